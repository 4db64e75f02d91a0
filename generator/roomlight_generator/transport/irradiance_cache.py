"""Irradiance in cells of the world's surfaces, filled when first looked at and shared by all views of a room.

Frames: world, y up, metres. A cell is about a pixel and a half wide as seen from where it was first looked at. Its
direct light comes from shadow rays; its indirect light is interpolated between sparser records (irradiance caching:
Ward et al. 1988), each the sum of `GATHER_RAYS` rays into the room's cache. A record reaches as far as its harmonic
mean distance to what it sees allows, within so many pixels.
"""

from typing import Final

import numpy as np
from jaxtyping import Float32, Int32

from roomlight_generator.transport.direct import DirectLight, Points, Received
from roomlight_generator.transport.kernels import irradiance_cache as kernels
from roomlight_generator.transport.kernels.gather import gather_rays, gather_sum
from roomlight_generator.transport.kernels.patches import find, find_points
from roomlight_generator.transport.kernels.surfaces import surface_points
from roomlight_generator.transport.patches import RoomCache, follow
from roomlight_generator.transport.sun_spots import NEAR_SPOT_M2
from roomlight_generator.transport.tables import Table, grown
from roomlight_generator.transport.tracer import Tracer
from roomlight_generator.transport.visibility_variance import VisibilityVariance

GATHER_RAYS: Final = 320
CONE_SHARE: Final = 0.3
"""Of the gather rays, so many go into cones about the lights."""

SHADOW_RAYS: Final = 32
MORE_SHADOW_RAYS: Final = 64
"""For each cell, and once more where the first ones leave its light uncertain by more than `UNCERTAIN` of it."""

UNCERTAIN: Final = 0.3
SUN_PICKS: Final = 2

REACH_PIXELS: Final = (18.0, 8.0, 3.5)
"""Reach of the records of each round: corners get more in the later ones."""

ROUND_SHARE: Final = (8, 4, 2)
"""Each round looks at every so many-th new cell: records are far apart in the first."""

SMALLEST_PIXELS: Final = 3.0
FARTHEST_M: Final = 0.35
CLEARANCE: Final = 0.35
"""A record reaches this share of its harmonic mean distance."""

NEAR_M: Final = 0.1
"""Nearer hits are lit afresh: a patch of the room's cache is 0.08 m wide and would light its own corner."""

_RAYS_AT_ONCE: Final = 1 << 16
_FOOT_RANGE: Final = (2e-4, 1.0)


class IrradianceCache:
    """The cells of one room."""

    def __init__(self, tracer: Tracer, light: DirectLight, cache: RoomCache, *, seed: int) -> None:
        """Empty."""
        self.tracer, self.light, self.cache = tracer, light, cache
        self._seed = seed
        self._table = Table(1 << 16)
        self._count = 0
        self._irradiance, self._sun = np.zeros((1 << 16, 3), np.float32), np.zeros((1 << 16, 3), np.float32)
        self._records = _Records()

    @property
    def count(self) -> int:
        """How many cells are filled."""
        return self._count

    @property
    def record_count(self) -> int:
        """How many records of indirect light there are."""
        return self._records.count

    def irradiance(
        self,
        position: Float32[np.ndarray, "n 3"],
        normal: Float32[np.ndarray, "n 3"],
        wound: Float32[np.ndarray, "n 3"],
        face: Int32[np.ndarray, " n"],
        *,
        foot_m: Float32[np.ndarray, " n"],
    ) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 3"]]:
        """Irradiance at surface points (off the surface; see `Points`), as let through by the coat where there is one;
        and what of it comes straight from the sun.

        foot_m is the width of a pixel there, across the ray.
        """
        count = len(face)
        material = self.tracer.geometry.material[face]
        foot = np.clip(foot_m, *_FOOT_RANGE)
        alpha = self.tracer.materials.roughness[material]
        self._table.reserve(self._count + count)
        cell, fresh = np.empty(count, np.int32), np.empty(count, np.int32)
        new = kernels.claim(
            position, normal, alpha, foot, self._table.keys, self._table.values, self._count, cell, fresh
        )
        if new:
            at = fresh[:new]
            first, self._count = self._count, self._count + new
            self._irradiance = grown(self._irradiance, first, self._count)
            self._sun = grown(self._sun, first, self._count)
            self._irradiance[first : self._count], self._sun[first : self._count] = self._fill(
                position[at], normal[at], wound[at], face[at], foot[at], first
            )
        return self._irradiance[cell], self._sun[cell]

    def _fill(
        self,
        position: Float32[np.ndarray, "n 3"],
        normal: Float32[np.ndarray, "n 3"],
        wound: Float32[np.ndarray, "n 3"],
        face: Int32[np.ndarray, " n"],
        foot: Float32[np.ndarray, " n"],
        first: int,
    ) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 3"]]:
        material = self.tracer.geometry.material[face]
        alpha = self.tracer.materials.roughness[material]
        row = np.empty(len(face), np.int32)
        find_points(self.cache.table, position, wound, material, face, row)
        number = np.arange(first, first + len(material), dtype=np.int64)
        points = Points(position, normal, wound, alpha, row, number)
        direct = self._direct(points)
        records = self._records
        for reach, share in zip(REACH_PIXELS, ROUND_SHARE, strict=True):
            chosen = records.choose(points, foot, reach, every=share)
            if len(chosen):
                some = Points(*(column[chosen] for column in points))
                start = records.count - len(chosen)
                light, clear = self.gathered(some, rays=GATHER_RAYS, first=start)
                records.irradiance[start : records.count] = light
                records.clear[start : records.count] = clear * np.float32(CLEARANCE)
        indirect = np.empty((len(material), 3), np.float32)
        coat = (alpha > 0)[:, None]
        fallback = np.where(coat, self.cache.indirect_coated[row], self.cache.indirect[row])
        records.interpolate(points, foot, fallback, indirect)
        irradiance = np.where(coat, direct.coated, direct.irradiance) + indirect
        return irradiance, np.where(coat, direct.sun_coated, direct.sun)

    def _direct(self, points: Points) -> Received:
        """Direct light, in a second round from more places on the lights where they are partly hidden."""
        doubt = VisibilityVariance(len(points.row))
        direct = self.light.received(
            points,
            candidates=SHADOW_RAYS,
            picks=SHADOW_RAYS,
            sun_picks=SUN_PICKS,
            seed=self._seed + 2,
            sun_outside=True,
            on_rays=doubt.hear,
        )
        uncertain = doubt.about(self.cache.indirect[points.row].mean(axis=1), UNCERTAIN)
        if len(uncertain):
            more = self.light.received(
                Points(*(column[uncertain] for column in points)),
                candidates=MORE_SHADOW_RAYS,
                picks=MORE_SHADOW_RAYS,
                sun_picks=2 * SUN_PICKS,
                seed=self._seed + 5,
                sun_outside=True,
            )
            known = np.float32(SHADOW_RAYS / (SHADOW_RAYS + MORE_SHADOW_RAYS))
            for first, second in zip(direct, more, strict=True):
                first[uncertain] = known * first[uncertain] + (1 - known) * second
        return direct

    def gathered(
        self, points: Points, *, rays: int, first: int
    ) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, " n"]]:
        """Indirect irradiance by so many rays from each point, and the harmonic mean of their lengths. `first` is the
        number that the first point's random numbers hang on."""
        count = len(points.position)
        irradiance, clear = np.empty((count, 3), np.float32), np.empty(count, np.float32)
        step = max(1, _RAYS_AT_ONCE // rays)
        cones = int(rays * CONE_SHARE)
        for start in range(0, count, step):
            some = points.part(start, start + step)
            number = np.arange(first + start, first + start + len(some.position), dtype=np.int64)
            total = len(number) * rays
            origin, direction = np.empty((total, 3), np.float32), np.empty((total, 3), np.float32)
            weight, passed = np.empty(total, np.float32), np.empty(total, np.float32)
            gather_rays(
                self.light.lights,
                self.light.vis,
                some.position,
                some.normal,
                some.wound,
                some.alpha,
                some.row,
                number,
                self.light.coat.through,
                rays - cones,
                cones,
                self._seed + 3,
                origin,
                direction,
                weight,
                passed,
            )
            face, distance, radiance = self._seen(origin, direction, (first + start) * rays)
            each = slice(start, start + len(number))
            gather_sum(radiance, weight, passed, face, distance, rays, irradiance[each], clear[each])
        return irradiance, clear

    def _seen(
        self, origin: Float32[np.ndarray, "n 3"], direction: Float32[np.ndarray, "n 3"], number: int
    ) -> tuple[Int32[np.ndarray, " n"], Float32[np.ndarray, " n"], Float32[np.ndarray, "n 3"]]:
        """Face, distance and radiance that gather rays see; emitted light only as shadow rays leave it to them."""
        tracer, cache, materials = self.tracer, self.cache, self.tracer.materials
        ends = follow(tracer, self.light, origin, direction)
        row, cosine = np.empty(len(origin), np.int32), np.zeros(len(origin), np.float32)
        find(tracer.geometry, cache.table, ends.face, ends.u, ends.v, ends.direction, row, cosine)
        row = cache.seen(row, ends.distance_m)
        material = tracer.geometry.material[ends.face]  # of no face: any
        alpha = materials.roughness[material]
        radiance = ends.radiance
        near = np.flatnonzero((ends.face >= 0) & (ends.distance_m < NEAR_M))
        if len(near):
            shape = len(near), 3
            position, normal, wound, albedo, emission = (np.empty(shape, np.float32) for _ in range(5))
            along = ends.direction[near]
            foot = np.full(len(near), 0.01, np.float32)
            surface_points(
                tracer.geometry,
                materials,
                tracer.atlas,
                ends.face[near],
                ends.u[near],
                ends.v[near],
                along,
                foot,
                position,
                normal,
                wound,
                albedo,
                emission,
            )
            numbers = near.astype(np.int64) + np.int64(number)
            points = Points(position, normal, wound, alpha[near], row[near], numbers)
            direct = self.light.received(points, candidates=6, picks=1, sun_picks=1, seed=self._seed + 4)
            irradiance = direct.irradiance + cache.indirect[row[near]]
            coated = direct.coated + cache.indirect_coated[row[near]]
            kernels.lessened(irradiance, direct.sun, ends.distance_m[near], NEAR_SPOT_M2)
            kernels.lessened(coated, direct.sun_coated, ends.distance_m[near], NEAR_SPOT_M2)
            light = np.empty(shape, np.float32)
            kernels.reflected_light(
                irradiance, coated, albedo, alpha[near], cosine[near], tuple(self.light.coat), light
            )
            radiance[near] += light * ends.factor[near, None]
            row[near] = -1
        kernels.leaving(
            row,
            cosine,
            alpha,
            ends.distance_m,
            tuple(self.light.coat),
            cache.base,
            cache.lobe,
            cache.sun_base,
            cache.sun_lobe,
            NEAR_SPOT_M2,
            ends.factor,
            radiance,
        )
        return ends.face, ends.distance_m, radiance


class _Records:
    """Records of indirect light, listed by the cells that they reach into."""

    def __init__(self) -> None:
        self.count = 0
        self.position, self.normal, self.irradiance = (np.zeros((1 << 12, 3), np.float32) for _ in range(3))
        self.coat = np.zeros(1 << 12, np.int32)
        self.clear, self.reach = np.zeros(1 << 12, np.float32), np.zeros(1 << 12, np.float32)
        self._table = Table(1 << 14)
        self._entries = 0
        self._entry_record, self._entry_next = np.zeros(1 << 14, np.int32), np.zeros(1 << 14, np.int32)
        self._levels = np.zeros(64, np.int32)

    def choose(
        self, points: Points, foot: Float32[np.ndarray, " n"], reach_pixels: float, *, every: int
    ) -> Int32[np.ndarray, " m"]:
        """Found records where they are wanting, looking at some points only; returns the points of the new ones. What
        these hold is up to the caller."""
        chosen: list[np.ndarray] = []
        step = 1 << 14
        for start in range(0, len(foot), step):
            part = points.part(start, start + step)
            some = len(part.position)
            for name in ("position", "normal", "irradiance", "coat", "clear", "reach"):
                setattr(self, name, grown(getattr(self, name), self.count, self.count + some))
            # A record reaches into 27 cells at most.
            self._entry_record = grown(self._entry_record, self._entries, self._entries + 27 * some)
            self._entry_next = grown(self._entry_next, self._entries, self._entries + 27 * some)
            self._table.reserve(self._entries + 27 * some)
            fresh = np.empty(some, np.int32)
            before = self.count
            self.count, self._entries = kernels.choose_records(
                part.position,
                part.normal,
                part.alpha,
                foot[start : start + step],
                reach_pixels,
                every,
                SMALLEST_PIXELS,
                FARTHEST_M,
                self._columns(),
                self._table.keys,
                self._table.values,
                self._entry_record,
                self._entry_next,
                self._levels,
                self.count,
                self._entries,
                fresh,
            )
            chosen.append(fresh[: self.count - before] + np.int32(start))
        return np.concatenate(chosen)

    def interpolate(
        self,
        points: Points,
        foot: Float32[np.ndarray, " n"],
        fallback: Float32[np.ndarray, "n 3"],
        out: Float32[np.ndarray, "n 3"],
    ) -> None:
        """Write the irradiance between the records."""
        kernels.interpolate(
            points.position,
            points.normal,
            points.alpha,
            foot,
            SMALLEST_PIXELS,
            self._columns(),
            self._table.keys,
            self._table.values,
            self._entry_record,
            self._entry_next,
            self._levels,
            fallback,
            out,
        )

    def _columns(self) -> tuple[np.ndarray, ...]:
        return self.position, self.normal, self.coat, self.clear, self.reach, self.irradiance
