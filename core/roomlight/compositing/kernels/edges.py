# pyright: reportMissingParameterType=false
"""Joint bilateral interpolation of visibility where depth does not decide it, guided by colour."""

import math

import numpy as np
from numba import njit


@njit(nogil=True, cache=True, fastmath=True)
def guide_by_colour(visible, certain, wanted, guide, radius, spread, out, start, stop):
    """Fill rows start..stop of `out` where `wanted`: the mean of certain neighbours, weighted by colour and distance.

    visible:  [h, w] 0 hidden to 1 visible.
    certain:  [h, w] where depth decides.
    wanted:   [h, w] pixels to fill.
    guide:    [h, w, 3] sRGB-encoded colour in [0, 1].
    radius:   of the window, pixels.
    spread:   difference of colour at which a neighbour's weight falls to 1/e.
    """
    height, width = visible.shape
    space = np.float32(2.0) / np.float32(radius * radius)
    tone = np.float32(1.0) / (spread * spread)
    for i in range(start, stop):
        for j in range(width):
            if not wanted[i, j]:
                continue
            total, mean = np.float32(0), np.float32(0)
            near_total, near_mean = np.float32(0), np.float32(0)
            for y in range(max(0, i - radius), min(height, i + radius + 1)):
                for x in range(max(0, j - radius), min(width, j + radius + 1)):
                    if not certain[y, x]:
                        continue
                    red = guide[y, x, 0] - guide[i, j, 0]
                    green = guide[y, x, 1] - guide[i, j, 1]
                    blue = guide[y, x, 2] - guide[i, j, 2]
                    near = math.exp(-np.float32((y - i) * (y - i) + (x - j) * (x - j)) * space)
                    weight = near * math.exp(-min((red * red + green * green + blue * blue) * tone, np.float32(40)))
                    total += weight
                    mean += weight * visible[y, x]
                    near_total += near
                    near_mean += near * visible[y, x]
            if total > np.float32(1e-7):
                out[i, j] = mean / total
            elif near_total > 0:
                out[i, j] = near_mean / near_total
