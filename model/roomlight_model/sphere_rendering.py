"""The Monte Carlo rendering layer: a glossy sphere under predicted light, differentiable (paper, equation R_p).

The material is the paper's: Karis's microfacet BRDF (2013) with albedo 0.8 and roughness 0.2, as in
`roomlight.spheres` (whose "glossy" is the readable twin). Directions are drawn by multiple importance sampling: a share
by the half vectors of the specular lobe, the rest by the cosine; dividing by the mixture's density makes the estimate
unbiased. Frame: that of the given vectors, world or volume.
"""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from roomlight.spheres import GLOSSY_ALBEDO, GLOSSY_F0, GLOSSY_ROUGHNESS

SPECULAR_SHARE = 0.5
"""Share of the samples; the lobe has a tenth of the energy and nearly all of the variance under small lamps."""

_GOLDEN = 0.618033988749895


class SphereSamples(NamedTuple):
    """Directions of incoming light and their weights: R_p = sum_s weight[p, s] L(direction[p, s])."""

    directions: Float[Tensor, "*b p s 3"]
    weights: Float[Tensor, "*b p s"]


def sphere_normals(to_viewer: Float[Tensor, "*b 3"], points: Float[Tensor, "*b p 2"]) -> Float[Tensor, "*b p 3"]:
    """Return the normals of an orthographically viewed sphere at points of the unit disc (right, up); +Y is up."""
    up = torch.zeros_like(to_viewer)
    up[..., 1] = 1.0
    steep = to_viewer[..., 1:2].abs() > 0.9999
    sideways = torch.zeros_like(to_viewer)
    sideways[..., 0] = 1.0
    up = torch.where(steep, sideways, up)
    right = functional.normalize(torch.linalg.cross(up, to_viewer), dim=-1)
    up = torch.linalg.cross(to_viewer, right)
    x, y = points[..., 0:1], points[..., 1:2]
    z = (1 - x * x - y * y).clamp(min=1e-6).sqrt()
    return x * right[..., None, :] + y * up[..., None, :] + z * to_viewer[..., None, :]


def disc(
    count: int, *, batch: tuple[int, ...] = (), generator: torch.Generator | None = None
) -> Float[Tensor, "*b p 2"]:
    """Draw points in the unit disc, stratified by area, without the outer 2 % of the radius."""
    uniform = torch.rand((*batch, count, 2), generator=generator)
    radius = 0.98 * ((torch.arange(count) + uniform[..., 0]) / count).sqrt()
    angle = 2 * math.pi * ((torch.arange(count) * _GOLDEN + uniform[..., 1]) % 1.0)
    return torch.stack([radius * angle.cos(), radius * angle.sin()], dim=-1)


def sample_sphere(
    normals: Float[Tensor, "*b p 3"],
    to_viewer: Float[Tensor, "*b 3"],
    *,
    samples: int,
    generator: torch.Generator | None = None,
) -> SphereSamples:
    """Draw stratified directions by the BRDF at each normal, with their weights F(l) n.l / (N P(l)).

    Raises:
        ValueError: Fewer than two samples: each lobe needs one.
    """
    specular = max(1, round(samples * SPECULAR_SHARE))
    if samples <= specular:
        raise ValueError(f"a pixel needs at least two samples, one for each lobe; got {samples}")
    viewer = to_viewer[..., None, None, :]
    shape = (*normals.shape[:-1], samples)
    # random numbers come from the CPU's generator on every device, so that runs repeat on other machines
    uniform = torch.rand((*shape, 2), generator=generator, dtype=normals.dtype).to(normals.device)
    strata = torch.cat([torch.arange(specular) / specular, torch.arange(samples - specular) / (samples - specular)])
    widths = torch.cat(
        [torch.full((specular,), 1 / specular), torch.full((samples - specular,), 1 / (samples - specular))]
    )
    radial = strata.to(normals) + uniform[..., 0] * widths.to(normals)
    # a lattice rotated by one random number per pixel: azimuths of neighbouring strata are far apart
    steps = torch.arange(samples, device=normals.device, dtype=normals.dtype) * _GOLDEN
    angle = 2 * math.pi * ((uniform[..., :1, 1] + steps) % 1.0)

    first = torch.arange(samples, device=normals.device) < specular
    alpha = GLOSSY_ROUGHNESS**2
    half_cosine = ((1 - radial) / (1 + (alpha**2 - 1) * radial)).clamp(0, 1).sqrt()
    cosine = torch.where(first, half_cosine, radial.sqrt())
    sine = (1 - cosine * cosine).clamp(min=0).sqrt()
    tangent, bitangent = _frame(normals)
    local = (
        (sine * angle.cos())[..., None] * tangent[..., None, :]
        + (sine * angle.sin())[..., None] * bitangent[..., None, :]
        + cosine[..., None] * normals[..., None, :]
    )
    reflected = 2 * (local * viewer).sum(-1, keepdim=True) * local - viewer
    directions = torch.where(first[:, None], reflected, local)
    directions = functional.normalize(directions, dim=-1)
    value, density = brdf_and_density(normals, to_viewer, directions, specular / samples)
    weights = torch.where(density > 0, value / density.clamp(min=1e-12), 0.0) / samples
    return SphereSamples(directions, weights)


def brdf_and_density(
    normals: Float[Tensor, "*b p 3"],
    to_viewer: Float[Tensor, "*b 3"],
    directions: Float[Tensor, "*b p s 3"],
    specular_share: float,
) -> tuple[Float[Tensor, "*b p s"], Float[Tensor, "*b p s"]]:
    """Return F(l, n, v) n.l, and the density (per steradian) with which `sample_sphere` draws direction l."""
    viewer, normal = to_viewer[..., None, None, :], normals[..., None, :]
    half = functional.normalize(directions + viewer, dim=-1)
    n_l = (directions * normal).sum(-1)
    n_v = (normal * viewer).sum(-1).clamp(min=1e-4)
    n_h, v_h = (half * normal).sum(-1).clamp(0, 1), (half * viewer).sum(-1).clamp(min=1e-4)
    alpha, k = GLOSSY_ROUGHNESS**2, (GLOSSY_ROUGHNESS + 1) ** 2 / 8
    ggx = alpha**2 / (math.pi * (n_h * n_h * (alpha**2 - 1) + 1) ** 2)
    fresnel = GLOSSY_F0 + (1 - GLOSSY_F0) * 2 ** ((-5.55473 * v_h - 6.98316) * v_h)
    lit = n_l.clamp(min=0)
    shadowing = 1 / ((lit * (1 - k) + k) * (n_v * (1 - k) + k))
    value = (GLOSSY_ALBEDO / math.pi + ggx * fresnel * shadowing / 4) * lit
    density = specular_share * ggx * n_h / (4 * v_h) + (1 - specular_share) * lit / math.pi
    return torch.where(n_l > 0, value, 0.0), density


def look_up(panoramas: Float[Tensor, "b 3 h w"], directions: Float[Tensor, "b n 3"]) -> Float[Tensor, "b n 3"]:
    """Sample panoramas along unit directions: bilinear, wrapping at the seam; differentiable in the panoramas."""
    width = panoramas.shape[-1]
    u = 0.5 + torch.atan2(directions[..., 2], directions[..., 0]) / (2 * math.pi)
    v = torch.acos(directions[..., 1].clamp(-1, 1)) / math.pi
    padded = torch.cat([panoramas[..., -1:], panoramas, panoramas[..., :1]], dim=-1)
    x = 2 * (u * width + 1) / (width + 2) - 1
    grid = torch.stack([x, 2 * v - 1], dim=-1)[:, None]
    read = functional.grid_sample(padded, grid.to(padded.dtype), padding_mode="border", align_corners=False)
    return read[:, :, 0].transpose(1, 2)


def shade(samples: SphereSamples, radiance: Float[Tensor, "*b p s 3"]) -> Float[Tensor, "*b p 3"]:
    """Return the pixels' radiance R_p."""
    return (samples.weights[..., None] * radiance).sum(dim=-2)


def _frame(normals: Float[Tensor, "*b p 3"]) -> tuple[Float[Tensor, "*b p 3"], Float[Tensor, "*b p 3"]]:
    """Return two unit vectors orthogonal to each normal and to each other."""
    other = torch.where(
        normals[..., 1:2].abs() < 0.9, normals.new_tensor([0.0, 1.0, 0.0]), normals.new_tensor([1.0, 0.0, 0.0])
    )
    tangent = functional.normalize(torch.linalg.cross(other, normals), dim=-1)
    return tangent, torch.linalg.cross(normals, tangent)
