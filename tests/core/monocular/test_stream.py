"""Depth made consistent over a stream: scale and shift by triangulated features, keyframes, and what stays without."""

from dataclasses import replace

import numpy as np
import pytest

from box_room import LENS, exact_depth, frame, pose
from depth_models import StatedDepth
from roomlight.engine.networks.graphs import SHIPPED
from roomlight.errors import FrameError
from roomlight.monocular.estimate import DepthKind
from roomlight.monocular.fitting import Fit, error_field, fit_inverse
from roomlight.monocular.network import DepthNetworkModel, shipped_depth
from roomlight.monocular.stream import DepthStream, open_depth_stream
from roomlight.monocular.tracks import View, carried, grey_picture, grid_of, partners, triangulated

POSES = [pose(0.12 * k, turn=0.02 * k) for k in range(8)]


def _errors(stream: DepthStream) -> list[float]:
    errors: list[float] = []
    for k, at in enumerate(POSES):
        completed = stream.complete(frame(k, at))
        assert completed.depth_estimated
        errors.append(float(np.median(np.abs(completed.depth_m / exact_depth(at) - 1))))
    return errors


def test_walls_do_not_breathe_without_parallax() -> None:
    """A camera that only turns: each frame is fitted to the depth of the first."""
    turned = [pose(0, turn=0.04 * k) for k in range(6)]
    factors = [1.1, 1.3, 0.9, 1.2, 1.0, 1.35]
    model = StatedDepth("metric", lambda k: 1 / (factors[k] * exact_depth(turned[k])))
    stream = DepthStream(model, reference=None)
    scales = [float(np.median(stream.complete(frame(k, at)).depth_m / exact_depth(at))) for k, at in enumerate(turned)]
    assert scales == pytest.approx([1.1] * 6, rel=0.03)


def test_inverse_depth_gets_scale_and_shift_from_the_motion() -> None:
    reference = StatedDepth("metric", lambda k: 1 / (1.15 * exact_depth(POSES[k])))
    model = StatedDepth("inverse", lambda k: (1 / exact_depth(POSES[k])) * (3 + k % 3) + 0.7)
    errors = _errors(DepthStream(model, reference=reference))
    assert errors[0] == pytest.approx(0.15, abs=0.02)
    assert max(errors[3:]) < 0.06


@pytest.mark.slow
def test_a_wrong_start_is_forgotten_within_a_few_frames() -> None:
    """The model's word is half the depth in every frame; keyframes follow the correction."""
    errors = _errors(DepthStream(StatedDepth("metric", lambda k: 2 / exact_depth(POSES[k]))))
    assert errors[0] == pytest.approx(0.5, abs=0.01)
    assert max(errors[2:]) < 0.05


@pytest.mark.slow
def test_errors_that_vary_over_the_picture_are_corrected() -> None:
    """Depth that grows by half from left to right, and is right at no scale: a third of the error is left."""
    tilt = np.linspace(0.8, 1.25, 320)[None]
    wrong = [tilt * exact_depth(at) for at in POSES]
    stream = DepthStream(StatedDepth("metric", lambda k: 1 / wrong[k]), reference=None)
    ratio = [stream.complete(frame(k, at)).depth_m / exact_depth(at) for k, at in enumerate(POSES)][-1]
    own = float(np.abs(wrong[-1] / exact_depth(POSES[-1]) - 1).mean())
    assert float(np.abs(ratio - 1).mean()) < own / 3


def test_poses_that_do_not_fit_the_pictures_change_nothing() -> None:
    """The camera went sideways and the poses say up: features are off their epipolar lines."""
    model = StatedDepth("metric", lambda k: 1 / exact_depth(POSES[k]))
    stream = DepthStream(model)
    for k, at in enumerate(POSES):
        lifted = pose(0, turn=0.02 * k).astype(np.float64)
        lifted[1, 3] += 0.12 * k
        depth = stream.complete(replace(frame(k, at), camera_to_world=lifted)).depth_m
        assert np.median(depth / exact_depth(at)) == pytest.approx(1, abs=0.1)


def test_the_model_gets_the_up_direction_where_it_is_known() -> None:
    rolled = pose(0).astype(np.float64)
    rolled[:3, :3] = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
    model = StatedDepth("metric", lambda _: 1 / exact_depth(POSES[0]))
    for gravity in (True, False):
        DepthStream(model, gravity=gravity).complete(frame(0, rolled))
    assert model.told[0] == pytest.approx([0.6, 0.8, 0])
    assert model.told[1] is None


def test_a_trained_networks_folder_is_a_model() -> None:
    model = open_depth_stream(SHIPPED / "depth").model
    assert isinstance(model, DepthNetworkModel)
    assert model.digest == shipped_depth().digest


def test_a_frame_with_depth_is_returned_as_it_is() -> None:
    given = frame(0, POSES[0], depth=True)
    assert DepthStream(StatedDepth("metric", lambda _: np.ones((4, 4)))).complete(given) is given


def test_a_black_frame_is_refused_and_leaves_no_trace() -> None:
    stream = DepthStream(StatedDepth("metric", lambda _: np.ones((4, 4))))
    given = frame(0, POSES[0])
    with pytest.raises(FrameError, match="its image is black"):
        stream.complete(replace(given, image=np.zeros_like(given.image)))
    assert stream.state.last is None


def test_features_are_triangulated_where_there_is_parallax() -> None:
    views = [
        View(grey_picture(frame(0, at).image), LENS, at.astype(np.float64), grid_of(1 / exact_depth(at)))
        for at in POSES
    ]
    samples = triangulated(views[3], views[0], 1 / (1.3 * exact_depth(POSES[3])))
    truth = exact_depth(POSES[3])[samples.pixels[:, 1].astype(int), samples.pixels[:, 0].astype(int)]
    assert len(truth) > 50
    assert np.median(np.abs(samples.inverse * truth - 1)) < 0.02
    assert [views.index(near) for near in partners(views[4], views[:4], 2.5, 2)] == [2, 1]
    still = triangulated(views[0], views[0], 1 / exact_depth(POSES[0]))
    assert len(still.pixels) == 0
    taken = carried(views[3], views[0])
    truth = exact_depth(POSES[3])[taken.pixels[:, 1].astype(int), taken.pixels[:, 0].astype(int)]
    assert np.median(np.abs(taken.inverse * truth - 1)) < 0.01


@pytest.mark.parametrize("kind", ["metric", "scale", "inverse"])
def test_a_fit_withstands_a_third_of_wrong_samples(kind: DepthKind) -> None:
    rng = np.random.default_rng(0)
    true = rng.uniform(0.2, 1.2, 300)
    estimated = (true - (0.1 if kind == "inverse" else 0.0)) / 2.5
    measured = true * np.exp(rng.normal(0, 0.02, 300))
    measured[::3] = rng.uniform(0.05, 3, 100)
    fit = fit_inverse(estimated, measured, np.ones(300), kind=kind, prior=None)
    assert fit is not None
    assert fit.scale == pytest.approx(2.5, rel=0.03)
    assert fit.shift == pytest.approx(0.1 if kind == "inverse" else 0.0, abs=0.02)


def test_too_few_samples_leave_the_earlier_fit() -> None:
    few = np.full(5, 0.5)
    assert fit_inverse(few, few, few, kind="metric", prior=None) is None
    assert fit_inverse(few, few, few, kind="metric", prior=Fit(1.3)) == Fit(1.3)


def test_a_field_of_errors_follows_the_picture_and_depth() -> None:
    """Near things are 20 % too far, the left 10 % too near: both are told by a hundred noisy samples."""
    rng = np.random.default_rng(4)
    inverse = np.where(np.arange(320)[None] % 80 < 40, 0.9, 0.3).repeat(240, axis=0).astype(np.float32)
    error = np.where(inverse > 0.5, 0.2, 0.0) - np.linspace(0.1, -0.1, 320)[None]
    pixels = rng.uniform((0, 0), (320, 240), (400, 2))
    columns, rows = pixels.astype(int).T
    samples = error[rows, columns] + rng.normal(0, 0.03, 400)
    samples[::9] = 3.0
    field = error_field(inverse, pixels, samples, np.ones(400))
    assert np.abs(field - error).mean() < 0.04
    assert np.abs(field - error).mean() < 0.4 * np.abs(error).mean()
    assert not error_field(inverse, pixels[:0], samples[:0], np.ones(0)).any()


@pytest.mark.slow
def test_the_floor_in_view_mends_half_of_the_scale_until_features_tell_it() -> None:
    """The model's word is two thirds of the depth; the camera looks down from 1.4 m and turns, then walks."""
    walk = [pose(0.12 * max(0, k - 3), turn=0.05 * min(k, 3)).astype(np.float64) for k in range(8)]
    c, s = np.cos(0.5), np.sin(0.5)
    for at in walk:
        at[:3, :3] = at[:3, :3] @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    ratios: dict[bool, list[float]] = {}
    for gravity in (True, False):
        stream = DepthStream(StatedDepth("metric", lambda k: 1.5 / exact_depth(walk[k])), gravity=gravity)
        depths = [stream.complete(frame(k, at)).depth_m for k, at in enumerate(walk)]
        ratios[gravity] = [float(np.median(depth / exact_depth(at))) for depth, at in zip(depths, walk, strict=True)]
    assert ratios[True][:4] == pytest.approx([np.sqrt(1.45 / 1.4 * 2 / 3)] * 4, rel=0.03)
    assert ratios[False][:4] == pytest.approx([2 / 3] * 4, rel=0.02)
    assert ratios[True][-1] == pytest.approx(1, rel=0.05)
    assert ratios[False][-1] == pytest.approx(1, rel=0.05)
