"""How far a noisy estimate of light is from the same light estimated otherwise: relative errors, and what is noise.

All figures are of relative luminance, |ours - reference| / reference. The reference comes as two independent halves:
half of their difference is the noise of their mean, and since their errors have nothing to do with each other, the mean
of (ours - one half) (ours - other half) is our own error's square without their noise (but for that of the reference it
is divided by: at 7 % a root mean square of 10 % reads 11).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import panorama_directions, panorama_solid_angles
from roomlight_generator.rooms.colour import LUMINANCE

_LEAST_SHARE: Final = 0.02
"""Of the mean luminance: what is darker counts as that dark, or a black corner's noise would be all there is."""


@dataclass(frozen=True)
class Deviation:
    """Over so many points: mean and median relative error, the mean that the reference's noise alone would give, and
    the root mean square of our error with that noise taken out by its halves."""

    points: int
    mean: float
    median: float
    noise: float
    rms: float

    @property
    def less_noise(self) -> float:
        """The mean error without the reference's noise, which adds to it in squares."""
        return float(np.sqrt(max(0.0, self.mean**2 - self.noise**2)))


def deviation(ours: Float[np.ndarray, "n 3"], halves: Float[np.ndarray, "2 n 3"]) -> Deviation:
    """The deviation over some points. ValueError where there are none."""
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
    """Means of several deviations (of rms, in squares), weighted by their points; None of none."""
    if not parts:
        return None
    weights = [part.points for part in parts]
    names = [field.name for field in fields(Deviation) if field.name not in ("points", "rms")]
    means = {name: float(np.average([getattr(part, name) for part in parts], weights=weights)) for name in names}
    rms = float(np.sqrt(np.average([part.rms**2 for part in parts], weights=weights)))
    return Deviation(points=sum(weights), rms=rms, **means)


def luminance(image: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape"]:
    """Luminance of linear RGB."""
    return image.astype(np.float64) @ LUMINANCE


def irradiance(panorama: Float[np.ndarray, "h w 3"], normals: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Of a small surface where the panorama was taken, for each unit normal: radiance times pi under even light."""
    height = len(panorama)
    cosine = np.maximum(normals @ panorama_directions(height).reshape(-1, 3).T.astype(np.float64), 0)
    return cosine @ (panorama * panorama_solid_angles(height)[..., None]).reshape(-1, 3).astype(np.float64)


def cube_normals() -> Float[np.ndarray, "26 3"]:
    """Unit vectors to a cube's 6 faces, 12 edges and 8 corners."""
    grid = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    grid = grid[np.abs(grid).any(1)]
    return grid / np.linalg.norm(grid, axis=1, keepdims=True)
