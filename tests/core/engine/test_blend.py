"""Accumulation of a probe's panorama: the conservative rule, and the kernel's reference."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomlight.camera import rigid_inverse
from roomlight.conventions import LUMINANCE, panorama_rays
from roomlight.engine.kernels.blend import count_seen_through, find_extremes
from roomlight.engine.kernels.reference import accumulate_reference, extremes_around, seen_through_reference
from roomlight.engine.observations import CLOSER_M
from roomlight.engine.panorama.blend import (
    DARK,
    FILL_COLOUR,
    UNSEEN_DEPTH,
    PanoramaState,
    PartialPanorama,
    accumulate,
    farthest_depth_m,
    fill_in,
)
from roomlight.engine.surface.mesh import DepthView
from rooms import camera_at

HEIGHT = 16
SHAPE = (HEIGHT, 2 * HEIGHT)


def _state(seed):
    rng = np.random.default_rng(seed)
    return PanoramaState(
        rng.uniform(0, 9, (*SHAPE, 3)).astype(np.float32),
        rng.uniform(0.5, 8, SHAPE).astype(np.float32),
        (rng.random(SHAPE) * (rng.random(SHAPE) < 0.7)).astype(np.float32),
        (rng.random(SHAPE) * (rng.random(SHAPE) < 0.5)).astype(np.float32),
        rng.uniform(0, 0.2, SHAPE).astype(np.float32),
        rng.integers(0, 2, SHAPE).astype(np.float32),
        rng.uniform(-0.2, 0.2, (*SHAPE, 3)).astype(np.float32),
        rng.random(SHAPE).astype(np.float32),
    )


def _views(seed, *, binary=False) -> dict[str, Any]:
    rng = np.random.default_rng(seed + 1)
    mask = rng.random(SHAPE) < 0.6
    weight = mask.astype(np.float32) if binary else (rng.random(SHAPE) * mask).astype(np.float32)
    return {
        "hdr": rng.uniform(0, 9, (*SHAPE, 3)).astype(np.float32),
        "partial": PartialPanorama(
            (rng.uniform(0, 1, (*SHAPE, 3)) * mask[..., None]).astype(np.float32),
            mask,
            (rng.uniform(0.3, 8, SHAPE) * mask).astype(np.float32),
            (rng.random(SHAPE) * (rng.random(SHAPE) < 0.5) * mask).astype(np.float32),
            (rng.uniform(0, 0.2, SHAPE) * mask).astype(np.float32),
            rng.random(SHAPE) < 0.5,
        ),
        "weight": weight,
        "camera": rng.uniform(-0.2, 0.2, 3).astype(np.float32),
        "unseen_m": 12.0,
    }


def _constant(*, hdr=2.0, detail=1.0, depth_m=1.0, weight=1.0, clipped=0.0, guessed=0.0) -> dict[str, Any]:
    radiance, depth_m, clipped, guessed, weight, hdr = (
        np.full((*SHAPE, *colours), value, np.float32)
        for value, colours in ((detail, [3]), (depth_m, []), (clipped, []), (guessed, []), (weight, []), (hdr, [3]))
    )
    partial = PartialPanorama(radiance, weight > 0, depth_m, clipped, guessed)
    return {"partial": partial, "hdr": hdr, "weight": weight, "unseen_m": 12.0}


def _after(*views):
    state = PanoramaState.fresh(HEIGHT, 3.0)
    for view in views:
        accumulate(state, **_constant(**view))
    return state


@given(st.integers(0, 2**31), st.booleans())
def test_the_kernel_equals_its_readable_reference(seed, binary):
    fast, slow = _state(seed), _state(seed)
    for step in range(3):
        accumulate(fast, **_views(seed + step, binary=binary))
        accumulate_reference(slow, **_views(seed + step, binary=binary))
    for field in dataclasses.fields(PanoramaState):
        # float32 throughout, sums of four terms up to 9; a pixel at a threshold may be on either side of it
        first, second = getattr(fast, field.name), getattr(slow, field.name)
        differs = abs(first - second) > 1e-5 * (1 + abs(second))
        assert differs.reshape(*SHAPE, -1).any(axis=-1).sum() <= 1, field.name


@given(st.integers(0, 2**31))
def test_what_is_seen_through_equals_its_readable_reference(seed):
    rng = np.random.default_rng(seed)
    fast, slow, position = _state(seed), _state(seed), rng.uniform(-1, 1, 3).astype(np.float32)
    gone = np.empty(SHAPE, bool)
    for _ in range(3):
        shown_m = (rng.uniform(0.3, 8, SHAPE) * (rng.random(SHAPE) < 0.6)).astype(np.float32)
        depth = (rng.uniform(0.5, 12, (12, 16)) * (rng.random((12, 16)) < 0.9)).astype(np.float32)
        camera = rigid_inverse(camera_at(rng.uniform(-1, 1, 3), *rng.uniform(-90, 90, 2))).astype(np.float32)
        view = DepthView(camera, np.array([9, 9, 8, 6], np.float32), depth)
        limits = np.float32(CLOSER_M), np.float32(7)
        count = count_seen_through(fast.arrays, shown_m, panorama_rays(HEIGHT), position, view, *limits, gone)
        expected = seen_through_reference(slow, shown_m, position, view, 7.0)
        assert count == gone.sum()
        # float32: a pixel at a threshold may be on either side of it
        assert (gone != expected).sum() + (fast.changed != slow.changed).sum() <= 2
        slow.changed[:] = fast.changed


@pytest.mark.parametrize("box", [np.s_[:0, :0], np.s_[:, :], np.s_[3:9, 5:12], np.s_[0:1, 31:], np.s_[15:, 0:1]])
def test_extremes_around_what_a_frame_shows(box):
    views = _views(5)
    mask = np.zeros(SHAPE, bool)
    mask[box] = True
    partial, weight = views["partial"], mask * views["weight"]
    detail, clipped, guessed = mask[..., None] * partial.radiance, mask * partial.clipped, mask * partial.guessed
    around = np.empty((3, *SHAPE), np.float32)
    rows = find_extremes(detail, clipped, guessed, weight, 1, around)
    seen = weight > 0
    expected = extremes_around(detail, clipped, guessed, weight=weight)
    np.testing.assert_allclose(around[:, seen], np.stack(expected)[:, seen], rtol=1e-6, atol=2e-7)
    shown = np.flatnonzero(seen.any(axis=1))
    assert rows == ((shown[0], shown[-1] + 1) if len(shown) else (0, 0))


def test_without_inferred_light_pixels_without_weight_stay_as_they_are():
    before, kept, copied, views = _state(3), _state(3), _state(3), _views(3)
    views["weight"][: HEIGHT // 2] = 0
    views["hdr"] = None
    accumulate(kept, **views)
    views["hdr"] = copied.radiance.copy()
    accumulate(copied, **views)
    unseen = views["weight"] == 0
    for field in dataclasses.fields(PanoramaState):
        plane = getattr(kept, field.name)
        np.testing.assert_allclose(plane, getattr(copied, field.name), rtol=1e-5, atol=1e-5)
        np.testing.assert_array_equal(plane[unseen], getattr(before, field.name)[unseen])
    assert (kept.radiance != before.radiance).any()


def test_the_first_frame_is_accepted_fully_and_the_rest_is_sglv():
    state = PanoramaState.fresh(HEIGHT, 3.0)
    views = _constant(weight=1.0)
    views["weight"][:, HEIGHT:] = 0
    accumulate(state, **views)
    assert (state.radiance[:, :HEIGHT] == 1.0).all()
    assert (state.radiance[:, HEIGHT:] == 2.0).all()
    assert (state.depth_m[:, :HEIGHT] == 1.0).all()
    assert (state.depth_m[:, HEIGHT:] == UNSEEN_DEPTH * 3.0).all()
    assert state.coverage() == pytest.approx(0.5)
    accumulate(state, **_constant(hdr=7.0, weight=0.0, depth_m=0.0))
    assert (state.radiance[:, HEIGHT:] == 7.0).all()  # unseen pixels follow the newest volume


@pytest.mark.parametrize("depth_max_m", [0.1, 0.3, 1.0, 3.0, 12.0])
def test_the_first_surface_is_accepted_at_any_distance(depth_max_m):
    state = PanoramaState.fresh(HEIGHT, depth_max_m)
    accumulate(state, **_constant(detail=0.5, depth_m=farthest_depth_m(depth_max_m)))
    assert (state.observed == 1).all()
    assert farthest_depth_m(depth_max_m) <= 3.2 * depth_max_m + 1e-9


@given(st.integers(0, 2**31))
def test_beyond_the_mesh_most_colour_comes_from_the_fill(seed):
    rng = np.random.default_rng(seed)
    hdr, ldr = rng.uniform(0, 9, (*SHAPE, 3)).astype(np.float32), rng.uniform(0.1, 1, (*SHAPE, 3)).astype(np.float32)
    mask, weight = rng.random(SHAPE) < 0.5, rng.random(SHAPE).astype(np.float32)
    light = fill_in(hdr, ldr, mask, weight=weight)
    np.testing.assert_array_equal(light[mask], hdr[mask])
    light, hdr, ldr, weight = light[~mask], hdr[~mask], ldr[~mask], weight[~mask]
    brightness = light @ LUMINANCE
    np.testing.assert_allclose(brightness, (1 - weight) * (hdr @ LUMINANCE) + weight * (ldr @ LUMINANCE), rtol=1e-4)
    mixed = hdr + weight[:, None] * (ldr - hdr)

    def away(colour):
        """From the fill's colour."""
        return colour / (colour @ LUMINANCE)[:, None] - (ldr + DARK) / (ldr @ LUMINANCE + DARK)[:, None]

    np.testing.assert_allclose(away(light), (1 - FILL_COLOUR) * away(mixed), atol=1e-4)


def test_a_black_fill_leaves_light_grey_and_finite():
    light = fill_in(
        np.full((*SHAPE, 3), 3, np.float32), np.zeros((*SHAPE, 3), np.float32), np.zeros(SHAPE, bool),
        weight=np.full(SHAPE, 0.5, np.float32),
    )  # fmt: skip
    np.testing.assert_allclose(light, 1.5, rtol=1e-5)


CLIPPED = {"detail": 2.0, "clipped": 1.0, "guessed": 1.0, "depth_m": 2.0}
"""White, estimated at twice that."""


@pytest.mark.parametrize(
    ("first", "second", "wanted"),
    [
        (CLIPPED, {"detail": 20.0, "depth_m": 2.1}, 20.0),
        ({"detail": 20.0, "depth_m": 2.1}, CLIPPED, 20.0),
        (CLIPPED, {"detail": 1.05, "depth_m": 2.0}, 1.05),
        # still clipped: at four times the white the estimate is eight
        (CLIPPED, {"detail": 8.0, "clipped": 1.0, "guessed": 4.0, "depth_m": 2.0}, 8.0),
        ({"detail": 8.0, "clipped": 1.0, "guessed": 4.0, "depth_m": 2.0}, CLIPPED, 8.0),
        # another estimate at the same white
        (CLIPPED, {"detail": 4.0, "clipped": 1.0, "guessed": 3.0, "depth_m": 2.0}, 2.0),
        # darker than the bound: not the same surface
        (CLIPPED, {"detail": 0.5, "depth_m": 2.0}, 2.0),
        # behind the clipped surface, or before it by less than the conservative rule asks for
        (CLIPPED, {"detail": 20.0, "depth_m": 2.3}, 2.0),
        (CLIPPED, {"detail": 20.0, "depth_m": 1.8}, 20.0),
        # half of the footprint clipped, then none of it; a pixel nearer to the lamp's rim at the same white does not
        ({"detail": 1.25, "clipped": 0.5, "guessed": 0.5}, {"detail": 10.25}, 10.25),
        ({"detail": 1.25, "clipped": 0.5, "guessed": 0.5}, {"detail": 1.6, "clipped": 0.8, "guessed": 0.7}, 1.25),
        ({"detail": 1.25, "clipped": 0.5, "guessed": 0.5}, {"detail": 0.6}, 1.25),
    ],
)
def test_clipped_yields_only_to_what_knows_more(first, second, wanted):
    state = _after(first, second)
    np.testing.assert_allclose(state.radiance, wanted, rtol=1e-5)
    assert (state.observed == 1).all()


@given(st.integers(0, 2**31))
def test_the_clipped_share_only_falls_on_a_surface(seed):
    rng = np.random.default_rng(seed)
    state = PanoramaState.fresh(HEIGHT, 3.0)
    bound, light = None, rng.uniform(2, 10)
    for white in 2.0 ** rng.integers(0, 6, 8):
        true = rng.uniform(0.9, 1.1) * light * np.ones(SHAPE)
        clipped = (true >= white).astype(np.float32)
        shown = np.where(clipped > 0, 2 * white, true)
        view = _constant(depth_m=2.0)
        view["partial"].radiance[:] = shown[..., None]
        view["partial"].clipped[:], view["partial"].guessed[:] = clipped, clipped * white
        accumulate(state, **view)
        before, bound = bound, state.radiance @ LUMINANCE - state.guessed
        if before is not None:
            assert (bound >= 0.89 * before).all()


@pytest.mark.parametrize(
    ("views", "hidden"),
    [
        ([(True, 3.0)], True),
        ([(False, 3.0)], False),
        ([(False, 3.0), (True, 3.1)], True),
        ([(True, 3.0), (False, 3.1)], True),
        ([(True, 3.0), (True, 2.0)], False),  # not before it
        ([(True, 3.0), *2 * [(None, 0.1)]], False),  # other light, of completed depth, replaced it
    ],
)
def test_completed_depth_is_left_out_before_what_was_measured(views, hidden):
    state = PanoramaState.fresh(HEIGHT, 3.0)
    for measured, value in views:
        view = _constant(depth_m=3.0 if measured is None else value, detail=value if measured is None else 1.0)
        view["partial"] = dataclasses.replace(view["partial"], measured=np.full(SHAPE, bool(measured)))
        accumulate(state, **view)
    seen = _constant(depth_m=2.0)["partial"]
    completed = dataclasses.replace(seen, measured=np.zeros(SHAPE, bool)).not_before(state)
    assert (completed.mask != hidden).all()
    assert ((completed.depth_m == 0) == hidden).all()
    assert not (seen.not_before(state).mask != seen.mask).any()


LIT, DARK_AGAIN = {"detail": 3.0, "clipped": 1.0, "guessed": 2.0}, {"detail": 0.2}
"""A lamp that is on and clips, with an estimate of three times white; the lamp switched off."""


@pytest.mark.parametrize(("before", "after", "wanted"), [(LIT, DARK_AGAIN, 0.2), (DARK_AGAIN, LIT, 3.0)])
def test_switched_light_is_taken_up_in_two_frames(before, after, wanted):
    assert (_after(before, before, before, after).radiance == _after(before).radiance).all()
    state = _after(before, before, before, after, after)
    np.testing.assert_allclose(state.radiance, wanted, rtol=1e-6)
    assert (state.changed == 0).all()


@pytest.mark.parametrize(
    "views",
    [
        [DARK_AGAIN, LIT, DARK_AGAIN, LIT, DARK_AGAIN],  # flashes of one frame
        *([{"detail": first}, *3 * [{"detail": second}]] for first, second in ((1.0, 0.8), (1.0, 1.9), (0.5, 0.26))),
        [{"detail": 0.004}, *3 * [{"detail": 0.04}]],  # noise in the dark
        [{"detail": 1.0, "depth_m": 2.0}, *3 * [{"detail": 0.1, "depth_m": 2.5}]],  # behind the surface
    ],
)
def test_what_is_no_change_of_light(views):
    np.testing.assert_allclose(_after(*views).radiance, views[0]["detail"], rtol=1e-4)


def test_changed_light_is_blended_as_if_it_were_seen_first():
    """A weight below 1 leaves a share of what was inferred, of which later frames take more, as they do at first."""
    old = {"detail": 3.0, "hdr": 2.0, "depth_m": 2.0, "weight": 0.75}
    new = {"detail": 0.2, "hdr": 0.3, "depth_m": 2.0, "weight": 0.75}
    for frames in (1, 2, 3):
        switched, first = _after(old, old, old, new, *frames * [new]), _after(*frames * [new])
        for plane in ("radiance", "depth_m", "observed"):
            np.testing.assert_allclose(getattr(switched, plane), getattr(first, plane), rtol=1e-6)


def test_an_edge_shifted_by_a_pixel_is_no_change():
    edge, shifted = _constant(depth_m=2.0), _constant(depth_m=2.0)
    edge["partial"].radiance[:, HEIGHT:] = 0.1
    shifted["partial"].radiance[:] = np.roll(edge["partial"].radiance, 1, axis=1)
    state = PanoramaState.fresh(HEIGHT, 3.0)
    for view in (edge, shifted, shifted, shifted):
        accumulate(state, **view)
    np.testing.assert_allclose(state.radiance[:, 1:-1], edge["partial"].radiance[:, 1:-1], rtol=1e-6)


def _moved(view, across_m) -> dict[str, Any]:
    """The view of a camera that far to the side of the probe; the panorama's middle column looks along x."""
    return _constant(depth_m=2.0, **view) | {"camera": np.array([0.0, 0.0, across_m], np.float32)}


@pytest.mark.parametrize(("across_m", "wanted"), [(0.0, 0.2), (0.15, 0.2), (0.2, 3.0), (1.0, 3.0)])
def test_other_light_from_elsewhere_is_no_change(across_m, wanted):
    """At 2 m, 5 degrees are 17 cm."""
    state = PanoramaState.fresh(HEIGHT, 3.0)
    for view in (_moved(LIT, 0.0), *3 * [_moved(DARK_AGAIN, across_m)]):
        accumulate(state, **view)
    np.testing.assert_allclose(state.radiance[HEIGHT // 2, HEIGHT], wanted, rtol=1e-6)


def test_a_walking_camera_sees_a_lamp_switched_off():
    """What every frame shows as it was is known from the last frame's place."""
    state = PanoramaState.fresh(HEIGHT, 3.0)
    for step in range(20):
        accumulate(state, **_moved(LIT if step < 18 else DARK_AGAIN, 0.05 * step))
    np.testing.assert_allclose(state.radiance, 0.2, rtol=1e-6)


def test_a_view_through_a_window_that_moves_with_the_camera_is_no_change():
    """Bright sky above dark ground, far behind a window 2 m away: its horizon falls by a row, 3 degrees, a step."""
    height, rows = 60, np.arange(60)[:, None]
    state = PanoramaState.fresh(height, 3.0)
    ones = np.ones((height, 2 * height), np.float32)
    for step in range(9):
        sky = np.repeat(np.where(rows < 28 + step, 5.0, 0.0)[..., None] * np.ones((1, 2 * height, 1)), 3, axis=-1)
        camera = np.array([0.0, -step * 2.0 * np.radians(3.0), 0.0], np.float32)
        seen = PartialPanorama(sky.astype(np.float32), ones > 0, 2 * ones)
        accumulate(state, seen, hdr=np.zeros_like(seen.radiance), weight=ones, unseen_m=12.0, camera=camera)
    np.testing.assert_array_equal(state.radiance[:28, 60], 5.0)
    np.testing.assert_array_equal(state.radiance[28:, 60], 0.0)
