"""The room's cache: radiance that every lit surface sends out, solved once by rays between patches.

Frames: world, y up, metres; radiance in kcd/m2. Rays from the lights find the first patches, rays from patches the
others, until no new ones are found. Each patch then gets its direct light, and what it gathers is summed bounce by
bounce. Emitted light is not in the cache: shadow rays bring it to every point.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int32, Int64

from roomlight_generator.transport.kernels import patches as kernels
from roomlight_generator.transport.kernels.structs import (
    CachedRadiance,
    Fineness,
    PatchColumns,
    PatchLinks,
    PatchPoints,
    PatchRays,
    PatchTable,
    RayEnds,
    ReceivedLight,
    SentLight,
    allocated,
)
from roomlight_generator.transport.lights.direct import DirectLight, Points, Received
from roomlight_generator.transport.lights.emitters import OPENING, TRIANGLE
from roomlight_generator.transport.lights.light_visibility import LightVisibility
from roomlight_generator.transport.lights.sun_spots import NEAR_SPOT_M2
from roomlight_generator.transport.paths import Surfaces, over_mirrors
from roomlight_generator.transport.tables import Table, grown
from roomlight_generator.transport.tracer import OFFSET_M

GATHER_RAYS: Final = 32
MOST_BOUNCES: Final = 60
SETTLED: Final = 2e-3
"""A bounce that adds less than this share of all light is the last: the 8th at albedo 0.5, the 25th in a white room."""

FINE_WITHIN_M: Final = ((1, 0.3), (2, 0.15), (3, 0.08))
"""(Halvings, distance): patches this near to lamps are halved that many times, 3 means one per face; openings: 1."""

ENCLOSED_M: Final = 0.3
"""A point near a lamp is inside of a closed lamp if all its rays end on lamps within this: its light does not leave.

A bulb that sticks out of its shade has faces partly inside, a thousand times as bright there as outside."""

_ENCLOSED_RAYS: Final = 24
SEED_RAYS: Final = 32768
FIRST_RAYS: Final = 16
MOST_WAVES: Final = 8
_RAYS_AT_ONCE: Final = 1 << 16


class Arrivals(NamedTuple):
    """Gather rays after mirrors: ends, lengths, whether they met a mirror, the share that mirrors left, emitted light
    (`arriving`)."""

    ends: RayEnds
    distance_m: Float32[np.ndarray, " n"]
    mirrored: Bool[np.ndarray, " n"]
    factor: Float32[np.ndarray, " n"]
    radiance: Float32[np.ndarray, "n 3"]


def follow(light: DirectLight, origin: Float32[np.ndarray, "n 3"], direction: Float32[np.ndarray, "n 3"]) -> Arrivals:
    """Trace rays over at most two mirrors to the first other surface; a third mirror absorbs the ray."""
    tracer = light.tracer
    hits = tracer.trace(origin, direction)
    factor = np.ones(len(origin), np.float32)
    origin, direction, mirrors = over_mirrors(tracer, hits, origin, direction, factor, most=2)
    mirrored, distance, radiance = mirrors > 0, hits.distance_m, np.empty((len(origin), 3), np.float32)
    ends = RayEnds(hits.face, hits.u, hits.v, direction)
    kernels.arriving(tracer.arrays, light.sources, ends, origin, distance, mirrored, factor, radiance)
    return Arrivals(ends, distance, mirrored, factor, radiance)


def _fineness(light: DirectLight) -> Fineness:
    corners = light.tracer.geometry.corners
    low = corners.min((0, 1)) - np.float32(0.01)
    size = corners.max((0, 1)) - low
    cell = max(0.1, float(size.max()) / 256)
    level = np.zeros(tuple(int(np.ceil(extent / cell)) + 1 for extent in size), np.uint8)
    lights = light.lights
    lamp = np.flatnonzero(lights.kind[lights.start] == TRIANGLE)
    for halvings, beyond_m in FINE_WITHIN_M:
        some = lamp if halvings > 1 else np.arange(lights.real)
        middle, reach = lights.centre[:, some].T, lights.radius[some] + np.float32(beyond_m)
        first = np.maximum(np.floor((middle - reach[:, None] - low) / cell), 0).astype(np.int64)
        last = np.floor((middle + reach[:, None] - low) / cell).astype(np.int64) + 1
        for box_low, box_high in zip(first, last, strict=True):
            box = level[tuple(slice(a, max(b, 0)) for a, b in zip(box_low, box_high, strict=True))]
            np.maximum(box, np.uint8(halvings), out=box)
    return Fineness(level, low, cell)


class _PatchSet:
    """Patches while they are found: columns with a row a patch (`PatchColumns`), of which `count` are in use."""

    def __init__(self, light: DirectLight, fineness: Fineness, seed: int) -> None:
        self.light, self.fineness, self.seed = light, fineness, seed
        self.table = Table()
        self.count = 0
        points = (np.empty((0, kernels.POINTS, 3), np.float32) for _ in range(4))
        self.columns = PatchColumns(*points, *(np.zeros(0, np.int32) for _ in range(3)))

    def visit(self, ends: RayEnds) -> tuple[Int32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Find or add each hit's patch (-1 without a hit); also returns the cosine at which the ray leaves it."""
        count = len(ends.face)
        self.columns = PatchColumns(*(grown(column, self.count, self.count + count) for column in self.columns))
        self.table.reserve(self.count + count)
        patch, cosine = np.empty(count, np.int32), np.zeros(count, np.float32)
        arrays, table = self.light.tracer.arrays, self.table.arrays
        self.count = kernels.visit(arrays, self.fineness, ends, table, self.columns, self.count, patch, cosine)
        return patch, cosine

    def gather(self, rows: Int[np.ndarray, " c"], rays: int) -> tuple[Arrivals, Float32[np.ndarray, " n"]]:
        """Trace cosine-weighted rays of some patches; also returns the share that each patch's coat lets through."""
        position, normal, geometric_normal, _, used, _, material = (column[rows] for column in self.columns)
        roughness = self.light.tracer.materials.roughness[material]
        points = PatchPoints(position, normal, geometric_normal, used, roughness, rows.astype(np.int64))
        sent = allocated(PatchRays, len(rows) * rays)
        kernels.patch_rays(points, self.light.coat.through, rays, self.seed, sent)
        return follow(self.light, sent.origin, sent.direction), sent.passed

    def linked(self, rows: Int[np.ndarray, " c"]) -> tuple[np.ndarray, ...]:
        """Return the columns of the links from some patches to others, by `GATHER_RAYS` rays each.

        Returns:
            For each ray: target patch, cosine there, length, share passed here, whether it met a mirror, and mirrors'
            factor. For each patch: the irradiance that comes from no patch, plain and as let through by its coat.
        """
        sent, passed = self.gather(rows, GATHER_RAYS)
        target, cosine = self.visit(sent.ends)
        radiance = sent.radiance.reshape(-1, GATHER_RAYS, 3)
        through = passed.reshape(-1, GATHER_RAYS, 1)
        scale = np.float32(np.pi / GATHER_RAYS)
        beside, beside_coated = radiance.sum(1) * scale, (radiance * through).sum(1) * scale
        return target, cosine, sent.distance_m, passed, sent.mirrored, sent.factor, beside, beside_coated


@dataclass(frozen=True, eq=False)
class RoomCache:
    """Light that patches send out and receive.

    The rows are the patches, then wider surroundings, then whole materials, then a row of zeros. The zeros come last,
    so that index -1 leads to them.

    Attributes:
        radiance: Base before a coat lets it out, mean of the lobe, and the parts of both that spots represent.
        indirect, indirect_coated: Irradiance that comes neither from lights nor from spots.
        enclosed: Patches that cannot be seen from beyond `ENCLOSED_M`: a ray from there meets a part of theirs outside,
            whose light is unknown.
    """

    table: PatchTable
    radiance: CachedRadiance
    indirect: Float32[np.ndarray, "rows 3"]
    indirect_coated: Float32[np.ndarray, "rows 3"]
    enclosed: Bool[np.ndarray, " rows"]

    def points(self, surfaces: Surfaces, stream: Int64[np.ndarray, " n"]) -> Points:
        """Return surface points to be lit, with their rows."""
        row = np.empty(len(stream), np.int32)
        points = Points(surfaces.position, surfaces.normal, surfaces.geometric_normal, surfaces.alpha, row, stream)
        kernels.find_points(self.table, points.position, points.geometric_normal, surfaces.material, surfaces.face, row)
        return points

    def visible(self, row: Int32[np.ndarray, " n"], distance_m: Float32[np.ndarray, " n"]) -> Int32[np.ndarray, " n"]:
        """Return the rows, with -1 in place of those that cannot be seen from that distance."""
        return np.where(self.enclosed[row] & (distance_m > ENCLOSED_M), np.int32(-1), row)


def solve_room(light: DirectLight, *, seed: int) -> RoomCache:
    """Find the patches, light them and let the light bounce.

    Sets `light.visibility`, which then has a row for each row of the cache.
    """
    fineness = _fineness(light)
    lit = _PatchSet(light, fineness, seed)
    lit.visit(_seed_rays(light, seed).ends)
    # The lights see only the lit part of a patch that is half in shadow: start over from what those patches see.
    patches = _PatchSet(light, fineness, seed)
    step = _RAYS_AT_ONCE // FIRST_RAYS
    for start in range(0, lit.count, step):
        rows = np.arange(start, min(start + step, lit.count))
        patches.visit(lit.gather(rows, FIRST_RAYS)[0].ends)
    parts = [patches.linked(np.arange(0))]
    done = 0
    step = _RAYS_AT_ONCE // GATHER_RAYS
    for _ in range(MOST_WAVES):
        stop = patches.count
        if stop == done:
            break
        for start in range(done, stop, step):
            parts.append(patches.linked(np.arange(start, min(start + step, stop))))
        done = stop
    columns = tuple(np.concatenate(column) for column in zip(*parts, strict=True))
    enclosed, changed = _drop_enclosed(patches, done)
    for start in range(0, len(changed), step):
        some = changed[start : start + step]
        for column, new in zip(columns, patches.linked(some), strict=True):
            rays_each = len(column) // done
            column.reshape(done, rays_each, *column.shape[1:])[some] = new.reshape(len(some), rays_each, *new.shape[1:])
    return _bounced(patches, done, columns, enclosed)


def _drop_enclosed(patches: _PatchSet, count: int) -> tuple[Bool[np.ndarray, " p"], Int32[np.ndarray, " c"]]:
    """Drop points inside of closed lamps from patches that also have points outside.

    Returns which patches are entirely inside, and those that lost points.
    """
    enclosed = np.zeros(count, bool)
    near = patches.table.values[patches.table.keys >= 1 << 62]
    near = np.sort(near[near < count])
    position, normal, geometric_normal, albedo, all_used, *_ = patches.columns
    used = all_used[near]
    owner, place = _points_of(used)
    points = len(owner)
    if not points:
        return enclosed, np.zeros(0, np.int32)
    at = near[owner], place
    origins = PatchPoints(
        position[at][:, None],
        normal[at][:, None],
        geometric_normal[at][:, None],
        np.ones(points, np.int32),
        np.zeros(points, np.float32),
        np.arange(points, dtype=np.int64),
    )
    rays, tracer = allocated(PatchRays, points * _ENCLOSED_RAYS), patches.light.tracer
    kernels.patch_rays(origins, patches.light.coat.through, _ENCLOSED_RAYS, patches.seed + 5, rays)
    hits = tracer.trace(rays.origin, rays.direction)
    items, material = tracer.geometry.item, tracer.geometry.material
    lamp = np.zeros(int(items.max()) + 1, bool)
    lamp[items[tracer.materials.emission[material].max(1) > 0]] = True
    stopped = (hits.face >= 0) & (hits.distance_m < ENCLOSED_M) & lamp[items[hits.face]]
    inside = stopped.reshape(points, _ENCLOSED_RAYS).all(1)
    outside = np.bincount(owner, ~inside, len(near))
    enclosed[near[outside == 0]] = True
    keep = ~inside | (outside == 0)[owner]
    changed = np.unique(owner[~keep])
    last = np.cumsum(used)
    for which in changed.tolist():
        patch, kept = near[which], np.flatnonzero(keep[last[which] - used[which] : last[which]])
        for column in (position, normal, geometric_normal, albedo):
            column[patch, : len(kept)] = column[patch, kept]
        all_used[patch] = len(kept)
    return enclosed, near[changed]


def _points_of(used: Int32[np.ndarray, " p"]) -> tuple[Int32[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return patch and place of each point that is used, patch by patch."""
    owner = np.repeat(np.arange(len(used), dtype=np.int32), used)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(used) - used, used)


def _seed_rays(light: DirectLight, seed: int) -> Arrivals:
    """Trace rays from the lights in all directions, evenly over clusters, so that dark corners are found too."""
    rng = np.random.default_rng([seed, 1])
    lights = light.lights
    if len(lights.piece) == 0:
        low, high = (getattr(light.tracer.geometry.corners, name)((0, 1)) for name in ("min", "max"))
        begin = rng.uniform(low, high, (SEED_RAYS, 3)).astype(np.float32)
    else:
        # Evenly over clusters and over a cluster's pieces: weak lamps in corners reach places that windows do not.
        cluster = rng.integers(len(lights.start), size=SEED_RAYS)
        piece = lights.start[cluster] + (rng.random(SEED_RAYS) * lights.pieces[cluster]).astype(np.int64)
        a, b = rng.random((2, SEED_RAYS, 1))
        table, kind = lights.piece[piece].astype(np.float64), lights.kind[piece, None]
        first, second, third = table[:, 0:3], table[:, 3:6], table[:, 6:9]
        root = np.sqrt(a)
        on_face = first * root * (1 - b) + second * (1 - root) + third * root * b
        on_opening = first + a * second + b * third
        begin = np.where(kind == TRIANGLE, on_face, np.where(kind == OPENING, on_opening, first)).astype(np.float32)
    along = rng.standard_normal((SEED_RAYS, 3)).astype(np.float32)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return follow(light, begin + np.float32(OFFSET_M) * along, along)


def _direct(patches: _PatchSet, visibility: LightVisibility) -> Received:
    """Compute each patch's direct light, the mean over its points, in two rounds.

    The first only measures which lights each patch sees; the second samples by that. `light.visibility` holds the
    counts of both.
    """
    count, light, seed = len(visibility.owner), patches.light, patches.seed
    columns = patches.columns
    used = columns.used[:count]
    owner, place = _points_of(used)
    points = Points(
        columns.position[owner, place],
        columns.normal[owner, place],
        columns.geometric_normal[owner, place],
        light.tracer.materials.roughness[columns.material[owner]],
        np.full(len(owner), -1, np.int32),
        np.arange(len(owner), dtype=np.int64),
    )

    alone = place == 0
    first = Points(*(column[alone] for column in points))
    light.received(first, candidates=8, picks=6, sun_picks=0, seed=seed + 6, on_rays=visibility.counting(owner[alone]))
    light.visibility = visibility.visibility()
    known = points._replace(row=owner)
    received = light.received(
        known, candidates=16, picks=8, sun_picks=2, seed=seed + 1, on_rays=visibility.counting(owner)
    )
    light.visibility = visibility.visibility()
    weight = (1 / used[owner]).astype(np.float32)
    means = (
        np.stack([np.bincount(owner, part[:, k] * weight, count) for k in range(3)], 1).astype(np.float32)
        for part in received
    )
    return Received(*means)


def _bounced(
    patches: _PatchSet, count: int, columns: tuple[np.ndarray, ...], enclosed: Bool[np.ndarray, " p"]
) -> RoomCache:
    """Sum the bounces of light between the patches; columns are those of `linked`."""
    light = patches.light
    materials, coat = light.tracer.materials, light.coat
    position, _, _, albedos, used, _, material = (column[:count] for column in patches.columns)
    alpha = materials.roughness[material]
    point = np.arange(kernels.POINTS) < used[:, None]
    albedo = (albedos * point[..., None]).sum(1) / np.maximum(used, 1)[:, None]
    visibility = LightVisibility(
        position, used, material.copy(), lights=max(1, len(light.lights.start)), materials=len(materials.mirror)
    )
    direct = _direct(patches, visibility)
    target, cosine, distance, passed, mirrored, factor, beside, beside_coated = columns
    target[target >= count] = -1  # found by the last wave and never lit
    target[enclosed[target] & (distance > ENCLOSED_M)] = -1
    shares = np.empty(len(target), np.float32), np.empty(len(target), np.float32)
    links = PatchLinks(target, *shares, passed, distance, mirrored, factor)
    kernels.link_shares(links, cosine, alpha, coat)
    base, lobe, sun_base, sun_lobe, bounced, bounced_coated = (np.zeros((count, 3), np.float32) for _ in range(6))
    sent, sun, gathered = SentLight(base, lobe), SentLight(sun_base, sun_lobe), ReceivedLight(bounced, bounced_coated)
    if len(light.lights.start) > light.lights.real:
        kernels.outgoing(albedo, alpha, coat, ReceivedLight(direct.sun, direct.sun_coated), sun)
        kernels.spots_gathered(links, sun, NEAR_SPOT_M2, GATHER_RAYS, gathered)
        beside -= bounced
        beside_coated -= bounced_coated
        bounced[:], bounced_coated[:] = 0, 0
    total = 0.0
    for _ in range(MOST_BOUNCES):
        received = ReceivedLight(direct.irradiance + beside + bounced, direct.coated + beside_coated + bounced_coated)
        kernels.outgoing(albedo, alpha, coat, received, sent)
        before, total = total, float(base.sum() + lobe.sum())
        if total - before <= SETTLED * total:
            break
        kernels.bounce(links, sent, GATHER_RAYS, gathered)
    solved = base, lobe, sun_base, sun_lobe, beside + bounced, beside_coated + bounced_coated
    return _with_fallbacks(patches, visibility, solved, enclosed)


def _with_fallbacks(
    patches: _PatchSet, visibility: LightVisibility, columns: tuple[np.ndarray, ...], enclosed: Bool[np.ndarray, " p"]
) -> RoomCache:
    """Append to the rows the means over wider cells and over materials, and a row of zeros."""
    table, count, wide = patches.table, len(visibility.owner), visibility.wide
    table.keys[table.values >= count] = -2  # of the last wave, unlit: -2 is neither a key nor an empty place
    tables: list[np.ndarray] = []
    for column in columns:
        around = _means(column, visibility.owner, count=wide)
        whole = _means(column, visibility.material, count=visibility.materials, fill=True)
        nothing = np.zeros((1, column.shape[1]), np.float32)
        tables.append(np.concatenate([column, around, whole, nothing]).astype(np.float32))
    coarse = visibility.coarse
    return RoomCache(
        PatchTable(patches.fineness, table.keys, table.values, coarse.keys, coarse.values, count, count + wide),
        CachedRadiance(*tables[:4]),
        *tables[4:],
        enclosed=np.concatenate([enclosed, np.zeros(len(tables[0]) - count, bool)]),
    )


def _means(
    column: Float[np.ndarray, "p c"], owner: Int32[np.ndarray, " p"], *, count: int, fill: bool = False
) -> Float[np.ndarray, "_ c"]:
    """Average the rows of each owner; owners without rows get zeros, or the mean of all rows if `fill`."""
    number = np.bincount(owner, minlength=count)
    total = np.stack([np.bincount(owner, column[:, k], count) for k in range(column.shape[1])], 1)
    mean = total / np.maximum(number, 1)[:, None]
    if fill and len(column):
        mean[number == 0] = column.mean(0)
    return mean
