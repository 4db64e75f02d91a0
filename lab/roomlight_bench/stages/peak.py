"""The machine's peak: the speed of a float32 matrix product, measured in the run that uses it."""

from typing import Final

import numpy as np

_EDGE: Final = 2048


class MatrixProduct:
    """NumPy's product of two square float32 matrices on its BLAS's threads, which no network outruns by much."""

    def __init__(self, *, edge: int = _EDGE) -> None:
        """Make the matrices and multiply them once."""
        self._factor = np.ones((edge, edge), np.float32)
        self._product = np.empty_like(self._factor)
        self.flops = 2.0 * edge**3
        self.run()

    def run(self) -> None:
        """Multiply once."""
        np.matmul(self._factor, self._factor, out=self._product)

    def flops_per_s(self, run_ms: float) -> float:
        """Return the operations per second of a run of `run_ms` milliseconds."""
        return 1e3 * self.flops / run_ms
