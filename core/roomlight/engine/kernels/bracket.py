# pyright: reportMissingParameterType=false
"""Reprojection of clipped pixels into another frame; see `roomlight.engine.surface.bracket`."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32
from numba import njit

from roomlight.engine.kernels.blend import better_share
from roomlight.kernels.common import CACHED


class SourceArrays(NamedTuple):
    """A frame that may show the points: texture at the image's size, depth at the mesh's.

    `lens` is (fx, fy, cx, cy) of the image, `depth_lens` of the depth.
    """

    image: Float32[np.ndarray, "h w 3"]
    clipped: Bool[np.ndarray, "h w"]
    bound: Float32[np.ndarray, "h w"]
    depth_m: Float32[np.ndarray, "dh dw"]
    lens: Float32[np.ndarray, "4"]
    depth_lens: Float32[np.ndarray, "4"]
    world_to_camera: Float32[np.ndarray, "4 4"]


class PointArrays(NamedTuple):
    """Clipped pixels as points in the world, with what is known of their radiance; the last three are updated."""

    world: Float32[np.ndarray, "n 3"]
    radiance: Float32[np.ndarray, "n 3"]
    bound: Float32[np.ndarray, " n"]
    clipped: Bool[np.ndarray, " n"]


@njit(**CACHED)
def take_radiance(points, source, tolerance_m):
    """Take each clipped point's radiance from the source, where that knows more; return how many were taken.

    The source's pixel of the point is tried first. If it is unclipped and too dark, its eight neighbours follow: the
    two frames agree within a pixel. An unclipped pixel beside a clipped one is no evidence: at the rim of a lamp that
    both frames clip it is part lamp and part wall.
    """
    one = np.float32(1)
    height, width = source.bound.shape
    depth_height, depth_width = source.depth_m.shape
    m, lens, depth_lens = source.world_to_camera, source.lens, source.depth_lens
    taken = 0
    for n in range(points.world.shape[0]):
        if not points.clipped[n]:
            continue
        px, py, pz = points.world[n, 0], points.world[n, 1], points.world[n, 2]
        z = -(m[2, 0] * px + m[2, 1] * py + m[2, 2] * pz + m[2, 3])
        if z <= 0:
            continue
        x = (m[0, 0] * px + m[0, 1] * py + m[0, 2] * pz + m[0, 3]) / z
        y = -(m[1, 0] * px + m[1, 1] * py + m[1, 2] * pz + m[1, 3]) / z
        column, row = lens[2] + lens[0] * x, lens[3] + lens[1] * y
        if not (0 <= column < width and 0 <= row < height):
            continue
        # the nearest vertex: half a vertex beyond the outermost ones
        i = min(max(int(np.floor(depth_lens[2] + depth_lens[0] * x)), 0), depth_width - 1)
        j = min(max(int(np.floor(depth_lens[3] + depth_lens[1] * y)), 0), depth_height - 1)
        depth = source.depth_m[j, i]
        if depth <= 0 or abs(depth - z) >= tolerance_m:
            continue
        for step in range(9):
            place = (step + 4) % 9  # the middle one first
            r, c = int(row) + place // 3 - 1, int(column) + place % 3 - 1
            if r < 0 or r >= height or c < 0 or c >= width:
                continue
            share = one if source.clipped[r, c] else np.float32(0)
            if share < one and _beside_clipped(source.clipped, r, c):
                continue
            if better_share(one, points.bound[n], share, source.bound[r, c]) == one:
                for k in range(3):  # assigning the row whole takes Numba a second to compile
                    points.radiance[n, k] = source.image[r, c, k]
                points.bound[n] = source.bound[r, c]
                points.clipped[n] = source.clipped[r, c]
                taken += 1
                break
            if step == 0 and share == one:
                break
    return taken


@njit(**CACHED)
def _beside_clipped(clipped, row, column):
    height, width = clipped.shape
    for r in range(max(row - 1, 0), min(row + 2, height)):
        for c in range(max(column - 1, 0), min(column + 2, width)):
            if clipped[r, c]:
                return True
    return False
