"""A replay through a server over a real socket writes the very bytes that one by the engine here writes."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import formats
import numpy as np
import pytest
from server_process import ServerProcess

from http_servers import InThread, RunningServer
from present import present
from roomlight.captures import CaptureOptions, CaptureWriter
from roomlight.conventions import linear_to_srgb8
from roomlight.engine.session import SessionOptions
from roomlight.errors import CaptureError, OutputError, WireError
from roomlight.images import write_exr, write_png
from roomlight_cli.replays.replay import replay
from roomlight_cli.replays.replay_options import ReplayOptions
from rooms import BoxRoom, pan
from written_captures import edited_copy

pytestmark = pytest.mark.usefixtures("small_pictures", "no_pictures")
ROOM = BoxRoom(lamp=((0.5, 3.0, 0.3), 0.3))
PROBES = ((0.4, 1.2, -0.3), (-0.8, 1.0, 0.6))
SMALL = SessionOptions(model="classical", height=16)


@pytest.fixture(scope="module")
def server():
    with RunningServer(model="classical") as running:
        yield f"http://127.0.0.1:{running.port}"


@pytest.fixture(scope="module")
def native(tmp_path_factory) -> Path:
    """Every kind of frame: JPEG, linear EXR, an exposure of its own, confidence, a depth map that does not decode."""
    path = tmp_path_factory.mktemp("captures") / "box"
    frames = list(pan(ROOM, 4, width=340, height=255))
    with CaptureWriter(path) as writer:
        for number, frame in enumerate(frames):
            exposure = 0.7 if number == 2 else 1.0
            confidence = np.full(frame.depth_m.shape, 2, np.uint8)
            confidence[:30] = 0
            writer.add(
                srgb8=linear_to_srgb8(frame.image * np.float32(exposure)),
                depth_m=frame.depth_m,
                intrinsics=frame.intrinsics,
                camera_to_world=frame.camera_to_world,
                timestamp_s=0.1 * number,
                confidence=confidence,
                exposure=exposure,
            )
    index = json.loads((path / "capture.json").read_text())
    index["frames"][1]["colour"] = "colour/linear.exr"
    write_exr(path / "colour" / "linear.exr", frames[1].image)
    broken = path / index["frames"][3]["depth"]
    broken.write_bytes(broken.read_bytes()[:60])
    (path / "capture.json").write_text(json.dumps(index))
    return path


@pytest.fixture(scope="module")
def video(tmp_path_factory) -> Path:
    return formats.stray_scanner(tmp_path_factory.mktemp("captures") / "stray", formats.scene(2))


def panoramas(out: Path) -> dict[str, bytes]:
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.rglob("*.exr"))}


def lasting(report: dict) -> dict:
    """A report without times: of the computation, and of the files in the fingerprint."""
    kept = {name: value for name, value in report.items() if name not in ("wall_s", "stage_ms_median", "fingerprint")}
    kept["frames"] = [
        {name: value for name, value in frame.items() if name != "stage_ms"} for frame in report["frames"]
    ]
    return kept


def replay_both(capture: Path, url: str, out: Path, options: ReplayOptions, remote: ReplayOptions | None = None):
    """Replay here and through a server, into `here` and `there`; check that the panoramas are the same."""
    here = replay(capture, out / "here", options)
    there = replay(capture, out / "there", replace(remote or options, server=url))
    assert panoramas(out / "there") == panoramas(out / "here") != {}
    return here, there


@pytest.mark.slow
@pytest.mark.usefixtures("pictures")
def test_files_are_the_same_as_those_of_a_local_replay(native, server, tmp_path):
    here, there = replay_both(native, server, tmp_path, ReplayOptions(session=SMALL, probes=PROBES))
    assert len(panoramas(tmp_path / "here")) == 2 * len(here["frames"]) > 3
    assert lasting(there) == lasting(here)
    assert there["stage_ms_median"].keys() == here["stage_ms_median"].keys()
    assert (tmp_path / "there" / "replay.mp4").read_bytes() == (tmp_path / "here" / "replay.mp4").read_bytes()
    sheets = [present(cv2.imread(str(tmp_path / place / "summary.png"))) for place in ("here", "there")]
    # the frame at the top left has spheres only where the engine is, and `observed` comes in steps of 1/255
    lower = [sheet.astype(int)[sheet.shape[0] // 2 :] for sheet in sheets]
    assert np.abs(lower[0] - lower[1]).max() <= 1


@pytest.mark.slow
def test_networks_give_the_same_files(native, tiny_video, tmp_path):
    """The server has the weights; the remote replay names the model only."""
    weights = tiny_video
    options = ReplayOptions(session=SessionOptions(model="video", height=32, weights=weights), probes=PROBES)
    remote = replace(options, session=SessionOptions(model="video", height=32))
    with RunningServer(model="video", weights=weights) as running:
        here, there = replay_both(native, f"http://127.0.0.1:{running.port}", tmp_path, options, remote)
    assert lasting(there) == lasting(here)
    assert here["model"] == "video"


def test_video_captures_give_the_same_files(video, server, tmp_path):
    replay_both(video, server, tmp_path, ReplayOptions(session=SMALL, probes=PROBES[:1]))
    assert len(panoramas(tmp_path / "here")) == 2


def test_interpolation_and_the_default_probe_are_the_same(native, server, tmp_path):
    here, there = replay_both(native, server, tmp_path, ReplayOptions(session=SMALL, every=2, interpolate=True))
    assert lasting(there) == lasting(here)
    assert here["interpolated"] > 0


def test_frames_without_depth_at_working_size(native, server, tmp_path):
    """Known depth only in a column that sampling leaves out: no session here starts with it; a server estimates it."""
    odd = edited_copy(native, tmp_path / "odd", lambda _: None)
    left_out = sorted(set(range(340)) - {int((column + 0.5) * 340 / 320) for column in range(320)})
    depth = odd / "depth" / "000000.png"
    millimetres = present(cv2.imread(str(depth), cv2.IMREAD_UNCHANGED))
    millimetres[:, sorted(set(range(340)) - {left_out[5]})] = 0
    write_png(depth, millimetres)
    options = ReplayOptions(session=SMALL, probes=PROBES[:1])
    here = replay(odd, tmp_path / "here", options)
    there = replay(odd, tmp_path / "there", replace(options, server=server))
    assert [[frame["index"] for frame in report["frames"]] for report in (here, there)] == [[1, 2], [0, 1, 2]]
    skipped = {one["index"]: one for one in here["skipped"]}
    assert skipped.keys() == {0, 3}
    assert Path(skipped[0]["file"]).name in skipped[0]["reason"]


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        (ReplayOptions(session=SessionOptions(model="classical", height=1024)), WireError, "height"),
        (ReplayOptions(CaptureOptions(depth_unit_m=1e-6), session=SMALL), CaptureError, "depth unit"),
    ],
)
def test_a_failed_replay_leaves_no_output(native, server, tmp_path, options, error, message):
    with pytest.raises(error, match=message):
        replay(native, tmp_path / "out", replace(options, server=server))
    assert not (tmp_path / "out").exists()


def test_local_and_remote_replays_do_not_share_a_folder(native, server, tmp_path):
    options = ReplayOptions(CaptureOptions(max_frames=1), session=SMALL, probes=PROBES[:1])
    replay(native, tmp_path / "out", options)
    with pytest.raises(OutputError, match=r"another replay .*server=none there"):
        replay(native, tmp_path / "out", replace(options, server=server))


def test_the_session_is_deleted_after_errors_too(native, tmp_path):
    def stop(*_):
        raise KeyboardInterrupt

    with RunningServer(model="classical", max_sessions=1) as running:
        options = ReplayOptions(CaptureOptions(max_frames=1), session=SMALL, server=f"http://127.0.0.1:{running.port}")
        replay(native, tmp_path / "whole", options)
        with pytest.raises(KeyboardInterrupt):
            replay(native, tmp_path / "stopped", options, progress=stop)
        assert running.registry.items() == []


@pytest.mark.slow
def test_a_replay_survives_a_killed_server(native, tmp_path):
    """The new server gets all frames again, so that the files are those of a replay without the interruption."""
    options = ReplayOptions(session=SMALL, probes=PROBES)
    replay(native, tmp_path / "here", options)
    events = []
    with ServerProcess() as server:
        starting = []

        def kill_once(_, done, __):
            if done == 1 and not starting:
                server.kill()
                starting.append(InThread(server.start))

        remote = replace(options, server=server.url)
        replay(native, tmp_path / "there", remote, progress=kill_once, on_recovery=events.append)
        starting[0].result()
    assert panoramas(tmp_path / "there") == panoramas(tmp_path / "here")
    assert [event.state for event in events] == ["waiting", "restored"]
    assert events[1].reopened
    assert not events[1].incomplete
