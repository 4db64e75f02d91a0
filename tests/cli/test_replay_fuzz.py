"""Broken captures through a whole replay: an error that names the file, or a report that lists the skipped frames."""

import json
import random

import formats
import pytest
from damage import damaged

from roomlight.engine.session import SessionOptions
from roomlight.errors import RoomLightError
from roomlight_cli.replays.replay import replay
from roomlight_cli.replays.replay_options import ReplayOptions

OPTIONS = ReplayOptions(session=SessionOptions(model="classical", height=16), probes=((0.1, 0.0, -0.5),))


@pytest.mark.parametrize("seed", range(1000, 1005))
@pytest.mark.parametrize("name", formats.BUILDERS)
@pytest.mark.slow
def test_a_damaged_capture_never_looks_complete(name, seed, tmp_path):
    whole = formats.BUILDERS[name](tmp_path / "whole" / name, formats.scene())
    path = damaged(whole, tmp_path, random.Random(f"{name} {seed}"))
    out = tmp_path / "out"
    refusal = None
    try:
        replay(path, out, OPTIONS)
    except RoomLightError as error:
        refusal = str(error)
    if refusal is not None:
        assert str(path) in refusal
        assert not (out / "report.json").exists()
        assert not (out / "summary.png").exists()
        return
    report = json.loads((out / "report.json").read_text())
    assert len(report["frames"]) + len(report["skipped"]) == report["capture"]["frames"]
    assert len(list((out / "probe-00").glob("*.exr"))) == len(report["frames"]) >= 1
    assert all(str(path) in skipped["reason"] for skipped in report["skipped"])
