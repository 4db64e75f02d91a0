# pyright: reportMissingParameterType=false
"""Points of the fused surface compared with what one depth image sees."""

import numpy as np
from numba import njit

from roomlight.kernels.common import CACHED

UNKNOWN = 0
FREE = 1
ON_SURFACE = 2


@njit(**CACHED)
def classify_points(points, view, measured, margin_m, margin_share, out, start, stop):
    """Write to out[start:stop] whether a point is unknown to the view, in free space, or on a surface that it sees.

    A point is free if the nearest of the 3 x 3 depths around it is farther by more than the margin, and on the surface
    if all nine are within the margin; so neither happens at a depth edge.

    Args:
        view: the depth image and its camera (`roomlight.engine.surface.mesh.DepthView`).
        measured: [h, w], where the sensor gave the depth.
    """
    matrix, lens, depth = view
    height, width = depth.shape
    for i in range(start, stop):
        out[i] = UNKNOWN
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        ahead = -(matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3])
        if ahead <= 0.01:
            continue
        column = lens[2] + lens[0] * (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / ahead
        row = lens[3] - lens[1] * (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / ahead
        if not (1 <= column < width - 1 and 1 <= row < height - 1):
            continue
        i0, j0 = int(row), int(column)
        nearest, farthest = np.float32(1e9), np.float32(0)
        known = True
        for di in range(-1, 2):
            for dj in range(-1, 2):
                known = known and measured[i0 + di, j0 + dj]
                value = depth[i0 + di, j0 + dj]
                nearest, farthest = min(nearest, value), max(farthest, value)
        if not known:
            continue
        margin = margin_m + margin_share * ahead
        if ahead < nearest - margin:
            out[i] = FREE
        elif nearest > ahead - margin and farthest < ahead + margin:
            out[i] = ON_SURFACE
