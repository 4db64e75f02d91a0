# pyright: reportMissingParameterType=false
"""One bounce of light paths from the camera, for a block of rays: what they met, shadow rays, and the next rays.

Light and scattering are drawn both and combined by the power heuristic (Veach 1995, section 9.2).
"""

import math

import numpy as np
from numba import njit

from roomlight.compositing.kernels.common import JIT, KERNEL, point, tangents
from roomlight.compositing.kernels.environment import density, probe_weights, sample
from roomlight.compositing.kernels.ground import arriving
from roomlight.compositing.kernels.microfacets import dielectric
from roomlight.compositing.kernels.scattering import draw, evaluate, surface
from roomlight.compositing.kernels.surfaces import colours, geometric_normal, points, shading_normal

PRIMARY = 1
"""Flag of a ray that has met nothing since the camera."""
CLEAR = 2
"""Flag of a ray that has met glass only, and was refracted first: the background behind the glass shows in it."""
BLURRED = 4
"""Flag of a ray that a matte surface scattered: mirrors that it meets are blurred, and lamps through glass dimmed."""
LEAST_BLURRED_ROUGHNESS = 0.3
"""Of lobes that a matte surface is lit by: their lamps can be sampled, where a mirror's would be rare bright dots."""
_DIMENSIONS = 4


@njit(**KERNEL)
def camera_rays(view, samples, first, paths):
    """Aim a ray through a point of each pixel per sample; slot s is sample (first + s) % count of its pixel."""
    m = view.camera_to_world
    for slot in range(len(paths.slot)):
        pixel = slot // samples
        u, v = 0.5, 0.5
        if view.jitter:
            u, v = point(view.key[pixel], first + slot % samples, 0)
        x = (view.column[pixel] + u - view.cx) / view.fx
        y = -(view.row[pixel] + v - view.cy) / view.fy
        scale = 1 / math.sqrt(x * x + y * y + 1)
        for axis in range(3):
            paths.origin[slot, axis] = m[axis, 3]
            paths.direction[slot, axis] = (m[axis, 0] * x + m[axis, 1] * y - m[axis, 2]) * scale
            paths.throughput[slot, axis] = 1
        paths.pdf[slot], paths.flags[slot], paths.slot[slot] = -1, PRIMARY, slot


@njit(**JIT)
def _add(out, slot, paths, i, r, g, b):
    out[slot, 0] += paths.throughput[i, 0] * r
    out[slot, 1] += paths.throughput[i, 1] * g
    out[slot, 2] += paths.throughput[i, 2] * b


@njit(**JIT)
def _continue(paths, i, live, origin, direction, weight, pdf, flags):
    """Store the next ray at place `live`, which is at most i."""
    for axis in range(3):
        paths.origin[live, axis], paths.direction[live, axis] = origin[axis], direction[axis]
        paths.throughput[live, axis] = paths.throughput[i, axis] * weight[axis]
    paths.pdf[live], paths.flags[live], paths.slot[live] = pdf, flags, paths.slot[i]


@njit(**JIT)
def _escape(world, paths, i, film, settings, weights):
    """Add the light that a ray meets which leaves the objects; returns whether the background is to give it."""
    slot = paths.slot[i]
    if paths.flags[i] & PRIMARY:
        return False
    if settings.background and paths.flags[i] & CLEAR:
        return True
    d = (paths.direction[i, 0] * 1.0, paths.direction[i, 1] * 1.0, paths.direction[i, 2] * 1.0)
    origin = (paths.origin[i, 0] * 1.0, paths.origin[i, 1] * 1.0, paths.origin[i, 2] * 1.0)
    probe_weights(world.light.position, origin[0], origin[1], origin[2], weights)
    r, g, b = arriving(world, weights, origin, d)
    scale = 1.0
    if paths.pdf[i] <= 0 and paths.flags[i] & BLURRED:
        scale = settings.brightest / max(r, g, b, settings.brightest)
    if paths.pdf[i] > 0:
        other = density(world.light, weights, d[0], d[1], d[2]) / paths.pdf[i]
        scale = 1 / (1 + other * other)
    _add(film.radiance, slot, paths, i, r * scale, g * scale, b * scale)
    return False


@njit(**JIT)
def _record(film, slot, world, hit, view):
    """Note the first surface of a camera ray, and its values for the denoiser; hit is (face, place, normal, base)."""
    face, place, normal, base = hit
    film.alpha[slot] = 1
    film.object_id[slot] = world.surfaces.object_id[face]
    m = view.camera_to_world
    depth = 0.0
    for axis in range(3):
        depth -= (place[axis] - m[axis, 3]) * m[axis, 2]
        film.normal[slot, axis], film.albedo[slot, axis] = normal[axis], base[axis]
    film.depth_m[slot] = depth


@njit(**JIT)
def _glass(paths, i, live, place, normal, face_normal, ratio, tint, choice, offset):
    """Reflect at smooth glass or refract through it; ratio is ior beyond / ior here."""
    point_flat, point_smooth = place
    d = (paths.direction[i, 0], paths.direction[i, 1], paths.direction[i, 2])
    cosine = -(d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2])
    reflectance, refracted = dielectric(cosine, ratio)
    flags = paths.flags[i] & ~PRIMARY
    if choice < reflectance:
        out = (d[0] + 2 * cosine * normal[0], d[1] + 2 * cosine * normal[1], d[2] + 2 * cosine * normal[2])
        origin = (
            point_smooth[0] + offset * face_normal[0],
            point_smooth[1] + offset * face_normal[1],
            point_smooth[2] + offset * face_normal[2],
        )
        _continue(paths, i, live, origin, out, (1.0, 1.0, 1.0), -1.0, flags)
        return
    along = cosine / ratio - refracted
    out = (d[0] / ratio + along * normal[0], d[1] / ratio + along * normal[1], d[2] / ratio + along * normal[2])
    origin = (
        point_flat[0] - offset * face_normal[0],
        point_flat[1] - offset * face_normal[1],
        point_flat[2] - offset * face_normal[2],
    )
    clear = flags | CLEAR if paths.flags[i] & (PRIMARY | CLEAR) else flags
    _continue(paths, i, live, origin, out, tint, -1.0, clear)


@njit(**JIT)
def _light_ray(world, paths, i, frame, local_view, found, shadow, count, weights, points2):
    """Draw a direction of the light and store its shadow ray at `count`; returns the number of shadow rays."""
    normal, a, b, origin = frame
    x, y, z = sample(world.light, weights, points2[0], points2[1])
    local = (
        a[0] * x + a[1] * y + a[2] * z,
        b[0] * x + b[1] * y + b[2] * z,
        normal[0] * x + normal[1] * y + normal[2] * z,
    )
    value, own = evaluate(found, local_view, local)
    if own <= 0 and value[0] + value[1] + value[2] <= 0:
        return count
    drawn = density(world.light, weights, x, y, z)
    if drawn <= 0:
        return count
    r, g, h = arriving(world, weights, origin, (x, y, z))
    scale = drawn / (drawn * drawn + own * own)
    red = paths.throughput[i, 0] * value[0] * r * scale
    green = paths.throughput[i, 1] * value[1] * g * scale
    blue = paths.throughput[i, 2] * value[2] * h * scale
    if red + green + blue <= 0:
        return count
    shadow.light[count, 0], shadow.light[count, 1], shadow.light[count, 2] = red, green, blue
    shadow.direction[count, 0], shadow.direction[count, 1], shadow.direction[count, 2] = x, y, z
    for axis in range(3):
        shadow.origin[count, axis] = origin[axis]
    shadow.slot[count] = paths.slot[i]
    return count + 1


@njit(**JIT)
def _opaque(paths, i, live, found, frame, local_view, choice, points2):
    """Draw the next ray of an opaque surface; returns 1 if there is one."""
    normal, a, b, origin = frame
    light, weight, pdf = draw(found, local_view, choice, points2[0], points2[1])
    if light[2] <= 0 or max(weight[0], weight[1], weight[2]) < 1e-6:
        return 0
    direction = (
        a[0] * light[0] + b[0] * light[1] + normal[0] * light[2],
        a[1] * light[0] + b[1] * light[1] + normal[1] * light[2],
        a[2] * light[0] + b[2] * light[1] + normal[2] * light[2],
    )
    matte = choice >= found[4] or found[3] >= LEAST_BLURRED_ROUGHNESS
    _continue(paths, i, live, origin, direction, weight, pdf, BLURRED if matte else paths.flags[i] & BLURRED)
    return 1


@njit(**KERNEL)
def bounce(world, view, paths, count, hits, film, queues, settings):
    """Advance `count` rays by one surface; returns the numbers of rays that go on, to the light, and to the background.

    Rays that go on are moved to the front of `paths`; the others are put into the two `queues`.
    """
    shadow, escape = queues
    weights = np.empty(world.light.radiance.shape[0])
    live, shadows, escaped = 0, 0, 0
    dimension = 1 + settings.depth * _DIMENSIONS
    last = settings.depth >= settings.max_bounces
    for i in range(count):
        face = hits.face[i]
        slot = paths.slot[i]
        if face < 0:
            if _escape(world, paths, i, film, settings, weights):
                for axis in range(3):
                    escape.direction[escaped, axis] = paths.direction[i, axis]
                    escape.origin[escaped, axis] = paths.origin[i, axis]
                    escape.light[escaped, axis] = paths.throughput[i, axis]
                escape.slot[escaped] = slot
                escaped += 1
            continue
        b, c = hits.u[i], hits.v[i]
        d = (paths.direction[i, 0], paths.direction[i, 1], paths.direction[i, 2])
        base, shares, emitted = colours(world, face, b, c)
        key = view.key[slot // settings.samples]
        number = settings.first + slot % settings.samples
        chance, choice = point(key, number, dimension)
        flat = geometric_normal(world.surfaces, face)
        side = 1.0 if flat[0] * d[0] + flat[1] * d[1] + flat[2] * d[2] < 0 else -1.0
        flat = (flat[0] * side, flat[1] * side, flat[2] * side)
        place = points(world.surfaces, face, b, c, side)
        if chance >= shares[2]:  # not there: straight on
            through = (
                place[0][0] - settings.offset_m * flat[0],
                place[0][1] - settings.offset_m * flat[1],
                place[0][2] - settings.offset_m * flat[2],
            )
            if not last:
                _continue(paths, i, live, through, d, (1.0, 1.0, 1.0), paths.pdf[i], paths.flags[i])
                live += 1
            continue
        normal = shading_normal(world, face, b, c, d, side)
        if paths.flags[i] & PRIMARY:
            _record(film, slot, world, (face, place[0], normal, base), view)
        _add(film.radiance, slot, paths, i, emitted[0], emitted[1], emitted[2])
        if last:
            continue
        material = world.surfaces.material[face]
        clear = world.materials.transmission[material]
        if clear > 0 and chance < clear * shares[2]:
            ratio = world.materials.ior[material] if side > 0 else 1 / world.materials.ior[material]
            _glass(paths, i, live, place, normal, flat, ratio, base, choice, settings.offset_m)
            live += 1
            continue
        ax, ay, az, bx, by, bz = tangents(normal[0], normal[1], normal[2])
        a, e = (ax, ay, az), (bx, by, bz)
        origin = (
            place[1][0] + settings.offset_m * flat[0],
            place[1][1] + settings.offset_m * flat[1],
            place[1][2] + settings.offset_m * flat[2],
        )
        frame = (normal, a, e, origin)
        local_view = (
            -(ax * d[0] + ay * d[1] + az * d[2]),
            -(bx * d[0] + by * d[1] + bz * d[2]),
            -(normal[0] * d[0] + normal[1] * d[1] + normal[2] * d[2]),
        )
        roughness = max(shares[1], LEAST_BLURRED_ROUGHNESS) if paths.flags[i] & BLURRED else shares[1]
        found = surface(world, material, base, shares[0], roughness, local_view[2])
        probe_weights(world.light.position, origin[0], origin[1], origin[2], weights)
        light_point = point(key, number, dimension + 1)
        shadows = _light_ray(world, paths, i, frame, local_view, found, shadow, shadows, weights, light_point)
        own_point = point(key, number, dimension + 2)
        live += _opaque(paths, i, live, found, frame, local_view, choice, own_point)
    return live, shadows, escaped


@njit(**KERNEL)
def add_lit(shadow, blocked, count, out):
    """Add the light of the shadow rays that met nothing."""
    for i in range(count):
        if not blocked[i]:
            for axis in range(3):
                out[shadow.slot[i], axis] += shadow.light[i, axis]
