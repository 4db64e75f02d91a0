# pyright: reportMissingParameterType=false
"""Samples of direct light: candidates from the clusters, resampled by their unshadowed contribution.

Each shading point draws `candidates` points on the lights: a cluster in proportion to its estimated contribution times
the visibility that the room's cache has measured for it, then a piece, then a place. It works out what each would give
unshadowed, and picks `picks` of them in proportion for a shadow ray (resampled importance sampling, Talbot et al. 2005,
with systematic picks). Most of the noise left is then the shadow's.

Frames: world, y up, metres; radiance in kcd/m2, irradiance in kcd/m2 times steradians.
"""

import math

import numpy as np
from numba import njit

from roomlight.kernels.common import mixed, tangents
from roomlight_generator.transport.kernels.common import (
    JIT,
    LEAST_COSINE,
    PHI1,
    PHI2,
    fraction,
    in_row,
    in_table,
    lobe,
    sky_radiance,
    unit,
)

FAR = 1e4  # `tracer.FAR_M`
SHORT = 1e-4  # shadow rays stop this far before a light: a lampshade's skin may lie a millimetre before it
LEAST_SEEN = 8  # 255ths: a light that a patch never saw may still be seen from a corner of it
NEAR_SQ = 1e-8  # least squared distance of a light, (0.1 mm)^2: keeps it off zero
_ZERO, _QUARTER, _ONE, _NEAR, _PER_255 = (np.float32(value) for value in (0, 0.25, 1, 1e-9, 1 / 255))


@njit(**JIT)
def left_to_gathering(distance_sq, area):
    """Return the share of a light's contribution that gather rays bring, not shadow rays.

    Division by the squared distance makes a rare sample close to a surface outshine all others. A share that depends on
    the geometry alone splits the light between the two estimators without bias. The area is that of the light's
    cluster.
    """
    return area / (area + 2 * distance_sq)


@njit(**JIT)
def crossings(hole, parts, point, direction):
    """Count the openings that a ray passes.

    Also returns the slot of the piece in the last opening (-1: no opening), and the mean share of the sky seen through
    the openings that is left to gather rays.
    """
    px, py, pz = point
    dx, dy, dz = direction
    count, slot, near = 0, -1, 0.0
    for o in range(len(hole)):
        h = hole[o]
        slope = dx * h[9] + dy * h[10] + dz * h[11]
        if abs(slope) < 1e-7:
            continue
        ax, ay, az = px - h[0], py - h[1], pz - h[2]
        d = -(ax * h[9] + ay * h[10] + az * h[11]) / slope
        if d <= 0:
            continue
        ax, ay, az = ax + d * dx, ay + d * dy, az + d * dz
        au, av = ax * h[3] + ay * h[4] + az * h[5], ax * h[6] + ay * h[7] + az * h[8]
        det = h[12] * h[14] - h[13] * h[13]
        s, t = (au * h[14] - av * h[13]) / det, (av * h[12] - au * h[13]) / det
        if 0 <= s <= 1 and 0 <= t <= 1:
            count += 1
            nu, nv = parts[o, 1], parts[o, 2]
            i, j = min(np.int64(s * nu), nu - 1), min(np.int64(t * nv), nv - 1)
            slot = parts[o, 0] + i * nv + j
            near += left_to_gathering(d * d, math.sqrt(det) / (nu * nv))
    return count, slot, near / max(count, 1)


@njit(**JIT)
def crossing_counts(hole, parts, position, direction, out):
    """Count the openings that each ray passes."""
    for i in range(len(position)):
        out[i], _, _ = crossings(
            hole, parts, (position[i, 0], position[i, 1], position[i, 2]),
            (direction[i, 0], direction[i, 1], direction[i, 2]),
        )  # fmt: skip


@njit(**JIT)
def coat_gains(alpha, cosine, coat, base, lobe):
    """Write what coats make of light that arrives at a cosine, as means over all directions.

    Args:
        alpha: Roughness of each coat (0: none), [n].
        cosine: The cosines, [n].
        coat: The coat's tables.
        base: Receives a factor on the base's radiance (1 without a coat), [n].
        lobe: Receives the lobe's radiance a unit of irradiance (0 without a coat), [n].
    """
    through, _, scale, mean_reflected, mean_through = coat
    for i in range(len(alpha)):
        base[i], lobe[i] = 1.0, 0.0
        if alpha[i] > 0:
            passed, mean = in_table(through, alpha[i], cosine[i]), in_row(mean_through, alpha[i])
            base[i] = in_row(scale, alpha[i]) * passed * mean
            lobe[i] = (1 - passed) / (math.pi * (1 - mean)) * in_row(mean_reflected, alpha[i])


@njit(**JIT)
def sun_may_reach(hole, parts, point, direction):
    """Return 1 if the ray to the sun passes an opening, 2 if it starts outside of one (a sill, a reveal), else 0."""
    px, py, pz = point
    openings, _, _ = crossings(hole, parts, point, direction)
    if openings > 0:
        return 1
    for o in range(len(hole)):
        h = hole[o]
        ax, ay, az = px - h[0], py - h[1], pz - h[2]
        if ax * h[9] + ay * h[10] + az * h[11] > -0.02:
            ux, uy, uz = (h[3] + h[6]) / 2, (h[4] + h[7]) / 2, (h[5] + h[8]) / 2
            ax, ay, az = ax - ux, ay - uy, az - uz
            if math.sqrt(ax * ax + ay * ay + az * az) < math.sqrt(ux * ux + uy * uy + uz * uz) + 1.0:
                return 2
    return 0


@njit(**JIT)
def estimate(lights, which, point, normal):
    """Estimate a cluster's unshadowed contribution to a point; zero only where it surely contributes nothing.

    In single precision and without branches: a loop over clusters becomes vector instructions, and is 30 times as fast.
    """
    px, py, pz = point
    nx, ny, nz = normal
    x, y, z = lights.centre[0, which] - px, lights.centre[1, which] - py, lights.centre[2, which] - pz
    d_sq = x * x + y * y + z * z
    per_d = _ONE / (np.sqrt(d_sq) + _NEAR)
    r, t = lights.radius[which], lights.thickness[which]
    ax, ay, az = lights.axis[0, which], lights.axis[1, which], lights.axis[2, which]
    # Extent along the normal of a disc of that radius and thickness.
    lean = nx * ax + ny * ay + nz * az
    facing = (nx * x + ny * y + nz * z + r * np.sqrt(max(_ONE - lean * lean, _ZERO)) + t * abs(lean)) * per_d
    k = lights.coherence[which]
    toward = -(ax * x + ay * y + az * z)
    toward = abs(toward) if which < lights.real else toward  # only spots shine to one side
    seen = _QUARTER * (_ONE - k) + k * max(min((toward + t) * per_d, _ONE), _ZERO)
    power = lights.power_up[which] if y > _ZERO else lights.power_down[which]
    return power * max(min(facing, _ONE), _ZERO) * seen / max(d_sq, r * r)


@njit(**JIT)
def estimates(lights, clusters, visibility, row, least, point, normal, out):
    """Write `estimate` for the first clusters, times their visibility where it was measured.

    Args:
        lights: Clusters of lights (`Lights`).
        clusters: Number of clusters.
        visibility: Share of each cluster that each row sees, in 255ths, [rows, l].
        row: Row of the point; below 0: not measured.
        least: Visibilities below this count as this, in 255ths.
        point, normal: The point (x, y, z) and its normal.
        out: Receives the estimates, [l].
    """
    for which in range(clusters):
        out[which] = estimate(lights, which, point, normal)
    if row >= 0:
        floor = np.float32(least)
        for which in range(clusters):
            out[which] *= max(np.float32(visibility[row, which]), floor) * _PER_255


@njit(**JIT)
def add_lobes(lights, clusters, visibility, row, point, normal, out):
    """Add the light that sunlit coats reflect toward a point to the estimates."""
    px, py, pz = point
    nx, ny, nz = normal
    sx, sy, sz = lights.sun[0], lights.sun[1], lights.sun[2]
    for which in range(lights.real, clusters):
        if lights.lobe_power[which] > 0:
            x, y, z = lights.centre[0, which] - px, lights.centre[1, which] - py, lights.centre[2, which] - pz
            ax, ay, az = lights.axis[0, which], lights.axis[1, which], lights.axis[2, which]
            d_sq = x * x + y * y + z * z + 1e-12
            d = math.sqrt(d_sq)
            r = lights.radius[which]
            toward = -(ax * x + ay * y + az * z) / d
            facing = min((nx * x + ny * y + nz * z + r) / d, 1.0)
            if facing > 0 and toward > -r / d:
                # Half vectors turn half as far as directions do over the cluster's width.
                alpha = min(math.sqrt(lights.lobe_alpha[which] ** 2 + 0.25 * r * r / max(d_sq, r * r)), 0.9)
                value, _ = lobe((ax, ay, az), (-x / d, -y / d, -z / d), (sx, sy, sz), alpha)
                share = lights.lobe_power[which] * value * max(toward, LEAST_COSINE) * facing / max(d_sq, r * r)
                if row >= 0:
                    share *= max(visibility[row, which], LEAST_SEEN) / 255.0
                out[which] += np.float32(share)


@njit(**JIT)
def cumulate_estimates(lights, clusters, visibility, row, point, normal, estimated, running):
    """Write the first clusters' estimates times their visibility, and their running sum; returns the total."""
    estimates(lights, clusters, visibility, row, LEAST_SEEN, point, normal, estimated)
    if clusters > lights.real:
        add_lobes(lights, clusters, visibility, row, point, normal, estimated)
    total = 0.0
    for which in range(clusters):
        total += estimated[which]
        running[which] = total
    return total


@njit(**JIT)
def point_on(surfaces, piece, r1, r2, point):
    """Draw a point of a piece (of `LightSurfaces`), uniform over its area, and work out how it is seen from `point`.

    Returns direction (x, y, z), reach, radiance (red, green, blue), the light's cosine over the squared distance, and
    the share of it that is left to gather rays.
    """
    table, kind, hole, parts, panorama, coat_share, sun = surfaces
    px, py, pz = point
    c = table[piece]
    what = kind[piece]
    if what == 2:
        dx, dy, dz = c[0] - px, c[1] - py, c[2] - pz
        d_sq = max(dx * dx + dy * dy + dz * dz, NEAR_SQ)
        d = math.sqrt(d_sq)
        dx, dy, dz = dx / d, dy / d, dz / d
        cosine = max(-(dx * c[3] + dy * c[4] + dz * c[5]), 0.0)
        red, green, blue = np.float64(c[15]), np.float64(c[16]), np.float64(c[17])
        if c[9] > 0 and cosine > 0:
            # A coat lets its base's light out by the cosine, and reflects the sun's about the mirrored direction.
            nx, ny, nz = c[6], c[7], c[8]
            out = in_table(coat_share, c[9], -(dx * nx + dy * ny + dz * nz))
            value, _ = lobe((nx, ny, nz), (-dx, -dy, -dz), (sun[0], sun[1], sun[2]), c[9])
            red, green, blue = out * red + value * c[10], out * green + value * c[11], out * blue + value * c[12]
        return dx, dy, dz, d - SHORT, red, green, blue, cosine / d_sq, left_to_gathering(d_sq, c[18])
    if what == 1:
        a, b = r1, r2
        ux, uy, uz, vx, vy, vz = c[3], c[4], c[5], c[6], c[7], c[8]
    else:
        root = math.sqrt(r1)
        a, b = 1 - root, r2 * root
        ux, uy, uz, vx, vy, vz = c[3] - c[0], c[4] - c[1], c[5] - c[2], c[6] - c[0], c[7] - c[1], c[8] - c[2]
    dx, dy, dz = c[0] + a * ux + b * vx - px, c[1] + a * uy + b * vy - py, c[2] + a * uz + b * vz - pz
    d_sq = max(dx * dx + dy * dy + dz * dz, NEAR_SQ)
    d = math.sqrt(d_sq)
    dx, dy, dz = dx / d, dy / d, dz / d
    wx, wy, wz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    cosine = abs(wx * dx + wy * dy + wz * dz) / max(math.sqrt(wx * wx + wy * wy + wz * wz), 1e-30)
    near = left_to_gathering(d_sq, c[18])
    if what == 1:
        red, green, blue = sky_radiance(panorama, dx, dy, dz)
        if len(hole) > 1:
            openings, _, _ = crossings(hole, parts, (px, py, pz), (dx, dy, dz))
            share = 1.0 / max(openings, 1)
            red, green, blue = red * share, green * share, blue * share
        return dx, dy, dz, FAR, red, green, blue, cosine / d_sq, near
    red, green, blue = np.float64(c[15]), np.float64(c[16]), np.float64(c[17])
    return dx, dy, dz, d - SHORT, red, green, blue, cosine / d_sq, near


@njit(**JIT)
def pick_piece(table, low, pieces, remainder):
    """Find the piece, of `pieces` from `low` on, in whose share of [0, 1) the remainder falls."""
    high = low + pieces - 1
    while low < high:
        middle = (low + high) // 2
        if table[middle, 20] > remainder:
            high = middle
        else:
            low = middle + 1
    return low


@njit(**JIT)
def candidate(lights, running, total, at, which):
    """Find the cluster (at or after `which`) and piece at a place in the running sum, and the density over its area."""
    while which < len(running) - 1 and running[which] <= at:
        which += 1
    low = running[which - 1] if which > 0 else 0.0
    share = running[which] - low
    within = min((at - low) / max(share, 1e-30), 0.999999)
    piece = pick_piece(lights.piece, lights.start[which], lights.pieces[which], within)
    return which, piece, share / total * lights.piece[piece, 19]


@njit(**JIT)
def resample(drawn, column, live, picks, shift):
    """Replace a column of the candidates, their contributions, by the factors on their weights.

    At most `picks` candidates are all kept (factor 1). Of more candidates, `picks` are selected in proportion
    (systematic, with a shift in [0, 1)); the factor of the others is 0.
    """
    total = 0.0
    for k in range(live):
        total += drawn[k, column]
    step = total / picks
    at, passed = shift * step, 0.0
    for k in range(live):
        given = drawn[k, column]
        passed += given
        times = 1.0
        if live > picks:
            times = 0.0
            while at < passed:
                times += step / given
                at += step
        drawn[k, column] = times


@njit(**JIT)
def shadow_rays(sources, through, points, visibility, sampling, scratch, rays):
    """Write the shadow rays of all points; returns how many.

    Args:
        sources: Lights, outdoors and surfaces of lights (`LightSources`, `LightSurfaces`).
        through: The coat's table: the share of light let through, by roughness and cosine.
        points: The points (`Points`).
        visibility: Share of each cluster that each row sees, in 255ths, [rows, l].
        sampling: Numbers of candidates, picks and sun rays, and the seed (`ShadowSampling`).
        scratch: Work space (`LightScratch`).
        rays: The rays (`ShadowRays`). weight is radiance times cosine over density, so that its sum over visible rays
            is irradiance; passed is the share that a coat lets through from there (1 without); cluster is the light
            (-1: the sun through an opening, -2: the sun outside).
    """
    lights, outdoors, surfaces = sources
    position, normal, geometric_normal, alpha, row, stream = points
    candidates, picks, sun_picks, seed = sampling
    owner, origin, direction, reach, weight, passed, cluster = rays
    hole, parts = outdoors.hole, outdoors.parts
    clusters = len(lights.start)
    estimated, running, drawn, light = scratch
    sun = outdoors.sun_irradiance[0] + outdoors.sun_irradiance[1] + outdoors.sun_irradiance[2] > 0
    sx, sy, sz = outdoors.sun_direction[0], outdoors.sun_direction[1], outdoors.sun_direction[2]
    tax, tay, taz, tbx, tby, tbz = tangents(sx, sy, sz)
    written = 0
    for i in range(len(position)):
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        gx, gy, gz = geometric_normal[i, 0], geometric_normal[i, 1], geometric_normal[i, 2]
        # 1. Seed the point's random numbers.
        state = mixed(np.uint64(stream[i]) ^ mixed(np.uint64(seed)))
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
        if total > 0:
            # 3. Draw candidates on the lights, each weighted by its unshadowed contribution.
            which, live = 0, 0
            for k in range(candidates):
                which, piece, density = candidate(lights, running, total, (k + shift3) / candidates * total, which)
                dx, dy, dz, far, red, green, blue, spread, near = point_on(
                    surfaces, piece, fraction(shift1 + PHI1 * k), fraction(shift2 + PHI2 * k), (px, py, pz)
                )
                cosine = nx * dx + ny * dy + nz * dz
                if cosine <= 0 or gx * dx + gy * dy + gz * dz <= 0 or far <= 0:
                    continue
                scale = cosine * spread * (1 - near) / (density * candidates)
                q = (red + green + blue) * scale
                if not q > 0:
                    continue
                if row[i] >= 0:
                    q *= max(visibility[row[i], which], LEAST_SEEN) / 255.0
                drawn[live, 0], drawn[live, 1], drawn[live, 2], drawn[live, 3] = dx, dy, dz, far
                drawn[live, 4], drawn[live, 5], drawn[live, 6] = red * scale, green * scale, blue * scale
                drawn[live, 7], drawn[live, 8] = q, cosine
                light[live] = which
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
                passed[written] = in_table(through, alpha[i], drawn[k, 8]) if alpha[i] > 0 else 1.0
                cluster[written] = light[k]
                written += 1
        # 5. Write rays to points of the sun's disc.
        if sun and nx * sx + ny * sy + nz * sz > 0 and gx * sx + gy * sy + gz * sz > 0:
            for k in range(sun_picks):
                radius = outdoors.sun_radius * math.sqrt(fraction(shift2 + PHI1 * k))
                angle = 2 * math.pi * fraction(shift3 + PHI2 * k)
                s, t = radius * math.cos(angle), radius * math.sin(angle)
                dx, dy, dz = sx + s * tax + t * tbx, sy + s * tay + t * tby, sz + s * taz + t * tbz
                how = sun_may_reach(hole, parts, (px, py, pz), (dx, dy, dz))
                if how == 0:
                    continue
                length = math.sqrt(dx * dx + dy * dy + dz * dz)
                dx, dy, dz = dx / length, dy / length, dz / length
                cosine = max(nx * dx + ny * dy + nz * dz, 0.0)
                owner[written] = i
                for c in range(3):
                    origin[written, c] = position[i, c]
                    weight[written, c] = outdoors.sun_irradiance[c] * cosine / sun_picks
                direction[written, 0], direction[written, 1], direction[written, 2] = dx, dy, dz
                reach[written] = FAR
                passed[written] = in_table(through, alpha[i], cosine) if alpha[i] > 0 else 1.0
                cluster[written] = -how
                written += 1
    return written


@njit(**JIT)
def add_visible(rays, seen, count, outside, out):
    """Add the first `count` shadow rays, where visible, to the light of their points (`Received`).

    Sunlight through an opening is added to the sun's part too. If `outside`, so is sunlight that passed no opening.
    """
    owner, _, _, _, weight, passed, cluster = rays
    irradiance, coated, sun, sun_coated = out
    for k in range(count):
        if seen[k]:
            i = owner[k]
            for c in range(3):
                irradiance[i, c] += weight[k, c]
                coated[i, c] += weight[k, c] * passed[k]
                if cluster[k] == -1 or (cluster[k] == -2 and outside):
                    sun[i, c] += weight[k, c]
                    sun_coated[i, c] += weight[k, c] * passed[k]


@njit(**JIT)
def sun_rays(outdoors, through, points, seed, rays):
    """Write a shadow ray toward the sun's disc for each point that the sun may reach; returns the number of rays.

    Args:
        outdoors: Openings and the sun (`Outdoors`).
        through: The coat's table: the share of light let through, by roughness and cosine.
        points: The points (`Points`).
        rays: The rays (`ShadowRays`). weight is the irradiance that the point's coat lets through; reach, passed and
            cluster are not written.
    """
    position, normal, geometric_normal, alpha, _, stream = points
    owner, origin, direction, _, weight, _, _ = rays
    hole, parts = outdoors.hole, outdoors.parts
    sx, sy, sz = outdoors.sun_direction[0], outdoors.sun_direction[1], outdoors.sun_direction[2]
    ax, ay, az, bx, by, bz = tangents(sx, sy, sz)
    written = 0
    for i in range(len(position)):
        cosine = normal[i, 0] * sx + normal[i, 1] * sy + normal[i, 2] * sz
        gx, gy, gz = geometric_normal[i, 0], geometric_normal[i, 1], geometric_normal[i, 2]
        if cosine <= 0 or gx * sx + gy * sy + gz * sz <= 0:
            continue
        state = mixed(np.uint64(stream[i]) ^ mixed(np.uint64(seed)))
        radius = outdoors.sun_radius * math.sqrt(unit(state))
        angle = 2 * math.pi * unit(mixed(state))
        s, t = radius * math.cos(angle), radius * math.sin(angle)
        dx, dy, dz = sx + s * ax + t * bx, sy + s * ay + t * by, sz + s * az + t * bz
        if sun_may_reach(hole, parts, (position[i, 0], position[i, 1], position[i, 2]), (dx, dy, dz)) == 0:
            continue
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        passed = in_table(through, alpha[i], cosine) if alpha[i] > 0 else 1.0
        owner[written] = i
        for c in range(3):
            origin[written, c] = position[i, c]
            weight[written, c] = outdoors.sun_irradiance[c] * cosine * passed
        direction[written, 0], direction[written, 1], direction[written, 2] = dx / length, dy / length, dz / length
        written += 1
    return written
