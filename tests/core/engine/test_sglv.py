"""SGLV ray tracing: equations 1 and 2, and the kernel against its readable reference."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roomlight.conventions import panorama_directions
from roomlight.engine.kernels.reference import render_rays_reference
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.engine.volume.sglv import COARSE_ROWS, Sglv, render_coarse_panorama, render_panorama, render_rays
from rooms import camera_at

SHAPE = (16, 15, 21)
GRID = VolumeGrid(camera_at((0.4, 1.5, -0.3), 35, 10), 3.0, SHAPE)
CENTRE = (0.4, 1.5, -0.3)


def _random(seed, *, opacity=0.3, sparse=0.0, grid=GRID):
    rng = np.random.default_rng(seed)
    shape = grid.shape
    alpha = (rng.random(shape) * opacity * (rng.random(shape) >= sparse)).astype(np.float32)
    lobes = rng.random((*shape, 10)).astype(np.float32)
    lobes[..., 3:6] *= 5
    lobes[..., 6] *= 10
    direction = rng.normal(size=(*shape, 3))
    lobes[..., 7:] = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    return Sglv(grid, alpha, lobes)


def _constant(value=1.0, alpha=0.1, grid=GRID):
    sglv = Sglv.empty(grid)
    sglv.alpha[:] = alpha
    sglv.lobes[..., :3] = value
    return sglv


def _directions(count=400, seed=1):
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    directions[:6] = np.concatenate([np.eye(3), -np.eye(3)])
    return (directions / np.linalg.norm(directions, axis=-1, keepdims=True)).astype(np.float32)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    opacity=st.sampled_from([0.02, 0.3, 1.0]),
    sparse=st.sampled_from([0.0, 0.95]),
    position=st.tuples(*[st.floats(-6, 6)] * 3),
    far=st.sampled_from(["boundary", "none"]),
    samples=st.sampled_from([1, 17, 128]),
    step_m=st.sampled_from([None, 0.1, 0.7]),
)
def test_the_kernel_equals_its_readable_reference(seed, opacity, sparse, position, far, samples, step_m):
    sglv = _random(seed, opacity=opacity, sparse=sparse)
    how = {"samples": samples, "step_m": step_m, "far": far}
    fast, left = render_rays(sglv, position, _directions(), **how)
    slow, left_slow = render_rays_reference(sglv, position, _directions(), **how)
    # The kernel is float32 and stops at a transmittance of 1e-3: c up to 1, w up to 5 and the lobe's exponent, up
    # to 10, share that remainder (about 0.02). A sample within 1e-6 of the volume's end may count in only one of
    # them, and a ray may graze an edge: such rays are few.
    far_off = (abs(fast - slow) > 0.03 + 0.01 * abs(slow)).any(axis=-1) | (abs(left - left_slow) > 2e-3)
    assert far_off.mean() <= 0.01
    assert np.median(abs(fast - slow)) < 1e-4
    assert np.isfinite(fast).all()


def test_a_position_outside_sees_the_volume_and_nothing_else():
    sglv = _constant(alpha=1.0)
    outside = (40.0, 1.5, -0.3)
    towards = np.array([[-1, 0, 0]], np.float32)
    for render in (render_rays, render_rays_reference):
        radiance, left = render(sglv, outside, np.concatenate([towards, -towards]))
        assert radiance == pytest.approx(np.array([[1, 1, 1], [0, 0, 0.0]]))
        assert left == pytest.approx([0, 1], abs=1e-3)


def test_a_panorama_is_its_rays_and_an_empty_volume_gives_no_light():
    sglv = _random(5)
    panorama, left = render_panorama(sglv, CENTRE, height=18)
    rays, left_of_rays = render_rays(sglv, CENTRE, panorama_directions(18).reshape(-1, 3))
    assert (panorama.reshape(-1, 3) == rays).all()
    assert (left.reshape(-1) == left_of_rays).all()
    radiance, left = render_panorama(Sglv.empty(GRID), CENTRE, height=16)
    assert radiance.shape == (16, 32, 3)
    assert (radiance == 0).all()
    assert (left == 1).all()


def test_parameters_are_accumulated_before_the_lobe_is_taken():
    """Equation 1 sums s and lambda, equation 2 is applied once: not a sum of lobes."""
    sglv = _constant(value=0.0, alpha=0.5)
    sglv.lobes[..., 3:6] = 2.0
    sglv.lobes[..., 6] = 3.0
    sglv.lobes[..., 7:] = [0, 0, 1]
    ray = (GRID.volume_to_world[:3, :3] @ [0, 0, 1]).astype(np.float32)[None]
    radiance, left = render_rays(sglv, CENTRE, ray, samples=2, far="none")
    kept = 0.75  # 0.5 + 0.25
    assert left[0] == pytest.approx(0.25)
    assert radiance[0] == pytest.approx([2 * kept * np.exp(3 * kept * (kept - 1))] * 3, rel=1e-5)


def test_a_coarse_panorama_is_interpolated_around_the_circle():
    sglv, height = _random(7), 2 * COARSE_ROWS
    half = np.dstack(render_panorama(sglv, CENTRE, height=height // 2))
    above, below = half[np.r_[0, : len(half) - 1]], half[np.r_[1 : len(half), -1]]
    rows = np.stack([0.75 * half + 0.25 * above, 0.75 * half + 0.25 * below], axis=1).reshape(height, height, 4)
    left, right = np.roll(rows, 1, axis=1), np.roll(rows, -1, axis=1)
    wanted = np.stack([0.75 * rows + 0.25 * left, 0.75 * rows + 0.25 * right], axis=2).reshape(height, -1, 4)
    radiance, transmittance = render_coarse_panorama(sglv, CENTRE, height=height)
    np.testing.assert_allclose(np.dstack([radiance, transmittance]), wanted, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("height", [9, 16, COARSE_ROWS + 1, 2 * COARSE_ROWS + 1])
def test_a_small_panorama_and_one_that_does_not_divide_have_every_ray(height):
    sglv = _random(7)
    for coarse, fine in zip(
        render_coarse_panorama(sglv, CENTRE, height=height), render_panorama(sglv, CENTRE, height=height), strict=True
    ):
        np.testing.assert_array_equal(coarse, fine)


def test_a_larger_panorama_takes_as_many_rays():
    sglv = _random(7)
    radiance, _ = render_coarse_panorama(sglv, CENTRE, height=4 * COARSE_ROWS)
    few, _ = render_panorama(sglv, CENTRE, height=COARSE_ROWS)
    means = cv2.resize(radiance, (2 * COARSE_ROWS, COARSE_ROWS), interpolation=cv2.INTER_AREA)
    assert np.abs(means - few).mean() < 0.03 * few.mean()  # what interpolation smoothes
    assert np.abs(np.roll(means, 1, axis=1) - few).mean() > 0.04 * few.mean()
