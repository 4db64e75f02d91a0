"""Pictures of a room from one point: rays lit from the irradiance cache, smoothed within surfaces, more at edges.

Frames: world, y up, metres; radiance in kcd/m2. Only the sun's own light has edges sharper than a cell of the cache: it
gets a shadow ray for every ray of the picture.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, Int64, UInt8

from roomlight_generator.transport.grid import SHARP, Grid
from roomlight_generator.transport.irradiance_cache import IrradianceCache
from roomlight_generator.transport.lights.direct import Points
from roomlight_generator.transport.paths import Paths, Surfaces, follow_view, surfaces_of
from roomlight_generator.transport.reflections import Reflections

EXTRA_RAYS: Final = 3
"""Rays added in pixels on edges."""

_EXTRA_PLACES: Final = np.array([[-0.33, 0.1], [0.1, -0.33], [0.27, 0.27]])
"""Places in the pixel (row, column, from its middle). With the middle they cover its rows and columns of thirds."""

RaysAt = Callable[[Float[np.ndarray, " n"], Float[np.ndarray, " n"]], Float32[np.ndarray, "n 3"]]
"""Returns unit world directions through places (row, column) of a picture; pixel centres are at half integers."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A picture's viewpoint.

    Attributes:
        origin: World, metres.
        pixel_angle: Width of a pixel in radians.
        dark_faces: Faces shown without their emission, except in mirrors.
    """

    origin: Float[np.ndarray, "3"]
    rays_at: RaysAt
    shape: tuple[int, int]
    pixel_angle: float
    dark_faces: Bool[np.ndarray, " f"] | None = None
    show_sun: bool = True


@dataclass(frozen=True, eq=False)
class Picture:
    """Radiance, distance to the first surface (inf without) and its class, panes and mirrors included."""

    radiance: Float32[np.ndarray, "h w 3"]
    distance_m: Float32[np.ndarray, "h w"]
    surface: UInt8[np.ndarray, "h w"]


class Viewer:
    """Renders pictures of one room."""

    def __init__(
        self, irradiance_cache: IrradianceCache, *, view_cache: IrradianceCache | None = None, lobe_passes: int = 1
    ) -> None:
        """Take a solved room.

        `irradiance_cache` is the light of the surfaces that reflections show, `view_cache` that of the surfaces that
        pictures show (default: the same). Coats' reflections are the mean of `lobe_passes` passes.
        """
        self.irradiance_cache = irradiance_cache
        self.tracer, self.light = irradiance_cache.tracer, irradiance_cache.light
        self._view_cache, self._lobe_passes = view_cache or irradiance_cache, lobe_passes
        self.reflections = Reflections(irradiance_cache)

    def picture(self, camera: Camera, *, seed: int) -> Picture:
        """Render a picture of height x width rays and more at edges."""
        height, width = camera.shape
        row, column = np.divmod(np.arange(height * width), width)
        paths, points = self._surfaces(camera, row + 0.5, column + 0.5)
        alpha = points.alpha
        grid = Grid(camera.shape, points, self._kinds(points, paths.mirrors))
        received = grid.smooth_received(self._received(points))
        coated = np.flatnonzero((alpha > 0) & _sparse(row[points.ray], column[points.ray], alpha))
        lobe, known = np.zeros_like(received), alpha <= 0
        if len(coated):
            passes = (self.reflections.lobes(points, coated, seed=seed + k) for k in range(self._lobe_passes))
            lobe[coated] = sum(passes) / np.float32(self._lobe_passes)
            known[coated] = True
            lobe, known = grid.smooth_lobes(lobe, known)
        received = received + self._sunlight(points, seed)
        image = self._composed(paths, points, received, lobe, ~known, camera).reshape(height, width, 3)
        surface = paths.surface.reshape(camera.shape)
        edge = grid.edges(image) | (surface != np.roll(surface, 1, axis=1))
        pixel = np.repeat(np.flatnonzero(edge), EXTRA_RAYS)
        if len(pixel):
            image = self._refined(image, grid, pixel, camera, seed)
        return Picture(image, paths.distance_m.reshape(camera.shape), surface)

    def _refined(
        self, image: Float32[np.ndarray, "h w 3"], grid: Grid, pixel: Int64[np.ndarray, " n"], camera: Camera, seed: int
    ) -> Float32[np.ndarray, "h w 3"]:
        """Add rays to the picture at jittered places in some pixels; a pixel is listed `EXTRA_RAYS` times."""
        height, width = camera.shape
        row, column = np.divmod(pixel, width)
        rng = np.random.default_rng([seed, 5])
        place = np.tile(_EXTRA_PLACES, (len(pixel) // EXTRA_RAYS, 1)) + rng.uniform(-0.16, 0.16, (len(pixel), 2))
        paths, points = self._surfaces(camera, row + 0.5 + place[:, 0], column + 0.5 + place[:, 1])
        kinds = self._kinds(points, paths.mirrors)
        received, lobe, was_borrowed = grid.borrowed(points, kinds, row[points.ray], column[points.ray])
        alone = np.flatnonzero(~was_borrowed)
        received[alone] = self._received(points.part(alone))
        received += self._sunlight(points, seed + 1)
        radiance = self._composed(paths, points, received, lobe, ~was_borrowed, camera)
        total, weight = image.reshape(-1, 3).copy(), np.ones(height * width, np.float32)
        edge = pixel[::EXTRA_RAYS]
        weight[edge] += EXTRA_RAYS
        for k in range(EXTRA_RAYS):
            total[edge] += radiance[k::EXTRA_RAYS]
        return (total / weight[:, None]).reshape(height, width, 3)

    def _surfaces(
        self, camera: Camera, row: Float[np.ndarray, " n"], column: Float[np.ndarray, " n"]
    ) -> tuple[Paths, Surfaces]:
        """Trace rays through places of the picture to the surfaces that they show."""
        directions = camera.rays_at(row, column)
        origins = np.broadcast_to(np.asarray(camera.origin, np.float32), directions.shape).copy()
        paths = follow_view(self.tracer, origins, directions)
        foot = paths.length_m * np.float32(camera.pixel_angle)
        return paths, surfaces_of(self.tracer, paths.ends, foot)

    def _received(self, points: Surfaces) -> Float32[np.ndarray, "m 3"]:
        """Return the irradiance of points, without what comes straight from the sun."""
        received, sun = self._view_cache.irradiance(points)
        return received - sun

    def _sunlight(self, points: Surfaces, seed: int) -> Float32[np.ndarray, "m 3"]:
        unknown = np.full(len(points.alpha), -1, np.int32)
        stream = np.arange(len(unknown), dtype=np.int64)
        lit = Points(points.position, points.normal, points.geometric_normal, points.alpha, unknown, stream)
        return self.light.sunlight(lit, seed=seed)

    def _kinds(self, points: Surfaces, mirrors: UInt8[np.ndarray, " n"]) -> Int32[np.ndarray, " m"]:
        """Combine material and mirrors on the way into a number, equal for pixels that show one surface."""
        return points.material + mirrors[points.ray].astype(np.int32) * np.int32(len(self.tracer.materials.mirror))

    def _emission(self, points: Surfaces, paths: Paths, camera: Camera) -> Float32[np.ndarray, "m 3"]:
        if camera.dark_faces is None:
            return points.emission
        dark = camera.dark_faces[points.face] & (paths.mirrors[points.ray] == 0)
        return np.where(dark[:, None], np.float32(0), points.emission)

    def _composed(
        self,
        paths: Paths,
        points: Surfaces,
        received: Float32[np.ndarray, "m 3"],
        lobe: Float32[np.ndarray, "m 3"],
        even_lobe: Bool[np.ndarray, " m"],
        camera: Camera,
    ) -> Float32[np.ndarray, "n 3"]:
        """Sum each ray's radiance: surface or sky, less what panes and mirrors take, plus what panes reflect."""
        out = np.zeros((len(paths.share), 3), np.float32)
        out[points.ray] = points.reflected(received, even_lobe) + lobe + self._emission(points, paths, camera)
        sky = np.flatnonzero(paths.ends.face < 0)
        out[sky] = self.reflections.sky(paths.ends.direction[sky], show_sun=camera.show_sun)
        out *= paths.share[:, None]
        if len(paths.pane_ray):
            np.add.at(out, paths.pane_ray, self.reflections.panes(paths, camera.pixel_angle))
        return out


def _sparse(
    row: Int64[np.ndarray, " n"], column: Int64[np.ndarray, " n"], alpha: Float32[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Select the pixels whose lobes are sampled: half of the sharp ones, a quarter of the rough; smoothing fills in."""
    return np.where(alpha < SHARP, (row + column) % 2 == 0, (column + 2 * row) % 4 == 0)
