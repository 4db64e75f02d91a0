"""The command as a person meets it: help, errors in one line, Ctrl-C, and the demo from end to end."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from roomlight.sample import sample_capture
from roomlight_cli import main as cli
from roomlight_cli import replay
from roomlight_evaluation.evaluate import evaluate_predictions


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from roomlight_cli.main import main; main()", *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


def test_help_names_every_command(tmp_path):
    result = run("--help", cwd=tmp_path)
    assert result.returncode == 0
    for command in ("replay", "demo", "eval", "export", "bench"):
        assert command in result.stdout


def test_version(tmp_path):
    assert run("--version", cwd=tmp_path).stdout.startswith("roomlight 0.")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("replay", "nowhere", "--out", "out"), "nowhere"),
        (("replay", ".", "--out", "out"), "roomlight"),
        (("eval", "nowhere"), "nowhere"),
        (("export", "nothing.pt", "--out", "model"), "nothing.pt"),
    ],
)
def test_an_error_is_one_line_with_the_path_and_no_traceback(arguments, says, tmp_path):
    result = run(*arguments, cwd=tmp_path)
    assert result.returncode == 1
    assert "error:" in result.stderr
    assert says in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("option", "says"),
    [
        (("--probe", "1,2"), "X,Y,Z"),
        (("--probe", "a,b,c"), "X,Y,Z"),
        (("--height", "3"), "--height"),
        (("--height", "3000"), "2048"),
        (("--max-frames", "0"), "--max-frames"),
        (("--probe", "0,1,0", "--probes-from-capture"), "not both"),
        (("--interpolate",), "--interpolate fills in"),
        (("--model", "classical", "--weights", "w"), "no networks"),
        (("--model", "magic"), "magic"),
        (("--world-up", "1,2"), "three numbers"),
    ],
)
def test_a_bad_argument_is_a_usage_error(option, says, tmp_path):
    result = run("replay", str(sample_capture()), "--out", "out", *option, cwd=tmp_path)
    assert result.returncode == 2
    assert says in result.stderr
    assert not (tmp_path / "out").exists()


def test_late_questions_cannot_be_put_to_files(tmp_path):
    result = run("eval", str(sample_capture()), "--late", "--predictions", ".", cwd=tmp_path)
    assert result.returncode == 2
    assert "--late asks the engine" in result.stderr


def test_names_that_look_like_markup_are_printed_as_they_are(tmp_path):
    result = run("replay", "a [bold]room[/x]", "--out", "out", cwd=tmp_path)
    assert result.returncode == 1
    assert "error: a [bold]room[/x]: there is no such file" in result.stderr


def test_predictions_of_every_tenth_frame_are_scored_as_such(tmp_path):
    sample = str(sample_capture())
    made = run(
        "replay", sample, "--out", "out [/y]", "--probes-from-capture", "--every", "10", "--height", "16", cwd=tmp_path
    )
    assert made.returncode == 0, made.stderr
    assert "Look at out [/y]/summary.png" in made.stdout
    assert "4 frames, 3 probes" in made.stdout
    missing = run("eval", sample, "--predictions", "out [/y]", cwd=tmp_path)
    assert missing.returncode == 1
    assert "--every" in missing.stderr
    scored = run("eval", sample, "--predictions", "out [/y]", "--every", "10", cwd=tmp_path)
    assert scored.returncode == 0, scored.stderr
    assert "predictions" in scored.stdout


@pytest.mark.parametrize("model", ["video", "single"])
def test_a_model_without_trained_weights_is_refused_by_name(model, tmp_path):
    from roomlight.engine.graphs import SHIPPED

    if (SHIPPED / model / "model.json").is_file():  # the weights came: then it must simply work
        arguments = ("replay", str(sample_capture()), "--out", "o", "--model", model, "--max-frames", "1")
        assert run(*arguments, cwd=tmp_path).returncode == 0
        return
    result = run("replay", str(sample_capture()), "--out", "out", "--model", model, cwd=tmp_path)
    assert result.returncode == 1
    assert "no trained weights" in result.stderr
    assert "classical" in result.stderr


def test_ctrl_c_stops_cleanly_and_the_same_command_continues(tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    argv = ["roomlight", "replay", str(sample_capture()), "--out", str(out), "--max-frames", "4", "--height", "16"]
    real = replay.replay

    def interrupted(path, folder, options, *, progress):
        def press(done: int, total: int) -> None:
            progress(done, total)
            if done == 2:
                os.kill(os.getpid(), signal.SIGINT)

        return real(path, folder, options, progress=press)

    monkeypatch.setattr(sys, "argv", argv)
    monkeypatch.setattr(replay, "replay", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    try:
        with pytest.raises(SystemExit) as stopped:
            cli.main()
    finally:
        signal.signal(signal.SIGINT, before)
    assert stopped.value.code == 130
    assert "continues" in capsys.readouterr().err
    assert not (out / "report.json").exists()

    monkeypatch.setattr(replay, "replay", real)
    with pytest.raises(SystemExit) as done:
        cli.main()
    assert done.value.code == 0
    assert json.loads((out / "report.json").read_text())["complete"] is True


def test_the_demo_needs_nothing_and_says_where_to_look(tmp_path):
    result = run("demo", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    out = tmp_path / "roomlight-demo"
    assert "summary.png" in result.stdout
    mean = evaluate_predictions(sample_capture(), out).cells("predictions", "log_l2")
    assert f"log-L2 {mean[0].mean:.3f} over the first seven frames, {mean[4].mean:.3f} over the last" in result.stdout
    report = json.loads((out / "report.json").read_text())
    assert len(report["probes"]) == 3
    assert report["skipped"] == []
    for probe in report["probes"]:
        assert len(list((out / probe["folder"]).glob("*.exr"))) == len(report["frames"])
