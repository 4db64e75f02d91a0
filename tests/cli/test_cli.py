"""The command as a person meets it: help, errors in one line, Ctrl-C, and the demo from end to end."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import typer
from command_runner import RunCommand

import stub_rooms
from roomlight.errors import FrameError, ModelError, OptionError, RoomLightError
from roomlight.sample import sample_capture
from roomlight_cli import console
from roomlight_cli import main as cli
from roomlight_cli.commands.bench import BENCHMARKS
from roomlight_cli.commands.evaluation import EVALUATIONS
from roomlight_cli.lazy import CommandEntry, load_command
from roomlight_evaluation.benchmark import benchmark_options
from roomlight_evaluation.captures.scores import CaptureScores
from written_captures import edited_copy


def python(code: str, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "entry",
    [*cli.COMMANDS, *EVALUATIONS, *BENCHMARKS],
    ids=lambda entry: entry.target.removeprefix("roomlight_cli.commands."),
)
def test_the_listed_summary_is_the_command_s_own(entry: CommandEntry) -> None:
    help_text = load_command(entry.target).help
    assert " ".join(help_text.split("\n\n")[0].split()) == entry.summary


def test_help_lists_commands_in_a_newcomer_s_order_and_imports_none(tmp_path: Path) -> None:
    code = """
import sys
from roomlight_cli.main import app
try:
    app(["--help"])
finally:
    print(*sys.modules, sep="\\n", file=sys.stderr)
"""
    result = python(code, cwd=tmp_path)
    assert result.returncode == 0
    text = result.stdout
    names = ["demo", "light", "replay", "composite", "stream", "serve", "eval", "bench", "dataset", "train", "export"]
    assert [line.split()[1] for line in text.splitlines() if line.startswith("│ ") and line[2].isalpha()] == names
    panels = [text.index(f"─ {panel} ") for panel in ("Try it", "Light a recording", "Serve", "Measure", "Train")]
    assert panels == sorted(panels)
    loaded = set(result.stderr.split())
    assert "roomlight_cli.lazy" in loaded
    assert not {name for name in loaded if name.startswith("roomlight_cli.commands")}
    assert not loaded & {"numpy", "cv2", "numba", "onnxruntime", "httpx", "torch"}


EXTRA = "torch: pip install 'roomlight[train]'"


@pytest.mark.parametrize(
    ("module", "command", "needs"),
    [
        ("torch", ["export", "a.pt", "--out", "model"], EXTRA),
        ("torch", ["train", "objects", "data"], EXTRA),
        ("fcntl", ["dataset", "stats", "data"], "Linux or macOS; on Windows use WSL 2"),
    ],
)
def test_a_missing_extra_or_system_is_named(module: str, command: list[str], needs: str, tmp_path: Path) -> None:
    code = f"import sys; sys.modules[{module!r}] = None; from roomlight_cli.main import main; main()"
    result = python(code, *command, cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.strip() == f"error: this command needs {needs}"


def test_a_name_that_the_console_cannot_show_is_escaped(tmp_path: Path) -> None:
    code = """
import sys
import typer
from roomlight_cli import console
app = typer.Typer()
app.command()(lambda: console.say("caf\\udce9"))
sys.stdout.reconfigure(errors="strict")
console.run(app)
"""
    assert python(code, cwd=tmp_path).stdout == "caf\\udce9\n"


def test_another_missing_module_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    app = typer.Typer(pretty_exceptions_enable=False)
    monkeypatch.setattr(sys, "argv", ["roomlight"])

    @app.command()
    def command() -> None:
        raise ModuleNotFoundError("No module named 'roomlight.typo'", name="roomlight.typo")

    with pytest.raises(ModuleNotFoundError, match="typo"):
        console.run(app)


def test_version(roomlight: RunCommand) -> None:
    assert roomlight("--version").out.startswith("roomlight 0.")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("replay", "nowhere", "--out", "out"), "nowhere"),
        (("replay", ".", "--out", "out"), "roomlight"),
        (("eval", "objects", ".", "--format", "nerfstudio"), "transforms.json: cannot be read"),
        (("export", "nothing.pt", "--out", "model"), "nothing.pt"),
        (("light", "a [bold]photo[/x]", "--depth", "d", "--probe", "0,0,-1", "--out", "out"), "a [bold]photo[/x]:"),
        (("replay", "a [bold]room[/x]", "--out", "out"), "error: a [bold]room[/x]: there is no such file"),
    ],
)
def test_an_error_is_one_line_without_traceback(
    arguments: tuple[str, ...], says: str, tmp_path: Path, roomlight: RunCommand
) -> None:
    result = roomlight(*arguments, cwd=tmp_path)
    assert result.code == 1
    assert result.err.strip().count("\n") == 0
    assert "error:" in result.err
    assert says in result.err
    assert not (tmp_path / "out").exists()


FLAGS = {name: "--" + name.replace("_", "-") for name in ("every", "max_frames", "min_confidence", "weights", "model")}
FLAGS |= {"depth_unit_m": "--depth-unit"}


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OptionError("every is 0; it must be 1 or more"), "--every is 0; it must be 1 or more"),
        (OptionError("every frame counts"), "--every frame counts"),
        (FrameError("every frame is bad"), "every frame is bad"),
        (FrameError("use the `every` and `max_frames` that"), "use the --every and --max-frames that"),
        (ModelError("w: not here; set min_confidence=2 to use it"), "w: not here; set --min-confidence 2 to use it"),
        (ModelError("give weights=DIR or model='classical'"), "give --weights DIR or --model 'classical'"),
        (FrameError("/data/depth_key/a.png: state depth_unit_m."), "/data/depth_key/a.png: state --depth-unit."),
    ],
)
def test_messages_name_the_flags(error: RoomLightError, message: str) -> None:
    assert console.with_flags(error, FLAGS) == message


@pytest.mark.parametrize(
    ("option", "says"),
    [
        (("--probe", "1,2"), "X,Y,Z"),
        (("--pixel", "5"), "a pixel is U,V"),
        (("--above", "-1"), "--above"),
        (("--height", "3000"), "2048"),
        (("--probe", "0,1,0", "--probes-from-capture"), "excludes --probe"),
        (("--pixel", "5,5", "--probes-from-capture"), "excludes --probe"),
        (("--interpolate",), "--interpolate fills in"),
        (("--model", "classical", "--weights", "w"), "leave out --weights"),
        (("--model", "magic"), "magic"),
        (("--world-up", "1,2"), "a position or direction is X,Y,Z"),
    ],
)
def test_a_bad_argument_is_a_usage_error(
    option: tuple[str, ...], says: str, tmp_path: Path, roomlight: RunCommand
) -> None:
    result = roomlight("replay", sample_capture(), "--out", "out", *option, cwd=tmp_path)
    assert result.code == 2
    assert says in result.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (("eval", "captures", sample_capture(), "--main-light", "--predictions", "."), "scores tracked probes"),
        (("bench", "stages", "--against", ".", "--weights", "w"), "leave out --weights with --against"),
        (("demo", "--no-browser", "--port", "1"), "--port is of the live page"),
    ],
)
def test_options_that_exclude_each_other_are_refused(
    command: tuple[object, ...], says: str, tmp_path: Path, roomlight: RunCommand
) -> None:
    result = roomlight(*command, cwd=tmp_path)
    assert result.code in (1, 2)
    assert says in result.err


def test_the_main_light_is_scored_on_a_capture(small_capture: Path, tmp_path: Path, roomlight: RunCommand) -> None:
    options = ("--main-light", "--model", "classical", "--json", "main.json")
    result = roomlight("eval", "captures", small_capture, *options, cwd=tmp_path)
    assert result.code == 0, result.err
    assert "one panorama" in result.out
    tracks = json.loads((tmp_path / "main.json").read_text())["tracks"]
    assert {len(track["directions"]) for track in tracks} == {6}


def test_parts_are_an_option_of_eval(tmp_path: Path, roomlight: RunCommand) -> None:
    result = roomlight(
        "eval", "captures", sample_capture(), "--parts", tmp_path / "none", "--max-frames", 1, cwd=tmp_path
    )
    assert result.code == 1
    assert "none: has none of the folders clipping, objects, prior" in result.err


def test_scores_are_written_before_a_reader_of_the_tables_can_leave(tmp_path, monkeypatch) -> None:
    def left(*_: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(console, "print_table", left)
    scores = CaptureScores((), ())
    with pytest.raises(BrokenPipeError):
        console.show_scores(scores, tmp_path / "scores.json", "table")
    assert json.loads((tmp_path / "scores.json").read_text())["tracks"] == []


@pytest.mark.slow
def test_predictions_of_every_tenth_frame_are_scored(tmp_path: Path, roomlight: RunCommand) -> None:
    sample, out = sample_capture(), "out [/y]"
    options = ("--every", "10", "--model", "classical")
    form = ("--probes-from-capture", "--use", "reflection", "--height", "16")
    made = roomlight("replay", sample, "--out", out, *form, *options, cwd=tmp_path)
    assert made.code == 0, made.err
    assert "Pictures: out [/y]/summary.png" in made.out
    assert "4 frames, 3 probes" in made.out
    missing = roomlight("eval", "captures", sample, "--predictions", out, cwd=tmp_path)
    assert missing.code == 1
    assert "--every" in missing.err
    scored = roomlight("eval", "captures", sample, "--predictions", out, *options, cwd=tmp_path)
    assert scored.code == 0, scored.err
    assert "predictions" in scored.out


@pytest.mark.parametrize(
    ("name", "text"), [("replay.json", '{"capture": "/mine"}'), ("replay.json", "[]"), ("composite.mp4", "mine")]
)
def test_the_demo_replaces_nothing_but_an_earlier_demo(
    name: str, text: str, tmp_path: Path, roomlight: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    for step in ("compile_beside", "replay", "composite_recording"):
        monkeypatch.setattr(f"roomlight_cli.commands.demo.{step}", lambda *_, **__: None)
    (tmp_path / name).write_text(text)
    result = roomlight("demo", "--out", tmp_path)
    assert result.code == 1
    assert "holds something else than a demo of this installation; choose another --out" in result.err


@pytest.mark.slow
def test_the_demo_needs_nothing_and_names_its_pictures(tmp_path: Path) -> None:
    sample = edited_copy(sample_capture(), tmp_path / "sample", lambda index: index.update(frames=index["frames"][:8]))
    out = tmp_path / "roomlight-demo"
    out.mkdir()
    (out / "replay.json").write_text(json.dumps({"capture": str(sample)}))  # of an earlier demo, which is replaced
    code = f"from roomlight_cli.commands import demo; demo.sample_capture = lambda: demo.Path({str(sample)!r})"
    result = python(f"{code}; from roomlight_cli.main import main; main()", "demo", "--no-browser", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "summary.png" in result.stdout
    assert (out / "composite.mp4").stat().st_size > 10_000
    report = json.loads((out / "report.json").read_text())
    assert len(report["probes"]) == 3
    assert report["skipped"] == []
    for probe in report["probes"]:
        assert len(list((out / probe["folder"]).glob("*.exr"))) == len(report["frames"])


@pytest.mark.slow
def test_the_benchmark_makes_its_rooms_and_scores_them(tmp_path, roomlight, monkeypatch):
    def short_walks(*, rooms: int, seed: int):
        return replace(benchmark_options(rooms=rooms, seed=seed), frames=3, renderer=stub_rooms.NAME)

    monkeypatch.setattr("roomlight_cli.commands.evaluation.rooms.benchmark_options", short_walks)
    command = ("eval", "benchmark", tmp_path / "rooms", "--rooms", 1, "--model", "classical", "--workers", 1)
    first = roomlight(*command, "--json", tmp_path / "scores.json")
    assert first.code == 0, first.err
    for heading in ("RMSE; exact depth, seed 0, rooms: 1", "scale-invariant RMSE;", "angular error (deg);"):
        assert heading in first.out
    assert len(json.loads((tmp_path / "scores.json").read_text())["scores"]) == 6
    again = roomlight(*command)
    assert again.out.splitlines()[:-2] == first.out.splitlines()[:-3]  # without the files' names


def test_the_benchmark_makes_no_rooms_among_other_files(tmp_path, roomlight):
    (tmp_path / "notes.txt").write_text("mine")
    result = roomlight("eval", "benchmark", tmp_path, "--rooms", 1)
    assert result.code == 1
    assert "is not a dataset" in result.err.replace("\n", " ")
