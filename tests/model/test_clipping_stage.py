"""The stage `clipping`: its frames, its batches, that it learns."""

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch

import lamp_rooms
import stub_rooms
from roomlight.engine.networks.clipping import SIDE
from roomlight.errors import DatasetError, ModelError
from roomlight_model.checkpoint import Checkpoint, load_checkpoint
from roomlight_model.clipping_network import ClippingNetwork
from roomlight_model.config import ModelConfig
from roomlight_model.object_light_network import ObjectLightNetwork
from roomlight_model.training.clipping import CLIPPED, ClippingFrames, ClippingOptions, ClippingStage, clipping_batch
from roomlight_model.training.loop import Run
from tiny_stages import keys_of_batch

SHORT = ClippingOptions(steps=24, batch=2, learning_rate=2e-3, warm_up=12, ema=0.5, seed=1, validate_steps=100)


def lamp_frames(count: int, *, bright: float = 9.0) -> ClippingFrames:
    """Frames of a lamp on a grey wall; how bright the wall is says how bright the lamp is."""
    rng = np.random.default_rng(2)
    radiance = np.empty((count, 3, SIDE, SIDE), np.float16)
    for number in range(count):
        wall = rng.uniform(0.1, 0.5)
        radiance[number] = wall
        row, column = rng.integers(30, 100, 2)
        radiance[number, :, row : row + 30, column : column + 30] = bright * wall + 1
    geometry = np.zeros((count, 7, SIDE, SIDE), np.float16)
    geometry[:, 0] = 1
    geometry[:, 3] = rng.uniform(-1, 1, (count, 1, 1))
    geometry[:, 0, :20] = 0
    return ClippingFrames(radiance, geometry)


def test_batches_hold_what_a_camera_shows_and_the_truth() -> None:
    frames = lamp_frames(3).take([0, 2])
    batch = clipping_batch(frames)
    assert batch.planes.shape == (2, 11, SIDE, SIDE)
    assert batch.planes[:, :3].max() <= 1
    clipped = torch.from_numpy(frames.radiance.astype(np.float32)).amax(1) >= CLIPPED
    assert (batch.planes[:, 3].bool() == (clipped & (batch.planes[:, 4] > 0))).all()
    assert (batch.planes[:, :4, :20] == 0).all()  # outside the frame
    assert ((batch.weight > 0) <= (batch.truth.amax(1, keepdim=True) >= CLIPPED)).all()
    assert batch.truth.amax() == pytest.approx(float(frames.radiance.max()), rel=1e-3)


def test_exposure_and_mirroring_keep_the_truth_consistent() -> None:
    """Whatever is drawn: clipped pixels are those at white, and their truth is above it."""
    frames, mirrored = lamp_frames(2), 0
    for seed in range(12):
        batch = clipping_batch(frames, np.random.default_rng(seed))
        marked = batch.planes[:, 3] > 0
        assert (batch.planes[:, :3].amax(1)[marked] >= CLIPPED).all()
        assert (batch.truth.amax(1, keepdim=True)[batch.weight > 0] >= CLIPPED).all()
        mirrored += int(torch.sign(batch.planes[0, 7, 50, 50]) != np.sign(frames.geometry[0, 3, 50, 50]))
    assert 0 < mirrored < 12


def test_held_out_frames_need_clipped_pixels() -> None:
    dark = ClippingFrames(np.zeros((2, 3, SIDE, SIDE), np.float16), np.zeros((2, 7, SIDE, SIDE), np.float16))
    with pytest.raises(DatasetError, match="none of the 2 held-out frames has a clipped pixel"):
        ClippingStage(SHORT, lamp_frames(2), dark)


def test_each_held_out_frame_counts_alike() -> None:
    """Of 17 frames the last one, which is scored in a part of its own, is another."""
    frames, network = lamp_frames(2, bright=100), ClippingNetwork().eval()
    frames.radiance[1] *= np.float16(20)
    many, one, other = (
        ClippingStage(SHORT, frames, frames.take(numbers)).scores(network) for numbers in ([0] * 16 + [1], [0], [1])
    )
    assert many == {name: pytest.approx((16 * one[name] + other[name]) / 17, rel=1e-3) for name in one}


@pytest.mark.slow
def test_it_learns_what_its_frames_show(tmp_path: Path) -> None:
    stage = ClippingStage(SHORT, lamp_frames(8, bright=40.0), lamp_frames(3, bright=40.0))
    run = Run(stage, tmp_path / "run")
    before = stage.scores(cast(ClippingNetwork, run.averaged()))["loss"]
    run.train()
    after = load_checkpoint(tmp_path / "run" / "best.pt").card["scores"]
    assert after["loss"] < 0.6 * before
    assert all(np.isfinite(value) for value in after.values())


def test_it_starts_from_weights_of_its_own_form() -> None:
    frames = lamp_frames(2)
    weights = Checkpoint("clipping", ModelConfig(), ClippingNetwork(), {"steps": 3})
    stage = ClippingStage(replace(SHORT, seed=9), frames, frames, start_from=weights)
    assert stage.start_from is weights
    assert all(v.equal(weights.model.state_dict()[k]) for k, v in stage.network().state_dict().items())
    with pytest.raises(ModelError, match="cannot start from objects weights; give `start_from` clipping"):
        ClippingStage(SHORT, frames, frames, start_from=Checkpoint("objects", ModelConfig(), ObjectLightNetwork(), {}))


@pytest.mark.slow
def test_frames_hold_the_true_radiance(tmp_path: Path) -> None:
    progress: list[tuple[int, int]] = []
    lamps = stub_rooms.make_dataset(tmp_path, 6, shard_size=6, frames=3, renderer=lamp_rooms.NAME)
    frames = ClippingFrames.read([lamps], seed=0, progress=lambda *state: progress.append(state))
    assert progress[-1] == (6, 6)
    assert len(frames) == 6
    assert frames.radiance.max() == pytest.approx(lamp_rooms.LAMP)
    assert (frames.radiance >= 2).any(axis=1).mean() == pytest.approx(0.75 * 80 / 768, rel=0.3)  # the lamp's area
    assert np.array_equal(ClippingFrames.read([lamps], seed=0).geometry, frames.geometry)


def test_recordings_without_the_truth_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no sequence holds the radiance of clipped pixels"):
        ClippingFrames.read([stub_rooms.make_dataset(tmp_path, 2)], seed=0)


def test_a_batch_has_a_random_stream_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = keys_of_batch(ClippingStage(SHORT, lamp_frames(3), lamp_frames(1)), monkeypatch)
    assert len(set(keys)) == len(keys) >= 4
