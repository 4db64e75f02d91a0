# pyright: reportMissingParameterType=false
"""Kernels of the room's cache: surface cells as patches, rays between them, bounces.

A patch is what lies in one cell of `CELL_M` (a half or a quarter of it near lights and openings) with one material and
one bucket of face normals. Hits create patches, so that only what light reaches has one; each keeps up to `POINTS` of
the places where it was hit.
"""

import math

import numpy as np
from numba import njit

from roomlight_generator.transport.kernels.common import (
    JIT,
    PHI1,
    PHI2,
    cosine_direction,
    direction_bucket,
    fraction,
    in_row,
    in_table,
    mixed,
    sky_radiance,
    slot_of,
    unit,
)
from roomlight_generator.transport.kernels.lights import crossings, emission_at, left_to_gathering
from roomlight_generator.transport.kernels.surfaces import OFFSET, face_normal, shading_normal, texture_at

CELL_M = 0.08
POINTS = 4
COARSE = 3  # the fallback's cells are so many times as wide, of any normal
FOOT_M = 0.04  # textures are averaged over this at each of a patch's points


@njit(**JIT)
def patch_key(fine, x, y, z, gx, gy, gz, material, face):
    """11 bits an axis (30 m at least), 7 for the normal, 2 for the fineness, 20 for the material; at level 3, the
    face stands for normal and material: a lampshade's two skins are a millimetre apart."""
    level = 0
    i = np.int64(np.floor((x - fine.low[0]) / fine.cell_m))
    j = np.int64(np.floor((y - fine.low[1]) / fine.cell_m))
    k = np.int64(np.floor((z - fine.low[2]) / fine.cell_m))
    if 0 <= i < fine.level.shape[0] and 0 <= j < fine.level.shape[1] and 0 <= k < fine.level.shape[2]:
        level = np.int64(fine.level[i, j, k])
    scale = (1 << min(level, 2)) / CELL_M
    i = np.int64(np.floor(x * scale + 0.37)) & 2047
    j = np.int64(np.floor(y * scale + 0.37)) & 2047
    k = np.int64(np.floor(z * scale + 0.37)) & 2047
    if level == 3:
        side = 1 if gx + 0.7 * gy + 0.43 * gz > 0 else 0
        return np.int64(1 << 62) | ((((i << 11) | j) << 11 | k) << 1 | side) << 26 | np.int64(face)
    bucket = direction_bucket(gx, gy, gz, 4)
    return ((((((i << 11) | j) << 11 | k) << 7) | bucket) << 2 | level) << 20 | np.int64(material)


@njit(**JIT)
def coarse_key(x, y, z, material):
    """The same for the fallback."""
    i = np.int64(np.floor(x / (COARSE * CELL_M) + 0.37)) & 1023
    j = np.int64(np.floor(y / (COARSE * CELL_M) + 0.37)) & 1023
    k = np.int64(np.floor(z / (COARSE * CELL_M) + 0.37)) & 1023
    return (((i << 10) | j) << 10 | k) << 20 | np.int64(material)


@njit(**JIT)
def visit(
    geometry, materials, atlas, fine, face, u, v, directions, keys, values, known, position, normal, wound, albedo,
    used, visits, material, patch, cosine,
):  # fmt: skip
    """Patch and cosine of the leaving ray for each hit (-1 without a face); new ones are appended after `known`.

    Returns how many there are now. position, normal, wound, albedo: [patches, POINTS, 3]; used: points of each, visits:
    hits.
    """
    for i in range(len(face)):
        f = face[i]
        patch[i] = -1
        if f < 0:
            continue
        corner = geometry.corners[f]
        s, t = u[i], v[i]
        w = 1 - s - t
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        gx, gy, gz = face_normal(corner, dx, dy, dz)
        x = w * corner[0, 0] + s * corner[1, 0] + t * corner[2, 0]
        y = w * corner[0, 1] + s * corner[1, 1] + t * corner[2, 1]
        z = w * corner[0, 2] + s * corner[1, 2] + t * corner[2, 2]
        m = geometry.material[f]
        nx, ny, nz = shading_normal(geometry.normals[f], s, t, gx, gy, gz)
        cosine[i] = max(-(nx * dx + ny * dy + nz * dz), 0.0)
        key = patch_key(fine, x, y, z, gx, gy, gz, m, f)
        at = slot_of(keys, key)
        if keys[at] == -1:
            keys[at], values[at] = key, known
            material[known] = m
            used[known], visits[known] = 0, 0
            known += 1
        p = values[at]
        patch[i] = p
        # A reservoir: each hit is kept with the same chance, whether it came early or late.
        n = visits[p]
        visits[p] = n + 1
        if n >= POINTS:
            n = np.int64(unit(mixed(np.uint64(p) * np.uint64(1048583) + np.uint64(n))) * (n + 1))
        if n < POINTS:
            used[p] = max(used[p], n + 1)
            position[p, n, 0], position[p, n, 1], position[p, n, 2] = x + OFFSET * gx, y + OFFSET * gy, z + OFFSET * gz
            normal[p, n, 0], normal[p, n, 1], normal[p, n, 2] = nx, ny, nz
            wound[p, n, 0], wound[p, n, 1], wound[p, n, 2] = gx, gy, gz
            r, g, b = 1.0, 1.0, 1.0
            if materials.texture[m] >= 0:
                r, g, b = texture_at(geometry, atlas, materials.texture[m], f, s, t, -gx, -gy, -gz, gx, gy, gz, FOOT_M)
            albedo[p, n, 0] = materials.albedo[m, 0] * r
            albedo[p, n, 1] = materials.albedo[m, 1] * g
            albedo[p, n, 2] = materials.albedo[m, 2] * b
    return known


@njit(**JIT)
def gather_rays(position, normal, wound, alpha, through, used, number, rays, seed, origin, direction, passed):
    """`rays` cosine-weighted rays from each patch, spread over its points, and what a coat would let through of each.

    Shading normals may lean so far that a ray starts into its own surface: it is turned up about that surface.
    """
    for p in range(len(used)):
        state = mixed(np.uint64(number[p]) ^ mixed(np.uint64(seed)))
        turn1 = unit(state)
        turn2 = unit(mixed(state))
        for k in range(rays):
            n = k % used[p]
            x, y, z, c = cosine_direction(
                normal[p, n, 0], normal[p, n, 1], normal[p, n, 2],
                fraction(turn1 + PHI1 * k), fraction(turn2 + PHI2 * k),
            )  # fmt: skip
            gx, gy, gz = wound[p, n, 0], wound[p, n, 1], wound[p, n, 2]
            under = x * gx + y * gy + z * gz
            if under < 0:
                x, y, z = x - 2 * under * gx, y - 2 * under * gy, z - 2 * under * gz
            at = p * rays + k
            for a in range(3):
                origin[at, a] = position[p, n, a]
            direction[at, 0], direction[at, 1], direction[at, 2] = x, y, z
            passed[at] = in_table(through, alpha[p], c) if alpha[p] > 0 else 1.0


@njit(**JIT)
def mirrored(geometry, materials, face, u, v, origin, direction, factor):
    """Turn rays that met a mirror: in place, new origin, direction, and the factor by its reflectance."""
    for i in range(len(face)):
        corner = geometry.corners[face[i]]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        gx, gy, gz = face_normal(corner, dx, dy, dz)
        s, t = u[i], v[i]
        w = 1 - s - t
        nx, ny, nz = shading_normal(geometry.normals[face[i]], s, t, gx, gy, gz)
        slope = dx * nx + dy * ny + dz * nz
        x, y, z = dx - 2 * slope * nx, dy - 2 * slope * ny, dz - 2 * slope * nz
        under = x * gx + y * gy + z * gz
        if under < 0:
            x, y, z = x - 2 * under * gx, y - 2 * under * gy, z - 2 * under * gz
        origin[i, 0] = w * corner[0, 0] + s * corner[1, 0] + t * corner[2, 0] + OFFSET * gx
        origin[i, 1] = w * corner[0, 1] + s * corner[1, 1] + t * corner[2, 1] + OFFSET * gy
        origin[i, 2] = w * corner[0, 2] + s * corner[1, 2] + t * corner[2, 2] + OFFSET * gz
        direction[i, 0], direction[i, 1], direction[i, 2] = x, y, z
        factor[i] *= materials.mirror[geometry.material[face[i]]]


@njit(**JIT)
def arriving(
    geometry, materials, atlas, lights, outdoors, face, u, v, distance, origin, direction, turned, factor, radiance
):
    """What rays bring beside reflected light, because shadow rays do not: sky past no opening, lights seen in a mirror,
    and a share of very near lights."""
    for i in range(len(face)):
        r, g, b, share = 0.0, 0.0, 0.0, factor[i]
        if face[i] < 0:
            dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
            if not turned[i]:
                found, _, near = crossings(
                    outdoors.hole, outdoors.parts, origin[i, 0], origin[i, 1], origin[i, 2], dx, dy, dz
                )
                if found > 0:
                    share *= near
            r, g, b = sky_radiance(outdoors.panorama, dx, dy, dz)
        elif lights.near_area[face[i]] > 0:
            if not turned[i]:
                share *= left_to_gathering(distance[i] * distance[i], lights.near_area[face[i]])
            r, g, b = emission_at(geometry, materials, atlas, face[i], u[i], v[i])
        radiance[i, 0], radiance[i, 1], radiance[i, 2] = r * share, g * share, b * share


@njit(**JIT)
def links(target, cosine, factor, material, materials, through, reflected, base, lobe):
    """How much of its patch's base and lobe each ray sees."""
    for i in range(len(target)):
        base[i], lobe[i] = 0.0, 0.0
        if target[i] >= 0:
            alpha = materials.roughness[material[target[i]]]
            if alpha > 0:
                base[i] = factor[i] * in_table(through, alpha, cosine[i])
                lobe[i] = factor[i] * in_table(reflected, alpha, cosine[i])
            else:
                base[i] = factor[i]


@njit(**JIT)
def without_spots(target, base, lobe, passed, distance, factor, sun_base, sun_lobe, area, rays, irradiance, coated):
    """What rays bring of sunlit spots beyond what `left_to_gathering` leaves them: to be taken off."""
    for p in range(len(irradiance)):
        scale = math.pi / rays
        for c in range(3):
            irradiance[p, c], coated[p, c] = 0.0, 0.0
        for k in range(p * rays, (p + 1) * rays):
            j = target[k]
            if j < 0 or factor[k] < 1:
                continue
            away = (1 - left_to_gathering(distance[k] * distance[k], area)) * scale
            for c in range(3):
                light = away * (base[k] * sun_base[j, c] + lobe[k] * sun_lobe[j, c])
                irradiance[p, c] += light
                coated[p, c] += light * passed[k]


@njit(**JIT)
def gathered(target, base, lobe, passed, base_radiance, lobe_radiance, rays, irradiance, coated):
    """One bounce: irradiance of each patch from its rays, plain and as let through by its coat."""
    for p in range(len(irradiance)):
        a0, a1, a2, b0, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(p * rays, (p + 1) * rays):
            j = target[k]
            if j < 0:
                continue
            f, h, t = base[k], lobe[k], passed[k]
            r = f * base_radiance[j, 0] + h * lobe_radiance[j, 0]
            g = f * base_radiance[j, 1] + h * lobe_radiance[j, 1]
            b = f * base_radiance[j, 2] + h * lobe_radiance[j, 2]
            a0, a1, a2, b0, b1, b2 = a0 + r, a1 + g, a2 + b, b0 + t * r, b1 + t * g, b2 + t * b
        scale = math.pi / rays
        irradiance[p, 0], irradiance[p, 1], irradiance[p, 2] = a0 * scale, a1 * scale, a2 * scale
        coated[p, 0], coated[p, 1], coated[p, 2] = b0 * scale, b1 * scale, b2 * scale


@njit(**JIT)
def outgoing(albedo, alpha, coat_scale, mean_through, irradiance, coated, base_radiance, lobe_radiance):
    """Radiance of each patch's base (before its coat lets it out) and the mean radiance that its lobe reflects."""
    for p in range(len(alpha)):
        if alpha[p] > 0:
            scale = in_row(coat_scale, alpha[p]) / math.pi
            kept = 1 / (math.pi * (1 - in_row(mean_through, alpha[p])))
            for c in range(3):
                base_radiance[p, c] = albedo[p, c] * scale * coated[p, c]
                lobe_radiance[p, c] = kept * max(irradiance[p, c] - coated[p, c], 0.0)
        else:
            for c in range(3):
                base_radiance[p, c] = albedo[p, c] / math.pi * irradiance[p, c]
                lobe_radiance[p, c] = 0.0


@njit(**JIT)
def visibility(owner, cluster, seen, count, row, tried, found):
    """Count each patch's shadow rays and the visible ones by light."""
    for k in range(count):
        if cluster[k] >= 0:
            tried[row[owner[k]], cluster[k]] += 1
            if seen[k]:
                found[row[owner[k]], cluster[k]] += 1


@njit(**JIT)
def add_counts(tried, found, owner, tried_sum, found_sum):
    """Sums of the patches' counts over each owner."""
    for p in range(len(owner)):
        for k in range(tried.shape[1]):
            tried_sum[owner[p], k] += tried[p, k]
            found_sum[owner[p], k] += found[p, k]


@njit(**JIT)
def shares(tried, found, owner, around, prior, out):
    """The share of each light that patches see, in 255ths; their owner's share counts as so many rays."""
    for p in range(len(owner)):
        for k in range(tried.shape[1]):
            share = (found[p, k] + prior * around[owner[p], k]) / (tried[p, k] + prior)
            out[p, k] = np.uint8(255 * min(share, np.float32(1.0)) + np.float32(0.5))


@njit(**JIT)
def fill_coarse(position, used, material, keys, values, known, owner):
    """Give each patch its place in the fallback's table; returns how many places there are."""
    for p in range(len(used)):
        key = coarse_key(position[p, 0, 0], position[p, 0, 1], position[p, 0, 2], material[p])
        at = slot_of(keys, key)
        if keys[at] == -1:
            keys[at], values[at] = key, known
            known += 1
        owner[p] = values[at]
    return known


@njit(**JIT)
def look_up(
    fine, keys, values, coarse_keys, coarse_values, first_coarse, first_material, x, y, z, gx, gy, gz, material, face
):
    """Row of the patch at a place, else of its surroundings of that material, else of that material's mean; inside of
    lamps, where neighbours tell nothing, -1."""
    key = patch_key(fine, x, y, z, gx, gy, gz, material, face)
    at = slot_of(keys, key)
    if keys[at] != -1:
        return values[at]
    if key >> 62:
        return -1
    at = slot_of(coarse_keys, coarse_key(x, y, z, material))
    if coarse_keys[at] != -1:
        return first_coarse + coarse_values[at]
    return first_material + material


@njit(**JIT)
def find(geometry, table, face, u, v, directions, row, cosine):
    """Row of the tables of radiance for each hit (-1 without a face), and the cosine of the leaving ray."""
    fine, keys, values, coarse_keys, coarse_values, first_coarse, first_material = table
    for i in range(len(face)):
        f = face[i]
        row[i] = -1
        if f < 0:
            continue
        corner = geometry.corners[f]
        s, t = u[i], v[i]
        w = 1 - s - t
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        gx, gy, gz = face_normal(corner, dx, dy, dz)
        nx, ny, nz = shading_normal(geometry.normals[f], s, t, gx, gy, gz)
        cosine[i] = max(-(nx * dx + ny * dy + nz * dz), 0.0)
        row[i] = look_up(
            fine, keys, values, coarse_keys, coarse_values, first_coarse, first_material,
            w * corner[0, 0] + s * corner[1, 0] + t * corner[2, 0],
            w * corner[0, 1] + s * corner[1, 1] + t * corner[2, 1],
            w * corner[0, 2] + s * corner[1, 2] + t * corner[2, 2],
            gx, gy, gz, geometry.material[f], f,
        )  # fmt: skip


@njit(**JIT)
def find_points(table, position, wound, material, face, row):
    """Row of the tables for surface points."""
    fine, keys, values, coarse_keys, coarse_values, first_coarse, first_material = table
    for i in range(len(material)):
        row[i] = look_up(
            fine, keys, values, coarse_keys, coarse_values, first_coarse, first_material,
            position[i, 0], position[i, 1], position[i, 2], wound[i, 0], wound[i, 1], wound[i, 2],
            material[i], face[i],
        )  # fmt: skip
