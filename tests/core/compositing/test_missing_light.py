"""Light that a panorama lacks: found by the surface below, added from above, and nothing where nothing lacks."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from roomlight.compositing.missing_light import ALBEDO, MOST, TRUST, with_missing_light
from roomlight.conventions import LUMINANCE, panorama_directions, panorama_solid_angles

ROWS = 32
DIRECTIONS = panorama_directions(ROWS)
SEEN = np.ones((ROWS, 2 * ROWS), np.float32)


def from_above(panorama: np.ndarray) -> float:
    weight = panorama_solid_angles(ROWS) * np.maximum(DIRECTIONS[..., 1], 0)
    return float(np.einsum("hwc,hw->c", panorama, np.broadcast_to(weight, DIRECTIONS.shape[:2])) @ LUMINANCE)


def room(ground: float, sky: float = 1 / np.pi) -> np.ndarray:
    """Return a panorama of two even halves; the irradiance from above is pi x sky."""
    value = np.where(DIRECTIONS[..., 1] < 0, ground, sky)
    return np.repeat(value[..., None], 3, axis=2).astype(np.float32)


def lamp_at(panorama: np.ndarray, direction: tuple[float, float, float], radiance: float) -> np.ndarray:
    inside = DIRECTIONS @ (np.array(direction) / np.linalg.norm(direction)) > np.cos(np.radians(8))
    return np.where(inside[..., None], np.float32(radiance), panorama).astype(np.float32)


def test_surface_that_the_light_explains_changes_nothing() -> None:
    for albedo in (0.05, 0.9 * ALBEDO):
        panorama = room(ground=albedo / np.pi)
        assert_array_equal(with_missing_light(panorama, SEEN), panorama)


def test_bright_surface_raises_the_light_from_above() -> None:
    panorama = room(ground=4 * ALBEDO / np.pi)
    found = with_missing_light(panorama, SEEN)
    assert_allclose(from_above(found) / from_above(panorama), 4**TRUST, rtol=0.05)
    assert (found >= panorama).all()
    assert_array_equal(found[DIRECTIONS[..., 1] < -0.3], panorama[DIRECTIONS[..., 1] < -0.3])


def test_missing_light_is_bounded() -> None:
    panorama = room(ground=1000.0)
    assert_allclose(from_above(with_missing_light(panorama, SEEN)) / from_above(panorama), MOST, rtol=0.05)


def test_missing_light_comes_from_where_no_frame_looked() -> None:
    observed = np.where(DIRECTIONS[..., 0] > 0, SEEN, np.float32(0))
    observed[DIRECTIONS[..., 1] < 0] = 1
    panorama = room(ground=4 * ALBEDO / np.pi)
    added = (with_missing_light(panorama, observed) - panorama) @ LUMINANCE
    assert added[DIRECTIONS[..., 1] < 0].max() == 0
    for row in np.flatnonzero(DIRECTIONS[:, 0, 1] > 0.1):
        unseen = observed[row] == 0
        assert_allclose(added[row, ~unseen], 0.1 * added[row, unseen].mean(), rtol=1e-3)
        assert (added[row, ~unseen] > 0).all()


def test_missing_light_makes_no_lamp() -> None:
    observed = SEEN.copy()
    observed[3:5, 7:9] = 0
    panorama = room(ground=4 * ALBEDO / np.pi)
    added = (with_missing_light(panorama, observed) - panorama) @ LUMINANCE
    assert added.max() < 20 * np.median(added[DIRECTIONS[..., 1] > 0.2])


def test_surface_that_no_frame_saw_says_nothing() -> None:
    panorama = room(ground=4 * ALBEDO / np.pi)
    assert_array_equal(with_missing_light(panorama, np.zeros_like(SEEN)), panorama)


def test_missing_light_follows_the_exposure() -> None:
    panorama = lamp_at(room(ground=4 * ALBEDO / np.pi), (0.2, 0.9, 0.1), 3.0)
    assert_allclose(with_missing_light(3 * panorama, SEEN), 3 * with_missing_light(panorama, SEEN), rtol=1e-3)


def test_black_panorama_stays_black() -> None:
    assert not with_missing_light(np.zeros((ROWS, 2 * ROWS, 3), np.float32), SEEN).any()
