"""A room whose distances can be written down: the inside of a box, with solid boxes standing in it."""

import cv2
import numpy as np

from roomlight.camera import Intrinsics
from roomlight_generator.sequences.walk import FreeSpace

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
TABLE: Box = ((-0.5, 0.0, -0.4), (0.6, 0.7, 0.4))
SOFA: Box = ((-2.5, 0.0, -1.0), (-1.6, 0.8, 1.0))
CELL_M = 0.1


def distances(size_m, boxes=()):
    """A caster for rays from inside the room (x and z about 0, floor at 0)."""
    low = np.array([-size_m[0] / 2, 0, -size_m[2] / 2])
    high = low + size_m

    def cast(origins, directions):
        o, d = origins.astype(np.float64), directions.astype(np.float64)
        d = np.where(np.abs(d) < 1e-12, 1e-12, d)
        nearest = np.maximum((low - o) / d, (high - o) / d).min(axis=1)
        for corner, far_corner in boxes:
            near, far = (corner - o) / d, (far_corner - o) / d
            enter, leave = np.minimum(near, far).max(axis=1), np.maximum(near, far).min(axis=1)
            hit = (enter <= leave) & (leave > 0)
            nearest = np.where(hit, np.minimum(nearest, np.where(enter > 0, enter, leave)), nearest)
        return nearest.astype(np.float32)

    return cast


def free_space(size_m=(5.0, 2.6, 4.0), boxes=(TABLE, SOFA), body_m=0.25):
    """The room's free space for a body of that radius."""
    columns, rows = round(size_m[0] / CELL_M), round(size_m[2] / CELL_M)
    x = (np.arange(columns) + 0.5) * CELL_M - size_m[0] / 2
    z = ((np.arange(rows) + 0.5) * CELL_M - size_m[2] / 2)[:, None]
    free = (np.abs(x) < size_m[0] / 2 - body_m) & (np.abs(z) < size_m[2] / 2 - body_m)
    for (x0, _, z0), (x1, _, z1) in boxes:
        free &= np.hypot(np.maximum(np.maximum(x0 - x, x - x1), 0), np.maximum(np.maximum(z0 - z, z - z1), 0)) >= body_m
    return FreeSpace(free, (float(x[0]), float(z[0, 0])), CELL_M, distances(np.array(size_m), boxes))


def clearance_m(points, size_m, boxes):
    """Exact distance of points to the nearest surface; negative inside of a box."""
    low = np.array([-size_m[0] / 2, 0, -size_m[2] / 2])
    gap = np.minimum(points - low, low + size_m - points).min(axis=1)
    for corner, far_corner in boxes:
        off = np.maximum(np.array(corner) - points, points - np.array(far_corner))
        outside = np.linalg.norm(np.maximum(off, 0), axis=1)
        gap = np.minimum(gap, np.where(outside > 0, outside, off.max(axis=1)))
    return gap


def depth_m(free: FreeSpace, camera: Intrinsics, camera_to_world: np.ndarray) -> np.ndarray:
    """Exact z-depth of a view."""
    rays = camera.rays().reshape(-1, 3)
    lengths = np.linalg.norm(rays, axis=1)
    ways = (rays / lengths[:, None]) @ camera_to_world[:3, :3].T
    reach = free.distances(np.tile(camera_to_world[:3, 3], (len(rays), 1)).astype(np.float32), ways.astype(np.float32))
    return (reach / lengths).reshape(camera.height, camera.width).astype(np.float32)


def shrunk(free: FreeSpace, rows: slice) -> FreeSpace:
    """The same room, walkable only in some rows of the grid."""
    keep = np.zeros_like(free.walkable)
    keep[rows] = free.walkable[rows]
    return FreeSpace(keep, free.origin, free.cell_m, free.distances)


def smooth_noise(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """A soft picture in [0, 1]."""
    coarse = rng.random((6, 8, 3)).astype(np.float32)
    return np.clip(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), 0, 1)
