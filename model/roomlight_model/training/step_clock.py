"""Timing of the parts of a training step in milliseconds: wall time and processor time."""

import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final

VIDEO_PARTS: Final = ("data", "mesh", "forward", "march", "blend", "backward", "optimiser")
"""Parts of a video stage's step. mesh: meshes and what the probes see of them, also on separate threads. march, blend:
ray marching and 2D networks. backward includes the networks' second forward pass."""
BACKGROUND: Final = ("data", "mesh")
"""Parts on separate threads."""
PARTS: Final = ("data", "forward", "render", "backward", "optimiser")
"""data: decoding, phone depth, initial volumes, meshes; on separate threads, in advance. forward: the 3D networks.
render: ray marching, 2D networks, sphere, losses. optimiser: clipping, AdamW, EMA."""


@dataclass
class StepClock:
    """Collects one value per step and part; several threads may report at once."""

    wall_ms: dict[str, list[float]] = field(default_factory=dict[str, list[float]])
    thread_ms: dict[str, list[float]] = field(default_factory=dict[str, list[float]])
    """Processor time of the reporting thread, without PyTorch's own threads."""

    @contextmanager
    def part(self, name: str) -> Generator[None]:
        """Time the block."""
        wall, own = time.perf_counter(), time.thread_time()
        yield
        self.wall_ms.setdefault(name, []).append((time.perf_counter() - wall) * 1e3)
        self.thread_ms.setdefault(name, []).append((time.thread_time() - own) * 1e3)

    def add_sums(self, other: "StepClock") -> None:
        """Add one value per part: the sum of another clock's values, such as those of a sequence's frames."""
        for mine, theirs in ((self.wall_ms, other.wall_ms), (self.thread_ms, other.thread_ms)):
            for name, values in theirs.items():
                mine.setdefault(name, []).append(sum(values))
