"""Simulated phone depth: its errors have the stated size and are in the stated places."""

from dataclasses import replace

import numpy as np
import pytest
from analytic_room import smooth_noise

from roomlight.dataset.arkit_depth import HEIGHT, LASER_M, WIDTH, DepthSensor, arkit_like
from roomlight.dataset.recording import GLASS, MIRROR, ORDINARY

CLEAN = DepthSensor(noise=0.0, grain=0.0, jitter=0.0, bleed=0.0, softness_px=0.1, far_slope=1.0, relief=0.0)
H, W = 240, 320


def measured(depth_m, sensor, *, surface=None, colour=None, seed=0):
    """Simulate frames given in metres; returns depth in metres."""
    depth_mm = np.rint(np.asarray(depth_m) * 1000).astype(np.uint16)
    kind = np.full(depth_mm.shape, ORDINARY, np.uint8) if surface is None else surface
    grey = np.full((*depth_mm.shape, 3), 128, np.uint8) if colour is None else colour
    return arkit_like(depth_mm, kind, grey, np.random.default_rng(seed), sensor=sensor) / 1000


def flat(metres: float, frames=1) -> np.ndarray:
    return np.full((frames, H, W), metres)


def step(near_m=2.0, far_m=4.0) -> np.ndarray:
    frames = flat(far_m)
    frames[..., : W // 2] = near_m
    return frames


def square(kind: int) -> np.ndarray:
    surface = np.zeros((1, H, W), np.uint8)
    surface[:, 80:160, 100:220] = kind
    return surface


MIDDLE = np.s_[0, 80:112, 100:150]


def test_a_faultless_sensor_resamples():
    depth = measured(flat(2.5), CLEAN)
    assert depth.shape == (1, HEIGHT, WIDTH)
    np.testing.assert_allclose(depth, 2.5, atol=0.001)


def test_depth_of_upright_frames_is_upright():
    level, upright = measured(step(), CLEAN), measured(step().transpose(0, 2, 1), CLEAN)
    np.testing.assert_allclose(upright, level.transpose(0, 2, 1), atol=0.01)


def test_flicker_grows_with_distance_as_measured():
    # relative deviation of simulated phone depth: 0.7 % below 4 m, 0.9 % at 5.5 m, 2.3 % at 10 m
    sensor = replace(CLEAN, noise=0.007)
    for metres, low, high in ((2.0, 0.006, 0.0082), (5.5, 0.0085, 0.012), (10.0, 0.019, 0.029)):
        depth = measured(flat(metres, 40), sensor)
        assert low < (depth / metres).std() < high
        assert abs((depth / metres).mean() - 1) < 0.004


def test_flicker_is_smooth_in_space_and_lasts_in_time():
    depth = measured(flat(3.0, 60), replace(CLEAN, noise=0.007, persistence=0.7))
    error = depth / 3 - 1

    def alike(one, other):
        return float((one * other).mean() / error.var())

    assert alike(error[:, :, 2:], error[:, :, :-2]) > 0.95
    assert 0.3 < alike(error[:, :, 16:], error[:, :, :-16]) < 0.85
    assert 0.55 < alike(error[1:], error[:-1]) < 0.85
    assert alike(error[4:], error[:-4]) < 0.5


def test_grain_and_scale_are_as_stated():
    depth = measured(flat(3.0), replace(CLEAN, grain=0.004, scale=0.02))
    assert depth.mean() == pytest.approx(3.06, rel=0.001)
    assert depth.std() / 3.06 == pytest.approx(0.004, rel=0.1)


def test_edges_bleed():
    row = measured(step(), replace(CLEAN, bleed=1.0, bleed_px=4))[0, 100]
    between = (row > 2.05) & (row < 3.9)
    assert 3 <= between.sum() <= 24
    np.testing.assert_allclose(row[:100], 2, atol=0.01)
    np.testing.assert_allclose(row[-100:], 4, atol=0.02)


def test_edges_follow_colour():
    colour = np.full((1, H, W, 3), 40, np.uint8)
    colour[..., W // 2 :, :] = 220
    sensor = replace(CLEAN, bleed=1.0, bleed_px=4)
    led, blind = (measured(step(), sensor, colour=seen)[0, 100] for seen in (colour, None))
    wrong = [np.abs(row - np.where(np.arange(WIDTH) < WIDTH // 2, 2, 4)).sum() for row in (led, blind)]
    assert wrong[0] < 0.5 * wrong[1]


def test_thin_objects_vanish():
    frames = flat(4.0)
    frames[..., 160:163] = 2.0
    assert measured(frames, CLEAN).min() < 2.5
    assert measured(frames, replace(CLEAN, thin_px=5)).min() > 3.9


def test_past_the_laser_distances_are_guesses():
    depth = measured(flat(9.0), replace(CLEAN, far_slope=0.5))
    assert depth.mean() == pytest.approx(LASER_M + 2, abs=0.01)


@pytest.mark.parametrize(("how", "low", "high"), [("pane", 2.9, 3.1), ("guess", 2.5, 3.5), ("far", 4.5, 5.1)])
def test_glass_is_a_pane_a_guess_or_seen_through(how, low, high):
    depth = measured(flat(3.0), replace(CLEAN, glass=how), surface=square(GLASS))
    assert low < depth[MIDDLE].min() <= depth[MIDDLE].max() < high
    assert depth[0, 10, 10] == pytest.approx(3, abs=0.01)


def test_glass_may_be_left_out():
    depth = measured(flat(3.0), replace(CLEAN, glass="hole"), surface=square(GLASS))
    assert (depth[MIDDLE] == 0).all()
    assert (depth > 0).mean() > 0.8


def test_mirrors_are_read_through_or_uneven():
    through = measured(flat(2.0), CLEAN, surface=square(MIRROR))
    np.testing.assert_allclose(through[MIDDLE], 2 * CLEAN.through, rtol=0.01)
    uneven = measured(flat(2.0), replace(CLEAN, mirror="plane", relief=0.15), surface=square(MIRROR))
    assert uneven[MIDDLE].std() > 0.02


@pytest.mark.parametrize(("how", "low", "high"), [("guess", 2.4, 3.6), ("far", 6.5, 7.5), ("hole", -1.0, 0.5)])
def test_sky_is_a_guess_far_or_nothing(how, low, high):
    frames = flat(3.0)
    frames[:, 80:160, 100:220] = 0
    depth = measured(frames, replace(CLEAN, sky=how))
    assert low < depth[MIDDLE].min() <= depth[MIDDLE].max() < high


def test_any_sensor_gives_sound_depth_repeatably():
    rng = np.random.default_rng(1)
    frames = np.stack([smooth_noise(rng, H, W)[..., 0] * 8 + 0.3 for _ in range(2)])
    frames[:, :40, :60] = 0
    surface = np.concatenate([square(GLASS), square(MIRROR)])
    colour = np.stack([(smooth_noise(rng, H, W) * 255).astype(np.uint8) for _ in range(2)])
    depth_mm = (frames * 1000).astype(np.uint16)
    for seed in range(12):
        once, again = (arkit_like(depth_mm, surface, colour, np.random.default_rng(seed)) for _ in range(2))
        np.testing.assert_array_equal(once, again)
        assert once.shape == (2, HEIGHT, WIDTH)
        assert once.max() <= 14_000


def test_drawn_sensors_differ():
    sensors = [DepthSensor.draw(np.random.default_rng(seed)) for seed in range(200)]
    assert {sensor.sky for sensor in sensors} == {"guess", "far", "hole"}
    assert {sensor.glass for sensor in sensors} == {"pane", "guess", "far", "hole"}
    assert {sensor.mirror for sensor in sensors} == {"plane", "far"}
    assert 0.003 < np.median([sensor.noise for sensor in sensors]) < 0.012
