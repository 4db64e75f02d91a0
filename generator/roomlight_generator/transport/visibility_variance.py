"""Which points' direct light is uncertain: some of their shadow rays met a light and others did not.

What a point received is a sum of its rays' weights, each counted or not. Where a share p of the weight arrived, the
sum's variance is about p (1 - p) times the sum of squared weights (the rays taken as independent).
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float32, Int64

from roomlight_generator.transport.direct import ShadowRays

_FEW: Final = 0.5
"""Rays' worth of light that a point is credited with, so that one whose rays all failed is not taken for a dark one."""


class VisibilityVariance:
    """Hears the shadow rays of `DirectLight.received`."""

    def __init__(self, count: int) -> None:
        """For so many points."""
        self._sent, self._seen, self._squares, self._rays = (np.zeros(count) for _ in range(4))

    def hear(self, first: int, rays: ShadowRays, seen: Bool[np.ndarray, " n"], count: int) -> None:
        """As `OnRays`: these rays belong to points from `first` on."""
        lamps = rays.cluster[:count] >= 0
        owner = rays.owner[:count][lamps] + first
        if not len(owner):
            return
        weight = rays.weight[:count][lamps].mean(axis=1, dtype=np.float64)
        start, stop = int(owner[0]), int(owner[-1]) + 1  # rays come in the points' order
        size = stop - start
        owner = owner - start
        self._sent[start:stop] += np.bincount(owner, weight, size)
        self._seen[start:stop] += np.bincount(owner, weight * seen[:count][lamps], size)
        self._squares[start:stop] += np.bincount(owner, weight * weight, size)
        self._rays[start:stop] += np.bincount(owner, minlength=size)

    def about(self, rest: Float32[np.ndarray, " n"], share: float) -> Int64[np.ndarray, " m"]:
        """Points whose standard deviation is more than a share of all their light; `rest` is what comes otherwise."""
        arrived = self._seen + _FEW * self._sent / np.maximum(self._rays, 1)
        p = np.clip(arrived / np.maximum(self._sent, 1e-30), 0, 1)
        deviation = np.sqrt(p * (1 - p) * self._squares)
        return np.flatnonzero(deviation > share * (arrived + rest))
