"""Radiance of clipped pixels, by the surface that they show."""

from dataclasses import replace

import numpy as np
import pytest

from roomlight.depth import complete_depth
from roomlight.engine.clipping import BRIGHT_GAIN, GLARE_GAIN, WINDOW_GAIN, restore_clipped
from rooms import BoxRoom, camera_at


@pytest.fixture
def frame():
    """Looks down at 35 degrees: floor below, wall above."""
    return BoxRoom().frame(camera_at((0.0, 1.4, 1.5), pitch_degrees=-35))


def gains(frame, clipped):
    marked = replace(frame, clipped=clipped)
    return restore_clipped(marked, complete_depth(frame.depth_m)).image / np.maximum(frame.image, 1e-6)


def test_unclipped_pixels_keep_their_bits(frame):
    result = restore_clipped(frame, frame.depth_m)
    assert (result.image == frame.image).all()


def test_glare_on_the_floor_is_reduced_and_a_bright_wall_raised(frame):
    every = np.ones(frame.clipped.shape, bool)
    gain = gains(frame, every)
    assert gain[-10, 80] == pytest.approx([GLARE_GAIN] * 3, rel=1e-4)
    assert gain[10, 80] == pytest.approx([BRIGHT_GAIN] * 3, rel=1e-4)


def test_clipped_without_depth_is_a_window_whatever_lies_behind(frame):
    depth = frame.depth_m.copy()
    depth[5:20, 60:100] = 0
    depth[-20:-5, 60:100] = 0
    every = np.ones(frame.clipped.shape, bool)
    gain = gains(replace(frame, depth_m=depth), every)
    assert gain[12, 80] == pytest.approx([WINDOW_GAIN] * 3, rel=1e-4)
    assert gain[-12, 80] == pytest.approx([WINDOW_GAIN] * 3, rel=1e-4)


def test_low_resolution_depth_serves_too(frame):
    small = BoxRoom().frame(camera_at((0.0, 1.4, 1.5), pitch_degrees=-35), depth_size=(64, 48))
    gain = gains(small, np.ones(frame.clipped.shape, bool))
    assert gain[-10, 80] == pytest.approx([GLARE_GAIN] * 3, rel=1e-4)
    assert gain[10, 80] == pytest.approx([BRIGHT_GAIN] * 3, rel=1e-4)


def test_the_completed_depth_comes_along(frame):
    completed = np.full_like(frame.depth_m, 2.0)
    assert (restore_clipped(frame, completed).depth_m == 2.0).all()
