# pyright: reportMissingParameterType=false
"""One bounce of light paths from the camera, for a block of rays: what they met, shadow rays, and the next rays.

Light and scattering are drawn both and combined by the balance heuristic (Veach 1995, section 9.2): with stratified
points it left 5 to 20 % less noise than the power heuristic. At the first surface, directions of the light are drawn by
light x scattering (`guiding`). Points of objects that emit light are drawn too, with shadow rays of their own.

Faces that nothing rises above are open: rays from there are not traced, as all of them reach the light. What an open
face's base reflects of the panoramas is known without noise, from their irradiance; samples give the lobe's light, and
the difference that the support makes (a control variate).

`bounce` is the kernel; the functions above it are its steps.
"""

import math

import numpy as np
from numba import njit

from roomlight.compositing.kernels.environment import (
    density_at,
    mean_around,
    mixed_at,
    pixel_at,
    place_of,
    probe_weights,
    sample,
)
from roomlight.compositing.kernels.ground import arriving
from roomlight.compositing.kernels.guiding import fill_guide, guided_density, guided_sample
from roomlight.compositing.kernels.scattering import Scatter, coat_reflectance, draw, evaluate, scatter_of, under_sheen
from roomlight.compositing.kernels.surfaces import (
    NORMAL,
    clear_coat,
    cloth_sheen,
    colours,
    geometric_normal,
    ior_beyond,
    points,
    shading_normal,
)
from roomlight.kernels.common import JIT, KERNEL, point, tangents
from roomlight.kernels.microfacets import MIRROR_ROUGHNESS, dielectric

PRIMARY = 1
"""Flag of a ray that has met nothing since the camera."""
CLEAR = 2
"""Flag of a ray that has met glass only, and was refracted first: the background behind the glass shows in it."""
BLURRED = 4
"""Flag of a ray that a matte surface scattered: mirrors that it meets are blurred, and lamps through glass dimmed."""
LEAST_BLURRED_ROUGHNESS = 0.3
"""Of lobes that a matte surface is lit by: their lamps can be sampled, where a mirror's would be rare bright dots."""
_DIMENSIONS = 4
_SAME_GUIDE = 0.95
"""Samples of a pixel share a guide while the cosine between their normals is above this: 18 degrees."""


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
        paths.share[slot], paths.density[slot], paths.flags[slot], paths.slot[slot] = 1, 0, PRIMARY, slot


@njit(**JIT)
def _add(out, slot, paths, i, r, g, b):
    out[slot, 0] += paths.throughput[i, 0] * r
    out[slot, 1] += paths.throughput[i, 1] * g
    out[slot, 2] += paths.throughput[i, 2] * b


@njit(**JIT)
def _continue(paths, i, live, origin, direction, weight, share, flags):
    """Store the next ray at place `live`, which is at most i.

    `share` is 1 where only this ray finds the panoramas' light; its `density` is 0 where only it finds emitters.
    """
    for axis in range(3):
        paths.origin[live, axis], paths.direction[live, axis] = origin[axis], direction[axis]
        paths.throughput[live, axis] = paths.throughput[i, axis] * weight[axis]
    paths.share[live], paths.density[live], paths.flags[live], paths.slot[live] = share, 0, flags, paths.slot[i]


@njit(**JIT)
def _escape(world, paths, i, film, settings, weights, escape, escaped):
    """Add the light that a ray meets which leaves the objects, or queue it for the background: returns 0 or 1."""
    slot = paths.slot[i]
    if paths.flags[i] & PRIMARY:
        return 0
    if settings.background and paths.flags[i] & CLEAR:
        for axis in range(3):
            escape.direction[escaped, axis] = paths.direction[i, axis]
            escape.origin[escaped, axis] = paths.origin[i, axis]
            escape.light[escaped, axis] = paths.throughput[i, axis]
        escape.slot[escaped] = slot
        return 1
    d = (paths.direction[i, 0] * 1.0, paths.direction[i, 1] * 1.0, paths.direction[i, 2] * 1.0)
    origin = (paths.origin[i, 0] * 1.0, paths.origin[i, 1] * 1.0, paths.origin[i, 2] * 1.0)
    probe_weights(world.light, origin[0], origin[1], origin[2], weights)
    scale = paths.share[i]
    sharp = scale >= 1 and not paths.flags[i] & BLURRED
    images = world.light.mirrored if sharp else world.light.radiance
    r, g, b = arriving(world, images, weights, origin, d, place_of(d[0], d[1], d[2]))
    if scale >= 1 and paths.flags[i] & BLURRED:
        scale = settings.brightest / max(r, g, b, settings.brightest)
    _add(film.radiance, slot, paths, i, r * scale, g * scale, b * scale)
    return 0


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
def _glass(paths, i, live, place, normal, face_normal, ratio, is_thin, tint, choice, offset):
    """Reflect at smooth glass or refract through it; ratio is ior beyond / ior here.

    A thin wall bends no ray and tints it once; light passes two surfaces of a solid, each of which tints it by half.
    """
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
        _continue(paths, i, live, origin, out, (1.0, 1.0, 1.0), 1.0, flags)
        return
    if is_thin:
        ratio, refracted = 1.0, cosine
    else:
        tint = (math.sqrt(tint[0]), math.sqrt(tint[1]), math.sqrt(tint[2]))
    along = cosine / ratio - refracted
    out = (d[0] / ratio + along * normal[0], d[1] / ratio + along * normal[1], d[2] / ratio + along * normal[2])
    origin = (
        point_flat[0] - offset * face_normal[0],
        point_flat[1] - offset * face_normal[1],
        point_flat[2] - offset * face_normal[2],
    )
    clear = flags | CLEAR if paths.flags[i] & (PRIMARY | CLEAR) else flags
    _continue(paths, i, live, origin, out, tint, 1.0, clear)


@njit(**JIT)
def _take_known(world, paths, i, scatter, film, at, scale):
    """Take away what the base reflects of the panoramas from a sample's direction; `_add_known` gave it as a whole."""
    base = scatter.base
    if base[0] + base[1] + base[2] > 0:
        r, g, h = mixed_at(world.light.radiance, at[0], at[1])
        _add(film.radiance, paths.slot[i], paths, i, -base[0] * r * scale, -base[1] * g * scale, -base[2] * h * scale)


@njit(**JIT)
def _add_known(world, paths, i, scatter, film, normal, weights):
    """Add what the base of an open face reflects of the panoramas; returns the surface that is left to sample.

    Without supports, that is the lobe alone.
    """
    f0, f90, base, roughness, _, lobe = scatter
    if base[0] + base[1] + base[2] <= 0:
        return scatter
    r, g, h = mean_around(world.light, weights, normal)
    _add(film.radiance, paths.slot[i], paths, i, base[0] * r, base[1] * g, base[2] * h)
    if world.supports.points.shape[0] > 0:
        return scatter
    return Scatter(f0, f90, (0.0, 0.0, 0.0), roughness, 1.0, lobe)


@njit(**JIT)
def _light_ray(world, paths, i, hit, film, shadow, count, guiding, points2):
    """Draw a direction of the light: add its light, or store a shadow ray at `count`; returns their number."""
    scatter, frame, local_view, flat, is_open, _ = hit
    normal, a, b, origin = frame
    weights, guide, guided = guiding
    if guided:
        d, place, drawn = guided_sample(world.light, weights, guide, points2[0], points2[1])
    else:
        d, place, drawn = sample(world.light, weights, points2[0], points2[1])
    local = (
        a[0] * d[0] + a[1] * d[1] + a[2] * d[2],
        b[0] * d[0] + b[1] * d[1] + b[2] * d[2],
        normal[0] * d[0] + normal[1] * d[1] + normal[2] * d[2],
    )
    value, own = evaluate(scatter, local_view, local)
    if drawn <= 0 or (own <= 0 and value[0] + value[1] + value[2] <= 0):
        return count
    r, g, h = arriving(world, world.light.radiance, weights, origin, d, place)
    scale = 1 / (drawn + own)
    red, green, blue = value[0] * r * scale, value[1] * g * scale, value[2] * h * scale
    if is_open:
        _take_known(world, paths, i, scatter, film, (weights, place), max(local[2], 0.0) * (scale / math.pi))
        if flat[0] * d[0] + flat[1] * d[1] + flat[2] * d[2] > 0:
            _add(film.radiance, paths.slot[i], paths, i, red, green, blue)
            return count
    if red + green + blue <= 0:
        return count
    return _store(shadow, count, paths, i, (origin, d), (red, green, blue), np.inf)


@njit(**JIT)
def _store(shadow, count, paths, i, ray, light, reach_m):
    """Store a shadow ray (origin, direction) at `count`; returns the number of them."""
    for axis in range(3):
        shadow.origin[count, axis], shadow.direction[count, axis] = ray[0][axis], ray[1][axis]
        shadow.light[count, axis] = paths.throughput[i, axis] * light[axis]
    shadow.reach_m[count], shadow.slot[count] = reach_m, paths.slot[i]
    return count + 1


@njit(**JIT)
def _emitter_ray(world, paths, i, hit, shadow, count, points2):
    """Draw a point of the triangles that emit light; store a shadow ray to it at `count`; returns their number."""
    scatter, (normal, a, b, origin), local_view, _, _, _ = hit
    emitters = world.emitters
    at = min(np.searchsorted(emitters.upto, points2[0], "right"), len(emitters.face) - 1)
    before = emitters.upto[at - 1] if at > 0 else 0.0
    root = math.sqrt(min((points2[0] - before) / max(emitters.upto[at] - before, 1e-12), 1.0))
    face, u, v = emitters.face[at], root * (1 - points2[1]), root * points2[1]
    place, _ = points(world.surfaces, face, u, v, 1.0)
    x, y, z = place[0] - origin[0], place[1] - origin[1], place[2] - origin[2]
    distance_m = math.sqrt(max(x * x + y * y + z * z, 1e-12))
    d = (x / distance_m, y / distance_m, z / distance_m)
    flat = geometric_normal(world.surfaces, face)
    facing = flat[0] * d[0] + flat[1] * d[1] + flat[2] * d[2]
    local = (
        a[0] * d[0] + a[1] * d[1] + a[2] * d[2],
        b[0] * d[0] + b[1] * d[1] + b[2] * d[2],
        normal[0] * d[0] + normal[1] * d[1] + normal[2] * d[2],
    )
    value, own = evaluate(scatter, local_view, local)
    _, shares, emitted = colours(world, face, u, v, -1.0 if facing > 0 else 1.0)
    scale = shares[2] / (own + _emitter_density(world, face, distance_m, facing))
    light = (value[0] * emitted[0] * scale, value[1] * emitted[1] * scale, value[2] * emitted[2] * scale)
    if light[0] + light[1] + light[2] <= 0:
        return count
    return _store(shadow, count, paths, i, (origin, d), light, distance_m * 0.999)


@njit(**JIT)
def _emitter_density(world, face, distance_m, facing):
    """Return the density, per steradian, of drawing a point of a face that is so far away."""
    density = world.emitters.density[world.surfaces.material[face]]
    return density * distance_m * distance_m / max(abs(facing), 1e-6)


@njit(**JIT)
def _opaque(world, paths, i, live, hit, film, guiding, choice, points2):
    """Draw the next ray of an opaque surface; returns 1 if there is one, 0 if it ends or meets the light."""
    scatter, frame, local_view, flat, is_open, is_bent = hit
    normal, a, b, origin = frame
    weights, guide, guided = guiding
    light, weight, pdf = draw(scatter, local_view, choice, points2[0], points2[1])
    if light[2] <= 0 or max(weight[0], weight[1], weight[2]) < 1e-6:
        return 0
    d = (
        a[0] * light[0] + b[0] * light[1] + normal[0] * light[2],
        a[1] * light[0] + b[1] * light[1] + normal[1] * light[2],
        a[2] * light[0] + b[2] * light[1] + normal[2] * light[2],
    )
    above = flat[0] * d[0] + flat[1] * d[1] + flat[2] * d[2]
    if is_bent and above < 0:  # a bent normal throws rays into its own surface, which would be dark: turned back
        d = (d[0] - 2 * above * flat[0], d[1] - 2 * above * flat[1], d[2] - 2 * above * flat[2])
    place = place_of(d[0], d[1], d[2])
    share = 1.0
    if pdf > 0:
        row, column = pixel_at(world.light, place)
        if guided:
            share = pdf / (pdf + guided_density(world.light, weights, guide, row, column))
        else:
            share = pdf / (pdf + density_at(world.light, weights, row, column))
    blurred = paths.flags[i] & BLURRED
    if is_open and pdf > 0:
        _take_known(world, paths, i, scatter, film, (weights, place), share * light[2] / (math.pi * pdf))
    if is_open and not (blurred and share >= 1) and flat[0] * d[0] + flat[1] * d[1] + flat[2] * d[2] > 0:
        images = world.light.radiance if pdf > 0 else world.light.mirrored
        r, g, h = arriving(world, images, weights, origin, d, place)
        _add(
            film.radiance, paths.slot[i], paths, i, weight[0] * r * share, weight[1] * g * share, weight[2] * h * share
        )
        return 0
    matte = choice >= scatter.lobe_probability or scatter.roughness >= LEAST_BLURRED_ROUGHNESS
    _continue(paths, i, live, origin, d, weight, share, BLURRED if matte else blurred)
    paths.density[live] = max(pdf, 0.0)
    return 1


@njit(**KERNEL)
def bounce(world, view, paths, count, hits, film, queues, settings):
    """Advance `count` rays by one surface.

    Rays that go on are moved to the front of `paths`; the others are put into the two `queues`.

    Args:
        world: surfaces, materials, textures and light (`renderer._World`).
        view: the camera and the pixels of the block (`renderer._View`).
        paths: the rays [n] (`renderer._Paths`); overwritten by those that go on.
        count: number of rays, the first of `paths`.
        hits: what each ray met (`roomlight.rays.RayHits`).
        film: [n] a value for each sample, by the rays' slots (`renderer._Film`); light is added.
        queues: shadow rays, with room for 2 n if things emit light, and rays to the background (`renderer._Queue`).
        settings: `renderer._Settings`.

    Returns:
        The numbers of rays that go on, to the light, and to the background.
    """
    shadow, escape = queues
    weights = np.empty(world.light.radiance.shape[0])
    rows, columns = world.light.cells.shape[1], world.light.cells.shape[2]
    guide = (np.empty((rows, columns)), np.empty(rows))
    guide_pixel, guide_layer, guide_normal = -1, -1, (0.0, 0.0, 0.0)
    live, shadows, escaped = np.int64(0), np.int64(0), np.int64(0)  # literal zeros would compile what they go to twice
    dimension = 1 + settings.depth * _DIMENSIONS
    last = settings.depth >= settings.max_bounces
    for i in range(count):
        face = hits.face[i]
        slot = paths.slot[i]
        # 1. A ray that leaves the objects brings the light there, or waits for the background behind glass.
        if face < 0:
            escaped += _escape(world, paths, i, film, settings, weights, escape, escaped)
            continue
        # 2. What the ray meets: colours, side and place.
        b, c = hits.u[i], hits.v[i]
        d = (paths.direction[i, 0], paths.direction[i, 1], paths.direction[i, 2])
        key = view.key[slot // settings.samples]
        number = settings.first + slot % settings.samples
        chance, choice = point(key, number, dimension)
        flat = geometric_normal(world.surfaces, face)
        side = 1.0 if flat[0] * d[0] + flat[1] * d[1] + flat[2] * d[2] < 0 else -1.0
        base, shares, emitted = colours(world, face, b, c, side)
        flat = (flat[0] * side, flat[1] * side, flat[2] * side)
        place = points(world.surfaces, face, b, c, side)
        # 3. A cut-out lets the ray pass; as it stops shadow rays, the path brings all of the light behind it. What a
        # camera ray passes is decided by one number, so that the shares of several layers are as even as of one.
        if settings.depth > 0 and paths.flags[i] & PRIMARY:
            chance = paths.layer[i] * 1.0
        if chance >= shares[2]:
            through = (
                place[0][0] - settings.offset_m * flat[0],
                place[0][1] - settings.offset_m * flat[1],
                place[0][2] - settings.offset_m * flat[2],
            )
            if last:
                escaped += _escape(world, paths, i, film, settings, weights, escape, escaped)
            else:
                _continue(paths, i, live, through, d, (1.0, 1.0, 1.0), 1.0, paths.flags[i])
                paths.layer[live] = (chance - shares[2]) / (1 - shares[2])
                live += 1
            continue
        # 4. The first surface of a camera ray is recorded; every surface adds the light that it emits, as far as
        # shadow rays to it have not.
        normal = shading_normal(world, face, b, c, d, side, True)
        if paths.flags[i] & PRIMARY:
            _record(film, slot, world, (face, place[0], normal, base), view)
        if emitted[0] + emitted[1] + emitted[2] > 0:
            scale, drawn = 1.0, paths.density[i] * 1.0
            if drawn > 0:
                facing = flat[0] * d[0] + flat[1] * d[1] + flat[2] * d[2]
                scale = drawn / (drawn + _emitter_density(world, face, hits.distance_m[i], facing))
            _add(film.radiance, slot, paths, i, emitted[0] * scale, emitted[1] * scale, emitted[2] * scale)
        # 5. Glass reflects or refracts the ray; the last one goes straight on to the light.
        material = world.surfaces.material[face]
        clear = world.materials.transmission[material]
        is_glass = clear > 0 and chance < clear * shares[2]
        if last:
            if is_glass:
                escaped += _escape(world, paths, i, film, settings, weights, escape, escaped)
            continue
        if is_glass:
            ratio, is_thin = ior_beyond(world, material, side)
            _glass(paths, i, live, place, normal, flat, ratio, is_thin, base, choice, settings.offset_m)
            live += 1
            continue
        # 6. A clear coat reflects some of the rays, as a white metal does; the others get to what is under it.
        metallic, roughness, is_coated = shares[0], shares[1], False
        coat, coat_roughness = clear_coat(world, face, b, c)
        if coat > 0:
            smooth = shading_normal(world, face, b, c, d, side, False)
            coat = coat_reflectance(coat, -(smooth[0] * d[0] + smooth[1] * d[1] + smooth[2] * d[2]))
            odds = min(max(coat, 0.1), 0.9)
            is_coated = chance < shares[2] * (clear + (1 - clear) * odds)
            weight = coat / odds if is_coated else (1 - coat) / (1 - odds)
            for axis in range(3):
                paths.throughput[i, axis] *= weight
            if is_coated:
                base, metallic, roughness, normal = (1.0, 1.0, 1.0), 1.0, coat_roughness, smooth
        # 7. How the surface scatters, in a frame about its normal.
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
        roughness = max(roughness, LEAST_BLURRED_ROUGHNESS) if paths.flags[i] & BLURRED else roughness
        scatter = scatter_of(world, material, base, metallic, roughness, local_view[2])
        if not is_coated:
            scatter = under_sheen(world, scatter, cloth_sheen(world, face, b, c), local_view[2])
        probe_weights(world.light, origin[0], origin[1], origin[2], weights)
        # 8. An open face's base gets the light of the panoramas that is known without samples.
        guided = (paths.flags[i] & PRIMARY) != 0  # also behind cut-outs
        is_open = side > 0 and world.is_open[face]
        if is_open:
            scatter = _add_known(world, paths, i, scatter, film, normal, weights)
            lobe, base_left = scatter.lobe, scatter.base
            if lobe[0] + lobe[1] + lobe[2] + base_left[0] + base_left[1] + base_left[2] <= 0:
                continue
        # 9. A direction of the light, with a shadow ray unless the face is open.
        is_bent = world.materials.texture[material, NORMAL] >= 0 and not is_coated
        hit = (scatter, frame, local_view, flat, is_open, is_bent)
        if scatter.lobe_probability < 1 or roughness >= MIRROR_ROUGHNESS:
            if guided:
                film.doubt[slot] = 1
                pixel = slot // settings.samples
                turned = normal[0] * guide_normal[0] + normal[1] * guide_normal[1] + normal[2] * guide_normal[2]
                layer = -2 - material if is_coated else material
                if pixel != guide_pixel or layer != guide_layer or turned < _SAME_GUIDE:
                    fill_guide(world.light, weights, scatter, (normal, a, e), local_view, guide)
                    guide_pixel, guide_layer, guide_normal = pixel, layer, normal
            light_point = point(key, number, dimension + 1)
            guiding = (weights, guide, guided)
            shadows = _light_ray(world, paths, i, hit, film, shadow, shadows, guiding, light_point)
            if len(world.emitters.face) and not is_open:
                shadows = _emitter_ray(world, paths, i, hit, shadow, shadows, point(key, number, dimension + 3))
        # 10. The next ray, by scattering.
        own_point = point(key, number, dimension + 2)
        live += _opaque(world, paths, i, live, hit, film, (weights, guide, guided), choice, own_point)
    return live, shadows, escaped


@njit(**KERNEL)
def add_lit(shadow, blocked, count, out):
    """Add the light of the shadow rays that met nothing."""
    for i in range(count):
        if not blocked[i]:
            for axis in range(3):
                out[shadow.slot[i], axis] += shadow.light[i, axis]
