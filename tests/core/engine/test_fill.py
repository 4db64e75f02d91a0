import numpy as np
import pytest

from roomlight.engine.panorama.fill import at_most_white, fill_unknown, push_pull

SIZES = [(1, 2), (2, 4), (5, 10), (16, 32), (15, 30), (12, 7), (120, 240)]


def scattered(height: int, width: int, share: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    weight = (rng.random((height, width)) < share).astype(np.float32)
    weight[rng.integers(height), rng.integers(width)] = 1
    return rng.random((height, width, 3)).astype(np.float32), weight


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_known_pixels_are_kept_to_the_bit_and_others_stay_between_them(height: int, width: int) -> None:
    image, weight = scattered(height, width, 0.05)
    filled = push_pull(image, weight)
    known = image[weight == 1]
    np.testing.assert_array_equal(filled[weight == 1], known)
    assert np.isfinite(filled).all()
    assert (filled >= known.min(axis=0) - 1e-5).all()
    assert (filled <= known.max(axis=0) + 1e-5).all()


def test_nothing_known_gives_zeros_unknown_colour_is_not_read_and_all_known_is_kept() -> None:
    image = np.full((6, 12, 3), np.nan, np.float32)
    weight = np.zeros((6, 12), np.float32)
    np.testing.assert_array_equal(push_pull(image, weight), np.zeros((6, 12, 3)))
    image[2, 3], weight[2, 3] = 0.25, 1
    np.testing.assert_allclose(push_pull(image, weight), 0.25, rtol=1e-5)
    image, _ = scattered(9, 18, 1.0)
    np.testing.assert_array_equal(push_pull(image, np.full((9, 18), 2.0, np.float32)), image)


def test_fill_unknown_keeps_known_and_spreads_at_most_white():
    image = np.full((16, 32, 3), 0.25, np.float32)
    image[6:9, 10:14] = 40.0, 20.0, 10.0  # a warm window: clipped channel by channel, it would fill in white
    known = np.zeros((16, 32), np.float32)
    known[4:11, 4:20] = 1
    filled = fill_unknown(image, known)
    np.testing.assert_array_equal(filled[known == 1], image[known == 1])
    assert (filled[known == 0] >= 0.25 - 1e-6).all()
    assert (filled[known == 0] <= 1).all()
    lent = filled[known == 0] - 0.25
    np.testing.assert_allclose(lent, lent[:, :1] * [1, 1 / 3, 0], atol=1e-5)
    np.testing.assert_array_equal(fill_unknown(np.minimum(image, 1), known), push_pull(np.minimum(image, 1), known))


def test_at_most_white_keeps_darker_pixels():
    image = np.random.default_rng(0).random((4, 8, 3), np.float32) * 3
    cut = at_most_white(image)
    dim = image.max(-1) <= 1
    assert dim.any()
    np.testing.assert_array_equal(cut[dim], image[dim])
    np.testing.assert_allclose(cut[~dim].max(-1), 1, rtol=1e-6)
    np.testing.assert_allclose(cut * image[..., :1], image * cut[..., :1], rtol=1e-5)


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_it_equals_the_same_pyramid_in_numpy(height, width):
    rng = np.random.default_rng(2)
    image, weight = scattered(height, width, 0.1)
    weight = np.where(rng.random(weight.shape) < 0.3, rng.random(weight.shape), weight).astype(np.float32)
    expected = fill_reference(image * weight[..., None], weight[..., None])
    np.testing.assert_allclose(push_pull(image, weight), expected, rtol=1e-5, atol=1e-6)  # another order of sums


def fill_reference(known, share):
    if (share >= 1).all():
        return known
    height, width = share.shape[:2]
    if height == 1 and width == 1:
        return known / np.maximum(share, np.finfo(np.float32).tiny)
    coarse_share = _halve(share)
    # A coarse pixel has the weights of its pixels together, at most 1: saturation keeps the pull local, and the
    # factor 4 gives full weight to a parent of one known pixel in four (Gortler's rule).
    gain = np.minimum(1.0, 4.0 * coarse_share) / np.maximum(coarse_share, np.finfo(np.float32).tiny)
    filled = fill_reference(_halve(known) * gain, coarse_share * gain)
    return known + (1 - share) * _double(filled, height, width)


def _halve(pixels):
    """Halve the size (rounded up) by the tent filter; columns wrap, the pole rows repeat."""
    if pixels.shape[0] > 1:
        rows = _pad_rows(pixels, before=1, after=2 + pixels.shape[0] % 2)
        count = (pixels.shape[0] + 1) // 2 * 2
        pixels = (
            rows[0:count:2] + 3 * rows[1 : count + 1 : 2] + 3 * rows[2 : count + 2 : 2] + rows[3 : count + 3 : 2]
        ) / 8
    if pixels.shape[1] > 1:
        width = pixels.shape[1]
        columns = np.arange(0, width, 2)
        left, right = pixels[:, columns], pixels[:, (columns + 1) % width]
        pixels = (pixels[:, columns - 1] + 3 * left + 3 * right + pixels[:, (columns + 2) % width]) / 8
    return pixels


def _double(pixels, height: int, width: int):
    """Enlarge up to twice by linear interpolation (3/4, 1/4); the counterpart of `_halve`."""
    if pixels.shape[0] < height:
        rows = _pad_rows(pixels, before=1, after=1)
        doubled = np.empty((2 * pixels.shape[0], *pixels.shape[1:]), np.float32)
        doubled[0::2] = 0.75 * pixels + 0.25 * rows[:-2]
        doubled[1::2] = 0.75 * pixels + 0.25 * rows[2:]
        pixels = doubled[:height]
    if pixels.shape[1] < width:
        doubled = np.empty((height, 2 * pixels.shape[1], pixels.shape[2]), np.float32)
        doubled[:, 0::2] = 0.75 * pixels + 0.25 * np.roll(pixels, 1, axis=1)
        doubled[:, 1::2] = 0.75 * pixels + 0.25 * np.roll(pixels, -1, axis=1)
        pixels = doubled[:, :width]
    return pixels


def _pad_rows(pixels, *, before: int, after: int):
    return np.pad(pixels, ((before, after), (0, 0), (0, 0)), mode="edge")
