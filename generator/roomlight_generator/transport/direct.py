"""Direct light at surface points, by shadow rays.

Frames: world, y up, metres; irradiance in kcd/m2 times steradians (linear RGB).
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32, Int64, UInt8

from roomlight_generator.transport.coat import CoatTable, coat_table
from roomlight_generator.transport.emitters import Lights, Outdoors, build_lights
from roomlight_generator.transport.kernels import lights as kernels
from roomlight_generator.transport.tracer import FAR_M, Tracer

_RAYS_AT_ONCE: Final = 1 << 16
"""Shadow rays of a batch: their arrays stay in the second-level cache."""


class Points(NamedTuple):
    """Surface points to be lit.

    Positions stand off the surface; normal is the shading normal, wound the triangle's, both on the side that is lit.
    alpha is the coat's roughness (0: none), row the place in the visibility table (-1: unknown), number what the random
    numbers hang on.
    """

    position: Float32[np.ndarray, "n 3"]
    normal: Float32[np.ndarray, "n 3"]
    wound: Float32[np.ndarray, "n 3"]
    alpha: Float32[np.ndarray, " n"]
    row: Int32[np.ndarray, " n"]
    number: Int64[np.ndarray, " n"]

    def part(self, start: int, stop: int) -> "Points":
        """Some of them."""
        return Points(*(column[start:stop] for column in self))


class Received(NamedTuple):
    """Irradiance, and what of it a point's coat lets through; of both, what the sun sends straight through an
    opening (its light elsewhere comes from spots)."""

    irradiance: Float32[np.ndarray, "n 3"]
    coated: Float32[np.ndarray, "n 3"]
    sun: Float32[np.ndarray, "n 3"]
    sun_coated: Float32[np.ndarray, "n 3"]


class ShadowRays(NamedTuple):
    """Rays toward lights, written by the kernel: whose they are, and what they carry if nothing stands between."""

    owner: Int32[np.ndarray, " n"]
    origin: Float32[np.ndarray, "n 3"]
    direction: Float32[np.ndarray, "n 3"]
    reach: Float32[np.ndarray, " n"]
    weight: Float32[np.ndarray, "n 3"]
    passed: Float32[np.ndarray, " n"]
    cluster: Int32[np.ndarray, " n"]

    @classmethod
    def room_for(cls, count: int) -> "ShadowRays":
        """Space for so many."""
        single, three = (count,), (count, 3)
        return cls(
            np.empty(single, np.int32),
            np.empty(three, np.float32),
            np.empty(three, np.float32),
            np.empty(single, np.float32),
            np.empty(three, np.float32),
            np.empty(single, np.float32),
            np.empty(single, np.int32),
        )


OnRays = Callable[[int, ShadowRays, Bool[np.ndarray, " n"], int], None]
"""Called with the first point's index, the rays, which were visible, and how many there are."""


class DirectLight:
    """The lights of a scene and what has been learned about which of them each part of the room sees."""

    lights: Lights
    outdoors: Outdoors
    coat: CoatTable
    vis: UInt8[np.ndarray, "rows l"]

    def __init__(self, tracer: Tracer) -> None:
        """Collect the lights; nothing is known of their visibility yet."""
        self.tracer = tracer
        self.lights, self.outdoors = build_lights(tracer)
        self.coat = coat_table()
        self.vis = np.full((1, max(1, len(self.lights.start))), 255, np.uint8)

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
        """Irradiance of each point from the lights, sunlit spots among them. sun_outside counts sunlight that passed no
        opening (on a sill) with the sun's."""
        count = len(points.position)
        out = Received(*(np.zeros((count, 3), np.float32) for _ in range(4)))
        step = max(1, _RAYS_AT_ONCE // (picks + sun_picks))
        rays = ShadowRays.room_for(min(step, max(count, 1)) * (picks + sun_picks))
        tracer = self.tracer
        for start in range(0, count, step):
            some = points.part(start, start + step)
            written = kernels.propose(
                self.lights,
                self.outdoors,
                tracer.atlas,
                self.coat.through,
                tuple(some),
                self.vis,
                candidates,
                picks,
                sun_picks,
                seed,
                *rays,
            )
            seen = tracer.visible(rays.origin[:written], rays.direction[:written], rays.reach[:written])
            kernels.received(
                rays.owner,
                rays.weight,
                rays.passed,
                rays.cluster,
                seen,
                written,
                sun_outside,
                *(column[start : start + step] for column in out),
            )
            if on_rays is not None:
                on_rays(start, rays, seen, written)
        return out

    def sunlight(self, points: Points, *, seed: int) -> Float32[np.ndarray, "n 3"]:
        """Irradiance straight from the sun by one ray each, as let through by the points' coats."""
        count = len(points.position)
        out = np.zeros((count, 3), np.float32)
        if self.outdoors.sun_irradiance.max() <= 0:
            return out
        owner = np.empty(count, np.int32)
        origin, direction, weight = (np.empty((count, 3), np.float32) for _ in range(3))
        written = kernels.sun_rays(
            self.outdoors,
            self.coat.through,
            points.position,
            points.normal,
            points.wound,
            points.alpha,
            points.number,
            seed,
            owner,
            origin,
            direction,
            weight,
        )
        reach = np.full(written, FAR_M, np.float32)
        seen = self.tracer.visible(origin[:written], direction[:written], reach)
        out[owner[:written][seen]] = weight[:written][seen]
        return out
