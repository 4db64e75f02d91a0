"""The room's cache: radiance that every lit surface sends out, solved once by rays between patches.

Frames: world, y up, metres; radiance in kcd/m2. Rays from the lights find the first patches, rays from patches the
others, until no new ones turn up. Every patch then has its direct light, and what it gathers is summed bounce by
bounce. Emitted light is not in the cache: shadow rays bring it to every point.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, UInt8

from roomlight_generator.transport.direct import DirectLight, Points, Received
from roomlight_generator.transport.emitters import OPENING, TRIANGLE
from roomlight_generator.transport.kernels import patches as kernels
from roomlight_generator.transport.light_visibility import LightVisibility
from roomlight_generator.transport.sun_spots import NEAR_SPOT_M2
from roomlight_generator.transport.tables import Table, grown
from roomlight_generator.transport.tracer import OFFSET_M, Tracer

GATHER_RAYS: Final = 32
MOST_BOUNCES: Final = 60
SETTLED: Final = 2e-3
"""Bounces stop when one adds less than this share of all light: 8 in a room of albedo 0.5, 25 in a white one."""

FINE_WITHIN_M: Final = ((1, 0.3), (2, 0.15), (3, 0.08))
"""Patches are halved so often so near to lamps, and told apart by face at level 3; openings have level 1 only."""

ENCLOSED_M: Final = 0.3
"""Where all rays from a point near a lamp end on lamps within this, it is inside of a closed one: its light gets
nowhere. A bulb that sticks out of its shade has faces partly in there, a thousand times as bright as outside."""

_ENCLOSED_RAYS: Final = 24
SEED_RAYS: Final = 32768
FIRST_RAYS: Final = 16
MOST_WAVES: Final = 8
_RAYS_AT_ONCE: Final = 1 << 16


class Arrivals(NamedTuple):
    """Ends of gather rays after mirrors: hits, last directions, share left by mirrors, light beside reflected light."""

    face: Int32[np.ndarray, " n"]
    u: Float32[np.ndarray, " n"]
    v: Float32[np.ndarray, " n"]
    direction: Float32[np.ndarray, "n 3"]
    distance_m: Float32[np.ndarray, " n"]
    factor: Float32[np.ndarray, " n"]
    radiance: Float32[np.ndarray, "n 3"]


def follow(
    tracer: Tracer, light: DirectLight, origin: Float32[np.ndarray, "n 3"], direction: Float32[np.ndarray, "n 3"]
) -> Arrivals:
    """Trace rays to the first surface that is no mirror, over two mirrors at most (a third swallows the ray)."""
    hits = tracer.trace(origin, direction)
    count = len(origin)
    factor = np.ones(count, np.float32)
    face, u, v, distance = hits
    turned = np.zeros(count, bool)
    if tracer.has_mirrors:
        at = np.flatnonzero(_on_mirror(tracer, face))
        if len(at):
            origin, direction = origin.copy(), direction.copy()
        for _ in range(2):
            if len(at) == 0:
                break
            begin, along, share = origin[at], direction[at], factor[at]
            kernels.mirrored(tracer.geometry, tracer.materials, face[at], u[at], v[at], begin, along, share)
            again = tracer.trace(begin, along)
            origin[at], direction[at], factor[at], turned[at] = begin, along, share, True
            face[at], u[at], v[at] = again.face, again.u, again.v
            distance[at] += again.distance_m
            at = at[_on_mirror(tracer, again.face)]
        factor[at] = 0
    radiance = np.empty((count, 3), np.float32)
    kernels.arriving(
        tracer.geometry,
        tracer.materials,
        tracer.atlas,
        light.lights,
        light.outdoors,
        face,
        u,
        v,
        distance,
        origin,
        direction,
        turned,
        factor,
        radiance,
    )
    return Arrivals(face, u, v, direction, distance, factor, radiance)


def _on_mirror(tracer: Tracer, face: Int32[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    return (face >= 0) & (tracer.materials.mirror > 0)[tracer.geometry.material[face]]


class Fineness(NamedTuple):
    """How often patches are halved: level[i, j, k] in cells of cell_m from the corner `low` on, 0 outside.

    A lampshade is bright inside and dark outside, a window frame in the sun likewise, and both have faces of one
    direction and material a few centimetres apart: patches of the usual size would leak.
    """

    level: UInt8[np.ndarray, "x y z"]
    low: Float32[np.ndarray, "3"]
    cell_m: float


def _fineness(tracer: Tracer, light: DirectLight) -> Fineness:
    corners = tracer.geometry.corners
    low = corners.min((0, 1)) - np.float32(0.01)
    size = corners.max((0, 1)) - low
    cell = max(0.1, float(size.max()) / 256)
    level = np.zeros(tuple(int(np.ceil(extent / cell)) + 1 for extent in size), np.uint8)
    lights = light.lights
    lamp = np.flatnonzero(lights.kind[lights.start, 0] == TRIANGLE)
    for halvings, beyond_m in FINE_WITHIN_M:
        some = lamp if halvings > 1 else np.arange(lights.real)
        middle, reach = lights.centre[:, some].T, lights.radius[some] + np.float32(beyond_m)
        first = np.maximum(np.floor((middle - reach[:, None] - low) / cell), 0).astype(np.int64)
        last = np.floor((middle + reach[:, None] - low) / cell).astype(np.int64) + 1
        for box_low, box_high in zip(first, last, strict=True):
            box = level[tuple(slice(a, max(b, 0)) for a, b in zip(box_low, box_high, strict=True))]
            np.maximum(box, np.uint8(halvings), out=box)
    return Fineness(level, low, cell)


class _Found:
    """Patches as they turn up."""

    def __init__(self, tracer: Tracer, fineness: Fineness) -> None:
        self.tracer = tracer
        self.fineness = fineness
        self.table = Table()
        self.count = 0
        shape = 0, kernels.POINTS, 3
        self.position, self.normal, self.wound, self.albedo = (np.empty(shape, np.float32) for _ in range(4))
        self.used, self.visits, self.material = (np.zeros(0, np.int32) for _ in range(3))

    def visit(self, ends: Arrivals) -> tuple[Int32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Patch of each hit (-1 without one) and the cosine that its ray leaves it at."""
        count = len(ends.face)
        for name in ("position", "normal", "wound", "albedo", "used", "visits", "material"):
            setattr(self, name, grown(getattr(self, name), self.count, self.count + count))
        self.table.reserve(self.count + count)
        patch, cosine = np.empty(count, np.int32), np.zeros(count, np.float32)
        self.count = kernels.visit(
            self.tracer.geometry,
            self.tracer.materials,
            self.tracer.atlas,
            self.fineness,
            ends.face,
            ends.u,
            ends.v,
            ends.direction,
            self.table.keys,
            self.table.values,
            self.count,
            self.position,
            self.normal,
            self.wound,
            self.albedo,
            self.used,
            self.visits,
            self.material,
            patch,
            cosine,
        )
        return patch, cosine


@dataclass(frozen=True, eq=False)
class RoomCache:
    """What patches send out and receive. Rows: patches, then wider surroundings, then whole materials,
    then one of nothing (the last, so that -1 finds it).

    base is the radiance of the diffuse part (before a coat lets it out), lobe the mean radiance that a coat reflects;
    sun_base and sun_lobe what of both is the sun's direct light, which spots stand for; indirect and indirect_coated
    the irradiance that comes from neither lights nor spots. enclosed patches cannot be seen from beyond `ENCLOSED_M`:
    what a ray from there meets is a part of theirs outside, of which nothing is known.
    """

    table: tuple[Fineness, np.ndarray, np.ndarray, np.ndarray, np.ndarray, int, int]
    patches: int
    base: Float32[np.ndarray, "rows 3"]
    lobe: Float32[np.ndarray, "rows 3"]
    sun_base: Float32[np.ndarray, "rows 3"]
    sun_lobe: Float32[np.ndarray, "rows 3"]
    indirect: Float32[np.ndarray, "rows 3"]
    indirect_coated: Float32[np.ndarray, "rows 3"]
    enclosed: Bool[np.ndarray, " rows"]

    def seen(self, row: Int32[np.ndarray, " n"], distance_m: Float32[np.ndarray, " n"]) -> Int32[np.ndarray, " n"]:
        """The rows, -1 in place of what cannot be seen from so far."""
        return np.where(self.enclosed[row] & (distance_m > ENCLOSED_M), np.int32(-1), row)


def solve_room(tracer: Tracer, light: DirectLight, *, seed: int) -> RoomCache:
    """Find the patches, light them and let the light bounce; fills `light.vis` for each row of the cache."""
    fineness = _fineness(tracer, light)
    lit = _Found(tracer, fineness)
    lit.visit(_seed_rays(tracer, light, seed))
    # What the lights see is no fair sample of a patch that is half in shadow: start from what that sees.
    found = _Found(tracer, fineness)
    step = _RAYS_AT_ONCE // FIRST_RAYS
    for start in range(0, lit.count, step):
        found.visit(_gather(tracer, light, lit, start, min(start + step, lit.count), FIRST_RAYS, seed).ends)
    parts = [_linked(found, _gather(tracer, light, found, 0, 0, GATHER_RAYS, seed))]
    done = 0
    step = _RAYS_AT_ONCE // GATHER_RAYS
    for _ in range(MOST_WAVES):
        stop = found.count
        if stop == done:
            break
        for start in range(done, stop, step):
            rays = _gather(tracer, light, found, start, min(start + step, stop), GATHER_RAYS, seed)
            parts.append(_linked(found, rays))
        done = stop
    columns = tuple(np.concatenate(column) for column in zip(*parts, strict=True))
    enclosed, changed = _opened(tracer, light, found, done, seed)
    for start in range(0, len(changed), step):
        some = changed[start : start + step]
        again = _linked(found, _gather(tracer, light, found, 0, 0, GATHER_RAYS, seed, some=some))
        for column, new in zip(columns, again, strict=True):
            each = len(column) // done
            column.reshape(done, each, *column.shape[1:])[some] = new.reshape(len(some), each, *new.shape[1:])
    return _bounced(tracer, light, found, done, columns, enclosed, seed)


def _opened(
    tracer: Tracer, light: DirectLight, found: _Found, count: int, seed: int
) -> tuple[Bool[np.ndarray, " p"], Int32[np.ndarray, " c"]]:
    """Drop points inside of closed lamps from patches that are also outside. Returns which patches are inside
    altogether, and those that lost points."""
    enclosed = np.zeros(count, bool)
    near = found.table.values[found.table.keys >= 1 << 62]
    near = np.sort(near[near < count])
    used = found.used[near]
    owner = np.repeat(np.arange(len(near)), used)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(used) - used, used)
    position, normal, wound = (
        column[near[owner], place][:, None] for column in (found.position, found.normal, found.wound)
    )
    points = len(owner)
    if not points:
        return enclosed, np.zeros(0, np.int32)
    origin, direction = (np.empty((points * _ENCLOSED_RAYS, 3), np.float32) for _ in range(2))
    kernels.gather_rays(
        position,
        normal,
        wound,
        np.zeros(points, np.float32),
        light.coat.through,
        np.ones(points, np.int32),
        np.arange(points, dtype=np.int64),
        _ENCLOSED_RAYS,
        seed + 5,
        origin,
        direction,
        np.empty(len(origin), np.float32),
    )
    hits = tracer.trace(origin, direction)
    items, shown = tracer.geometry.item, tracer.geometry.material
    lamp = np.zeros(int(items.max()) + 1, bool)
    lamp[items[tracer.materials.emission[shown].max(1) > 0]] = True
    stopped = (hits.face >= 0) & (hits.distance_m < ENCLOSED_M) & lamp[items[hits.face]]
    inside = stopped.reshape(points, _ENCLOSED_RAYS).all(1)
    outside = np.bincount(owner, ~inside, len(near))
    enclosed[near[outside == 0]] = True
    keep = ~inside | (outside == 0)[owner]
    changed = np.unique(owner[~keep])
    last = np.cumsum(used)
    for which in changed.tolist():
        patch, kept = near[which], np.flatnonzero(keep[last[which] - used[which] : last[which]])
        for column in (found.position, found.normal, found.wound, found.albedo):
            column[patch, : len(kept)] = column[patch, kept]
        found.used[patch] = len(kept)
    return enclosed, near[changed]


def _seed_rays(tracer: Tracer, light: DirectLight, seed: int) -> Arrivals:
    """Rays out of the lights and from hits of those, so that dark corners of a lit room are found too."""
    rng = np.random.default_rng([seed, 1])
    lights = light.lights
    if len(lights.piece) == 0:
        low, high = (getattr(tracer.geometry.corners, name)((0, 1)) for name in ("min", "max"))
        begin = rng.uniform(low, high, (SEED_RAYS, 3)).astype(np.float32)
    else:
        # Evenly over clusters and over each one's pieces: a weak lamp in a corner finds what a window does not.
        cluster = rng.integers(len(lights.start), size=SEED_RAYS)
        piece = lights.start[cluster] + (rng.random(SEED_RAYS) * lights.pieces[cluster]).astype(np.int64)
        a, b = rng.random((2, SEED_RAYS, 1))
        table, kind = lights.piece[piece].astype(np.float64), lights.kind[piece, :1]
        first, second, third = table[:, 0:3], table[:, 3:6], table[:, 6:9]
        root = np.sqrt(a)
        on_face = first * root * (1 - b) + second * (1 - root) + third * root * b
        on_opening = first + a * second + b * third
        begin = np.where(kind == TRIANGLE, on_face, np.where(kind == OPENING, on_opening, first)).astype(np.float32)
    along = rng.standard_normal((SEED_RAYS, 3)).astype(np.float32)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return follow(tracer, light, begin + np.float32(OFFSET_M) * along, along)


class _Rays(NamedTuple):
    """Gather rays' ends, what a coat lets through of each where it arrives, and how many each patch has."""

    ends: Arrivals
    passed: Float32[np.ndarray, " n"]
    each: int


def _gather(
    tracer: Tracer,
    light: DirectLight,
    found: _Found,
    start: int,
    stop: int,
    rays: int,
    seed: int,
    *,
    some: Int32[np.ndarray, " c"] | None = None,
) -> _Rays:
    """Cosine-weighted rays of the patches from `start` to `stop`, or of some."""
    numbers = np.arange(start, stop, dtype=np.int64) if some is None else some.astype(np.int64)
    some_or_all = slice(start, stop) if some is None else some
    count = len(numbers) * rays
    origin, direction = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    passed = np.empty(count, np.float32)
    kernels.gather_rays(
        found.position[some_or_all],
        found.normal[some_or_all],
        found.wound[some_or_all],
        tracer.materials.roughness[found.material[some_or_all]],
        light.coat.through,
        found.used[some_or_all],
        numbers,
        rays,
        seed,
        origin,
        direction,
        passed,
    )
    return _Rays(follow(tracer, light, origin, direction), passed, rays)


def _linked(found: _Found, rays: _Rays) -> tuple[np.ndarray, ...]:
    """Target patch, cosine there, mirrors' factor, length, share passed here; and irradiance that comes from no
    patch."""
    ends = rays.ends
    target, cosine = found.visit(ends)
    radiance = ends.radiance.reshape(-1, rays.each, 3)
    through = rays.passed.reshape(-1, rays.each, 1)
    scale = np.float32(np.pi / rays.each)
    beside, beside_coated = radiance.sum(1) * scale, (radiance * through).sum(1) * scale
    return target, cosine, ends.factor, ends.distance_m, rays.passed, beside, beside_coated


def _direct(tracer: Tracer, light: DirectLight, found: _Found, sightings: LightVisibility, seed: int) -> Received:
    """Mean over each patch's points of direct light. First a round that only finds out which lights are seen from
    where, then one that knows; `light.vis` holds what both found."""
    count = len(sightings.owner)
    used = found.used[:count]
    owner = np.repeat(np.arange(count, dtype=np.int32), used)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(used) - used, used)
    points = Points(
        found.position[owner, place],
        found.normal[owner, place],
        found.wound[owner, place],
        tracer.materials.roughness[found.material[owner]],
        np.full(len(owner), -1, np.int32),
        np.arange(len(owner), dtype=np.int64),
    )

    alone = place == 0
    first = Points(*(column[alone] for column in points))
    light.received(first, candidates=8, picks=6, sun_picks=0, seed=seed + 6, on_rays=sightings.counting(owner[alone]))
    light.vis = sightings.visibility()
    known = points._replace(row=owner)
    each = light.received(known, candidates=16, picks=8, sun_picks=2, seed=seed + 1, on_rays=sightings.counting(owner))
    light.vis = sightings.visibility()
    weight = (1 / used[owner]).astype(np.float32)
    means = (
        np.stack([np.bincount(owner, part[:, k] * weight, count) for k in range(3)], 1).astype(np.float32)
        for part in each
    )
    return Received(*means)


def _bounced(
    tracer: Tracer,
    light: DirectLight,
    found: _Found,
    count: int,
    columns: tuple[np.ndarray, ...],
    enclosed: Bool[np.ndarray, " p"],
    seed: int,
) -> RoomCache:
    materials, coat = tracer.materials, light.coat
    material = found.material[:count].copy()
    alpha = materials.roughness[material]
    point = np.arange(kernels.POINTS) < found.used[:count, None]
    albedo = (found.albedo[:count] * point[..., None]).sum(1) / np.maximum(found.used[:count], 1)[:, None]
    sightings = LightVisibility(
        found.position[:count],
        found.used[:count],
        found.material[:count],
        lights=max(1, len(light.lights.start)),
        materials=len(materials.mirror),
    )
    direct = _direct(tracer, light, found, sightings, seed)
    target, cosine, factor, distance, passed, beside, beside_coated = columns
    target[target >= count] = -1  # found by the last wave and never lit
    target[enclosed[target] & (distance > ENCLOSED_M)] = -1
    base_link, lobe_link = np.empty(len(target), np.float32), np.empty(len(target), np.float32)
    kernels.links(target, cosine, factor, material, materials, coat.through, coat.reflected, base_link, lobe_link)
    base, lobe, sun_base, sun_lobe, bounced, bounced_coated = (np.zeros((count, 3), np.float32) for _ in range(6))
    surface = albedo, alpha, coat.scale, coat.mean_through
    if len(light.lights.start) > light.lights.real:
        kernels.outgoing(*surface, direct.sun, direct.sun_coated, sun_base, sun_lobe)
        kernels.without_spots(
            target, base_link, lobe_link, passed, distance, factor, sun_base, sun_lobe, NEAR_SPOT_M2, GATHER_RAYS,
            bounced, bounced_coated,
        )  # fmt: skip
        beside -= bounced
        beside_coated -= bounced_coated
        bounced[:], bounced_coated[:] = 0, 0
    total = 0.0
    for _ in range(MOST_BOUNCES):
        arriving = direct.irradiance + beside + bounced, direct.coated + beside_coated + bounced_coated
        kernels.outgoing(*surface, *arriving, base, lobe)
        before, total = total, float(base.sum() + lobe.sum())
        if total - before <= SETTLED * total:
            break
        kernels.gathered(target, base_link, lobe_link, passed, base, lobe, GATHER_RAYS, bounced, bounced_coated)
    solved = base, lobe, sun_base, sun_lobe, beside + bounced, beside_coated + bounced_coated
    return _with_fallbacks(found, sightings, solved, enclosed)


def _with_fallbacks(
    found: _Found, sightings: LightVisibility, columns: tuple[np.ndarray, ...], enclosed: Bool[np.ndarray, " p"]
) -> RoomCache:
    """Append means over wider cells and over materials to the rows."""
    table, count, wide = found.table, len(sightings.owner), sightings.wide
    table.keys[table.values >= count] = -2  # of the last wave: -2 is no key, and no empty place either
    tables: list[np.ndarray] = []
    for column in columns:
        around = _means(column, sightings.owner, count=wide)
        whole = _means(column, sightings.material, count=sightings.materials, fill=True)
        nothing = np.zeros((1, column.shape[1]), np.float32)
        tables.append(np.concatenate([column, around, whole, nothing]).astype(np.float32))
    base, lobe, sun_base, sun_lobe, indirect, indirect_coated = tables
    coarse = sightings.coarse
    return RoomCache(
        (found.fineness, table.keys, table.values, coarse.keys, coarse.values, count, count + wide),
        count,
        base,
        lobe,
        sun_base,
        sun_lobe,
        indirect,
        indirect_coated,
        np.concatenate([enclosed, np.zeros(len(indirect) - count, bool)]),
    )


def _means(
    column: Float[np.ndarray, "p c"],
    owner: Int32[np.ndarray, " p"],
    *,
    count: int,
    fill: bool = False,
) -> Float[np.ndarray, "_ c"]:
    """Mean of the rows of each owner; those that own nothing get the mean of all where `fill` says so."""
    number = np.bincount(owner, minlength=count)
    total = np.stack([np.bincount(owner, column[:, k], count) for k in range(column.shape[1])], 1)
    mean = total / np.maximum(number, 1)[:, None]
    if fill and len(column):
        mean[number == 0] = column.mean(0)
    return mean
