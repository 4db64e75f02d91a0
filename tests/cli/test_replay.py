"""Replays: what is written, what is refused, what survives an interruption."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from roomlight.captures import CaptureOptions, CaptureWriter, open_capture
from roomlight.conventions import linear_to_srgb8
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import CaptureError, OutputError, ProbeError
from roomlight.images import read_panorama
from roomlight_cli.replay import ReplayOptions, replay
from rooms import BoxRoom, pan

FRAMES = 6
PROBES = [(0.4, 1.2, -0.3), (-0.8, 1.0, 0.6)]
SMALL = SessionOptions(model="classical", height=16)


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("captures") / "box"
    room = BoxRoom()
    with CaptureWriter(path, name="box") as writer:
        for number, frame in enumerate(pan(room, FRAMES, width=64, height=48)):
            writer.add(
                srgb8=linear_to_srgb8(frame.image),
                depth_m=frame.depth_m,
                intrinsics=frame.intrinsics,
                camera_to_world=frame.camera_to_world,
                timestamp_s=0.1 * number,
            )
        for position in PROBES:
            writer.add_probe(position, room.panorama(position, height=16)[0])
    return path


def exr_names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("*.exr"))


def test_a_replay_writes_a_panorama_a_frame_and_probe(capture, tmp_path):
    seen = []
    options = ReplayOptions(session=SMALL, probes_from_capture=True)
    result = replay(capture, tmp_path / "out", options, progress=lambda done, total: seen.append((done, total)))
    for probe in range(2):
        assert exr_names(tmp_path / "out" / f"probe-{probe:02d}") == [f"{n:06d}.exr" for n in range(FRAMES)]
    assert (tmp_path / "out" / "summary.png").stat().st_size > 0
    assert (tmp_path / "out" / "replay.mp4").stat().st_size > 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report == result.report
    assert report["complete"] is True
    assert [frame["index"] for frame in report["frames"]] == list(range(FRAMES))
    assert {"volume", "sglv", "mesh", "render", "partial", "blend"} <= report["stage_ms_median"].keys()
    assert seen[-1] == (FRAMES, FRAMES)
    coverage = [frame["coverage"][0] for frame in report["frames"]]
    assert coverage == sorted(coverage)


def test_the_panoramas_are_those_of_the_session(capture, tmp_path):
    replay(capture, tmp_path / "out", ReplayOptions(session=SMALL, probes=(PROBES[0],)))
    session = Session(SMALL)
    session.track(PROBES[0])
    for frame in open_capture(capture):
        session.push(frame)
    last = read_panorama(tmp_path / "out" / "probe-00" / f"{FRAMES - 1:06d}.exr")
    assert (last == session.light(0).panorama.astype(np.float16)).all()


def test_every_and_interpolate(capture, tmp_path):
    sparse = replay(capture, tmp_path / "sparse", ReplayOptions(session=SMALL, probes=(PROBES[0],), every=2))
    assert exr_names(tmp_path / "sparse" / "probe-00") == ["000000.exr", "000002.exr", "000004.exr"]
    assert len(sparse.report["frames"]) == 3
    dense = ReplayOptions(session=SMALL, probes=(PROBES[0],), every=2, interpolate=True)
    result = replay(capture, tmp_path / "dense", dense)
    assert exr_names(tmp_path / "dense" / "probe-00") == [f"{n:06d}.exr" for n in range(FRAMES)]
    assert result.report["interpolated"] == 3
    panoramas = [read_panorama(tmp_path / "dense" / "probe-00" / f"{n:06d}.exr") for n in range(FRAMES)]
    # half floats carry 11 bits: the mean of two rounded ends is within 2^-10 of the rounded mean
    assert panoramas[1] == pytest.approx((panoramas[0] + panoramas[2]) / 2, rel=2e-3, abs=1e-4)
    assert (panoramas[5] == panoramas[4]).all()  # nothing comes after it: the light stays


def test_max_frames_and_a_default_probe(capture, tmp_path):
    options = ReplayOptions(capture=CaptureOptions(max_frames=2), session=SMALL)
    report = replay(capture, tmp_path / "out", options).report
    assert [frame["index"] for frame in report["frames"]] == [0, 1]
    assert len(report["probes"]) == 1
    assert "outside_volume" not in report["probes"][0]


def test_a_probe_outside_the_volume_is_said_so(capture, tmp_path):
    report = replay(capture, tmp_path / "out", ReplayOptions(session=SMALL, probes=((200.0, 0.0, 0.0),))).report
    assert report["probes"][0]["outside_volume"] is True


class _InterruptError(KeyboardInterrupt):
    pass


def test_an_interrupted_replay_leaves_no_report_and_continues(capture, tmp_path):
    out = tmp_path / "out"
    options = ReplayOptions(session=SMALL, probes=(PROBES[0],))

    def stop(done: int, _: int) -> None:
        if done == 3:
            raise _InterruptError

    with pytest.raises(_InterruptError):
        replay(capture, out, options, progress=stop)
    assert exr_names(out / "probe-00") == ["000000.exr", "000001.exr", "000002.exr"]
    assert not (out / "report.json").exists()
    assert not (out / "replay.mp4").exists()
    assert not list(out.glob(".*.part"))
    before = {path.name: path.stat().st_mtime_ns for path in (out / "probe-00").iterdir()}

    whole = replay(capture, out, options)
    assert exr_names(out / "probe-00") == [f"{n:06d}.exr" for n in range(FRAMES)]
    after = {path.name: path.stat().st_mtime_ns for path in (out / "probe-00").iterdir()}
    assert all(after[name] == stamp for name, stamp in before.items())
    assert whole.report["complete"]
    fresh = tmp_path / "fresh"
    replay(capture, fresh, options)
    for name in exr_names(fresh / "probe-00"):
        assert (fresh / "probe-00" / name).read_bytes() == (out / "probe-00" / name).read_bytes()


def test_another_replay_or_a_foreign_folder_is_not_mixed_in(capture, tmp_path):
    out = tmp_path / "out"
    replay(capture, out, ReplayOptions(session=SMALL, probes=(PROBES[0],)))
    other = ReplayOptions(session=SMALL, probes=(PROBES[1],))
    with pytest.raises(OutputError, match="another replay"):
        replay(capture, out, other)
    replaced = replay(capture, out, ReplayOptions(session=SMALL, probes=(PROBES[1],), overwrite=True))
    assert replaced.report["probes"][0]["position"] == list(PROBES[1])
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("precious")
    with pytest.raises(OutputError, match="not empty"):
        replay(capture, foreign, other)
    assert (foreign / "thesis.tex").read_text() == "precious"
    with pytest.raises(OutputError, match="is a file"):
        replay(capture, foreign / "thesis.tex", other)
    with pytest.raises(OutputError, match="Not a directory"):
        replay(capture, foreign / "thesis.tex" / "out", other)
    stale = foreign / "probe-00" / "000000.exr"
    stale.parent.mkdir()
    stale.write_bytes(b"of another program")
    (foreign / "probe-00" / "notes.txt").write_text("precious too")
    replay(capture, foreign, ReplayOptions(session=SMALL, probes=(PROBES[1],), overwrite=True))
    assert read_panorama(stale).shape == (16, 32, 3)
    assert (foreign / "thesis.tex").read_text() == "precious"
    assert (foreign / "probe-00" / "notes.txt").read_text() == "precious too"


def test_a_mistaken_command_leaves_nothing_that_hinders_the_right_one(capture, tmp_path):
    out = tmp_path / "out"
    wrong = CaptureOptions(depth_unit_m=1.0)
    with pytest.raises(CaptureError, match="depth unit"):
        replay(capture, out, ReplayOptions(capture=wrong, session=SMALL))
    assert not out.exists()
    kept = replay(capture, out, ReplayOptions(session=SMALL, probes=(PROBES[0],))).report
    with pytest.raises(CaptureError, match="depth unit"):
        replay(capture, out, ReplayOptions(capture=wrong, session=SMALL, overwrite=True))
    assert json.loads((out / "report.json").read_text()) == kept


def test_a_capture_is_never_its_own_output(capture):
    before = sorted(path.name for path in capture.iterdir())
    for path in (capture, capture / "capture.json"):
        with pytest.raises(OutputError, match="the capture itself"):
            replay(path, capture, ReplayOptions(session=SMALL, overwrite=True))
    assert sorted(path.name for path in capture.iterdir()) == before


def test_a_finished_replay_is_made_anew_when_asked_again(capture, tmp_path):
    out, options = tmp_path / "out", ReplayOptions(session=SMALL, probes=(PROBES[0],))
    replay(capture, out, options)
    panorama = out / "probe-00" / "000001.exr"
    whole = panorama.read_bytes()
    panorama.write_bytes(b"from before the capture was recorded again")
    replay(capture, out, options)
    assert panorama.read_bytes() == whole


def test_bad_frames_are_skipped_and_listed(capture, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(capture, broken)
    index = json.loads((broken / "capture.json").read_text())
    depth = broken / index["frames"][2]["depth"]
    depth.write_bytes(depth.read_bytes()[:50])
    report = replay(broken, tmp_path / "out", ReplayOptions(session=SMALL, probes=(PROBES[0],))).report
    assert [frame["index"] for frame in report["frames"]] == [0, 1, 3, 4, 5]
    assert [skipped["index"] for skipped in report["skipped"]] == [2]
    assert depth.name in report["skipped"][0]["reason"]


def test_what_cannot_be_asked(capture, tmp_path):
    with pytest.raises(CaptureError, match="every"):
        ReplayOptions(every=0)
    with pytest.raises(ProbeError, match="finite"):
        ReplayOptions(probes=((float("nan"), 0.0, 0.0),))
    bare = tmp_path / "bare"
    shutil.copytree(capture, bare)
    index = json.loads((bare / "capture.json").read_text())
    index["probes"] = []
    (bare / "capture.json").write_text(json.dumps(index))
    with pytest.raises(CaptureError, match="names no probes"):
        replay(bare, tmp_path / "out", ReplayOptions(session=SMALL, probes_from_capture=True))
