"""Probe positions: points in the first frame's view where an application might put a virtual object.

World frame: y up, metres; poses camera-to-world, OpenGL axes; depth is z-depth.
"""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float

from roomlight.camera import Intrinsics, transform_points
from roomlight_generator.sequences.walk import FreeSpace

PROBE_CLEARANCE_M: Final = 0.12
"""Least distance of a probe to any surface: a mug has room there."""
DISTANCE_M: Final = (0.5, 4.5)
"""Least and largest distance of a probe to the camera: within the range of a phone's depth sensor."""
APART_M: Final = 0.4
"""Least distance between probes, where the view allows it."""
LIFT_M: Final = (0.13, 0.6)
"""Height above a floor, table or seat of probes for an object on it."""

_CANDIDATES: Final = 160
_RESTING_SHARE: Final = 0.75
"""Share of the candidates that are lifted from level surfaces."""
_RESTING_WEIGHT: Final = 4.0
"""Weight of a point close above a surface; a point in mid-air has 1."""
_DOWN: Final = np.array([[0.0, -1.0, 0.0]], np.float32)
_MARGIN: Final = 0.06
"""Share of the image's width and height that is left free at its edges."""
_LEVEL: Final = 0.85
"""Least vertical component of the normal of a surface on which an object can stand."""
_CHOICES: Final = 48
"""Random choices of probes that are compared."""


def place_probes(
    free: FreeSpace,
    rng: np.random.Generator,
    *,
    intrinsics: Intrinsics,
    camera_to_world: Float[np.ndarray, "4 4"],
    depth_m: Float[np.ndarray, "h w"],
    count: int = 3,
) -> Float[np.ndarray, "{count} 3"] | None:
    """Choose points in the first frame's view, clear of surfaces and seen by its camera.

    Most points are above visible level surfaces, the rest in mid-air in front of visible surfaces. They are spread over
    distance and over the picture.

    Camera, pose and exact depth (0: nothing hit, at any size of the same view) are those of the first frame.

    Returns:
        The points (world, metres), or None if there are too few.
    """
    camera = intrinsics.resized(depth_m.shape[1], depth_m.shape[0])
    candidates = _candidates(rng, camera, camera_to_world, depth_m)
    candidates = candidates[_in_view(candidates, camera, camera_to_world, depth_m)]
    candidates = candidates[_in_sight(free, candidates, camera_to_world)]
    candidates = candidates[free.clear(candidates, PROBE_CLEARANCE_M)]
    if len(candidates) < count:
        return None
    below_m = free.distances(candidates.astype(np.float32), np.tile(_DOWN, (len(candidates), 1)))
    weight = np.where(below_m <= LIFT_M[1] + 0.02, _RESTING_WEIGHT, 1.0)
    return _spread(rng, candidates, camera, camera_to_world, weight / weight.sum(), count)


def _candidates(
    rng: np.random.Generator,
    camera: Intrinsics,
    camera_to_world: Float[np.ndarray, "4 4"],
    depth_m: Float[np.ndarray, "h w"],
) -> Float[np.ndarray, "n 3"]:
    """Draw points lifted from visible level surfaces, and points between the camera and any visible surface."""
    height, width = depth_m.shape
    points = transform_points(camera_to_world, (camera.rays() * depth_m[..., None]).astype(np.float64))
    resting = int(_CANDIDATES * _RESTING_SHARE)
    level = np.flatnonzero(_level(points, depth_m))
    parts: list[np.ndarray] = []
    if len(level):
        # A layer that covers little of the picture is likelier: a table rather than the floor around it.
        altitude = points[..., 1].ravel()[level]
        layer = np.rint((altitude - altitude.min()) / 0.1).astype(np.int64)
        weight = 1 / np.sqrt(np.bincount(layer)[layer])
        base = points.reshape(-1, 3)[rng.choice(level, resting, p=weight / weight.sum())]
        lift = LIFT_M[0] + (LIFT_M[1] - LIFT_M[0]) * rng.random(resting) ** 1.5
        parts.append(base + lift[:, None] * [0.0, 1.0, 0.0])
    in_mid_air = _CANDIDATES - sum(len(part) for part in parts)
    pixel = rng.integers(height * width, size=in_mid_air)
    surface_m = depth_m.ravel()[pixel]
    surface_m = np.where(surface_m > 0, surface_m, DISTANCE_M[1])
    depth = np.minimum(surface_m, DISTANCE_M[1]) * rng.uniform(0.3, 0.92, in_mid_air)
    parts.append(transform_points(camera_to_world, camera.rays().reshape(-1, 3)[pixel] * depth[:, None]))
    return np.concatenate(parts)


def _level(points: Float[np.ndarray, "h w 3"], depth_m: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Return the pixels of floors, seats and table tops: known depth, upward normal, no step in depth beside them."""
    right = np.roll(points, -1, axis=1) - np.roll(points, 1, axis=1)
    down = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    normal = np.cross(down, right)
    length = np.linalg.norm(normal, axis=-1)
    known = cv2.erode((depth_m > 0).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    flat = np.abs(right[..., 1]) + np.abs(down[..., 1]) < 0.03
    level = known & flat & (length > 1e-12) & (normal[..., 1] > _LEVEL * length)
    level[[0, -1]] = False
    level[:, [0, -1]] = False
    return level


def _in_view(
    points: Float[np.ndarray, "n 3"],
    camera: Intrinsics,
    camera_to_world: Float[np.ndarray, "4 4"],
    depth_m: Float[np.ndarray, "h w"],
) -> Bool[np.ndarray, " n"]:
    """Return which points are inside the picture, within `DISTANCE_M`, and nearer than the surface shown there."""
    local = (points - camera_to_world[:3, 3]) @ camera_to_world[:3, :3]
    distance = np.linalg.norm(local, axis=1)
    fits = (distance >= DISTANCE_M[0]) & (distance <= DISTANCE_M[1]) & (local[:, 2] < 0)
    xy, depth = camera.project(local)
    size = np.array([camera.width, camera.height])
    with np.errstate(invalid="ignore"):
        fits &= ((xy >= _MARGIN * size) & (xy < (1 - _MARGIN) * size)).all(axis=1)
    column, row = np.where(fits, xy.T, 0).astype(np.int64)
    surface = depth_m[row, column]
    return fits & ((surface == 0) | (depth < surface - 0.02))


def _in_sight(
    free: FreeSpace, points: Float[np.ndarray, "n 3"], camera_to_world: Float[np.ndarray, "4 4"]
) -> Bool[np.ndarray, " n"]:
    """Return which points no surface hides from the camera, not even a pane of glass."""
    if len(points) == 0:
        return np.zeros(0, bool)
    away = points - camera_to_world[:3, 3]
    distance = np.linalg.norm(away, axis=1)
    eyes = np.tile(camera_to_world[:3, 3], (len(points), 1)).astype(np.float32)
    reach = free.distances(eyes, (away / distance[:, None]).astype(np.float32))
    return np.asarray(reach > distance + PROBE_CLEARANCE_M / 2)


def _spread(
    rng: np.random.Generator,
    points: Float[np.ndarray, "n 3"],
    camera: Intrinsics,
    camera_to_world: Float[np.ndarray, "4 4"],
    chance: Float[np.ndarray, " n"],
    count: int,
) -> Float[np.ndarray, "{count} 3"]:
    """Return the random choice of points that are farthest apart in space, on the picture and in distance."""
    local = (points - camera_to_world[:3, 3]) @ camera_to_world[:3, :3]
    xy, _ = camera.project(local)
    place = np.concatenate(
        [xy / [camera.width, camera.height], 0.5 * np.log2(np.linalg.norm(local, axis=1))[:, None]], axis=1
    )
    best, best_score = np.arange(count), -np.inf
    for _ in range(_CHOICES):
        chosen = rng.choice(len(points), count, replace=False, p=chance)
        first, second = np.triu_indices(count, 1)
        apart = np.linalg.norm(points[chosen[first]] - points[chosen[second]], axis=1)
        spread = np.linalg.norm(place[chosen[first]] - place[chosen[second]], axis=1)
        score = np.minimum(apart / APART_M, 1).min(initial=1) * 4 + np.minimum(spread, 0.45).sum()
        if score > best_score:
            best, best_score = chosen, float(score)
    return points[best]
