"""Whether the depth of a capture agrees with its poses: a wrong unit of either shows in the maps themselves.

The map of a camera, moved into the view of another by the poses, must meet that camera's own map. Where the unit of
depth is wrong, the maps meet only when all depths are multiplied by the same factor.
"""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics, rigid_inverse
from roomlight.captures.decoding import registered
from roomlight.conventions import OPENCV_TO_OPENGL
from roomlight.frame import Frame

FRAMES: Final = 12
"""Frames that are compared."""
_COLUMNS: Final = 64
_PAIRS: Final = 6
_FACTORS: Final = tuple(float(2 ** (step / 2)) for step in range(-7, 8))
_MIN_MOVE: Final = 0.03
"""Least movement between two cameras, relative to the depth, that tells factors apart."""
_MIN_SHARED: Final = 0.2
_CLEAR: Final = 0.5
"""Disagreement that the best factor may leave, of that without it."""


class DepthCheck:
    """Collects the first frames of a pass; `factor` compares them."""

    def __init__(self) -> None:
        self._maps: list[tuple[Float[np.ndarray, "h w"], Intrinsics, Float[np.ndarray, "4 4"]]] = []

    def add(self, frame: Frame) -> bool:
        """Take a frame; returns whether it completes the set."""
        if len(self._maps) >= FRAMES:
            return False
        height, width = frame.depth_m.shape
        size = _COLUMNS, max(2, round(_COLUMNS * height / width))
        small = cv2.resize(frame.depth_m, size, interpolation=cv2.INTER_NEAREST)
        self._maps.append((small, frame.intrinsics.resized(*size), frame.camera_to_world @ OPENCV_TO_OPENGL))
        return len(self._maps) == FRAMES

    def factor(self) -> float | None:
        """Return the factor on depth that brings maps and poses together; None if 1 does, or none is clear."""
        moves = sorted(
            ((self._move(first, second), first, second) for second in range(FRAMES) for first in range(second)),
            reverse=True,
        )
        errors = np.zeros(len(_FACTORS))
        pairs = 0
        for _, first, second in moves:
            if pairs == _PAIRS:
                break
            of_pair = [self._disagreement(first, second, factor) for factor in _FACTORS]
            known = [error for error in of_pair if error is not None]
            if len(known) >= len(_FACTORS) // 2:
                errors += [max(known) if error is None else error for error in of_pair]
                pairs += 1
        best = int(np.argmin(errors))
        same = len(_FACTORS) // 2
        moved = moves and moves[0][0] * _FACTORS[-1] > _MIN_MOVE
        if pairs < 3 or not moved or best in (0, len(_FACTORS) - 1) or abs(best - same) < 2:
            return None
        return _FACTORS[best] if errors[best] < _CLEAR * errors[same] else None

    def _move(self, first: int, second: int) -> float:
        """Return the way between two cameras, relative to the first one's depth."""
        depth_m = self._maps[first][0]
        way = float(np.linalg.norm(self._maps[second][2][:3, 3] - self._maps[first][2][:3, 3]))
        known = depth_m[depth_m > 0]
        return way / float(np.median(known)) if known.size else 0.0

    def _disagreement(self, first: int, second: int, factor: float) -> float | None:
        """Return the median relative difference of two maps; None where they share too little."""
        (depth_a, camera_a, pose_a), (depth_b, camera_b, pose_b) = self._maps[first], self._maps[second]
        scaled = depth_a * np.float32(factor)
        moved = registered(scaled, camera_a, camera_b, rigid_inverse(pose_b) @ pose_a)
        there = cv2.resize(depth_b, moved.shape[::-1], interpolation=cv2.INTER_NEAREST) * np.float32(factor)
        both = (moved > 0) & (there > 0)
        return float(np.median(np.abs(moved[both] / there[both] - 1))) if both.mean() > _MIN_SHARED else None
