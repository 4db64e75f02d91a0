"""Writers and readers round-trip, and a partial capture is never read as a complete one."""

import json
from dataclasses import replace
from pathlib import Path

import formats
import numpy as np
import pytest

from roomlight.camera import Intrinsics
from roomlight.captures import CaptureWriter, open_capture
from roomlight.conventions import srgb8_to_linear
from roomlight.errors import OutputError, UnknownFormatError

VIEWS = formats.scene()
CAMERA = Intrinsics(formats.FX, formats.FY, formats.CX, formats.CY, formats.WIDTH, formats.HEIGHT)


def add(writer: CaptureWriter, view: formats.View, *, exposure: float | None = None) -> None:
    writer.add(
        srgb8=view.srgb8,
        depth_m=view.depth_m,
        intrinsics=CAMERA,
        camera_to_world=view.pose,
        timestamp_s=view.time_s,
        confidence=view.confidence,
        exposure=exposure,
    )


def add_all(writer: CaptureWriter, *, exposure: float | None = None) -> None:
    for view in VIEWS:
        add(writer, view, exposure=exposure)


def check(path: Path) -> None:
    capture = open_capture(path)
    frames = list(capture)
    assert len(frames) == 4
    assert capture.skipped == []
    for frame, view in zip(frames, VIEWS, strict=True):
        np.testing.assert_allclose(frame.camera_to_world, view.pose, atol=1e-12)
        np.testing.assert_allclose(frame.depth_m, np.where(view.confidence > 0, view.depth_m, 0), atol=1e-6)
        assert frame.timestamp_s == pytest.approx(view.time_s)
        k = frame.intrinsics
        np.testing.assert_allclose([k.fx, k.fy, k.cx, k.cy], [CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy], rtol=1e-9)
        # A lossy codec at high quality, half colour resolution: 1 % of white on the mean.
        assert np.abs(frame.image - srgb8_to_linear(view.srgb8)).mean() < 0.012


def test_native_round_trip_with_probes_and_exposure(tmp_path: Path) -> None:
    path = tmp_path / "capture"
    panorama = np.random.default_rng(0).uniform(0, 30, (8, 16, 3)).astype(np.float32)
    with CaptureWriter(path, name="room") as writer:
        add_all(writer, exposure=1.0)
        writer.add_probe((1.0, 2.0, 3.0), panorama)
        assert not path.exists()
    check(path)
    (probe,) = open_capture(path).probes
    assert probe.position == (1.0, 2.0, 3.0)
    np.testing.assert_allclose(probe.panorama(), panorama, rtol=1e-3)  # half floats: 11 bits
    assert [entry.name for entry in tmp_path.iterdir()] == ["capture"]


def test_depth_beyond_16_bits_of_millimetres_is_unknown(tmp_path: Path) -> None:
    depth_m = np.full((24, 32), 2.0, np.float32)
    depth_m[0, :5] = [np.nan, np.inf, -1, 65.535, 70]
    depth_m[0, 5] = 65.534
    with CaptureWriter(tmp_path / "capture") as writer:
        writer.add(srgb8=VIEWS[0].srgb8, depth_m=depth_m, intrinsics=CAMERA, camera_to_world=np.eye(4))
    (frame,) = open_capture(tmp_path / "capture")
    np.testing.assert_allclose(frame.depth_m[0, :6], [0, 0, 0, 0, 0, 65.534], rtol=1e-6)
    assert frame.timestamp_s is None


def test_an_exception_leaves_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with CaptureWriter(tmp_path / "capture") as writer:
            add_all(writer)
            raise KeyError("interrupted")

    with pytest.raises(KeyError):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_an_unfinished_capture_is_unreadable_and_replaced(tmp_path: Path) -> None:
    add_all(CaptureWriter(tmp_path / "capture"))
    (partial,) = tmp_path.iterdir()
    with pytest.raises(UnknownFormatError):
        open_capture(partial)
    with CaptureWriter(tmp_path / "capture") as writer:
        add_all(writer)
    assert open_capture(tmp_path / "capture").frame_count == 4


def test_invalid_input_to_the_native_writer_is_refused(tmp_path: Path) -> None:
    whole = VIEWS[0]
    with pytest.raises(OutputError, match="at least one frame"), CaptureWriter(tmp_path / "a"):
        pass
    with pytest.raises(OutputError, match="32 x 20"), CaptureWriter(tmp_path / "a") as writer:
        add(writer, replace(whole, srgb8=whole.srgb8[:20]))
    with pytest.raises(OutputError, match="lost tracking"), CaptureWriter(tmp_path / "a") as writer:
        add(writer, replace(whole, pose=np.eye(4) * np.nan))
    with pytest.raises(OutputError, match="twice as wide"), CaptureWriter(tmp_path / "a") as writer:
        writer.add_probe((0.0, 0.0, 0.0), np.zeros((4, 4, 3), np.float32))
    (tmp_path / "full").mkdir()
    (tmp_path / "full/file").write_text("x")
    with pytest.raises(OutputError, match="exists already"):
        CaptureWriter(tmp_path / "full")
    with pytest.raises(OutputError, match="cannot be created"):
        CaptureWriter(tmp_path / "full/file/capture")
    with CaptureWriter(tmp_path / "b") as writer:
        add(writer, whole)
        writer.close()  # closing early is closing once
    assert open_capture(tmp_path / "b").frame_count == 1


def test_a_capture_is_written_by_its_name_or_into_the_empty_folder_where_one_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for path in (".", str(tmp_path / "there")):
        with CaptureWriter(path) as writer:
            add_all(writer)
        check(Path(path))
    assert json.loads(Path("capture.json").read_text())["name"] == "here"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["here", "there"]


def test_a_film_of_uneven_or_missing_frames_is_noted(tmp_path: Path) -> None:
    with CaptureWriter(tmp_path / "uneven") as writer:
        for view, time_s in zip(VIEWS, (0.0, 0.1, 0.2, 1.2), strict=True):
            add(writer, replace(view, time_s=time_s))
    capture = open_capture(tmp_path / "uneven")
    assert capture.pace_note(3, 0, 2) is None
    assert "the film runs 0.1 s, the recording 0.2 s" in str(capture.pace_note(2, 0, 2))  # one was skipped
    assert "the film runs 0.3 s, the recording 1.2 s" in str(capture.pace_note(4, 0, 3))
