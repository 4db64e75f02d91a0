"""The prior over panoramas: what is seen stays, what is not seen follows it, and headings do not matter."""

import numpy as np
import pytest

from roomlight.engine.panorama.prior import COLUMNS, FILE, NOISE, OFFSET, ROWS, PanoramaPrior
from roomlight.errors import ModelError

HEIGHT = 48


def rooms(count, seed=0):
    """Panoramas whose brightness, ceiling and one window differ from room to room."""
    rng = np.random.default_rng(seed)
    rows = np.linspace(1, -1, HEIGHT)[:, None, None]
    for _ in range(count):
        logs = rng.normal(-1, 0.8) + rng.normal(0.5, 0.2) * rows + rng.normal(0, 0.05, (HEIGHT, 2 * HEIGHT, 3))
        yield np.exp(np.roll(logs, rng.integers(2 * HEIGHT), axis=1)).astype(np.float32)


@pytest.fixture(scope="module")
def prior():
    return PanoramaPrior.fit(rooms(40))


def test_the_unseen_half_follows_the_seen_one(prior):
    seen = np.zeros((HEIGHT, 2 * HEIGHT), np.float32)
    seen[:, :HEIGHT] = 1
    for room in rooms(5, seed=9):
        fill = prior.fill(room, seen)
        error = np.log(fill[:, HEIGHT:] + OFFSET) - np.log(room[:, HEIGHT:] + OFFSET)
        assert abs(error.mean()) < 0.1
        assert error.std() < 0.15  # the noise of 0.05, and the ceiling's


def test_without_anything_seen_the_mean_of_all_rooms_is_returned(prior):
    nothing = np.zeros((HEIGHT, 2 * HEIGHT), np.float32)
    fill = prior.fill(np.full((HEIGHT, 2 * HEIGHT, 3), np.nan_to_num(np.inf)), nothing)
    logs = np.log(fill + OFFSET).reshape(ROWS, HEIGHT // ROWS, -1).mean(axis=(1, 2))
    assert logs == pytest.approx(prior.mean, abs=0.05)


def test_it_turns_with_the_room(prior):
    rng = np.random.default_rng(4)
    room = next(iter(rooms(1, seed=3))) * rng.uniform(0.3, 3, (1, COLUMNS, 1)).repeat(2 * HEIGHT // COLUMNS, axis=1)
    seen = (np.arange(2 * HEIGHT) < 30).astype(np.float32) * np.ones((HEIGHT, 1), np.float32)
    turned, step = 5 * (2 * HEIGHT // COLUMNS), 1
    expected = np.roll(prior.fill(room, seen), turned, axis=step)
    found = prior.fill(np.roll(room, turned, axis=step), np.roll(seen, turned, axis=step))
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-3)


@pytest.mark.parametrize("share", [0.3, 0.8, 1.0])
def test_it_is_the_conditional_mean_of_the_gaussian(prior, share):
    """Against the textbook's formula in float64, on coarse pixels."""
    rng = np.random.default_rng(1)
    logs = rng.normal(-1, 1, (ROWS, COLUMNS, 3))
    seen = rng.random((ROWS, COLUMNS)) < share
    matrix = np.empty((ROWS, COLUMNS, ROWS, COLUMNS))
    for a in range(COLUMNS):
        for b in range(COLUMNS):
            matrix[:, a, :, b] = prior.covariance[:, :, (a - b) % COLUMNS]
    matrix = matrix.reshape(ROWS * COLUMNS, -1)
    mean = np.repeat(prior.mean, COLUMNS).astype(float)[:, None]
    known = seen.reshape(-1)
    inverse = np.linalg.inv(matrix[np.ix_(known, known)] + NOISE * np.eye(known.sum()))
    radiance = np.maximum(np.exp(logs) - OFFSET, 0).astype(np.float32)
    logs_seen = np.log(radiance + OFFSET).reshape(-1, 3)
    expected = mean + matrix[:, known] @ inverse @ (logs_seen - mean)[known]
    fill = prior.fill(radiance, seen.astype(np.float32))
    np.testing.assert_allclose(np.log(fill + OFFSET).reshape(-1, 3), np.maximum(expected, np.log(OFFSET)), atol=5e-3)


def test_it_is_saved_and_loaded(prior, tmp_path):
    prior.save(tmp_path / FILE)
    loaded = PanoramaPrior.load(tmp_path / FILE)
    assert (loaded.mean == prior.mean).all()
    assert (loaded.covariance == prior.covariance).all()


def test_a_damaged_file_is_refused_by_name(tmp_path):
    (tmp_path / FILE).write_bytes(b"no arrays")
    with pytest.raises(ModelError, match=f"{FILE}: cannot be read"):
        PanoramaPrior.load(tmp_path / FILE)
    np.savez(tmp_path / FILE, mean=np.zeros(3), covariance=np.zeros((3, 3, 6)))
    with pytest.raises(ModelError, match=r"must hold mean \(16,\)"):
        PanoramaPrior.load(tmp_path / FILE)


def test_nothing_to_fit_is_an_error():
    with pytest.raises(ValueError, match="at least one panorama"):
        PanoramaPrior.fit([])
