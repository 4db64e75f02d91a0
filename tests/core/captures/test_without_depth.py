"""Recordings without depth: read with estimated depth, or refused where the user wants files."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from box_room import LENS, exact_depth, frame, pose
from depth_models import SIZE, write_depth_model
from roomlight.captures import CaptureOptions, open_capture
from roomlight.captures.photo import PhotoOptions, read_photo
from roomlight.conventions import linear_to_srgb8
from roomlight.errors import CaptureError, ModelError, OptionError
from roomlight.images import write_png
from written_captures import write_capture

POSES = [pose(0.1 * k) for k in range(3)]


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """Return a metric model that knows the depth of the first pose."""
    truth = exact_depth(POSES[0], LENS.resized(SIZE[1], SIZE[0]))
    return write_depth_model(tmp_path / "metric.onnx", {"depth": truth[None]})


def _native(folder: Path) -> Path:
    write_capture(folder, [frame(k, at, depth=True) for k, at in enumerate(POSES)])
    index = json.loads((folder / "capture.json").read_text())
    for entry in index["frames"]:
        del entry["depth"]
    (folder / "capture.json").write_text(json.dumps(index))
    shutil.rmtree(folder / "depth")
    return folder


def _nerfstudio(folder: Path) -> Path:
    _native(folder)
    (folder / "capture.json").unlink()
    frames = [{"file_path": f"colour/{k:06d}.jpg", "transform_matrix": at.tolist()} for k, at in enumerate(POSES)]
    lens = {"fl_x": LENS.fx, "fl_y": LENS.fy, "cx": LENS.cx, "cy": LENS.cy, "w": 320, "h": 240}
    (folder / "transforms.json").write_text(json.dumps({**lens, "world_up": "y", "frames": frames}))
    return folder


def _polycam(folder: Path) -> Path:
    _native(folder)
    (folder / "keyframes/cameras").mkdir(parents=True)
    shutil.move(folder / "colour", folder / "keyframes/images")
    for k, at in enumerate(POSES):
        rows = {f"t_{row}{column}": float(at[row, column]) for row in range(3) for column in range(4)}
        lens = {"fx": LENS.fx, "fy": LENS.fy, "cx": LENS.cx, "cy": LENS.cy, "width": 320, "height": 240}
        (folder / f"keyframes/cameras/{k:06d}.json").write_text(json.dumps({**rows, **lens}))
    (folder / "capture.json").unlink()
    return folder


def _scanner_app(folder: Path) -> Path:
    _native(folder)
    for k, at in enumerate(POSES):
        shutil.move(folder / f"colour/{k:06d}.jpg", folder / f"frame_{k:05d}.jpg")
        k_matrix = [LENS.fx, 0, LENS.cx, 0, LENS.fy, LENS.cy, 0, 0, 1]
        stated = {"cameraPoseARFrame": at.astype(float).ravel().tolist(), "intrinsics": k_matrix, "time": 0.1 * k}
        (folder / f"frame_{k:05d}.json").write_text(json.dumps(stated))
    (folder / "capture.json").unlink()
    return folder


def _colmap(folder: Path) -> Path:
    _native(folder)
    (folder / "capture.json").unlink()
    shutil.move(folder / "colour", folder / "images")
    (folder / "sparse/0").mkdir(parents=True)
    camera = f"1 PINHOLE 320 240 {LENS.fx} {LENS.fy} {LENS.cx} {LENS.cy}\n"
    (folder / "sparse/0/cameras.txt").write_text(camera)
    lines = [f"{k + 1} 1 0 0 0 {-at[0, 3]} {at[1, 3]} 0 1 {k:06d}.jpg\n\n" for k, at in enumerate(POSES)]
    (folder / "sparse/0/images.txt").write_text("".join(lines))
    return folder


@pytest.mark.parametrize("write", [_native, _nerfstudio, _polycam, _scanner_app, _colmap])
def test_a_recording_without_depth_gets_it_estimated_and_says_so(
    tmp_path: Path, model: Path, write: Callable[[Path], Path]
) -> None:
    capture = open_capture(write(tmp_path / "recording"), CaptureOptions(depth_model=model))
    frames = list(capture)
    assert len(frames) == len(POSES)
    for read in frames:
        assert read.depth_m.shape == (240, 320)
        assert np.median(np.abs(read.depth_m / exact_depth(POSES[0]) - 1)) < 0.15
    (note,) = [note for note in capture.notes if "estimated" in note.left_out]
    assert "metric.onnx" in note.left_out


def test_files_can_be_demanded_or_ignored(tmp_path: Path, model: Path) -> None:
    without = _native(tmp_path / "without")
    with pytest.raises(CaptureError, match="has no depth; depth=auto estimates it"):
        list(open_capture(without, CaptureOptions(depth="file")))
    whole = write_capture(tmp_path / "whole", [frame(0, POSES[2], depth=True)])
    (measured,) = open_capture(whole, CaptureOptions(depth_model=model))
    assert np.allclose(measured.depth_m, exact_depth(POSES[2]), atol=1e-3)
    (estimated,) = open_capture(whole, CaptureOptions(depth="network", depth_model=model))
    assert np.median(np.abs(estimated.depth_m / exact_depth(POSES[0]) - 1)) < 0.02
    with pytest.raises(OptionError, match="depth=file does not estimate depth"):
        CaptureOptions(depth="file", depth_model=model)


def test_a_bad_model_is_no_bad_frame(tmp_path: Path) -> None:
    without = _native(tmp_path / "without")
    with pytest.raises(ModelError, match="there is no such depth model"):
        list(open_capture(without, CaptureOptions(depth_model=tmp_path / "absent.onnx")))


def test_masked_pixels_get_no_depth(tmp_path: Path, model: Path) -> None:
    folder = _nerfstudio(tmp_path / "masked")
    mask = np.full((240, 320, 3), 255, np.uint8)
    mask[:120] = 0
    write_png(folder / "mask.png", mask)
    index = json.loads((folder / "transforms.json").read_text())
    for entry in index["frames"]:
        entry["mask_path"] = "mask.png"
    (folder / "transforms.json").write_text(json.dumps(index))
    read = next(iter(open_capture(folder, CaptureOptions(depth_model=model))))
    assert not read.depth_m[:120].any()
    assert (read.depth_m[120:] > 0).all()


def test_a_photo_without_depth(tmp_path: Path, model: Path) -> None:
    write_png(tmp_path / "photo.png", linear_to_srgb8(frame(0, POSES[0]).image))
    photo = read_photo(tmp_path / "photo.png", None, PhotoOptions(fov_deg=59.5, depth_model=model))
    assert np.median(np.abs(photo.frame.depth_m / exact_depth(POSES[0]) - 1)) < 0.02
    assert any("estimated" in note.left_out for note in photo.notes)
    with pytest.raises(OptionError, match="one of them is used"):
        read_photo(tmp_path / "photo.png", tmp_path / "photo.png", PhotoOptions(depth_model=model))


def test_poses_without_metres_are_scaled_by_the_floor(tmp_path: Path) -> None:
    """A capture in feet that looks down: frames, measured depth and true panoramas come in metres."""
    turn = np.eye(4)
    turn[1:3, 1:3] = [[0.88, 0.48], [-0.48, 0.88]]
    turn[:3, :3] /= np.linalg.norm(turn[:3, :3], axis=0)
    shots = [frame(k, pose(0.1 * k) @ turn, depth=True).scaled(1 / 0.3048) for k in range(3)]
    probe = ((1.0, 2.0, 3.0), np.ones((8, 16, 3), np.float32))
    folder = write_capture(tmp_path / "feet", shots, probes=[probe])
    capture = open_capture(folder, CaptureOptions(camera_height_m=1.4))
    assert capture.probes[0].position == pytest.approx((0.3048, 0.6096, 0.9144), rel=0.02)
    frames = list(capture)
    assert frames[2].camera_to_world[:3, 3] == pytest.approx(pose(0.2)[:3, 3], rel=0.02)
    assert np.median(frames[0].depth_m / exact_depth(shots[0].scaled(0.3048).camera_to_world)) == pytest.approx(
        1, rel=0.02
    )
    assert np.array_equal(capture.frame_at(1).depth_m, frames[1].depth_m)
    assert any("camera for 1.4 m above the floor" in note.effect for note in capture.notes)
    assert np.allclose(next(iter(open_capture(folder))).depth_m, frames[0].depth_m / 0.3048, rtol=0.02)


def test_a_capture_whose_frames_are_all_bad_has_no_scale(tmp_path: Path) -> None:
    folder = _native(tmp_path / "bad")
    for picture in (folder / "colour").iterdir():
        picture.write_bytes(b"no picture")
    with pytest.raises(CaptureError, match="none of 3 frames can be used to find the scale"):
        list(open_capture(folder, CaptureOptions(camera_height_m=1.4)))
