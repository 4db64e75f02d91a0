"""Back-propagation through time in the video stages: gradients, units, and the loss over a sequence."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from present import present
from roomlight_model.training import video
from roomlight_model.training.video import Unroll
from tiny_stages import WALKS, box_walk, dimmed, video_stage, walk_batch

STAGES = ["video-sglv", "video-blend", "video-joint"]


def batch_of(options, *, length=3, change_light=None):
    changes = change_light is not None
    walk = box_walk(np.random.default_rng(0), length=length, augment=changes, change_light=change_light)
    return walk_batch(walk, height=None if options.stage == "video-sglv" else options.panorama_height)


def video_model():
    return video_stage().network()


def unroll_of(model, batch, options):
    return Unroll(model, batch, options, generator=torch.Generator().manual_seed(0))


def gradients(model, batch, options):
    """The mean losses of a batch and the gradients of their total."""
    stage = video_stage(options)
    names = [name for name, weight in stage.network().named_parameters() if weight.requires_grad]
    trained = [model.get_parameter(name) for name in names]
    losses = stage.losses(model, batch, torch.Generator().manual_seed(0))
    found = torch.autograd.grad(losses["loss"], trained, allow_unused=True)
    return {name: value.detach() for name, value in losses.items()}, dict(zip(names, found, strict=True))


@pytest.mark.parametrize("stage", STAGES[1:])
def test_recomputed_gradients_are_those_of_a_plain_pass(stage, monkeypatch):
    options = replace(WALKS, stage=stage)
    model, batch = video_model(), batch_of(options)
    losses, recomputed = gradients(model, batch, options)
    monkeypatch.setattr(video, "_recomputed", lambda step, given, state: step(given, state))
    plain_losses, plain = gradients(model, batch, options)
    torch.testing.assert_close(losses, plain_losses)
    assert any(gradient is not None and gradient.any() for gradient in plain.values())
    for name, gradient in plain.items():
        torch.testing.assert_close(recomputed[name], gradient, rtol=1e-4, atol=1e-8)


def test_gradients_agree_with_finite_differences():
    options = replace(WALKS, stage="video-sglv")
    model, batch = video_model(), batch_of(options, length=3)
    bias = present(model.sg_decoder.heads.bias)
    _, found = gradients(model, batch, options)
    gradient = present(found["sg_decoder.heads.bias"])
    step, totals = 1e-2, []
    for sign in (1, -1):
        with torch.no_grad():
            bias[1] += sign * step
            sequence = unroll_of(model, batch, options)
            totals.append(float(torch.stack([sequence.advance(frame)["loss"] for frame in (1, 2)]).mean()))
            bias[1] -= sign * step
    assert (totals[0] - totals[1]) / (2 * step) == pytest.approx(float(gradient[1]), rel=0.05)


def test_the_loss_is_the_sum_of_its_three_parts():
    for stage in STAGES:
        options = replace(WALKS, stage=stage, smoothness_weight=2.0)
        with torch.no_grad():
            losses = unroll_of(video_model(), batch_of(options, length=2), options).advance(1)
        assert losses["smoothness"] > 0
        total = losses["log_l2"] + 0.3 * losses["rendering"] + 2 * losses["smoothness"]
        torch.testing.assert_close(losses["loss"], total, rtol=1e-5, atol=0)


def test_smoothness_compares_consecutive_panoramas():
    options = replace(WALKS, stage="video-blend")
    batch = batch_of(options)
    unroll = unroll_of(video_model(), batch, options)
    with torch.no_grad():
        assert unroll.probe_state is not None
        before = unroll.probe_state.panorama.radiance
        losses = unroll.advance(1)
        after = unroll.probe_state.panorama.radiance
    expected = (torch.log1p(after) - torch.log1p(before)).square().mean()
    torch.testing.assert_close(losses["smoothness"], expected)


def test_a_frame_is_compared_with_its_own_light():
    """Where the light changes, so does the truth of the loss."""
    options = replace(WALKS, stage="video-blend")
    batch = batch_of(options, length=4, change_light=dimmed)
    model = video_model()
    constant = replace(batch, light_of=torch.zeros_like(batch.light_of))
    logs = []
    for given in (batch, constant):
        unroll = unroll_of(model, given, options)
        with torch.no_grad():
            logs.append([float(unroll.advance(frame)["log_l2"]) for frame in (1, 2, 3)])
    assert logs[0][0] == logs[1][0]
    assert logs[0][1] != logs[1][1]


def test_blending_stages_need_the_probes_views():
    options = replace(WALKS, stage="video-blend")
    batch = replace(batch_of(options), detail=None)
    with pytest.raises(ValueError, match="with_views"):
        unroll_of(video_model(), batch, options)


def test_the_first_frames_unit_stays_when_frames_darken():
    model = video_model()
    batch = batch_of(replace(WALKS, stage="video-sglv"), length=3)
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
    batch = batch_of(replace(WALKS, stage="video-sglv"), length=2)
    volumes = batch.volume.clone()
    volumes[:, :, :3] *= 0.4  # below white: fills stop there
    brighter = volumes.clone()
    brighter[:, :, :3] *= 2
    with torch.no_grad():
        states = [model.step(given[:, 1], model.start(given[:, 0])) for given in (volumes, brighter)]
    one, other = (state.volume for state in states)
    assert (one.alpha - other.alpha).abs().mean() < 0.01
    ratio = (other.lobes[..., :3] / one.lobes[..., :3].clamp(min=1e-6))[one.lobes[..., :3] > 0.02]
    assert ratio.median() == pytest.approx(2, rel=0.1)


def test_a_warm_start_passes_the_mean_of_state_and_feature():
    model = video_model()
    hidden, feature = (torch.tanh(torch.randn(1, 4, 5, 5, 5)) for _ in range(2))
    with torch.no_grad():
        new = model.sg_gru0(hidden, feature)
    assert (new - (hidden + feature) / 2).abs().mean() < 0.15
