# pyright: reportMissingParameterType=false
"""Rays from points of real surfaces to the light and to objects, and the sums of what they find."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from roomlight.compositing.kernels.environment import place_of
from roomlight.compositing.kernels.ground import light_left
from roomlight.compositing.kernels.surfaces import colours
from roomlight.kernels.common import CACHED, JIT, KERNEL


class Receivers(NamedTuple):
    """Points of real surfaces.

    Attributes:
        points: [n, 3] world metres, float32.
        normals: [n, 3] unit, float32.
        subset: [n] which subset of the light samples a point uses.
        seen: [n] 1 where the strongest lamp is seen, 0 where real surfaces hide it, float32.
    """

    points: np.ndarray
    normals: np.ndarray
    subset: np.ndarray
    seen: np.ndarray


class LightSamples(NamedTuple):
    """Directions sampled from a panorama, in subsets that each estimate the irradiance.

    Attributes:
        directions: [s, m, 3] unit, toward the light.
        weights: [s, m, 3] radiance / (pdf m): a sum of weight x cosine over a subset is the irradiance.
    """

    directions: np.ndarray
    weights: np.ndarray


class LightPlaces(NamedTuple):
    """Where the light of `LightSamples` comes from: it has parallax.

    Attributes:
        position: [3] from which the samples' directions point, world metres.
        inverse_m: [s, m] 1 / distance of the surface that sends the light, 0 for far away.
        normals: [s, m, 3] unit normals of these surfaces, toward `position`.
    """

    position: np.ndarray
    inverse_m: np.ndarray
    normals: np.ndarray


class Rays(NamedTuple):
    """Rays of a block of points; `weight` is the irradiance [n, 3] or [n, 1] that a ray stands for."""

    origin: np.ndarray
    direction: np.ndarray
    point: np.ndarray
    target: np.ndarray
    weight: np.ndarray


class Looks(NamedTuple):
    """Surfaces of the objects as matte surfaces are lit by them.

    Attributes:
        corners: [f, 3, 3] of the triangles.
        material: [f] rows of the following.
        object_id: [f].
        diffuse: [m, 3] albedo.
        shiny: [m, 3] reflectance of metals.
        emissive: [m, 3].
        level: [m] prefiltered panorama that metals reflect.
    """

    corners: np.ndarray
    material: np.ndarray
    object_id: np.ndarray
    diffuse: np.ndarray
    shiny: np.ndarray
    emissive: np.ndarray
    level: np.ndarray


class Ground(NamedTuple):
    """The surface that the objects stand on, and how they shade it.

    Attributes:
        known: whether there is one.
        point: [3] on it.
        normal: [3] unit.
        spheres: [k, 4] centre and radius of a sphere for each object, which covers as much of the sky as the object.
    """

    known: bool
    point: np.ndarray
    normal: np.ndarray
    spheres: np.ndarray


class Opacities(NamedTuple):
    """What surfaces of the objects take of the light that passes them.

    Attributes:
        surfaces, materials, textures: tables of the scene.
        share: [m] of light that a material takes; of a cut-out, where it is there.
        is_cut: [m] whether a texture or a cutoff says where it is.
    """

    surfaces: Any
    materials: Any
    textures: Any
    share: np.ndarray
    is_cut: np.ndarray


_MOST_NEARER = np.float32(4.0)
"""Light of a near surface counts at most this much more than from the panorama's position."""
_ON_GROUND_M = 0.02
_FOOT = 0.5
"""About this far from a point on the ground, in radii of `Ground.spheres`, objects see ground as shaded as there."""


@njit(**JIT)
def _look_up(panorama, x, y, z):
    """Return row and column of a unit direction."""
    height, width = panorama.shape[0], panorama.shape[1]
    place = place_of(x, y, z)
    return min(int(place[1] * height), height - 1), min(max(int(place[0] * width), 0), width - 1)


@njit(**CACHED, fastmath=True)
def light_rays(receivers, light, places, of_lamp, spheres, lift_m, matte, unblocked, irradiance, rays, start, stop):
    """Sum the irradiance of points start..stop; store the rays to the light that meet a bounding sphere.

    Args:
        receivers: [n] the points.
        light: [s, m] directions and weights.
        places: [s, m] where this light comes from.
        of_lamp: [s, m] directions whose light comes where `seen` says alone.
        spheres: [k, 4] centre and radius.
        matte: [h, w, 3] panorama of irradiance / pi.
        unblocked: [n, 3] out: of the samples.
        irradiance: [n, 3] out: of `matte`, without the samples' noise.

    Returns:
        The number of rays; their points count from start.
    """
    zero, one = np.float32(0), np.float32(1)
    count = 0
    for i in range(start, stop):
        s = receivers.subset[i]
        nx, ny, nz = receivers.normals[i, 0], receivers.normals[i, 1], receivers.normals[i, 2]
        row, column = _look_up(matte, nx, ny, nz)
        for c in range(3):
            irradiance[i, c] = np.float32(math.pi) * matte[row, column, c]
        px = receivers.points[i, 0] + lift_m * nx
        py = receivers.points[i, 1] + lift_m * ny
        pz = receivers.points[i, 2] + lift_m * nz
        qx, qy, qz = px - places.position[0], py - places.position[1], pz - places.position[2]
        red, green, blue = zero, zero, zero
        for j in range(light.directions.shape[1]):
            # 1. The direction of the light from here, and how large its surface looks beside from `places.position`.
            dx, dy, dz = light.directions[s, j, 0], light.directions[s, j, 1], light.directions[s, j, 2]
            cosine = nx * dx + ny * dy + nz * dz
            inverse = places.inverse_m[s, j]
            if inverse > zero:
                ux, uy, uz = places.normals[s, j, 0], places.normals[s, j, 1], places.normals[s, j, 2]
                facing = ux * dx + uy * dy + uz * dz
                dx, dy, dz = dx - qx * inverse, dy - qy * inverse, dz - qz * inverse
                scale = one / max(dx * dx + dy * dy + dz * dz, np.float32(0.01))
                root = math.sqrt(scale)
                dx, dy, dz = dx * root, dy * root, dz * root
                facing = (ux * dx + uy * dy + uz * dz) / min(facing, np.float32(-0.1))
                cosine = (nx * dx + ny * dy + nz * dz) * min(max(facing, zero) * scale, _MOST_NEARER)
            if of_lamp[s, j]:
                cosine *= receivers.seen[i]
            if cosine <= zero:
                continue
            # 2. Its irradiance.
            r, g, b = (
                light.weights[s, j, 0] * cosine,
                light.weights[s, j, 1] * cosine,
                light.weights[s, j, 2] * cosine,
            )
            red, green, blue = red + r, green + g, blue + b
            # 3. A ray, where an object may be in the way.
            for k in range(spheres.shape[0]):
                ox, oy, oz = spheres[k, 0] - px, spheres[k, 1] - py, spheres[k, 2] - pz
                along = ox * dx + oy * dy + oz * dz
                square = ox * ox + oy * oy + oz * oz
                radius2 = spheres[k, 3] * spheres[k, 3]
                if square < radius2 or (along > zero and square - along * along < radius2):
                    rays.origin[count, 0], rays.origin[count, 1], rays.origin[count, 2] = px, py, pz
                    rays.direction[count, 0], rays.direction[count, 1], rays.direction[count, 2] = dx, dy, dz
                    rays.weight[count, 0], rays.weight[count, 1], rays.weight[count, 2] = r, g, b
                    rays.point[count] = i
                    count += 1
                    break
        unblocked[i, 0], unblocked[i, 1], unblocked[i, 2] = red, green, blue
    return count


@njit(**KERNEL)
def fill_taken(opacities, hits, out):
    """Fill [n] with the share of light that the surfaces take that rays meet; 0 where a ray meets none."""
    for i in range(len(out)):
        face = hits.face[i]
        if face < 0:
            out[i] = 0
            continue
        m = opacities.surfaces.material[face]
        out[i] = opacities.share[m]
        if opacities.is_cut[m]:
            out[i] *= colours(opacities, face, hits.u[i], hits.v[i], 1.0)[1][2]


@njit(**CACHED, fastmath=True)
def add_blocked(rays, share, distance, blocked, squares, nearness):
    """Add the light that each ray's point loses.

    Args:
        rays: [n] to the light.
        share: [n] 1 where an object blocks the ray, less where it lets light through.
        distance: [n] metres to the object.
        blocked: [points, 3] must begin at 0.
        squares: [points] sum of squares of the blocked mean of the channels, for its variance; must begin at 0.
        nearness: [points] sum of the blocked mean of the channels / distance; must begin at 0.
    """
    for p in range(len(share)):
        if share[p] == 0:
            continue
        i = rays.point[p]
        lost = np.float32(0)
        for c in range(3):
            value = rays.weight[p, c] * share[p]
            blocked[i, c] += value
            lost += value
        lost /= np.float32(3)
        squares[i] += lost * lost
        nearness[i] += lost / max(distance[p], np.float32(1e-3))


@njit(**CACHED, fastmath=True)
def object_rays(receivers, spheres, lift_m, numbers, reach, rays, start, stop):
    """Store rays from points start..stop toward bounding spheres, for the light that objects reflect.

    Args:
        numbers: [s, m, 2] low-discrepancy numbers in [0, 1), a row a subset.
        reach: in sphere radii; farther points get none.
        rays: out; the weight is cosine / (pdf m).

    Returns:
        The number of rays.
    """
    zero, one = np.float32(0), np.float32(1)
    samples = numbers.shape[1]
    count = 0
    for i in range(start, stop):
        s = receivers.subset[i]
        nx, ny, nz = receivers.normals[i, 0], receivers.normals[i, 1], receivers.normals[i, 2]
        px = receivers.points[i, 0] + lift_m * nx
        py = receivers.points[i, 1] + lift_m * ny
        pz = receivers.points[i, 2] + lift_m * nz
        for k in range(spheres.shape[0]):
            ox, oy, oz = spheres[k, 0] - px, spheres[k, 1] - py, spheres[k, 2] - pz
            far2 = ox * ox + oy * oy + oz * oz
            radius = spheres[k, 3]
            far = math.sqrt(far2)
            toward = nx * ox + ny * oy + nz * oz
            outside = far > np.float32(1.02) * radius
            if far > reach * radius or (outside and toward < -radius):
                continue
            if outside:  # uniform in the cone of the sphere
                ax, ay, az = ox / far, oy / far, oz / far
                least = math.sqrt(max(zero, one - radius * radius / far2))
            else:  # cosine-weighted over the hemisphere
                ax, ay, az = nx, ny, nz
                least = zero
            if abs(ax) < np.float32(0.7):
                ux, uy, uz = zero, az, -ay
            else:
                ux, uy, uz = -az, zero, ax
            length = math.sqrt(ux * ux + uy * uy + uz * uz)
            ux, uy, uz = ux / length, uy / length, uz / length
            vx, vy, vz = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
            for m in range(samples):
                first, second = numbers[s, m, 0], numbers[s, m, 1]
                height = one - first * (one - least) if outside else math.sqrt(one - first)
                ring = math.sqrt(max(zero, one - height * height))
                angle = np.float32(2 * math.pi) * second
                cu, cv = ring * math.cos(angle), ring * math.sin(angle)
                dx = height * ax + cu * ux + cv * vx
                dy = height * ay + cu * uy + cv * vy
                dz = height * az + cu * uz + cv * vz
                factor = np.float32(math.pi) / samples
                if outside:
                    factor = (dx * nx + dy * ny + dz * nz) * np.float32(2 * math.pi) * (one - least) / samples
                if factor <= np.float32(1e-4):
                    continue
                rays.origin[count, 0], rays.origin[count, 1], rays.origin[count, 2] = px, py, pz
                rays.direction[count, 0], rays.direction[count, 1], rays.direction[count, 2] = dx, dy, dz
                rays.point[count], rays.target[count], rays.weight[count, 0] = i, k, factor
                count += 1
    return count


@njit(**JIT)
def _ground_seen(ground, p, d):
    """Return the share of light left where a ray that goes down from an object meets the ground."""
    n, q = ground.normal, ground.point
    height = max((p[0] - q[0]) * n[0] + (p[1] - q[1]) * n[1] + (p[2] - q[2]) * n[2], 0.0)
    far = height / max(-(d[0] * n[0] + d[1] * n[1] + d[2] * n[2]), 1e-3)
    return light_left(ground.spheres, n, p[0] + far * d[0], p[1] + far * d[1], p[2] + far * d[2])


@njit(**JIT)
def _origin_seen(ground, rays, p, distance_m):
    """Return how much of the ground that an object sees is as shaded as a ray's origin there, 0 to 1."""
    n, q, o = ground.normal, ground.point, rays.origin[p]
    if abs((o[0] - q[0]) * n[0] + (o[1] - q[1]) * n[1] + (o[2] - q[2]) * n[2]) > _ON_GROUND_M:
        return 0.0
    far = distance_m / max(_FOOT * ground.spheres[rays.target[p], 3], 1e-6)
    return math.exp(-min(far * far, 30.0))


@njit(**CACHED, fastmath=True)
def add_bounced(rays, face, distance, object_ids, looks, levels, ground, taken, bounced):
    """Add the light that the met surfaces reflect, from prefiltered panoramas, to each ray's point.

    The panorama shows the ground without the objects: what they see of it is reduced by the objects' own shade: near
    a ray's point by the point's, to which the object gives back a share of what it takes, else as under an even sky.

    Args:
        face: [n] triangle that each ray met, -1 for none.
        object_ids: [k] object of each target; a ray that meets another one is counted where it was aimed at that one.
        levels: [l, h, w, 3] panoramas, the last one irradiance / pi.
        taken: [points] share of light that objects take.
        bounced: [points, 3] must begin at 0.
    """
    last = levels.shape[0] - 1
    up = ground.normal
    row, column = _look_up(levels[last], -up[0], -up[1], -up[2])
    below = levels[last, row, column]
    for p in range(len(face)):
        f = face[p]
        if f < 0 or looks.object_id[f] != object_ids[rays.target[p]]:
            continue
        m = looks.material[f]
        d = (rays.direction[p, 0], rays.direction[p, 1], rays.direction[p, 2])
        a, b, c = looks.corners[f, 0], looks.corners[f, 1], looks.corners[f, 2]
        ex, ey, ez, gx, gy, gz = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
        x, y, z = ey * gz - ez * gy, ez * gx - ex * gz, ex * gy - ey * gx
        scale = 1 / math.sqrt(max(x * x + y * y + z * z, np.float32(1e-30)))
        facing = (x * d[0] + y * d[1] + z * d[2]) * scale
        if facing > 0:
            scale = -scale
        x, y, z, facing = x * scale, y * scale, z * scale, -abs(facing)
        at = (
            rays.origin[p, 0] + distance[p] * d[0],
            rays.origin[p, 1] + distance[p] * d[1],
            rays.origin[p, 2] + distance[p] * d[2],
        )
        row, column = _look_up(levels[last], x, y, z)
        i, weight = rays.point[p], rays.weight[p, 0]
        lost, near, left = 0.0, 0.0, 0.0
        if ground.known:
            near, back = _origin_seen(ground, rays, p, distance[p]), 0.0
            for k in range(3):
                back += (looks.diffuse[m, k] + looks.shiny[m, k]) / 3 * taken[i]
            left = near * (1 - taken[i]) * (1 + back)
            rise = x * up[0] + y * up[1] + z * up[2]
            aside = (x - (rise + 1) * up[0], y - (rise + 1) * up[1], z - (rise + 1) * up[2])  # down, and outward
            lost = (1 - rise) / 2 * (1 - left - (1 - near) * _ground_seen(ground, at, aside))
        for k in range(3):
            lit = max(levels[last, row, column, k] - lost * below[k], 0.0)
            bounced[i, k] += weight * (looks.diffuse[m, k] * lit + looks.emissive[m, k])
        if looks.shiny[m, 0] + looks.shiny[m, 1] + looks.shiny[m, 2] <= 0:
            continue
        turn = (d[0] - 2 * facing * x, d[1] - 2 * facing * y, d[2] - 2 * facing * z)
        level = looks.level[m]
        row, column = _look_up(levels[level], turn[0], turn[1], turn[2])
        if ground.known and turn[0] * up[0] + turn[1] * up[1] + turn[2] * up[2] < 0:
            weight *= left + (1 - near) * _ground_seen(ground, at, turn)
        for k in range(3):
            bounced[i, k] += weight * looks.shiny[m, k] * levels[level, row, column, k]
