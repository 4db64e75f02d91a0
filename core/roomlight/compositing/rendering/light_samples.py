"""Directions to the light for shadows: drawn from a panorama, in subsets that neighbouring pixels share."""

from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float, Float32

from roomlight.compositing.kernels.shadow_rays import LightSamples
from roomlight.compositing.light.lighting import LightSampler
from roomlight.conventions import panorama_directions

TILE: Final = 4
"""Side of the tiles whose pixels use different subsets of the samples."""
_EVEN_SHARE: Final = np.float32(0.25)


def light_samples(light: LightSampler, count: int, *, toward: Float[np.ndarray, "3"] | None = None) -> LightSamples:
    """Sample a panorama in TILE^2 subsets of `count` directions each, in proportion to luminance; kept with the light.

    A fifth of the directions is drawn without regard to luminance, so that the light around a strong lamp is sampled
    too.

    Args:
        toward: normal of the surface that most points lie on: its cosine is sampled too.
    """
    key = count, b"" if toward is None else toward.astype(np.float32).tobytes()
    if (drawn_before := light.kept.get(key)) is not None:
        return drawn_before
    mixture = light.mixed_from
    if mixture is None:
        drawn = _drawn(light, count, toward)
        made = LightSamples(drawn.directions, drawn.weights * _radiance(light, drawn))
    else:
        if key not in mixture.kept:
            drawn = _drawn(mixture.even, count, toward)
            mixture.kept[key] = drawn, np.stack([_radiance(sampler, drawn) for sampler in mixture.samplers])
        drawn, radiance = mixture.kept[key]
        mean = np.tensordot(mixture.shares.astype(np.float32), radiance, axes=1)
        made = LightSamples(drawn.directions, drawn.weights * mean)
    light.kept[key] = made
    return made


def _drawn(light: LightSampler, count: int, toward: Float[np.ndarray, "3"] | None) -> LightSamples:
    """Draw directions; the weights [s, m, 1] are 1 / (pdf count)."""
    share = np.ones(light.panorama.shape[:2], np.float32)
    if toward is not None:
        cosine = panorama_directions(len(light.panorama)) @ toward.astype(np.float32)
        share = np.maximum(cosine, np.float32(0.15))
    weighted = light.panorama * share[..., None]
    sampler = LightSampler(weighted + _EVEN_SHARE * share[..., None] * weighted.mean(), light.position)
    directions, density = sampler.sample(subset_points(count))
    weights = 1 / (np.maximum(density, np.float32(1e-9)) * np.float32(count))
    return LightSamples(directions.reshape(TILE * TILE, count, 3), weights.reshape(TILE * TILE, count, 1))


def _radiance(light: LightSampler, drawn: LightSamples) -> Float32[np.ndarray, "s m 3"]:
    return light.radiance(drawn.directions.reshape(-1, 3)).reshape(drawn.directions.shape)


@lru_cache(maxsize=8)
def subset_points(count: int) -> Float[np.ndarray, "n 2"]:
    """Return TILE^2 Hammersley sets of `count` points, each shifted by a point of the R2 sequence (Roberts 2018)."""
    index = np.arange(count)
    inverse = np.zeros(count)
    for bit in range(20):
        inverse += ((index >> bit) & 1) * 0.5 ** (bit + 1)
    hammersley = np.stack([(index + 0.5) / count, inverse], axis=-1)
    order = np.arange(TILE * TILE)[:, None, None]
    points = (hammersley + order * np.array([0.7548776662466927, 0.5698402909980532])) % 1.0
    points = points.reshape(-1, 2)
    points.setflags(write=False)
    return points
