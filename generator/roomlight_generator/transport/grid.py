"""Surface points laid out as a picture: smoothing within surfaces, edges, and what extra rays borrow from pixels."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float32, Int32, Int64

from roomlight_generator.transport.kernels import images
from roomlight_generator.transport.paths import Surfaces

SHARP: Final = 0.1
"""Reflections of a lower alpha have edges that smoothing must keep."""

OUTSHINES: Final = 3.0
"""A pixel's reflection may be so many times as bright as its surroundings': beyond it is a ray's luck, which smoothing
would make a white dot. Highlights are wider than the pixels that this looks at."""

RECEIVES: Final = 1.7
"""The same of what arrives at a pixel: lamplight is smoother than reflections, and the sun is not in it."""


class Grid:
    """Points of a picture with what they received and reflect; pixels that show none are left out."""

    def __init__(
        self,
        shape: tuple[int, int],
        points: Surfaces,
        kinds: Int32[np.ndarray, " m"],
        alpha: Float32[np.ndarray, " m"],
    ) -> None:
        """kinds must be equal for two pixels to show one surface."""
        self._ray = points.ray
        self._shape = shape
        self._lobe_spread = np.ones(shape, np.float32)
        self._lobe_spread.reshape(-1)[points.ray] = np.where(alpha < SHARP, 3, 1000)
        self.kind = np.full(shape, -1, np.int32)
        self.kind.reshape(-1)[points.ray] = kinds
        self.foot = np.ones(shape, np.float32)
        self.foot.reshape(-1)[points.ray] = points.foot_m
        self.position, self.normal = self._laid(points.position), self._laid(points.normal)
        self.received, self.lobe = np.zeros((*shape, 3), np.float32), np.zeros((*shape, 3), np.float32)

    def smooth_received(self, received: Float32[np.ndarray, "m 3"]) -> Float32[np.ndarray, "m 3"]:
        """Smooth what the points received, and keep it to be borrowed."""
        known, even = np.ones(self._shape, bool), np.ones(self._shape, np.float32)
        image = self._laid(received)
        images.tame(image, self.kind, known, RECEIVES)
        image = self._smooth(image, known, np.float32(1.6) * even, 1)
        self.received = self._smooth(image, known, np.float32(0.5) * even, 2)
        return self.received.reshape(-1, 3)[self._ray]

    def smooth_lobes(
        self, lobe: Float32[np.ndarray, "m 3"], known: Bool[np.ndarray, " m"]
    ) -> tuple[Float32[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]:
        """Spread what some of the points reflect over their surfaces; returns it, and which points then have it."""
        laid = np.zeros(self._shape, bool)
        laid.reshape(-1)[self._ray] = known
        image = self._laid(lobe)
        images.tame(image, self.kind, laid, OUTSHINES)
        self.lobe = self._smooth(image, laid, self._lobe_spread, 1)
        return self.lobe.reshape(-1, 3)[self._ray], laid.reshape(-1)[self._ray]

    def _laid(self, values: Float32[np.ndarray, "m 3"]) -> Float32[np.ndarray, "h w 3"]:
        out = np.zeros((*self._shape, 3), np.float32)
        out.reshape(-1, 3)[self._ray] = values
        return out

    def _smooth(
        self,
        image: Float32[np.ndarray, "h w 3"],
        known: Bool[np.ndarray, "h w"],
        spread: Float32[np.ndarray, "h w"],
        step: int,
    ) -> Float32[np.ndarray, "h w 3"]:
        out = np.empty_like(image)
        images.smooth(image, self.position, self.normal, self.kind, self.foot, known, spread, step, out)
        return out

    def edges(self, image: Float32[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
        """Pixels that want more rays."""
        out = np.zeros(self._shape, bool)
        images.edges(self.kind, self.position, self.normal, self.foot, image, out)
        return out

    def borrowed(
        self,
        points: Surfaces,
        kinds: Int32[np.ndarray, " m"],
        row: Int64[np.ndarray, " m"],
        column: Int64[np.ndarray, " m"],
    ) -> tuple[Float32[np.ndarray, "m 3"], Float32[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]:
        """What neighbouring pixels know of the surfaces at these points, and where they know any."""
        received, lobe = np.zeros_like(points.position), np.zeros_like(points.position)
        found = np.zeros(len(kinds), bool)
        images.borrow(
            self.kind,
            self.position,
            self.normal,
            self.foot,
            self.received,
            self.lobe,
            row,
            column,
            kinds,
            points.position,
            points.normal,
            received,
            lobe,
            found,
        )
        return received, lobe, found
