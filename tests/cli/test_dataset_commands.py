"""`roomlight dataset` as its users meet it."""

import io
import json
import os
import signal
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
import typer
from command_runner import Finished
from rich.console import Console

import stub_rooms
from roomlight.captures import open_capture
from roomlight.dataset.loader import Dataset
from roomlight.dataset.shards import read_index
from roomlight.images import encode_exr
from roomlight_cli.commands import dataset as dataset_commands
from roomlight_cli.console import stopped_by_signals
from roomlight_cli.generation import cost_text, show_generation
from roomlight_cli.progress import Progress
from roomlight_generator.generate import GenerateReport, GenerationProgress

SMALL = ("--shard-size", "4", "--sequences-per-room", "2", "--frames", "4", "--workers", "1")
STUBBED = f"""
import sys
from roomlight_generator import generate
generate.RENDERER = {stub_rooms.NAME!r}
for name in sys.argv.pop(1).split(","):
    sys.modules[name] = None
from roomlight_cli import console
from roomlight_cli.commands import dataset as dataset_commands
console.run(dataset_commands.app)
"""
BASE_ONLY = "torch,av,onnxruntime,fastapi,uvicorn,lzfse,filelock,onnx,roomlight.captures"


def start(*arguments, cwd, **options):
    """The command with the stand-in renderer, without the modules that training, serving and reading captures need."""
    return subprocess.Popen(
        [sys.executable, "-c", STUBBED, BASE_ONLY, *arguments],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        **options,
    )


@pytest.fixture
def run(monkeypatch, roomlight):
    """`roomlight dataset ...` in this process, with the stand-in renderer."""
    monkeypatch.setattr("roomlight_generator.generate.RENDERER", stub_rooms.NAME)
    return partial(roomlight, "dataset")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A dataset generated without the modules that training, serving and reading captures need."""
    cwd = tmp_path_factory.mktemp("commands")
    with start("generate", "--out", "set [x]", "--sequences", "8", "--seed", "5", *SMALL, cwd=cwd) as process:
        out, err = process.communicate()
    assert process.returncode == 0, err
    return cwd, Finished(0, out, err)


def test_generate_reports_sequences_and_costs(made, run):
    cwd, result = made
    assert "set [x]: 8 train sequences, 0.0" in result.out
    assert "core-seconds each (first half" in result.out
    assert "roomlight dataset preview set [x] --out preview" in result.out
    again = run("generate", "--out", "set [x]", "--sequences", "8", "--seed", "5", *SMALL, cwd=cwd)
    assert "already has 8 train sequences" in again.out
    fewer = run("generate", "--out", "set [x]", "--sequences", "4", "--seed", "5", *SMALL, cwd=cwd)
    assert "already has 8 train sequences" in fewer.out
    other = run("generate", "--out", "set [x]", "--sequences", "8", *SMALL, cwd=cwd)
    assert other.code == 1
    assert "error: set [x]: was generated with seed 5, not 0" in other.err


def test_preview_stats_verify_and_extract(made, tmp_path, run):
    cwd, _ = made
    preview = run("preview", "set [x]", "--rooms", "2", "--out", str(tmp_path / "sheets"), cwd=cwd)
    assert preview.code == 0, preview.err
    assert preview.out.split() == [str(tmp_path / "sheets" / "preview-00.png")]
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "lamp.exr").write_bytes(encode_exr(np.linspace(0, 4, 16 * 32 * 3).reshape(16, 32, 3)))
    light = run("stats", "set [x]", "--against", str(tmp_path / "real"), "--json", str(tmp_path / "l.json"), cwd=cwd)
    assert light.code == 0, light.err
    for word in ("8 sequences", "1 panoramas", "ceiling / floor", "each quartile within 25%"):
        assert word in light.out
    assert json.loads((tmp_path / "l.json").read_text())["panoramas"] == 1
    verify = run("verify", "set [x]", cwd=cwd)
    assert verify.code == 0
    assert "set [x]: 8 sequences" in verify.out
    extract = run("extract", "set [x]", "train-000003", "--out", str(tmp_path / "room"), cwd=cwd)
    assert extract.code == 0, extract.err
    assert len(list(open_capture(tmp_path / "room"))) == 4


@pytest.mark.slow
def test_damage_is_reported_and_repaired(made, tmp_path, run):
    cwd, _ = made
    out = tmp_path / "broken"
    out.mkdir()
    for path in (cwd / "set [x]").iterdir():
        (out / path.name).write_bytes(path.read_bytes())
    tar = out / "train-00001.tar"
    broken = bytearray(tar.read_bytes())
    broken[read_index(tar).entries[1].offset] ^= 1
    tar.write_bytes(broken)
    found = run("verify", str(out), cwd=tmp_path)
    assert found.code == 1
    assert "train-000005" in found.out
    assert "1 damaged, 7 intact" in found.err
    repaired = run("verify", str(out), "--repair", cwd=tmp_path)
    assert repaired.code == 0
    assert "with the dataset's settings makes them again" in repaired.out
    lost = run("verify", str(out), cwd=tmp_path)
    assert lost.code == 1
    assert "7 sequences are intact, but 1 more" in lost.err
    again = run("generate", "--out", str(out), "--sequences", "8", "--seed", "5", *SMALL, cwd=tmp_path)
    assert "1 made in" in again.out
    assert run("verify", str(out), cwd=tmp_path).code == 0


@pytest.mark.parametrize(
    "arguments", [("stats", "--against", "x"), ("preview",), ("verify",), ("extract", "x", "--out", "o")]
)
def test_a_folder_without_a_dataset_is_one_line(arguments, tmp_path, run):
    result = run(arguments[0], "no", *arguments[1:], cwd=tmp_path)
    assert result.code == 1
    assert "error: no: is not a dataset" in result.err


@pytest.mark.parametrize("command", ["preview", "stats --against real", "prior --out prior"])
def test_a_split_without_sequences_is_named(command, made, run):
    name, *options = command.split()
    result = run(name, "set [x]", *options, "--split", "test", cwd=made[0])
    assert (result.code, result.out) == (1, "")
    assert "error: set [x]: has no sequence of the split test; give another --split" in result.err


def test_a_prior_is_written_if_its_folder_can_be(made, tmp_path, run, monkeypatch):
    (tmp_path / "file").write_text("held")
    with monkeypatch.context() as patch:
        patch.setattr(Dataset, "read", lambda *_, **__: pytest.fail("the dataset was read"))
        refused = run("prior", "set [x]", "--out", str(tmp_path / "file"), cwd=made[0])
    assert refused.code == 1
    assert "file/prior/prior.npz: cannot be written" in refused.err
    fitted = run("prior", "set [x]", "--out", str(tmp_path / "new"), cwd=made[0])
    assert fitted.code == 0, fitted.err
    assert {path.name for path in (tmp_path / "new" / "prior").iterdir()} == {"prior.npz", "model.json"}
    assert f"use it with --parts {tmp_path / 'new'}" in fitted.out


def test_a_prior_is_not_fitted_to_views_without_probes(tmp_path, run):
    stub_rooms.make_dataset(tmp_path / "views", 2, renderer=stub_rooms.VIEWS)
    refused = run("prior", "views", "--out", "new", cwd=tmp_path)
    assert refused.code == 1
    assert "error: views: no sequence has probes to fit to" in refused.err


@pytest.mark.slow
def test_ctrl_c_stops_and_the_same_command_continues(tmp_path, monkeypatch, run):
    monkeypatch.setenv("STUB_ROOMS", str(tmp_path))
    (tmp_path / "steer.json").write_text(json.dumps({"gate": [1, 0]}))
    for name in ("reached", "go"):
        os.mkfifo(tmp_path / name)
    command = ("generate", "--out", "set", "--sequences", "8", *SMALL)
    # a shell's background jobs ignore Ctrl-C, and what they start does too
    defaults = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.default_int_handler)}
    with start(*command, cwd=tmp_path, **defaults) as process, (tmp_path / "reached").open() as reached:
        assert reached.readline() == "here\n"
        process.send_signal(signal.SIGINT)
        _, err = process.communicate()
    assert process.returncode == 130
    assert "stopped; finished sequences are kept" in err
    assert "Traceback" not in err
    (tmp_path / "steer.json").unlink()
    again = run(*command, cwd=tmp_path)
    assert "8 train sequences" in again.out
    assert "6 made in" in again.out


def test_a_signal_that_ends_a_command_is_answered(capsys):
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(typer.Exit) as ended, stopped_by_signals(lambda: "all is kept"):
        signal.raise_signal(signal.SIGTERM)
    assert ended.value.exit_code == 128 + signal.SIGTERM
    assert capsys.readouterr().err == "stopped; all is kept\n"
    assert signal.getsignal(signal.SIGTERM) == before


def test_the_state_of_a_run_is_a_line_with_rate_cost_and_time_left():
    stream = io.StringIO()
    with Progress("generating", Console(file=stream, width=120, highlight=False)) as progress:
        show = show_generation(progress)
        show(GenerationProgress(10, 2, 0, 5_000_000, 0.0, 0.0))
        assert progress.line() == "generating (5 MB) 2 of 10, 0:00"
        show(GenerationProgress(10, 3, 1, 8_000_000, 11.0, 6.0, "a [worker] died"))
        show(GenerationProgress(10, 10, 8, 30_000_000, 96.0, 48.0))
        assert progress.line() == "generating (30 MB, 600 per hour, 0:00 left, 12.0 core-seconds each) 10 of 10, 0:00"
    assert stream.getvalue() == "note: a [worker] died\n"


def test_costs_show_whether_they_grow():
    assert cost_text([10.0]) == "10.0 core-seconds each"
    assert cost_text([10.0, 11.0, 13.0]) == "11.3 core-seconds each (first half 10.0, second 12.0)"


def test_generate_names_the_panoramas_of_each_split(run, monkeypatch, tmp_path):
    for name in ("barn", "lounge", "hall_1", "hall_2", "cellar", "shed", "studio"):
        (tmp_path / f"{name}.exr").write_bytes(encode_exr(np.ones((16, 32, 3), np.float32)))
    asked = []

    def generated(_out, options, **_):
        asked.append(options)
        return GenerateReport(3, 3, 0, 0, 0.0, ())

    monkeypatch.setattr(dataset_commands, "run_generator", generated)
    result = run("generate", "--out", "x", "--sequences", "3", "--panoramas", str(tmp_path), "--furniture-share", "0.2")
    assert result.code == 0, result.err
    used, kept = result.out.splitlines()[:2]
    assert "of 7 panoramas light the train rooms: " in used
    assert kept.startswith("kept for the other split, whole buildings each: ")
    named = [*used.split(": ")[-1].split(", "), *kept.split(": ")[-1].split(", ")]
    assert sorted(named) == ["barn", "cellar", "hall_1", "hall_2", "lounge", "shed", "studio"]
    assert ("hall_1" in used) == ("hall_2" in used)
    assert (asked[0].panoramas, asked[0].furniture_share) == (tmp_path, 0.2)
