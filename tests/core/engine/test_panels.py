"""Panels of a panorama, and the change of its light: what was observed stays, the rest changes and is finite."""

import numpy as np
import pytest

from roomlight.engine.panorama.panels import BRIGHTEST, FARTHEST_M, HEIGHT, PANELS, changed_light, panorama_panels


def change_of(constant):
    return np.full((3, HEIGHT, 2 * HEIGHT), constant, np.float32)


def observed(seed=0, height=120):
    """Random panels' sources: detail, known, clipped, depth, fill."""
    rng = np.random.default_rng(seed)
    shape = (height, 2 * height)
    return {
        "detail": rng.exponential(1, (*shape, 3)).astype(np.float32),
        "known": (rng.random(shape) < 0.4).astype(np.float32),
        "clipped": rng.random(shape).astype(np.float32),
        "depth_m": rng.uniform(0.5, 6, shape).astype(np.float32),
        "fill": rng.exponential(0.5, (*shape, 3)).astype(np.float32),
    }


def test_panels_are_means_of_what_was_observed():
    given = observed()
    panels = panorama_panels(**given)
    assert panels.shape == (PANELS, HEIGHT, 2 * HEIGHT)
    assert panels.dtype == np.float32

    def blocks(plane):
        return plane.reshape(60, 2, 120, 2, *plane.shape[2:]).sum(axis=(1, 3))

    count = blocks(given["known"])
    assert panels[3] == pytest.approx(count / 4)
    seen = count > 0
    for found, name in ((panels[:3], "detail"), (panels[4], "clipped"), (panels[5], "depth_m")):
        weight = given["known"].reshape(given["known"].shape + (1,) * (given[name].ndim - 2))
        expected = blocks(weight * given[name])[seen] / count[seen].reshape(-1, *(1,) * (given[name].ndim - 2))
        np.testing.assert_allclose(found[..., seen].T, expected, rtol=1e-4)
        assert (found[..., ~seen] == 0).all()
    assert panels[6:9] == pytest.approx(np.moveaxis(blocks(given["fill"]) / 4, -1, 0), rel=1e-4)


@pytest.mark.parametrize("height", [16, 32, 60, 120, 200])
def test_panels_have_one_size_and_limit_for_every_panorama(height):
    given = observed(height=height)
    panels = panorama_panels(**given)
    assert panels.shape == (PANELS, HEIGHT, 2 * HEIGHT)
    assert np.isfinite(panels).all()
    given["detail"][:] = given["fill"][:] = 1e12
    given["depth_m"][:] = 1e6
    panels = panorama_panels(**given)
    limits = (panels[:3].max(), panels[6:].max(), panels[5].max())
    assert limits == pytest.approx((BRIGHTEST, BRIGHTEST, FARTHEST_M))  # to rounding: panels are resampled


@pytest.mark.parametrize("height", [16, 32, 60, 120, 200])
def test_a_change_has_no_seam(height):
    change = np.random.default_rng(0).normal(size=(3, HEIGHT, 2 * HEIGHT)).astype(np.float32)
    light, share = np.ones((height, 2 * height, 3), np.float32), np.ones((height, 2 * height), np.float32)
    turned = changed_light(light, np.roll(change, HEIGHT, axis=2), share)
    np.testing.assert_array_equal(np.roll(turned, height, axis=1), changed_light(light, change, share))


@pytest.mark.parametrize("constant", [-30.0, 30.0])
@pytest.mark.parametrize("radiance", [0.0, 1.0, 1e12])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_light_is_finite_for_black_bright_and_empty(constant, radiance, share):
    shape = (120, 240)
    image, known = np.full((*shape, 3), np.float32(radiance)), np.full(shape, np.float32(share))
    flat = np.full(shape, np.float32(1))
    panels = panorama_panels(detail=image, known=known, clipped=flat, depth_m=flat, fill=image)
    assert np.isfinite(panels).all()
    result = changed_light(image, change_of(constant), 1 - known)
    assert np.isfinite(result).all()
    assert result.min() >= 0
    if share < 1:
        assert result.max() <= BRIGHTEST * 1.001
