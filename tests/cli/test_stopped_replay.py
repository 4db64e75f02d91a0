"""A replay that was stopped goes on with the same bits, or says why it does not."""

import errno
import itertools
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from roomlight.captures import open_capture
from roomlight.captures.capture import PassState
from roomlight.captures.options import CaptureOptions
from roomlight.engine.session import SessionOptions
from roomlight.engine.state.records import pack_records, unpack_records
from roomlight.engine.state.values import records_of_values, values_of_records
from roomlight.errors import OutputError
from roomlight.frame import Frame
from roomlight.sample import sample_capture
from roomlight_cli.replays.pictures import VIDEO
from roomlight_cli.replays.replay import replay
from roomlight_cli.replays.replay_options import ReplayOptions
from roomlight_cli.replays.saved_replay import is_due
from rooms import BoxRoom, pan
from written_captures import write_capture

FRAMES, SAVE_EVERY = 18, 4
SMALL = ReplayOptions(session=SessionOptions(model="classical", height=16), probes=((0.4, 1.2, -0.3),))
DENSE = replace(SMALL, every=2, interpolate=True)
KILLED = """
import os, signal, sys
from roomlight_cli.main import main
from roomlight_cli.replays import pictures, replay, saved_replay, video
saved_replay.SAVE_EVERY = 4
video._FRAME_ROWS, video._PANORAMA_ROWS = 96, (28, 60)
add = pictures.ReplayPictures.add
def kill(self, frame, *rest):
    if frame.index == 10:
        os.kill(os.getpid(), signal.SIGKILL)
    add(self, frame, *rest)
if sys.argv.pop(1) == "killed":
    pictures.ReplayPictures.add = kill
main()
"""


@pytest.fixture(autouse=True)
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("roomlight_cli.replays.saved_replay.SAVE_EVERY", SAVE_EVERY)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    frames = [replace(frame, timestamp_s=0.1 * frame.index) for frame in pan(BoxRoom(), FRAMES, width=64, height=48)]
    capture = write_capture(tmp_path_factory.mktemp("long") / "box", frames)
    index = json.loads((capture / "capture.json").read_text())
    (capture / index["frames"][3]["depth"]).write_bytes(b"damaged")
    return capture


def stop_at(frames: int) -> Callable[[str, int, int], None]:
    def stop(_: str, done: int, __: int) -> None:
        if done == frames:
            raise KeyboardInterrupt

    return stop


def assert_same(out: Path, whole: Path) -> None:
    """All files but for times. H.264 of several threads is not the same from run to run: its pictures are compared."""

    def files(folder: Path) -> dict[str, Any]:
        return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*.*")}

    def report(folder: Path) -> dict[str, Any]:
        values = json.loads((folder / "report.json").read_text())
        for frame in values["frames"]:
            frame.pop("stage_ms")
        return {
            name: value for name, value in values.items() if name not in ("stage_ms_median", "wall_s", "fingerprint")
        }

    def pictures(folder: Path) -> np.ndarray:
        with av.open(str(folder / VIDEO)) as container:
            return np.stack([frame.to_ndarray(format="gray") for frame in container.decode(video=0)]).astype(float)

    first, second = files(out), files(whole)
    changing = {"report.json", VIDEO}
    assert {name: first[name] for name in first.keys() - changing} == {
        name: second[name] for name in second.keys() - changing
    }
    assert report(out) == report(whole)
    assert (VIDEO in first) == (VIDEO in second)
    if VIDEO in first:
        different = np.abs(pictures(out) - pictures(whole))
        assert different.mean() < 0.5
        assert different.max() < 40


@pytest.mark.slow
def test_a_killed_process_goes_on_with_the_same_bits(tmp_path):
    command = (
        *("replay", sample_capture(), "--model", "classical", "--height", "16", "--max-frames", "12"),
        *("--form", "glb", "--probe", "0.2,-0.1,-1.5", "--out"),
    )

    def run(how: str, out: str) -> subprocess.CompletedProcess[str]:
        arguments = [sys.executable, "-c", KILLED, how, *map(str, command), out]
        return subprocess.run(arguments, cwd=tmp_path, capture_output=True, text=True, env=os.environ)

    assert run("killed", "out").returncode == -signal.SIGKILL
    assert not (tmp_path / "out" / "report.json").exists()
    whole, rest = run("whole", "whole"), run("whole", "out")
    assert (whole.returncode, rest.returncode) == (0, 0), rest.stderr
    assert_same(tmp_path / "out", tmp_path / "whole")
    assert (tmp_path / "out" / VIDEO).exists()
    assert not (tmp_path / "out" / ".replay").exists()


@pytest.mark.usefixtures("small_pictures")
def test_a_stopped_replay_goes_on_with_the_same_bits(capture, tmp_path):
    """Of interpolated frames; it is stopped twice."""
    out, seen = tmp_path / "out", []
    with pytest.raises(KeyboardInterrupt):
        replay(capture, out, DENSE, progress=stop_at(17))
    assert not (out / "report.json").exists()
    assert not (out / "replay.mp4").exists()
    with pytest.raises(KeyboardInterrupt):
        replay(capture, out, DENSE, progress=stop_at(17))
    replay(capture, out, DENSE, progress=lambda _, done, __: seen.append(done))
    assert seen[0] > 12  # what was done counts, and is not done again
    assert seen[-1] == FRAMES
    replay(capture, tmp_path / "whole", DENSE)
    assert_same(out, tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.usefixtures("small_pictures", "no_pictures")
def test_a_full_disk_stops_a_replay_that_goes_on_later(capture, tmp_path, monkeypatch):
    """Frame 3 is damaged, so that frames and panoramas are counted apart."""
    calls = []

    def full(_: int) -> None:
        calls.append(1)
        if len(calls) > 2:  # a state is a file and its folder's names
            raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("roomlight.files.os.fsync", full)
        patch.setattr("roomlight_cli.replays.saved_replay.SAVE_EVERY", 2)
        with pytest.raises(OutputError, match=r"state: cannot be written \(No space left on device\)"):
            replay(capture, tmp_path / "out", SMALL)
    seen = []
    replay(capture, tmp_path / "out", SMALL, progress=lambda _, done, __: seen.append(done))
    assert seen[0] > 12
    replay(capture, tmp_path / "whole", SMALL)
    assert_same(tmp_path / "out", tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.usefixtures("small_pictures", "no_pictures")
def test_what_differs_is_named_and_overwrite_begins_again(capture, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        replay(capture, out, SMALL, progress=stop_at(17))
    with pytest.raises(OutputError, match=r"holds another replay .*use='lighting' there, 'reflection' here"):
        replay(capture, out, replace(SMALL, use="reflection"))
    index = capture / "capture.json"
    before = index.stat().st_mtime_ns
    os.utime(index, ns=(before, before + 10**9))
    with pytest.raises(OutputError, match=r"cannot go on: files of the recording .* begin again with --overwrite"):
        replay(capture, out, SMALL)
    os.utime(index, ns=(before, before))
    state = out / ".replay" / "state"
    state.write_bytes(state.read_bytes()[:-100])
    with pytest.raises(OutputError, match=r"cannot go on: .*truncated.*begin again with --overwrite"):
        replay(capture, out, SMALL)
    seen = []
    replay(capture, out, replace(SMALL, overwrite=True), progress=lambda _, done, __: seen.append(done))
    assert seen[0] == 1


@pytest.mark.slow
@pytest.mark.usefixtures("small_pictures", "no_pictures")
@pytest.mark.parametrize(
    ("at", "more", "said"),
    [
        (2, (), "the same command begins again"),
        (17, (), "the same command goes on after frame 16 of this run"),
        (17, ("--overwrite",), "the same command without --overwrite goes on after frame 16"),
    ],
)
def test_the_message_says_what_the_next_run_does(capture, tmp_path, monkeypatch, roomlight, at, more, said):
    monkeypatch.setattr(
        "roomlight_cli.progress.Progress.count_of", lambda _, name, done, total: stop_at(at)(name, done, total)
    )
    command = ("replay", capture, "--model", "classical", "--height", "16", "--probe", "0.4,1.2,-0.3")
    stopped = roomlight(*command, "--out", tmp_path / "out", *more)
    assert stopped.code == 130
    assert f"stopped; {said}" in stopped.err


def test_a_long_replay_is_saved_at_each_hundredth(monkeypatch: pytest.MonkeyPatch) -> None:
    """The state grows by the frames' reports: saving it takes the same share of the time."""
    monkeypatch.undo()
    due = [0, *(frames for frames in range(1, 10_001) if is_due(frames))]
    assert due[:101] == list(range(0, 2501, 25))
    assert 0.005 < max(frames / last - 1 for last, frames in itertools.pairwise(due[100:])) < 0.02
    assert len(due) < 300


@pytest.mark.slow
def test_a_pass_over_a_capture_without_depth_goes_on():
    """Scale and keyframes of estimated depth are saved too."""
    capture = open_capture(sample_capture(), CaptureOptions(depth="network", max_frames=14))
    whole, records = list[Frame](), b""
    for frame in capture:
        whole.append(frame)
        if len(whole) == 13:
            records = pack_records(records_of_values(capture.passed(), "PASS"))
    read = values_of_records(PassState, unpack_records(records, "state"), "PASS", "state")
    again = open_capture(sample_capture(), CaptureOptions(depth="network", max_frames=14))
    rest = list(again.frames(read))
    assert [frame.index for frame in rest] == [13]
    for before, after in zip(whole[13:], rest, strict=True):
        assert (before.depth_m == after.depth_m).all()
    assert again.notes == capture.notes
    assert next(iter(again)).index == 0
    assert again.passed() is None  # the first frames are compared with each other
