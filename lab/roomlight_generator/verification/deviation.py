"""Relative errors of an estimate of light against a noisy reference, with and without the reference's noise.

All figures are of relative luminance, |ours - reference| / reference. The reference comes as two independent halves:
half of their difference is the noise of their mean. Since their errors are independent, the mean of (ours - one half)
(ours - other half) is our error's square without their noise, except for the noise of the reference in the
denominator: at 7 % noise a root mean square of 10 % reads 11 %.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import panorama_directions, panorama_solid_angles
from roomlight_generator.rooms.colour import LUMINANCE

_LEAST_SHARE: Final = 0.02
"""Share of the mean luminance that darker points count as: the noise of black corners would dominate otherwise."""


@dataclass(frozen=True)
class Deviation:
    """Relative errors over a number of points.

    Attributes:
        mean, median: Of the error.
        noise: Mean error that the reference's noise alone would give.
        rms: Root mean square of our error, after the reference's two halves have removed that noise.
    """

    points: int
    mean: float
    median: float
    noise: float
    rms: float

    @property
    def less_noise(self) -> float:
        """Mean error without the reference's noise, which adds to it in squares."""
        return float(np.sqrt(max(0.0, self.mean**2 - self.noise**2)))


def deviation(ours: Float[np.ndarray, "n 3"], halves: Float[np.ndarray, "2 n 3"]) -> Deviation:
    """Compute the deviation over some points.

    Raises:
        ValueError: if there are no points.
    """
    if not len(ours):
        raise ValueError("no points to compare")
    own, (a, b) = luminance(ours), luminance(halves)
    truth = (a + b) / 2
    scale = np.maximum(truth, max(_LEAST_SHARE * float(truth.mean()), 1e-12))
    error = np.abs(own - truth) / scale
    noise = np.abs(a - b) / 2 / scale
    square = float(((own - a) * (own - b) / scale**2).mean())
    rms = float(np.sqrt(max(square, 0.0)))
    return Deviation(len(own), float(error.mean()), float(np.median(error)), float(noise.mean()), rms)


def pooled(parts: Sequence[Deviation]) -> Deviation | None:
    """Average deviations (rms in squares), weighted by their points; None if there are none."""
    if not parts:
        return None
    weights = [part.points for part in parts]
    names = [field.name for field in fields(Deviation) if field.name not in ("points", "rms")]
    means = {name: float(np.average([getattr(part, name) for part in parts], weights=weights)) for name in names}
    rms = float(np.sqrt(np.average([part.rms**2 for part in parts], weights=weights)))
    return Deviation(points=sum(weights), rms=rms, **means)


def luminance(image: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape"]:
    """Return the luminance of linear RGB."""
    return image.astype(np.float64) @ LUMINANCE


def irradiance(panorama: Float[np.ndarray, "h w 3"], normals: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Integrate a panorama to irradiance on a small surface, for each unit normal: even radiance times pi."""
    height = len(panorama)
    cosine = np.maximum(normals @ panorama_directions(height).reshape(-1, 3).T.astype(np.float64), 0)
    return cosine @ (panorama * panorama_solid_angles(height)[..., None]).reshape(-1, 3).astype(np.float64)


def cube_normals() -> Float[np.ndarray, "26 3"]:
    """Return unit vectors to a cube's 6 faces, 12 edges and 8 corners."""
    grid = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    grid = grid[np.abs(grid).any(1)]
    return grid / np.linalg.norm(grid, axis=1, keepdims=True)
