"""Recordings without depth: read with estimated depth, or refused where the user wants files."""

import json
import re
import shutil
from pathlib import Path

import cv2
import formats
import numpy as np
import pytest
import tool_formats
from builders import BUILDERS
from capture_checks import edit, unreadable

from box_room import LENS, exact_depth, frame, pose
from depth_models import SIZE, write_depth_model
from roomlight.captures import CaptureOptions, open_capture
from roomlight.captures.photo import PhotoOptions, read_photo
from roomlight.conventions import linear_to_srgb8
from roomlight.errors import ModelError, OptionError
from roomlight.images import write_png
from written_captures import write_capture

POSES = [pose(0.1 * k) for k in range(3)]
VIEWS = formats.scene(2)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """Return a metric model that knows the depth of the first pose."""
    truth = exact_depth(POSES[0], LENS.resized(SIZE[1], SIZE[0]))
    return write_depth_model(tmp_path / "metric.onnx", {"depth": truth[None]})


def without_depth(name: str, folder: Path, *, emptied: bool = False) -> Path:
    """Return a capture of a layout without its files of depth, and without a word of them in its index.

    Folders of depth that are `emptied` stay, with an empty folder and what macOS leaves.
    """
    if name == "ros-bag":
        return tool_formats.ros2_bag(folder, tool_formats.ros_messages(VIEWS, without="aligned_depth"))
    path = BUILDERS[name](folder, VIEWS)
    if path.is_file():
        members = formats.record3d_members(VIEWS)
        formats.zipped(path, {name: members[name] for name in members if not name.endswith((".depth", ".conf"))})
    for file in sorted(path.rglob("*depth*")):
        was_folder = file.is_dir()
        shutil.rmtree(file) if was_folder else file.unlink(missing_ok=True)
        if emptied and was_folder:
            formats.save(file / "camera_1/.DS_Store", b"Bud1")
    for index in (path / "capture.json", path / "transforms.json"):
        if index.exists():
            edit(index, lambda stated: [f.pop(key) for f in stated["frames"] for key in list(f) if "depth" in key])
    return path


@pytest.mark.parametrize("name", [name for name in BUILDERS if name != "scannet"])  # a .sens always has depth
@pytest.mark.parametrize("emptied", [False, True])
def test_a_recording_without_depth_gets_it_estimated_and_says_so(tmp_path: Path, name: str, emptied: bool) -> None:
    seen = cv2.resize(VIEWS[0].depth_m, SIZE[::-1])
    model = write_depth_model(tmp_path / "metric.onnx", {"depth": seen[None]})
    path = without_depth(name, tmp_path / "recording", emptied=emptied)
    capture = open_capture(path, CaptureOptions(depth_model=model))
    frames = list(capture)
    assert len(frames) == len(VIEWS)
    for read in frames:
        assert read.depth_estimated
        assert np.median(np.abs(read.depth_m / VIEWS[0].depth_m - 1)) < 0.15
    (note,) = [note for note in capture.notes if "estimated" in note.left_out]
    assert "metric.onnx" in note.left_out
    unreadable(path, "depth=auto estimates it", CaptureOptions(depth="file"))


def test_files_can_be_demanded_or_ignored(tmp_path: Path, model: Path) -> None:
    whole = write_capture(tmp_path / "whole", [frame(0, POSES[2], depth=True)])
    (measured,) = open_capture(whole, CaptureOptions(depth_model=model))
    assert np.allclose(measured.depth_m, exact_depth(POSES[2]), atol=1e-3)
    (estimated,) = open_capture(whole, CaptureOptions(depth="network", depth_model=model))
    assert np.median(np.abs(estimated.depth_m / exact_depth(POSES[0]) - 1)) < 0.02
    with pytest.raises(OptionError, match="depth=file does not estimate depth"):
        CaptureOptions(depth="file", depth_model=model)


@pytest.mark.parametrize("name", [name for name in BUILDERS if name != "ros-bag"])
def test_files_of_depth_that_is_not_wanted_may_be_damaged(tmp_path: Path, model: Path, name: str) -> None:
    path, members = BUILDERS[name](tmp_path / "recording", VIEWS[:1]), formats.record3d_members(VIEWS[:1])
    for file in path.rglob("*.*"):
        if re.search("depth|conf", str(file.relative_to(path))) and not file.name.startswith("intrinsic_"):
            file.write_bytes(b"x")
    if path.suffix == ".r3d":
        formats.zipped(path, members | {name: b"x" for name in members if name.endswith((".depth", ".conf"))})
    elif path.suffix == ".sens":  # the depth is at the end
        path.write_bytes(path.read_bytes()[:-20] + bytes(20))
    (read,) = open_capture(path, CaptureOptions(depth="network", depth_model=model))
    assert read.depth_estimated
    unreadable(path, str(path), CaptureOptions(depth="file"))


def test_coloured_depth_of_nerfcapture_is_noted_and_not_read(tmp_path: Path, model: Path) -> None:
    """As the app saves it beside its pictures: 8-bit RGBA, of three times their size."""
    path = BUILDERS["nerfcapture"](tmp_path / "recording", VIEWS)
    for file in path.rglob("*.depth.png"):
        file.write_bytes(cv2.imencode(".png", np.full((72, 96, 4), 255, np.uint8))[1].tobytes())
    frames = list(capture := open_capture(path, CaptureOptions(depth_model=model)))
    assert [read.depth_estimated for read in frames] == [True] * len(VIEWS)
    (note,) = [note for note in capture.notes if "8-bit" in note.left_out]
    assert "0.depth.png" in note.left_out
    unreadable(path, "depth=auto estimates it", CaptureOptions(depth="file"))
    (path / "images/1.depth.png").unlink()
    capture = open_capture(path, CaptureOptions(depth_model=model))
    assert [read.index for read in capture] == [0]
    assert "1.depth.png" in capture.skipped[0].reason


def test_a_bad_model_is_no_bad_frame(tmp_path: Path) -> None:
    without = without_depth("roomlight", tmp_path / "without")
    with pytest.raises(ModelError, match="there is no such depth model"):
        list(open_capture(without, CaptureOptions(depth_model=tmp_path / "absent.onnx")))


def test_masked_pixels_get_no_depth(tmp_path: Path, model: Path) -> None:
    folder = without_depth("nerfstudio", tmp_path / "masked")
    mask = np.full((24, 32, 3), 255, np.uint8)
    mask[:12] = 0
    write_png(folder / "mask.png", mask)
    edit(folder / "transforms.json", lambda index: index.update(mask_path="mask.png"))
    read = next(iter(open_capture(folder, CaptureOptions(depth_model=model))))
    assert not read.depth_m[:12].any()
    assert (read.depth_m[12:] > 0).all()


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
    assert any("camera for 1.4 m above the floor" in note.effect for note in capture.notes)
    assert np.allclose(next(iter(open_capture(folder))).depth_m, frames[0].depth_m / 0.3048, rtol=0.02)


def test_a_capture_whose_frames_are_all_bad_has_no_scale(tmp_path: Path) -> None:
    folder = without_depth("roomlight", tmp_path / "bad")
    for picture in (folder / "colour").iterdir():
        picture.write_bytes(b"no picture")
    unreadable(folder, "none of 2 frames can be used to find the scale", CaptureOptions(camera_height_m=1.4))


def scannetpp_dslr(path: Path, pictures: str, masks: str) -> Path:
    """The frames of a scene's DSLR: poses twice, pictures and masks in folders that no file names."""
    mask = np.full((24, 32), 255, np.uint8)
    mask[:6] = 0
    frames, lines = [], []
    for at, view in enumerate(VIEWS):
        formats.save(path / pictures / f"DSC{at}.JPG", formats.image(".jpg", view.srgb8))
        formats.save(path / masks / f"DSC{at}.png", formats.image(".png", mask))
        matrix = (formats.Y_UP_TO_Z_UP @ view.pose).tolist()
        frames.append({"file_path": f"DSC{at}.JPG", "mask_path": f"DSC{at}.png", "transform_matrix": matrix})
        lines += [f"{at + 1} 1 0 0 0 0 0 0 1 DSC{at}.JPG", ""]
    index = {"fl_x": formats.FX, "w": 32, "h": 24, "camera_model": "PINHOLE", "frames": frames, "has_mask": True}
    formats.save(path / "nerfstudio/transforms.json", json.dumps(index).encode())
    formats.save(path / "colmap/cameras.txt", b"1 PINHOLE 32 24 28 27 16.5 11.75\n")
    formats.save(path / "colmap/images.txt", "\n".join(lines).encode())
    return path


@pytest.mark.parametrize("opened", ["", "nerfstudio", "nerfstudio/transforms.json"])
def test_pictures_of_scannetpps_dslr_lie_beside_the_index(tmp_path: Path, opened: str) -> None:
    model = write_depth_model(tmp_path / "metric.onnx", {"depth": cv2.resize(VIEWS[0].depth_m, SIZE[::-1])[None]})
    folders = ("images", "masks") if opened else ("resized_images", "resized_anon_masks")
    path = scannetpp_dslr(tmp_path / "dslr", *folders)
    capture = open_capture(path / opened, CaptureOptions(depth_model=model))
    frames = list(capture)
    assert (capture.format, capture.skipped) == ("nerfstudio", [])
    assert frames[0].source == f"{path}/{folders[0]}/DSC0.JPG"
    turn = np.eye(4) if opened else formats.FLIP  # the data set's own pictures come with a world that is z-down
    for read, view in zip(frames, VIEWS, strict=True):
        np.testing.assert_allclose(read.camera_to_world, turn @ view.pose, atol=1e-9)
        assert read.seen is not None
        assert not read.seen[:6].any()
    assert [folder for folder in folders for note in capture.notes if f"{path}/{folder} is read" in str(note)]
    shutil.rmtree(path / folders[1])
    edit(path / "nerfstudio/transforms.json", lambda index: index.update(has_mask=False))
    assert next(iter(open_capture(path / opened, CaptureOptions(depth_model=model)))).seen is None
