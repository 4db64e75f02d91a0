"""The main directional light of a panorama: the one that casts the shadows.

The main light is the lobe (lamp, window, bright wall) with the most light above the room's level, not the brightest
pixel: a wide window sheds more light than a glint. The room's level is the median luminance by solid angle. Within
about 25 degrees of the lobe's peak, the light above that level is the main light:

    intensity = sum over the lobe of (share above the level) x radiance x solid angle

which is its irradiance on a surface that faces it (three.js's `DirectionalLight.intensity` x colour), in the
panorama's unit x steradian. As a point at `direction` it has harmonics intensity x basis(direction), and the ambient
harmonics are total minus exactly those.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import LUMINANCE, panorama_rays, panorama_solid_angles
from roomlight.light.checks import check_panorama
from roomlight.spheres import resize_panorama

_SEARCH_ROWS: Final = 24  # 7.5 degrees a pixel, under a kernel of 12
_KERNELS_DEG: Final = (12.0, 12.0, 12.0, 6.0, 6.0, 6.0, 6.0)
"""Widths (standard deviation) of the steps to the peak: from that of a lobe to one that separates lamps 15 degrees
apart."""
_LOBE_DEG: Final = (20.0, 30.0)  # all of the light above the level counts up to the first, none from the second on
_FAINTEST: Final = 1e-4  # of all light: a fainter lobe is a rounding error of even light


@dataclass(frozen=True)
class MainLight:
    """Unit world direction toward the light, and RGB intensity >= 0; float64.

    (0, 1, 0) with intensity 0 where the light comes evenly from everywhere, or not at all.
    """

    direction: Float[np.ndarray, "3"]
    intensity: Float[np.ndarray, "3"]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values: `direction` and `intensity`."""
        return {"direction": self.direction.tolist(), "intensity": self.intensity.tolist()}


def main_light(panorama: Float[np.ndarray, "h w 3"]) -> MainLight:
    """Find the main light; 1.5 ms for 120 x 240 on one core. Negative radiance counts as black.

    Products are computed with einsum, on this thread alone: BLAS uses its own threads, which wait for a core beside a
    running engine (12 to 16 ms in all, at a load of 8 on two cores).
    """
    panorama = np.maximum(check_panorama(panorama), 0)
    height = panorama.shape[0]
    coarse = resize_panorama(panorama, min(height, _SEARCH_ROWS)) @ LUMINANCE
    search = _Search.of_rows(len(coarse))
    level = _median(coarse.reshape(-1), search.solid_angle)
    gathered = np.einsum("ij,j->i", search.kernel, np.maximum(coarse.reshape(-1) - level, 0))
    direction = panorama_rays(len(coarse))[np.argmax(gathered)].astype(np.float64)

    rays = panorama_rays(height)
    near = np.flatnonzero(_along(rays, direction.astype(np.float32)) > np.cos(np.radians(60)))
    radiance = panorama.reshape(-1, 3)[near].astype(np.float64)
    rays, luminance = rays[near].astype(np.float64), _along(radiance, LUMINANCE.astype(np.float64))
    solid_angle = panorama_solid_angles(height)[near // (2 * height), 0]
    share = np.maximum(luminance - level, 0) / np.maximum(luminance, 1e-30)
    power = share * luminance * solid_angle
    for width_deg in _KERNELS_DEG:
        pull = power * np.exp((_along(rays, direction) - 1) / np.radians(width_deg) ** 2)
        mean = np.einsum("i,ij->j", pull, rays)
        if np.linalg.norm(mean) < 1e-30:
            break
        direction = mean / np.linalg.norm(mean)

    inner, outer = np.radians(_LOBE_DEG)
    angle = np.arccos(np.clip(_along(rays, direction), -1, 1))
    ramp = np.clip((outer - angle) / (outer - inner), 0, 1)
    window = ramp * ramp * (3 - 2 * ramp)  # a smooth edge: a lamp that crosses it does not flicker
    intensity = np.einsum("i,ij->j", window * share * solid_angle, radiance)
    total = float(coarse.reshape(-1) @ search.solid_angle)
    if intensity @ LUMINANCE <= _FAINTEST * total:
        return MainLight(np.array([0.0, 1.0, 0.0]), np.zeros(3))
    return MainLight(direction, intensity)


@dataclass(frozen=True)
class _Search:
    """Weights that gather light about every direction of a coarse panorama."""

    kernel: Float[np.ndarray, "n n"]
    solid_angle: Float[np.ndarray, " n"]

    @staticmethod
    @lru_cache(maxsize=4)
    def of_rows(rows: int) -> "_Search":
        rays = panorama_rays(rows)
        solid_angle = np.repeat(panorama_solid_angles(rows)[:, 0], 2 * rows)
        kernel = np.exp((rays @ rays.T - 1) / np.float32(np.radians(_KERNELS_DEG[0]) ** 2))
        return _Search(kernel * solid_angle, solid_angle)


def _along(vectors: Float[np.ndarray, "n 3"], axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, " n"]:
    return np.einsum("ij,j->i", vectors, axis)


def _median(values: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]) -> float:
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(cumulative, cumulative[-1] / 2)]])
