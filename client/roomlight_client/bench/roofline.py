"""The roofline: no code on this machine can take less than its arithmetic at the speed of a matrix product, nor less
than its compulsory memory traffic at the speed of a copy. Both ceilings are measured in the run that uses them.
"""

import time
from dataclasses import dataclass
from typing import Final

import numpy as np

from roomlight.threads import shard

_MATRIX: Final = 2048
_COPY_FLOATS: Final = 32 * 2**20
"""128 MiB each way: beyond any cache of today."""
_ATTEMPTS: Final = 5


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


def measure_ceilings(*, matrix: int = _MATRIX, floats: int = _COPY_FLOATS) -> Ceilings:
    """Best of a few: NumPy's float32 matrix product on the threads its BLAS takes, and a copy on our threads."""
    a = np.ones((matrix, matrix), np.float32)
    product = np.empty_like(a)
    source, target = np.ones(floats, np.float32), np.zeros(floats, np.float32)

    def copy(start: int, stop: int) -> None:
        target[start:stop] = source[start:stop]

    matmul_s, copy_s = float("inf"), float("inf")
    for _ in range(_ATTEMPTS):
        began = time.perf_counter()
        np.matmul(a, a, out=product)
        between = time.perf_counter()
        shard(copy, floats, pieces_per_thread=1)
        matmul_s = min(matmul_s, between - began)
        copy_s = min(copy_s, time.perf_counter() - between)
    return Ceilings(2 * matrix**3 / matmul_s, 2 * source.nbytes / copy_s)
