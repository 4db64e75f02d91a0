# pyright: reportMissingParameterType=false
"""Scattering at an opaque surface: the lobe over the base of `roomlight.compositing.objects.materials`.

Vectors are local: z along the shading normal.
"""

import math
from typing import NamedTuple

from numba import njit

from roomlight.kernels.common import JIT, normalised
from roomlight.kernels.microfacets import (
    MIRROR_ROUGHNESS,
    distribution,
    lobe_share,
    masking,
    schlick,
    sheen_share,
    visible_normal,
)


class Scatter(NamedTuple):
    """How a surface scatters light toward one viewer; colours are RGB.

    Attributes:
        f0: reflectance of the lobe's microfacets at normal incidence, with what bounces between them.
        f90: the same at grazing incidence.
        base: albedo of the base, reduced by what the dielectric's lobe reflects.
        roughness: of the lobe, perceptual.
        lobe_probability: of drawing a direction from the lobe.
        lobe: share of even light that the lobe reflects.
    """

    f0: tuple[float, float, float]
    f90: tuple[float, float, float]
    base: tuple[float, float, float]
    roughness: float
    lobe_probability: float
    lobe: tuple[float, float, float]


@njit(**JIT)
def _grey(colour):
    return 0.2126 * colour[0] + 0.7152 * colour[1] + 0.0722 * colour[2]


@njit(**JIT)
def _bounces(f0, f90, kept):
    """Return 1 + F kept + (F kept)^2 ...: microfacets keep a share of the light and reflect their mean F of it again.

    Fdez-Aguera 2019, "A multiple-scattering microfacet model for real-time image based lighting".
    """
    return 1 / (1 - (20 / 21 * f0 + 1 / 21 * f90) * kept)


@njit(**JIT)
def scatter_of(world, material, base, metallic, roughness, n_v):
    """Return the `Scatter` of a material's values, as seen from the cosine n_v: `metallic` mixes dielectric and metal.

    Each one's lobe is scaled for light that meets several microfacets before it leaves (`_bounces`).
    """
    ior, specular = world.materials.ior[material], world.materials.specular[material]
    low, high = lobe_share(world.lobe, n_v, roughness)
    kept, left = 1 - (low + high), 1 - metallic
    normal = (ior - 1) / (ior + 1)
    normal = normal * normal * specular
    scale = _bounces(normal, specular, kept)
    under = left * max(1 - scale * (normal * low + specular * high), 0.0)
    normal, grazing = left * scale * normal, left * scale * specular
    f0, edge = (normal, normal, normal), (grazing, grazing, grazing)
    if metallic > 0:
        x, y, z = _bounces(base[0], 1.0, kept), _bounces(base[1], 1.0, kept), _bounces(base[2], 1.0, kept)
        x, y, z = metallic * x, metallic * y, metallic * z
        f0 = (normal + x * base[0], normal + y * base[1], normal + z * base[2])
        edge = (grazing + x, grazing + y, grazing + z)
    lobe = (f0[0] * low + edge[0] * high, f0[1] * low + edge[1] * high, f0[2] * low + edge[2] * high)
    under = (base[0] * under, base[1] * under, base[2] * under)
    return Scatter(f0, edge, under, roughness, _lobe_probability(lobe, under), lobe)


@njit(**JIT)
def _lobe_probability(lobe, base):
    shiny, matte = _grey(lobe), _grey(base)
    share = shiny / max(shiny + matte, 1e-12)
    return min(max(share, 0.1), 0.9) if matte > 0 and shiny > 0 else share


@njit(**JIT)
def under_sheen(world, scatter, sheen, n_v):
    """Lay sheen, colour and roughness, over a surface, which gets what the brightest channel of the sheen leaves.

    What sheen reflects of even light toward the viewer is reflected of light from any direction: it depends on the view
    as in KHR_materials_sheen, and is spread over the light's directions as a base is.
    """
    (red, green, blue), roughness = sheen
    if red + green + blue <= 0:
        return scatter
    share = sheen_share(world.lobe, n_v, roughness)
    left = 1 - max(red, green, blue) * share
    f0, f90, base, lobe = scatter.f0, scatter.f90, scatter.base, scatter.lobe
    lobe = (left * lobe[0], left * lobe[1], left * lobe[2])
    base = (left * base[0] + share * red, left * base[1] + share * green, left * base[2] + share * blue)
    return Scatter(
        (left * f0[0], left * f0[1], left * f0[2]),
        (left * f90[0], left * f90[1], left * f90[2]),
        base,
        scatter.roughness,
        _lobe_probability(lobe, base),
        lobe,
    )


@njit(**JIT)
def coat_reflectance(strength, cosine):
    """Return what a clear coat of index 1.5 reflects at a cosine (KHR_materials_clearcoat)."""
    return strength * (0.04 + 0.96 * schlick(cosine))


@njit(**JIT)
def evaluate(scatter, view, light):
    """Return f x (n.l), RGB, and the density of drawing `light`; both vectors local. A mirror's lobe counts as 0."""
    f0, f90, base, roughness, share, _ = scatter
    n_l, n_v = light[2], view[2]
    if n_l <= 0 or n_v <= 0:
        return (0.0, 0.0, 0.0), 0.0
    matte = n_l / math.pi
    density = (1 - share) * matte
    r, g, b = base[0] * matte, base[1] * matte, base[2] * matte
    if roughness >= MIRROR_ROUGHNESS and share > 0:
        alpha = roughness * roughness
        hx, hy, hz = normalised(view[0] + light[0], view[1] + light[1], view[2] + light[2])
        v_h = max(view[0] * hx + view[1] * hy + view[2] * hz, 0.0)
        seen = masking(n_v, alpha)
        common = distribution(hz, alpha) * seen / (4 * n_v)
        density += share * common
        weight = schlick(v_h)
        value = common * masking(n_l, alpha)
        r += value * (f0[0] + (f90[0] - f0[0]) * weight)
        g += value * (f0[1] + (f90[1] - f0[1]) * weight)
        b += value * (f0[2] + (f90[2] - f0[2]) * weight)
    return (r, g, b), density


@njit(**JIT)
def draw(scatter, view, choice, u, v):
    """Draw a local direction; returns it, the weight f (n.l) / density, and the density (-1 for a mirror)."""
    f0, f90, _, roughness, share, _ = scatter
    if choice < share:
        if roughness < MIRROR_ROUGHNESS:
            weight = schlick(view[2])
            scale = 1 / share
            return (
                (-view[0], -view[1], view[2]),
                (
                    (f0[0] + (f90[0] - f0[0]) * weight) * scale,
                    (f0[1] + (f90[1] - f0[1]) * weight) * scale,
                    (f0[2] + (f90[2] - f0[2]) * weight) * scale,
                ),
                -1.0,
            )
        hx, hy, hz = visible_normal(view[0], view[1], view[2], roughness * roughness, u, v)
        v_h = 2 * (view[0] * hx + view[1] * hy + view[2] * hz)
        light = (v_h * hx - view[0], v_h * hy - view[1], v_h * hz - view[2])
    else:
        radius, angle = math.sqrt(u), 2 * math.pi * v
        light = (radius * math.cos(angle), radius * math.sin(angle), math.sqrt(max(1 - u, 1e-9)))
    value, density = evaluate(scatter, view, light)
    if density <= 0:
        return light, (0.0, 0.0, 0.0), 1.0
    return light, (value[0] / density, value[1] / density, value[2] / density), density
