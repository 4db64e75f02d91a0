from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roomlight.metrics import (
    METRICS,
    SphereScorer,
    angular_error_deg,
    energy_ratio,
    interval_means,
    intervals,
    ldr_l2,
    log_l2,
    si_rmse,
)
from roomlight.spheres import SphereRenderer


def panorama(seed: int = 0, height: int = 16) -> np.ndarray:
    return np.random.default_rng(seed).exponential(1.0, (height, 2 * height, 3)).astype(np.float32)


@pytest.mark.parametrize("metric", [log_l2, ldr_l2])
def test_zero_for_equal_positive_otherwise_and_symmetric(metric: Callable[..., float]) -> None:
    first, second = panorama(1), panorama(2)
    assert metric(first, first) == 0
    assert metric(first, second) > 0
    assert metric(first, second) == metric(second, first)


def test_log_l2_is_the_papers_formula_as_a_mean() -> None:
    prediction, truth = np.full((4, 8, 3), np.float32(np.e - 1)), np.zeros((4, 8, 3), np.float32)
    assert log_l2(prediction, truth) == pytest.approx(1.0, rel=1e-6)
    truth[..., 1] = np.e - 1
    assert log_l2(prediction, truth) == pytest.approx(2 / 3, rel=1e-6)
    assert log_l2(np.full((4, 8, 3), np.float32(-5)), np.zeros((4, 8, 3), np.float32)) == 0  # below zero is none


def test_ldr_error_ignores_light_above_white() -> None:
    white = np.ones((4, 8, 3), np.float32)
    assert ldr_l2(50 * white, white) == 0
    assert ldr_l2(0.5 * white, 50 * white) == pytest.approx(0.25)


@settings(max_examples=30, deadline=None)
@given(scale=st.floats(1e-3, 1e3), seed=st.integers(0, 100))
def test_si_rmse_ignores_scale(scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    prediction, truth = rng.random((50, 3)), rng.random((50, 3))
    assert si_rmse(scale * prediction, truth) == pytest.approx(si_rmse(prediction, truth), rel=1e-6)
    assert si_rmse(scale * truth, truth) == pytest.approx(0, abs=1e-9)


def test_si_rmse_takes_the_best_factor() -> None:
    rng = np.random.default_rng(0)
    prediction, truth = rng.random((50, 3)), rng.random((50, 3))
    factors = np.linspace(0, 3, 3001)
    best = min(np.sqrt(np.mean((factor * prediction - truth) ** 2)) for factor in factors)
    assert si_rmse(prediction, truth) == pytest.approx(best, rel=1e-4)
    assert si_rmse(np.zeros((50, 3)), truth) == pytest.approx(np.sqrt(np.mean(truth**2)))


def test_angular_error_of_known_angles() -> None:
    red, green = np.tile([1.0, 0.0, 0.0], (10, 1)), np.tile([0.0, 1.0, 0.0], (10, 1))
    assert angular_error_deg(red, red) == 0
    assert angular_error_deg(red, green) == pytest.approx(90)
    assert angular_error_deg(red, 0.1 * (red + green)) == pytest.approx(45)
    black = np.zeros((10, 3))
    assert angular_error_deg(black, black) == 0
    assert angular_error_deg(black, red) == angular_error_deg(red, black) == 90


def test_sphere_scores_are_zero_for_the_truth_and_detect_errors() -> None:
    truth = panorama(3, 32)
    judge = SphereScorer(truth, SphereRenderer((0.0, 0.0, -1.0), size=24))
    assert judge.scores(truth) == pytest.approx(dict.fromkeys(judge.scores(truth), 0), abs=1e-5)
    brighter = judge.scores(2 * truth)
    assert brighter.pop("render_l2") > 0.001  # this metric depends on the scale, the others do not
    assert brighter == pytest.approx(dict.fromkeys(brighter, 0), abs=1e-4)
    other = judge.scores(panorama(4, 32))
    assert all(value > 0 for value in other.values())
    # the sharper the sphere, the more detail counts
    assert other["si_rmse_mirror"] > other["si_rmse_matte"] > other["si_rmse_diffuse"]


def test_every_metric_has_a_column() -> None:
    judge = SphereScorer(panorama(height=8), SphereRenderer((0.0, 0.0, -1.0), size=8))
    measured = {"log_l2", "ldr_l2", "smoothness", "energy", *judge.scores(panorama(height=8))}
    assert {metric.key for metric in METRICS} == measured


def test_intervals_of_31_frames_are_the_papers() -> None:
    numbered = [(part[0] + 1, part[-1] + 1) for part in intervals(31)]
    assert numbered == [(1, 7), (8, 13), (14, 19), (20, 25), (26, 31)]  # that they have no gaps is asserted below


@given(frames=st.integers(0, 1000))
def test_intervals_cover_every_frame_once_in_order(frames: int) -> None:
    assert [position for part in intervals(frames) for position in part] == list(range(frames))
    assert len(intervals(frames)) == 5


def test_interval_means() -> None:
    values = np.arange(31, dtype=np.float64)
    np.testing.assert_allclose(interval_means(values, 31), [3, 9.5, 15.5, 21.5, 27.5])
    # smoothness has one value fewer: its last interval is [26,30]
    np.testing.assert_allclose(interval_means(values[:30], 31), [3, 9.5, 15.5, 21.5, 27])
    assert np.isnan(interval_means(values[:2], 2)).any()
    with pytest.raises(ValueError, match="do not belong"):
        interval_means(values, 20)
    with pytest.raises(ValueError, match="0 frames or more"):
        intervals(-1)


def test_energy_is_a_ratio_to_the_truths_weighted_by_solid_angle() -> None:
    truth = panorama(3)
    assert energy_ratio(truth, truth) == pytest.approx(1)
    assert energy_ratio(2.5 * truth, truth) == pytest.approx(2.5)
    assert energy_ratio(np.zeros_like(truth), truth) == 0
    assert np.isnan(energy_ratio(truth, np.zeros_like(truth)))
    polar = np.zeros_like(truth)
    polar[0] = 1
    assert energy_ratio(polar, np.ones_like(truth)) == pytest.approx((1 - np.cos(np.pi / 16)) / 2, rel=1e-5)
    truth = np.full((16, 32, 3), np.float32(1e-3))
    truth[8, 5] = 1e9
    assert energy_ratio(truth, truth) == pytest.approx(1, rel=1e-9)  # sums without loss
