"""`roomlight eval --ship-rule`: the verdict, and options that it excludes."""

import json
from pathlib import Path

from command_runner import RunCommand

from roomlight.sample import sample_capture


def test_the_ship_rule_compares_and_decides(small_capture: Path, tmp_path: Path, roomlight: RunCommand) -> None:
    """The reference against itself: nothing is gained."""
    options = ("--ship-rule", "--model", "classical", "--max-frames", 2, "--json", "s.json")
    result = roomlight("eval", "captures", small_capture, *options, cwd=tmp_path)
    assert result.code == 1, result.err
    assert "classical to classical" in result.out
    assert "log-L2 is 1.000 (nan-nan) of classical's, not below 1.0" in result.out
    assert "classical fails: 2 of its figures break the rule" in result.out
    written = json.loads((tmp_path / "s.json").read_text())
    assert [ratio["mean"] for ratio in written["ship_rule"]["ratios"].values()] == [1.0, 1.0]
    assert {track["method"] for track in written["tracks"]} == {"candidate", "reference"}


def test_parts_are_an_option_of_eval(tmp_path: Path, roomlight: RunCommand) -> None:
    result = roomlight(
        "eval", "captures", sample_capture(), "--parts", tmp_path / "none", "--max-frames", 1, cwd=tmp_path
    )
    assert result.code == 1
    assert "none/clipping/model.json: cannot be read" in result.err
