"""The prior: its documented properties, in the forms that clients get."""

import numpy as np
import pytest
from light_rooms import mean_light

from roomlight.conventions import panorama_directions
from roomlight.light.main_light import main_light
from roomlight.light.prior import LEVEL, UPWARD, prior_panorama
from roomlight.light.spherical_harmonics import project


@pytest.mark.parametrize("height", [16, 33, 120, 512])
def test_it_is_grey_and_falls_from_above_to_below(height):
    prior = prior_panorama(height)
    assert prior.shape == (height, 2 * height, 3)
    assert prior.dtype == np.float32
    assert (prior[..., 0] == prior[..., 1]).all()
    assert (prior[..., 0] == prior[..., 2]).all()
    assert (np.diff(prior[:, 0, 0]) < 0).all()
    assert prior.min() > 0
    np.testing.assert_allclose(mean_light(prior), LEVEL, rtol=1e-3)


def test_harmonics_of_one_band_hold_all_of_it():
    prior = prior_panorama(120)
    harmonics = project(prior)
    np.testing.assert_allclose(harmonics.coefficients[4:], 0, atol=1e-6)
    rays = panorama_directions(16).reshape(-1, 3)
    np.testing.assert_allclose(harmonics.evaluate(rays)[:, 0], LEVEL + UPWARD * rays[:, 1], atol=1e-5)


def test_the_priors_main_light_is_soft_and_from_above():
    """Less than a quarter of what falls on a floor, so that its shadows are faint."""
    light = main_light(prior_panorama(120))
    assert light.direction[1] > 0.995  # 6 degrees: a lobe that wide has no sharper peak
    on_a_floor = project(prior_panorama(120)).irradiance().evaluate(np.array([[0.0, 1.0, 0.0]]))[0]
    assert (light.intensity > 0).all()
    assert (light.intensity < on_a_floor / 4).all()


def test_it_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        prior_panorama(16)[0] = 1
