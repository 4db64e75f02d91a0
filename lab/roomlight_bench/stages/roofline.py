"""The roofline: a lower bound on the time of a stage on this machine.

No code can be faster than its arithmetic at the speed of a matrix product, nor faster than its compulsory memory
traffic at the speed of a copy. Both ceilings are measured in the run that uses them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from roomlight.threads import parallel_for

_MATRIX: Final = 2048
_COPY_FLOATS: Final = 32 * 2**20
"""128 MiB each for source and target: larger than any cache."""


@dataclass(frozen=True)
class Ceilings:
    """The most this machine can do: float32 operations per second (matrix product), bytes per second (copy)."""

    flops_per_s: float
    bytes_per_s: float


@dataclass(frozen=True)
class Cost:
    """Work of a stage by formula: floating-point operations, and bytes that must be read or written at least once."""

    flops: float
    bytes: float

    def __add__(self, other: "Cost") -> "Cost":
        """Add the work of two stages."""
        return Cost(self.flops + other.flops, self.bytes + other.bytes)

    def __mul__(self, count: float) -> "Cost":
        """Multiply the work by `count`."""
        return Cost(self.flops * count, self.bytes * count)

    def roof_ms(self, ceilings: Ceilings) -> float:
        """Return the least time in milliseconds: max(FLOPs / matmul peak, bytes / copy bandwidth)."""
        return 1e3 * max(self.flops / ceilings.flops_per_s, self.bytes / ceilings.bytes_per_s)


@dataclass(frozen=True)
class CeilingRuns:
    """The runs that measure the ceilings; interleaved with the stages, so that a busy machine lowers both."""

    matmul: Callable[[], object]
    copy: Callable[[], object]
    flops: float
    bytes: float

    @classmethod
    def of(cls, *, matrix: int = _MATRIX, floats: int = _COPY_FLOATS) -> "CeilingRuns":
        """Prepare NumPy's float32 matrix product on its BLAS's threads and a copy on our threads; run each once."""
        factor = np.ones((matrix, matrix), np.float32)
        product = np.empty_like(factor)
        source, target = np.ones(floats, np.float32), np.zeros(floats, np.float32)

        def piece(start: int, stop: int) -> None:
            target[start:stop] = source[start:stop]

        def multiply() -> None:
            np.matmul(factor, factor, out=product)

        def copy() -> None:
            parallel_for(piece, floats, pieces_per_thread=1)

        multiply()
        copy()
        return cls(multiply, copy, 2.0 * matrix**3, 2.0 * source.nbytes)

    def ceilings(self, matmul_ms: float, copy_ms: float) -> Ceilings:
        """Compute the ceilings from the least times of the two runs."""
        return Ceilings(1e3 * self.flops / matmul_ms, 1e3 * self.bytes / copy_ms)
