# pyright: reportMissingParameterType=false
"""Linear radiance to 8-bit sRGB by table, and noise of encoded values."""

import math

import numpy as np
from numba import njit


@njit(nogil=True, cache=True)
def encode_values(linear, table, out, start, stop):
    """Encode values start..stop; `table` holds the code of i / 65535."""
    for i in range(start, stop):
        value = linear[i]
        if value >= np.float32(1):
            out[i] = table[65535]
        elif value > np.float32(0):
            out[i] = table[int(value * np.float32(65535) + np.float32(0.5))]
        else:
            out[i] = table[0]


@njit(nogil=True, cache=True)
def compose_rows(frame, ratio, objects, alpha, table, encoded, start, stop):
    """Encode frame x ratio x (1 - alpha) + objects for rows start..stop; pixels that nothing changes stay.

    frame, ratio, objects:  [h, w, 3] linear.
    alpha:                  [h, w].
    table:                  as in `encode_values`.
    encoded:                [h, w, 3] in: the encoded frame; out: the encoded sum.
    """
    one = np.float32(1)
    for i in range(start, stop):
        for j in range(alpha.shape[1]):
            left = one - alpha[i, j]
            if left == one and ratio[i, j, 0] == one and ratio[i, j, 1] == one and ratio[i, j, 2] == one:
                continue
            for c in range(3):
                value = frame[i, j, c] * ratio[i, j, c] * left + objects[i, j, c]
                if value >= one:
                    encoded[i, j, c] = table[65535]
                elif value > np.float32(0):
                    encoded[i, j, c] = table[int(value * np.float32(65535) + np.float32(0.5))]
                else:
                    encoded[i, j, c] = table[0]


@njit(nogil=True, cache=True)
def add_pattern(image, alpha, noise, pattern, corner, start, stop):
    """Add noise to the part `alpha` of rows start..stop of an encoded image [h, w, 3], in place; clip to 0 to 1.

    noise:    [levels, 3] standard deviation at each brightness.
    pattern:  [n, n, 3] periodic noise of deviation 1; `corner` is its row and column at the image's corner.
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
