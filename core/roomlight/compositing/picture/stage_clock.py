"""Time of the compositor's stages: by the clock, and of the processor."""

import time
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass
class StageClock:
    """Milliseconds by stage.

    Attributes:
        wall_ms: Time that passed.
        cpu_ms: Processor time of the whole process: also of its other threads, if they work meanwhile.
    """

    wall_ms: dict[str, float] = field(default_factory=dict[str, float])
    cpu_ms: dict[str, float] = field(default_factory=dict[str, float])

    @contextmanager
    def stage(self, name: str):
        """Add the time inside the `with` block to a stage."""
        began, began_cpu = time.perf_counter(), time.process_time()
        yield
        self.cpu_ms[name] = self.cpu_ms.get(name, 0.0) + (time.process_time() - began_cpu) * 1e3
        self.wall_ms[name] = self.wall_ms.get(name, 0.0) + (time.perf_counter() - began) * 1e3
