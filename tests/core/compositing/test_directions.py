"""Directions in the kernels against the conventions."""

import numpy as np
import pytest

from roomlight.compositing.kernels.environment import angle, place_of
from roomlight.conventions import direction_to_uv

AXES = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]


def test_panoramas_are_read_where_the_conventions_say() -> None:
    directions = np.random.default_rng(0).normal(size=(2000, 3))
    directions = np.concatenate([directions / np.linalg.norm(directions, axis=1, keepdims=True), AXES])
    places = np.array([place_of(*direction) for direction in directions.tolist()])
    off = (places - direction_to_uv(directions) + 0.5) % 1 - 0.5  # u wraps around
    assert np.abs(off).max() < 1e-8


@pytest.mark.parametrize("y", [-1.0, -0.3, 0.0, 0.3, 1.0])
def test_angle_is_the_library_function_in_all_quadrants(y: float) -> None:
    for x in np.linspace(-1, 1, 41).tolist():
        assert angle(y, x) == pytest.approx(np.arctan2(y, x), abs=2e-8)
