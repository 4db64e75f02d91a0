"""Which points get a second round of shadow rays."""

import numpy as np

from roomlight_generator.transport.direct import ShadowRays
from roomlight_generator.transport.visibility_variance import VisibilityVariance

RAYS = 32


def heard(seen, *, cluster=0, batches=1):
    """A doubt that heard `seen` [points, rays] of equally weighted rays."""
    points = len(seen)
    doubt = VisibilityVariance(points)
    for first in range(0, points, points // batches):
        some = seen[first : first + points // batches]
        rays = ShadowRays.room_for(some.size + 5)  # as in use: longer than what is written
        rays.owner[: some.size] = np.repeat(np.arange(len(some)), RAYS)
        rays.weight[: some.size] = 1 / RAYS
        rays.cluster[: some.size] = cluster
        doubt.hear(first, rays, some.ravel(), some.size)
    return doubt


def with_share(*shares):
    return np.arange(RAYS) < RAYS * np.array(shares)[:, None]


def test_half_hidden_lights_are_uncertain_and_others_are_not():
    doubt = heard(with_share(1.0, 0.5, 0.25, 0.97))
    assert doubt.about(np.zeros(4, np.float32), 0.12).tolist() == [1, 2]
    # sqrt(p (1 - p) / n) / p: 0.17 and 0.30, with half a ray's credit somewhat less
    assert doubt.about(np.zeros(4, np.float32), 0.2).tolist() == [2]
    assert doubt.about(np.zeros(4, np.float32), 0.35).tolist() == []


def test_beside_much_other_light_it_does_not_matter():
    doubt = heard(with_share(0.5, 0.5))
    assert doubt.about(np.array([0, 5], np.float32), 0.12).tolist() == [0]


def test_rays_that_all_failed_are_not_taken_for_certain_darkness():
    assert heard(with_share(0.0)).about(np.zeros(1, np.float32), 0.3).tolist() == [0]


def test_points_in_batches_are_told_apart_and_the_sun_does_not_count():
    shares = with_share(1.0, 0.5, 0.5, 1.0)
    assert heard(shares, batches=2).about(np.zeros(4, np.float32), 0.12).tolist() == [1, 2]
    assert heard(shares, cluster=-1).about(np.zeros(4, np.float32), 0.12).tolist() == []
