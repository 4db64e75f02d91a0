"""Replays: what is written, and what is refused."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from roomlight.captures import CaptureOptions, open_capture
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import CaptureError, OptionError, OutputError, ProbeError
from roomlight.files import write_json
from roomlight.images import read_panorama
from roomlight.placement import point_at_pixel
from roomlight_cli.replays.replay import replay
from roomlight_cli.replays.replay_folder import describe_intent, finished_report
from roomlight_cli.replays.replay_options import ReplayOptions
from rooms import BoxRoom, pan
from written_captures import edited_copy, write_capture

pytestmark = pytest.mark.usefixtures("small_pictures", "no_pictures")
FRAMES = 6
PROBES = [(0.4, 1.2, -0.3), (-0.8, 1.0, 0.6)]
SMALL = SessionOptions(model="classical", height=16)
ONE = ReplayOptions(session=SMALL, probes=(PROBES[0],))
OTHER = ReplayOptions(session=SMALL, probes=(PROBES[1],))


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    room = BoxRoom()
    frames = [replace(frame, timestamp_s=0.1 * frame.index) for frame in pan(room, FRAMES, width=64, height=48)]
    probes = [(position, room.panorama(position, height=16)[0]) for position in PROBES]
    return write_capture(tmp_path_factory.mktemp("captures") / "box", frames, probes=probes)


def exr_names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("*.exr"))


@pytest.mark.usefixtures("pictures")
def test_each_frame_and_probe_gets_a_panorama(capture, tmp_path):
    seen = []
    options = ReplayOptions(session=SMALL, probes_from_capture=True)
    returned = replay(capture, tmp_path / "out", options, progress=lambda _, done, total: seen.append((done, total)))
    for probe in range(2):
        assert exr_names(tmp_path / "out" / f"probe-{probe:02d}") == [f"light.{n:06d}.exr" for n in range(FRAMES)]
    assert (tmp_path / "out" / "summary.png").stat().st_size > 0
    assert (tmp_path / "out" / "replay.mp4").stat().st_size > 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report == returned
    assert report["complete"] is True
    assert [frame["index"] for frame in report["frames"]] == list(range(FRAMES))
    assert {"volume", "sglv", "mesh", "render", "partial", "blend"} <= report["stage_ms_median"].keys()
    assert seen[-1] == (FRAMES, FRAMES)
    coverage = [frame["coverage"][0] for frame in report["frames"]]
    assert coverage == sorted(coverage)


@pytest.mark.parametrize("use", ["lighting", "reflection"])
def test_panoramas_and_other_forms_are_those_of_the_session(capture, tmp_path, use):
    forms = ("usdz", "glb", "equirect", "confidence")
    replay(capture, tmp_path / "out", replace(ONE, use=use, forms=(*forms, "json")))
    session = Session(SMALL)
    session.track(PROBES[0])
    for frame in open_capture(capture):
        session.push(frame)
    light, folder = session.light(0).used_for(use), tmp_path / "out" / "probe-00"
    last = read_panorama(folder / f"light.{FRAMES - 1:06d}.exr")
    assert (last == light.panorama.astype(np.float16)).all()
    for form, end in zip(forms, (".usdz", ".glb", ".equirect.ktx2", ".confidence.png"), strict=True):
        assert (folder / f"light{end}").read_bytes() == light.file(form)
    assert json.loads((folder / "light.json").read_text())["use"] == use


def test_the_sequence_has_timecode_and_gain_in_every_file(capture, tmp_path):
    """At ten frames a second the sixth record is half a second in, whatever was left out before it."""
    stated = edited_copy(capture, tmp_path / "stated", lambda index: index["frames"][5].update(exposure=0.5))
    report = replay(stated, tmp_path / "out", replace(ONE, capture=CaptureOptions(every=5)))
    assert [frame["gain"] for frame in report["frames"]] == [[1, 1, 1], [2, 2, 2]]
    for index, frame in ((0, 0), (5, 5)):
        header = OpenEXR.File(str(tmp_path / f"out/probe-00/light.{index:06d}.exr")).header()
        assert header["framesPerSecond"] == 10
        timecode = header["timeCode"]
        assert (timecode.hours, timecode.minutes, timecode.seconds, timecode.frame) == (0, 0, 0, frame)
        assert header["roomlight:use"] == "lighting"
        assert header["roomlight:gain"] == {0: "1 1 1", 5: "2 2 2"}[index]


def test_a_capture_without_times_runs_at_30_frames_a_second(tmp_path):
    untimed = write_capture(tmp_path / "box", [*pan(BoxRoom(), 2, width=64, height=48)])
    replay(untimed, tmp_path / "out", ONE)
    header = OpenEXR.File(str(tmp_path / "out/probe-00/light.000001.exr")).header()
    assert (header["framesPerSecond"], header["roomlight:frame"], header["timeCode"].frame) == (30, 1, 1)
    assert "framesPerSecond = 30\n" in (tmp_path / "out/probe-00/light.usda").read_text()
    assert open_capture(untimed, CaptureOptions(every=3)).film_rate == 10


@pytest.mark.parametrize(("step_s", "notes"), [(0.1, 0), (1.0, 1)])
def test_a_recording_slower_than_its_video_is_noted(tmp_path, step_s, notes):
    frames = [replace(frame, timestamp_s=step_s * frame.index) for frame in pan(BoxRoom(), 2, width=64, height=48)]
    report = replay(write_capture(tmp_path / "slow", frames), tmp_path / "out", ONE)
    effects = [note["effect"] for note in report["notes"] if "film runs" in note["effect"]]
    assert effects == ["the film runs 0.5 s, the recording 1 s"] * notes


def test_usd_core_reads_the_stage_of_a_replay(capture, tmp_path):
    Usd, UsdLux = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdLux")
    replay(capture, tmp_path / "out", replace(ONE, every=2))
    stage = Usd.Stage.Open(str(tmp_path / "out/probe-00/light.usda"))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (0, 4, 10)
    texture = UsdLux.DomeLight(stage.GetPrimAtPath("/Light/Room")).GetTextureFileAttr()
    assert texture.GetTimeSamples() == [0, 2, 4]
    for time, index in ((0, 0), (3, 2), (4, 4), (Usd.TimeCode.Default(), 4)):  # an asset stays until the next
        path = tmp_path / "out" / "probe-00" / f"light.{index:06d}.exr"
        assert Path(texture.Get(time).resolvedPath) == path
        assert path.is_file()


def test_every_and_interpolate(capture, tmp_path):
    sparse = replay(capture, tmp_path / "sparse", replace(ONE, every=2))
    assert exr_names(tmp_path / "sparse" / "probe-00") == ["light.000000.exr", "light.000002.exr", "light.000004.exr"]
    assert len(sparse["frames"]) == 3
    dense = replay(capture, tmp_path / "dense", replace(ONE, every=2, interpolate=True))
    assert dense["interpolated"] == 3
    panoramas = [read_panorama(tmp_path / "dense" / "probe-00" / f"light.{n:06d}.exr") for n in range(FRAMES)]
    # half floats carry 11 bits: the mean of two rounded ends is within 2^-10 of the rounded mean
    assert panoramas[1] == pytest.approx((panoramas[0] + panoramas[2]) / 2, rel=2e-3, abs=1e-4)
    assert (panoramas[5] == panoramas[4]).all()  # nothing comes after it: the light stays


def test_the_pictures_of_interpolated_frames_know_what_was_seen_and_wait_as_small_as_printed(
    capture, tmp_path, monkeypatch
):
    seen, columns = [], []

    def add(_, frame, __, coverage=(), observed=()):
        seen.append((bool(coverage), [share.mean() for share in observed]))
        columns.append(frame.image.shape[1])

    monkeypatch.setattr("roomlight_cli.replays.replay.ReplayPictures.add", add)
    monkeypatch.setattr("roomlight_cli.replays.inserted_spheres._COLUMNS", 48)
    replay(capture, tmp_path, replace(ONE, every=2, interpolate=True))
    assert [is_computed for is_computed, _ in seen] == [True, False] * 3
    assert [shares for _, shares in seen[1::2]] == [shares for _, shares in seen[::2]]  # those of the frame before
    assert 0 < seen[1][1][0] < 1
    assert columns == [64, 48] * 3


def test_a_probe_outside_every_volume_is_reported(tmp_path):
    """A probe of a room that was left is not outside."""
    frames = [replace(frame, timestamp_s=0.1 * frame.index) for frame in pan(BoxRoom(), 2, width=64, height=48)]
    pose = frames[1].camera_to_world.copy()
    pose[0, 3] += 50
    capture = write_capture(tmp_path / "walk", [frames[0], replace(frames[1], camera_to_world=pose)])
    x, y, z = PROBES[0]
    report = replay(capture, tmp_path / "out", replace(ONE, probes=(PROBES[0], (x + 50, y, z), (x + 25, y, z))))
    assert [probe.get("outside_volume", False) for probe in report["probes"]] == [False, False, True]


@pytest.mark.slow
def test_other_files_are_never_mixed_with_a_replay(capture, tmp_path):
    out = tmp_path / "out"
    replay(capture, out, ONE)
    with pytest.raises(OutputError, match="another replay"):
        replay(capture, out, OTHER)
    replaced = replay(capture, out, replace(OTHER, overwrite=True))
    assert replaced["probes"][0]["position"] == list(PROBES[1])
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("precious")
    for path, message in (
        ("", "holds other files"),
        ("thesis.tex", "is a file"),
        ("thesis.tex/out", r"replay\.json: cannot be written \(Not a directory\)"),
    ):
        with pytest.raises(OutputError, match=message):
            replay(capture, foreign / path, OTHER)
    stale = foreign / "probe-00" / "light.000000.exr"
    stale.parent.mkdir()
    stale.write_bytes(b"of another program")
    (foreign / "probe-00" / "notes.txt").write_text("precious too")
    replay(capture, foreign, replace(OTHER, overwrite=True))
    assert read_panorama(stale).shape == (16, 32, 3)
    assert (foreign / "thesis.tex").read_text() == "precious"
    assert (foreign / "probe-00" / "notes.txt").read_text() == "precious too"


def test_what_differs_is_written_as_options_are(roomlight, capture, tmp_path):
    there = replace(ONE, forms=("exr", "hdr"), probes=(*PROBES,))
    write_json(tmp_path / "replay.json", describe_intent(capture, "classical", there))
    done = roomlight("replay", capture, "--out", tmp_path, "--model", "classical", "--height", "16")
    assert "--form exr, hdr there, none here" in done.err
    assert "--probe 0.4,1.2,-0.3, -0.8,1.0,0.6 there, none here" in done.err


def test_a_refused_command_leaves_the_folder_as_it_was(capture, tmp_path):
    out, wrong = tmp_path / "out", ReplayOptions(CaptureOptions(depth_unit_m=1.0), session=SMALL)
    with pytest.raises(CaptureError, match="depth unit"):
        replay(capture, out, wrong)
    assert not out.exists()
    kept = replay(capture, out, ONE)
    with pytest.raises(CaptureError, match="depth unit"):
        replay(capture, out, replace(wrong, overwrite=True))
    assert json.loads((out / "report.json").read_text()) == kept


def test_a_capture_is_never_its_own_output(capture):
    before = sorted(path.name for path in capture.iterdir())
    for path in (capture, capture / "capture.json"):
        with pytest.raises(OutputError, match="the capture itself"):
            replay(path, capture, ReplayOptions(session=SMALL, overwrite=True))
    assert sorted(path.name for path in capture.iterdir()) == before


def test_only_the_same_finished_replay_counts_as_done(capture, tmp_path):
    out, options = tmp_path / "out", replace(ONE, capture=CaptureOptions(max_frames=1))
    copy = edited_copy(capture, tmp_path / "copy", lambda _: None)
    assert finished_report(copy, out, options) is None
    report = replay(copy, out, options)
    assert finished_report(copy, out, options) == report
    assert finished_report(copy, out, replace(options, probes=(PROBES[1],))) is None
    assert finished_report(capture, out, options) is None  # the same frames, but another capture
    panorama, depth = out / "probe-00" / "light.000000.exr", next((copy / "depth").iterdir())
    original = panorama.read_bytes()
    for path, changed in ((panorama, b"damaged"), (depth, depth.read_bytes() + b"recorded again")):
        path.write_bytes(changed)
        assert finished_report(copy, out, options) is None
        replay(copy, out, options)
        assert panorama.read_bytes() == original
        assert finished_report(copy, out, options) is not None
    (out / "report.json").unlink()
    assert finished_report(copy, out, options) is None


def test_names_that_are_not_utf8_are_replayed_and_known_again(capture, tmp_path):
    copy = edited_copy(capture, tmp_path / os.fsdecode(b"caf\xe9"), lambda _: None)
    out, options = tmp_path / os.fsdecode(b"th\xe9"), replace(ONE, capture=CaptureOptions(max_frames=1))
    assert finished_report(copy, out, options) is None
    assert replay(copy, out, options) == finished_report(copy, out, options)


def test_a_finished_replay_is_not_run_again(capture, tmp_path, monkeypatch, roomlight):
    command = ("replay", capture, "--out", tmp_path / "out", "--model", "classical", "--height", "16")
    command += ("--max-frames", "1", "--probe", "0.4,1.2,-0.3")
    first = roomlight(*command)
    assert first.code == 0, first.err
    calls = []
    with monkeypatch.context() as patch:
        patch.setattr("roomlight_cli.commands.replay.run_replay", lambda *arguments, **_: calls.append(arguments))
        again = roomlight(*command)
    assert again.code == 0, again.err
    assert not calls
    assert "already holds this replay, finished" in again.out
    assert "1 frame, 1 probe, model classical" in again.out
    other = roomlight(*command, "--every", "2")
    assert other.code == 1
    assert "holds another replay" in other.err
    repeated = roomlight(*command, "--overwrite")
    assert repeated.code == 0, repeated.err
    assert "already holds" not in repeated.out


@pytest.mark.parametrize("first", [0, 1])
def test_pixels_are_points_on_the_first_frame_that_is_used(capture, tmp_path, first):
    recording = edited_copy(capture, tmp_path / "recording", lambda _: None)
    if first:
        (recording / "depth" / "000000.png").write_bytes(b"")
    expected = point_at_pixel(next(iter(open_capture(recording))), 20.0, 30.0, above_m=0.3)
    options = replace(ONE, capture=CaptureOptions(max_frames=2), pixels=((20.0, 30.0),), above_m=0.3)
    report = replay(recording, tmp_path / "out", options)
    assert [tuple(probe["position"]) for probe in report["probes"]] == [PROBES[0], expected]
    noted = [note["left_out"] for note in report["notes"] if "pixel" in note["left_out"]]
    assert [text.endswith("000001.jpg") for text in noted] == [True] * first


def test_a_probe_that_was_hardly_seen_gets_a_warning(capture, tmp_path, roomlight):
    command = ("replay", capture, "--model", "classical", "--height", "16", "--max-frames", "1")
    # close to a wall behind the camera, which looks along -z: the frame shows little of what is around it
    seen = roomlight(*command, "--out", tmp_path / "seen", "--pixel", "32,24")
    unseen = roomlight(*command, "--out", tmp_path / "unseen", "--probe", "0,1.5,30")
    assert "warning" not in seen.out
    assert "of the light around this point was seen; most of it is inferred" in unseen.out


def test_bad_frames_are_skipped_and_listed(capture, tmp_path):
    broken = edited_copy(capture, tmp_path / "broken", lambda _: None)
    depth = broken / "depth" / "000002.png"
    depth.write_bytes(depth.read_bytes()[:50])
    report = replay(broken, tmp_path / "out", ONE)
    assert [frame["index"] for frame in report["frames"]] == [0, 1, 3, 4, 5]
    assert [skipped["index"] for skipped in report["skipped"]] == [2]
    assert depth.name in report["skipped"][0]["reason"]


def test_impossible_options_are_refused(capture, tmp_path):
    with pytest.raises(OptionError, match="every"):
        ReplayOptions(every=0)
    with pytest.raises(ProbeError, match="finite"):
        ReplayOptions(probes=((float("nan"), 0.0, 0.0),))
    bare = edited_copy(capture, tmp_path / "bare", lambda index: index["probes"].clear())
    with pytest.raises(CaptureError, match="has no probes of its own"):
        replay(bare, tmp_path / "out", ReplayOptions(session=SMALL, probes_from_capture=True))
