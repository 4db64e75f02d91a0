"""Tileable fractal noise, for clouds and skylines."""

from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float


def fbm(
    rng: np.random.Generator, shape: tuple[int, int], cells: tuple[int, int], *, octaves: int = 4, gain: float = 0.55
) -> Float[np.ndarray, "h w"]:
    """Return smooth tileable fractal noise of variance about 0.15 and mean about 0.

    `cells` are the rows and columns of the coarsest octave; `gain` is the amplitude's factor from octave to octave.
    """
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        rows, columns = _nearest_divisor(cells[0] << octave, shape[0]), _nearest_divisor(cells[1] << octave, shape[1])
        grid = rng.random((rows, columns), np.float32) * 2 - 1
        total += _upsampled(grid, shape) * np.float32(gain**octave)
        if rows >= shape[0] and columns >= shape[1]:
            break
    return total


@lru_cache(maxsize=256)
def _nearest_divisor(cells: int, size: int) -> int:
    """Return the divisor of `size` nearest to `cells` (within a third): others cost three times as much."""
    divisors = [n for n in range(1, size + 1) if size % n == 0]
    best = min(divisors, key=lambda n: abs(np.log(n / cells)))
    return best if 3 * abs(best - cells) <= cells else min(cells, size)


def _upsampled(grid: Float[np.ndarray, "r c"], shape: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """Interpolate cubically on the torus: padded by two cells, enlarged by whole factors, then cropped."""
    factors = [-(-shape[k] // grid.shape[k]) for k in (0, 1)]
    if factors == [1, 1]:
        return grid
    padded = np.pad(grid, 2, mode="wrap")
    size = (padded.shape[1] * factors[1], padded.shape[0] * factors[0])
    large = cv2.resize(padded, size, interpolation=cv2.INTER_CUBIC)
    top, left = 2 * factors[0], 2 * factors[1]
    large = large[top : top + grid.shape[0] * factors[0], left : left + grid.shape[1] * factors[1]]
    if large.shape != shape:
        large = cv2.resize(large, (shape[1], shape[0]), interpolation=cv2.INTER_AREA)
    return large
