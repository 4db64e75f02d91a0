"""Irradiance in cells of the room's surfaces, computed when first needed and shared by all views of a room.

Frames: world, y up, metres; irradiance in kcd/m2 times steradians. A cell is about a pixel and a half wide in the view
that first needs it. Its direct light comes from shadow rays; its indirect light is interpolated between sparser records
(irradiance caching: Ward et al. 1988), each the sum of `GATHER_RAYS` rays into the room's cache. A record's reach is
limited by the harmonic mean distance to the surfaces that it sees, and in pixels.
"""

from typing import Final

import numpy as np
from jaxtyping import Float32, Int32, Int64

from roomlight_generator.transport.kernels import irradiance_cache as kernels
from roomlight_generator.transport.kernels.gather import gather_rays, gather_sum
from roomlight_generator.transport.kernels.patches import find_hits
from roomlight_generator.transport.kernels.structs import (
    CacheHits,
    CachePoints,
    ConeScratch,
    GatherRays,
    GatherSampling,
    RayEnds,
    RecordColumns,
    RecordLists,
    SurfacePoints,
    allocated,
)
from roomlight_generator.transport.kernels.surfaces import surface_points
from roomlight_generator.transport.lights.direct import DirectLight, Points, Received
from roomlight_generator.transport.lights.sun_spots import NEAR_SPOT_M2
from roomlight_generator.transport.lights.visibility_variance import VisibilityVariance
from roomlight_generator.transport.patches import RoomCache, follow
from roomlight_generator.transport.paths import Surfaces
from roomlight_generator.transport.tables import Table, grown

GATHER_RAYS: Final = 320
CONE_SHARE: Final = 0.3
"""Share of the gather rays that go into cones about the lights."""

SHADOW_RAYS: Final = 32
MORE_SHADOW_RAYS: Final = 64
"""Shadow rays of each cell, and more where those leave its light uncertain by more than the share `UNCERTAIN`."""

UNCERTAIN: Final = 0.3
SUN_PICKS: Final = 2

REACH_PIXELS: Final = (18.0, 8.0, 3.5)
"""Reach of the records of each round: the later rounds add records in corners."""

ROUND_SHARE: Final = (8, 4, 2)
"""Each round considers every n-th new cell, so that the first round's records are far apart."""

CLEARANCE: Final = 0.35
"""Share of its harmonic mean distance that a record reaches."""

NEAR_M: Final = 0.1
"""Nearer hits are lit anew: a patch of the room's cache is 0.08 m wide and would light its own corner."""

_RAYS_AT_ONCE: Final = 1 << 16
_FOOT_RANGE: Final = (2e-4, 1.0)


class IrradianceCache:
    """Irradiance of one room's surfaces, in cells."""

    def __init__(
        self,
        light: DirectLight,
        room_cache: RoomCache,
        *,
        seed: int,
        gather_rays: int = GATHER_RAYS,
        interpolated: bool = True,
    ) -> None:
        """Start empty. Gather rays bring the light of `room_cache`.

        If not `interpolated`, every cell is a record, cells are twice as wide, and a cell's random numbers depend on
        its place alone, so that two caches of nearly the same room differ by the room and hardly by noise.
        """
        self.tracer, self.light, self.room_cache = light.tracer, light, room_cache
        self._seed, self._gather_rays, self._interpolated = seed, gather_rays, interpolated
        self._table = Table(1 << 16)
        self._count = 0
        self._irradiance, self._sun = np.zeros((1 << 16, 3), np.float32), np.zeros((1 << 16, 3), np.float32)
        self._records = _Records()

    def irradiance(self, surfaces: Surfaces) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 3"]]:
        """Return the irradiance at surface points, as let through by their coats; and what comes straight from the sun.

        foot_m of the points is the width of a pixel there, across the ray.
        """
        count = len(surfaces.face)
        foot = np.clip(surfaces.foot_m if self._interpolated else 2 * surfaces.foot_m, *_FOOT_RANGE)
        self._table.reserve(self._count + count)
        cell, fresh = np.empty(count, np.int32), np.empty(count, np.int32)
        points = CachePoints(surfaces.position, surfaces.normal, surfaces.alpha, foot)
        new = kernels.claim(points, self._table.arrays, self._count, cell, fresh)
        if new:
            at = fresh[:new]
            first, self._count = self._count, self._count + new
            self._irradiance = grown(self._irradiance, first, self._count)
            self._sun = grown(self._sun, first, self._count)
            self._irradiance[first : self._count], self._sun[first : self._count] = self._fill(
                surfaces.part(at), foot[at], first
            )
        return self._irradiance[cell], self._sun[cell]

    def _fill(
        self, surfaces: Surfaces, foot: Float32[np.ndarray, " n"], first: int
    ) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 3"]]:
        """Compute `irradiance` of new cells, numbered from `first` on, at a point in each."""
        numbered = np.arange(first, first + len(foot), dtype=np.int64)
        stream = numbered if self._interpolated else _streams(surfaces.position)
        points = self.room_cache.points(surfaces, stream)
        direct = self._direct(points)
        coat, row = (points.alpha > 0)[:, None], points.row
        if self._interpolated:
            fallback = np.where(coat, self.room_cache.indirect_coated[row], self.room_cache.indirect[row])
            indirect = self._interpolate(points, foot, fallback)
        else:
            indirect, _ = self.gathered(points, rays=self._gather_rays, first=0, streams=stream)
        irradiance = np.where(coat, direct.coated, direct.irradiance) + indirect
        return irradiance, np.where(coat, direct.sun_coated, direct.sun)

    def _interpolate(
        self, points: Points, foot: Float32[np.ndarray, " n"], fallback: Float32[np.ndarray, "n 3"]
    ) -> Float32[np.ndarray, "n 3"]:
        """Return indirect irradiance from records about the points, where needed from new ones."""
        records = self._records
        for reach, share in zip(REACH_PIXELS, ROUND_SHARE, strict=True):
            chosen = records.choose(points, foot, reach, every=share)
            if len(chosen):
                some = Points(*(column[chosen] for column in points))
                start = records.count - len(chosen)
                light, clear = self.gathered(some, rays=self._gather_rays, first=start)
                records.columns.irradiance[start : records.count] = light
                records.columns.clear[start : records.count] = clear * np.float32(CLEARANCE)
        return records.interpolate(points, foot, fallback)

    def _direct(self, points: Points) -> Received:
        """Compute direct light, with a second round of shadow rays where lights are partly hidden."""
        variance = VisibilityVariance(len(points.row))
        direct = self.light.received(
            points,
            candidates=SHADOW_RAYS,
            picks=SHADOW_RAYS,
            sun_picks=SUN_PICKS,
            seed=self._seed + 2,
            sun_outside=True,
            on_rays=variance.add,
        )
        uncertain = variance.select(self.room_cache.indirect[points.row].mean(axis=1), UNCERTAIN)
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
        self, points: Points, *, rays: int, first: int, streams: Int64[np.ndarray, " n"] | None = None
    ) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, " n"]]:
        """Compute indirect irradiance by rays from each point, and the harmonic mean of their lengths.

        The points seed their random streams by `first`, `first` + 1 and so on, or by `streams`.
        """
        count = len(points.position)
        irradiance, clear = np.empty((count, 3), np.float32), np.empty(count, np.float32)
        step = max(1, _RAYS_AT_ONCE // rays)
        cones = int(rays * CONE_SHARE)
        scratch = ConeScratch.empty(self.light.lights.real)
        for start in range(0, count, step):
            some = points.part(start, start + step)
            numbered = np.arange(first + start, first + start + len(some.position), dtype=np.int64)
            stream = numbered if streams is None else streams[start : start + step]
            sent = allocated(GatherRays, len(stream) * rays)
            sampling = GatherSampling(rays - cones, cones, self._seed + 3)
            light, some = self.light, some._replace(stream=stream)
            gather_rays(light.lights, light.visibility, some, light.coat.through, sampling, scratch, sent)
            face, distance, radiance = self._seen(sent.origin, sent.direction, (first + start) * rays)
            rows = slice(start, start + len(stream))
            gather_sum(sent, radiance, face, distance, rays, irradiance[rows], clear[rows])
        return irradiance, clear

    def _seen(
        self, origin: Float32[np.ndarray, "n 3"], direction: Float32[np.ndarray, "n 3"], first: int
    ) -> tuple[Int32[np.ndarray, " n"], Float32[np.ndarray, " n"], Float32[np.ndarray, "n 3"]]:
        """Trace gather rays to face, distance and radiance; of emitted light the share that shadow rays leave.

        The rays seed their random streams by `first`, `first` + 1 and so on.
        """
        tracer, cache, materials = self.tracer, self.room_cache, self.tracer.materials
        ends, distance_m, mirrored, factor, radiance = follow(self.light, origin, direction)
        row, cosine = np.empty(len(origin), np.int32), np.zeros(len(origin), np.float32)
        find_hits(tracer.geometry, cache.table, ends, row, cosine)
        row = cache.visible(row, distance_m)
        material = tracer.geometry.material[ends.face]  # without a face: any
        alpha = materials.roughness[material]
        near = np.flatnonzero((ends.face >= 0) & (distance_m < NEAR_M))
        if len(near):
            surface = allocated(SurfacePoints, len(near))
            foot = np.full(len(near), 0.01, np.float32)
            surface_points(tracer.arrays, RayEnds(*(column[near] for column in ends)), foot, surface)
            points = Points(
                surface.position,
                surface.normal,
                surface.geometric_normal,
                alpha[near],
                row[near],
                near.astype(np.int64) + np.int64(first),
            )
            direct = self.light.received(points, candidates=6, picks=1, sun_picks=1, seed=self._seed + 4)
            irradiance = direct.irradiance + cache.indirect[row[near]]
            coated = direct.coated + cache.indirect_coated[row[near]]
            # After a mirror nothing is subtracted, as at no distance.
            distance = np.where(mirrored[near], np.float32(0), distance_m[near])
            kernels.subtract_spots(irradiance, direct.sun, distance, NEAR_SPOT_M2)
            kernels.subtract_spots(coated, direct.sun_coated, distance, NEAR_SPOT_M2)
            light = np.empty((len(near), 3), np.float32)
            kernels.reflected_light(
                irradiance, coated, surface.albedo, alpha[near], cosine[near], self.light.coat, light
            )
            radiance[near] += light * factor[near, None]
            row[near] = -1
        hits = CacheHits(row, cosine, alpha, distance_m, mirrored, factor)
        kernels.add_cached(hits, self.light.coat, cache.radiance, NEAR_SPOT_M2, radiance)
        return ends.face, distance_m, radiance


def _streams(position: Float32[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Return a number for each point that depends on its place alone, to a tenth of a millimetre."""
    x, y, z = np.rint(position.astype(np.float64) * 1e4).astype(np.int64).T
    return np.abs(x * 73856093 ^ y * 19349663 ^ z * 83492791)


class _Records:
    """Records of indirect light, listed by the grid cells into which they reach."""

    def __init__(self) -> None:
        self.count = 0
        self.columns = allocated(RecordColumns, 1 << 12)
        self._table = Table(1 << 14)
        self._entries = 0
        self._entry_record, self._entry_next = np.zeros(1 << 14, np.int32), np.zeros(1 << 14, np.int32)
        self._levels = np.zeros(64, np.int32)

    def choose(
        self, points: Points, foot: Float32[np.ndarray, " n"], reach_pixels: float, *, every: int
    ) -> Int32[np.ndarray, " m"]:
        """Add records where they are needed, considering one in `every` points; returns the new records' points.

        The caller fills in their light.
        """
        chosen: list[np.ndarray] = []
        step = 1 << 14
        for start in range(0, len(foot), step):
            part = points.part(start, start + step)
            some = len(part.position)
            self.columns = RecordColumns(*(grown(column, self.count, self.count + some) for column in self.columns))
            # A record reaches into 27 cells at most.
            self._entry_record = grown(self._entry_record, self._entries, self._entries + 27 * some)
            self._entry_next = grown(self._entry_next, self._entries, self._entries + 27 * some)
            self._table.reserve(self._entries + 27 * some)
            fresh = np.empty(some, np.int32)
            before = self.count
            self.count, self._entries = kernels.choose_records(
                CachePoints(part.position, part.normal, part.alpha, foot[start : start + step]),
                reach_pixels,
                every,
                self.columns,
                self._lists(),
                self.count,
                self._entries,
                fresh,
            )
            chosen.append(fresh[: self.count - before] + np.int32(start))
        return np.concatenate(chosen)

    def interpolate(
        self, points: Points, foot: Float32[np.ndarray, " n"], fallback: Float32[np.ndarray, "n 3"]
    ) -> Float32[np.ndarray, "n 3"]:
        """Return the irradiance of points interpolated between the records."""
        out = np.empty_like(fallback)
        at = CachePoints(points.position, points.normal, points.alpha, foot)
        kernels.interpolate(at, self.columns, self._lists(), fallback, out)
        return out

    def _lists(self) -> RecordLists:
        keys, heads = self._table.arrays
        return RecordLists(keys, heads, self._entry_record, self._entry_next, self._levels)
