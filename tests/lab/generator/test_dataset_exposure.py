"""The phone's auto exposure and white balance."""

from dataclasses import replace

import numpy as np
import pytest
from analytic_room import smooth_noise

from roomlight.conventions import LUMINANCE
from roomlight_generator.rooms.colour import blackbody_rgb
from roomlight_generator.sequences.exposure import Exposure, MeterSettings, expose, meter, settle, white_balance

PLAIN = replace(
    MeterSettings.draw(np.random.default_rng(0)),
    bias=0.0,
    highlights=0.5,
    settle_s=0.6,
    locked=False,
    first_error=0.0,
    max_multiplier=900.0,
    balance=0.75,
)


def grey(value: float, shape=(30, 40)) -> np.ndarray:
    return np.full((*shape, 3), value, np.float32)


def test_the_80th_percentile_has_the_same_brightness():
    rng = np.random.default_rng(4)
    for _ in range(10):
        frame = 0.02 + 0.1 * smooth_noise(rng, 30, 40)
        shown = frame * 2 ** meter(frame, PLAIN)
        assert np.percentile(shown @ LUMINANCE, 80) == pytest.approx(0.43, rel=0.02)


def test_a_bright_window_pulls_the_exposure_down_but_still_clips():
    frame = grey(0.05)
    frame[:15, :10] = 20.0
    without, with_highlights = (meter(frame, replace(PLAIN, highlights=share)) for share in (0.0, 0.5))
    assert with_highlights < without - 1
    assert 2**with_highlights * 20 > 1


def test_phones_show_frames_like_real_ones():
    """Over phones: 80th percentiles of 0.3 to 0.6 of white, in the median that of real frames."""
    frames = np.stack([grey(0.1)] * 2)
    shown = [0.1 * expose(frames, np.random.default_rng(seed)).multiplier[0] for seed in range(200)]
    assert 0.41 < np.median(shown) < 0.48
    assert np.mean((np.array(shown) > 0.3) & (np.array(shown) < 0.65)) > 0.9


def test_the_multiplier_is_limited():
    assert 2 ** meter(grey(1e-6), PLAIN) == pytest.approx(900)
    assert 2 ** meter(grey(0.0), PLAIN) == pytest.approx(900)


def test_exposure_follows_slowly_and_without_overshoot():
    wanted = np.r_[np.zeros(5), np.full(25, -3.0)]
    stops = settle(wanted, PLAIN)
    assert (stops[:5] == 0).all()
    assert -2.0 < stops[5] < -0.5
    assert (np.diff(stops) <= 0).all()
    assert stops[-1] == pytest.approx(-3, abs=0.2)


def test_small_changes_and_a_lock_keep_the_exposure():
    assert np.ptp(settle(np.linspace(0, 0.1, 31), PLAIN)) == 0
    assert np.ptp(settle(np.linspace(0, 3, 31), replace(PLAIN, locked=True))) == 0


@pytest.mark.parametrize("kelvin", [2700, 3500, 5000, 8000])
def test_white_balance_goes_most_of_the_way_to_neutral(kelvin):
    light = np.array(blackbody_rgb(kelvin))
    seen = np.log(light[[0, 2]] / light[1])
    shown = light * white_balance((grey(0.1) * light).astype(np.float32), PLAIN)
    left = np.log(shown[[0, 2]] / shown[1])
    assert np.linalg.norm(left) < 0.5 * np.linalg.norm(seen)
    assert left @ seen >= 0
    assert shown @ LUMINANCE == pytest.approx(1, abs=0.05)


def test_a_green_wall_stays_green():
    wall = np.array([0.2, 0.5, 0.2])
    shown = wall * white_balance((grey(0.1) * wall).astype(np.float32), PLAIN)
    assert shown[1] / shown[0] > 1.6
    assert shown[1] / shown[2] > 1.6


def test_panoramas_are_in_the_first_frames_units():
    made = Exposure(multiplier=np.array([3.0, 6.0]), gains=np.array([1.2, 1.0, 0.5]))
    radiance = np.random.default_rng(2).random((4, 8, 3)).astype(np.float32)
    panorama = made.panorama(radiance)
    assert panorama.dtype == np.float32
    np.testing.assert_allclose(panorama, radiance * [3.6, 3.0, 1.5], rtol=1e-6)
    # what the second frame shows, brought back by its relative exposure, is the panorama's value
    np.testing.assert_allclose(radiance * made.gains * made.multiplier[1] / made.relative[1], panorama, rtol=1e-6)
