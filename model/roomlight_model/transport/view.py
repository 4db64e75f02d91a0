"""Pictures of a room from one point: a grid of rays, shaded from the cells, smoothed within surfaces, with extra rays
at edges.

Frames: world, y up, metres; radiance in kcd/m2.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, Int64, UInt8

from roomlight_model.transport.cells import Cells
from roomlight_model.transport.direct import DirectLight
from roomlight_model.transport.kernels import glossy, images
from roomlight_model.transport.kernels.cells import diffuse_light
from roomlight_model.transport.kernels.patches import find_points
from roomlight_model.transport.paths import Paths, Surfaces, follow_view, surfaces_of
from roomlight_model.transport.tracer import Tracer

LOBE_RAYS: Final = 1
LOBE_CANDIDATES: Final = 10
LOBE_PICKS: Final = 2

SHARP: Final = 0.1
"""Reflections of a lower alpha have edges that smoothing must keep."""

EXTRA_RAYS: Final = 3
"""Rays added in pixels on edges."""

FAINT: Final = 0.15
FAINT_WIDTH: Final = 4.0
STRONG_WIDTH: Final = 1.5
"""What reflections show is lit from cells so many pixels wide; wider where the surface reflects a FAINT share."""

LOBE_WIDENING: Final = 0.5
"""A reflection's footprint grows by so much of alpha a metre: the spread of its few rays does the rest."""

RaysAt = Callable[[Float[np.ndarray, " n"], Float[np.ndarray, " n"]], Float32[np.ndarray, "n 3"]]
"""Unit world directions through places (row, column) of a picture; pixel centres are at half integers."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Radiance, distance to the first surface (inf without) and its class, pane and mirror included."""

    radiance: Float32[np.ndarray, "h w 3"]
    distance_m: Float32[np.ndarray, "h w"]
    surface: UInt8[np.ndarray, "h w"]


class Viewer:
    """Draws pictures of one room."""

    def __init__(self, tracer: Tracer, light: DirectLight, cells: Cells) -> None:
        """Take a solved room."""
        self.tracer, self.light, self.cells = tracer, light, cells
        self._coat = tuple(light.coat)
        self._roughness = tracer.materials.roughness

    def picture(
        self,
        origin: Float[np.ndarray, "3"],
        rays_at: RaysAt,
        shape: tuple[int, int],
        *,
        pixel_angle: float,
        seed: int,
        dark_faces: Bool[np.ndarray, " f"] | None = None,
        show_sun: bool = True,
    ) -> Picture:
        """A picture of height x width rays and more at edges.

        pixel_angle is a pixel's width in radians. dark_faces are seen without their emission (but not in mirrors).
        """
        height, width = shape
        rng = np.random.default_rng([seed, 5])
        row, column = np.divmod(np.arange(height * width), width)
        directions = rays_at(row + 0.5, column + 0.5)
        origins = np.broadcast_to(np.asarray(origin, np.float32), directions.shape).copy()
        paths = follow_view(self.tracer, origins, directions)
        points = surfaces_of(
            self.tracer, paths.face, paths.u, paths.v, paths.direction, paths.length_m * np.float32(pixel_angle)
        )
        received = self._received(points)
        lobe = self._lobe(points, seed)
        grid = _Grid(
            shape, points, self._kinds(points, paths.mirrors), received, lobe, self._roughness[points.material]
        )
        received, lobe = grid.smoothed(bool((self._roughness[points.material] > 0).any()))
        emission = self._emission(points, paths, dark_faces)
        nothing = np.zeros(len(points.ray), bool)
        radiance = self._composed(paths, points, received, lobe, emission, nothing, pixel_angle, show_sun)
        image = radiance.reshape(height, width, 3)
        edge = grid.edges(image)
        edge |= paths.surface.reshape(shape) != np.roll(paths.surface.reshape(shape), 1, axis=1)
        pixel = np.repeat(np.flatnonzero(edge), EXTRA_RAYS)
        if len(pixel):
            image = self._refined(image, grid, pixel, rng, origin, rays_at, pixel_angle, dark_faces, show_sun)
        return Picture(image, paths.distance_m.reshape(shape), paths.surface.reshape(shape))

    def _refined(
        self,
        image: Float32[np.ndarray, "h w 3"],
        grid: "_Grid",
        pixel: Int64[np.ndarray, " n"],
        rng: np.random.Generator,
        origin: Float[np.ndarray, "3"],
        rays_at: RaysAt,
        pixel_angle: float,
        dark_faces: Bool[np.ndarray, " f"] | None,
        show_sun: bool,
    ) -> Float32[np.ndarray, "h w 3"]:
        """The picture with more rays in some pixels, at jittered places of a rotated grid."""
        height, width = image.shape[:2]
        row, column = np.divmod(pixel, width)
        offsets = np.array([[-0.33, 0.1], [0.1, -0.33], [0.27, 0.27]])
        place = np.tile(offsets, (len(pixel) // EXTRA_RAYS, 1)) + rng.uniform(-0.16, 0.16, (len(pixel), 2))
        directions = rays_at(row + 0.5 + place[:, 0], column + 0.5 + place[:, 1])
        origins = np.broadcast_to(np.asarray(origin, np.float32), directions.shape).copy()
        paths = follow_view(self.tracer, origins, directions)
        points = surfaces_of(
            self.tracer, paths.face, paths.u, paths.v, paths.direction, paths.length_m * np.float32(pixel_angle)
        )
        kinds = self._kinds(points, paths.mirrors)
        received, lobe, found = grid.borrowed(points, kinds, row[points.ray], column[points.ray])
        alone = np.flatnonzero(~found)
        received[alone] = self._received(points, alone)
        emission = self._emission(points, paths, dark_faces)
        radiance = self._composed(paths, points, received, lobe, emission, ~found, pixel_angle, show_sun)
        total, weight = image.reshape(-1, 3).copy(), np.ones(height * width, np.float32)
        images.add_rays(total, weight, pixel, radiance)
        return (total / weight[:, None]).reshape(height, width, 3)

    def _received(self, points: Surfaces, some: Int64[np.ndarray, " k"] | None = None) -> Float32[np.ndarray, "_ 3"]:
        at = slice(None) if some is None else some
        received, _ = self.cells.irradiance(
            points.position[at], points.normal[at], points.wound[at], points.face[at], foot_m=points.foot_m[at]
        )
        return received

    def _kinds(self, points: Surfaces, mirrors: UInt8[np.ndarray, " n"]) -> Int32[np.ndarray, " m"]:
        """What must be equal for two pixels to show one surface: material and mirrors on the way."""
        return points.material + mirrors[points.ray].astype(np.int32) * np.int32(len(self._roughness))

    def _emission(
        self, points: Surfaces, paths: Paths, dark_faces: Bool[np.ndarray, " f"] | None
    ) -> Float32[np.ndarray, "m 3"]:
        if dark_faces is None:
            return points.emission
        dark = dark_faces[points.face] & (paths.mirrors[points.ray] == 0)
        return np.where(dark[:, None], np.float32(0), points.emission)

    def _composed(
        self,
        paths: Paths,
        points: Surfaces,
        received: Float32[np.ndarray, "m 3"],
        lobe: Float32[np.ndarray, "m 3"],
        emission: Float32[np.ndarray, "m 3"],
        even_lobe: Bool[np.ndarray, " m"],
        pixel_angle: float,
        show_sun: bool,
    ) -> Float32[np.ndarray, "n 3"]:
        """Radiance of each ray: surface or sky, less what panes and mirrors take, plus what panes reflect."""
        alpha = self._roughness[points.material]
        cosine = np.clip((points.normal * points.view).sum(1), glossy.LEAST_COSINE, 1)
        light = np.empty_like(received)
        diffuse_light(received, points.albedo, alpha, cosine, self._coat, even_lobe, light)
        out = np.zeros((len(paths.face), 3), np.float32)
        out[points.ray] = light + lobe + emission
        sky = np.flatnonzero(paths.face < 0)
        out[sky] = self._sky(paths.direction[sky], show_sun)
        out *= paths.share[:, None]
        if len(paths.pane_ray):
            wider = np.where(paths.pane_share < FAINT, FAINT_WIDTH, STRONG_WIDTH).astype(np.float32) * pixel_angle
            width = paths.pane_length_m * wider
            seen = self._seen(paths.pane_origin, paths.pane_direction, width, wider)
            np.add.at(out, paths.pane_ray, seen * paths.pane_share[:, None])
        return out

    def _sky(self, directions: Float32[np.ndarray, "n 3"], show_sun: bool) -> Float32[np.ndarray, "n 3"]:
        outdoors = self.light.outdoors
        out = np.zeros_like(directions)
        glossy.sky_seen(outdoors.panorama, directions, np.ones(len(directions), np.float32), out)
        if show_sun and outdoors.sun_irradiance.max() > 0:
            disc = outdoors.sun_irradiance / np.float32(np.pi * outdoors.sun_radius**2)
            out[directions @ outdoors.sun_direction > np.cos(outdoors.sun_radius)] += disc
        return out

    def _seen(
        self,
        origins: Float32[np.ndarray, "n 3"],
        directions: Float32[np.ndarray, "n 3"],
        width_m: Float32[np.ndarray, " n"],
        widening: float | Float32[np.ndarray, " n"],
        shares: Callable[[Paths], tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]] | None = None,
    ) -> Float32[np.ndarray, "n 3"]:
        """Radiance along reflected rays, `width_m` wide where they start. shares gives what is kept of the light that
        lights and the sky send straight, and of the sun's direct light on surfaces."""
        paths = follow_view(self.tracer, origins, directions)
        width = (width_m + paths.length_m * widening).astype(np.float32)
        points = surfaces_of(self.tracer, paths.face, paths.u, paths.v, paths.direction, width)
        alpha = self._roughness[points.material]
        cosine = np.clip((points.normal * points.view).sum(1), glossy.LEAST_COSINE, 1)
        received, sun = self.cells.irradiance(
            points.position, points.normal, points.wound, points.face, foot_m=points.foot_m
        )
        lights = np.ones(len(origins), np.float32)
        if shares is not None:
            lights, spots = shares(paths)
            received = received - (1 - spots[points.ray, None]) * sun
        light = np.empty_like(received)
        diffuse_light(received, points.albedo, alpha, cosine, self._coat, np.ones(len(alpha), bool), light)
        out = np.zeros((len(origins), 3), np.float32)
        out[points.ray] = light + points.emission * lights[points.ray, None]
        sky = np.flatnonzero(paths.face < 0)
        out[sky] = self._sky(paths.direction[sky], False) * lights[sky, None]
        return out * paths.share[:, None]

    def _lobe(self, points: Surfaces, seed: int) -> Float32[np.ndarray, "m 3"]:
        """What the coats of the points reflect specularly."""
        out = np.zeros((len(points.ray), 3), np.float32)
        alpha = self._roughness[points.material]
        at = np.flatnonzero(alpha > 0)
        if len(at) == 0:
            return out
        tracer, light = self.tracer, self.light
        alpha, view = alpha[at], points.view[at]
        position, normal, wound = points.position[at], points.normal[at], points.wound[at]
        number = points.ray[at].astype(np.int64)
        visible_row = np.empty(len(at), np.int32)
        find_points(self.cells.cache.table, position, wound, points.material[at], points.face[at], visible_row)
        rays = len(at) * (LOBE_PICKS + 1)
        owner, reach = np.empty(rays, np.int32), np.empty(rays, np.float32)
        origin, toward, weight = (np.empty((rays, 3), np.float32) for _ in range(3))
        totals = np.empty(len(at), np.float64)
        written = glossy.lobe_lights(
            light.lights,
            light.outdoors,
            tracer.atlas,
            position,
            normal,
            wound,
            view,
            alpha,
            visible_row,
            number,
            light.vis,
            LOBE_RAYS,
            LOBE_CANDIDATES,
            LOBE_PICKS,
            seed,
            owner,
            origin,
            toward,
            reach,
            weight,
            totals,
        )
        seen = tracer.visible(origin[:written], toward[:written], reach[:written])
        found = np.zeros((len(at), 3), np.float32)
        glossy.scattered(owner, weight, seen, written, found)
        direction = np.empty((len(at) * LOBE_RAYS, 3), np.float32)
        gain, density = (np.empty(len(at) * LOBE_RAYS, np.float32) for _ in range(2))
        glossy.lobe_rays(normal, wound, view, alpha, number, LOBE_RAYS, seed, direction, gain, density)

        def shares(paths: Paths) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
            kept, sampled = np.empty(len(paths.face), np.float32), np.empty(len(paths.face), np.float32)
            mirrored = paths.mirrors > 0
            glossy.lobe_share(
                light.lights,
                light.outdoors,
                light.vis,
                visible_row,
                position,
                normal,
                totals,
                LOBE_RAYS,
                LOBE_CANDIDATES,
                paths.face,
                paths.u,
                paths.v,
                paths.length_m,
                direction,
                density,
                mirrored,
                kept,
            )
            glossy.spot_shares(alpha, paths.length_m, LOBE_RAYS, sampled)
            return kept, np.where(mirrored, np.float32(1), 1 - sampled)

        width = np.repeat(points.foot_m[at], LOBE_RAYS) * np.where(gain < FAINT, FAINT_WIDTH, STRONG_WIDTH)
        widening = np.repeat(alpha, LOBE_RAYS) * np.float32(LOBE_WIDENING)
        start = np.repeat(position, LOBE_RAYS, axis=0)
        reflected = self._seen(start, direction, width.astype(np.float32), widening, shares) * gain[:, None]
        out[at] = found + reflected.reshape(-1, LOBE_RAYS, 3).mean(1)
        return out


class _Grid:
    """Surface points laid out as the picture, with what they received."""

    def __init__(
        self,
        shape: tuple[int, int],
        points: Surfaces,
        kinds: Int32[np.ndarray, " m"],
        received: Float32[np.ndarray, "m 3"],
        lobe: Float32[np.ndarray, "m 3"],
        alpha: Float32[np.ndarray, " m"],
    ) -> None:
        self._ray = points.ray
        self._shape = shape
        self._lobe_spread = np.ones(shape, np.float32)
        self._lobe_spread.reshape(-1)[points.ray] = np.where(alpha < SHARP, 3, 1000)
        self.kind = np.full(shape, -1, np.int32)
        self.kind.reshape(-1)[points.ray] = kinds
        self.foot = np.ones(shape, np.float32)
        self.foot.reshape(-1)[points.ray] = points.foot_m
        self.position, self.normal = self._laid(points.position), self._laid(points.normal)
        self.received, self.lobe = self._laid(received), self._laid(lobe)

    def _laid(self, values: Float32[np.ndarray, "m 3"]) -> Float32[np.ndarray, "h w 3"]:
        out = np.zeros((*self._shape, 3), np.float32)
        out.reshape(-1, 3)[self._ray] = values
        return out

    def smoothed(self, coated: bool) -> tuple[Float32[np.ndarray, "m 3"], Float32[np.ndarray, "m 3"]]:
        """Smooth what the points received and reflect; returns both as lists again."""
        even = np.ones(self._shape, np.float32)
        self.received = self._smooth(self._smooth(self.received, even, 1), np.float32(0.5) * even, 2)
        if coated:
            self.lobe = self._smooth(self.lobe, self._lobe_spread, 1)
        return self.received.reshape(-1, 3)[self._ray], self.lobe.reshape(-1, 3)[self._ray]

    def _smooth(
        self, image: Float32[np.ndarray, "h w 3"], spread: Float32[np.ndarray, "h w"], step: int
    ) -> Float32[np.ndarray, "h w 3"]:
        out = np.empty_like(image)
        images.smooth(image, self.position, self.normal, self.kind, self.foot, spread, step, out)
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
