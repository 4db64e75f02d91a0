# pyright: reportMissingParameterType=false
"""Depth at the pixels of a finer image, and visibility guided by colour where depth does not decide it."""

import math

import numpy as np
from numba import njit

from roomlight.kernels.common import CACHED


@njit(**CACHED, fastmath=True)
def resample_depth(depth, smooth, corner, scale, out, certain, start, stop):
    """Fill rows start..stop of a finer image: linear where the nearest sample is `smooth`, else the nearest sample.

    Args:
        corner: row and column of the finer image's first pixel.
        scale: size of its pixels in samples of depth, along rows and columns.
        out, certain: [h, w] out: depth, and `smooth` at the nearest sample.
    """
    rows, columns = depth.shape
    half = np.float32(0.5)
    for i in range(start, stop):
        y = (np.float32(corner[0] + i) + half) * scale[0] - half
        near_y = min(max(math.floor(y + half), 0), rows - 1)
        y = min(max(y, np.float32(0)), np.float32(rows - 1))
        top = int(y)
        bottom, down = min(top + 1, rows - 1), y - np.float32(top)
        for j in range(out.shape[1]):
            x = (np.float32(corner[1] + j) + half) * scale[1] - half
            near_x = min(max(math.floor(x + half), 0), columns - 1)
            certain[i, j] = smooth[near_y, near_x]
            if not smooth[near_y, near_x]:
                out[i, j] = depth[near_y, near_x]
                continue
            x = min(max(x, np.float32(0)), np.float32(columns - 1))
            left = int(x)
            right, across = min(left + 1, columns - 1), x - np.float32(left)
            upper = depth[top, left] + across * (depth[top, right] - depth[top, left])
            lower = depth[bottom, left] + across * (depth[bottom, right] - depth[bottom, left])
            out[i, j] = upper + down * (lower - upper)


@njit(**CACHED, fastmath=True)
def guide_by_colour(visible, certain, wanted, guide, radius, spread, doubt, contrast, out, start, stop):
    """Fill rows start..stop of `out` where `wanted`: the mean of neighbours, weighted by colour and distance.

    Args:
        visible: [h, w] 0 hidden to 1 visible.
        certain: [h, w] where depth decides.
        wanted: [h, w] pixels to fill.
        guide: [h, w, 3] sRGB-encoded colour in [0, 1].
        radius: of the window, pixels.
        spread: difference of colour at which a neighbour's weight falls to 1/e.
        doubt: weight of neighbours that are not certain.
        contrast: of the mean about a half, which makes soft edges narrow.
    """
    height, width = visible.shape
    space = np.float32(2.0) / np.float32(radius * radius)
    tone, half = np.float32(1.0) / (spread * spread), np.float32(0.5)
    for i in range(start, stop):
        for j in range(width):
            if not wanted[i, j]:
                continue
            total, mean = np.float32(0), np.float32(0)
            near_total, near_mean = np.float32(0), np.float32(0)
            for y in range(max(0, i - radius), min(height, i + radius + 1)):
                for x in range(max(0, j - radius), min(width, j + radius + 1)):
                    red = guide[y, x, 0] - guide[i, j, 0]
                    green = guide[y, x, 1] - guide[i, j, 1]
                    blue = guide[y, x, 2] - guide[i, j, 2]
                    near = math.exp(-np.float32((y - i) * (y - i) + (x - j) * (x - j)) * space)
                    near *= np.float32(1) if certain[y, x] else doubt
                    weight = near * math.exp(-min((red * red + green * green + blue * blue) * tone, np.float32(40)))
                    total += weight
                    mean += weight * visible[y, x]
                    near_total += near
                    near_mean += near * visible[y, x]
            if total <= np.float32(1e-7):
                total, mean = near_total, near_mean
            if total > 0:
                out[i, j] = min(max((mean / total - half) * contrast + half, np.float32(0)), np.float32(1))
