"""Which way is up in pictures, from straight lines of the room: vertical edges, and horizontal ones at right angles.

A line of a picture spans a plane with the camera's centre. The planes of vertical lines hold the up direction; those of
horizontal lines cut the horizontal plane along the room's axes, two directions that are 90 degrees apart (Coughlan and
Yuille 1999, "Manhattan World"). A camera in a hand is hardly rolled, and looks ahead or down: that counts as much as a
few lines.

Cameras: x right, y up, z backward. Angles in radians where no unit is stated.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from roomlight.camera import Intrinsics

_LEAST_SIDE: Final = 120
"""Pixels of the shorter side below which lines are too coarse to say anything."""
_LEAST_LENGTH: Final = 0.04
"""Of a line, relative to the picture's diagonal."""
_MOST_LINES: Final = 2000
_STRENGTH: Final = 60.0
"""Score of all lines, if all agree, against the logarithm of how cameras are held."""
_PITCH_DEG: Final = (-10.0, 12.0, 20.0)
"""How cameras are held: the likeliest pitch, and standard deviations above and below it."""
_ROLL_DEG: Final = 3.0
"""Standard deviation of the roll."""
_PITCHES, _ROLLS = (-60.0, 36.0), (-12.0, 12.0)
"""What is looked at. An estimate at this edge is not sure."""
_STEP_DEG: Final = 2.0
_SHARPNESS: Final = (0.03, 0.004)
"""How near a line's plane must come to the up direction, in the coarse search and in the fine one."""
_BINS: Final = 60
SURE_DEG: Final = 3.0
"""Spread of the estimate up to which it is used."""


@dataclass(frozen=True, eq=False)
class Lines:
    """Straight lines of a picture.

    Attributes:
        normals: Of their planes through the camera, unit vectors in its axes.
        lengths: In the picture, relative to its diagonal.
    """

    normals: Float[np.ndarray, "n 3"]
    lengths: Float[np.ndarray, " n"]

    def refocused(self, factor: float) -> "Lines":
        """Return the lines of the same picture by a lens of another focal length."""
        normals = self.normals * (factor, factor, 1.0)
        return Lines(normals / np.linalg.norm(normals, axis=1, keepdims=True), self.lengths)


@dataclass(frozen=True)
class Upright:
    """An estimated up direction.

    Attributes:
        up: Unit vector in the world of the cameras; the likeliest for cameras in hands if the lines do not tell.
        spread_deg: Standard deviation of the estimate's direction.
    """

    up: tuple[float, float, float]
    spread_deg: float

    @property
    def sure(self) -> bool:
        """Whether the lines say more than that cameras are held about level."""
        return self.spread_deg <= SURE_DEG


def lines_of(grey: UInt8[np.ndarray, "h w"], intrinsics: Intrinsics) -> Lines:
    """Return the straight lines of a grey picture (LSD, Grompone von Gioi et al. 2010)."""
    height, width = grey.shape
    segments = cv2.createLineSegmentDetector().detect(grey)[0] if min(height, width) >= _LEAST_SIDE else None
    ends = np.zeros((0, 2, 2)) if segments is None else segments.reshape(-1, 2, 2).astype(np.float64)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / np.hypot(height, width)
    ends, lengths = ends[lengths > _LEAST_LENGTH], lengths[lengths > _LEAST_LENGTH]
    k = intrinsics
    rays = np.stack([(ends[..., 0] + 0.5 - k.cx) / k.fx, (k.cy - ends[..., 1] - 0.5) / k.fy], axis=-1)
    rays = np.concatenate([rays, np.full((*rays.shape[:2], 1), -1.0)], axis=-1)
    normals = np.cross(rays[:, 0], rays[:, 1])
    return Lines(normals / np.linalg.norm(normals, axis=1, keepdims=True), lengths)


def upright(pictures: Sequence[Lines], turns: Sequence[Float[np.ndarray, "3 3"]]) -> Upright:
    """Estimate the up direction that the lines of all pictures agree on.

    Args:
        pictures: Lines of each picture.
        turns: Camera-to-world rotations.
    """
    axes = np.mean(np.asarray(turns), axis=0)  # columns: where the cameras' axes point, on average
    middle = _unit(axes[:, 1])
    ahead = _unit(-axes[:, 2] + (axes[:, 2] @ middle) * middle + 1e-9)
    frame = np.stack([np.cross(ahead, middle), middle, -ahead], axis=1)
    normals = np.concatenate([lines.normals @ turn.T for lines, turn in zip(pictures, turns, strict=True)]) @ frame
    lengths = np.concatenate([lines.lengths for lines in pictures])
    kept = np.argsort(-lengths)[:_MOST_LINES]
    normals, lengths = normals[kept].astype(np.float32), np.minimum(lengths[kept], 0.4).astype(np.float32)
    pitch, roll = _grid(*(np.arange(low, high + _STEP_DEG, _STEP_DEG) for low, high in (_PITCHES, _ROLLS)))
    score = _score(pitch, roll, normals, lengths, _SHARPNESS[0])
    best = int(np.argmax(score))
    chance = np.exp(score - score[best])
    directions = _directions(pitch, roll)
    apart = np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))
    spread = float(np.sqrt((chance * apart[best] ** 2).sum() / chance.sum()))
    if pitch[best] in _PITCHES or roll[best] in _ROLLS:
        spread = math.inf
    if spread > SURE_DEG:
        x, y, z = (frame @ directions[np.argmin(apart @ chance)]).tolist()  # the least error on average
        return Upright((x, y, z), spread)
    near = np.arange(-1, 1.01, 0.2) * _STEP_DEG
    pitch, roll = _grid(pitch[best] + near, roll[best] + near)
    fine = int(np.argmax(_score(pitch, roll, normals, lengths, _SHARPNESS[1])))
    x, y, z = (frame @ _directions(pitch[fine : fine + 1], roll[fine : fine + 1])[0]).tolist()
    return Upright((x, y, z), spread)


def _grid(
    pitches: Float[np.ndarray, " p"], rolls: Float[np.ndarray, " r"]
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Return all pairs of pitch and roll."""
    pitch, roll = np.meshgrid(pitches, rolls)
    return pitch.ravel(), roll.ravel()


def _score(
    pitch: Float[np.ndarray, " c"],
    roll: Float[np.ndarray, " c"],
    normals: Float32[np.ndarray, "n 3"],
    lengths: Float32[np.ndarray, " n"],
    sharpness: float,
) -> Float[np.ndarray, " c"]:
    """Return the log-probability of up directions, up to a constant."""
    middle, above, below = _PITCH_DEG
    prior = -0.5 * ((pitch - middle) / np.where(pitch > middle, above, below)) ** 2 - 0.5 * (roll / _ROLL_DEG) ** 2
    if len(lengths) == 0:
        return prior
    up = _directions(pitch, roll).astype(np.float32)  # [c, 3]
    off = up @ normals.T  # [c, n]: sine of the angle between up and the line's plane
    vertical = np.exp(-0.5 * (off / np.float32(sharpness)) ** 2)
    # where the planes cut the horizontal plane of each candidate, modulo 90 degrees
    across = np.cross(up, np.array([0, 0, 1], np.float32))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    forward = np.cross(up, across)
    angle = np.arctan2(across @ normals.T, forward @ normals.T) % np.float32(np.pi / 2)
    bins = np.minimum((angle * np.float32(_BINS / (np.pi / 2))).astype(np.int64), _BINS - 1)
    weight = lengths * (1 - vertical) * (np.abs(off) < 0.97)
    places = (np.arange(len(up))[:, None] * _BINS + bins).ravel()
    counts = np.bincount(places, weight.ravel(), _BINS * len(up)).reshape(-1, _BINS)
    peak = (counts + 0.5 * np.roll(counts, 1, axis=1) + 0.5 * np.roll(counts, -1, axis=1)).max(axis=1)
    total = float(lengths.sum()) + 0.5
    return prior + _STRENGTH * ((lengths * vertical).sum(axis=1) + 0.7 * peak) / total


def _directions(pitch_deg: Float[np.ndarray, " c"], roll_deg: Float[np.ndarray, " c"]) -> Float[np.ndarray, "c 3"]:
    """Return up directions in axes where (0, 1, 0) is level; positive pitch: the camera looks up."""
    pitch, roll = np.radians(pitch_deg), np.radians(roll_deg)
    return np.stack([np.sin(roll), np.cos(roll) * np.cos(pitch), -np.cos(roll) * np.sin(pitch)], axis=1)


def _unit(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
