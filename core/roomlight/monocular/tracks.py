"""Features that two frames see, and their depth by triangulation with known poses.

Poses are camera-to-world, OpenGL axes; pixel coordinates have centres at half integers.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from roomlight.camera import Intrinsics

STEP: Final = 12
"""Pixels between two points of the depth that views carry to each other."""
_FEATURES: Final = 400
_LEAST_PARALLAX: Final = np.radians(0.4)
_ERROR_PX: Final = 0.5
"""Deviation of a feature's place."""
_SHAPE_ERROR: Final = 0.1
"""Deviation of a network's depth around its scale: features that are known better than this weigh the same."""
_MOST_REPROJECTION_PX: Final = 1.5
_ROUND_TRIP_PX: Final = 1.0
_FITTING: Final = 0.4
"""Where fewer of the features lie on their epipolar lines, poses or lens do not fit the pictures: 0.92 to 0.99 do in
rendered rooms, 0.8 in 7-Scenes, whose colour and depth cameras are not registered."""
_BASELINE: Final = 0.1
"""Best distance between two cameras, of the distance to what they see: farther apart, features look different."""
_MOST_TURN: Final = np.radians(45)


@dataclass(frozen=True, eq=False)
class View:
    """A frame as features are followed in it.

    Attributes:
        grey: 8-bit picture.
        intrinsics: Its lens.
        camera_to_world: Its pose.
        inverse: Its fitted 1 / depth at every `STEP`-th pixel (`grid_of`), 0 = unknown.
    """

    grey: UInt8[np.ndarray, "h w"]
    intrinsics: Intrinsics
    camera_to_world: Float[np.ndarray, "4 4"]
    inverse: Float[np.ndarray, "gh gw"]

    @cached_property
    def corners(self) -> Float[np.ndarray, "n 1 2"]:
        """Pixels that can be followed to other views (OpenCV's: centres at whole numbers)."""
        corners = cv2.goodFeaturesToTrack(self.grey, _FEATURES, 0.005, 5)
        return np.zeros((0, 1, 2), np.float32) if np.size(corners) < 2 else corners  # OpenCV returns None for none


@dataclass(frozen=True, eq=False)
class Samples:
    """Known inverse depth at pixels of a frame.

    Attributes:
        pixels: (column, row).
        inverse: 1 / z-depth, per metre.
        weight: How well it is known.
    """

    pixels: Float[np.ndarray, "n 2"]
    inverse: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]

    def scaled(self, factor: float) -> "Samples":
        """Return the samples with inverse depth in another unit."""
        return replace(self, inverse=factor * self.inverse)

    @classmethod
    def joined(cls, parts: list["Samples"]) -> "Samples":
        """Put samples together."""
        empty = cls(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
        columns = ([getattr(part, name) for part in (empty, *parts)] for name in ("pixels", "inverse", "weight"))
        return cls(*(np.concatenate(column) for column in columns))


def places_of(
    samples: Samples, plane: Shaped[np.ndarray, "h w"]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return the rows and columns of samples in a plane of the picture's size."""
    columns, rows = np.floor(samples.pixels).astype(int).T
    return rows.clip(0, plane.shape[0] - 1), columns.clip(0, plane.shape[1] - 1)


def triangulated(view: View, earlier: View, guess: Float[np.ndarray, "h w"]) -> Samples:
    """Follow features from a view to an earlier one and back, and triangulate them (midpoint of two rays).

    Features without parallax, behind a camera, or off their epipolar line are left out; if many are off, all are.

    `guess` is about 1 / depth of the view: where a feature is looked for.
    """
    start = view.corners
    if len(start) == 0 or view.grey.shape != earlier.grey.shape:
        return Samples.joined([])
    expected = _expected(view, earlier, start, guess)
    inside = ((expected > 2) & (expected < np.array(view.grey.shape[::-1]) - 2)).all(axis=(1, 2))
    start, expected = start[inside], expected[inside]
    if len(start) == 0:
        return Samples.joined([])
    moved, there = _followed(view, earlier, start, expected)
    back, again = _followed(earlier, view, moved, start)
    near = np.linalg.norm(back - start, axis=2)[:, 0] < _ROUND_TRIP_PX
    kept = there & again & near
    first, second = start[kept, 0] + 0.5, moved[kept, 0] + 0.5  # OpenCV's pixel centres are whole numbers
    points, angle = _meeting_points(view, first, earlier, second)
    depth, good = np.zeros(len(points)), angle > _LEAST_PARALLAX
    turned = int(good.sum())
    for camera, pixels in ((view, first), (earlier, second)):
        local = (points - camera.camera_to_world[:3, 3]) @ camera.camera_to_world[:3, :3]
        seen, far = camera.intrinsics.project(local)
        good &= (far > 0.05) & (np.linalg.norm(np.nan_to_num(seen, nan=1e9) - pixels, axis=1) < _MOST_REPROJECTION_PX)
        depth = far if camera is view else depth
    if int(good.sum()) < _FITTING * turned:
        return Samples.joined([])
    error = _ERROR_PX / (np.sqrt(view.intrinsics.fx * view.intrinsics.fy) * np.maximum(angle, 1e-6))
    weight = 1 / (1 + (error / _SHAPE_ERROR) ** 2)
    return Samples(first[good].astype(np.float64), 1 / depth[good], weight[good])


def partners(view: View, others: Sequence[View], middle_m: float, count: int) -> list[View]:
    """Return the views that show most of a view's depth by parallax, the nearest first; none that hardly moved.

    Args:
        others: Earlier views.
        middle_m: Distance to what the view shows.
        count: How many at most.
    """
    good: list[tuple[float, float, int]] = []
    for number, other in enumerate(others):
        moved = float(np.linalg.norm(other.camera_to_world[:3, 3] - view.camera_to_world[:3, 3])) / middle_m
        turn = np.arccos(np.clip(other.camera_to_world[:3, 2] @ view.camera_to_world[:3, 2], -1, 1))
        if moved > _BASELINE / 20 and turn < _MOST_TURN:
            good.append((float(abs(np.log(moved / _BASELINE)) - np.log(1 - turn / _MOST_TURN)), moved, number))
    return [others[number] for _, _, number in sorted(sorted(good)[:count], key=lambda entry: entry[1])]


def _expected(
    view: View, earlier: View, start: Float[np.ndarray, "n 1 2"], guess: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "n 1 2"]:
    """Return where features should be in the earlier view; NaN behind it."""
    columns, rows = start[:, 0].astype(int).T
    k = view.intrinsics
    far = 1 / guess[rows, columns].astype(np.float64)
    x, y = (start[:, 0, 0] + 0.5 - k.cx) / k.fx, -(start[:, 0, 1] + 0.5 - k.cy) / k.fy
    world = np.stack([x * far, y * far, -far], axis=1) @ view.camera_to_world[:3, :3].T + view.camera_to_world[:3, 3]
    pixels, _ = earlier.intrinsics.project((world - earlier.camera_to_world[:3, 3]) @ earlier.camera_to_world[:3, :3])
    return (pixels - 0.5).astype(np.float32)[:, None]


def _followed(
    view: View, other: View, start: Float[np.ndarray, "n 1 2"], expected: Float[np.ndarray, "n 1 2"]
) -> tuple[Float[np.ndarray, "n 1 2"], Bool[np.ndarray, " n"]]:
    """Follow features to another view from where they are expected; returns their places, and which were followed."""
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        view.grey, other.grey, start, expected.copy(), winSize=(15, 15), maxLevel=3, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    return moved, status[:, 0] > 0


def grid_of(plane: Shaped[np.ndarray, "h w *c"]) -> Shaped[np.ndarray, "gh gw *c"]:
    """Return every `STEP`-th pixel of a plane."""
    return plane[STEP // 2 :: STEP, STEP // 2 :: STEP]


def carried(view: View, earlier: View, factor: float = 1.0) -> Samples:
    """Return the depth of an earlier view as this view sees it, on a grid, where the earlier view is not behind.

    Its 1 / depth, and that of the samples, times `factor` is per metre.
    """
    rays = grid_of(earlier.intrinsics.rays()).reshape(-1, 3).astype(np.float64)
    inverse = factor * earlier.inverse.ravel()
    known = inverse > 0
    local = rays[known] / inverse[known, None]
    world = local @ earlier.camera_to_world[:3, :3].T + earlier.camera_to_world[:3, 3]
    pixels, depth = view.intrinsics.project((world - view.camera_to_world[:3, 3]) @ view.camera_to_world[:3, :3])
    rows, columns = view.grey.shape
    inside = depth > 0.05
    inside &= (np.nan_to_num(pixels, nan=-1) >= 0).all(axis=1) & (np.nan_to_num(pixels, nan=1e9) < (columns, rows)).all(
        axis=1
    )
    return Samples(pixels[inside], 1 / (factor * depth[inside]), np.full(int(inside.sum()), 0.3))


def _meeting_points(
    view: View, first: Float[np.ndarray, "n 2"], earlier: View, second: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Return the points nearest to both rays of each feature, and the angles between the rays (radians)."""
    ahead, other = _world_rays(view, first), _world_rays(earlier, second)
    apart = earlier.camera_to_world[:3, 3] - view.camera_to_world[:3, 3]
    cosine = (ahead * other).sum(axis=1)
    sine2 = np.maximum(1 - cosine**2, 1e-12)
    along = (ahead @ apart - cosine * (other @ apart)) / sine2
    back = (cosine * (ahead @ apart) - other @ apart) / sine2
    here = view.camera_to_world[:3, 3] + along[:, None] * ahead
    there = earlier.camera_to_world[:3, 3] + back[:, None] * other
    return (here + there) / 2, np.arcsin(np.sqrt(np.minimum(sine2, 1)))


def _world_rays(view: View, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    k = view.intrinsics
    rays = np.stack([(pixels[:, 0] - k.cx) / k.fx, -(pixels[:, 1] - k.cy) / k.fy, -np.ones(len(pixels))], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return rays @ view.camera_to_world[:3, :3].T


def grey_picture(picture: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """Return an sRGB picture in [0, 1] as 8-bit grey."""
    return np.rint(np.clip(picture @ np.array([0.3, 0.6, 0.1], np.float32), 0, 1) * 255).astype(np.uint8)


def far_apart(view: View, other: View) -> bool:
    """Return whether two cameras see a room differently enough to keep both."""
    step = np.linalg.norm(view.camera_to_world[:3, 3] - other.camera_to_world[:3, 3])
    cosine = (np.trace(view.camera_to_world[:3, :3].T @ other.camera_to_world[:3, :3]) - 1) / 2
    return bool(step > 0.15 or cosine < np.cos(np.radians(12)))
