"""Which points get a second round of shadow rays."""

import numpy as np

from roomlight_generator.transport.kernels.structs import allocated
from roomlight_generator.transport.lights.direct import ShadowRays
from roomlight_generator.transport.lights.visibility_variance import VisibilityVariance

RAYS = 32


def variance_of(seen, *, cluster=0, batches=1):
    """The variance after rays of equal weight, `seen` [points, rays] of them visible."""
    points = len(seen)
    variance = VisibilityVariance(points)
    for first in range(0, points, points // batches):
        some = seen[first : first + points // batches]
        rays = allocated(ShadowRays, some.size + 5)  # as in use: longer than what is written
        rays.owner[: some.size] = np.repeat(np.arange(len(some)), RAYS)
        rays.weight[: some.size] = 1 / RAYS
        rays.cluster[: some.size] = cluster
        variance.add(first, rays, some.ravel(), some.size)
    return variance


def with_share(*shares):
    return np.arange(RAYS) < RAYS * np.array(shares)[:, None]


def test_half_hidden_lights_are_uncertain_and_others_are_not():
    variance = variance_of(with_share(1.0, 0.5, 0.25, 0.97))
    assert variance.select(np.zeros(4, np.float32), 0.12).tolist() == [1, 2]
    # sqrt(p (1 - p) / n) / p: 0.17 and 0.30, with half a ray's credit somewhat less
    assert variance.select(np.zeros(4, np.float32), 0.2).tolist() == [2]
    assert variance.select(np.zeros(4, np.float32), 0.35).tolist() == []


def test_much_other_light_makes_uncertainty_irrelevant():
    variance = variance_of(with_share(0.5, 0.5))
    assert variance.select(np.array([0, 5], np.float32), 0.12).tolist() == [0]


def test_all_rays_blocked_is_not_certain_darkness():
    assert variance_of(with_share(0.0)).select(np.zeros(1, np.float32), 0.3).tolist() == [0]


def test_rays_to_the_sun_do_not_count():
    shares = with_share(1.0, 0.5, 0.5, 1.0)
    assert variance_of(shares, cluster=-1).select(np.zeros(4, np.float32), 0.12).tolist() == []
