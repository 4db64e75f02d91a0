"""A textured box room of known size, seen by a camera: pictures and exact depth without any renderer."""

import cv2
import numpy as np
from jaxtyping import Float32

from roomlight.camera import Intrinsics
from roomlight.frame import Frame

LENS = Intrinsics(280.0, 280.0, 160.0, 120.0, 320, 240)
_LOW, _HIGH = np.array([-2.0, 0.0, -3.5]), np.array([2.5, 2.6, 2.0])
_TEXTURE = cv2.resize(
    np.random.default_rng(5).random((96, 96), np.float32), (1536, 1536), interpolation=cv2.INTER_CUBIC
).clip(0, 1)


def pose(x: float, *, turn: float = 0.0) -> Float32[np.ndarray, "4 4"]:
    """Return a level camera at (x, 1.4, 0), turned about the vertical."""
    c, s = np.cos(turn), np.sin(turn)
    matrix = np.array([[c, 0, s, x], [0, 1, 0, 1.4], [-s, 0, c, 0], [0, 0, 0, 1.0]])
    return matrix.astype(np.float32)


def exact_depth(camera_to_world: np.ndarray, lens: Intrinsics = LENS) -> Float32[np.ndarray, "h w"]:
    """Return the exact z-depth."""
    return hit(camera_to_world, lens)[0]


def frame(index: int, camera_to_world: np.ndarray, *, depth: bool = False, lens: Intrinsics = LENS) -> Frame:
    """Return a frame with the room's texture; without depth unless asked for."""
    depth_m, points, axis = hit(camera_to_world, lens)
    across = np.take_along_axis(points, ((axis + 1) % 3)[..., None], 2)[..., 0]
    along = np.take_along_axis(points, ((axis + 2) % 3)[..., None], 2)[..., 0]
    columns = ((across + 5) * 120 + 97 * axis).astype(np.float32) % 1535
    rows = ((along + 5) * 120).astype(np.float32) % 1535
    value = 0.05 + 0.8 * cv2.remap(_TEXTURE, columns, rows, cv2.INTER_LINEAR)
    image = np.repeat(value[..., None], 3, axis=2)
    known = depth_m if depth else np.zeros_like(depth_m)
    return Frame(index, image, np.zeros(value.shape, bool), known, lens, camera_to_world.astype(np.float64))


def hit(camera_to_world: np.ndarray, lens: Intrinsics) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return z-depth, the points in the world, and the axis of the wall, of each pixel."""
    rays = lens.rays().astype(np.float64) @ np.asarray(camera_to_world, np.float64)[:3, :3].T
    origin = np.asarray(camera_to_world, np.float64)[:3, 3]
    with np.errstate(divide="ignore"):
        reach = np.where(rays > 0, (_HIGH - origin) / rays, (_LOW - origin) / rays)
    axis = reach.argmin(axis=2)
    depth = reach.min(axis=2)
    return depth.astype(np.float32), origin + depth[..., None] * rays, axis
