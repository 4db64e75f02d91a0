# pyright: reportMissingParameterType=false
"""Kernels of the coat's specular lobe (GGX, sampled by visible normals and by the lights), panes and small lights.

Both samples of the lobe are joined by the balance heuristic. view is the unit direction toward the viewer; normals are
on its side. Frames: world, y up, metres; radiance in kcd/m2.
"""

import math

import numpy as np
from numba import njit

from roomlight.kernels.common import mixed, tangents
from roomlight.kernels.microfacets import dielectric, visible_normal
from roomlight_generator.transport.kernels.common import (
    COAT_INDEX,
    JIT,
    LEAST_COSINE,
    PHI1,
    PHI2,
    fraction,
    lobe,
    sky_radiance,
    unit,
)
from roomlight_generator.transport.kernels.lights import (
    FAR,
    LEAST_SEEN,
    candidate,
    crossings,
    cumulate_estimates,
    estimate,
    pick_piece,
    point_on,
    resample,
    sun_may_reach,
)
from roomlight_generator.transport.kernels.surfaces import OFFSET, hit_at

SPOT_M = 0.06  # where a lobe is wider than this, samples of spots replace sunlit surfaces


@njit(**JIT)
def spot_share(alpha, distance):
    """Return the share of a sunlit spot's light in a lobe that samples of the spot bring, not reflected rays."""
    width = alpha * distance
    return width * width / (width * width + SPOT_M * SPOT_M)


@njit(**JIT)
def spot_shares(alpha, distance, rays, out):
    """Write `spot_share` of each ray by its length; each point (by alpha) has `rays` rays in a row."""
    for k in range(len(distance)):
        out[k] = spot_share(alpha[k // rays], distance[k])


@njit(**JIT)
def lobe_rays(points, view, rays, seed, out):
    """Write `rays` reflections (`LobeRays`) of each point (`Points`) by visible normals (Heitz 2018).

    view is the unit direction toward the viewer. A reflection into the surface has weight 0 and the direction of the
    geometric normal.
    """
    _, normal, geometric_normal, alpha, _, stream = points
    direction, weight, density = out
    for i in range(len(alpha)):
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        gx, gy, gz = geometric_normal[i, 0], geometric_normal[i, 1], geometric_normal[i, 2]
        ax, ay, az, bx, by, bz = tangents(nx, ny, nz)
        vx, vy, vz = view[i, 0], view[i, 1], view[i, 2]
        a = alpha[i]
        x, y, z = vx * ax + vy * ay + vz * az, vx * bx + vy * by + vz * bz, vx * nx + vy * ny + vz * nz
        z = max(z, LEAST_COSINE)
        state = mixed(np.uint64(stream[i]) ^ mixed(np.uint64(seed)))
        shift1 = unit(state)
        shift2 = unit(mixed(state))
        for k in range(rays):
            hx, hy, hz = visible_normal(x, y, z, a, fraction(shift1 + PHI1 * k), fraction(shift2 + PHI2 * k))
            ox, oy, oz = hx * ax + hy * bx + hz * nx, hx * ay + hy * by + hz * ny, hx * az + hy * bz + hz * nz
            toward = vx * ox + vy * oy + vz * oz
            lx, ly, lz = 2 * toward * ox - vx, 2 * toward * oy - vy, 2 * toward * oz - vz
            at = i * rays + k
            cos_l = lx * nx + ly * ny + lz * nz
            if toward <= 0 or cos_l <= 0 or lx * gx + ly * gy + lz * gz <= 0:
                direction[at, 0], direction[at, 1], direction[at, 2] = gx, gy, gz
                weight[at], density[at] = 0.0, 1.0
                continue
            direction[at, 0], direction[at, 1], direction[at, 2] = lx, ly, lz
            value, chance = lobe((nx, ny, nz), (vx, vy, vz), (lx, ly, lz), a)
            weight[at] = value / chance if chance > 0 else 0.0
            density[at] = chance


@njit(**JIT)
def lobe_lights(sources, points, view, visibility, sampling, scratch, shadow, totals):
    """Write the shadow rays by which the lobe of each point samples the lights; returns how many.

    Args:
        sources: Lights, outdoors and surfaces of lights (`LightSources`, `LightSurfaces`).
        points: Coated points (`Points`).
        view: Unit direction from each toward the viewer, [n, 3].
        visibility: Share of each cluster that each row sees, in 255ths, [rows, l].
        sampling: Numbers of reflected rays, candidates and picks, and the seed (`LobeSampling`).
        scratch: Work space (`LightScratch`).
        shadow: The rays (`ShadowRays`); passed and cluster are not written.
        totals: Receives each point's sum of estimates, for `lobe_share`, [n].
    """
    lights, outdoors, surfaces = sources
    kind = surfaces.kind
    position, normal, geometric_normal, alpha, row, stream = points
    rays, candidates, picks, seed = sampling
    owner, origin, direction, reach, weight, _, _ = shadow
    hole, parts = outdoors.hole, outdoors.parts
    clusters = len(lights.start)
    estimated, running, drawn, _ = scratch
    sun = outdoors.sun_irradiance[0] + outdoors.sun_irradiance[1] + outdoors.sun_irradiance[2] > 0
    sx, sy, sz = outdoors.sun_direction[0], outdoors.sun_direction[1], outdoors.sun_direction[2]
    tax, tay, taz, tbx, tby, tbz = tangents(sx, sy, sz)
    written = 0
    for i in range(len(alpha)):
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        gx, gy, gz = geometric_normal[i, 0], geometric_normal[i, 1], geometric_normal[i, 2]
        vx, vy, vz = view[i, 0], view[i, 1], view[i, 2]
        # 1. Seed the point's random numbers.
        state = mixed(np.uint64(stream[i]) ^ mixed(np.uint64(seed) + np.uint64(1)))
        shift1 = unit(state)
        state = mixed(state)
        shift2 = unit(state)
        state = mixed(state)
        shift3 = unit(state)
        # 2. Estimate the clusters' contributions.
        total = 0.0
        if clusters > 0:
            total = cumulate_estimates(
                lights, clusters, visibility, row[i], (px, py, pz), (nx, ny, nz), estimated, running
            )
        totals[i] = total
        if total > 0:
            # 3. Draw candidates on the lights, weighted by the lobe.
            which, live = 0, 0
            for k in range(candidates):
                which, piece, density = candidate(lights, running, total, (k + shift3) / candidates * total, which)
                dx, dy, dz, far, red, green, blue, spread, _ = point_on(
                    surfaces, piece, fraction(shift1 + PHI1 * k), fraction(shift2 + PHI2 * k), (px, py, pz)
                )
                if far <= 0 or gx * dx + gy * dy + gz * dz <= 0:
                    continue
                value, by_lobe = lobe((nx, ny, nz), (vx, vy, vz), (dx, dy, dz), alpha[i])
                scale = value * spread / (density * candidates)
                if kind[piece] == 2:
                    scale *= spot_share(alpha[i], far)
                else:
                    # density / spread is the density in solid angle.
                    scale *= candidates * density / (candidates * density + rays * by_lobe * spread)
                q = (red + green + blue) * scale
                if not q > 0:
                    continue
                drawn[live, 0], drawn[live, 1], drawn[live, 2], drawn[live, 3] = dx, dy, dz, far
                drawn[live, 4], drawn[live, 5], drawn[live, 6], drawn[live, 7] = (
                    red * scale,
                    green * scale,
                    blue * scale,
                    q,
                )
                live += 1
            # 4. Pick some of the candidates and write their rays.
            resample(drawn, 7, live, picks, unit(mixed(state)))
            for k in range(live):
                if drawn[k, 7] == 0:
                    continue
                owner[written] = i
                for c in range(3):
                    origin[written, c] = position[i, c]
                    direction[written, c] = drawn[k, c]
                    weight[written, c] = drawn[k, 4 + c] * drawn[k, 7]
                reach[written] = drawn[k, 3]
                written += 1
        # 5. Write a ray to the sun's disc if it leaves through an opening.
        if sun and gx * sx + gy * sy + gz * sz > 0:
            radius, angle = outdoors.sun_radius * math.sqrt(shift1), 2 * math.pi * shift2
            s, t = radius * math.cos(angle), radius * math.sin(angle)
            dx, dy, dz = sx + s * tax + t * tbx, sy + s * tay + t * tby, sz + s * taz + t * tbz
            value, _ = lobe((nx, ny, nz), (vx, vy, vz), (sx, sy, sz), alpha[i])
            if value > 0 and sun_may_reach(hole, parts, (px, py, pz), (dx, dy, dz)) > 0:
                length = math.sqrt(dx * dx + dy * dy + dz * dz)
                owner[written] = i
                for c in range(3):
                    origin[written, c] = position[i, c]
                    weight[written, c] = outdoors.sun_irradiance[c] * value
                direction[written, 0], direction[written, 1], direction[written, 2] = (
                    dx / length,
                    dy / length,
                    dz / length,
                )
                reach[written] = FAR
                written += 1
    return written


@njit(**JIT)
def lobe_share(sources, points, visibility, totals, sampling, reflected, ends, distance, mirrored, share):
    """Write the share of emitted light that each reflected ray keeps, given that the lights are sampled too.

    Args:
        sources: Lights and outdoors.
        points: Coated points (`Points`).
        visibility: Share of each cluster that each row sees, in 255ths, [rows, l].
        totals: Each point's sum of estimates, from `lobe_lights`, [n].
        sampling: As in `lobe_lights`.
        reflected: The rays (`LobeRays`).
        ends: Where the rays ended (`RayEnds`).
        distance, mirrored: Their lengths, and whether they met a mirror, [n * rays].
        share: Receives the shares, 1 after a mirror, [n * rays].
    """
    lights, outdoors, _ = sources
    position, normal, row = points.position, points.normal, points.row
    rays, candidates, _, _ = sampling
    direction, density = reflected.direction, reflected.density
    face, u, v, _ = ends
    for at in range(len(face)):
        i = at // rays
        share[at] = 1.0
        if mirrored[at] or totals[i] <= 0:
            continue
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        dx, dy, dz = direction[at, 0], direction[at, 1], direction[at, 2]
        f = face[at]
        slot, d = -1, np.float64(distance[at])
        if f < 0:
            openings, slot, _ = crossings(outdoors.hole, outdoors.parts, (px, py, pz), (dx, dy, dz))
            if openings == 0:
                continue
        else:
            cuts = lights.face_cuts[f]
            if cuts == 0:
                continue
            x, y = u[at] * cuts, v[at] * cuts
            a, b = min(np.int64(x), cuts - 1), min(np.int64(y), cuts - 1)
            upper = 1 if (x - a) + (y - b) > 1 and a + b < cuts - 1 else 0
            slot = lights.face_first[f] + 2 * (a * cuts + b) + upper
        piece = lights.piece_at[slot]
        if piece < 0:
            continue
        c = lights.piece[piece]
        ux, uy, uz, wx, wy, wz = c[3], c[4], c[5], c[6], c[7], c[8]
        if f >= 0:
            ux, uy, uz, wx, wy, wz = ux - c[0], uy - c[1], uz - c[2], wx - c[0], wy - c[1], wz - c[2]
        mx, my, mz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        length = max(math.sqrt(mx * mx + my * my + mz * mz), 1e-30)
        slope = (mx * dx + my * dy + mz * dz) / length
        if f < 0:
            along = mx * (c[0] - px) + my * (c[1] - py) + mz * (c[2] - pz)
            d = along / length / slope if abs(slope) > 1e-9 else 1e9
        which = lights.cluster[piece]
        chance = estimate(lights, which, (px, py, pz), (normal[i, 0], normal[i, 1], normal[i, 2]))
        if row[i] >= 0:
            chance *= max(visibility[row[i], which], LEAST_SEEN) / 255.0
        by_area = chance / totals[i] * c[19]
        spread = abs(slope) / (d * d)
        share[at] = rays * density[at] * spread / (rays * density[at] * spread + candidates * by_area)


@njit(**JIT)
def add_scattered(shadow, seen, count, out):
    """Add the first `count` shadow rays, where visible, to their points' radiance."""
    owner, weight = shadow.owner, shadow.weight
    for k in range(count):
        if seen[k]:
            for c in range(3):
                out[owner[k], c] += weight[k, c]


@njit(**JIT)
def pane_rays(geometry, ends, out):
    """Write how rays that met a thin pane go on (`PaneRays`): mirrored by both its faces, and straight."""
    direction = ends.direction
    reflected, mirrored, through, share = out
    for i in range(len(direction)):
        (x, y, z), (gx, gy, gz), _ = hit_at(geometry, ends, i)
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        slope = dx * gx + dy * gy + dz * gz
        f, _ = dielectric(min(-slope, 1.0), COAT_INDEX)
        share[i] = 2 * f / (1 + f)
        mirrored[i, 0], mirrored[i, 1], mirrored[i, 2] = dx - 2 * slope * gx, dy - 2 * slope * gy, dz - 2 * slope * gz
        through[i, 0], through[i, 1], through[i, 2] = x + OFFSET * dx, y + OFFSET * dy, z + OFFSET * dz
        reflected[i, 0], reflected[i, 1], reflected[i, 2] = x + OFFSET * gx, y + OFFSET * gy, z + OFFSET * gz


@njit(**JIT)
def splat_rays(sources, chosen, samples, point, seed, rays):
    """Write rays from a point to samples on each cluster of lights with a chosen piece; returns the number of rays.

    Args:
        sources: Lights and surfaces of lights.
        chosen: Which pieces get rays, [p].
        samples: Rays to each cluster.
        point: World position (x, y, z).
        rays: The rays (`ShadowRays`), of which origin, direction, reach and weight are written; weight is radiance
            times solid angle.
    """
    lights, _, surfaces = sources
    x, y, z = point
    _, origin, direction, reach, light, _, _ = rays
    written = 0
    for which in range(len(lights.start)):
        first, pieces = lights.start[which], lights.pieces[which]
        any_chosen = False
        for piece in range(first, first + pieces):
            any_chosen = any_chosen or chosen[piece]
        if not any_chosen:
            continue
        state = mixed(np.uint64(which) ^ mixed(np.uint64(seed)))
        shift1 = unit(state)
        shift2 = unit(mixed(state))
        for k in range(samples):
            piece = pick_piece(lights.piece, first, pieces, (k + 0.5) / samples)
            if not chosen[piece]:
                continue
            dx, dy, dz, far, r, g, b, spread, _ = point_on(
                surfaces, piece, fraction(shift1 + PHI1 * k), fraction(shift2 + PHI2 * k), point
            )
            if far <= 0:
                continue
            scale = spread / (lights.piece[piece, 19] * samples)
            origin[written, 0], origin[written, 1], origin[written, 2] = x, y, z
            direction[written, 0], direction[written, 1], direction[written, 2] = dx, dy, dz
            light[written, 0], light[written, 1], light[written, 2] = r * scale, g * scale, b * scale
            reach[written] = far
            written += 1
    return written


@njit(**JIT)
def add_sky(panorama, direction, share, out):
    """Add the sky's radiance along rays, each multiplied by its share."""
    for i in range(len(share)):
        r, g, b = sky_radiance(panorama, direction[i, 0], direction[i, 1], direction[i, 2])
        out[i, 0] += r * share[i]
        out[i, 1] += g * share[i]
        out[i, 2] += b * share[i]
