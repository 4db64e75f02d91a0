"""Variance of points' direct light: large where some shadow rays met a light and others did not.

A point's light is the sum of the weights of its visible rays. If a share p of all weight arrives, the
sum's variance is about p (1 - p) times the sum of squared weights (the rays taken as independent).
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float32, Int64

from roomlight_generator.transport.lights.direct import ShadowRays

_FEW: Final = 0.5
"""A point is credited with the light of this many rays: a point whose rays all failed does not count as dark."""


class VisibilityVariance:
    """The variance of points' direct light, estimated from the shadow rays of `DirectLight.received`."""

    def __init__(self, count: int) -> None:
        """Start without rays, for `count` points."""
        self._sent, self._seen, self._squares, self._rays = (np.zeros(count) for _ in range(4))

    def add(self, first: int, rays: ShadowRays, seen: Bool[np.ndarray, " n"], count: int) -> None:
        """Add the first `count` rays, which belong to points from `first` on (an `OnRays`); the sun's do not count."""
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

    def select(self, rest: Float32[np.ndarray, " n"], share: float) -> Int64[np.ndarray, " m"]:
        """Select the points whose standard deviation exceeds a share of all their light.

        Args:
            rest: Irradiance of each point from elsewhere, mean over the channels.
            share: Largest accepted standard deviation, as a share of the point's light.
        """
        arrived = self._seen + _FEW * self._sent / np.maximum(self._rays, 1)
        p = np.clip(arrived / np.maximum(self._sent, 1e-30), 0, 1)
        deviation = np.sqrt(p * (1 - p) * self._squares)
        return np.flatnonzero(deviation > share * (arrived + rest))
