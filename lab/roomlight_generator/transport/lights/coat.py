"""The clear coat of glossy materials, tabulated: Mitsuba's `roughplastic`, index 1.5, GGX, nonlinear = false.

Its diffuse base reflects albedo * scale * T(incoming) * T(outgoing) / pi, where T is the share of light from a
direction that gets through the rough boundary and scale = 1 / ((1 - internal reflectance) * 1.5^2). Light lost
to masking at the boundary (single scattering) stays lost, as in Mitsuba.
"""

from functools import cache
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float, Float32

INDEX: Final = 1.5
ROUGHEST: Final = 0.64
"""The table's last GGX alpha; materials go to 0.6."""

_ALPHAS: Final = 17
_COSINES: Final = 65


class CoatTable(NamedTuple):
    """The shares of light that the boundary lets through and reflects, by alpha and cosine.

    Rows are alpha = 0 to ROUGHEST, columns cosine = 0 to 1, both in even steps. For each row also the base's scale, and
    the mean shares of even light that are reflected and let through.
    """

    through: Float32[np.ndarray, "a c"]
    reflected: Float32[np.ndarray, "a c"]
    scale: Float32[np.ndarray, " a"]
    mean_reflected: Float32[np.ndarray, " a"]
    mean_through: Float32[np.ndarray, " a"]


def fresnel(cosine: Float[np.ndarray, "*n"], index: float) -> Float[np.ndarray, "*n"]:
    """Return the unpolarised reflectance of a dielectric for light at a cosine; index is inside over outside."""
    sine_sq = (1 - cosine**2) / index**2
    inner = np.sqrt(np.maximum(1 - sine_sq, 0))
    parallel = (index * cosine - inner) / (index * cosine + inner + 1e-12)
    perpendicular = (cosine - index * inner) / (cosine + index * inner + 1e-12)
    return np.where(sine_sq >= 1, 1.0, (parallel**2 + perpendicular**2) / 2)


def boundary(
    alpha: float, cosines: Float[np.ndarray, " c"], index: float
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Return the shares of the light from each cosine that a GGX boundary reflects and lets through.

    By 48 x 48 points of visible-normal sampling.
    """
    nodes, weights = np.polynomial.legendre.leggauss(48)
    x, y = np.meshgrid((nodes + 1) / 2, (nodes + 1) / 2)
    share = np.outer(weights, weights) / 4
    cosine = np.maximum(cosines, 1e-3)[:, None, None]
    sine = np.sqrt(1 - cosine**2)
    # Visible normals of the stretched view (Heitz 2018), view in the x-z plane.
    length = np.sqrt((alpha * sine) ** 2 + cosine**2)
    vx, vz = alpha * sine / length, cosine / length
    radius, angle = np.sqrt(x), 2 * np.pi * y
    across, along = radius * np.cos(angle), radius * np.sin(angle)
    mix = (1 + vz) / 2
    along = (1 - mix) * np.sqrt(1 - across**2) + mix * along
    up = np.sqrt(np.maximum(1 - across**2 - along**2, 0))
    # Frame: across is the y axis, along is v x y = (-vz, 0, vx).
    nx, ny, nz = alpha * (-vz * along + vx * up), alpha * across, np.maximum(vx * along + vz * up, 1e-9)
    norm = np.sqrt(nx**2 + ny**2 + nz**2)
    toward = (nx * sine + nz * cosine) / norm
    out_z = 2 * toward * nz / norm - cosine
    facing = np.clip(toward, 0, 1)
    reflection = fresnel(facing, index)
    reflected = np.where(out_z > 0, reflection * _unmasked(out_z, alpha), 0)
    # Refracted: -view / index + (toward / index - inner cosine) * facet.
    inner = np.sqrt(np.maximum(1 - (1 - facing**2) / index**2, 0))
    down = -cosine / index + (facing / index - inner) * nz / norm
    through = np.where(down < 0, (1 - reflection) * _unmasked(-down, alpha), 0)
    return (reflected * share).sum((1, 2)), (through * share).sum((1, 2))


def _unmasked(cosine: Float[np.ndarray, "*n"], alpha: float) -> Float[np.ndarray, "*n"]:
    """Return Smith's masking term G1 of GGX."""
    cosine = np.clip(cosine, 1e-4, 1)
    return 2 / (1 + np.sqrt(1 + alpha**2 * (1 - cosine**2) / cosine**2))


@cache
def coat_table() -> CoatTable:
    """Return the table; the first call takes 0.5 s."""
    cosines = np.linspace(0, 1, _COSINES)
    nodes, weights = np.polynomial.legendre.leggauss(32)
    inner = (nodes + 1) / 2
    reflected, through = np.empty((_ALPHAS, _COSINES)), np.empty((_ALPHAS, _COSINES))
    scale = np.empty(_ALPHAS)
    for row, roughness in enumerate(np.linspace(0, ROUGHEST, _ALPHAS)):
        alpha = max(float(roughness), 1e-3)
        reflected[row], through[row] = boundary(alpha, cosines, INDEX)
        internal = float((boundary(alpha, inner, 1 / INDEX)[0] * inner * weights).sum())
        scale[row] = 1 / ((1 - internal) * INDEX**2)
    means = [2 * np.trapezoid(part * cosines, cosines) for part in (reflected, through)]
    return CoatTable(*(np.asarray(part, np.float32) for part in (through, reflected, scale, *means)))
