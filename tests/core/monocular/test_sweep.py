"""Depth by other views: the kernels against their readable twins, and what a sweep finds in a room known exactly."""

import numpy as np
import pytest

from box_room import LENS, exact_depth, frame, pose
from roomlight.monocular.estimate import srgb_picture
from roomlight.monocular.kernels.reference import (
    aggregate_reference,
    census_reference,
    decide_reference,
    sweep_reference,
)
from roomlight.monocular.kernels.sweep import REACH, aggregate_lines, census_rows, decide_rows, sweep_rows
from roomlight.monocular.sweep import refined
from roomlight.monocular.tracks import View, grey_picture

RANDOM = np.random.default_rng(0)


def _census(grey: np.ndarray) -> np.ndarray:
    signs = np.empty((2, *grey.shape), np.uint32)
    census_rows(np.pad(grey, REACH, mode="edge"), 3, signs[0], signs[1], 0, len(grey))
    return signs


def test_the_census_is_that_of_its_reference() -> None:
    grey = RANDOM.integers(100, 112, (17, 23), dtype=np.uint8)
    np.testing.assert_array_equal(_census(grey), census_reference(grey, 3))


@pytest.mark.parametrize("views", [1, 2, 3, 4])
def test_costs_are_those_of_their_reference(views: int) -> None:
    """Some depths lie outside of some pictures or behind their cameras."""
    pictures = RANDOM.integers(0, 256, (views + 1, 30, 40), dtype=np.uint8)
    own, *others = map(_census, pictures)
    projections = np.tile(np.eye(3, 4, dtype=np.float32), (views, 1, 1))
    projections[:, :, 3] = RANDOM.uniform(-9, 9, (views, 3)) * (1, 1, 0.1)
    inverses = (np.linspace(0.2, 1.6, 16) ** 2).astype(np.float32)
    guess = RANDOM.uniform(0.1, 2, (15, 20)).astype(np.float32)
    costs, contrast = np.empty((15, 20, 16), np.float32), np.empty((15, 20), np.float32)
    sweep_rows(own, np.stack(others), projections, inverses, guess, 0.05, 2, costs, contrast, 0, 15)
    expected, spans = sweep_reference(own, np.stack(others), projections, inverses, guess, 0.05, 2)
    off = np.abs(costs - expected) > 1e-5  # single precision puts a point beside a pixel's edge on its other side
    assert off.mean() < 0.002
    assert (np.abs(contrast - spans) > 1e-5).mean() < 0.02


@pytest.mark.parametrize(("dy", "dx"), [(0, 1), (0, -1), (1, 0), (-1, 0)])
def test_paths_are_those_of_their_reference(dy: int, dx: int) -> None:
    costs = RANDOM.uniform(0, 0.6, (7, 9, 8)).astype(np.float32)
    grey = RANDOM.integers(0, 256, (7, 9), dtype=np.uint8)
    penalties = np.array([0.1, 0.8, 10], np.float32)
    sums = np.zeros_like(costs)
    aggregate_lines(costs, grey, penalties, dy, dx, sums, 0, 7 if dy == 0 else 9)
    np.testing.assert_allclose(sums, aggregate_reference(costs, grey, penalties, dy, dx), atol=1e-5)


def test_depths_are_those_of_their_reference() -> None:
    sums = RANDOM.uniform(0, 3, (6, 5, 12)).astype(np.float32)
    tones = np.linspace(-2, 1, 12).astype(np.float32)
    tone, spread = np.empty((6, 5), np.float32), np.empty((6, 5), np.float32)
    decide_rows(sums, tones, 0.4, tone, spread, 0, 6)
    expected, deviation = decide_reference(sums, tones, 0.4)
    np.testing.assert_allclose(tone, expected, atol=1e-5)
    np.testing.assert_allclose(spread, deviation, atol=1e-3)


def _view(number: int, at: np.ndarray) -> View:
    return View(grey_picture(srgb_picture(frame(number, at))), LENS, at, np.zeros((0, 0)))


def test_other_views_mend_a_guess_that_is_flat() -> None:
    """The guess knows only how far the room is in the middle; three views from beside give its walls."""
    poses = [pose(0.12 * k, turn=0.02 * k) for k in range(4)]
    views, true_m = [_view(k, at) for k, at in enumerate(poses)], exact_depth(poses[3])
    guess = np.full(true_m.shape, 1 / np.median(true_m), np.float32)
    depth = 1 / refined(views[3], views[:3], guess, srgb_picture(frame(3, poses[3])))
    errors, before = np.abs(depth / true_m - 1), np.abs(1 / guess / true_m - 1)
    assert np.median(errors) < 0.25 * np.median(before)


def test_a_bare_room_stays_as_guessed() -> None:
    """Pictures of one grey match at all depths."""
    grey = np.full((LENS.height, LENS.width), 128, np.uint8)
    views = [View(grey, LENS, pose(0.12 * k), np.zeros((0, 0))) for k in range(3)]
    guess = np.full(grey.shape, 0.4, np.float32)
    np.testing.assert_allclose(refined(views[2], views[:2], guess, np.full((*grey.shape, 3), 0.5, np.float32)), guess)


def test_views_of_other_sizes_are_left_out() -> None:
    guess = np.full((LENS.height, LENS.width), 0.4, np.float32)
    view, small = _view(0, pose(0)), View(np.zeros((30, 40), np.uint8), LENS, pose(0.2), np.zeros((0, 0)))
    assert refined(view, [small], guess, np.zeros((*guess.shape, 3), np.float32)) is guess
