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
from typing import Final, NamedTuple

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
_ROLL_DEG: Final = 3.0
"""Standard deviation of the roll."""
_FINE: Final = 0.004
"""How near a line's plane must come to the up direction, in the last search (a sine)."""
_DOUBTED: Final = 0.5
"""What lines count where they do not agree, beside how cameras are held."""
_BINS: Final = 60
SURE_DEG: Final = 3.0
"""Spread of the estimate up to which it is used."""


class _Hold(NamedTuple):
    """A way in which cameras are held, in degrees, and how it is looked for.

    Attributes:
        pitch: The likeliest, and standard deviations above and below it.
        pitches: What is looked at. An estimate at the edge does not count.
        rolls: The same.
        step: Of the search.
        sharpness: How near a line's plane must come to the up direction (a sine).
    """

    pitch: tuple[float, float, float]
    pitches: tuple[float, float]
    rolls: tuple[float, float]
    step: float
    sharpness: float

    def grid(self) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
        """Return all pitches and rolls."""
        return _grid(*(np.arange(low, high + self.step, self.step) for low, high in (self.pitches, self.rolls)))

    def prior(self, pitch: Float[np.ndarray, " c"], roll: Float[np.ndarray, " c"]) -> Float[np.ndarray, " c"]:
        """Return the log-probability of pitches and rolls, up to a constant."""
        middle, above, below = self.pitch
        spread = np.where(pitch > middle, above, below)
        return -0.5 * ((pitch - middle) / spread) ** 2 - 0.5 * (roll / _ROLL_DEG) ** 2


_LEVEL: Final = _Hold((0.0, 8.0, 8.0), (-16.0, 16.0), (-10.0, 10.0), 1.0, 0.02)
_TILTED: Final = _Hold((-10.0, 12.0, 20.0), (-60.0, 36.0), (-12.0, 12.0), 2.0, 0.03)


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
    """Estimate the up direction that the lines of all pictures agree on; `turns` are camera-to-world rotations."""
    axes = np.mean(np.asarray(turns), axis=0)  # columns: where the cameras' axes point, on average
    middle = _unit(axes[:, 1])
    ahead = _unit(-axes[:, 2] + (axes[:, 2] @ middle) * middle + 1e-9)
    frame = np.stack([np.cross(ahead, middle), middle, -ahead], axis=1)
    normals = np.concatenate([lines.normals @ turn.T for lines, turn in zip(pictures, turns, strict=True)]) @ frame
    lengths = np.concatenate([lines.lengths for lines in pictures])
    kept = np.argsort(-lengths)[:_MOST_LINES]
    normals, lengths = normals[kept].astype(np.float32), np.minimum(lengths[kept], 0.4).astype(np.float32)
    spread = math.inf
    for hold in (_LEVEL, _TILTED):
        pitch, roll = hold.grid()
        score = hold.prior(pitch, roll) + _score(pitch, roll, normals, lengths, hold.sharpness)
        best = int(np.argmax(score))
        spread = _spread_deg(_directions(pitch, roll), score)
        if pitch[best] in hold.pitches or roll[best] in hold.rolls:
            spread = math.inf
        if spread <= SURE_DEG:
            near = np.arange(-1, 1.01, 0.2) * hold.step
            pitch, roll = _grid(pitch[best] + near, roll[best] + near)
            score = hold.prior(pitch, roll) + _score(pitch, roll, normals, lengths, _FINE)
            fine = int(np.argmax(score))
            x, y, z = (frame @ _directions(pitch[fine : fine + 1], roll[fine : fine + 1])[0]).tolist()
            return Upright((x, y, z), spread)
    pitch, roll = _TILTED.grid()
    score = _TILTED.prior(pitch, roll) + _DOUBTED * _score(pitch, roll, normals, lengths, _TILTED.sharpness)
    directions, chance = _directions(pitch, roll), np.exp(score - score.max())
    errors = np.arccos(np.clip(directions @ directions.T, -1, 1)) @ chance
    x, y, z = (frame @ directions[np.argmin(errors)]).tolist()  # the least error on average
    return Upright((x, y, z), spread)


def _spread_deg(directions: Float[np.ndarray, "c 3"], score: Float[np.ndarray, " c"]) -> float:
    """Return the standard deviation of directions from the likeliest, by their log-probabilities."""
    best = int(np.argmax(score))
    chance = np.exp(score - score[best])
    apart = np.degrees(np.arccos(np.clip(directions @ directions[best], -1, 1)))
    return float(np.sqrt((chance * apart**2).sum() / chance.sum()))


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
    """Return what the lines add to the log-probability of up directions."""
    if len(lengths) == 0:
        return np.zeros(len(pitch))
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
    return _STRENGTH * ((lengths * vertical).sum(axis=1) + 0.7 * peak) / total


def _directions(pitch_deg: Float[np.ndarray, " c"], roll_deg: Float[np.ndarray, " c"]) -> Float[np.ndarray, "c 3"]:
    """Return up directions in axes where (0, 1, 0) is level; positive pitch: the camera looks up."""
    pitch, roll = np.radians(pitch_deg), np.radians(roll_deg)
    return np.stack([np.sin(roll), np.cos(roll) * np.cos(pitch), -np.cos(roll) * np.sin(pitch)], axis=1)


def _unit(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
