"""Metres of poses that have none, as of a COLMAP model: by the floor in view, and how high the camera was held."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float32

from roomlight.errors import CaptureError
from roomlight.frame import Frame
from roomlight.monocular.estimate import srgb_picture
from roomlight.monocular.floor import FloorFit, camera_height, floor_scale
from roomlight.monocular.network import shipped_depth
from roomlight.monocular.stream import SIZE, corrected
from roomlight.monocular.tracks import Samples, View, grey_picture, triangulated

_NEAR: Final = 4
"""Views that features are followed to."""
_AHEAD: Final = float(np.cos(np.radians(45)))
_LEAST_FEATURES: Final = 12.0
"""Weight of the features that tell the unit of poses."""


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
