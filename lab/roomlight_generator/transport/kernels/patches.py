# pyright: reportMissingParameterType=false
"""Kernels of the room's cache: patches of the surfaces, rays between them, bounces.

A patch is the surface in one cell of `CELL_M` (a half or a quarter of it near lights and openings) with one material
and one bucket of face normals. Hits create patches, so only surfaces that light reaches have one; each keeps up to
`POINTS` of the places where it was hit. Frames: world, y up, metres; radiance in kcd/m2.
"""

import math

import numpy as np
from numba import njit

from roomlight.kernels.common import mixed
from roomlight_generator.transport.kernels.common import (
    JIT,
    PHI1,
    PHI2,
    cosine_direction,
    direction_bucket,
    fraction,
    in_row,
    in_table,
    sky_radiance,
    slot_of,
    unit,
)
from roomlight_generator.transport.kernels.lights import crossings, left_to_gathering
from roomlight_generator.transport.kernels.surfaces import OFFSET, hit_at, texture_at

CELL_M = 0.08
POINTS = 4
COARSE = 3  # the fallback's cells are this many times as wide, and hold all normals
FOOT_M = 0.04  # textures are averaged over this at each of a patch's points


@njit(**JIT)
def patch_key(fine, point, geometric_normal, material, face):
    """Pack a patch's key: 11 bits an axis (30 m at least), 7 for the normal, 2 for the fineness, 20 for the material.

    At level 3 the face stands for normal and material: a lampshade's two skins are a millimetre apart.
    """
    x, y, z = point
    gx, gy, gz = geometric_normal
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
    """Pack the key of a fallback cell: 10 bits an axis, 20 for the material."""
    i = np.int64(np.floor(x / (COARSE * CELL_M) + 0.37)) & 1023
    j = np.int64(np.floor(y / (COARSE * CELL_M) + 0.37)) & 1023
    k = np.int64(np.floor(z / (COARSE * CELL_M) + 0.37)) & 1023
    return (((i << 10) | j) << 10 | k) << 20 | np.int64(material)


@njit(**JIT)
def visit(scene, fine, ends, table, patches, known, patch, cosine):
    """Write the patch of each hit, and append new patches; returns the number of patches.

    Args:
        scene: Geometry, materials and textures (`SceneArrays`).
        fine: How often patches are halved.
        ends: Where the rays ended, n of them.
        table: Keys and rows of the patches.
        patches: The patches (`PatchColumns`).
        known: Number of patches so far.
        patch: Receives the patch of each hit, -1 without a face, [n].
        cosine: Receives the cosine at which each ray leaves its surface, [n].
    """
    geometry, materials = scene.geometry, scene.materials
    face, u, v, directions = ends
    keys, values = table
    position, normal, geometric_normal, albedo, used, visits, material = patches
    for i in range(len(face)):
        f = face[i]
        patch[i] = -1
        if f < 0:
            continue
        (x, y, z), (gx, gy, gz), (nx, ny, nz) = hit_at(geometry, ends, i)
        m = geometry.material[f]
        cosine[i] = max(-(nx * directions[i, 0] + ny * directions[i, 1] + nz * directions[i, 2]), 0.0)
        key = patch_key(fine, (x, y, z), (gx, gy, gz), m, f)
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
            geometric_normal[p, n, 0], geometric_normal[p, n, 1], geometric_normal[p, n, 2] = gx, gy, gz
            r, g, b = 1.0, 1.0, 1.0
            if materials.texture[m] >= 0:
                r, g, b = texture_at(scene, materials.texture[m], f, u[i], v[i], (-gx, -gy, -gz), (gx, gy, gz), FOOT_M)
            albedo[p, n, 0] = materials.albedo[m, 0] * r
            albedo[p, n, 1] = materials.albedo[m, 1] * g
            albedo[p, n, 2] = materials.albedo[m, 2] * b
    return known


@njit(**JIT)
def patch_rays(points, through, rays, seed, out):
    """Write cosine-weighted rays from each patch, spread over its points.

    A shading normal may lean so far that a ray starts into its own surface: such a ray is mirrored out of the surface.

    Args:
        points: The patches' points (`PatchPoints`).
        through: The coat's table: the share of light let through, by roughness and cosine.
        rays: Rays of a patch.
        out: The rays (`PatchRays`), [p * rays].
    """
    position, normal, geometric_normal, used, alpha, stream = points
    origin, direction, passed = out
    for p in range(len(used)):
        state = mixed(np.uint64(stream[p]) ^ mixed(np.uint64(seed)))
        shift1 = unit(state)
        shift2 = unit(mixed(state))
        for k in range(rays):
            n = k % used[p]
            x, y, z, c = cosine_direction(
                normal[p, n, 0], normal[p, n, 1], normal[p, n, 2],
                fraction(shift1 + PHI1 * k), fraction(shift2 + PHI2 * k),
            )  # fmt: skip
            gx, gy, gz = geometric_normal[p, n, 0], geometric_normal[p, n, 1], geometric_normal[p, n, 2]
            under = x * gx + y * gy + z * gz
            if under < 0:
                x, y, z = x - 2 * under * gx, y - 2 * under * gy, z - 2 * under * gz
            at = p * rays + k
            for a in range(3):
                origin[at, a] = position[p, n, a]
            direction[at, 0], direction[at, 1], direction[at, 2] = x, y, z
            passed[at] = in_table(through, alpha[p], c) if alpha[p] > 0 else 1.0


@njit(**JIT)
def mirror_rays(geometry, materials, ends, origin, factor):
    """Reflect rays that met a mirror, in place: origin, direction (of `ends`), and factor times its reflectance."""
    face, direction = ends.face, ends.direction
    for i in range(len(face)):
        (px, py, pz), (gx, gy, gz), (nx, ny, nz) = hit_at(geometry, ends, i)
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        slope = dx * nx + dy * ny + dz * nz
        x, y, z = dx - 2 * slope * nx, dy - 2 * slope * ny, dz - 2 * slope * nz
        under = x * gx + y * gy + z * gz
        if under < 0:
            x, y, z = x - 2 * under * gx, y - 2 * under * gy, z - 2 * under * gz
        origin[i, 0], origin[i, 1], origin[i, 2] = px + OFFSET * gx, py + OFFSET * gy, pz + OFFSET * gz
        direction[i, 0], direction[i, 1], direction[i, 2] = x, y, z
        factor[i] *= materials.mirror[geometry.material[face[i]]]


@njit(**JIT)
def arriving(scene, sources, ends, origin, distance, mirrored, factor, radiance):
    """Write the emitted light that gather rays bring, which shadow rays do not bring.

    This is the sky where no opening leads to it, lights seen in a mirror, and a share of very near lights.

    Args:
        scene: Geometry, materials and textures (`SceneArrays`).
        sources: Lights, outdoors and surfaces of lights.
        ends: Where the rays ended, n of them.
        origin, distance: The rays' last origins and their lengths, [n, 3], [n].
        mirrored, factor: Whether they met a mirror, and the share that mirrors left, [n].
        radiance: Receives the radiance, [n, 3].
    """
    lights, outdoors, _ = sources
    face, _, _, direction = ends
    for i in range(len(face)):
        r, g, b, share = 0.0, 0.0, 0.0, factor[i]
        if face[i] < 0:
            dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
            if not mirrored[i]:
                openings, _, near = crossings(
                    outdoors.hole, outdoors.parts, (origin[i, 0], origin[i, 1], origin[i, 2]), (dx, dy, dz)
                )
                if openings > 0:
                    share *= near
            r, g, b = sky_radiance(outdoors.panorama, dx, dy, dz)
        elif lights.near_area[face[i]] > 0:
            if not mirrored[i]:
                share *= left_to_gathering(distance[i] * distance[i], lights.near_area[face[i]])
            emission = scene.materials.emission[scene.geometry.material[face[i]]]
            r, g, b = np.float64(emission[0]), np.float64(emission[1]), np.float64(emission[2])
        radiance[i, 0], radiance[i, 1], radiance[i, 2] = r * share, g * share, b * share


@njit(**JIT)
def link_shares(links, cosine, alpha, coat):
    """Write the shares of the target's base and lobe that each ray sees.

    Args:
        links: The rays between patches (`PatchLinks`).
        cosine: Cosine of each ray at its target, [n].
        alpha: Roughness of each patch, [p].
        coat: The coat's tables.
    """
    target, base, lobe, _, _, _, factor = links
    for i in range(len(target)):
        base[i], lobe[i] = 0.0, 0.0
        if target[i] >= 0:
            rough = alpha[target[i]]
            if rough > 0:
                base[i] = factor[i] * in_table(coat.through, rough, cosine[i])
                lobe[i] = factor[i] * in_table(coat.reflected, rough, cosine[i])
            else:
                base[i] = factor[i]


@njit(**JIT)
def spots_gathered(links, sun, area, rays, out):
    """Write the light of sunlit spots (`SentLight`) that rays bring beyond the share that `left_to_gathering` leaves.

    The caller subtracts it from what the patches gather.
    """
    target, base, lobe, passed, distance, mirrored, _ = links
    sun_base, sun_lobe = sun
    irradiance, coated = out
    for p in range(len(irradiance)):
        scale = math.pi / rays
        for c in range(3):
            irradiance[p, c], coated[p, c] = 0.0, 0.0
        for k in range(p * rays, (p + 1) * rays):
            j = target[k]
            if j < 0 or mirrored[k]:
                continue
            away = (1 - left_to_gathering(distance[k] * distance[k], area)) * scale
            for c in range(3):
                light = away * (base[k] * sun_base[j, c] + lobe[k] * sun_lobe[j, c])
                irradiance[p, c] += light
                coated[p, c] += light * passed[k]


@njit(**JIT)
def bounce(links, sent, rays, out):
    """Write the irradiance that each patch receives along its rays: one bounce.

    Args:
        links: The rays between patches (`PatchLinks`), `rays` in a row for each patch.
        sent: Radiance that patches send out (`SentLight`).
        rays: Rays of a patch.
        out: Receives the irradiance (`ReceivedLight`).
    """
    target, base, lobe, passed, _, _, _ = links
    base_radiance, lobe_radiance = sent
    irradiance, coated = out
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
def outgoing(albedo, alpha, coat, received, sent):
    """Write the radiance of each patch's base (before its coat lets it out) and the mean radiance of its lobe."""
    irradiance, coated = received
    base_radiance, lobe_radiance = sent
    for p in range(len(alpha)):
        if alpha[p] > 0:
            scale = in_row(coat.scale, alpha[p]) / math.pi
            kept = 1 / (math.pi * (1 - in_row(coat.mean_through, alpha[p])))
            for c in range(3):
                base_radiance[p, c] = albedo[p, c] * scale * coated[p, c]
                lobe_radiance[p, c] = kept * max(irradiance[p, c] - coated[p, c], 0.0)
        else:
            for c in range(3):
                base_radiance[p, c] = albedo[p, c] / math.pi * irradiance[p, c]
                lobe_radiance[p, c] = 0.0


@njit(**JIT)
def count_visible(rays, seen, count, row, tried, visible):
    """Count, for each patch and light, the shadow rays and the visible shadow rays.

    Args:
        rays: The shadow rays (`ShadowRays`), of which the first `count` are counted.
        seen: Whether each ray is visible.
        count: Number of rays.
        row: Patch of each point.
        tried: Counts of the rays, [p, l]; added to.
        visible: Counts of the visible rays, [p, l]; added to.
    """
    owner, cluster = rays.owner, rays.cluster
    for k in range(count):
        if cluster[k] >= 0:
            tried[row[owner[k]], cluster[k]] += 1
            if seen[k]:
                visible[row[owner[k]], cluster[k]] += 1


@njit(**JIT)
def add_counts(tried, visible, owner, tried_sum, visible_sum):
    """Sum the patches' counts over each owner."""
    for p in range(len(owner)):
        for k in range(tried.shape[1]):
            tried_sum[owner[p], k] += tried[p, k]
            visible_sum[owner[p], k] += visible[p, k]


@njit(**JIT)
def shares(tried, visible, owner, around, prior, out):
    """Write the share of each light that each patch sees, in 255ths.

    Args:
        tried: Counts of shadow rays, [p, l].
        visible: Counts of visible shadow rays, [p, l].
        owner: The surroundings of each patch, [p].
        around: Share of each light that the surroundings see, 0 to 1.
        prior: Number of rays for which the surroundings' share counts.
        out: Receives the shares, [p, l].
    """
    for p in range(len(owner)):
        for k in range(tried.shape[1]):
            share = (visible[p, k] + prior * around[owner[p], k]) / (tried[p, k] + prior)
            out[p, k] = np.uint8(255 * min(share, np.float32(1.0)) + np.float32(0.5))


@njit(**JIT)
def fill_coarse(position, used, material, table, owner):
    """Give each patch its cell in the fallback's table, which is empty; returns how many cells there are."""
    keys, values = table
    known = 0
    for p in range(len(used)):
        key = coarse_key(position[p, 0, 0], position[p, 0, 1], position[p, 0, 2], material[p])
        at = slot_of(keys, key)
        if keys[at] == -1:
            keys[at], values[at] = key, known
            known += 1
        owner[p] = values[at]
    return known


@njit(**JIT)
def look_up(table, point, geometric_normal, material, face):
    """Find the row (`PatchTable`) of the patch at a place.

    Without a patch, the row is that of the surroundings with that material; without surroundings, that of the
    material's mean. Inside lamps neighbours are no guide: the row is -1.
    """
    fine, keys, values, coarse_keys, coarse_values, first_coarse, first_material = table
    x, y, z = point
    key = patch_key(fine, point, geometric_normal, material, face)
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
def find_hits(geometry, table, ends, row, cosine):
    """Write the row of the room's cache for each hit (-1 without a face), and the cosine of the leaving ray."""
    face, directions = ends.face, ends.direction
    for i in range(len(face)):
        f = face[i]
        row[i] = -1
        if f < 0:
            continue
        place, geometric_normal, (nx, ny, nz) = hit_at(geometry, ends, i)
        cosine[i] = max(-(nx * directions[i, 0] + ny * directions[i, 1] + nz * directions[i, 2]), 0.0)
        row[i] = look_up(table, place, geometric_normal, geometry.material[f], f)


@njit(**JIT)
def find_points(table, position, geometric_normal, material, face, row):
    """Write the row of the room's cache for surface points."""
    for i in range(len(material)):
        row[i] = look_up(
            table,
            (position[i, 0], position[i, 1], position[i, 2]),
            (geometric_normal[i, 0], geometric_normal[i, 1], geometric_normal[i, 2]),
            material[i],
            face[i],
        )
