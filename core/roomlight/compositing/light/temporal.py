"""Stability over time: depth, shadows and light are eased into their new state.

Each follows its input with a time constant: after it, 63 % of a change has happened. Depth and shadows of the frame
before are reprojected into the new view first; where that view shows something else, the new value is taken at once.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from roomlight.camera import Intrinsics, rigid_inverse
from roomlight.compositing.kernels.reproject import accumulate_image, splat_depth
from roomlight.compositing.kernels.shadows import SurfaceGrid
from roomlight.compositing.light.lighting import LightSampler
from roomlight.compositing.picture.crop import CropCamera
from roomlight.conventions import Position
from roomlight.frame import Frame
from roomlight.imaging.rates import DEFAULT_RATE
from roomlight.threads import parallel_for

LIGHT_S: Final = 0.4
"""Time constant of light: slow enough that a newly seen lamp fades in, faster than a viewer waits."""
DEPTH_S: Final = 0.12
"""Time constant of depth: averages the noise of 4 frames at 30 a second."""
SHADOW_S: Final = 0.08
"""Time constant of shadows: in a preview a moving object's shadow lags by less than 3 frames."""
SAME_SURFACE: Final = 0.04
"""Largest relative change of depth that counts as noise; beyond it the new depth is another surface."""
SAME_ESTIMATED: Final = 0.3
"""The same for estimated depth, which is wrong by another factor in each frame. With it, and real things in front only
where two frames show them, the visible share of objects in a Kinect's film differs from the median of five frames by
0.017 instead of 0.041 (by its depth 0.005); 108 placements in 12 captures: 0.009 instead of 0.011."""
MAX_HELD: Final = 10
"""Frames that depth is held for where the sensor stops giving it."""
MAX_DEPTH_WIDTH: Final = 320
_LONG_AGO: Final = 0.99
"""Share of a change, 0.6 s later, from which on the frame before tells nothing of this one."""
_AROUND: Final = 4
"""Known neighbours, of 8, of a pixel that is a gap of reprojection; elsewhere nothing was seen."""


def share_of(elapsed_s: float, constant_s: float) -> float:
    """Return the share of a change that happens in a time: 1 - exp(-elapsed / constant)."""
    return 1.0 - float(np.exp(-max(elapsed_s, 0.0) / constant_s))


@dataclass(frozen=True)
class Moment:
    """What is kept of a frame to tell how much later another one is."""

    timestamp_s: float | None
    index: int


def elapsed_since(first: Moment | Frame, frame: Frame) -> float:
    """Return the seconds between two frames: by timestamps, else 1/30 s an index."""
    if first.timestamp_s is not None and frame.timestamp_s is not None:
        return frame.timestamp_s - first.timestamp_s
    return (frame.index - first.index) / DEFAULT_RATE


def elapsed_s(before: Moment | Frame, frame: Frame) -> float:
    """Return `elapsed_since`, at most 1 and at least 0."""
    return float(np.clip(elapsed_since(before, frame), 0.0, 1.0))


@dataclass(frozen=True)
class _AgedDepth:
    """Depth of a frame in metres, and for how many frames each pixel was not measured."""

    frame: Frame
    depth: Float32[np.ndarray, "h w"]
    age: Float32[np.ndarray, "h w"]

    def seen_by(
        self, frame: Frame, shape: tuple[int, ...]
    ) -> tuple[Float32[np.ndarray, "sh sw"], Float32[np.ndarray, "sh sw"]]:
        """Return depth and age as the camera of a later frame sees them."""
        pose, later = self.frame.camera_to_world, frame.camera_to_world
        lens, new_lens = _lens(self.frame.intrinsics, self.depth.shape), _lens(frame.intrinsics, shape)
        if np.array_equal(pose, later) and np.array_equal(lens, new_lens) and shape == self.depth.shape:
            return self.depth, self.age
        transform = (rigid_inverse(later) @ pose)[:3].astype(np.float32)
        depth, age = np.zeros((2, *shape), np.float32)
        splat_depth(self.depth, self.age, lens, transform, new_lens, depth, age)
        return depth, age


class DepthFilter:
    """Depth of the real scene, averaged over the frames that agree."""

    def __init__(self) -> None:
        """Begin without depth."""
        self._before: _AgedDepth | None = None

    def push(self, frame: Frame, *, max_width: int = MAX_DEPTH_WIDTH) -> Float32[np.ndarray, "h w"]:
        """Return the frame's depth, averaged with what was known; wider maps are reduced to `max_width` columns.

        Estimated depth is nowhere nearer than in the frame before: single frames tear holes into objects.
        """
        depth = reduced(frame.depth_m, max_width)
        near = SAME_ESTIMATED if frame.depth_estimated else SAME_SURFACE
        previous, age, share = np.zeros_like(depth), np.zeros_like(depth), np.float32(1)
        if self._before is not None:
            previous, previous_age = self._before.seen_by(frame, depth.shape)
            share = np.float32(share_of(elapsed_s(self._before.frame, frame), DEPTH_S))
            same = (depth > 0) & (previous > 0) & (np.abs(previous - depth) < near * depth)
            gone = (depth <= 0) & (previous > 0) & (previous_age < MAX_HELD)
            age[gone] = previous_age[gone] + 1
            blended = previous + share * (depth - previous)
            depth = np.where(same, blended, np.where(gone, previous, depth)).astype(np.float32)
        self._before = _AgedDepth(frame, depth, age)
        if frame.depth_estimated and share < _LONG_AGO:
            return np.maximum(depth, without_gaps(previous))
        return depth


def without_gaps(depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Return reprojected depth with the gaps between its pixels filled by the nearest of those around them."""
    gap, box = depth <= 0, np.ones((3, 3), np.uint8)
    inside = cv2.boxFilter((~gap).astype(np.float32), -1, (3, 3), normalize=False) >= _AROUND
    nearest = cv2.erode(np.where(gap, np.float32(np.inf), depth), box)
    return np.where(gap & inside, nearest, depth).astype(np.float32)


@dataclass(frozen=True)
class _Shadow:
    ratio: Float32[np.ndarray, "h w 4"]
    known: Bool[np.ndarray, "h w"]
    lens: Float32[np.ndarray, "4"]
    world_to_camera: Float32[np.ndarray, "3 4"]


class ShadowHistory:
    """The shadow image of the frame before, to average the new one with."""

    def __init__(self) -> None:
        """Begin without an image."""
        self._before: _Shadow | None = None

    def blend(
        self,
        ratio: Float32[np.ndarray, "h w 3"],
        grid: SurfaceGrid,
        depth_m: Float32[np.ndarray, "h w"],
        camera: CropCamera,
        camera_to_world: Float[np.ndarray, "4 4"],
        *,
        share: float,
    ) -> Float32[np.ndarray, "h w 3"]:
        """Return the image moved from the reprojected one before toward `ratio` by a share of 0 to 1.

        The history is clamped to the range of each pixel's neighbours, so that the shadow of a moving object leaves no
        trail.
        """
        out = ratio.copy()
        if self._before is not None and share < 1:
            before = self._before
            view = before.world_to_camera, before.lens
            arguments = (out, ratio, grid.known, grid.points, *view, before.ratio, before.known)
            limits = np.float32(share), np.float32(0.01)
            parallel_for(lambda start, stop: accumulate_image(*arguments, *limits, start, stop), len(out))
        self._before = _Shadow(
            np.concatenate([out, depth_m[..., None]], axis=-1),
            grid.known,
            np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32),
            rigid_inverse(camera_to_world)[:3].astype(np.float32),
        )
        return out


class EasedLight:
    """The light at one position, which follows the session's."""

    def __init__(self, position: Position, panorama: Float[np.ndarray, "h w 3"]) -> None:
        """Begin at the first panorama."""
        self.position = position
        self.sampler = LightSampler(panorama, position)
        self._target = self.sampler.panorama

    def aim(self, panorama: Float[np.ndarray, "h w 3"]) -> None:
        """Set the panorama that is followed."""
        if panorama.shape != self._target.shape:
            self.sampler = LightSampler(panorama, self.position)
        self._target = np.maximum(np.ascontiguousarray(panorama, np.float32), 0)

    def advance(self, elapsed: float) -> bool:
        """Move toward the target for a time in seconds; return whether the light changed by more than 0.1 %."""
        present = self.sampler.panorama
        change = np.abs(self._target - present).mean()
        if change < 1e-3 * max(float(present.mean()), 1e-6):
            return False
        share = np.float32(share_of(elapsed, LIGHT_S))
        if share <= 0:
            return False
        self.sampler = LightSampler(present + share * (self._target - present), self.position)
        return True


def reduced(depth_m: Float[np.ndarray, "h w"], max_width: int) -> Float32[np.ndarray, "h2 w2"]:
    """Take every n-th sample, so that at most `max_width` columns are left."""
    step = -(-depth_m.shape[1] // max_width)
    if step == 1:
        return depth_m.astype(np.float32)
    size = max(2, depth_m.shape[1] // step), max(2, depth_m.shape[0] // step)
    return cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST_EXACT).astype(np.float32)


def _lens(camera: Intrinsics, shape: tuple[int, ...]) -> Float32[np.ndarray, "4"]:
    scale_x, scale_y = shape[1] / camera.width, shape[0] / camera.height
    return np.array([camera.fx * scale_x, camera.fy * scale_y, camera.cx * scale_x, camera.cy * scale_y], np.float32)
