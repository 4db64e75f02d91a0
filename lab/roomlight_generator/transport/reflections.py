"""Reflections: the coats' specular lobes and panes.

Frames: world, y up, metres; radiance in kcd/m2. A lobe is sampled by the lights and by reflected rays, joined by the
balance heuristic. Surfaces that a ray meets are lit from the irradiance cache, as if their own coats' lobes were even.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from jaxtyping import Float32, Int64

from roomlight_generator.transport.irradiance_cache import IrradianceCache
from roomlight_generator.transport.kernels import glossy
from roomlight_generator.transport.kernels.structs import (
    LightScratch,
    LobeRays,
    LobeSampling,
    allocated,
)
from roomlight_generator.transport.lights.direct import ShadowRays
from roomlight_generator.transport.paths import Paths, Surfaces, follow_view, surfaces_of

LOBE_RAYS: Final = 1
LOBE_CANDIDATES: Final = 10
LOBE_PICKS: Final = 2

FAINT: Final = 0.15
FAINT_WIDTH: Final = 4.0
STRONG_WIDTH: Final = 1.5
"""Width in pixels of the cells that light reflected surfaces; wider where a surface reflects a FAINT share."""

LOBE_WIDENING: Final = 0.5
"""Growth of a reflection's footprint per metre, as a share of alpha; the rays' spread adds the rest of the blur."""

Shares = Callable[[Paths], tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]]


class Reflections:
    """Renders the reflections of a room's surfaces."""

    def __init__(self, irradiance_cache: IrradianceCache) -> None:
        self.irradiance_cache = irradiance_cache
        self.tracer, self.light = irradiance_cache.tracer, irradiance_cache.light

    def panes(self, paths: Paths, pixel_angle: float) -> Float32[np.ndarray, "p 3"]:
        """Return the radiance that the paths' panes reflect, times their share; pixel_angle is in radians."""
        share = paths.pane_share
        wider = np.where(share < FAINT, FAINT_WIDTH, STRONG_WIDTH).astype(np.float32) * np.float32(pixel_angle)
        width = paths.pane_length_m * wider
        return self._seen(paths.pane_origin, paths.pane_direction, width, wider) * share[:, None]

    def sky(self, directions: Float32[np.ndarray, "n 3"], *, show_sun: bool) -> Float32[np.ndarray, "n 3"]:
        """Return the sky's radiance along rays, with the sun's disc or without."""
        outdoors = self.light.outdoors
        out = np.zeros_like(directions)
        glossy.add_sky(outdoors.panorama, directions, np.ones(len(directions), np.float32), out)
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
        """Return the radiance along reflected rays.

        Args:
            width_m: Width of each ray where it starts.
            widening: Growth of the width a metre.
            shares: Gives the shares of each ray that are kept of light straight from lights and the sky, and of the
                sun's direct light on surfaces.
        """
        paths = follow_view(self.tracer, origins, directions)
        width = (width_m + paths.length_m * widening).astype(np.float32)
        points = surfaces_of(self.tracer, paths.ends, width)
        received, sun = self.irradiance_cache.irradiance(points)
        lights = np.ones(len(origins), np.float32)
        if shares is not None:
            lights, spots = shares(paths)
            received = received - (1 - spots[points.ray, None]) * sun
        out = np.zeros((len(origins), 3), np.float32)
        light = points.reflected(received, np.ones(len(received), bool))
        out[points.ray] = light + points.emission * lights[points.ray, None]
        sky = np.flatnonzero(paths.ends.face < 0)
        out[sky] = self.sky(paths.ends.direction[sky], show_sun=False) * lights[sky, None]
        return out * paths.share[:, None]

    def lobes(self, points: Surfaces, at: Int64[np.ndarray, " k"], *, seed: int) -> Float32[np.ndarray, "k 3"]:
        """Return the specular reflections of the coats of some points, of which there are any, all with a coat."""
        tracer, light = self.tracer, self.light
        points = points.part(at)
        lobe, view = self.irradiance_cache.room_cache.points(points, points.ray.astype(np.int64)), points.view
        sampling = LobeSampling(LOBE_RAYS, LOBE_CANDIDATES, LOBE_PICKS, seed)
        shadow = allocated(ShadowRays, len(at) * (LOBE_PICKS + 1))
        totals = np.empty(len(at), np.float64)
        scratch = LightScratch.empty(len(light.lights.start), LOBE_CANDIDATES)
        written = glossy.lobe_lights(light.sources, lobe, view, light.visibility, sampling, scratch, shadow, totals)
        seen = tracer.visible(shadow.origin[:written], shadow.direction[:written], shadow.reach[:written])
        scattered = np.zeros((len(at), 3), np.float32)
        glossy.add_scattered(shadow, seen, written, scattered)
        reflected = allocated(LobeRays, len(at) * LOBE_RAYS)
        glossy.lobe_rays(lobe, view, LOBE_RAYS, seed, reflected)

        def shares(paths: Paths) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
            length, mirrored = paths.length_m, paths.mirrors > 0
            kept, sampled = np.empty_like(length), np.empty_like(length)
            glossy.lobe_share(
                light.sources, lobe, light.visibility, totals, sampling, reflected, paths.ends, length, mirrored, kept
            )
            glossy.spot_shares(lobe.alpha, length, LOBE_RAYS, sampled)
            return kept, np.where(mirrored, np.float32(1), 1 - sampled)

        gain = reflected.weight
        width = np.repeat(points.foot_m, LOBE_RAYS) * np.where(gain < FAINT, FAINT_WIDTH, STRONG_WIDTH)
        widening = np.repeat(lobe.alpha, LOBE_RAYS) * np.float32(LOBE_WIDENING)
        start = np.repeat(lobe.position, LOBE_RAYS, axis=0)
        radiance = self._seen(start, reflected.direction, width.astype(np.float32), widening, shares) * gain[:, None]
        return scattered + radiance.reshape(-1, LOBE_RAYS, 3).mean(1)
