"""Metric scale from the floor: how high a camera is held gives it.

The floor is the lowest level surface that fills a part of the picture. Points are in the camera's axes (OpenGL).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.monocular.fitting import median_of

CAMERA_HEIGHT_M: Final = 1.45
"""How high people hold a phone that films a room."""
_WIDTH: Final = 80
"""Columns of depth that are looked at."""
_LEVEL: Final = float(np.cos(np.radians(25)))
"""Least cosine between a level surface's normal and up; estimated depth is as crooked."""
_LEAST_DIP: Final = float(np.sin(np.radians(8)))
"""Rays that fall less meet the floor too far away to tell its height."""
_BIN: Final = 0.05
"""Width of the bins of log height."""
_BAND: Final = 0.15
_LEAST_SHARE: Final = 0.02
"""Of the picture's pixels that a floor fills."""
_LEAST_OF_LARGEST: Final = 0.3
"""A lower surface of fewer pixels than this, of the largest level surface's, is an error of depth below the floor."""


@dataclass(frozen=True)
class FloorFit:
    """The floor of a picture.

    Attributes:
        height: The camera's height over it, in the unit of the depth.
        share: Of the picture's pixels that show it.
    """

    height: float
    share: float


def camera_height(
    depth: Float[np.ndarray, "h w"], intrinsics: Intrinsics, up: Float[np.ndarray, "3"]
) -> FloorFit | None:
    """Return how high a camera is over the floor that it sees; None if it sees none.

    Args:
        depth: z-depth in any unit, 0 = unknown.
        intrinsics: Its lens, for a picture of any size of the same view.
        up: The world's up in the camera's axes, a unit vector (the second row of a camera-to-world rotation).
    """
    rows, columns = depth.shape
    width = min(_WIDTH, columns)
    height = max(3, round(rows * width / columns))
    small = cv2.resize(depth.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    known = cv2.resize((depth > 0).astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) > 0.99
    points = intrinsics.resized(width, height).rays().astype(np.float64) * small[..., None]
    across, along = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    normal = np.cross(along, across)
    inner = points[1:-1, 1:-1]
    drop = -(inner @ up)
    known = known[1:-1, 2:] & known[1:-1, :-2] & known[2:, 1:-1] & known[:-2, 1:-1] & known[1:-1, 1:-1]
    level = np.abs(normal @ up) > _LEVEL * np.linalg.norm(normal, axis=2)
    chosen = np.log(drop[known & level & (drop > _LEAST_DIP * np.linalg.norm(inner, axis=2))])
    least = _LEAST_SHARE * drop.size
    if len(chosen) < least:
        return None
    low = float(chosen.min())
    counts = np.bincount(((chosen - low) / _BIN).astype(int), minlength=5)
    near = np.convolve(counts, np.ones(5), mode="same")
    (large,) = np.nonzero(near >= max(least, _LEAST_OF_LARGEST * float(near.max())))
    if len(large) == 0:
        return None
    first = int(large[-1])
    while first > 0 and near[first - 1] > near[first]:  # down from the flank to the surface's own height
        first -= 1
    floor = chosen[np.abs(chosen - low - (first + 0.5) * _BIN) < _BAND]
    return FloorFit(float(np.exp(np.median(floor))), len(floor) / drop.size)


def floor_scale(fits: Sequence[FloorFit | None], height_m: float) -> float | None:
    """Return the metres of a unit of depth, by the floors of several frames whose depth has the same unit.

    The median by share of the picture, for the camera's mean height: half of the frames may be wrong. None if no frame
    shows the floor.
    """
    seen = np.array([(fit.height, fit.share) for fit in fits if fit is not None])
    return height_m / median_of(*seen.T) if len(seen) else None
