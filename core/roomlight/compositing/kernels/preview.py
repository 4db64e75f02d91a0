# pyright: reportMissingParameterType=false
"""Shading of first hits by prefiltered panoramas, without random numbers: Karis's split sum (2013).

`shade_hits` is the kernel.
"""

import numpy as np
from numba import njit

from roomlight.compositing.kernels.environment import bilinear_at, mixed_at, place_of, probe_weights
from roomlight.compositing.kernels.ground import arriving
from roomlight.compositing.kernels.scattering import scatter_of
from roomlight.compositing.kernels.surfaces import colours, geometric_normal, points, shading_normal
from roomlight.kernels.common import JIT, KERNEL
from roomlight.kernels.microfacets import MIRROR_ROUGHNESS, dielectric


@njit(**JIT)
def _blurred(light, mips, weights, direction, roughness):
    """Read the panorama blurred by a lobe of this roughness; the first level is what mirrors show."""
    last = mips.shape[1] - 1
    level = min(max(roughness, 0.0), 1.0) * last
    fine = min(int(level), last - 1)
    blend = level - fine
    red, green, blue = 0.0, 0.0, 0.0
    place = place_of(direction[0], direction[1], direction[2])
    for k in range(mips.shape[0]):
        r, g, b = 0.0, 0.0, 0.0
        if blend < 1:
            if fine == 0:
                r, g, b = bilinear_at(light.mirrored[k], place)
            else:
                r, g, b = bilinear_at(mips[k, fine], place)
        if blend > 0:
            p, q, s = bilinear_at(mips[k, fine + 1], place)
            r, g, b = r + blend * (p - r), g + blend * (q - g), b + blend * (s - b)
        red, green, blue = red + weights[k] * r, green + weights[k] * g, blue + weights[k] * b
    return red, green, blue


@njit(**JIT)
def _shade(world, mips, weights, face, base, shares, normal, place, d, side):
    """Return the radiance of an opaque surface toward the viewer, and the mirrored direction."""
    material = world.surfaces.material[face]
    n_v = -(d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2])
    mirrored = (d[0] + 2 * n_v * normal[0], d[1] + 2 * n_v * normal[1], d[2] + 2 * n_v * normal[2])
    clear = world.materials.transmission[material]
    r, g, b = 0.0, 0.0, 0.0
    if clear < 1:
        _, _, under, roughness, _, lobe = scatter_of(world, material, base, shares[0], shares[1], n_v)
        if lobe[0] + lobe[1] + lobe[2] > 0:
            if roughness < MIRROR_ROUGHNESS:
                p, q, s = arriving(world, world.light.mirrored, weights, place, mirrored)
            else:
                p, q, s = _blurred(world.light, mips, weights, mirrored, roughness)
            r, g, b = lobe[0] * p, lobe[1] * q, lobe[2] * s
        if under[0] + under[1] + under[2] > 0:
            p, q, s = _blurred(world.light, mips, weights, normal, 1.0)
            r, g, b = r + under[0] * p, g + under[1] * q, b + under[2] * s
    if clear > 0:
        ratio = world.materials.ior[material] if side > 0 else 1 / world.materials.ior[material]
        reflected, _ = dielectric(n_v, ratio)
        p, q, s = mixed_at(world.light.mirrored, weights, place_of(mirrored[0], mirrored[1], mirrored[2]))
        t, u, v = mixed_at(world.light.mirrored, weights, place_of(d[0], d[1], d[2]))
        let = 1 - reflected
        r += clear * (reflected * p + let * base[0] * t - r)
        g += clear * (reflected * q + let * base[1] * u - g)
        b += clear * (reflected * s + let * base[2] * v - b)
    return r, g, b


@njit(**KERNEL)
def shade_hits(world, mips, view, paths, hits, film, begin, end):
    """Fill the film of the slots begin .. end from their camera rays' first hits, but for albedo and normal."""
    weights = np.empty(world.light.radiance.shape[0])
    m = view.camera_to_world
    for i in range(begin, end):
        face = hits.face[i]
        if face < 0:
            continue
        b, c = hits.u[i], hits.v[i]
        d = (paths.direction[i, 0] * 1.0, paths.direction[i, 1] * 1.0, paths.direction[i, 2] * 1.0)
        base, shares, emitted = colours(world, face, b, c)
        flat = geometric_normal(world.surfaces, face)
        side = 1.0 if flat[0] * d[0] + flat[1] * d[1] + flat[2] * d[2] < 0 else -1.0
        place = points(world.surfaces, face, b, c, side)[0]
        normal = shading_normal(world, face, b, c, d, side)
        probe_weights(world.light.position, place[0], place[1], place[2], weights)
        red, green, blue = _shade(world, mips, weights, face, base, shares, normal, place, d, side)
        there = shares[2]
        film.radiance[i, 0] = there * (red + emitted[0])
        film.radiance[i, 1] = there * (green + emitted[1])
        film.radiance[i, 2] = there * (blue + emitted[2])
        film.alpha[i] = there
        film.object_id[i] = world.surfaces.object_id[face]
        depth = 0.0
        for axis in range(3):
            depth -= (place[axis] - m[axis, 3]) * m[axis, 2]
        film.depth_m[i] = depth
