"""What reflections show: the coats' specular lobes and panes.

Frames: world, y up, metres; radiance in kcd/m2. A lobe is sampled by the lights and by reflected rays, joined by the
balance heuristic; what a ray meets is lit from the cells, its own coat's lobe taken as even.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from jaxtyping import Float32, Int64

from roomlight_generator.transport.direct import DirectLight
from roomlight_generator.transport.irradiance_cache import IrradianceCache
from roomlight_generator.transport.kernels import glossy
from roomlight_generator.transport.kernels.irradiance_cache import diffuse_light
from roomlight_generator.transport.kernels.patches import find_points
from roomlight_generator.transport.paths import Paths, Surfaces, follow_view, surfaces_of
from roomlight_generator.transport.tracer import Tracer

LOBE_RAYS: Final = 1
LOBE_CANDIDATES: Final = 10
LOBE_PICKS: Final = 2

FAINT: Final = 0.15
FAINT_WIDTH: Final = 4.0
STRONG_WIDTH: Final = 1.5
"""What reflections show is lit from cells so many pixels wide; wider where the surface reflects a FAINT share."""

LOBE_WIDENING: Final = 0.5
"""A reflection's footprint grows by so much of alpha a metre: the spread of its few rays does the rest."""

Shares = Callable[[Paths], tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]]


class Reflections:
    """Looks along reflected rays of one room."""

    def __init__(self, tracer: Tracer, light: DirectLight, cells: IrradianceCache) -> None:
        """Take a solved room."""
        self.tracer, self.light, self.cells = tracer, light, cells
        self._coat = tuple(light.coat)
        self._roughness = tracer.materials.roughness

    def panes(self, paths: Paths, pixel_angle: float) -> Float32[np.ndarray, "p 3"]:
        """What the paths' panes reflect, times their share."""
        share = paths.pane_share
        wider = np.where(share < FAINT, FAINT_WIDTH, STRONG_WIDTH).astype(np.float32) * np.float32(pixel_angle)
        width = paths.pane_length_m * wider
        return self._seen(paths.pane_origin, paths.pane_direction, width, wider) * share[:, None]

    def sky(self, directions: Float32[np.ndarray, "n 3"], *, show_sun: bool) -> Float32[np.ndarray, "n 3"]:
        """The sky along rays, with the sun's disc or without."""
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
        widening: Float32[np.ndarray, " n"],
        shares: Shares | None = None,
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
        out[sky] = self.sky(paths.direction[sky], show_sun=False) * lights[sky, None]
        return out * paths.share[:, None]

    def lobes(self, points: Surfaces, some: Int64[np.ndarray, " k"], *, seed: int) -> Float32[np.ndarray, "k 3"]:
        """What the coats of some of the points, which all have one, reflect specularly."""
        at = some
        if len(at) == 0:
            return np.zeros((0, 3), np.float32)
        tracer, light = self.tracer, self.light
        alpha = self._roughness[points.material]
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
        return found + reflected.reshape(-1, LOBE_RAYS, 3).mean(1)
