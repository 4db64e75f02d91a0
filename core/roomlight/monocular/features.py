"""Features of a video's pictures: matched by their looks in any two pictures, or followed from picture to picture.

SIFT features are recognised after a long time, but bare walls have few that look like no other. Corners are followed
from each picture to the next (Lucas and Kanade), as far as the way back leads to the start.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float32, Int, UInt8

SIDE: Final = 640
"""Longest side of the pictures that are compared; lengths in pixels are of such a picture."""
_SIFT: Final = 1000
_CONTRAST: Final = 0.004
"""SIFT's threshold; its default of 0.04 leaves few features on the walls of rooms."""
_RATIO: Final = 0.8
"""Distance of a feature's match relative to the second nearest feature's."""
_CORNERS: Final = 500
_CELL_PX: Final = 20.0
"""Of the features in a cell of so many pixels the one is followed on that was followed longest: with all of them,
cameras took five times as long, and were turned wrong by 5.3 degrees instead of 3.4 (mean of 11 captures)."""
_APART_PX: Final = 12.0
"""Pixels between a corner and other features."""
_ROUND_TRIP_PX: Final = 1.0
"""Greatest distance between a feature and where the way to the next picture and back ends."""
_WINDOW: Final = (21, 21)
_LEVELS: Final = 4


@dataclass(frozen=True, eq=False)
class Features:
    """Features of a picture.

    Attributes:
        pixels: (column, row); centres at half integers.
        descriptors: Of the first features, unit vectors; the others are only followed.
        tracks: The same number in all pictures through which a feature was followed.
    """

    pixels: Float32[np.ndarray, "n 2"]
    descriptors: Float32[np.ndarray, "s 128"]
    tracks: Int[np.ndarray, " n"]


class FeatureTracker:
    """Finds the features of a video's pictures in order, and follows them from picture to picture."""

    def __init__(self) -> None:
        self._sift = cv2.SIFT.create(_SIFT, contrastThreshold=_CONTRAST)
        self._last: tuple[Features, UInt8[np.ndarray, "h w"]] | None = None
        self._tracks = 0

    def features(self, grey: UInt8[np.ndarray, "h w"]) -> Features:
        """Return the features of the next picture."""
        points, counts = self._sift.detectAndCompute(grey, None)
        own = np.array([point.pt for point in points], np.float32).reshape(-1, 2)
        followed, old = self._followed(grey)
        free, apart = np.full(grey.shape, 255, np.uint8), round(_APART_PX * _unit(grey))
        for x, y in np.concatenate([own, followed]).astype(int).tolist():
            cv2.circle(free, (x, y), apart, 0, -1)
        corners = cv2.goodFeaturesToTrack(grey, _CORNERS, 0.005, apart, mask=free)
        # OpenCV returns None for none
        new = corners[:, 0] if np.size(corners) > 1 else np.zeros((0, 2), np.float32)
        descriptors = np.zeros((0, 128), np.float32)
        if len(own):
            descriptors = np.sqrt(counts / np.maximum(counts.sum(axis=1, keepdims=True), 1e-6))  # RootSIFT
        tracks = self._tracks + np.arange(len(own) + len(new))
        self._tracks += len(tracks)
        pixels = np.concatenate([own, new, followed]) + np.float32(0.5)
        result = Features(pixels, descriptors, np.concatenate([tracks, old]))
        self._last = result, grey
        return result

    def _followed(self, grey: UInt8[np.ndarray, "h w"]) -> tuple[Float32[np.ndarray, "n 2"], Int[np.ndarray, " n"]]:
        """Return where the last picture's features are now, and their tracks."""
        if self._last is None or self._last[1].shape != grey.shape or len(self._last[0].pixels) == 0:
            return np.zeros((0, 2), np.float32), np.zeros(0, np.int64)
        last, before = self._last
        start = last.pixels - np.float32(0.5)
        there, there_is, _ = cv2.calcOpticalFlowPyrLK(before, grey, start, start.copy(), None, None, _WINDOW, _LEVELS)
        back, back_is, _ = cv2.calcOpticalFlowPyrLK(grey, before, there, there.copy(), None, None, _WINDOW, _LEVELS)
        good = ((there >= 0) & (there < np.array(grey.shape[::-1]))).all(axis=1)
        good &= (there_is[:, 0] > 0) & (back_is[:, 0] > 0)
        good &= np.linalg.norm(back - start, axis=1) < _ROUND_TRIP_PX * _unit(grey)
        order = np.flatnonzero(good)[np.argsort(last.tracks[good])]
        cells = np.floor(there[order] / (_CELL_PX * _unit(grey)))
        oldest = order[np.unique(cells, axis=0, return_index=True)[1]]
        return there[oldest], last.tracks[oldest]


def _unit(grey: UInt8[np.ndarray, "h w"]) -> float:
    return max(grey.shape) / SIDE


def matched(first: Features, second: Features) -> Int[np.ndarray, "k 2"]:
    """Return pairs of features of two pictures that are clearly each other's nearest, or of the same track."""
    same = np.stack(np.intersect1d(first.tracks, second.tracks, return_indices=True)[1:], axis=1)
    pairs = np.concatenate([_alike(first.descriptors, second.descriptors), same])
    return pairs[np.unique(pairs[:, 0], return_index=True)[1]]


def _alike(first: Float32[np.ndarray, "n 128"], second: Float32[np.ndarray, "m 128"]) -> Int[np.ndarray, "k 2"]:
    if min(len(first), len(second)) < 2:
        return np.zeros((0, 2), np.int64)
    like = first @ second.T
    there, back = like.argmax(axis=1), like.argmax(axis=0)
    rows = np.arange(len(there))
    nearest = like[rows, there]
    like[rows, there] = -1
    # descriptors are unit vectors: squared distance = 2 - 2 cosine
    clear = (1 - nearest) < _RATIO**2 * (1 - like.max(axis=1))
    kept = np.flatnonzero(clear & (back[there] == rows))
    return np.stack([kept, there[kept]], axis=1)
