"""Camera walks: two bodies under random forces, the camera and the point at which it looks.

The paper's two-body motion (section "Dataset creation", after McCormac et al. 2017 and Li et al. 2018): both bodies
are pushed at random, slowed by drag and kept from walls. Here the camera stays at the height of a hand and over the
walkable floor, and a spring keeps the target a leash's length before it, so that the view neither spins nor dives.

World frame: y up, metres, the floor at y = 0; poses camera-to-world, OpenGL axes; one frame every third of a second.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.camera import Intrinsics
from roomlight_generator.rooms.shapes import sphere_directions

FRAME_INTERVAL_S: Final = 1 / 3
"""Every tenth frame of a 30 Hz recording; the paper samples 30 of some ten seconds."""
HEIGHT_M: Final = (0.9, 1.75)
"""Lowest and highest camera: before a sitting person and before a tall standing person."""
CLEARANCE_M: Final = 0.25
"""Least distance of the camera to any surface."""
FIELD_OF_VIEW_DEGREES: Final = (55.0, 72.0)
"""Across the long side of a 4:3 frame: phones' main cameras, cropped for stabilisation or not (one iPhone: 69)."""

Angles = float | Float[np.ndarray, "*n"]

_SUBSTEPS: Final = 10
_CANDIDATES: Final = 24
"""Walks simulated together: 24 take no longer than one (17 to 20 ms), because the time is that of NumPy's calls."""
_ROUNDS: Final = 8
_EDGE_M: Final = 0.25
"""The camera is pushed back this near to the edge of the walkable floor."""
_PITCH_LIMITS: Final = (-50.0, 35.0)
_NEAR_M: Final = 0.7
_NEAR_SHARE: Final = 0.4
"""Largest share of a view that may be nearer than _NEAR_M: a closer view does not show the room."""
_FIRST_MEDIAN_M: Final = (1.7, 1.2)
"""Least median depth of the first view; the second for rooms in which no walk begins that far from surfaces."""
_FARTHEST_WEIGHT_M: Final = 3.0
"""First views with a farther view are likelier up to this distance, and no more beyond it.

With 6 m and the distance cubed, views down the room were so frequent that a window or a lamp was in seven of eight of
them; in a quarter of the views of real panoramas hardly anything clips (`stats --against`)."""
_MEAN_STEP_M: Final = 0.105
_MEAN_TURN_DEGREES: Final = 5.06
"""Mean motion drawn for ordinary walks.

With nearly still walks mixed in, and slowed by walls, walks then average the paper's motion: 0.0887 m and 4.73 degrees
a frame in 720 walks through 90 furnished rooms.
"""


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Space for a camera: the walkable floor, and the distances to surfaces.

    Attributes:
        walkable: [row, column] is a square of cell_m metres around origin + cell_m (column, row): the planner's free
            floor, best for a body of radius CLEARANCE_M.
        origin: (x, z), world.
        distances: Takes origins [n, 3] and unit directions [n, 3] (float32); returns metres to the first surface, inf
            for none.
    """

    walkable: Bool[np.ndarray, "nz nx"]
    origin: tuple[float, float]
    cell_m: float
    distances: Callable[[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]], Float[np.ndarray, " n"]]

    def walkable_at(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return which points are above walkable floor."""
        cell = self.cells(points)
        inside = ((cell >= 0) & (cell < self.walkable.shape)).all(axis=1)
        row, column = np.where(inside, cell.T, 0)
        return inside & self.walkable[row, column]

    def cells(self, points: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, "n 2"]:
        """Return row and column of the squares under points; they may lie outside of the grid."""
        plan = points[:, [2, 0]] - np.asarray(self.origin)[::-1]
        return np.rint(plan / self.cell_m).astype(np.int64)

    def clear(self, points: Float[np.ndarray, "n 3"], clearance_m: float, rays: int = 256) -> Bool[np.ndarray, " n"]:
        """Return which points have no surface within clearance_m, by rays from each to all sides.

        One of 256 rays passes within 9.5 degrees of any direction: they meet whatever is wider than a third of the
        clearance.
        """
        fan = sphere_directions(rays)
        origins = np.repeat(points.astype(np.float32), rays, axis=0)
        distances = self.distances(origins, np.tile(fan, (len(points), 1))).reshape(-1, rays)
        return np.asarray(distances.min(axis=1) >= clearance_m)


@dataclass(frozen=True)
class _WalkParameters:
    """Parameters of a walk: mean motion a frame, the bodies' drag, and the hand that carries the camera.

    Attributes:
        follow: Share of the camera's velocity that the target takes over.
        leash_m: Distance of the target.
        tremor_m, tremor_degrees: Deviations of the hand.
    """

    step_m: float
    turn_degrees: float
    camera_drag_s: float
    target_drag_s: float
    follow: float
    height_m: float
    pitch_degrees: float
    leash_m: float
    roll_degrees: float
    tremor_m: float
    tremor_degrees: float


def motion(
    camera_to_world: Float[np.ndarray, "f 4 4"],
) -> tuple[Float[np.ndarray, " steps"], Float[np.ndarray, " steps"]]:
    """Compute distances of consecutive positions (metres) and geodesic angles of consecutive rotations (degrees)."""
    poses = np.asarray(camera_to_world, np.float64)
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    chords = np.linalg.norm(np.diff(poses[:, :3, :3], axis=0), axis=(1, 2))  # 2 sqrt(2) sin(angle / 2)
    angles = 2 * np.arcsin(np.clip(chords / np.sqrt(8), 0, 1))
    return steps, np.degrees(angles)


def phone_intrinsics(rng: np.random.Generator, width: int = 320, height: int = 240) -> Intrinsics:
    """Draw a phone's main camera: square pixels, the principal point off the middle by about 1 % (at most 2 %)."""
    focal = width / 2 / np.tan(np.radians(rng.uniform(*FIELD_OF_VIEW_DEGREES)) / 2)
    off = np.clip(rng.normal(0, 0.008, 2), -0.02, 0.02)
    return Intrinsics(
        fx=float(focal),
        fy=float(focal),
        cx=float(width * (0.5 + off[0])),
        cy=float(height * (0.5 + off[1])),
        width=width,
        height=height,
    )


def camera_walk(
    free: FreeSpace, rng: np.random.Generator, *, intrinsics: Intrinsics, frames: int
) -> Float[np.ndarray, "{frames} 4 4"] | None:
    """Draw camera-to-world poses of a hand-held walk; None if the room has no place for a walk.

    The walk's speed and rotation are drawn first, from nearly still to sweeping. Walks are then simulated from random
    places; of the acceptable walks (each pose keeps `CLEARANCE_M`, views show the room) the nearest to the drawn
    motion is taken. So narrow rooms and rejected walks do not make the data slower than intended.
    """
    field = _EdgeDistance(free)
    if field.starts.size == 0:
        return None
    step_m, turn_degrees = _draw_motion(rng)
    for attempt in range(_ROUNDS):
        if attempt == _ROUNDS // 2:  # no place for this motion: try a slower motion
            step_m, turn_degrees = 0.3 * step_m, min(turn_degrees, 4.0)
        parameters = _draw_parameters(rng, step_m, turn_degrees)
        position, target = _simulate(free, field, parameters, rng, frames)
        walks = [_poses(p, t, parameters, rng) for p, t in zip(position, target, strict=True)]
        for walk in sorted(walks, key=lambda walk: _distance_from(parameters, walk)):
            if _acceptable(free, walk, intrinsics, _FIRST_MEDIAN_M[attempt > 1]):
                return walk
    return None


class _EdgeDistance:
    """Distance to the edge of the walkable floor, on the floor's grid, and its slope."""

    def __init__(self, free: FreeSpace) -> None:
        padded = np.pad(free.walkable.astype(np.uint8), 1)
        distance_m = np.maximum(cv2.distanceTransform(padded, cv2.DIST_L2, 5) - 0.5, 0) * free.cell_m
        along_z, along_x = np.gradient(distance_m, free.cell_m)
        slope = np.stack([np.asarray(along_x), np.asarray(along_z)], axis=-1)
        self.free = free
        self.metres, self.slope = distance_m[1:-1, 1:-1], slope[1:-1, 1:-1]
        self.starts = np.argwhere(free.walkable & (self.metres >= min(0.15, 0.7 * float(self.metres.max(initial=0)))))

    def at(self, points: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
        """Return distance and slope (x, z) at points; outside of the grid those of the nearest square."""
        row, column = np.clip(self.free.cells(points), 0, np.array(self.metres.shape) - 1).T
        return self.metres[row, column], self.slope[row, column]


def _draw_motion(rng: np.random.Generator) -> tuple[float, float]:
    """Draw a walk's mean metres and degrees a frame: log-normal, some walks rotate on the spot, some hardly rotate."""
    step = float(np.exp(rng.normal(-0.5 * 0.5**2, 0.5))) * _MEAN_STEP_M
    turn = float(np.exp(rng.normal(-0.5 * 0.45**2, 0.45))) * _MEAN_TURN_DEGREES
    kind = rng.random()
    if kind < 0.12:
        step = rng.uniform(0.0, 0.025)
    elif kind < 0.18:
        turn = rng.uniform(0.5, 1.8)
    return float(np.clip(step, 0, 0.25)), float(np.clip(turn, 0.4, 13))


def _draw_parameters(rng: np.random.Generator, step_m: float, turn_degrees: float) -> _WalkParameters:
    pitch = rng.uniform(2, 20) if rng.random() < 0.08 else np.clip(rng.normal(-15, 8), -36, 4)
    height = rng.uniform(0.92, 1.2) if rng.random() < 0.2 else np.clip(rng.normal(1.45, 0.13), 1.1, 1.7)
    return _WalkParameters(
        step_m=step_m,
        turn_degrees=turn_degrees,
        camera_drag_s=rng.uniform(0.8, 2.5),
        target_drag_s=rng.uniform(0.6, 3.0),
        follow=rng.uniform(0.2, 1.0),
        height_m=float(height),
        pitch_degrees=float(pitch),
        leash_m=rng.uniform(1.4, 3.0),
        roll_degrees=float(rng.normal(0, 1.2)),
        tremor_m=rng.uniform(0.0003, 0.002),
        tremor_degrees=rng.uniform(0.03, 0.3),
    )


def _simulate(
    free: FreeSpace, field: _EdgeDistance, parameters: _WalkParameters, rng: np.random.Generator, frames: int
) -> tuple[Float[np.ndarray, "b {frames} 3"], Float[np.ndarray, "b {frames} 3"]]:
    """Simulate positions of the camera and of its target (the point looked at), for several walks at once.

    Each body's velocity is an Ornstein-Uhlenbeck process (random force against drag) plus springs: walls push the
    camera away, a spring holds its height; another keeps the target a leash's length before the camera, at the height
    of the preferred pitch; `follow` is the share of the camera's velocity that the target takes over.
    """
    count, dt = _CANDIDATES, FRAME_INTERVAL_S / _SUBSTEPS
    place = field.starts[rng.integers(len(field.starts), size=count)]
    jitter = rng.uniform(-0.4, 0.4, (count, 2))
    plan = np.asarray(free.origin) + (place[:, ::-1] + jitter) * free.cell_m
    height = np.clip(parameters.height_m + rng.normal(0, 0.04, count), *HEIGHT_M)
    camera = np.stack([plan[:, 0], height, plan[:, 1]], axis=1)
    azimuth = _first_azimuths(free, camera, rng)
    ahead = np.stack([np.cos(azimuth), np.zeros(count), np.sin(azimuth)], axis=1)
    rise = parameters.leash_m * np.tan(np.radians(parameters.pitch_degrees))
    target = camera + parameters.leash_m * ahead + [0, rise, 0]

    # E|v| is 1.25 sigma for two axes and 0.80 sigma for one
    speed = parameters.step_m / FRAME_INTERVAL_S / 1.25
    sweep = np.radians(parameters.turn_degrees) / FRAME_INTERVAL_S * parameters.leash_m / 1.0
    camera_sigma = speed * np.array([1.0, 0.25, 1.0])
    target_sigma = sweep * np.array([1.0, 0.45, 1.0])
    camera_v = rng.normal(size=(count, 3)) * camera_sigma
    target_v = rng.normal(size=(count, 3)) * target_sigma
    push = rng.normal(size=(frames * _SUBSTEPS, 2, count, 3))
    push[:, 0] *= camera_sigma * np.sqrt(2 * dt / parameters.camera_drag_s)
    push[:, 1] *= target_sigma * np.sqrt(2 * dt / parameters.target_drag_s)

    positions, targets = np.empty((2, count, frames, 3))
    for k in range(frames * _SUBSTEPS):
        if k % _SUBSTEPS == 0:
            positions[:, k // _SUBSTEPS], targets[:, k // _SUBSTEPS] = camera, target
        gap_m, slope = field.at(camera)
        camera_v += push[k, 0] - camera_v * (dt / parameters.camera_drag_s)
        camera_v[:, 1] -= 2.0 * dt * (camera[:, 1] - parameters.height_m)
        camera_v[:, ::2] += (4.0 * dt * np.maximum(_EDGE_M - gap_m, 0))[:, None] * slope
        moved = camera + dt * camera_v
        moved[:, 1] = np.clip(moved[:, 1], *HEIGHT_M)
        walkable = free.walkable_at(moved)
        inward = (camera_v[:, ::2] * slope).sum(axis=1, keepdims=True)
        bounced = camera_v[:, ::2] - 1.5 * np.minimum(inward, 0) * slope / np.maximum((slope**2).sum(1), 0.25)[:, None]
        camera_v[:, ::2] = np.where(walkable[:, None], camera_v[:, ::2], 0.7 * bounced)
        camera = np.where(walkable[:, None], moved, camera)

        away = target - camera
        reach = np.hypot(away[:, 0], away[:, 2])
        target_v += push[k, 1] - (target_v - parameters.follow * camera_v) * (dt / parameters.target_drag_s)
        target_v[:, ::2] += (6.0 * dt * (parameters.leash_m / np.maximum(reach, 0.2) - 1))[:, None] * away[:, ::2]
        target_v[:, 1] += 1.5 * dt * (rise - away[:, 1])
        target = target + dt * target_v
    return positions, targets


def _first_azimuths(
    free: FreeSpace, cameras: Float[np.ndarray, "b 3"], rng: np.random.Generator
) -> Float[np.ndarray, " b"]:
    """Draw the azimuths of the first views: directions with a farther view are likelier."""
    directions = 16
    azimuths = 2 * np.pi * (np.arange(directions) + rng.random((len(cameras), 1))) / directions
    fan = np.stack([np.cos(azimuths), np.zeros_like(azimuths), np.sin(azimuths)], axis=-1)
    reach = free.distances(
        np.repeat(cameras, directions, axis=0).astype(np.float32), fan.reshape(-1, 3).astype(np.float32)
    ).reshape(-1, directions)
    weight = np.clip(reach, 0.3, _FARTHEST_WEIGHT_M)
    cumulative = np.cumsum(weight, axis=1) / weight.sum(axis=1, keepdims=True)
    chosen = (cumulative < rng.random((len(cameras), 1))).sum(axis=1).clip(0, directions - 1)
    return azimuths[np.arange(len(cameras)), chosen]


def _poses(
    position: Float[np.ndarray, "f 3"],
    target: Float[np.ndarray, "f 3"],
    parameters: _WalkParameters,
    rng: np.random.Generator,
) -> Float[np.ndarray, "f 4 4"]:
    """Return poses that look from each position at each target, with the roll and the tremor of a hand."""
    frames = len(position)
    tremor = np.radians(parameters.tremor_degrees) * rng.normal(size=(frames, 3))
    away = target - position
    azimuth = np.arctan2(away[:, 2], away[:, 0]) + tremor[:, 0]
    pitch = np.arctan2(away[:, 1], np.hypot(away[:, 0], away[:, 2])) + tremor[:, 1]
    pitch = np.clip(pitch, *np.radians(_PITCH_LIMITS))
    sway = np.cumsum(rng.normal(0, 0.35, frames))
    roll = np.radians(np.clip(parameters.roll_degrees + sway - sway.mean(), -6, 6)) + tremor[:, 2]

    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, :3, :3] = camera_axes(azimuth, pitch, roll)
    poses[:, :3, 3] = position + parameters.tremor_m * rng.normal(size=(frames, 3))
    poses[:, 1, 3] = np.clip(poses[:, 1, 3], *HEIGHT_M)
    return poses


def camera_axes(azimuth: Angles, pitch: Angles, roll: Angles = 0.0) -> Float[np.ndarray, "*n 3 3"]:
    """Return the axes (columns: right, up, backward) of cameras that look along azimuth and pitch.

    Angles are in radians, of one shape or single: azimuth from x toward z, pitch above the horizon, roll of the camera
    to its left.
    """
    a, p, r = (np.asarray(part, np.float64)[..., None] for part in (azimuth, pitch, roll))
    forward = np.concatenate([np.cos(p) * np.cos(a), np.sin(p), np.cos(p) * np.sin(a)], axis=-1)
    right = np.concatenate([-np.sin(a), np.zeros_like(a), np.cos(a)], axis=-1)
    up = np.cross(right, forward)
    return np.stack([np.cos(r) * right + np.sin(r) * up, np.cos(r) * up - np.sin(r) * right, -forward], axis=-1)


def _distance_from(parameters: _WalkParameters, walk: Float[np.ndarray, "f 4 4"]) -> float:
    """Return how far a walk's motion is from the drawn one, in logarithms."""
    if len(walk) == 1:  # without motion, as all walks of one frame
        return 0.0
    step, turn = (float(values.mean()) for values in motion(walk))
    return abs(np.log((step + 0.01) / (parameters.step_m + 0.01))) + abs(
        np.log((turn + 0.3) / (parameters.turn_degrees + 0.3))
    )


def _acceptable(
    free: FreeSpace, walk: Float[np.ndarray, "f 4 4"], intrinsics: Intrinsics, first_median_m: float
) -> bool:
    """Return whether a walk is clear of surfaces at and between its poses, and its views show the room."""
    eyes = walk[:, :3, 3].astype(np.float32)
    if not free.walkable_at(eyes).all():  # the tremor moved it past the edge
        return False
    rays = intrinsics.resized(12, 9).rays().reshape(-1, 3)
    lengths = np.linalg.norm(rays, axis=1)
    seen = (rays / lengths[:, None]) @ np.swapaxes(walk[:, :3, :3], 1, 2).astype(np.float32)
    origins = np.repeat(eyes, len(rays), axis=0)
    depth_m = free.distances(origins, np.ascontiguousarray(seen.reshape(-1, 3))).reshape(len(walk), -1) / lengths
    if np.median(depth_m[0]) <= first_median_m or ((depth_m < _NEAR_M).mean(axis=1) > _NEAR_SHARE).any():
        return False
    strides = np.diff(eyes, axis=0)
    far_m = np.linalg.norm(strides, axis=1)
    along = strides / np.maximum(far_m, 1e-6)[:, None] + np.float32(1e-9)
    moving = far_m > 1e-4
    if moving.any() and (free.distances(eyes[:-1][moving], along[moving]) <= far_m[moving]).any():
        return False
    return bool(free.clear(eyes, CLEARANCE_M).all())
