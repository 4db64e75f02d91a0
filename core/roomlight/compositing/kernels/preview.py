# pyright: reportMissingParameterType=false
"""Shading of hits of camera rays by prefiltered panoramas, without random numbers: Karis's split sum (2013).

`shade_hits` is the kernel.
"""

import math

import numpy as np
from numba import njit

from roomlight.compositing.kernels.environment import bilinear_at, mixed_at, place_of, probe_weights
from roomlight.compositing.kernels.ground import arriving
from roomlight.compositing.kernels.scattering import coat_reflectance, scatter_of, under_sheen
from roomlight.compositing.kernels.surfaces import (
    clear_coat,
    cloth_sheen,
    colours,
    geometric_normal,
    ior_beyond,
    points,
    shading_normal,
)
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
def _mirrored(d, normal):
    """Return the cosine between a ray and a normal, and the direction of its reflection."""
    n_v = -(d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2])
    return n_v, (d[0] + 2 * n_v * normal[0], d[1] + 2 * n_v * normal[1], d[2] + 2 * n_v * normal[2])


@njit(**JIT)
def _reflected(world, mips, weights, place, mirrored, roughness):
    """Return the light that a lobe sees."""
    if roughness < MIRROR_ROUGHNESS:
        seen_at = place_of(mirrored[0], mirrored[1], mirrored[2])
        return arriving(world, world.light.mirrored, weights, place, mirrored, seen_at)
    return _blurred(world.light, mips, weights, mirrored, roughness)


@njit(**JIT)
def _shade(world, mips, weights, at, base, shares, normal, place, d, side, behind):
    """Return the radiance of a surface, at (face, b, c), toward the viewer; glass shows `behind`, if NaN the light."""
    face, b, c = at
    material = world.surfaces.material[face]
    n_v, mirrored = _mirrored(d, normal)
    clear = world.materials.transmission[material]
    red, green, blue = 0.0, 0.0, 0.0
    if clear < 1:
        scatter = scatter_of(world, material, base, shares[0], shares[1], n_v)
        _, _, under, roughness, _, lobe = under_sheen(world, scatter, cloth_sheen(world, face, b, c), n_v)
        if lobe[0] + lobe[1] + lobe[2] > 0:
            p, q, s = _reflected(world, mips, weights, place, mirrored, roughness)
            red, green, blue = lobe[0] * p, lobe[1] * q, lobe[2] * s
        if under[0] + under[1] + under[2] > 0:
            p, q, s = _blurred(world.light, mips, weights, normal, 1.0)
            red, green, blue = red + under[0] * p, green + under[1] * q, blue + under[2] * s
        strength, roughness = clear_coat(world, face, b, c)
        if strength > 0:
            cosine, along = _mirrored(d, shading_normal(world, face, b, c, d, side, False))
            coat = coat_reflectance(strength, cosine)
            p, q, s = _reflected(world, mips, weights, place, along, roughness)
            red, green, blue = red + coat * (p - red), green + coat * (q - green), blue + coat * (s - blue)
    if clear > 0:
        reflected, _ = dielectric(n_v, ior_beyond(world, material, side)[0])
        p, q, s = mixed_at(world.light.mirrored, weights, place_of(mirrored[0], mirrored[1], mirrored[2]))
        t, u, v = behind
        if t != t:
            t, u, v = mixed_at(world.light.mirrored, weights, place_of(d[0], d[1], d[2]))
        let = 1 - reflected
        red += clear * (reflected * p + let * base[0] * t - red)
        green += clear * (reflected * q + let * base[1] * u - green)
        blue += clear * (reflected * s + let * base[2] * v - blue)
    return red, green, blue


@njit(**KERNEL)
def shade_hits(world, mips, view, paths, hits, behind, film, begin, end):
    """Add hits of the slots begin .. end to their film, behind what that has, but for albedo and normal.

    Args:
        behind: [end - begin, 3] radiance that glass shows straight behind it, NaN: the panorama's; or no rows.
    """
    weights = np.empty(world.light.radiance.shape[0])
    m = view.camera_to_world
    for i in range(begin, end):
        face = hits.face[i]
        if face < 0:
            continue
        b, c = hits.u[i], hits.v[i]
        d = (paths.direction[i, 0] * 1.0, paths.direction[i, 1] * 1.0, paths.direction[i, 2] * 1.0)
        flat = geometric_normal(world.surfaces, face)
        side = 1.0 if flat[0] * d[0] + flat[1] * d[1] + flat[2] * d[2] < 0 else -1.0
        base, shares, emitted = colours(world, face, b, c, side)
        there = (1 - film.alpha[i]) * shares[2]
        if there <= 0:
            continue
        place = points(world.surfaces, face, b, c, side)[0]
        normal = shading_normal(world, face, b, c, d, side, True)
        probe_weights(world.light, place[0], place[1], place[2], weights)
        through = (math.nan, math.nan, math.nan)
        if len(behind):
            row = i - begin
            through = (behind[row, 0] * 1.0, behind[row, 1] * 1.0, behind[row, 2] * 1.0)
        red, green, blue = _shade(world, mips, weights, (face, b, c), base, shares, normal, place, d, side, through)
        film.radiance[i, 0] += there * (red + emitted[0])
        film.radiance[i, 1] += there * (green + emitted[1])
        film.radiance[i, 2] += there * (blue + emitted[2])
        film.alpha[i] += there
        if film.object_id[i] < 0:
            film.object_id[i] = world.surfaces.object_id[face]
        depth = 0.0
        for axis in range(3):
            depth -= (place[axis] - m[axis, 3]) * m[axis, 2]
        film.depth_m[i] += (depth - film.depth_m[i]) * there / film.alpha[i]
