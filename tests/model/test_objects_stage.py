"""The stage `objects`: its examples, its errors beside the evaluation's, that it learns."""

from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch

import lamp_rooms
import stub_rooms
from roomlight.conventions import panorama_directions
from roomlight.engine.lighting import LIGHTING_PANELS
from roomlight.engine.panorama.panels import BRIGHTEST, HEIGHT
from roomlight.errors import ModelError
from roomlight_evaluation.objects.lit_objects import LitObjects
from roomlight_model.checkpoint import Checkpoint, load_checkpoint
from roomlight_model.clipping_network import ClippingNetwork
from roomlight_model.config import ModelConfig
from roomlight_model.object_light_network import ObjectLightNetwork
from roomlight_model.training.loop import Run
from roomlight_model.training.objects import (
    MATERIALS,
    ObjectsOptions,
    ObjectsStage,
    ProbePanels,
    brightness_errors,
    object_light,
    panels_batch,
    picture_errors,
    reduced_truth,
)
from tiny_stages import keys_of_batch

EVALUATED = ("diffuse", "glossy")
SHORT = ObjectsOptions(steps=24, batch=2, learning_rate=1e-3, warm_up=6, ema=0.5, seed=1, validate_steps=100)


def half_rooms(count):
    """Panoramas of which one half is observed; the other is half as bright in log(1 + L) as the fill says."""
    rng = np.random.default_rng(3)
    panels = np.zeros((count, LIGHTING_PANELS, HEIGHT, 2 * HEIGHT), np.float16)
    truth = np.zeros((count, 3, HEIGHT, 2 * HEIGHT), np.float16)
    for number in range(count):
        light = rng.uniform(0.5, 2.0)
        panels[number, :3, :, :HEIGHT] = light
        panels[number, 3, :, :HEIGHT] = 1
        panels[number, 5, :, :HEIGHT] = 2
        panels[number, 6:9] = truth[number] = light
        truth[number, :, :, HEIGHT:] = np.expm1(np.log1p(light) / 2)
    return ProbePanels(panels, truth)


def test_light_of_objects_keeps_what_was_measured():
    """What was seen stays, unless it is an estimate for clipped pixels."""
    examples = half_rooms(1)
    examples.panels[:, 9, : HEIGHT // 2, :HEIGHT] = 10 * examples.panels[:, 6, : HEIGHT // 2, :HEIGHT]
    panels = panels_batch(examples).panels

    class Brighter(torch.nn.Module):
        def forward(self, panels):
            return torch.full_like(panels[:, :3], 0.5)

    with torch.no_grad():
        gain = torch.log1p(object_light(Brighter(), panels)) - torch.log1p(panels[:, 6:9])
    assert torch.allclose(gain[..., HEIGHT // 2 :, :HEIGHT], torch.zeros(1), atol=1e-5)
    assert torch.allclose(gain[..., : HEIGHT // 2, :HEIGHT], torch.tensor(0.5), atol=1e-5)
    assert torch.allclose(gain[..., HEIGHT:], torch.tensor(0.5), atol=1e-5)


def test_errors_of_objects_are_those_of_the_evaluation():
    """Seen from six sides: the training has normals all around, and lobes instead of a microfacet."""
    rng = np.random.default_rng(1)
    directions = panorama_directions(HEIGHT)
    truth, other = (
        np.exp(-1.2 + directions @ rng.normal(0, 0.25, 3))[..., None] * np.ones(3) * scale for scale in (1.0, 1.3)
    )
    as_tensors = [torch.from_numpy(np.moveaxis(one, -1, 0)[None].astype(np.float32)) for one in (truth, other)]
    ours = picture_errors(as_tensors[1], as_tensors[0])[0].tolist()
    axes = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    views = [LitObjects(truth, (s * x, s * y, s * z)).errors(other) for x, y, z in axes for s in (-1, 1)]
    wanted = {name: float(np.sqrt(np.mean([view[name] ** 2 for view in views]))) for name in EVALUATED}
    ours_by_material = dict(zip(MATERIALS, ours, strict=True))
    for name in EVALUATED:
        error = ours_by_material[name]
        assert error == pytest.approx(wanted[name], rel=0.25, abs=5e-3), name


def test_light_beyond_white_is_no_error_and_still_has_a_gradient():
    truth = torch.full((1, 3, HEIGHT, 2 * HEIGHT), 5.0)
    assert picture_errors(2 * truth, truth)[0].tolist() == pytest.approx([0] * 3, abs=4e-3)
    bright = torch.full_like(truth, 3.0).requires_grad_()
    picture_errors(bright, torch.full_like(truth, 0.3)).sum().backward()
    assert bright.grad is not None
    assert (bright.grad > 0).all()


def test_half_and_twice_as_bright_cost_the_same():
    truth = torch.full((2, 3, HEIGHT, 2 * HEIGHT), 3.0)
    darker, brighter = brightness_errors(truth * 0.5, truth), brightness_errors(truth * 2, truth)
    assert darker.tolist() == pytest.approx([np.log(2)] * 2, rel=0.01)
    assert brighter.tolist() == pytest.approx(darker.tolist(), rel=0.01)


def test_augmented_panoramas_stay_consistent():
    """Observed pixels show the truth in every channel, at any rotation."""
    for seed in range(8):
        batch = panels_batch(half_rooms(2), np.random.default_rng(seed))
        known = (batch.panels[:, 3:4] == 1).expand(-1, 3, -1, -1)
        assert known.float().mean() == pytest.approx(0.5)
        assert torch.allclose(batch.panels[:, :3][known], batch.truth[known], rtol=1e-3)
        assert torch.allclose(batch.panels[:, 6:9][known], batch.truth[known], rtol=1e-3)


@pytest.mark.slow
def test_it_learns_what_its_examples_show(tmp_path):
    stage = ObjectsStage(SHORT, half_rooms(6), half_rooms(2))
    run = Run(stage, tmp_path / "run")
    before = stage.scores(cast(ObjectLightNetwork, run.averaged()))["loss"]
    run.train()
    after = load_checkpoint(tmp_path / "run" / "best.pt").card["scores"]
    assert set(after) == {"loss", *MATERIALS}
    assert after["loss"] < 0.3 * before
    assert all(np.isfinite(value) for value in after.values())


def test_other_weights_are_refused():
    weights = Checkpoint("clipping", ModelConfig(), ClippingNetwork(), {})
    with pytest.raises(ModelError, match="stage objects cannot start from clipping weights"):
        ObjectsStage(SHORT, half_rooms(2), half_rooms(1), start_from=weights)


def test_streams_hold_what_was_seen_and_the_truth(tmp_path: Path) -> None:
    dataset = stub_rooms.make_dataset(tmp_path, 2, renderer=lamp_rooms.NAME)
    examples = ProbePanels.read([dataset], seed=0, streams=1, models=["classical"])
    assert len(examples) >= 4  # two probes of two recordings, one or two moments
    assert 0 < examples.panels[:, 3].astype(np.float32).mean() < 1
    assert np.isfinite(examples.truth).all()


@pytest.mark.parametrize("rows", [60, 90, 120, 240])
def test_reduced_truth_keeps_the_energy(rows: int) -> None:
    """A small lamp too, and at heights that are no multiple of the network's."""
    truth = np.full((rows, 2 * rows, 3), np.float32(0.25))
    truth[rows - 8, 2 * rows - 5] = 400.0
    reduced = reduced_truth(truth)
    assert reduced.shape == (3, 60, 120)
    assert reduced.astype(np.float32).mean() == pytest.approx(float(truth.mean()), rel=2e-3)  # half precision


def test_reduced_truth_of_the_sun_keeps_its_hue() -> None:
    truth = np.zeros((120, 240, 3), np.float32)
    truth[:2, :2] = (4e5, 2e5, 1e5)
    assert reduced_truth(truth)[:, 0, 0].tolist() == [BRIGHTEST, BRIGHTEST / 2, BRIGHTEST / 4]


def test_a_batch_has_a_random_stream_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = keys_of_batch(ObjectsStage(SHORT, half_rooms(3), half_rooms(1)), monkeypatch)
    assert len(set(keys)) == len(keys) >= 4
