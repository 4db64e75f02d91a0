"""Points to light: where an object can be placed in view of a camera.

World metres, as the frame's pose has them; pixels are (column, row) of the colour image from its top left corner.
"""

from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import transform_points
from roomlight.conventions import Position
from roomlight.errors import OptionError, ProbeError
from roomlight.frame import Frame
from roomlight.rules import check_type

ABOVE_M: Final = 0.1
"""Default distance of a point from the surface that it is picked on: the middle of a mug or a small plant."""
_WINDOW: Final = 4
"""Depth pixels on each side of the picked one that a surface's normal is fitted to."""
_SAME_SURFACE: Final = 0.1
"""Largest relative difference of depth to the picked pixel; beyond it lies another surface."""
_FLAT: Final = 0.05
"""Smallest ratio of a patch's width to its length; the normal of a narrower one is arbitrary."""


def point_in_view(frame: Frame) -> Position:
    """Return a point in free space in front of the camera: on its axis, at 60 % of the median depth.

    Raises:
        OptionError: `frame` is no frame.
        ProbeError: The frame has no depth.

    Examples:
        >>> import roomlight as rl
        >>> frame = next(iter(rl.open_capture(rl.sample_capture())))
        >>> x, y, z = rl.point_in_view(frame)
    """
    check_type(frame, Frame, "frame")
    known = frame.depth_m[frame.depth_m > 0]
    if known.size == 0:
        raise ProbeError(f"{frame.source}: no depth to place a probe by; give the probe's position")
    return _in_world(frame, np.array([0, 0, -0.6 * float(np.median(known))]))


def point_at_pixel(frame: Frame, u: float, v: float, *, above_m: float = ABOVE_M) -> Position:
    """Return the point `above_m` metres above the surface that a pixel shows, in world metres.

    Above is along the surface's normal on the camera's side. The normal is fitted to the depth around the pixel; where
    that is too little, it is the direction to the camera.

    Args:
        frame: The frame that the pixel belongs to.
        u: Column in the colour image; 0 is the left column, fractions are allowed.
        v: Row in the colour image; 0 is the top row.
        above_m: Distance from the surface in metres.

    Raises:
        OptionError: `frame` is no frame, the pixel lies outside the image, or `above_m` is negative or not finite.
        ProbeError: The frame has no depth at the pixel.

    Examples:
        >>> import roomlight as rl
        >>> frame = next(iter(rl.open_capture(rl.sample_capture())))
        >>> x, y, z = rl.point_at_pixel(frame, 160.0, 180.0, above_m=0.05)
    """
    check_type(frame, Frame, "frame")
    height, width = frame.image.shape[:2]
    if not (0 <= u < width and 0 <= v < height):
        raise OptionError(
            f"pixel is {u:g},{v:g}; the image is {width} x {height} pixels: columns are 0 to {width - 1}, rows 0 to "
            f"{height - 1}, from the top left"
        )
    if not 0 <= above_m < np.inf:
        raise OptionError(f"above_m is {above_m}; it must be a distance in metres, 0 or more")
    row, column, ray = depth_pixel(frame, u, v)
    depth_m = float(frame.depth_m[row, column])
    if depth_m <= 0:
        raise ProbeError(f"{frame.source}: {_no_depth(frame, u, v, row, column)}")
    surface = depth_m * ray
    return _in_world(frame, surface + above_m * _normal(frame, row, column, surface))


def depth_pixel(frame: Frame, u: float, v: float) -> tuple[int, int, Float[np.ndarray, "3"]]:
    """Return row and column of the depth pixel at a colour pixel, and the colour pixel's ray in the camera, z = -1."""
    (rows, columns), (height, width), k = frame.depth_m.shape, frame.image.shape[:2], frame.intrinsics
    row, column = min(int((v + 0.5) * rows / height), rows - 1), min(int((u + 0.5) * columns / width), columns - 1)
    return row, column, np.array([(u + 0.5 - k.cx) / k.fx, -(v + 0.5 - k.cy) / k.fy, -1.0])


def _normal(frame: Frame, row: int, column: int, surface: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Fit the unit normal of the surface around a depth pixel: camera axes, toward the camera."""
    toward_camera = -surface / np.linalg.norm(surface)
    rows, columns = frame.depth_m.shape
    down = np.arange(max(0, row - _WINDOW), min(rows, row + _WINDOW + 1))[:, None]
    across = np.arange(max(0, column - _WINDOW), min(columns, column + _WINDOW + 1))[None, :]
    depth = frame.depth_m[down, across].astype(np.float64)
    centre_m = depth[row - down[0, 0], column - across[0, 0]]
    k = frame.intrinsics.resized(columns, rows)
    x, y = (across + 0.5 - k.cx) / k.fx * depth, -(down + 0.5 - k.cy) / k.fy * depth
    same = (depth > 0) & (np.abs(depth - centre_m) < _SAME_SURFACE * centre_m)
    points = np.stack([x, y, -depth], axis=-1)[same]
    if len(points) < 3:
        return toward_camera
    _, spread, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    if spread[1] < _FLAT * spread[0]:
        return toward_camera
    normal = axes[2]
    return normal if normal @ toward_camera >= 0 else -normal


def _no_depth(frame: Frame, u: float, v: float, row: int, column: int) -> str:
    near = nearest_with_depth(frame, row, column)
    if near is None:
        return f"there is no depth at pixel {u:g},{v:g}, nor anywhere else in this frame; give the point in metres"
    return (
        f"there is no depth at pixel {u:g},{v:g} (a window, a lamp or a shiny surface?); the nearest pixel with depth "
        f"is {near[0]},{near[1]}"
    )


def nearest_with_depth(frame: Frame, row: int, column: int) -> tuple[int, int] | None:
    """Return the colour pixel (u, v) with depth that is nearest to a depth pixel; None if the frame has no depth."""
    known = np.argwhere(frame.depth_m > 0)
    if not len(known):
        return None
    near_row, near_column = known[np.argmin(((known - (row, column)) ** 2).sum(axis=1))].tolist()
    scale_v, scale_u = frame.image.shape[0] / frame.depth_m.shape[0], frame.image.shape[1] / frame.depth_m.shape[1]
    return int((near_column + 0.5) * scale_u), int((near_row + 0.5) * scale_v)


def _in_world(frame: Frame, point_camera: Float[np.ndarray, "3"]) -> Position:
    x, y, z = (round(value, 3) for value in transform_points(frame.camera_to_world, point_camera).tolist())
    return x, y, z
