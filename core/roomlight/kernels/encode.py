# pyright: reportMissingParameterType=false
"""Linear radiance to 8-bit sRGB by table, and noise of encoded values."""

import math

import numpy as np
from numba import njit

from roomlight.kernels.common import CACHED, JIT


@njit(**JIT)
def _code(value, table):
    limited = min(max(value, np.float32(0)), np.float32(1))
    return table[int(limited * np.float32(65535) + np.float32(0.5))]


@njit(**CACHED)
def encode_values(linear, table, out, start, stop):
    """Encode values start..stop; `table` holds the code of i / 65535."""
    for i in range(start, stop):
        out[i] = _code(linear[i], table)


@njit(**CACHED)
def compose_rows(frame, ratio, objects, corner, table, encoded, start, stop):
    """Encode frame x ratio x (1 - alpha) + objects for rows start..stop; pixels that nothing changes stay.

    Args:
        frame, ratio: [h, w, 3] linear.
        objects: [oh, ow, 4] linear radiance times alpha, and alpha; `corner` is the row and column where they begin.
        table: as in `encode_values`.
        encoded: [h, w, 3] in: the encoded frame; out: the encoded sum.
    """
    one = np.float32(1)
    rows, columns = objects.shape[:2]
    for i in range(start, stop):
        y = i - corner[0]
        for j in range(ratio.shape[1]):
            x = j - corner[1]
            left = one - objects[y, x, 3] if 0 <= y < rows and 0 <= x < columns else one
            if left < one:
                for c in range(3):
                    encoded[i, j, c] = _code(frame[i, j, c] * ratio[i, j, c] * left + objects[y, x, c], table)
            elif ratio[i, j, 0] != one or ratio[i, j, 1] != one or ratio[i, j, 2] != one:
                for c in range(3):
                    encoded[i, j, c] = _code(frame[i, j, c] * ratio[i, j, c], table)


@njit(**CACHED)
def add_pattern(image, alpha, noise, pattern, corner, start, stop):
    """Add noise to the part `alpha` of rows start..stop of an encoded image [h, w, 3], in place; clip to 0 to 1.

    Args:
        noise: [levels, 3] standard deviation at each brightness.
        pattern: [n, n, 3] periodic noise of deviation 1; `corner` is its row and column at the image's corner.
    """
    last = noise.shape[0] - 1
    size = pattern.shape[0]
    zero, one = np.float32(0), np.float32(1)
    for i in range(start, stop):
        row = (i + corner[0]) % size
        for j in range(image.shape[1]):
            if alpha[i, j] <= zero:
                continue
            column = (j + corner[1]) % size
            # the real part of a mixed pixel has its own noise: variances add up to the camera's
            left = one - alpha[i, j]
            strength = np.float32(math.sqrt(max(one - left * left, zero)))
            for c in range(3):
                place = min(max(image[i, j, c] * (last + 1) - np.float32(0.5), zero), np.float32(last - 1e-3))
                low = int(place)
                share = place - low
                sigma = (one - share) * noise[low, c] + share * noise[low + 1, c]
                image[i, j, c] = min(max(image[i, j, c] + strength * sigma * pattern[row, column, c], zero), one)
