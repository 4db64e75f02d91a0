# pyright: reportMissingParameterType=false
"""Systems of a few hundred equations on one thread.

LAPACK's solvers and NumPy's products run on the BLAS's threads, which wait for each other step by step: 1 ms on idle
cores, 200 ms where other work shares them, as in a server.
"""

import math

import numpy as np
from numba import njit

from roomlight.kernels.common import CACHED


@njit(**CACHED, fastmath=True)
def solve_in_place(matrix, values):
    """Solve matrix x = values by Cholesky's decomposition: `values` [c, n] becomes x, `matrix` [n, n] is overwritten.

    The matrix is symmetric and positive definite, both are float32; only its lower triangle is read.
    """
    channels, count = values.shape
    # 1. matrix = L L^T; rows are contiguous, and so are their products
    for i in range(count):
        for j in range(i + 1):
            rest = matrix[i, j]
            product = np.float32(0)
            for k in range(j):
                product += matrix[i, k] * matrix[j, k]
            rest -= product
            matrix[i, j] = math.sqrt(rest) if i == j else rest / matrix[j, j]
    for channel in range(channels):
        own = values[channel]
        # 2. L y = values
        for i in range(count):
            product = np.float32(0)
            for k in range(i):
                product += matrix[i, k] * own[k]
            own[i] = (own[i] - product) / matrix[i, i]
        # 3. L^T x = y, row by row of L
        for i in range(count - 1, -1, -1):
            own[i] /= matrix[i, i]
            for k in range(i):
                own[k] -= matrix[i, k] * own[i]


@njit(**CACHED, fastmath=True)
def multiply(matrix, values, out):
    """Write the product of a matrix [m, n] with each channel of `values` [c, n] into `out` [c, m]; all float32."""
    for i in range(matrix.shape[0]):
        row = matrix[i]
        for channel in range(values.shape[0]):
            own, product = values[channel], np.float32(0)
            for k in range(len(row)):
                product += row[k] * own[k]
            out[channel, i] = product
