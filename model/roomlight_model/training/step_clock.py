"""Where a training step's time goes: milliseconds by part, as they pass and of the thread's own."""

import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final

PARTS: Final = ("data", "forward", "render", "backward", "optimiser")
"""data: decoding, phone depth, initial volumes, meshes; on threads of its own, ahead of need. forward: the 3D
networks. render: marching the rays and what is compared (2D networks, sphere). optimiser: clipping, AdamW, EMA."""


@dataclass
class StepClock:
    """Collects one value a step and part. Parts that run on several threads at once may all report."""

    wall_ms: dict[str, list[float]] = field(default_factory=dict[str, list[float]])
    thread_ms: dict[str, list[float]] = field(default_factory=dict[str, list[float]])
    """Processor time of the thread that reports: that of the networks' own threads is not in it."""

    @contextmanager
    def part(self, name: str) -> Generator[None]:
        """Time what is done inside."""
        wall, own = time.perf_counter(), time.thread_time()
        yield
        self.wall_ms.setdefault(name, []).append((time.perf_counter() - wall) * 1e3)
        self.thread_ms.setdefault(name, []).append((time.thread_time() - own) * 1e3)
