"""Metric scale from the floor: where poses have none, how high the camera was held gives it.

The floor is the lowest level surface that fills a part of the picture. Points are in the camera's axes (OpenGL).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, Float32

from roomlight.camera import Intrinsics
from roomlight.errors import CaptureError
from roomlight.frame import Frame
from roomlight.monocular.estimate import srgb_picture
from roomlight.monocular.network import shipped_depth
from roomlight.monocular.stream import SIZE, corrected
from roomlight.monocular.tracks import Samples, View, grey_picture, triangulated

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
_NEAR: Final = 4
"""Views that features are followed to."""
_AHEAD: Final = float(np.cos(np.radians(45)))
_LEAST_FEATURES: Final = 12.0
"""Weight of the features that tell the unit of poses."""
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


def metres_per_unit(frames: Sequence[Frame], height_m: float) -> float:
    """Return the metres of the unit of frames' poses, by the floor that they show.

    Frames with depth, in the poses' unit, show the floor by themselves. Others are depth by the network in the package,
    corrected by the features that moved since the frames beside them, whose triangulation has the poses' unit.

    Args:
        frames: Runs of neighbouring frames in the order of the capture, y up; without depth at least two.
        height_m: The camera's mean height over the floor.

    Raises:
        CaptureError: No frame shows the floor, or none that has none of depth moved.
    """
    measured = all(frame.depth_m.any() for frame in frames)
    fits = [_fit_of(frame) for frame in frames] if measured else _fits_by_features(frames)
    scale = floor_scale(fits, height_m)
    if scale is None:
        reason = "their depth shows no floor" if fits else "no frame moved enough to tell the unit of its poses"
        raise CaptureError(
            f"{frames[0].source} to {frames[-1].source}: {reason}; scale the poses to metres and leave out "
            f"camera_height_m={height_m:g}, or correct world_up"
        )
    return scale


def _fit_of(frame: Frame) -> FloorFit | None:
    return camera_height(frame.depth_m, frame.intrinsics, frame.camera_to_world[1, :3].astype(np.float64))


def _fits_by_features(frames: Sequence[Frame]) -> list[FloorFit | None]:
    """Return the floors of the frames without depth that moved, in the poses' unit."""
    spread = float(np.std([frame.camera_to_world[:3, 3] for frame in frames], axis=0).max())
    if spread == 0:
        return []
    model, near = shipped_depth(), [frame.scaled(1 / spread).resized(*SIZE) for frame in frames]
    views = [View(grey_picture(srgb_picture(f)), f.intrinsics, f.camera_to_world, np.zeros((0, 0))) for f in near]
    fits: list[FloorFit | None] = []
    for frame, view in zip(near, views, strict=True):
        up = frame.camera_to_world[1, :3].astype(np.float64)
        estimated = model.estimate(srgb_picture(frame), frame.intrinsics, up).resized(*view.grey.shape[::-1])
        inverse = _by_features(view, views, estimated.inverse)
        if inverse is not None:
            fit = camera_height(1 / inverse, frame.intrinsics, up)
            fits.append(None if fit is None else FloorFit(spread * fit.height, fit.share))
    return fits


def _by_features(
    view: View, others: Sequence[View], inverse: Float32[np.ndarray, "h w"]
) -> Float32[np.ndarray, "h w"] | None:
    """Return estimated 1 / depth in the unit of the poses; None without features that moved.

    The nearest views come first, where features are followed from the place that they would have infinitely far away.
    """
    place, ahead = view.camera_to_world[:3, 3], view.camera_to_world[:3, 2]
    apart = sorted((float(np.linalg.norm(other.camera_to_world[:3, 3] - place)), k) for k, other in enumerate(others))
    known, guess = Samples.joined([]), np.full_like(inverse, 1e-6)
    for _, k in [(far, k) for far, k in apart if far > 0 and others[k].camera_to_world[:3, 2] @ ahead > _AHEAD][:_NEAR]:
        known = Samples.joined([known, triangulated(view, others[k], guess)])
        if float(known.weight.sum()) > _LEAST_FEATURES:
            guess = corrected(inverse, known)
    return guess if float(known.weight.sum()) > _LEAST_FEATURES else None


def floor_scale(fits: Sequence[FloorFit | None], height_m: float) -> float | None:
    """Return the metres of a unit of depth, by the floors of several frames whose depth has the same unit.

    Args:
        fits: Of the frames (`camera_height`); None where no floor is seen.
        height_m: The camera's mean height over the floor.

    Returns:
        None if no frame shows the floor. The median by share of the picture: half of the frames may be wrong.
    """
    seen = sorted((fit.height, fit.share) for fit in fits if fit is not None)
    if not seen:
        return None
    total = np.cumsum([share for _, share in seen])
    return height_m / seen[int(np.searchsorted(total, total[-1] / 2))][0]
