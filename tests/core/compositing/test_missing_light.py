"""The light of objects: completed where no frame looked, clipped light in full, and what the surface below needs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from roomlight.compositing.missing_light import (
    ALBEDO,
    CLIPPED_GAIN,
    MOST,
    TRUST,
    UNSEEN_GAIN,
    completed_light,
    object_light,
    with_clipped_energy,
    with_missing_light,
)
from roomlight.conventions import LUMINANCE, panorama_directions, panorama_solid_angles
from roomlight.engine.session import Session, SessionOptions
from rooms import BoxRoom, camera_at

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
    for ground in (0.1, 4.0):
        panorama = room(ground=ground * ALBEDO / np.pi)
        found = with_missing_light(panorama, np.zeros_like(SEEN))
        assert_allclose(from_above(found) / from_above(panorama), np.exp(UNSEEN_GAIN), rtol=0.01)


def test_light_from_above_grows_by_the_share_that_no_frame_showed() -> None:
    panorama = room(ground=ALBEDO / np.pi)
    assert_array_equal(with_missing_light(panorama, SEEN), panorama)
    half = np.where((DIRECTIONS[..., 0] > 0) & (DIRECTIONS[..., 1] > 0), np.float32(0), SEEN)
    found = with_missing_light(panorama, half)
    assert_allclose(from_above(found) / from_above(panorama), np.exp(UNSEEN_GAIN / 2), rtol=0.01)


def test_a_dark_surface_below_says_that_less_is_missing() -> None:
    observed = np.where(DIRECTIONS[..., 1] < 0, SEEN, np.float32(0))
    dark, bright = (
        from_above(with_missing_light(room(ground=ground * ALBEDO / np.pi), observed)) for ground in (0.8, 1.25)
    )
    assert_allclose(bright / dark, (1.25 / 0.8) ** TRUST, rtol=0.01)
    black = room(ground=0.01 * ALBEDO / np.pi)
    assert_array_equal(with_missing_light(black, observed), black)


def test_clipped_light_counts_in_full() -> None:
    panorama = np.full((ROWS, 2 * ROWS, 3), 4.0, np.float32)
    guessed = np.zeros((ROWS, 2 * ROWS), np.float32)
    guessed[3, 5], guessed[4, 5] = 4.0, 2.0  # all of the light is an estimate, and half of it
    found = with_clipped_energy(panorama, guessed)
    assert_allclose(found[3, 5], 4 * CLIPPED_GAIN)
    assert_allclose(found[4, 5], 2 + 2 * CLIPPED_GAIN)
    changed = (found != panorama).any(axis=-1)
    assert changed.sum() == 2


@pytest.fixture
def session() -> Session:
    lit = BoxRoom(size_m=(5.0, 2.6, 4.5), lamp=((0.5, 2.6, 0.3), 0.3))
    session = Session(SessionOptions(height=32))
    session.push(lit.frame(camera_at((0.2, 1.4, 1.2), pitch_degrees=-35.0), width=64, height=48))
    return session


def test_completion_changes_what_no_frame_showed_alone(session: Session) -> None:
    state = session.panorama_state(session.track((0.3, 0.4, -1.0)))
    found = completed_light(session, state)
    assert_array_equal(found[state.seen >= 1], state.radiance[state.seen >= 1])
    unseen = state.seen < 0.01
    assert unseen.any()
    assert (found[unseen] != state.radiance[unseen]).any(axis=-1).mean() > 0.9


def test_object_light_is_made_of_the_three_steps(session: Session) -> None:
    handle = session.track((0.3, 0.4, -1.0))
    state = session.panorama_state(handle)
    light = object_light(session, handle)
    assert_array_equal(light.casting, with_clipped_energy(completed_light(session, state), state.guessed))
    assert_array_equal(light.shown, with_missing_light(light.casting, state.seen))
    assert_array_equal(state.radiance, session.light(handle).panorama)  # the session's own light stays


def test_networks_that_complete_the_light_themselves_are_not_completed_again() -> None:
    lit = BoxRoom(size_m=(5.0, 2.6, 4.5))
    session = Session(SessionOptions(model="completion", height=32))
    session.push(lit.frame(camera_at((0.2, 1.4, 1.2), pitch_degrees=-35.0), width=64, height=48))
    handle = session.track((0.3, 0.4, -1.0))
    assert_array_equal(object_light(session, handle).casting, session.light(handle).panorama)


def test_missing_light_follows_the_exposure() -> None:
    panorama = lamp_at(room(ground=4 * ALBEDO / np.pi), (0.2, 0.9, 0.1), 3.0)
    assert_allclose(with_missing_light(3 * panorama, SEEN), 3 * with_missing_light(panorama, SEEN), rtol=1e-3)


def test_black_panorama_stays_black() -> None:
    assert not with_missing_light(np.zeros((ROWS, 2 * ROWS, 3), np.float32), SEEN).any()
