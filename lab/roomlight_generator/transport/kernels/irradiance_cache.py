# pyright: reportMissingParameterType=false
"""Kernels of the irradiance cache: cells' keys, records of indirect light and their interpolation.

Frames: world, y up, metres; irradiance in kcd/m2 times steradians.
"""

import math

import numpy as np
from numba import njit

from roomlight_generator.transport.kernels.common import JIT, direction_bucket, in_row, in_table, slot_of
from roomlight_generator.transport.kernels.lights import left_to_gathering

CELL_PIXELS = 1.9  # a cell's width is the power of two in metres nearest to the footprint of this many pixels
LOWEST_LEVEL = -12
NORMAL_AGREES = 0.8  # cosine: records count for normals within 37 degrees, in full at 0
SMALLEST_PIXELS = 3.0  # least reach of a record
FARTHEST_M = 0.35  # largest reach of a record
BLEND = 1.6  # a record counts up to this many times its reach: the mean of more records has less noise
COVERED = 0.35  # a point gets a new record if the total weight of the records around it is below this


@njit(**JIT)
def coat_bucket(alpha):
    """Return 0 without a coat, else 1 to 7 by its roughness."""
    return 0 if alpha <= 0 else 1 + min(np.int64(alpha * 10), 6)


@njit(**JIT)
def cell_key(point, normal, alpha, foot):
    """Pack a cell's key: 4 bits for the level, 15 an axis, 9 for the normal (11 degrees), 3 for the coat."""
    x, y, z = point
    nx, ny, nz = normal
    level = np.int64(np.floor(math.log2(CELL_PIXELS * foot) + 0.5))
    level = min(max(level, LOWEST_LEVEL), LOWEST_LEVEL + 15)
    scale = 2.0 ** (-level)
    i = np.int64(np.floor(x * scale + 0.37)) & 32767
    j = np.int64(np.floor(y * scale + 0.37)) & 32767
    k = np.int64(np.floor(z * scale + 0.37)) & 32767
    bucket = direction_bucket(nx, ny, nz, 8)
    return (((((level - LOWEST_LEVEL) << 15 | i) << 15 | j) << 15 | k) << 9 | bucket) << 3 | coat_bucket(alpha)


@njit(**JIT)
def claim(points, table, known, cell, fresh):
    """Write the cell of each point and claim new cells; returns the number of new cells.

    Args:
        points: The points (`CachePoints`), n of them.
        table: Keys and cells.
        known: Number of cells so far: the number of the first new cell.
        cell: Receives each point's cell, [n].
        fresh: Receives the first point in each new cell.
    """
    position, normal, alpha, foot = points
    keys, values = table
    new = 0
    for i in range(len(foot)):
        key = cell_key(
            (position[i, 0], position[i, 1], position[i, 2]), (normal[i, 0], normal[i, 1], normal[i, 2]),
            alpha[i], foot[i],
        )  # fmt: skip
        at = slot_of(keys, key)
        if keys[at] == -1:
            keys[at], values[at] = key, known + new
            fresh[new] = i
            new += 1
        cell[i] = values[at]
    return new


@njit(**JIT)
def record_key(level, i, j, k):
    """Pack the key of a grid cell of records: 6 bits for the level, 18 an axis."""
    return ((np.int64(level) & 63) << 18 | (i & 262143)) << 36 | (j & 262143) << 18 | (k & 262143)


@njit(**JIT)
def insert(records, lists, which, entries):
    """List a record in every grid cell of its level that its reach touches; returns how many entries there are."""
    keys, heads, entry_record, entry_next, levels = lists
    position = records.position
    r = BLEND * records.reach[which]
    level = np.int64(np.ceil(math.log2(2 * r)))
    levels[level + 32] = 1
    scale = 2.0 ** (-level)
    x, y, z = position[which, 0], position[which, 1], position[which, 2]
    for i in range(np.int64(np.floor((x - r) * scale)), np.int64(np.floor((x + r) * scale)) + 1):
        for j in range(np.int64(np.floor((y - r) * scale)), np.int64(np.floor((y + r) * scale)) + 1):
            for k in range(np.int64(np.floor((z - r) * scale)), np.int64(np.floor((z + r) * scale)) + 1):
                key = record_key(level, i, j, k)
                at = slot_of(keys, key)
                if keys[at] == -1:
                    keys[at], heads[at] = key, -1
                entry_record[entries], entry_next[entries] = which, heads[at]
                heads[at] = entries
                entries += 1
    return entries


@njit(**JIT)
def weigh_records(records, lists, point, point_normal, bucket, foot):
    """Weigh the records about a point by distance and normal.

    Returns the sum of the weights within the records' reach, the sum within `BLEND` times their reach, and the red,
    green and blue irradiance weighted by the latter.
    """
    position, normal, coat, clear, reach, irradiance = records
    keys, heads, entry_record, entry_next, levels = lists
    x, y, z = point
    nx, ny, nz = point_normal
    cover, total, red, green, blue = 0.0, 0.0, 0.0, 0.0, 0.0
    for at_level in range(64):
        if levels[at_level] == 0:
            continue
        scale = 2.0 ** (32 - at_level)
        key = record_key(
            at_level - 32,
            np.int64(np.floor(x * scale)),
            np.int64(np.floor(y * scale)),
            np.int64(np.floor(z * scale)),
        )
        at = slot_of(keys, key)
        if keys[at] == -1:
            continue
        entry = heads[at]
        while entry >= 0:
            which = entry_record[entry]
            entry = entry_next[entry]
            if coat[which] != bucket:
                continue
            r = min(max(clear[which], SMALLEST_PIXELS * foot), reach[which])
            dx, dy, dz = x - position[which, 0], y - position[which, 1], z - position[which, 2]
            d_sq = dx * dx + dy * dy + dz * dz
            if d_sq >= (BLEND * r) ** 2:
                continue
            mx, my, mz = normal[which, 0], normal[which, 1], normal[which, 2]
            agree = nx * mx + ny * my + nz * mz
            if agree <= NORMAL_AGREES:
                continue
            off = 0.5 * abs(dx * (nx + mx) + dy * (ny + my) + dz * (nz + mz))
            if off > 0.25 * r + 1e-3:
                continue
            along = math.sqrt(d_sq) / r
            agree = (agree - NORMAL_AGREES) / (1 - NORMAL_AGREES)
            cover += max(1 - along, 0.0) * agree
            weight = (1 - along / BLEND) * agree
            total += weight
            red += weight * irradiance[which, 0]
            green += weight * irradiance[which, 1]
            blue += weight * irradiance[which, 2]
    return cover, total, red, green, blue


@njit(**JIT)
def choose_records(points, reach_pixels, every, records, lists, known, entries, fresh):
    """Add a record at each point that the records so far do not cover; returns the numbers of records and of entries.

    The points are considered one after the other, and new records count at their full reach.

    Args:
        points: The points (`CachePoints`).
        reach_pixels: Reach of the records in pixels.
        every: One in so many points is considered.
        records: The records, `known` of them filled.
        lists: Which records reach into a grid cell.
        known: Number of records so far.
        entries: Number of list entries so far.
        fresh: Receives the index of each new record's point.
    """
    position, normal, alpha, foot = points
    r_position, r_normal, r_coat, r_clear, r_reach, r_irradiance = records
    new = 0
    for i in range(0, len(foot), every):
        bucket = coat_bucket(alpha[i])
        cover, _, _, _, _ = weigh_records(
            records, lists, (position[i, 0], position[i, 1], position[i, 2]),
            (normal[i, 0], normal[i, 1], normal[i, 2]), bucket, foot[i],
        )  # fmt: skip
        if cover >= COVERED:
            continue
        which = known + new
        for a in range(3):
            r_position[which, a], r_normal[which, a] = position[i, a], normal[i, a]
            r_irradiance[which, a] = 0.0
        r_coat[which] = bucket
        r_clear[which] = 1e9
        r_reach[which] = min(reach_pixels * foot[i], FARTHEST_M)
        fresh[new] = i
        new += 1
        entries = insert(records, lists, which, entries)
    return known + new, entries


@njit(**JIT)
def interpolate(points, records, lists, fallback, out):
    """Interpolate the indirect irradiance of each point from the records about it; the fallback without any."""
    position, normal, alpha, foot = points
    for i in range(len(foot)):
        _, total, red, green, blue = weigh_records(
            records, lists, (position[i, 0], position[i, 1], position[i, 2]),
            (normal[i, 0], normal[i, 1], normal[i, 2]), coat_bucket(alpha[i]), foot[i],
        )  # fmt: skip
        if total > 1e-6:
            out[i, 0], out[i, 1], out[i, 2] = red / total, green / total, blue / total
        else:
            out[i, 0], out[i, 1], out[i, 2] = fallback[i, 0], fallback[i, 1], fallback[i, 2]


@njit(**JIT)
def add_cached(hits, coat, cached, area, radiance):
    """Add the cached radiance of the surfaces that rays hit (`CacheHits`) to what the rays bring.

    Sunlit spots count only by the share that `left_to_gathering` leaves to rays, but in full after a mirror.
    """
    row, cosine, alpha, distance, mirrored, factor = hits
    base, lobe, sun_base, sun_lobe = cached
    through, reflected = coat.through, coat.reflected
    for i in range(len(row)):
        p = row[i]
        if p < 0:
            continue
        t, e = factor[i], 0.0
        if alpha[i] > 0:
            e = factor[i] * in_table(reflected, alpha[i], cosine[i])
            t = factor[i] * in_table(through, alpha[i], cosine[i])
        away = 0.0 if mirrored[i] else 1 - left_to_gathering(distance[i] * distance[i], area)
        for c in range(3):
            radiance[i, c] += t * (base[p, c] - away * sun_base[p, c]) + e * (lobe[p, c] - away * sun_lobe[p, c])


@njit(**JIT)
def subtract_spots(light, sun, distance, area):
    """Subtract the sunlight that rays of that length should not bring: all but the share of `left_to_gathering`."""
    for i in range(len(distance)):
        away = 1 - left_to_gathering(distance[i] * distance[i], area)
        for c in range(3):
            light[i, c] -= away * sun[i, c]


@njit(**JIT)
def reflected_light(irradiance, coated, albedo, alpha, cosine, coat, out):
    """Write the radiance that surfaces send along rays, as if the light of a coat's lobe were even.

    Args:
        irradiance: Irradiance of the surfaces, [n, 3].
        coated: Irradiance that the coat lets through, [n, 3].
        albedo: Reflectance of the base, [n, 3].
        alpha: Roughness of the coat (0: none), [n].
        cosine: Cosine at which the ray leaves, [n].
        coat: The coat's tables.
        out: Receives the radiance, [n, 3].
    """
    through, reflected, scale, _, mean_through = coat
    for i in range(len(alpha)):
        if alpha[i] > 0:
            t = in_table(through, alpha[i], cosine[i]) * in_row(scale, alpha[i]) / math.pi
            e = in_table(reflected, alpha[i], cosine[i]) / (math.pi * (1 - in_row(mean_through, alpha[i])))
            for c in range(3):
                out[i, c] = t * albedo[i, c] * coated[i, c] + e * max(irradiance[i, c] - coated[i, c], 0.0)
        else:
            for c in range(3):
                out[i, c] = albedo[i, c] / math.pi * irradiance[i, c]


@njit(**JIT)
def diffuse_light(received, albedo, alpha, cosine, coat, with_lobe, out):
    """Write the radiance that surfaces send out.

    Args:
        received: Irradiance, as let through by a coat, if any, [n, 3].
        albedo: Reflectance of the base, [n, 3].
        alpha: Roughness of the coat (0: none), [n].
        cosine: Cosine at which the ray leaves, [n].
        coat: The coat's tables.
        with_lobe: Add the coat's own reflection as if light arrived evenly from all sides, [n].
        out: Receives the radiance, [n, 3].
    """
    through, reflected, scale, _, mean_through = coat
    for i in range(len(alpha)):
        base, extra = 1 / math.pi, 0.0
        if alpha[i] > 0:
            base = in_table(through, alpha[i], cosine[i]) * in_row(scale, alpha[i]) / math.pi
            if with_lobe[i]:
                extra = in_table(reflected, alpha[i], cosine[i]) / (math.pi * in_row(mean_through, alpha[i]))
        for c in range(3):
            out[i, c] = received[i, c] * (base * albedo[i, c] + extra)
