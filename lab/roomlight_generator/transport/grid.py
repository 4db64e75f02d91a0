"""Surface points laid out as a picture: smoothing within surfaces, edges, and light that extra rays borrow from pixels.

Frames: world, y up, metres; radiance in kcd/m2.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float32, Int32, Int64

from roomlight_generator.transport.kernels import images
from roomlight_generator.transport.kernels.structs import Borrowed, ExtraRays, PixelSurfaces
from roomlight_generator.transport.paths import Surfaces

SHARP: Final = 0.1
"""Alpha below which reflections have edges that smoothing must keep."""

OUTSHINES: Final = 3.0
"""Largest ratio of the brightness of a pixel's reflection to that of its surroundings.

A brighter pixel is an outlier that smoothing would spread to a white dot. Highlights are wider than these pixels.
"""

RECEIVES: Final = 1.7
"""The same for a pixel's irradiance, which varies less than reflections: the sun is not in it."""


class Grid:
    """Surface points of a picture (height, width) and the light that they receive and reflect; others are left out."""

    def __init__(self, shape: tuple[int, int], points: Surfaces, kinds: Int32[np.ndarray, " m"]) -> None:
        """Lay out the points by their rays' indices; kinds are equal for pixels that show one surface."""
        self._ray = points.ray
        self._shape = shape
        self._lobe_spread = np.ones(shape, np.float32)
        self._lobe_spread.reshape(-1)[points.ray] = np.where(points.alpha < SHARP, 3, 1000)
        kind = np.full(shape, -1, np.int32)
        kind.reshape(-1)[points.ray] = kinds
        foot = np.ones(shape, np.float32)
        foot.reshape(-1)[points.ray] = points.foot_m
        self.surfaces = PixelSurfaces(kind, self._laid_out(points.position), self._laid_out(points.normal), foot)
        self.received, self.lobe = np.zeros((*shape, 3), np.float32), np.zeros((*shape, 3), np.float32)

    def smooth_received(self, received: Float32[np.ndarray, "m 3"]) -> Float32[np.ndarray, "m 3"]:
        """Smooth the points' irradiance, and keep it for `borrowed`."""
        known, even = np.ones(self._shape, bool), np.ones(self._shape, np.float32)
        image = self._laid_out(received)
        images.tame(image, self.surfaces.kind, known, RECEIVES)
        image = self._smooth(image, known, np.float32(1.6) * even, 1)
        self.received = self._smooth(image, known, np.float32(0.5) * even, 2)
        return self.received.reshape(-1, 3)[self._ray]

    def smooth_lobes(
        self, lobe: Float32[np.ndarray, "m 3"], known: Bool[np.ndarray, " m"]
    ) -> tuple[Float32[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]:
        """Spread the known points' reflections over their surfaces; return them and the mask of the known points."""
        laid = np.zeros(self._shape, bool)
        laid.reshape(-1)[self._ray] = known
        image = self._laid_out(lobe)
        images.tame(image, self.surfaces.kind, laid, OUTSHINES)
        self.lobe = self._smooth(image, laid, self._lobe_spread, 1)
        return self.lobe.reshape(-1, 3)[self._ray], laid.reshape(-1)[self._ray]

    def _laid_out(self, values: Float32[np.ndarray, "m 3"]) -> Float32[np.ndarray, "h w 3"]:
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
        images.smooth(self.surfaces, image, known, spread, step, out)
        return out

    def edges(self, image: Float32[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
        """Return the pixels that need more rays."""
        out = np.zeros(self._shape, bool)
        images.edges(self.surfaces, image, out)
        return out

    def borrowed(
        self,
        points: Surfaces,
        kinds: Int32[np.ndarray, " m"],
        row: Int64[np.ndarray, " m"],
        column: Int64[np.ndarray, " m"],
    ) -> Borrowed:
        """Return irradiance and reflections at points from neighbouring pixels, and which points got any."""
        out = Borrowed(np.zeros_like(points.position), np.zeros_like(points.position), np.zeros(len(kinds), bool))
        rays = ExtraRays(row, column, kinds, points.position, points.normal)
        images.borrow(self.surfaces, self.received, self.lobe, rays, out)
        return out
