"""The 8-bit picture: sRGB, clipping, noise, repeatable."""

import numpy as np
import pytest
from analytic_room import smooth_noise

from roomlight.conventions import linear_to_srgb8, srgb8_to_linear
from roomlight_generator.sequences.sensor import BASE_MULTIPLIER, Sensor, clipped_radiance, develop

CLEAN = Sensor(noise=0.0)
NEUTRAL = np.ones(3)


def picture(radiance, sensor=CLEAN, seed=0, multiplier=1.0, gains=NEUTRAL):
    return develop(radiance, sensor, np.random.default_rng(seed), multiplier=multiplier, gains=gains)


def flat(value: float, shape=(120, 160)) -> np.ndarray:
    return np.full((*shape, 3), value, np.float32)


def test_a_clean_sensor_is_exactly_srgb():
    for value in (0.0, 0.002, 0.1, 0.5, 1.0):
        np.testing.assert_array_equal(picture(flat(value)), linear_to_srgb8(flat(value)))


def test_linearised_colour_is_radiance_by_gains_and_multiplier():
    radiance = (smooth_noise(np.random.default_rng(1), 120, 160) * 0.02 + 0.002).astype(np.float32)
    gains = np.array([1.3, 1.0, 0.7])
    shown = srgb8_to_linear(picture(radiance, multiplier=20.0, gains=gains))
    assert np.abs(shown - radiance * gains * 20).max() < 0.012  # half a step at white is 0.0045; the rest is the blur


def test_clipped_pixels_keep_their_radiance_in_units_of_white():
    radiance = flat(0.02)
    radiance[20:40, 30:60] = (3.0, 0.5, 0.01)
    radiance[80:90, :10] = 1e6
    gains = np.array([1.5, 1.0, 0.8])
    shown = picture(radiance, multiplier=10.0, gains=gains)
    clipped = clipped_radiance(radiance, shown, multiplier=10.0, gains=gains)
    np.testing.assert_allclose(clipped[30, 45], (45.0, 5.0, 0.08), rtol=1e-3)
    np.testing.assert_allclose(clipped[85, 5], np.array([1.0, 1 / 1.5, 0.8 / 1.5]) * 65504, rtol=1e-3)  # hue kept
    np.testing.assert_array_equal((clipped > 0).any(axis=2), (shown >= 250).any(axis=2))
    assert not clipped[60:75].any()


def test_noise_grows_with_gain_and_leaves_the_mean():
    deviations = []
    for multiplier in (BASE_MULTIPLIER, 60.0, 600.0):
        shown = srgb8_to_linear(picture(flat(0.3 / multiplier), Sensor(), multiplier=multiplier))
        deviations.append(shown.std())
        assert shown.mean() == pytest.approx(0.3, rel=0.01)
    assert deviations[0] < deviations[1] < deviations[2]
    assert deviations[0] < 0.004
    assert 0.01 < deviations[2] < 0.06


def test_corners_lose_light_as_stated():
    shown = srgb8_to_linear(picture(flat(0.5), Sensor(noise=0.0, vignetting=0.1)))
    assert shown[60, 80].mean() == pytest.approx(0.5, abs=0.005)
    assert shown[0, 0].mean() == pytest.approx(0.45, abs=0.008)


def test_sharpening_leaves_plain_areas_and_lifts_edges():
    step = flat(0.2)
    step[:, 80:] = 0.5
    shown = srgb8_to_linear(picture(step, Sensor(noise=0.0, sharpening=0.5)))
    assert shown[:, :60].mean() == pytest.approx(0.2, abs=0.004)
    assert shown[60, 79:86].max() > 0.51


def test_other_responses_stay_near_srgb_with_black_and_white():
    for gamma in (0.95, 1.05):
        for contrast in (-0.06, 0.06):
            own = Sensor(noise=0.0, response=(gamma, contrast))
            for value in np.linspace(0, 1, 30):
                shown = picture(flat(float(value), (8, 8)), own)[0, 0, 0]
                plain = linear_to_srgb8(np.array([value]))[0]
                assert abs(int(shown) - int(plain)) <= 10
            assert (picture(flat(0.0), own) == 0).all()
            assert (picture(flat(1.0), own) == 255).all()
