"""`roomlight train`: held-out rooms, curves, pictures, stopping and continuing."""

import json
from dataclasses import replace
from typing import Any

import pytest
from rich.console import Console

import stub_rooms
from recordings import BoxRecordings
from roomlight.engine.networks.graphs import SHIPPED
from roomlight.errors import OptionError
from roomlight_cli.train import train
from roomlight_export.importing import load_exported
from roomlight_generator.generate import GenerateOptions, generate
from roomlight_model.checkpoint import load_checkpoint
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.training.options import OPTIONS as OPTIONS_FILE
from roomlight_model.training.options import TrainOptions
from roomlight_model.training.subsets import train_val_split

OPTIONS = TrainOptions(
    steps=4, batch=2, warm_up=2, rays=32, sphere_pixels=2, sphere_samples=4, volume_shape=(16, 15, 21),
    panorama_height=16, bf16=False,
    model=ModelConfig(sg=SGConfig(channels=4, full_channels=4), blend=BlendConfig(channels=4, full_channels=4)),
)  # fmt: skip


def run(tmp_path, options=OPTIONS, **changes):
    arguments = {"device": "cpu", "start_from": None, "minutes": None, "every_steps": 2} | changes
    training, held_out = train_val_split([BoxRecordings(6)])
    return train(options, training, tmp_path / "run", held_out=held_out, console=Console(quiet=True), **arguments)


def test_a_run_leaves_weights_curves_and_pictures(tmp_path):
    card = run(tmp_path)
    assert card["steps"] == 4
    assert card["sequences"] == 5  # one of six is held out
    folder = tmp_path / "run"
    card = load_checkpoint(folder / "model.pt").card
    assert card["steps"] == 4
    assert sorted(path.name for path in (folder / "pictures").iterdir()) == ["0000002.png", "0000004.png"]
    assert any((folder / "tensorboard").iterdir())
    assert [json.loads(line)["step"] for line in (folder / "log.jsonl").read_text().splitlines()] == [4]


@pytest.mark.slow
def test_the_next_stage_starts_from_the_one_before(tmp_path):
    run(tmp_path)
    weights = load_checkpoint(tmp_path / "run" / "model.pt")
    card = train(
        replace(OPTIONS, stage="single-blend", model=ModelConfig()), BoxRecordings(5), tmp_path / "blend",
        held_out=BoxRecordings(1), device="cpu", start_from=tmp_path / "run" / "model.pt", minutes=None,
        every_steps=100, console=Console(quiet=True),
    )  # fmt: skip
    assert card["options"]["model"]["sg"]["channels"] == 4  # the network is that of the first stage
    assert (card["before"]["stage"], card["before"]["steps"]) == ("single-sglv", 4)
    after = load_checkpoint(tmp_path / "blend" / "model.pt")
    before = weights.model.state_dict()
    assert all(value.equal(before[name]) for name, value in after.model.state_dict().items() if name.startswith("sg_"))


@pytest.mark.slow
def test_the_recurrent_form_starts_from_single_view_weights(tmp_path):
    run(tmp_path)
    options = replace(OPTIONS, stage="video-joint", steps=2, frames=3, model=ModelConfig())
    card = train(
        options, BoxRecordings(5), tmp_path / "video", held_out=BoxRecordings(1), device="cpu",
        start_from=tmp_path / "run" / "model.pt", minutes=None, every_steps=1, console=Console(quiet=True),
    )  # fmt: skip
    assert (card["stage"], card["steps"], card["before"]["stage"]) == ("video-joint", 2, "single-sglv")
    best = load_checkpoint(tmp_path / "video" / "best.pt")
    assert best.form == "video"
    card = best.card
    assert isinstance(card["scores"], dict)
    scores = card["scores"]
    assert {"log_l2_video", "log_l2_no_rnn", "smoothness_video", "log_l2_video_01_07"} <= set(scores)
    assert len(list((tmp_path / "video" / "pictures").iterdir())) == 2


@pytest.mark.slow
def test_the_shipped_weights_can_be_trained_further(tmp_path):
    options = replace(OPTIONS, stage="single-blend", steps=1)
    card = run(tmp_path, options, start_from=SHIPPED / "single", every_steps=10)
    shipped = load_exported(SHIPPED / "single")
    assert card["before"] == shipped.card
    before, after = shipped.model.state_dict(), load_checkpoint(tmp_path / "run" / "model.pt").model.state_dict()
    assert before.keys() == after.keys()
    assert all(value.equal(before[name]) for name, value in after.items() if name.startswith("sg_"))
    assert any(not value.equal(before[name]) for name, value in after.items() if name.startswith("blend_"))


@pytest.mark.slow
def test_sequences_finished_meanwhile_are_used(tmp_path):
    training, held_out = train_val_split([BoxRecordings(4)])
    grown, _ = train_val_split([BoxRecordings(9)], 1)
    card = train(
        OPTIONS, training, tmp_path / "run", held_out=held_out, device="cpu", start_from=None, minutes=None,
        every_steps=2, console=Console(quiet=True), grow=lambda: training.replace_by(grown),
    )  # fmt: skip
    assert card["sequences"] == 8


@pytest.mark.slow
def test_the_best_weights_on_held_out_rooms_are_kept(tmp_path):
    run(tmp_path)
    best: dict[str, Any] = load_checkpoint(tmp_path / "run" / "best.pt").card
    assert best["steps"] in (2, 4)
    assert best["held_out"] > 0
    assert best["scores"]["log_l2_sglv"] + 0.3 * best["scores"]["rendering_sglv"] == pytest.approx(best["held_out"])
    assert {"mean_colour", "warp"} <= {name.removeprefix("log_l2_") for name in best["scores"]}


@pytest.mark.slow
def test_a_run_out_of_time_stops_and_continues(tmp_path):
    assert run(tmp_path, minutes=0.0)["steps"] == 0
    assert run(tmp_path)["steps"] == 4


def test_held_out_rooms_are_not_trained_on():
    training, held_out = train_val_split([BoxRecordings(200), BoxRecordings(40)])
    assert (len(training), len(held_out)) == (192, 48)
    assert held_out.read(0, frames=[0]).name == "box-0"
    assert training.read(0, frames=[0]).name == "box-48"
    assert training.read(152, frames=[0]).name == "box-0"  # of the second folder
    assert [len(part) for part in train_val_split([BoxRecordings(3)])] == [3, 0]


@pytest.mark.slow
def test_a_continued_run_keeps_its_held_out_rooms(tmp_path, roomlight):
    data, out = tmp_path / "data", tmp_path / "run"
    for steps, sequences in ((1, 8), (2, 16)):
        generate(data, GenerateOptions(sequences, shard_size=8, frames=1, renderer=stub_rooms.NAME), workers=1)
        options = ["--stage", "single-sglv", "--steps", str(steps), "--batch", "1"]
        result = roomlight("train", data, "--out", out, *options)
        assert result.code == 0, result.err
        card = load_checkpoint(out / "model.pt").card
        assert (card["steps"], card["sequences"]) == (steps, sequences - 2)
    assert TrainOptions.read(out / OPTIONS_FILE).held_out == 2


def test_a_missing_gpu_is_an_option_error(tmp_path, monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(OptionError, match="use 'cpu'"):
        run(tmp_path, device="cuda")
