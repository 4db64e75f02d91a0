"""How a phone is carried through a room: two bodies under random forces, the camera and the point it looks at.

The paper's two-body motion (section "Dataset creation", after McCormac et al. 2017 and Li et al. 2018): both bodies
are pushed at random, slowed by drag and kept from walls. Here the camera keeps to the height of a hand and to the
walkable floor, and the point looked at is on a leash before it, so that the view neither spins nor dives.

World frame: y up, metres, the floor at y = 0; poses camera-to-world, OpenGL axes; one frame every third of a second.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.camera import Intrinsics

FRAME_INTERVAL_S: Final = 1 / 3
"""Every tenth frame of a 30 Hz recording; the paper samples 30 of some ten seconds."""
HEIGHT_M: Final = (0.9, 1.75)
"""Lowest and highest camera: held before a sitting person and before a tall standing one."""
CLEARANCE_M: Final = 0.25
"""Nothing comes nearer to the camera than this."""
FIELD_OF_VIEW_DEGREES: Final = (55.0, 72.0)
"""Across the long side of a 4:3 frame: phones' main cameras, cropped for steadiness or not (one iPhone's: 69)."""

_SUBSTEPS: Final = 10
_CANDIDATES: Final = 24
"""Walks simulated together: 24 take no longer than one (17 to 20 ms), the time is NumPy's calls."""
_ROUNDS: Final = 8
_SHY_M: Final = 0.25
"""So near to the edge of the walkable floor the camera is pushed back."""
_PITCH_LIMITS: Final = (-50.0, 35.0)
_NEAR_M: Final = 0.7
_NEAR_SHARE: Final = 0.4
"""A view of which more than this share is nearer than _NEAR_M shows nothing of the room."""
_FIRST_MEDIAN_M: Final = (1.7, 1.2)
"""Least median depth of the first view; the second where a room has no walk that begins so far from things."""
_MEAN_STEP_M: Final = 0.105
_MEAN_TURN_DEGREES: Final = 5.06
"""Means of the motion drawn for ordinary walks. With the nearly still ones mixed in, and what walls take away, walks
then average the paper's motion: 0.0887 m and 4.73 degrees a frame in 720 walks through 90 furnished rooms."""


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Where a camera can be: the floor one can walk on, and what is around.

    walkable[row, column] is a square of cell_m metres around origin + cell_m (column, row), origin being (x, z): the
    planner's free floor, best for a body of CLEARANCE_M radius. distances(origins [n, 3], unit directions [n, 3],
    float32) gives metres to the first surface, inf for nothing.
    """

    walkable: Bool[np.ndarray, "nz nx"]
    origin: tuple[float, float]
    cell_m: float
    distances: Callable[[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]], Float[np.ndarray, " n"]]

    def walkable_at(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether the points are over floor that one can walk on."""
        cell = self.cells(points)
        inside = ((cell >= 0) & (cell < self.walkable.shape)).all(axis=1)
        row, column = np.where(inside, cell.T, 0)
        return inside & self.walkable[row, column]

    def cells(self, points: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, "n 2"]:
        """Row and column of the squares under points; they may lie outside of the grid."""
        plan = points[:, [2, 0]] - np.asarray(self.origin)[::-1]
        return np.rint(plan / self.cell_m).astype(np.int64)

    def clear(self, points: Float[np.ndarray, "n 3"], clearance_m: float, rays: int = 256) -> Bool[np.ndarray, " n"]:
        """Which points have no surface within clearance_m, by a fan of rays from each to all sides.

        Of 256 rays one passes within 9.5 degrees of any direction: what is wider than a third of the clearance is seen.
        """
        fan = sphere_directions(rays)
        origins = np.repeat(points.astype(np.float32), rays, axis=0)
        distances = self.distances(origins, np.tile(fan, (len(points), 1))).reshape(-1, rays)
        return np.asarray(distances.min(axis=1) >= clearance_m)


@dataclass(frozen=True, eq=False)
class Motion:
    """How far the camera goes (metres) and turns (degrees) from each frame to the next."""

    translation_m: Float[np.ndarray, " steps"]
    rotation_degrees: Float[np.ndarray, " steps"]


@dataclass(frozen=True)
class _Habit:
    """One person's way of filming: what a walk aims at. Metres a frame, degrees a frame, seconds, degrees, metres."""

    step_m: float
    turn_degrees: float
    camera_drag_s: float
    look_drag_s: float
    follow: float
    height_m: float
    pitch_degrees: float
    leash_m: float
    roll_degrees: float
    tremor_m: float
    tremor_degrees: float


def motion_statistics(camera_to_world: Float[np.ndarray, "f 4 4"]) -> Motion:
    """Distance of consecutive positions and geodesic angle of consecutive rotations."""
    poses = np.asarray(camera_to_world, np.float64)
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    chords = np.linalg.norm(np.diff(poses[:, :3, :3], axis=0), axis=(1, 2))  # 2 sqrt(2) sin(angle / 2)
    angles = 2 * np.arcsin(np.clip(chords / np.sqrt(8), 0, 1))
    return Motion(translation_m=steps, rotation_degrees=np.degrees(angles))


def timestamps_s(frames: int) -> Float[np.ndarray, " f"]:
    """When so many frames are taken."""
    return np.arange(frames) * FRAME_INTERVAL_S


def phone_intrinsics(rng: np.random.Generator, width: int = 320, height: int = 240) -> Intrinsics:
    """A phone's main camera: square pixels, the principal point off the middle by about 1 % (2 % at most)."""
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


def sphere_directions(count: int) -> Float[np.ndarray, "{count} 3"]:
    """Unit directions spread evenly over the sphere (a Fibonacci lattice), float32."""
    k = np.arange(count) + 0.5
    y = 1 - 2 * k / count
    ring = np.sqrt(1 - y * y)
    azimuth = np.pi * (1 + np.sqrt(5)) * k
    return np.stack([ring * np.cos(azimuth), y, ring * np.sin(azimuth)], axis=1).astype(np.float32)


def camera_walk(
    free: FreeSpace, rng: np.random.Generator, *, intrinsics: Intrinsics, frames: int = 31
) -> Float[np.ndarray, "{frames} 4 4"] | None:
    """Camera-to-world poses of a hand-held walk, or None where the room has no place for one.

    How fast a walk goes and turns is drawn first, from nearly still to sweeping. Of the walks then simulated from
    random places, the one nearest to that is taken whose every pose keeps `CLEARANCE_M` and whose views are worth
    having: so narrow rooms and refused walks do not make the data slower than was asked for.
    """
    field = _Field(free)
    if field.starts.size == 0:
        return None
    step_m, turn_degrees = _draw_motion(rng)
    for attempt in range(_ROUNDS):
        if attempt == _ROUNDS // 2:  # no room for this one: be content with less
            step_m, turn_degrees = 0.3 * step_m, min(turn_degrees, 4.0)
        habit = _draw_habit(rng, step_m, turn_degrees)
        position, target = _simulate(free, field, habit, rng, frames)
        walks = [_poses(p, t, habit, rng) for p, t in zip(position, target, strict=True)]
        for walk in sorted(walks, key=lambda walk: _distance_from(habit, walk)):
            if _acceptable(free, walk, intrinsics, _FIRST_MEDIAN_M[attempt > 1]):
                return walk
    return None


class _Field:
    """Distance to the next place one cannot walk on, over the plan, and its slope."""

    def __init__(self, free: FreeSpace) -> None:
        padded = np.pad(free.walkable.astype(np.uint8), 1)
        distance_m = np.maximum(cv2.distanceTransform(padded, cv2.DIST_L2, 5) - 0.5, 0) * free.cell_m
        along_z, along_x = np.gradient(distance_m, free.cell_m)
        slope = np.stack([np.asarray(along_x), np.asarray(along_z)], axis=-1)
        self.free = free
        self.metres, self.slope = distance_m[1:-1, 1:-1], slope[1:-1, 1:-1]
        self.starts = np.argwhere(free.walkable & (self.metres >= min(0.15, 0.7 * float(self.metres.max(initial=0)))))

    def at(self, points: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
        """Distance and slope (x, z) at points; outside of the grid its nearest square's."""
        row, column = np.clip(self.free.cells(points), 0, np.array(self.metres.shape) - 1).T
        return self.metres[row, column], self.slope[row, column]


def _draw_motion(rng: np.random.Generator) -> tuple[float, float]:
    """Mean metres and degrees a frame of one walk: log-normal, with some that turn on the spot and some that stare."""
    step = float(np.exp(rng.normal(-0.5 * 0.5**2, 0.5))) * _MEAN_STEP_M
    turn = float(np.exp(rng.normal(-0.5 * 0.45**2, 0.45))) * _MEAN_TURN_DEGREES
    kind = rng.random()
    if kind < 0.12:
        step = rng.uniform(0.0, 0.025)
    elif kind < 0.18:
        turn = rng.uniform(0.5, 1.8)
    return float(np.clip(step, 0, 0.25)), float(np.clip(turn, 0.4, 13))


def _draw_habit(rng: np.random.Generator, step_m: float, turn_degrees: float) -> _Habit:
    pitch = rng.uniform(2, 20) if rng.random() < 0.08 else np.clip(rng.normal(-15, 8), -36, 4)
    height = rng.uniform(0.92, 1.2) if rng.random() < 0.2 else np.clip(rng.normal(1.45, 0.13), 1.1, 1.7)
    return _Habit(
        step_m=step_m,
        turn_degrees=turn_degrees,
        camera_drag_s=rng.uniform(0.8, 2.5),
        look_drag_s=rng.uniform(0.6, 3.0),
        follow=rng.uniform(0.2, 1.0),
        height_m=float(height),
        pitch_degrees=float(pitch),
        leash_m=rng.uniform(1.4, 3.0),
        roll_degrees=float(rng.normal(0, 1.2)),
        tremor_m=rng.uniform(0.0003, 0.002),
        tremor_degrees=rng.uniform(0.03, 0.3),
    )


def _simulate(
    free: FreeSpace, field: _Field, habit: _Habit, rng: np.random.Generator, frames: int
) -> tuple[Float[np.ndarray, "b {frames} 3"], Float[np.ndarray, "b {frames} 3"]]:
    """Positions of the camera and of the point looked at, for several walks at once.

    Each body's velocity is an Ornstein-Uhlenbeck process (random force against drag) plus springs: walls push the
    camera away, a spring holds its height; the point looked at hangs on a leash before the camera, at the height that
    the preferred pitch asks for, and goes along with the camera as far as `follow` says.
    """
    count, dt = _CANDIDATES, FRAME_INTERVAL_S / _SUBSTEPS
    place = field.starts[rng.integers(len(field.starts), size=count)]
    jitter = rng.uniform(-0.4, 0.4, (count, 2))
    plan = np.asarray(free.origin) + (place[:, ::-1] + jitter) * free.cell_m
    height = np.clip(habit.height_m + rng.normal(0, 0.04, count), *HEIGHT_M)
    camera = np.stack([plan[:, 0], height, plan[:, 1]], axis=1)
    azimuth = _outlook(free, camera, rng)
    ahead = np.stack([np.cos(azimuth), np.zeros(count), np.sin(azimuth)], axis=1)
    rise = habit.leash_m * np.tan(np.radians(habit.pitch_degrees))
    look = camera + habit.leash_m * ahead + [0, rise, 0]

    # E|v| is 1.25 sigma for two axes and 0.80 sigma for one
    speed = habit.step_m / FRAME_INTERVAL_S / 1.25
    sweep = np.radians(habit.turn_degrees) / FRAME_INTERVAL_S * habit.leash_m / 1.0
    camera_sigma = speed * np.array([1.0, 0.25, 1.0])
    look_sigma = sweep * np.array([1.0, 0.45, 1.0])
    camera_v = rng.normal(size=(count, 3)) * camera_sigma
    look_v = rng.normal(size=(count, 3)) * look_sigma
    push = rng.normal(size=(frames * _SUBSTEPS, 2, count, 3))
    push[:, 0] *= camera_sigma * np.sqrt(2 * dt / habit.camera_drag_s)
    push[:, 1] *= look_sigma * np.sqrt(2 * dt / habit.look_drag_s)

    positions, targets = np.empty((2, count, frames, 3))
    for k in range(frames * _SUBSTEPS):
        if k % _SUBSTEPS == 0:
            positions[:, k // _SUBSTEPS], targets[:, k // _SUBSTEPS] = camera, look
        gap_m, slope = field.at(camera)
        camera_v += push[k, 0] - camera_v * (dt / habit.camera_drag_s)
        camera_v[:, 1] -= 2.0 * dt * (camera[:, 1] - habit.height_m)
        camera_v[:, ::2] += (4.0 * dt * np.maximum(_SHY_M - gap_m, 0))[:, None] * slope
        moved = camera + dt * camera_v
        moved[:, 1] = np.clip(moved[:, 1], *HEIGHT_M)
        walkable = free.walkable_at(moved)
        inward = (camera_v[:, ::2] * slope).sum(axis=1, keepdims=True)
        bounced = camera_v[:, ::2] - 1.5 * np.minimum(inward, 0) * slope / np.maximum((slope**2).sum(1), 0.25)[:, None]
        camera_v[:, ::2] = np.where(walkable[:, None], camera_v[:, ::2], 0.7 * bounced)
        camera = np.where(walkable[:, None], moved, camera)

        away = look - camera
        reach = np.hypot(away[:, 0], away[:, 2])
        look_v += push[k, 1] - (look_v - habit.follow * camera_v) * (dt / habit.look_drag_s)
        look_v[:, ::2] += (6.0 * dt * (habit.leash_m / np.maximum(reach, 0.2) - 1))[:, None] * away[:, ::2]
        look_v[:, 1] += 1.5 * dt * (rise - away[:, 1])
        look = look + dt * look_v
    return positions, targets


def _outlook(free: FreeSpace, cameras: Float[np.ndarray, "b 3"], rng: np.random.Generator) -> Float[np.ndarray, " b"]:
    """Azimuths to look along first: at random, the likelier the farther one sees."""
    ways = 16
    azimuths = 2 * np.pi * (np.arange(ways) + rng.random((len(cameras), 1))) / ways
    fan = np.stack([np.cos(azimuths), np.zeros_like(azimuths), np.sin(azimuths)], axis=-1)
    reach = free.distances(
        np.repeat(cameras, ways, axis=0).astype(np.float32), fan.reshape(-1, 3).astype(np.float32)
    ).reshape(-1, ways)
    weight = np.clip(reach, 0.3, 6.0) ** 3
    ladder = np.cumsum(weight, axis=1) / weight.sum(axis=1, keepdims=True)
    chosen = (ladder < rng.random((len(cameras), 1))).sum(axis=1).clip(0, ways - 1)
    return azimuths[np.arange(len(cameras)), chosen]


def _poses(
    position: Float[np.ndarray, "f 3"], target: Float[np.ndarray, "f 3"], habit: _Habit, rng: np.random.Generator
) -> Float[np.ndarray, "f 4 4"]:
    """Look from each position at each target, with the roll and the tremor of a hand."""
    frames = len(position)
    tremor = np.radians(habit.tremor_degrees) * rng.normal(size=(frames, 3))
    away = target - position
    azimuth = np.arctan2(away[:, 2], away[:, 0]) + tremor[:, 0]
    pitch = np.arctan2(away[:, 1], np.hypot(away[:, 0], away[:, 2])) + tremor[:, 1]
    pitch = np.clip(pitch, *np.radians(_PITCH_LIMITS))
    sway = np.cumsum(rng.normal(0, 0.35, frames))
    roll = np.radians(np.clip(habit.roll_degrees + sway - sway.mean(), -6, 6)) + tremor[:, 2]

    zero = np.zeros(frames)
    forward = np.stack([np.cos(pitch) * np.cos(azimuth), np.sin(pitch), np.cos(pitch) * np.sin(azimuth)], axis=1)
    right = np.stack([-np.sin(azimuth), zero, np.cos(azimuth)], axis=1)
    up = np.cross(right, forward)
    c, s = np.cos(roll)[:, None], np.sin(roll)[:, None]
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, :3, 0] = c * right + s * up
    poses[:, :3, 1] = c * up - s * right
    poses[:, :3, 2] = -forward
    poses[:, :3, 3] = position + habit.tremor_m * rng.normal(size=(frames, 3))
    poses[:, 1, 3] = np.clip(poses[:, 1, 3], *HEIGHT_M)
    return poses


def _distance_from(habit: _Habit, walk: Float[np.ndarray, "f 4 4"]) -> float:
    """How far a walk is from what was drawn for it, in logarithms."""
    if len(walk) == 1:  # goes nowhere, as any other of one frame
        return 0.0
    motion = motion_statistics(walk)
    step, turn = float(motion.translation_m.mean()), float(motion.rotation_degrees.mean())
    return abs(np.log((step + 0.01) / (habit.step_m + 0.01))) + abs(np.log((turn + 0.3) / (habit.turn_degrees + 0.3)))


def _acceptable(
    free: FreeSpace, walk: Float[np.ndarray, "f 4 4"], intrinsics: Intrinsics, first_median_m: float
) -> bool:
    """Clear of everything at each pose, nothing between poses, and views that show something."""
    eyes = walk[:, :3, 3].astype(np.float32)
    if not free.walkable_at(eyes).all():  # the tremor put it past the edge
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
    ways = strides / np.maximum(far_m, 1e-6)[:, None] + np.float32(1e-9)
    moving = far_m > 1e-4
    if moving.any() and (free.distances(eyes[:-1][moving], ways[moving]) <= far_m[moving]).any():
        return False
    return bool(free.clear(eyes, CLEARANCE_M).all())
