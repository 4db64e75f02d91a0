"""Back-propagation through time: gradients, windows, units, and the loss over a sequence."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from recordings import BoxRecordings
from roomlight_model.networks import VideoModel
from roomlight_model.training import unroll as unrolling
from roomlight_model.training.sequences import PreparedWalk, collate_walks, read_walk, with_views
from roomlight_model.training.stages import trained_modules
from roomlight_model.training.starting import starting_model, starting_options
from roomlight_model.training.unroll import Unroll, window_mb
from video_training import CPU, OPTIONS, SHAPE, TINY, dimmed, single_view_weights

STAGES = ["video-sglv", "video-blend", "video-joint"]


def batch_of(options, *, length=4, count=1, change_light=None):
    walks = [
        PreparedWalk.of(
            read_walk(
                BoxRecordings(count), k, np.random.default_rng(k), depth="exact", length=length,
                augment=change_light is not None, change_light=change_light,
            ),
            SHAPE,
        )
        for k in range(count)
    ]  # fmt: skip
    if options.stage == "video-sglv":
        return collate_walks(walks, panorama_height=None)
    height = options.panorama_height
    return with_views(collate_walks(walks, panorama_height=height), walks, panorama_height=height)


def video_model(config=TINY):
    weights = single_view_weights()
    options = starting_options(replace(OPTIONS, model=config), weights)
    model = starting_model(options, weights)
    assert isinstance(model, VideoModel)
    return model


def gradients(model, batch, options):
    parameters = [p for module in trained_modules(model, options.stage) for p in module.parameters()]
    unroll = Unroll(model, batch, options, generator=torch.Generator().manual_seed(0), device=CPU)
    return unroll.gradients(parameters)


@pytest.mark.parametrize("stage", STAGES)
def test_recomputed_gradients_are_those_of_a_plain_pass(stage, monkeypatch):
    options = replace(OPTIONS, stage=stage)
    model, batch = video_model(), batch_of(options)
    losses, recomputed = gradients(model, batch, options)
    monkeypatch.setattr(unrolling, "_recomputed", lambda step, given, state: step(given, state))
    plain_losses, plain = gradients(model, batch, options)
    torch.testing.assert_close(losses, plain_losses)
    assert any(gradient is not None and gradient.any() for gradient in plain)
    for one, other in zip(recomputed, plain, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("stage", STAGES)
def test_a_shorter_window_has_the_same_losses_and_other_gradients(stage):
    """The recursion is the same; only the way back in time ends at the window."""
    options = replace(OPTIONS, stage=stage)
    model, batch = video_model(), batch_of(options)
    losses, whole = gradients(model, batch, options)
    short_losses, short = gradients(model, batch, replace(options, window=1))
    torch.testing.assert_close(losses, short_losses)
    pairs = [(one, other) for one, other in zip(whole, short, strict=True) if one is not None and other is not None]
    assert any(not torch.allclose(one, other, rtol=1e-3, atol=1e-9) for one, other in pairs)


def test_gradients_agree_with_finite_differences():
    options = replace(OPTIONS, stage="video-sglv")
    model, batch = video_model(), batch_of(options, length=3)
    bias = model.sg_decoder.heads.bias
    assert bias is not None
    _, found = gradients(model, batch, options)
    parameters = [p for module in trained_modules(model, options.stage) for p in module.parameters()]
    gradient = next(g for p, g in zip(parameters, found, strict=True) if p is bias)
    assert gradient is not None
    step, totals = 1e-2, []
    for sign in (1, -1):
        with torch.no_grad():
            bias[1] += sign * step
            totals.append(float(gradients_of_total(model, batch, options)))
            bias[1] -= sign * step
    assert (totals[0] - totals[1]) / (2 * step) == pytest.approx(float(gradient[1]), rel=0.05)


def gradients_of_total(model, batch, options):
    unroll = Unroll(model, batch, options, generator=torch.Generator().manual_seed(0), device=CPU)
    return torch.stack([unroll.advance(frame).total for frame in range(1, batch.frames)]).mean()


def test_the_loss_is_the_sum_of_its_three_parts():
    for stage in STAGES:
        options = replace(OPTIONS, stage=stage, smoothness_weight=2.0)
        losses, _ = gradients(video_model(), batch_of(options), options)
        total, log_l2, rendering, smoothness = (float(part) for part in losses)
        assert smoothness > 0
        assert total == pytest.approx(log_l2 + 0.3 * rendering + 2 * smoothness, rel=1e-5)


def test_smoothness_compares_consecutive_panoramas():
    options = replace(OPTIONS, stage="video-blend")
    batch = batch_of(options)
    unroll = Unroll(video_model(), batch, options, generator=torch.Generator().manual_seed(0), device=CPU)
    with torch.no_grad():
        assert unroll.probe_state is not None
        before = unroll.probe_state.panorama.radiance
        losses = unroll.advance(1)
        after = unroll.probe_state.panorama.radiance
    expected = (torch.log1p(after) - torch.log1p(before)).square().mean()
    torch.testing.assert_close(losses.smoothness, expected)


def test_a_frame_is_compared_with_its_own_light():
    """Where the light changes, so does the truth of the loss."""
    options = replace(OPTIONS, stage="video-blend")
    batch = batch_of(options, change_light=dimmed)
    model = video_model()
    constant = replace(batch, light_of=torch.zeros_like(batch.light_of))
    logs = []
    for given in (batch, constant):
        unroll = Unroll(model, given, options, generator=torch.Generator().manual_seed(0), device=CPU)
        with torch.no_grad():
            logs.append([float(unroll.advance(frame).log_l2) for frame in (1, 2, 3)])
    assert logs[0][0] == logs[1][0]
    assert logs[0][1] != logs[1][1]


def test_blending_stages_need_the_probes_views():
    options = replace(OPTIONS, stage="video-blend")
    batch = replace(batch_of(options), detail=None)
    with pytest.raises(ValueError, match="with_views"):
        Unroll(video_model(), batch, options, generator=torch.Generator(), device=CPU)


def test_the_memory_of_a_window_grows_with_its_frames():
    short, whole = (window_mb(replace(OPTIONS, frames=31, window=window)) for window in (5, 30))
    assert whole == pytest.approx(6 * short)
    assert window_mb(replace(OPTIONS, frames=31, window=100)) == whole
    assert window_mb(replace(OPTIONS, frames=31, batch=4)) == pytest.approx(2 * whole)


def test_the_first_frames_unit_stays_when_frames_darken():
    model = video_model()
    batch = batch_of(replace(OPTIONS, stage="video-sglv"), length=3)
    with torch.no_grad():
        state = model.start(batch.volume[:, 0])
        first = state.unit
        for frame in (1, 2):
            darker = batch.volume[:, frame].clone()
            darker[:, :3] *= 0.25
            state = model.step(darker, state)
    assert state.unit.equal(first)


def test_a_sequence_twice_as_bright_has_twice_the_light():
    """Units make the networks equivariant to exposure; only the darkest colours (`DARKEST`) are off."""
    model = video_model()
    batch = batch_of(replace(OPTIONS, stage="video-sglv"), length=3)
    volumes = batch.volume.clone()
    volumes[:, :, :3] *= 0.4  # below white: fills stop there
    brighter = volumes.clone()
    brighter[:, :, :3] *= 2
    with torch.no_grad():
        one, other = model(volumes)[-1], model(brighter)[-1]
    assert (one.alpha - other.alpha).abs().mean() < 0.01
    ratio = (other.lobes[..., :3] / one.lobes[..., :3].clamp(min=1e-6))[one.lobes[..., :3] > 0.02]
    assert ratio.median() == pytest.approx(2, rel=0.1)


def test_a_warm_start_passes_the_mean_of_state_and_feature():
    model = video_model()
    hidden, feature = (torch.tanh(torch.randn(1, 4, 5, 5, 5)) for _ in range(2))
    with torch.no_grad():
        new = model.sg_gru0(hidden, feature)
    assert (new - (hidden + feature) / 2).abs().mean() < 0.15
