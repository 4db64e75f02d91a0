# pyright: reportMissingParameterType=false
"""Systems of a few hundred equations on one thread.

LAPACK's solvers run on the BLAS's threads, which wait for each other step by step: 1 ms on idle cores, 200 ms where
other work shares them, as in a server.
"""

import math

import numpy as np
from numba import njit


@njit(nogil=True, cache=True, fastmath=True)
def solve_in_place(matrix, values):
    """Solve matrix x = values by Cholesky's decomposition: `values` [n, c] becomes x, `matrix` [n, n] is overwritten.

    The matrix is symmetric and positive definite, both are float32; only its lower triangle is read.
    """
    count, columns = values.shape
    # 1. matrix = L L^T; rows are contiguous, and so are their products
    for i in range(count):
        for j in range(i + 1):
            rest = matrix[i, j]
            product = np.float32(0)
            for k in range(j):
                product += matrix[i, k] * matrix[j, k]
            rest -= product
            matrix[i, j] = math.sqrt(rest) if i == j else rest / matrix[j, j]
    # 2. L y = values
    for i in range(count):
        for column in range(columns):
            product = np.float32(0)
            for k in range(i):
                product += matrix[i, k] * values[k, column]
            values[i, column] = (values[i, column] - product) / matrix[i, i]
    # 3. L^T x = y, row by row of L
    for i in range(count - 1, -1, -1):
        for column in range(columns):
            values[i, column] /= matrix[i, i]
            for k in range(i):
                values[k, column] -= matrix[i, k] * values[i, column]
