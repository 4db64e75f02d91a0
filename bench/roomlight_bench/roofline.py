"""The roofline: no code on this machine can take less than its arithmetic at the speed of a matrix product, nor less
than its compulsory memory traffic at the speed of a copy. Both ceilings are measured in the run that uses them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from roomlight.threads import shard

_MATRIX: Final = 2048
_COPY_FLOATS: Final = 32 * 2**20
"""128 MiB each way: beyond any cache of today."""


@dataclass(frozen=True)
class Ceilings:
    """What this machine can do at most: float32 operations a second (matrix product), bytes a second (copy)."""

    flops_per_s: float
    bytes_per_s: float


@dataclass(frozen=True)
class Cost:
    """Work of a stage by formula: floating-point operations, and bytes that must be read or written once."""

    flops: float
    bytes: float

    def __add__(self, other: "Cost") -> "Cost":
        """Both, one after the other."""
        return Cost(self.flops + other.flops, self.bytes + other.bytes)

    def __mul__(self, count: float) -> "Cost":
        """The same `count` times."""
        return Cost(self.flops * count, self.bytes * count)

    def roof_ms(self, ceilings: Ceilings) -> float:
        """The least time: max(FLOPs / matmul peak, bytes / copy bandwidth), in milliseconds."""
        return 1e3 * max(self.flops / ceilings.flops_per_s, self.bytes / ceilings.bytes_per_s)


@dataclass(frozen=True)
class CeilingRuns:
    """What the ceilings are measured by; timed in turn with the stages, so that a busy machine lowers both."""

    matmul: Callable[[], object]
    copy: Callable[[], object]
    flops: float
    bytes: float

    @classmethod
    def of(cls, *, matrix: int = _MATRIX, floats: int = _COPY_FLOATS) -> "CeilingRuns":
        """NumPy's float32 matrix product on the threads its BLAS takes, and a copy on our threads; both run once."""
        factor = np.ones((matrix, matrix), np.float32)
        product = np.empty_like(factor)
        source, target = np.ones(floats, np.float32), np.zeros(floats, np.float32)

        def piece(start: int, stop: int) -> None:
            target[start:stop] = source[start:stop]

        def multiply() -> None:
            np.matmul(factor, factor, out=product)

        def copy() -> None:
            shard(piece, floats, pieces_per_thread=1)

        multiply()
        copy()
        return cls(multiply, copy, 2.0 * matrix**3, 2.0 * source.nbytes)

    def ceilings(self, matmul_ms: float, copy_ms: float) -> Ceilings:
        """The ceilings, from the least times of the two."""
        return Ceilings(1e3 * self.flops / matmul_ms, 1e3 * self.bytes / copy_ms)
