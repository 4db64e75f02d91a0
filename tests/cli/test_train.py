"""`roomlight train`: data, stages and export of a recipe; stopping, continuing, refusals."""

import json
import os
import signal
from pathlib import Path

import pytest
from command_runner import RunCommand

import lamp_rooms
from roomlight.dataset.folder import locked
from roomlight.engine.networks.graphs import SHIPPED, load_part
from roomlight_cli.train import LOCK
from roomlight_export.importing import load_exported
from roomlight_model.checkpoint import load_checkpoint
from roomlight_model.training import loop

LAMPS = f"""[data.lamps]
sequences = 6
seed = 3
shard_size = 6
sequences_per_room = 2
frames = 3
renderer = "{lamp_rooms.NAME}"
"""
CLIPPING = f"""
ships = "run/best.pt"
{LAMPS}[[stages]]
name = "run"
stage = "clipping"
data = ["lamps"]
steps = 3
batch = 2
validate_steps = 1
"""
TINY = """batch = 2
rays = 32
sphere_pixels = 2
sphere_samples = 4
volume_shape = [16, 15, 21]
panorama_height = 16
held_out = 1
bf16 = false
"""
MODELS = f"""
ships = "objects/best.pt"
[data.lamps]
sequences = 8
shard_size = 8
sequences_per_room = 2
frames = 3
renderer = "{lamp_rooms.NAME}"
[[stages]]
name = "views"
stage = "single-sglv"
data = ["lamps"]
steps = 2
model = {{sg = {{channels = 4, full_channels = 4}}, blend = {{channels = 4, full_channels = 4}}}}
{TINY}
[[stages]]
name = "blending"
stage = "single-blend"
start_from = "views/best.pt"
data = ["lamps", "lamps"]
steps = 2
surround_max = 100.0
{TINY}
[[stages]]
name = "recurrent"
stage = "video-joint"
start_from = "blending/model.pt"
data = ["lamps"]
steps = 2
frames = 3
{TINY}
[[stages]]
name = "objects"
stage = "objects"
data = ["lamps"]
steps = 2
batch = 2
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "recipe.toml"
    path.write_text(text)
    return path


@pytest.mark.slow
def test_one_command_makes_data_weights_and_a_model(tmp_path: Path, roomlight: RunCommand) -> None:
    write(tmp_path, CLIPPING)
    done = roomlight("train", "recipe.toml", "--out", "out", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "generating 6 sequences" in done.err
    assert "step 3: held out: loss" in done.err
    assert "out/onnx/clipping: the weights of out/run/best.pt" in done.out
    assert "use them with --parts out/onnx\n" in done.out
    card = load_checkpoint(tmp_path / "out" / "run" / "model.pt").card
    assert (card["steps"], card["stage"]) == (3, "clipping")
    assert [(data["seed"], data["sequences"], data["renderer"]) for data in card["data"]] == [(3, 6, lamp_rooms.NAME)]
    best = load_checkpoint(tmp_path / "out" / "run" / "best.pt")
    graph = load_part(tmp_path / "out" / "onnx" / "clipping", "clipping", provider="cpu")
    assert set(graph.inputs) == {"planes"}
    again = load_exported(tmp_path / "out" / "onnx" / "clipping")
    assert again.card == best.card
    for name, value in again.model.state_dict().items():
        assert value.allclose(best.model.state_dict()[name], rtol=1e-3, atol=1e-6)


@pytest.mark.slow
def test_a_stopped_run_continues_and_a_finished_one_is_kept(
    tmp_path: Path, roomlight: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, CLIPPING)
    advance = loop.Run.advance

    def interrupt(run, batch):
        losses = advance(run, batch)
        if run.step == 2:
            signal.raise_signal(signal.SIGTERM)
        return losses

    with monkeypatch.context() as patched:
        patched.setattr(loop.Run, "advance", interrupt)
        stopped = roomlight("train", "recipe.toml", "--out", "out", cwd=tmp_path)
    assert stopped.code == 128 + signal.SIGTERM, stopped.err
    assert "run: stopped at step 2; the same command continues" in stopped.err
    assert not (tmp_path / "out" / "onnx").exists()
    continued = roomlight("train", "recipe.toml", "--out", "out", "--set", "steps=4", cwd=tmp_path)
    assert "run: 6 examples, step 2 of 4" not in continued.err  # a room is held out
    assert "run: 4 examples, step 2 of 4" in continued.err
    assert load_checkpoint(tmp_path / "out" / "run" / "model.pt").card["steps"] == 4
    finished = roomlight("train", "recipe.toml", "--out", "out", "--set", "steps=4", cwd=tmp_path)
    assert "run: finished" in finished.err
    fewer = roomlight("train", "recipe.toml", "--out", "out", "--set", "steps=2", cwd=tmp_path)
    assert fewer.code == 1
    assert "its run has made 4 steps, and steps is 2" in fewer.err
    refused = roomlight("train", "recipe.toml", "--out", "out", "--set", "seed=9", cwd=tmp_path)
    assert refused.code == 1
    assert "other options (seed)" in refused.err
    write(tmp_path, CLIPPING.replace("steps = 3", 'start_from = "out/run/model.pt"'))
    refused = roomlight("train", "recipe.toml", "--out", "out", "--set", "steps=4", cwd=tmp_path)
    assert refused.code == 1
    assert "out/run: its run started from other weights (start_from); delete the folder" in refused.err
    logged = [json.loads(line) for line in (tmp_path / "out" / "run" / "log.jsonl").read_text().splitlines()]
    assert [entry["step"] for entry in logged if "scores" in entry] == [1, 2, 3, 4]


def test_a_second_run_in_a_folder_is_refused(tmp_path: Path, roomlight: RunCommand) -> None:
    write(tmp_path, CLIPPING)
    with locked(tmp_path / "out", LOCK):
        refused = roomlight("train", "recipe.toml", "--out", "out", cwd=tmp_path)
    assert refused.code == 1
    assert f"out: process {os.getpid()} on " in refused.err
    assert [path.name for path in (tmp_path / "out").iterdir()] == [LOCK]


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        (("", ""), "cats", "one of clipping, depth, objects, single, video"),
        (("", ""), "recipe.toml --set steps", "--set takes NAME=VALUE"),
        (("", ""), "recipe.toml --set steps=soon", "steps is 'soon': Input should be a valid integer"),
        (("", ""), "recipe.toml --device cuda", "use 'cpu'"),
        (("sequences = 6", "sequences = 0"), "recipe.toml", "data lamps: sequences is 0: Input should be"),
        (("sequences = 6", 'sequences = 6\nsplit = "test"'), "recipe.toml", "data lamps: split is 'test'; stages"),
        (("sequences = 6", "rooms = 6"), "recipe.toml", "data lamps: there is no option rooms"),
        (
            ("sequences = 6", 'sequences = 6\npanoramas = "hdris"'),
            "recipe.toml",
            "data/hdris: is no folder; the dataset",
        ),
        (("steps = 3", 'start_from = "shipped/cats"'), "recipe.toml", "stage run: start_from is 'shipped/cats', but"),
        (("steps = 3", 'start_from = "run/best.pt"'), "recipe.toml", "stage run: start_from is 'run/best.pt', but"),
        (
            ('stage = "clipping"', 'stage = "single-sglv"\nheld_out = 0'),
            "recipe.toml",
            "run/best.pt is used, but stage run would score no weights: held_out is 0",
        ),
        (
            (LAMPS, "[data.lamps]\n"),
            "recipe.toml --data mine",
            "mine/lamps: is no dataset, and the recipe does not say",
        ),
    ],
)
def test_what_is_wrong_is_refused_before_any_work(
    change: tuple[str, str],
    arguments: str,
    message: str,
    tmp_path: Path,
    roomlight: RunCommand,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    write(tmp_path, CLIPPING.replace(*change))
    refused = roomlight("train", *arguments.split(), "--out", "out", cwd=tmp_path)
    assert refused.code == (2 if "NAME=VALUE" in message else 1)
    assert message in " ".join(refused.err.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_all_kinds_of_stages_follow_each_other(tmp_path: Path, roomlight: RunCommand) -> None:
    write(tmp_path, MODELS)
    done = roomlight("train", "recipe.toml", "--out", "out", "--data", "data", cwd=tmp_path)
    assert done.code == 0, done.err
    cards = {
        name: load_checkpoint(tmp_path / "out" / name / "model.pt").card for name in ("views", "blending", "recurrent")
    }
    assert cards["blending"]["before"]["stage"] == "single-sglv"
    assert cards["blending"]["examples"] == 12  # six of eight, twice
    assert cards["recurrent"]["before"] == cards["blending"]
    assert {"loss", "log_l2_video", "log_l2_no_rnn"} <= set(cards["recurrent"]["scores"])
    assert len(list((tmp_path / "out" / "recurrent" / "pictures").iterdir())) == 1
    assert load_checkpoint(tmp_path / "out" / "recurrent" / "best.pt").form == "video"
    assert load_part(tmp_path / "out" / "onnx" / "objects", "objects", provider="cpu").inputs
    longer = roomlight("train", "recipe.toml", "--out", "out", "--data", "data", "--set", "steps=3", cwd=tmp_path)
    assert longer.code == 1
    assert "out/blending: its run started from views/best.pt, whose training is not finished; delete" in longer.err
    assert load_checkpoint(tmp_path / "out" / "views" / "model.pt").card == cards["views"]


@pytest.mark.slow
def test_the_shipped_weights_can_be_trained_further(tmp_path: Path, roomlight: RunCommand) -> None:
    stage = (
        MODELS[MODELS.index("[data.lamps]") : MODELS.index("[[stages]]")]
        + f"""
[[stages]]
name = "more"
stage = "single-blend"
start_from = "shipped/single"
data = ["lamps"]
steps = 1
{TINY}"""
    )
    write(tmp_path, 'ships = "more/model.pt"\n' + stage)
    done = roomlight("train", "recipe.toml", "--out", "out", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "the weights of out/more/model.pt (step 1), as ONNX graphs" in done.out
    shipped = load_exported(SHIPPED / "single")
    more = load_checkpoint(tmp_path / "out" / "more" / "model.pt")
    assert more.card["before"] == shipped.card
    before, after = shipped.model.state_dict(), more.model.state_dict()
    assert all(value.equal(before[name]) for name, value in after.items() if name.startswith("sg_"))
    assert any(not value.equal(before[name]) for name, value in after.items() if name.startswith("blend_"))
