"""Whether pictures, depth and poses of a capture agree: what a format or a user assumes is checked by what they show.

The map of a camera, moved into the view of another by the poses, must meet that camera's own map. Where the unit of
depth is wrong, the maps meet only when all depths are multiplied by the same factor. Features of the pictures move as
poses and depth say; where the direction of the poses or the camera's axes are assumed wrongly, they move as the other
convention says.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from roomlight.camera import Intrinsics, pose_from_quaternion, rigid_inverse
from roomlight.captures.decoding import registered
from roomlight.captures.options import UP_AXES
from roomlight.conventions import OPENCV_TO_OPENGL
from roomlight.frame import Frame

FRAMES: Final = 12
"""Frames that are compared."""
_SAMPLED: Final = 4
_COLUMNS: Final = 64
_PAIRS, _TRIED = 6, 24
_ALONG: Final = 0.8
"""Cosine between the views of cameras that may share much."""
_FACTORS: Final = tuple(float(2 ** (step / 2)) for step in range(-7, 8))
_MIN_MOVE: Final = 0.03
"""Least movement between two cameras, relative to the depth, that tells factors apart."""
_MIN_SHARED: Final = 0.2
_CLEAR, _BACK = 0.5, 0.35
"""Disagreement that the best factor may leave, and maps that are turned back, of that without."""
_MEETS, _TOGETHER, _APART = 0.08, 0.02, 0.1
"""Disagreement up to which maps meet at all (at most 0.05 in captures), and up to which nothing else is tried; and from
which on they do not meet."""
_TURNED: Final = {"upside down": (-1, 1), "mirrored": (1, -1), "turned by 180 degrees": (-1, -1)}
"""Steps along rows and columns that turn back maps stored otherwise."""
_UNLIKE, _LIKE = 0.45, 0.6
"""Correlation with the estimate below which maps are turned, and above which they are once they are turned back."""

_TURN_DEG: Final = 3.0
"""Turn between the pictures whose features are compared."""
_TURNS: Final = 6
_ALIKE: Final = 0.9
"""Correlation of a picture with the last one that is compared, from which on it counts only where the pose turned."""
_WIDTH: Final = 320
_LEAST_TRACKS: Final = 20
_LEAST_PAIRS: Final = 3
_LEAST_ERROR: Final = 0.012
"""Distance of features from where they should be, relative to the width, below which nothing is said: the smallest turn
moves them by 0.04."""
_SHARE: Final = 0.3
"""Distance that another convention may leave, of that of the assumed one."""
_JUMP: Final = 0.5
"""Distance that one pair of pictures must not show, relative to the width: at most 0.2 in captures."""
_NEAR: Final = 0.02
"""Distance from where the poses put a feature within which it is looked for, relative to the width."""
_LOST: Final = 0.4
"""Distance from which on the assumed one is wrong, relative to the features' movement: 0.01 to 0.3 in captures."""
_HANGING: Final = -0.5
"""Mean cosine of the cameras' up with the assumed one below which they hang upside down."""
_ALONG_PICTURE, _UPRIGHT = 0.5, 0.8
"""Mean cosine of an axis of the world with the picture's columns, or rows, from which on it may be up; and that of the
assumed up with the columns from which on it is not far from up."""
_ROLL, _ROLLED, _LEAST_SWING = 0.1, 3.0, 0.03
"""Sines of roll: the most about up (0.03 in captures); how many times as much there is about what is not up; and the
least variation of that."""
_FALLING, _ODD_RATIO = -0.6, 5.0
"""Correlation of depth and its estimate below which it is pointed out, and their ratio beyond which it is."""
_LENGTHS: Final = tuple(10 ** (step / 8) for step in range(-28, 29))
_LEAST_LENGTH: Final = 1.5
"""Factor on positions, either way, from which on it is looked for where features are near where they should be."""
_NOISE: Final = 0.004
"""Distance of features, relative to the width, that hardly tells a factor on positions."""
_BODY_TO_OPENGL: Final = np.array([[0.0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""Turn from axes x forward, y left, z up, as robots have them."""


class Tracks(NamedTuple):
    """Pixels of features in a view and in the next one, and their depth in the first."""

    at: int
    start: Float[np.ndarray, "n 2"]
    end: Float[np.ndarray, "n 2"]
    depth_m: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Disagreement:
    """What is wrong with the poses, as features show it.

    Attributes:
        inverse: The poses map the other way.
        other_axes: The camera has the axes of the other convention.
        length: Factor on positions that brings them together with depth; None if there is one, but not clearly which.
        w_first: Quaternions were written w first and read as x, y, z, w.
        body_axes: The camera has a robot's axes: x forward, y left, z up.
        focal: Factor on the focal lengths that makes features move as they do.
        known: Whether one of these explains it.
        axis: Direction of the stored world about which the cameras are level, upward, if it is not the assumed up.
        up: Opposite of the assumed up, if the cameras hang upside down; an axis of the stored world.
    """

    inverse: bool = False
    other_axes: bool = False
    length: float | None = 1.0
    w_first: bool = False
    body_axes: bool = False
    focal: float = 1.0
    known: bool = True
    axis: str | None = None
    up: str | None = None


class PoseCheck:
    """Collects pictures of a pass that differ, set by set; `disagreement` compares those of the latest set.

    Directions of the world in the cameras are summed over the pass: a few views at the rate of a video hardly differ.
    """

    def __init__(self, to_y_up: Float[np.ndarray, "4 4"], *, opencv: bool, quaternions: bool) -> None:
        """Take the conventions that are assumed: the turn of the world, whether cameras have OpenCV's axes.

        `quaternions` says whether poses are stored as such, x, y, z, w.
        """
        self._to_y_up, self._opencv, self._quaternions = to_y_up, opencv, quaternions
        self._views: list[tuple[UInt8[np.ndarray, "h w"], Frame]] = []
        self._last: Float32[np.ndarray, "h w"] | None = None
        self._frames = self._resting = 0
        self._axes = np.column_stack([to_y_up[:3, :3], [0.0, 1.0, 0.0]])  # of the stored world, and the assumed up
        self._seen = np.zeros((3, 2, 4))  # their x and y in the cameras, the squares of these, and frames

    def add(self, frame: Frame) -> bool:
        """Take a frame; returns whether it completes a set.

        It counts if the pose has turned since the last one that does, or the picture has changed. As many frames as a
        set took are passed over after it. Takes a millisecond, 4 to 11 more (1920 x 1440) for a frame that counts.
        """
        seen = frame.camera_to_world[:3, :2].T @ self._axes
        self._seen += [seen, seen**2, np.ones_like(seen)]
        if self._resting:
            self._resting -= 1
            return False
        if len(self._views) >= _TURNS:
            self._views, self._frames = [], 0
        self._frames += 1
        looks = _coarse(frame.image)
        if self._views and self._last is not None:
            last = self._views[-1][1].camera_to_world[:3, :3]
            cosine = (np.trace(last.T @ frame.camera_to_world[:3, :3]) - 1) / 2
            alike = looks.shape == self._last.shape and float((looks * self._last).mean()) > _ALIKE
            if alike and cosine > np.cos(np.radians(_TURN_DEG)):
                return False
        small = frame.resized(_WIDTH, _WIDTH)
        grey = np.clip(small.image.mean(axis=-1) / max(float(np.percentile(small.image, 99)), 1e-6), 0, 1)
        self._views.append((np.rint(255 * np.sqrt(grey)).astype(np.uint8), small))
        self._last = looks
        complete = len(self._views) == _TURNS
        self._resting = self._frames if complete else 0
        return complete

    def disagreement(self, *, measured: bool) -> Disagreement | None:
        """Return what is wrong; None for nothing, and if the pictures do not tell.

        `measured`: depth is no estimate, whose scale may be wrong.
        """
        stated = [frame.camera_to_world for _, frame in self._views]
        if len(stated) < _LEAST_PAIRS:
            return None
        wrong_up = self._wrong_up()
        pairs = [pair for at in range(len(stated) - 1) if (pair := self._tracks(at)) is not None]
        if len(pairs) < _LEAST_PAIRS:
            return wrong_up

        def error(poses: Sequence[Float[np.ndarray, "4 4"]], length: float = 1.0, focal: float = 1.0) -> float:
            return float(np.median([self._error(pair, poses, length, focal) for pair in pairs]))

        assumed = error(stated)
        if assumed < _LEAST_ERROR:
            worst = max(pairs, key=lambda pair: self._error(pair, stated))
            if self._error(worst, stated) > _JUMP and not self._repeats(worst, stated):
                return Disagreement(known=False)
            if measured and assumed > _NOISE:
                length, left, is_clear = _best_length(lambda length: error(stated, length))
                if is_clear and left < _SHARE * assumed and not 1 / _LEAST_LENGTH < length < _LEAST_LENGTH:
                    return Disagreement(length=length)
            return wrong_up
        if 2 * sum(self._repeats(pair, stated) for pair in pairs) >= len(pairs):
            return wrong_up
        axes = OPENCV_TO_OPENGL if self._opencv else np.eye(4)
        stored = [rigid_inverse(self._to_y_up) @ pose @ axes for pose in stated]
        length, left, is_clear = _best_length(lambda length: error(stated, length))
        choices = {Disagreement(length=length): left} if measured or not 0.1 < length < 10 else {}
        choices |= {Disagreement(focal=focal): error(stated, focal=focal) for focal in (0.5, 2.0)}
        choices[Disagreement(body_axes=True)] = error([pose @ _BODY_TO_OPENGL for pose in stored])
        choices[Disagreement(w_first=True)] = error([_reordered(pose) @ axes for pose in stored])
        for inverse in (False, True):
            poses = [rigid_inverse(pose) for pose in stored] if inverse else stored
            for other in (False, True):
                flip = OPENCV_TO_OPENGL if other != self._opencv else np.eye(4)
                choices[Disagreement(inverse, other)] = error([pose @ flip for pose in poses])
        best = min(choices, key=lambda choice: choices[choice])
        if choices[best] < min(_LEAST_ERROR, _SHARE * assumed):
            if best.w_first and not self._quaternions:  # of a tool before, or by chance: poses in another order
                return Disagreement(known=False)
            return best if best.length == 1 or is_clear else Disagreement(length=None)
        moved = np.median([np.median(np.linalg.norm(pair.end - pair.start, axis=1)) for pair in pairs])
        lost = assumed > max(2 * _LEAST_ERROR, _LOST * float(moved) / self._views[0][0].shape[1])
        return Disagreement(known=False) if lost else wrong_up

    def _tracks(self, at: int) -> Tracks | None:
        """Follow features of a view into the next one; None for too few."""
        (first, frame), (second, _) = self._views[at : at + 2]
        corners = cv2.goodFeaturesToTrack(first, 200, 0.01, 5)
        if np.size(corners) < 2 * _LEAST_TRACKS or first.shape != second.shape:
            return None
        there, there_is, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, np.copy(corners), None, None, (15, 15), 4)
        back, back_is, _ = cv2.calcOpticalFlowPyrLK(second, first, there, there.copy(), None, None, (15, 15), 4)
        start, end = corners[:, 0], there[:, 0]
        share = np.array(frame.depth_m.shape[::-1]) / first.shape[::-1]
        column, row = ((start + 0.5) * share).astype(int).T
        depth_m = frame.depth_m[row, column]
        good = (there_is[:, 0] > 0) & (back_is[:, 0] > 0) & (depth_m > 0)
        good &= np.linalg.norm(back[:, 0] - start, axis=1) < 0.5
        return Tracks(at, start[good], end[good], depth_m[good]) if good.sum() >= _LEAST_TRACKS else None

    def _error(
        self, pair: Tracks, poses: Sequence[Float[np.ndarray, "4 4"]], length: float = 1.0, focal: float = 1.0
    ) -> float:
        """Return how far features are from where poses and depth put them: median, relative to the width."""
        xy, z = self._placed(pair, poses, length, focal)
        width = self._views[pair.at][1].intrinsics.width
        distance = np.where(z > 0, np.linalg.norm(xy - pair.end, axis=1), width)
        return min(float(np.median(distance)) / width, 1.0)

    def _placed(
        self, pair: Tracks, poses: Sequence[Float[np.ndarray, "4 4"]], length: float = 1.0, focal: float = 1.0
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
        """Return the pixels in the next view where poses and depth put features, and their depth there."""
        camera = self._views[pair.at][1].intrinsics
        camera = replace(camera, fx=focal * camera.fx, fy=focal * camera.fy)
        motion = rigid_inverse(poses[pair.at + 1]) @ poses[pair.at]
        x, y = ((pair.start + 0.5 - [camera.cx, camera.cy]) / [camera.fx, camera.fy]).T
        points = np.stack([x, -y, -np.ones_like(x)], axis=1) * pair.depth_m[:, None]
        xy, z = camera.project(points @ motion[:3, :3].T + length * motion[:3, 3])
        return xy - 0.5, z

    def _repeats(self, pair: Tracks, poses: Sequence[Float[np.ndarray, "4 4"]]) -> bool:
        """Whether many features look the same where the poses put them: a pattern repeats, such as a wallpaper's."""
        (first, _), (second, _) = self._views[pair.at : pair.at + 2]
        xy, z = self._placed(pair, poses)
        height, width = second.shape
        inside = (z > 0) & (xy >= 0).all(axis=1) & (xy < [width, height]).all(axis=1)
        if not inside.any():
            return False
        start = pair.start[inside, None].astype(np.float32)
        there, unlike = self._nearby(first, second, start, xy[inside, None].astype(np.float32))
        _, least = self._nearby(first, second, start, pair.end[inside, None].astype(np.float32))
        same = (np.linalg.norm(there - xy[inside], axis=1) < _NEAR * width) & (unlike < 1.5 * least + 1)
        return bool(same.sum() > _SHARE * len(pair.start))

    @staticmethod
    def _nearby(
        first: UInt8[np.ndarray, "h w"],
        second: UInt8[np.ndarray, "h w"],
        start: Float32[np.ndarray, "n 1 2"],
        guess: Float32[np.ndarray, "n 1 2"],
    ) -> tuple[Float32[np.ndarray, "n 2"], Float32[np.ndarray, " n"]]:
        """Return where features are near a guess, and how much they differ there in grey levels; infinite if lost."""
        way = cv2.OPTFLOW_USE_INITIAL_FLOW
        there, there_is, unlike = cv2.calcOpticalFlowPyrLK(
            first, second, start, guess.copy(), None, None, (15, 15), 1, flags=way
        )
        return there[:, 0], np.where(there_is[:, 0] > 0, unlike[:, 0], np.float32(np.inf))

    def _wrong_up(self) -> Disagreement | None:
        """Return what is wrong with the assumed up; None if cameras are level about it, or nothing tells.

        Up lies along the pictures' columns, and cameras hardly roll about it; along their rows where a phone was held
        upright, with the first pixels of the rows up.
        """
        mean, square = self._seen[:2] / self._seen[2]
        roll = np.where(np.abs(mean)[::-1] > _ALONG_PICTURE, np.sqrt(square), np.inf)
        row, axis = np.unravel_index(np.argmin(roll[:, :3]), (2, 3))
        other = np.argmin(roll[:, 3]) if np.isfinite(roll[:, 3]).any() else row
        swings = square[other, 3] - mean[other, 3] ** 2 > _LEAST_SWING**2
        level = roll[row, axis] < min(_ROLL, np.sqrt(square[other, 3]) / _ROLLED)
        if swings and level and mean[1, 3] < _UPRIGHT:
            upward = mean[1, axis] if row == 0 else -mean[0, axis]
            return Disagreement(axis=f"{'' if upward > 0 else '-'}{'xyz'[axis]}")
        if mean[1, 3] < _HANGING:
            down = -self._to_y_up[1, :3]
            return Disagreement(up=max(UP_AXES, key=lambda name: float(down @ UP_AXES[name])))
        return None


def _best_length(error: Callable[[float], float]) -> tuple[float, float, bool]:
    """Return the factor on positions of least error, to a twentieth, its error, and whether it is clearly that one."""
    near = min(_LENGTHS, key=error)
    best = min((near * 10 ** (step / 32) for step in (0, -1, 1, -2, 2)), key=error)
    return best, error(best), min(error(0.6 * best), error(best / 0.6)) > 2 * error(best)


def _coarse(image: Float[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "ch cw"]:
    """Return brightness of a few hundred patches: mean 0, standard deviation 1."""
    step = max(1, max(image.shape[:2]) // 128)
    grey = np.sqrt(np.maximum(image[::step, ::step].mean(axis=-1, dtype=np.float32), 0))
    small = cv2.resize(grey, (grey.shape[1] // 4 + 1, grey.shape[0] // 4 + 1), interpolation=cv2.INTER_AREA)
    return ((small - small.mean()) / max(float(small.std()), 1e-6)).astype(np.float32)


def _reordered(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return a pose whose quaternion was stored as w, x, y, z and read as x, y, z, w."""
    turn = cv2.Rodrigues(pose[:3, :3])[0][:, 0].astype(np.float64)
    half = float(np.linalg.norm(turn)) / 2
    x, y, z = turn * 0.5 * np.sinc(half / np.pi)
    return pose_from_quaternion(np.array([y, z, np.cos(half), x]), pose[:3, 3])


def odd_depth(frames: Sequence[Frame]) -> tuple[bool, float] | None:
    """Compare depth with what the network inside the package estimates from each picture alone.

    On 120 captures and walks their logarithms correlate by -0.50 to 0.99, and their ratio is 0.67 to 2.9; 0.2 to 3.25
    for single pictures of 50 rooms, 4.5 of a drawn one.

    Returns:
        Whether depth falls where the estimate rises, as 1 / depth does, and how many times as large it is: medians over
        the frames. None if it agrees, or nothing tells.
    """
    (compared,) = _compared(frames, (1, 1))
    if not compared:
        return None
    correlation, ratio = np.median(compared, axis=0).tolist()
    falls = correlation < _FALLING
    return (falls, ratio) if falls or not 1 / _ODD_RATIO < ratio < _ODD_RATIO else None


def looks_turned(frames: Sequence[Frame], turn: str) -> bool:
    """Whether depth agrees with the pictures, by the network's estimate, only if its maps are turned back."""
    compared = _compared(frames, (1, 1), _TURNED[turn])
    stored, turned = ([correlation for correlation, _ in of_turn if correlation] for of_turn in compared)
    return bool(stored and turned) and bool(np.median(stored) < _UNLIKE and np.median(turned) > _LIKE)


def _compared(frames: Sequence[Frame], *turns: tuple[int, int]) -> list[list[tuple[float, float]]]:
    """Compare depth, its maps turned in each of these ways, with the estimate.

    Returns:
        By turn: correlation, 0 where it tells nothing, and ratio in each frame of which enough is known.
    """
    from roomlight.monocular.estimate import srgb_picture  # onnxruntime takes a while to import
    from roomlight.monocular.network import shipped_depth

    compared: list[list[tuple[float, float]]] = [[] for _ in turns]
    for frame in frames:
        small = replace(frame, depth_m=np.zeros(frame.image.shape[:2], np.float32)).resized(_WIDTH, _WIDTH)
        estimated = shipped_depth().estimate(srgb_picture(small), small.intrinsics)
        for (row, column), of_turn in zip(turns, compared, strict=True):
            turned = np.ascontiguousarray(frame.depth_m[::row, ::column])
            own = cv2.resize(turned, estimated.inverse.shape[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
            known = own > 0
            stated, seen = np.log(own[known]), -np.log(np.maximum(estimated.inverse[known], 1e-3))
            if known.mean() > _MIN_SHARED:
                tells = min(stated.std(), seen.std()) > 0.1
                correlation = float(np.corrcoef(stated, seen)[0, 1]) if tells else 0.0
                of_turn.append((correlation, float(np.exp(np.median(stated - seen)))))
    return compared


class Mismatch(NamedTuple):
    """How maps of depth do not meet by the poses: by a factor on depth or a turn of the maps they would; else neither.

    A turn is one of those in `_TURNED`.
    """

    factor: float | None = None
    turn: str | None = None


class DepthCheck:
    """Collects the first frames of a pass; `mismatch` compares them, `samples` are some of them."""

    def __init__(self) -> None:
        self.samples: list[Frame] = []
        self._maps: list[tuple[Float[np.ndarray, "h w"], Intrinsics, Float[np.ndarray, "4 4"]]] = []

    def add(self, frame: Frame) -> None:
        """Take a frame."""
        if len(self._maps) % _SAMPLED == 0:
            self.samples.append(frame)
        height, width = frame.depth_m.shape
        size = _COLUMNS, max(2, round(_COLUMNS * height / width))
        small = cv2.resize(frame.depth_m, size, interpolation=cv2.INTER_NEAREST_EXACT)
        self._maps.append((small, frame.intrinsics.resized(*size), frame.camera_to_world @ OPENCV_TO_OPENGL))

    def mismatch(self) -> Mismatch | None:
        """Return what would bring maps and poses together; None if they meet as they are, or nothing tells."""
        if len(self._maps) < FRAMES:
            return None
        moves = sorted(
            ((self._move(first, second), first, second) for second in range(FRAMES) for first in range(second)),
            reverse=True,
        )
        errors, pairs = np.zeros(len(_FACTORS)), 0
        stored = [depth_m for depth_m, _, _ in self._maps]
        for _, first, second in moves:
            if pairs == _PAIRS:
                break
            of_pair = [self._disagreement(first, second, stored, factor) for factor in _FACTORS]
            known = [error for error in of_pair if error is not None]
            if len(known) >= len(_FACTORS) // 2:
                errors += [max(known) if error is None else error for error in of_pair]
                pairs += 1
        if pairs < _LEAST_PAIRS:
            return None
        errors /= pairs
        best = int(np.argmin(errors))
        same = len(_FACTORS) // 2
        other = self._turned(moves, stored, errors[best]) if errors[same] > _TOGETHER else None
        if other is not None and other.turn is not None:
            return other
        moved = moves[0][0] * _FACTORS[-1] > _MIN_MOVE
        if not moved or best in (0, len(_FACTORS) - 1) or abs(best - same) < 2:
            return other
        clear = errors[best] < min(_MEETS, _CLEAR * errors[same])
        return Mismatch(factor=_FACTORS[best]) if clear else other

    def _turned(
        self, moves: Sequence[tuple[float, int, int]], stored: Sequence[Float[np.ndarray, "h w"]], by_factor: float
    ) -> Mismatch | None:
        """Return how the maps are stored, if they meet when they are turned back, or that they do not meet; else None.

        They must meet better than by a factor, and the same views clearly better than as they are.
        """
        facing = [-pose[:3, 2] for _, _, pose in self._maps]
        pairs = [pair for _, *pair in moves if facing[pair[0]] @ facing[pair[1]] > _ALONG][:_TRIED]
        rests: dict[str, float] = {}
        for turn, (row, column) in {"": (1, 1), **_TURNED}.items():
            maps = [depth_m[::row, ::column] for depth_m in stored]
            of_pair = (self._disagreement(first, second, maps) for first, second in pairs)
            known = list(islice((rest for rest in of_pair if rest is not None), _PAIRS))
            rests[turn] = float(np.mean(known)) if len(known) >= _LEAST_PAIRS else math.inf
        best = min(rests, key=rests.__getitem__)
        if rests[best] < min(_MEETS, by_factor, _BACK * rests[""]):
            return Mismatch(turn=best)
        return Mismatch() if _APART < rests[""] < math.inf else None

    def _move(self, first: int, second: int) -> float:
        """Return the way between two cameras, relative to the first one's depth."""
        depth_m = self._maps[first][0]
        way = float(np.linalg.norm(self._maps[second][2][:3, 3] - self._maps[first][2][:3, 3]))
        known = depth_m[depth_m > 0]
        return way / float(np.median(known)) if known.size else 0.0

    def _disagreement(
        self, first: int, second: int, depths: Sequence[Float[np.ndarray, "h w"]], factor: float = 1.0
    ) -> float | None:
        """Return the median relative difference of two of these maps; None where they share too little."""
        (_, camera_a, pose_a), (_, camera_b, pose_b) = self._maps[first], self._maps[second]
        scaled = depths[first] * np.float32(factor)
        moved = registered(scaled, camera_a, camera_b, rigid_inverse(pose_b) @ pose_a)
        there = cv2.resize(depths[second], moved.shape[::-1], interpolation=cv2.INTER_NEAREST) * np.float32(factor)
        both = (moved > 0) & (there > 0)
        return float(np.median(np.abs(moved[both] / there[both] - 1))) if both.mean() > _MIN_SHARED else None
