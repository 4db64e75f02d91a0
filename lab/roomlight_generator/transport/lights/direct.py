"""Direct light at surface points, by shadow rays.

Frames: world, y up, metres; irradiance in kcd/m2 times steradians (linear RGB).
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32, Int64, UInt8

from roomlight_generator.transport.kernels import lights as kernels
from roomlight_generator.transport.kernels.structs import LightScratch, ShadowSampling, allocated
from roomlight_generator.transport.lights.coat import coat_table
from roomlight_generator.transport.lights.emitters import build_lights
from roomlight_generator.transport.tracer import FAR_M, Tracer

_RAYS_AT_ONCE: Final = 1 << 16
"""Shadow rays of a batch: few enough that their arrays stay in the second-level cache."""


class Points(NamedTuple):
    """Surface points to be lit.

    Attributes:
        position: Positions, off the surface on the side that is lit.
        normal: Shading normals, on that side.
        geometric_normal: The triangles' normals, on that side.
        alpha: Roughness of the coat (0: none).
        row: Row of the visibility table (-1: unknown).
        stream: Number that seeds a point's random numbers.
    """

    position: Float32[np.ndarray, "n 3"]
    normal: Float32[np.ndarray, "n 3"]
    geometric_normal: Float32[np.ndarray, "n 3"]
    alpha: Float32[np.ndarray, " n"]
    row: Int32[np.ndarray, " n"]
    stream: Int64[np.ndarray, " n"]

    def part(self, start: int, stop: int) -> "Points":
        """Return the points from `start` to before `stop`, as views."""
        return Points(*(column[start:stop] for column in self))


class Received(NamedTuple):
    """Irradiance of points, and the part of it that their coats let through.

    sun and sun_coated are the parts of both that the sun sends straight through an opening; its light elsewhere comes
    from spots.
    """

    irradiance: Float32[np.ndarray, "n 3"]
    coated: Float32[np.ndarray, "n 3"]
    sun: Float32[np.ndarray, "n 3"]
    sun_coated: Float32[np.ndarray, "n 3"]


class ShadowRays(NamedTuple):
    """Rays toward lights: the point of each ray, and the light that it carries if nothing stands between."""

    owner: Int32[np.ndarray, " n"]
    origin: Float32[np.ndarray, "n 3"]
    direction: Float32[np.ndarray, "n 3"]
    reach: Float32[np.ndarray, " n"]
    weight: Float32[np.ndarray, "n 3"]
    passed: Float32[np.ndarray, " n"]
    cluster: Int32[np.ndarray, " n"]


OnRays = Callable[[int, ShadowRays, Bool[np.ndarray, " n"], int], None]
"""Called with the first point's index, the rays, their visibility, and the number of rays."""


class DirectLight:
    """The lights of a scene, and their visibility from each part of the room, in 255ths."""

    visibility: UInt8[np.ndarray, "rows l"]

    def __init__(self, tracer: Tracer) -> None:
        """Collect the lights; all count as visible until `visibility` is set."""
        self.tracer = tracer
        self.sources = build_lights(tracer)
        self.lights, self.outdoors = self.sources.lights, self.sources.outdoors
        self.coat = coat_table()
        self.visibility = np.full((1, max(1, len(self.lights.start))), 255, np.uint8)

    def received(
        self,
        points: Points,
        *,
        candidates: int,
        picks: int,
        sun_picks: int,
        seed: int,
        sun_outside: bool = False,
        on_rays: OnRays | None = None,
    ) -> Received:
        """Compute each point's irradiance from the lights, sunlit spots among them.

        Args:
            candidates, picks, sun_picks, seed: As in `ShadowSampling`.
            sun_outside: Count sunlight that passed no opening (on a sill) as part of the sun's light.
            on_rays: Called with each batch of shadow rays.
        """
        count = len(points.position)
        out = Received(*(np.zeros((count, 3), np.float32) for _ in range(4)))
        step = max(1, _RAYS_AT_ONCE // (picks + sun_picks))
        rays = allocated(ShadowRays, min(step, max(count, 1)) * (picks + sun_picks))
        sampling = ShadowSampling(candidates, picks, sun_picks, seed)
        scratch = LightScratch.empty(len(self.lights.start), candidates)
        tracer = self.tracer
        for start in range(0, count, step):
            some = points.part(start, start + step)
            written = kernels.shadow_rays(
                self.sources, self.coat.through, some, self.visibility, sampling, scratch, rays
            )
            seen = tracer.visible(rays.origin[:written], rays.direction[:written], rays.reach[:written])
            part = Received(*(column[start : start + step] for column in out))
            kernels.add_visible(rays, seen, written, sun_outside, part)
            if on_rays is not None:
                on_rays(start, rays, seen, written)
        return out

    def sunlight(self, points: Points, *, seed: int) -> Float32[np.ndarray, "n 3"]:
        """Compute irradiance straight from the sun by one ray a point, as let through by the points' coats."""
        count = len(points.position)
        out = np.zeros((count, 3), np.float32)
        if self.outdoors.sun_irradiance.max() <= 0:
            return out
        rays = allocated(ShadowRays, count)
        written = kernels.sun_rays(self.outdoors, self.coat.through, points, seed, rays)
        reach = np.full(written, FAR_M, np.float32)
        seen = self.tracer.visible(rays.origin[:written], rays.direction[:written], reach)
        out[rays.owner[:written][seen]] = rays.weight[:written][seen]
        return out
