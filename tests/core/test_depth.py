"""Depth completion: known pixels stay, planes stay planes, a map without depth stays so."""

import numpy as np
import pytest

from roomlight.depth import clean_depth, complete_depth
from rooms import BoxRoom, camera_at, pinhole


def _plane(width=160, height=120, normal=(0.3, 0.2, 1.0), distance=2.5):
    rays = pinhole(width, height).rays()
    return (distance / (rays @ -np.array(normal, np.float32))).astype(np.float32)


@pytest.fixture
def holed():
    depth = BoxRoom().frame(camera_at((0, 1.5, 0), 20)).depth_m.copy()
    depth[np.random.default_rng(0).random(depth.shape) < 0.3] = 0
    depth[40:70, 30:80] = 0
    return depth


def test_clean_depth_knows_only_positive_finite_numbers():
    assert clean_depth(np.array([[np.nan, np.inf, -1.0, 0.0, 3.0, 1e300]])).tolist() == [[0, 0, 0, 0, 3.0, 0]]


def test_known_pixels_keep_their_bits_and_all_are_filled_between_them(holed):
    filled = complete_depth(holed)
    known = holed > 0
    assert (filled[known] == holed[known]).all()
    assert np.isfinite(filled).all()
    assert filled.min() >= holed[known].min() * (1 - 1e-5)
    assert filled.max() <= holed.max() * (1 + 1e-5)


@pytest.mark.parametrize(
    "normal",
    [
        (0.3, 0.2, 1.0),
        pytest.param((0, 0, 1.0), marks=pytest.mark.slow),
        pytest.param((0.2, 0.0, 1.0), marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("hole", [np.s_[50:60, 70:80], np.s_[40:70, 60:100], np.s_[37:38, 20:120]])
def test_a_hole_in_a_plane_is_filled_with_the_plane(normal, hole):
    plane = _plane(normal=normal)
    depth = plane.copy()
    depth[hole] = 0
    assert complete_depth(depth) == pytest.approx(plane, rel=0.01)


@pytest.mark.parametrize("shape", [(2, 2), (3, 5), (61, 83), (192, 256)])
def test_any_size_is_completed_from_one_known_pixel(shape):
    depth = np.zeros(shape, np.float32)
    depth[1, 1] = 3.0
    assert complete_depth(depth) == pytest.approx(np.full(shape, 3.0), rel=1e-5)


@pytest.mark.parametrize("value", [0.0, 2.0])
def test_all_unknown_and_all_known_maps_are_unchanged(value):
    depth = np.full((30, 40), value, np.float32)
    assert complete_depth(depth) is depth
