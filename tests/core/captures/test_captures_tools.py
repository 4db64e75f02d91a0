"""Layouts of data sets and tools beside those that `test_captures_readers` covers, and what is refused by name."""

import json
import shutil
import sqlite3
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import cv2
import formats
import numpy as np
import pytest
import tool_formats
from capture_checks import edit, first_of, notes_of, one_skipped, refused, same_views, unreadable
from rosbags.highlevel import AnyReader
from tool_formats import COLOUR, DEPTH, OPTICAL, Message

from roomlight.captures import CaptureOptions, open_capture, source
from roomlight.captures.formats.packed_depth import lz4_block
from roomlight.captures.formats.ros.bag import RosBagReader
from roomlight.captures.formats.ros.images import decode_colour_image, decode_depth_image
from roomlight.conventions import srgb8_to_linear
from roomlight.errors import RoomLightError, UnknownFormatError

VIEWS = formats.scene()


# ScanNet and ScanNet++


@pytest.mark.parametrize("kind", ["stream", "deflate", "lz4"])
def test_scannetpp_as_downloaded(tmp_path: Path, kind: str) -> None:
    """A video of 21 frames in which every tenth is listed, and packed depth of 256 x 192."""
    path = tool_formats.scannetpp(tmp_path / "iphone", VIEWS[:3])
    shutil.rmtree(path / "rgb")
    shutil.rmtree(path / "depth")
    edit(path / "pose_intrinsic_imu.json", lambda index: [index.pop(key) for key in list(index) if key.endswith("1")])
    pictures = [VIEWS[number // 10].srgb8 // (1 + number % 10) for number in range(21)]
    formats.video(path / "rgb.mkv", pictures, rate=60, options={"crf": "4"}, file={"format": "matroska"})
    maps = [np.full((192, 256), 1 + 0.1 * number, np.float32) for number in range(21)]
    for depth_m in maps:
        depth_m[96:] += 0.5
    (path / "depth.bin").write_bytes(tool_formats.packed_depth(maps, kind))
    capture = open_capture(path)
    frames = list(capture)
    assert capture.skipped == []
    for number, (frame, view) in enumerate(zip(frames, VIEWS[:3], strict=True)):
        np.testing.assert_allclose(frame.camera_to_world, view.pose, atol=1e-9)
        np.testing.assert_allclose(frame.depth_m, maps[10 * number], atol=6e-4)
        assert np.abs(frame.image - srgb8_to_linear(view.srgb8)).mean() < 0.012
    np.testing.assert_allclose(next(iter(capture)).depth_m, maps[0], atol=6e-4)
    data = (path / "depth.bin").read_bytes()
    (path / "depth.bin").write_bytes(data[: len(data) * 2 // 3])
    capture = open_capture(path)
    assert len(list(capture)) < 3
    assert all("depth.bin" in skipped.reason for skipped in capture.skipped)


@pytest.mark.parametrize(("kind", "unit_m"), [("stream", 2.0), ("deflate", 2.0), ("lz4", 0.002)])
def test_a_stated_unit_is_that_of_the_packed_values(tmp_path: Path, kind: str, unit_m: float) -> None:
    """Floats are stored in metres, integers in millimetres; the largest integer is unknown as in a PNG."""
    path = tool_formats.scannetpp(tmp_path / "iphone", VIEWS[:1])
    shutil.rmtree(path / "depth")
    depth_m = np.full((192, 256), 1.5, np.float32)
    if kind == "lz4":
        depth_m[:8] = 65.535
    (path / "depth.bin").write_bytes(tool_formats.packed_depth([depth_m], kind))
    (frame,) = open_capture(path, CaptureOptions(depth_unit_m=unit_m))
    np.testing.assert_allclose(frame.depth_m[8:], 3.0, rtol=1e-6)
    assert frame.depth_m[:8].max() == pytest.approx(0.0 if kind == "lz4" else 3.0)


@pytest.mark.parametrize("data", [b"", b"\x00\x00", b"\xf0\xff\xff", b"\x10A\x05\x00", b"\x1fA\x01\x00" + b"\xff" * 99])
def test_damaged_lz4_is_refused(data: bytes) -> None:
    with pytest.raises((ValueError, IndexError)):
        lz4_block(data, 64)


@pytest.mark.parametrize(
    ("build", "name"),
    [
        (tool_formats.scannetpp, "rgb_masks/frame_000010.png"),
        (formats.colmap, "masks/frame_00002.png.png"),
        (formats.colmap, "masks/frame_00002.png"),
    ],
)
def test_pixels_of_a_mask_are_not_seen(tmp_path: Path, build: Callable[..., Path], name: str) -> None:
    path, mask = build(tmp_path / "capture", VIEWS), np.full((24, 32), 255, np.uint8)
    mask[:6] = 0
    formats.save(path / name, formats.image(".png", mask))
    plain, masked, *_ = open_capture(path)
    assert plain.seen is None
    assert masked.seen is not None
    assert not masked.seen[:6].any()


def test_scannetpp_with_missing_parts(tmp_path: Path) -> None:
    path = tool_formats.scannetpp(tmp_path / "iphone", VIEWS)
    (path / "rgb_mask.mkv").write_bytes(b"x")
    assert any("rgb_mask.mkv" in note.left_out for note in open_capture(path).notes)
    shutil.rmtree(path / "rgb")
    refused(path, r"neither rgb/ nor rgb\.mkv")


@pytest.mark.parametrize("build", [formats.scannet, tool_formats.scannet_frames])
@pytest.mark.parametrize("other", ["extrinsic_color", "intrinsic_depth", "extrinsic_depth"])
def test_depth_of_another_camera_is_projected_into_the_colour_image(
    tmp_path: Path, build: Callable[..., Path], other: str
) -> None:
    """A wall at 1 m beside one at 3 m, in depth of twice the size."""
    depth_m = np.where(np.arange(64) < 32, 1.0, 3.0)
    path = build(tmp_path / "capture", [replace(VIEWS[0], depth_m=np.broadcast_to(depth_m, (48, 64)))])
    scale, shift = (4, 0.0) if other == "intrinsic_depth" else (2, 0.2)
    k, moved = np.diag([scale * formats.FX, scale * formats.FY, 1, 1]), np.eye(4)
    k[:2, 2] = 2 * formats.CX - 0.5, 2 * formats.CY - 0.5
    moved[0, 3] = -shift if other == "extrinsic_color" else shift
    for name, matrix in {"intrinsic_depth": k, other: k if other == "intrinsic_depth" else moved}.items():
        if path.is_dir():
            np.savetxt(path / f"intrinsic/{name}.txt", matrix)
            continue
        data = bytearray(path.read_bytes())
        at = 27 + 64 * ("intrinsic_color", "extrinsic_color", "intrinsic_depth", "extrinsic_depth").index(name)
        data[at : at + 64] = matrix.astype("<f4").tobytes()
        data[299:307] = struct.pack("<2i", 64, 48)
        path.write_bytes(data)
    (frame,) = open_capture(path)
    height, width = frame.depth_m.shape
    row, camera = frame.depth_m[height // 2], frame.intrinsics.resized(width, height)
    x = (np.flatnonzero(row) + 0.5 - camera.cx) / camera.fx * row[row > 0]
    seen = (np.arange(64) + 0.5 - 2 * formats.CX) / (scale * formats.FX) * depth_m + shift
    assert x.min() == pytest.approx(max(seen.min(), (0.5 - camera.cx) / camera.fx), abs=0.06)
    assert set(row[row > 0].round(3)) == {np.float32(1.0), np.float32(3.0)}


def test_scannets_frames_with_k_beside_the_folders(tmp_path: Path) -> None:
    """As in `scannet_frames_25k`, whose depth camera has a K of its own."""
    path = tool_formats.scannet_frames(tmp_path / "capture", VIEWS)
    for kind in ("color", "depth"):
        (path / f"intrinsic/intrinsic_{kind}.txt").rename(path / f"intrinsics_{kind}.txt")
    shutil.rmtree(path / "intrinsic")
    same_views(open_capture(path), VIEWS)


@pytest.mark.parametrize("times", [2, 1.5, 0.5])
def test_scannets_frames_resized_beside_the_k_of_the_whole(tmp_path: Path, times: float) -> None:
    path = tool_formats.scannet_frames(tmp_path / "capture", VIEWS[:2])
    fx, fy, cx, cy = (times * value for value in (formats.FX, formats.FY, formats.CX, formats.CY))
    whole = f"{fx} 0 {cx} 0\n0 {fy} {cy} 0\n0 0 1 0\n0 0 0 1\n"
    (path / "intrinsic/intrinsic_color.txt").write_text(whole)
    unreadable(path, r"for another size; scale fx and cx with the width.*or give the pictures")


@pytest.mark.parametrize("build", [tool_formats.scannet_frames, tool_formats.rtabmap])
def test_pictures_called_jpeg_are_read(tmp_path: Path, build: Callable[..., Path]) -> None:
    path = build(tmp_path / "capture", VIEWS)
    for picture in path.rglob("*.jpg"):
        picture.rename(picture.with_suffix(".jpeg"))
    notes_of(path, frames=4)


# ICL-NUIM, in TUM's form


def test_icl_nuims_pairs_and_left_handed_poses(tmp_path: Path) -> None:
    path, y_turned = formats.tum(tmp_path / "capture", VIEWS), np.diag([1.0, -1.0, 1.0, 1.0])
    pairs, poses = ["# pairs"], []
    for number, view in enumerate(VIEWS):
        name = f"{view.time_s:.6f}.png"
        pairs.append(f"{number} depth/{name} {number} rgb/{name}")
        pose = y_turned @ formats.FLIP @ view.pose @ formats.FLIP @ y_turned
        poses.append(" ".join(map(str, (number, *pose[:3, 3], *formats.quaternion(pose[:3, :3])))))
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt", "camera-intrinsics.txt"):
        (path / name).unlink()
    (path / "associations.txt").write_text("\n".join(pairs))
    (path / "livingRoom0.gt.freiburg").write_text("\n".join(poses))
    frames = list(capture := open_capture(path))
    assert (capture.format, capture.frames_per_second) == ("tum", pytest.approx(30))
    same_views(frames, VIEWS, depth_atol=2e-4)
    assert frames[0].intrinsics.fx == pytest.approx(481.2 / 20)
    assert any("focal length of 481.2 pixels" in note.effect for note in capture.notes)
    (path / "associations.txt").unlink()
    (path / "association.txt").write_text("0 depth/0.png 0")
    refused(path, r"association\.txt: line 1: is '0 depth/0\.png 0', not a time")


# RTAB-Map


def test_rtabmap_by_time_with_the_robots_poses(tmp_path: Path) -> None:
    """Names are times, the poses are the robot's, and the calibration holds the camera's place on it."""
    path = tool_formats.rtabmap(tmp_path / "capture", VIEWS)
    mount = ", ".join(str(float(value)) for value in tool_formats.MOUNT[:3].reshape(-1))
    extra = f"local_transform:\n   rows: 3\n   cols: 4\n   data: [ {mount} ]\n"
    lines = []
    for index, view in enumerate(VIEWS):
        number, stem = 3 * index + 10, f"{view.time_s:.6f}"
        (path / f"room_rgb/{number}.jpg").rename(path / f"room_rgb/{stem}.jpg")
        (path / f"room_depth/{number}.png").rename(path / f"room_depth/{stem}.png")
        (path / f"room_calib/{number}.yaml").unlink()
        formats.save(path / f"room_calib/{stem}.yaml", tool_formats.opencv_yaml(stem, extra).encode())
        base = formats.Y_UP_TO_Z_UP @ view.pose @ formats.FLIP @ np.linalg.inv(tool_formats.MOUNT)
        values = [view.time_s, *base[:3, 3], *formats.quaternion(base[:3, :3])]
        lines.append(" ".join(map(str, values)))
    (path / "room_camera_poses.txt").unlink()
    (path / "room_poses.txt").write_text("\n".join(lines))
    for frame, view in zip(open_capture(path), VIEWS, strict=True):
        np.testing.assert_allclose(frame.camera_to_world, view.pose, atol=1e-6)
        assert frame.timestamp_s == pytest.approx(view.time_s)
    formats.save(path / f"room_calib/{VIEWS[1].time_s:.6f}.yaml", tool_formats.opencv_yaml("x").encode())
    one_skipped(path, 1, "local_transform", "--poses_camera")


def test_what_macos_leaves_beside_an_export_of_rtabmap_is_not_read(tmp_path: Path) -> None:
    path = tool_formats.rtabmap(tmp_path / "capture", VIEWS)
    for name in ("rgb", "depth", "calib", "camera_poses.txt"):
        formats.save(path / f"._room_{name}", b"\0\5\x16\7")
    same_views(open_capture(path), VIEWS)


def test_confidence_of_rtabmap_is_in_percent(tmp_path: Path) -> None:
    path, percent = tool_formats.rtabmap(tmp_path / "capture", VIEWS), np.full((24, 32), 100, np.uint8)
    percent[:4], percent[4:8], percent[8:12] = 0, 49, 50
    formats.save(path / "room_confidence/10.png", formats.image(".png", percent))
    for least, rows in ((None, 8), (2, 12), (0, 0)):
        first, second, *_ = open_capture(path, CaptureOptions(min_confidence=least))
        assert np.flatnonzero(first.depth_m.any(axis=1))[0] == rows
        assert second.depth_m.all()  # a frame may have none


def test_rtabmap_without_a_pose_or_a_camera(tmp_path: Path) -> None:
    path = tool_formats.rtabmap(tmp_path / "capture", VIEWS)
    poses = (path / "room_camera_poses.txt").read_text()
    (path / "room_camera_poses.txt").write_text(poses.replace(" 13\n", " 14\n"))
    one_skipped(path, 1, "the poses have none of its number or time; export them with --poses_format 11")
    (path / "room_camera_poses.txt").write_text(poses)
    (path / "room_calib/13.yaml").write_text("%YAML:1.0\nimage_width: 32\n")
    one_skipped(path, 1, "13.yaml", "camera_matrix")
    for number in (10, 13, 16, 19):
        text = tool_formats.opencv_yaml(number).replace("[ 0., 0.", "[ 0.1, 0.")
        (path / f"room_calib/{number}.yaml").write_text(text)
    capture = open_capture(path)
    assert len(list(capture)) == 4
    assert "distortion" in capture.notes[0].left_out
    for line in ("1.0 2.0", "1 0 0 0 0 1 0 0 0 0 1 0"):
        (path / "room_camera_poses.txt").write_text(f"{line}\n")
        refused(path, r"room_camera_poses\.txt: line 1.*--poses_format 11")


# COLMAP


def own_depth_maps(path: Path) -> Path:
    """COLMAP's own maps in place of the others."""
    shutil.rmtree(path / "depth")
    for index, view in enumerate(VIEWS):
        data = f"{formats.WIDTH}&{formats.HEIGHT}&1&".encode() + view.depth_m.astype("<f4").tobytes()
        formats.save(path / f"stereo/depth_maps/frame_{index + 1:05d}.png.geometric.bin", data)
    return path


def test_colmaps_own_depth_maps(tmp_path: Path) -> None:
    path = own_depth_maps(formats.colmap(tmp_path / "dense", VIEWS))
    same_views(open_capture(path), VIEWS, depth_atol=1e-6)
    doubled = first_of(path, CaptureOptions(depth_unit_m=2.0))
    np.testing.assert_allclose(doubled.depth_m, 2 * VIEWS[0].depth_m, rtol=1e-6)
    (path / "stereo/depth_maps/frame_00002.png.geometric.bin").write_bytes(b"32&24&1&1234")
    one_skipped(path, 1, "a map of 32 x 24 does not have")


@pytest.mark.parametrize(("model", "read"), [("sparse", "images"), ("distorted/sparse", "input")])
def test_pictures_of_3d_gaussian_splatting_before_it_undistorts_them(tmp_path: Path, model: str, read: str) -> None:
    path = formats.colmap(tmp_path / "capture", VIEWS)
    (path / "images").rename(path / "input")
    (path / model).parent.mkdir(exist_ok=True)
    (path / "sparse").rename(path / model)
    same_views(open_capture(path, CaptureOptions(depth="file")), VIEWS)
    shutil.copytree(path / "input", path / "images")
    assert first_of(path).source == f"{path}/{read}/frame_00001.png"


def test_relative_depth_beside_a_colmap_model(tmp_path: Path) -> None:
    """As 3D Gaussian splatting takes it, whose `make_depth_scale.py` fits each map to the model's points."""
    path = formats.colmap(tmp_path / "capture", VIEWS)
    fits = {}
    for index, view in enumerate(VIEWS):
        inverse = 1 / view.depth_m.astype(np.float64)
        offset = inverse.min() - 0.05 * np.ptp(inverse)
        scale = (inverse.max() - offset) * 65536 / 65535
        stored = np.rint((inverse - offset) / scale * 65536).astype(np.uint16)
        formats.save(path / f"depth/frame_{index + 1:05d}.png", formats.image(".png", stored))
        fits[f"frame_{index + 1:05d}"] = {"scale": scale, "offset": offset}
    formats.save(path / "sparse/0/depth_params.json", json.dumps(fits).encode())
    same_views(open_capture(path), VIEWS, depth_atol=1e-3)
    edit(path / "sparse/0/depth_params.json", lambda stated: stated["frame_00002"].update(scale=12 * scale))
    one_skipped(path, 1, "depth_params.json: scale is ", "not 0.2 to 5 times the median")
    edit(path / "sparse/0/depth_params.json", lambda stated: stated["frame_00002"].update(scale=0))
    one_skipped(path, 1, "depth_params.json: scale is 0")
    edit(path / "sparse/0/depth_params.json", lambda stated: stated.pop("frame_00002"))
    one_skipped(path, 1, "depth_params.json: has no entry of this image")


def workspace(path: Path) -> Path:
    """COLMAP's automatic reconstruction: the model has a lens, the undistorted images are larger."""
    shutil.rmtree(formats.colmap(path, VIEWS) / "depth")
    data = bytearray((path / "sparse/0/cameras.bin").read_bytes())
    parameters = struct.pack("<8d", formats.FX, formats.FY, formats.CX, formats.CY, -0.2, 0, 0, 0)
    (path / "sparse/0/cameras.bin").write_bytes(data[:12] + struct.pack("<i", 4) + data[16:32] + parameters)
    dense = own_depth_maps(formats.colmap(path / "dense/0", VIEWS))
    for name in ("cameras.bin", "images.bin"):
        (dense / "sparse/0" / name).rename(dense / "sparse" / name)
    grey = formats.image(".png", np.full((formats.HEIGHT, formats.WIDTH, 3), 128, np.uint8))
    for picture in (path / "images").iterdir():
        picture.write_bytes(grey)
    return path


def test_depth_of_colmaps_dense_folder_is_read_with_its_images(tmp_path: Path) -> None:
    path = workspace(tmp_path / "capture")
    formats.save(path / "masks/frame_00001.png", formats.image(".png", np.zeros((24, 32), np.uint8)))
    capture = open_capture(path)
    for frame, view in zip(capture, VIEWS, strict=True):
        np.testing.assert_allclose(frame.image, srgb8_to_linear(view.srgb8), atol=1e-6)
        np.testing.assert_allclose(frame.depth_m, view.depth_m, rtol=1e-6)
        assert frame.seen is None
    assert any("/masks" in note.left_out for note in capture.notes)
    assert not any("the models" in note.left_out for note in capture.notes)
    shutil.copytree(path / "dense/0", path / "dense/1")
    assert any("the models dense/1/sparse" in note.left_out for note in open_capture(path).notes)
    shutil.rmtree(path / "dense/0/images")
    assert any("dense/0/ lacks" in note.effect for note in open_capture(path).notes)


@pytest.mark.parametrize(("name", "folder"), [("colmap", "sparse/0"), ("dense", "sparse")])
def test_a_colmap_recording_may_be_called_as_its_parts_are(tmp_path: Path, name: str, folder: str) -> None:
    path = formats.colmap(tmp_path / "scene" / name, VIEWS)
    if folder == "sparse":
        for file in ("cameras.bin", "images.bin"):
            (path / "sparse/0" / file).rename(path / "sparse" / file)
    same_views(open_capture(path.parent, CaptureOptions(depth="file")), VIEWS, depth_atol=1e-6)
    formats.tum(path.parent / "other", VIEWS)
    refused(path.parent, rf"holds 2 captures \({name}, other\)", error=UnknownFormatError)
    formats.colmap_files(path.parent, VIEWS)
    assert first_of(path.parent).source == f"{path.parent}/images/frame_00001.png"


@pytest.mark.parametrize("opened", ["sparse/0", "sparse"])
def test_a_colmap_model_is_read_with_the_pictures_above_it(tmp_path: Path, opened: str) -> None:
    path = formats.colmap(tmp_path / "capture", VIEWS[:2])
    same_views(open_capture(path / opened), VIEWS[:2], depth_atol=1e-6)
    assert any(f"read from {path}" in note for note in notes_of(path / opened))
    workspace(path)
    capture = open_capture(path / opened)
    assert any("sparse/0 is of others" in note.effect for note in capture.notes)
    assert next(iter(capture)).image.shape == (24, 32, 3)


@pytest.mark.parametrize("folder", ["images", "input"])
def test_pictures_that_a_colmap_model_did_not_place_are_noted(tmp_path: Path, folder: str) -> None:
    path = formats.colmap(tmp_path / "capture", VIEWS)
    (path / folder).mkdir(exist_ok=True)
    for number in range(1, 8):
        shutil.copy(path / "images/frame_00001.png", path / f"{folder}/more_{number}.png")
        shutil.copy(path / "images/frame_00001.png", path / f"{folder}/._more_{number}.png")
    said = f"{path}/{folder}: the model placed 4 of {11 if folder == 'images' else 7} pictures"
    assert any(note.left_out == said for note in open_capture(path).notes)


def test_small_pictures_of_a_colmap_model_are_read(tmp_path: Path) -> None:
    path = formats.colmap(tmp_path / "capture", VIEWS[:1])
    formats.save(path / "images_2/frame_00001.png", formats.image(".png", VIEWS[0].srgb8[::2, ::2]))
    shutil.rmtree(path / "images")
    (frame,) = open_capture(path)
    assert (frame.intrinsics.width, frame.intrinsics.fx) == (16, formats.FX / 2)
    shutil.rmtree(path / "images_2")
    refused(path, r"capture: has no pictures \(images, images_2, .*copy frame_00001\.png")


def test_other_names_of_a_colmap_models_depth(tmp_path: Path) -> None:
    path = formats.colmap(tmp_path / "capture", VIEWS)
    (path / "depth/frame_00001.png").rename(path / "depth/frame_00001.png.png")
    (path / "depth/frame_00002.png").unlink()
    formats.save(path / "depth/frame_00002.tif", formats.image(".tif", VIEWS[1].depth_m))
    same_views(open_capture(path), VIEWS, depth_atol=1e-6)


@pytest.mark.parametrize("build", [formats.colmap, formats.colmap_text])
def test_points_of_a_colmap_model_do_not_count_as_its_index(
    tmp_path: Path, build: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = build(tmp_path / "capture", VIEWS)
    (images,) = path.rglob("images.*")
    point, sep = struct.pack("<ddq", 1.0, 2.0, -1), b"1.0 2.0 -1"
    data = images.read_bytes().replace(struct.pack("<Q", 1) + point, struct.pack("<Q", 900) + 900 * point)
    images.write_bytes(data.replace(sep, b" ".join(900 * [sep])))
    monkeypatch.setattr(source, "MAX_INDEX_BYTES", 4000)
    same_views(open_capture(path), VIEWS)
    images.write_bytes(images.read_bytes()[:-23000])
    if images.suffix == ".bin":
        refused(path, r"images\.bin: the model is truncated or damaged")


@pytest.mark.parametrize("build", [formats.colmap, formats.colmap_text])
def test_what_is_wrong_with_colmaps_cameras_names_their_file(tmp_path: Path, build: Callable[..., Path]) -> None:
    (cameras,) = build(tmp_path / "capture", VIEWS).rglob("cameras.*")
    cameras.write_bytes(b"1 PINHOLE\0")
    refused(tmp_path / "capture", rf"{cameras.name}: (is not text|the model is truncated)")


def test_late_camera_models_of_colmap(tmp_path: Path) -> None:
    """SIMPLE_FISHEYE has no coefficients; EUCM is not read."""
    path = formats.colmap(tmp_path / "capture", VIEWS)
    size = formats.WIDTH, formats.HEIGHT
    data = struct.pack("<QiiQQ3d", 1, 1, 14, *size, formats.FX, formats.CX, formats.CY)
    (path / "sparse/0/cameras.bin").write_bytes(data)
    assert first_of(path).intrinsics.fx < formats.FX
    data = struct.pack("<QiiQQ6d", 1, 1, 16, *size, formats.FX, formats.FY, formats.CX, formats.CY, 0.5, 1.0)
    (path / "sparse/0/cameras.bin").write_bytes(data)
    unreadable(path, "its camera model EUCM cannot be used")


def test_names_of_a_windows_code_page_in_a_binary_model(tmp_path: Path) -> None:
    path = formats.colmap(tmp_path / "capture", VIEWS)
    data = (path / "sparse/0/images.bin").read_bytes()
    (path / "sparse/0/images.bin").write_bytes(data.replace(b"frame_00002", "K\xfcche_00002".encode("latin-1")))
    for folder in ("images", "depth"):
        (path / folder / "frame_00002.png").rename(path / folder / "K\xfcche_00002.png")
    notes_of(path, frames=4)


# ROS


def renamed(topics: dict[str, str], messages: list[Message]) -> list[Message]:
    return [(topics.get(topic, topic), kind, time_s, data) for topic, kind, time_s, data in messages]


REALSENSE = {
    COLOUR: "/device_0/sensor_1/Color_0/image/data",
    "/camera/color/camera_info": "/device_0/sensor_1/Color_0/info/camera_info",
    DEPTH: "/device_0/sensor_0/Depth_0/image/data",
}
ISAAC = {COLOUR: "/rgb", "/camera/color/camera_info": "/camera_info", DEPTH: "/depth"}


@pytest.mark.parametrize(
    ("names", "without", "says"),
    [
        ({}, "/tf", r"no poses of camera_color_optical_frame.*RTAB-Map"),
        ({}, "/tf_static", r"has poses of base_link, and no tf from there to camera_color.*tf_static"),
        ({}, "/camera/color/image", r"no topic of colour images; its topics are /camera/aligned_depth"),
        ({}, "/camera/color/camera_info", "no CameraInfo beside /camera/color/image_raw"),
        (REALSENSE, "/tf", "recordings of RealSense alone hold none"),
    ],
)
def test_a_bag_without_poses_colour_or_camera_says_so(
    tmp_path: Path, names: dict[str, str], without: str, says: str
) -> None:
    messages = renamed(names, tool_formats.ros_messages(VIEWS, without=without))
    refused(tool_formats.ros2_bag(tmp_path / "bag", messages), says)


@pytest.mark.parametrize("names", [REALSENSE, ISAAC])
def test_topics_of_realsense_and_isaac_sim_are_known(tmp_path: Path, names: dict[str, str]) -> None:
    messages = renamed(names, tool_formats.ros_messages(VIEWS))
    notes_of(tool_formats.ros2_bag(tmp_path / "bag", messages), frames=4)


def test_a_compressed_mosaic_is_refused() -> None:
    grey = np.repeat(VIEWS[0].srgb8[..., :1], 3, axis=2)
    message = SimpleNamespace(format="bayer_rggb8; jpeg compressed ", data=formats.image(".jpg", grey))
    with pytest.raises(ValueError, match="colour of 'bayer_rggb8', compressed, is not read; debayer"):
        decode_colour_image(message, "x")


def test_compressed_depth_may_be_a_tiff() -> None:
    stored = formats.millimetres(VIEWS[0])
    message = SimpleNamespace(format="16UC1; compressedDepth", data=formats.image(".tiff", stored))
    np.testing.assert_allclose(decode_depth_image(message, "x", None), stored / 1000, atol=1e-6)


BAG = b"#ROSBAG V2.0\n" + bytes(99)
MCAP = b"\x89MCAP0\r\n\1" + struct.pack("<QI", 12, 4) + b"ros1\0\0\0\0"

REINDEXED = b"""
rosbag2_bagfile_information:
  version: 5
  relative_file_paths: [d.mcap]
  storage_identifier: ''
"""


@pytest.mark.parametrize(
    ("name", "data", "says"),
    [
        ("d.bag", BAG, r"d\.bag: is not a readable ROS bag .*; copy it again; rosbag reindex"),
        ("d.BAG", BAG, r"; rename it to end in \.bag"),
        ("d.mcap", MCAP[:9], "; copy it again; mcap recover IN -o OUT repairs"),
        ("d.bag.active", BAG, r"d\.bag\.active is a ROS bag that was not closed; rosbag reindex it, .* to d\.bag"),
        ("d/metadata.yaml", REINDEXED, r"names no storage; delete that file, or open the \.db3 or \.mcap itself"),
        ("d.mcap", MCAP, "its profile is 'ros1'; record it with ROS 2"),
    ],
)
def test_a_file_that_is_no_readable_bag_says_so(tmp_path: Path, name: str, data: bytes, says: str) -> None:
    formats.save(tmp_path / name, data)
    if "/" in name:
        formats.save(tmp_path / "d/d.mcap", MCAP)
    refused(tmp_path / name.split("/")[0], says, error=RoomLightError)


def test_definitions_of_types_that_are_not_read_do_not_count(tmp_path: Path) -> None:
    """Drivers write none, or the wrong hash; rosbridge cuts them off."""
    others = ("rslidar_msgs/msg/Scan", ""), ("std_msgs/msg/Int8", "int8 data"), ("a/msg/B", "sensor_msgs/Imu i\na/C")
    path = tool_formats.ros1_bag(tmp_path / "walk.bag", tool_formats.ros_messages(VIEWS), *others)
    same_views(open_capture(path), VIEWS, depth_atol=6e-4)
    path = tool_formats.ros1_bag(tmp_path / "other.bag", [], *others)
    refused(path, r"no topic of colour images; its topics are /a/msg/B, /rslidar")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("walk_0.bag", "walk_1.bag"),
        ("2026-11-30-18-00-00_0.bag", "2026-11-30-18-05-00_1.bag"),
        ("walk_2026-11-30-18-00-00_0.bag", "walk_2026-11-30-18-05-00_1.bag"),
    ],
)
def test_parts_of_a_split_recording_are_read_as_one(tmp_path: Path, first: str, second: str) -> None:
    """Only the first has what is fixed."""
    tool_formats.ros1_bag(tmp_path / first, tool_formats.ros_messages(VIEWS[:2]))
    tool_formats.ros1_bag(tmp_path / second, tool_formats.ros_messages(VIEWS[2:], without="/tf_static"))
    capture = open_capture(tmp_path)
    same_views(capture, VIEWS, depth_atol=6e-4)
    assert f"2 bags, {first}, {second}: read as parts of one recording" in str(capture.notes[0])
    refused(tmp_path / second, "no tf from there to camera_color_optical_frame; it may be in an earlier part: open the")
    for name in ("other_2.bag", "walk.bag"):
        shutil.copy(tmp_path / first, tmp_path / name)
        refused(tmp_path, "captures.*open one of them", error=UnknownFormatError)
        (tmp_path / name).unlink()


def test_a_type_without_a_definition_is_named(tmp_path: Path) -> None:
    path = tool_formats.ros2_bag(tmp_path / "bag", tool_formats.ros_messages(VIEWS))
    with sqlite3.connect(path / "bag.db3") as base:
        base.execute("INSERT INTO message_definitions SELECT id, type, 'unknown', '', '' FROM topics")
    base.close()
    refused(path, r"of one of its topics has no definition; copy the others \(mcap filter IN -o OUT -n '\.\*/_action")


def test_a_bag_of_compressed_files_and_a_file_alone(tmp_path: Path) -> None:
    messages = tool_formats.ros_messages(VIEWS)
    path = tool_formats.ros2_bag(tmp_path / "bag", messages, compressed=True)
    assert len(list(open_capture(path))) == len(VIEWS)
    refused(path / "bag.db3.zstd", "is a compressed part of a bag; open its folder")
    path = tool_formats.ros2_bag(tmp_path / "alone", messages)
    (path / "metadata.yaml").unlink()
    assert open_capture(path).frame_count == len(VIEWS)


@pytest.mark.parametrize(
    ("write", "name", "every", "read"),
    [(tool_formats.mcap_without_chunks, "walk.mcap", 1, 80), (tool_formats.ros2_bag, "walk", 10, 8)],
)
def test_a_pass_reads_an_image_once(tmp_path: Path, write: Any, name: str, every: int, read: int) -> None:
    """Without an index no file from its start for each image, also of late depth; with an index none in between."""
    views = [replace(VIEWS[number % 4], time_s=10 + number / 30) for number in range(40)]
    messages = [
        (topic, kind, logged + 0.3 * (topic == DEPTH), data)
        for topic, kind, logged, data in tool_formats.ros_messages(views)
    ]
    path = write(tmp_path / name, sorted(messages, key=lambda message: message[2]))
    capture, times, reading = open_capture(path, CaptureOptions(every=every)), list[int](), AnyReader.messages

    def counted(*args: Any, **options: Any) -> Iterator[Any]:
        for image in reading(*args, **options):
            times.append(image[1])
            yield image

    with patch.object(AnyReader, "messages", counted):
        assert len(list(capture)) == len(views) / every
    assert len(times) == read


def test_an_mcap_out_of_order_without_an_index_says_so(tmp_path: Path) -> None:
    messages = tool_formats.ros_messages(VIEWS)[::-1]
    refused(
        tool_formats.mcap_without_chunks(tmp_path / "walk.mcap", messages), r"walk\.mcap: its .*run mcap sort on it"
    )


def without_tf() -> list[Message]:
    return tool_formats.ros_messages(VIEWS, without="/tf")


def poses_of(
    topic: str,
    child: str | None = None,
    *,
    beside: float = 0.0,
    kind: str = "PoseStamped",
    mount: np.ndarray = np.eye(4),  # noqa: B008
    views: list[formats.View] = VIEWS,
) -> list[Message]:
    """Poses of the camera, or `beside` it, or of what carries it: Odometry of `child`, for None a `kind`."""
    messages: list[Message] = []
    for view in views:
        pose = formats.Y_UP_TO_Z_UP @ view.pose @ formats.FLIP @ np.linalg.inv(mount)
        pose[0, 3] += beside
        header, stated = tool_formats.header(view.time_s, "odom" if beside else "map"), tool_formats.pose_of(pose)
        if child is not None or "Covariance" in kind:
            stated = tool_formats.ros("geometry_msgs/msg/PoseWithCovariance", stated, np.zeros(36))
        if child is None:
            messages.append(tool_formats.message(topic, view.time_s, f"geometry_msgs/msg/{kind}", header, stated))
        else:
            still = tool_formats.ros("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
            twist = tool_formats.ros("geometry_msgs/msg/Twist", still, still)
            fields = (
                header,
                child,
                stated,
                tool_formats.ros("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
            )
            messages.append(tool_formats.message(topic, view.time_s, "nav_msgs/msg/Odometry", *fields))
    return messages


def mount_on_tf() -> list[Message]:
    """The camera's mount, as launch files repeat it."""
    mount = tool_formats.MOUNT
    return [tool_formats.transform(view.time_s, "base_link", OPTICAL, mount) for view in VIEWS]


def test_a_mount_that_is_repeated_on_tf_is_no_movement(tmp_path: Path) -> None:
    messages = tool_formats.ros_messages(VIEWS, without="/tf_static")
    same_views(open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages + mount_on_tf())), VIEWS)
    poses = poses_of("/odom", "base_link", mount=tool_formats.MOUNT)
    same_views(open_capture(tool_formats.ros2_bag(tmp_path / "loose", without_tf() + poses + mount_on_tf())), VIEWS)


def test_a_camera_that_never_moves_is_noted(tmp_path: Path) -> None:
    standing = [replace(view, pose=VIEWS[0].pose) for view in VIEWS]
    goal = poses_of("/initialpose", kind="PoseWithCovarianceStamped")[:1]
    messages = tool_formats.ros_messages(standing)
    odometry = poses_of("/odom", "base_link", mount=tool_formats.MOUNT, views=standing)
    for at, bag in enumerate((without_tf() + mount_on_tf(), messages + odometry, messages + goal)):
        capture = open_capture(tool_formats.ros2_bag(tmp_path / f"{at}", bag))
        assert ["poses that never change" in str(note) for note in capture.notes] == [True]
        assert len(list(capture)) == len(VIEWS)
    mount = [tool_formats.transform(view.time_s, "camera_link", OPTICAL, tool_formats.MOUNT) for view in VIEWS]
    apart = tool_formats.ros2_bag(tmp_path / "apart", without_tf() + mount + poses_of("/odom", "base_link"))
    refused(apart, "poses of base_link, and no tf from there")


@pytest.mark.parametrize("kind", ["PoseStamped", "PoseWithCovarianceStamped"])
def test_a_pose_topic_stands_in_for_tf(tmp_path: Path, kind: str) -> None:
    capture = open_capture(tool_formats.ros2_bag(tmp_path / "bag", without_tf() + poses_of("/slam/pose", kind=kind)))
    same_views(capture, VIEWS)
    assert f"the {kind} messages of /slam/pose" in capture.notes[0].left_out


@pytest.mark.parametrize(
    ("poses", "others"),
    [
        (poses_of("/z_slam/pose") + poses_of("/goal_pose", beside=5)[:1], "/goal_pose"),
        (poses_of("/vins/camera_pose", "") + poses_of("/vins/body", "", beside=5), "/vins/body"),
        (
            poses_of("/odom", OPTICAL)
            + poses_of("/camera_pose", beside=5)
            + poses_of("/gps", "gps_link", beside=7)
            + poses_of("/odom/filtered", OPTICAL, beside=9)[1:],
            "/odom/filtered, /camera_pose, /gps",
        ),
    ],
)
def test_one_of_several_pose_topics_is_read(tmp_path: Path, poses: list[Message], others: str) -> None:
    capture = open_capture(tool_formats.ros2_bag(tmp_path / "bag", poses[::-1] + without_tf()))
    same_views(capture, VIEWS)
    assert f"the poses of {others}: those of {poses[0][0]} are read" in str(capture.notes[0])


def test_odometry_of_the_base_of_a_head_that_moves_is_read(tmp_path: Path) -> None:
    messages = [*without_tf(), tool_formats.transform(0.0, "head", OPTICAL, tool_formats.MOUNT, fixed=True)]
    for at, view in enumerate(VIEWS):
        head = np.eye(4)
        head[:3, :3] = cv2.Rodrigues(np.array([0.0, 0.0, 0.1 * at]))[0]
        messages.append(tool_formats.transform(view.time_s, "base_link", "head", head))
        messages += poses_of("/odom", "base_link", mount=head @ tool_formats.MOUNT, views=[view])
    same_views(open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages)), VIEWS)
    messages.append(tool_formats.transform(0.0, "foot", "base_link", tool_formats.MOUNT, fixed=True))
    same_views(open_capture(tool_formats.ros2_bag(tmp_path / "foot", messages)), VIEWS)


@pytest.mark.parametrize(
    ("child", "mount"),
    [("base_link", tool_formats.MOUNT), (OPTICAL, np.eye(4)), ("imu", np.linalg.inv(tool_formats.MOUNT))],
)
def test_odometry_of_any_link_that_is_fixed_to_the_camera_is_read(
    tmp_path: Path, child: str, mount: np.ndarray
) -> None:
    """Also of one below the root of the fixed links, and of one beside the camera."""
    messages = without_tf() + poses_of("/odom", child, mount=mount) + poses_of("/other", "gps", beside=5)
    for parent, link in (("foot", "base_link"), ("base_link", OPTICAL), (OPTICAL, "imu")):
        messages.append(tool_formats.transform(0.0, parent, link, tool_formats.MOUNT, fixed=True))
    same_views(open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages)), VIEWS)


def test_a_second_parent_in_tf_is_noted(tmp_path: Path) -> None:
    second = tool_formats.transform(VIEWS[1].time_s, "odom", "base_link", np.eye(4))
    capture = open_capture(tool_formats.ros2_bag(tmp_path / "bag", [*tool_formats.ros_messages(VIEWS), second]))
    (note,) = capture.notes
    assert "poses of base_link in odom beside those in map: those in map, which come first, are read" in str(note)
    same_views(capture, VIEWS)


@pytest.mark.parametrize("static", ["/tf_static", "/r1/tf_static"])
def test_tf_of_another_robot_is_not_read(tmp_path: Path, static: str) -> None:
    others = [replace(view, pose=VIEWS[0].pose) for view in VIEWS]
    names = {topic: f"/r1{topic}" for topic in (COLOUR, DEPTH, "/camera/color/camera_info", "/tf")}
    messages = renamed({"/tf": "/r2/tf"}, [tool_formats.robot(view) for view in others])
    messages += renamed(names | {"/tf_static": static}, tool_formats.ros_messages(VIEWS))
    same_views(open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages)), VIEWS)
    alone = renamed({"/tf": "/vicon/tf"}, tool_formats.ros_messages(VIEWS))
    same_views(open_capture(tool_formats.ros2_bag(tmp_path / "alone", alone)), VIEWS)


def test_poses_between_two_of_tf_are_interpolated(tmp_path: Path) -> None:
    """Those above the moving robot also where they are further apart."""
    messages = [message for message in tool_formats.ros_messages(VIEWS) if message[0] != "/tf"]
    messages += [tool_formats.robot(view) for view in (VIEWS[0], *VIEWS[2:])]
    messages += [tool_formats.transform(VIEWS[0].time_s + at, "world", "map", np.eye(4)) for at in (-0.7, 0.7)]
    _, second, *_ = open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages))
    assert np.abs(second.camera_to_world[:3, 3] - VIEWS[1].pose[:3, 3]).max() < 0.03
    assert np.degrees(np.arccos((second.camera_to_world[:3, 2] * VIEWS[1].pose[:3, 2]).sum())) < 0.5


@pytest.mark.parametrize("encoding", ["rgb8", "rgba8", "mono8", "jpeg", "libx264", "bayer_rggb8"])
def test_encodings_of_colour(tmp_path: Path, encoding: str) -> None:
    rgb, time_s = VIEWS[0].srgb8, VIEWS[0].time_s
    pixels = {
        "rgb8": rgb,
        "rgba8": np.dstack([rgb, np.full(rgb.shape[:2], 255, np.uint8)]),
        "mono8": rgb[..., 1],
        "bayer_rggb8": np.where(np.indices((24, 32)).sum(axis=0) % 2, rgb[..., 1], rgb[..., 0]),
    }
    pixels["bayer_rggb8"][1::2, 1::2] = rgb[1::2, 1::2, 2]
    if encoding in ("jpeg", "libx264"):
        kind, data = f"rgb8; {encoding} compressed", formats.image(".jpg", rgb)
        colour = tool_formats.compressed_image(f"{COLOUR}/compressed", time_s, kind, data)
    else:
        stored = np.ascontiguousarray(pixels[encoding])
        colour = tool_formats.image_message(COLOUR, time_s, OPTICAL, encoding, stored)
    path = tool_formats.ros2_bag(tmp_path / "bag", [*tool_formats.ros_messages(VIEWS[:1], without=COLOUR), colour])
    if encoding == "libx264":
        unreadable(path, "colour of 'rgb8; libx264 compressed' is a video's, which is not read; record JPEG")
        return
    (frame,) = open_capture(path)
    expected = np.repeat(rgb[..., 1:2], 3, axis=2) if encoding == "mono8" else rgb
    error = np.abs(frame.image - srgb8_to_linear(expected))[2:-2, 2:-2]
    assert error.mean() < (0.03 if encoding == "bayer_rggb8" else 0.012)


def with_info(path: Path, **camera: Any) -> Path:
    info = tool_formats.camera("/camera/color/camera_info", OPTICAL, **camera)
    return tool_formats.ros2_bag(path, [info, *tool_formats.ros_messages(VIEWS, without="camera_info")])


@pytest.mark.parametrize(
    ("model", "d"),
    [
        ("double_sphere", (-0.2, 0.6)),
        ("fov", (0.9,)),
        ("mei", (1.2, -0.1, 0.05, 0.0, 0.0)),
        ("", (0.1, 0.0, 0.0, 0.0, 0.0)),
        ("rational_polynomial", (*[0.0] * 8, 0.08, 0.0, 0.08, 0.0)),
        ("equidistant", (0.1, 0.0, 0.0, 0.0, 0.02)),
    ],
)
def test_lenses_of_a_camera_info_that_are_not_read(tmp_path: Path, model: str, d: tuple[float, ...]) -> None:
    path = with_info(tmp_path / "bag", model=model, d=d)
    refused(path, f"beside /camera/color/image_raw: distortion_model '{model}' with D of")


@pytest.mark.parametrize(
    ("model", "d"),
    [
        ("", ()),
        ("Inverse Brown Conrady", (0.0,) * 5),
        ("rational_polynomial", (0.0,) * 14),
        ("perspective", (0.0,) * 5),
    ],
)
def test_names_of_no_lens(tmp_path: Path, model: str, d: tuple[float, ...]) -> None:
    assert first_of(with_info(tmp_path / "bag", model=model, d=d)).intrinsics.fx == formats.FX


def test_other_names_of_plumb_bob(tmp_path: Path) -> None:
    names, d = ("plumb_bob", "plumb bob", "radtan", "Inverse Brown Conrady"), (-0.2, 0.05, 0.0, 0.0, 0.0)
    focal = {first_of(with_info(tmp_path / name, model=name, d=d)).intrinsics.fx for name in names}
    assert len(focal) == 1
    assert focal != {formats.FX}


@pytest.mark.parametrize(
    ("space", "image", "raw"),
    [("/director/color", "image_raw", True), ("/color", "image_rectify_color", False), ("/rect/color", "image", False)],
)
def test_rectified_images_are_known_by_their_topic(tmp_path: Path, space: str, image: str, raw: bool) -> None:
    messages = [tool_formats.camera(f"{space}/camera_info", OPTICAL, d=(-0.2, 0.05, 0.0, 0.0, 0.0))]
    messages += renamed({COLOUR: f"{space}/{image}"}, tool_formats.ros_messages(VIEWS[:1], without="camera_info"))
    (frame,) = open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages))
    assert (frame.intrinsics.fx != formats.FX) == raw


@pytest.mark.parametrize(("binning", "roi"), [(2, None), (0, (5, 20)), (2, (6, 20))])
def test_the_camera_of_a_part_of_the_sensor(tmp_path: Path, binning: int, roi: tuple[int, int] | None) -> None:
    capture = open_capture(with_info(tmp_path / "bag", binning=binning, roi=roi))
    camera = next(iter(capture)).intrinsics
    assert (camera.fx, camera.fy, camera.width, camera.height) == (formats.FX, formats.FY, 32, 24)
    np.testing.assert_allclose((camera.cx, camera.cy), (formats.CX, formats.CY))
    assert not capture.notes


def other_image(view: formats.View, topic: str, frame: str, encoding: str, value: int) -> Message:
    shape, dtype = ((24, 32, 3), np.uint8) if encoding == "bgr8" else ((24, 32), np.uint16)
    pixels = np.full(shape, value, dtype)
    return tool_formats.image_message(topic, view.time_s, frame, encoding, pixels, later_s=0.01)


def test_depth_is_that_of_the_colours_camera(tmp_path: Path) -> None:
    """A second camera has aligned depth; the first has depth of its own frame, and no word `aligned`."""
    names = {
        COLOUR: "/cam1/color/image_raw",
        "/camera/color/camera_info": "/cam1/color/camera_info",
        DEPTH: "/cam1/depth/image_rect_raw",
    }
    messages = renamed(names, tool_formats.ros_messages(VIEWS))
    messages.append(tool_formats.camera("/cam2/color/camera_info", "cam2_optical"))
    for view in VIEWS:
        messages.append(other_image(view, "/cam2/color/image_raw", "cam2_optical", "bgr8", 99))
        messages.append(other_image(view, "/cam2/aligned_depth_to_color/image_raw", "cam2_optical", "16UC1", 9000))
    capture = open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages))
    same_views(capture, VIEWS, depth_atol=6e-4)
    (note,) = [str(note) for note in capture.notes if "alone is read" in str(note)]
    assert "/cam2/color" in note
    assert "/cam1/color/image_raw" in note


def test_aligned_depth_of_another_frame_is_projected_or_noted(tmp_path: Path) -> None:
    """The name `aligned` does not say to which camera."""
    topic, beside = "/camera/aligned_depth_to_infra1", np.eye(4)
    messages = tool_formats.ros_messages(VIEWS, without="aligned")
    messages += [other_image(view, f"{topic}/image_raw", "infra1_optical", "16UC1", 2000) for view in VIEWS]
    capture = open_capture(tool_formats.ros2_bag(tmp_path / "untold", messages))
    assert next(iter(capture)).depth_m.shape == (24, 32)
    assert any("infra1_optical" in note.left_out for note in capture.notes)
    beside[0, 3] = 0.4
    messages.append(tool_formats.transform(0.0, OPTICAL, "infra1_optical", beside, fixed=True))
    guessed = renamed({f"{topic}/image_raw": "/camera/color/depth"}, messages)
    assert any("no CameraInfo of" in note for note in notes_of(tool_formats.ros2_bag(tmp_path / "guessed", guessed)))
    messages.append(tool_formats.camera(f"{topic}/camera_info", "infra1_optical"))
    depth_m = first_of(tool_formats.ros2_bag(tmp_path / "told", messages)).depth_m
    assert not depth_m[:, :3].any()
    assert depth_m[:, -3:].all()


def test_pictures_of_other_programs_are_no_camera_and_no_depth(tmp_path: Path) -> None:
    messages = tool_formats.ros_messages(VIEWS)
    for view in VIEWS:
        messages.append(other_image(view, "/a_detections/color_image", "x", "bgr8", 0))
        messages.append(other_image(view, "/camera/color/a_detections", "x", "bgr8", 0))
        messages.append(other_image(view, "/camera/aligned_depth_colormap/image", "x", "bgr8", 0))
    frames = list(open_capture(tool_formats.ros2_bag(tmp_path / "a", messages)))
    same_views(frames, VIEWS, depth_atol=6e-4)
    for frame, view in zip(frames, VIEWS, strict=True):
        np.testing.assert_allclose(frame.image, srgb8_to_linear(view.srgb8), atol=1e-6)
    coloured = [message for message in messages if "depth_to" not in message[0]]
    notes = open_capture(tool_formats.ros2_bag(tmp_path / "b", coloured)).notes
    assert any("depth_colormap/image holds colours" in str(note).replace(":", "") for note in notes)


@pytest.mark.parametrize("encoding", ["32FC1; compressedDepth png", "16UC1; compressedDepth rvl", "jpeg"])
def test_compressed_depth(tmp_path: Path, encoding: str) -> None:
    """Of floats: 1 / depth in a PNG behind 12 bytes. A JPEG is no depth; other kinds are refused with a way out."""
    a, b, time_s = 4000.0, 10.0, VIEWS[0].time_s
    stored = np.rint(a / VIEWS[0].depth_m + b).astype(np.uint16)
    data = struct.pack("<iff", 0, a, b) + formats.image(".png", np.where(VIEWS[0].depth_m > 0, stored, 0))
    data, topic = b"RVL" if "rvl" in encoding else data, "/camera/depth_to_color/image_raw/compressed"
    messages = tool_formats.ros_messages(VIEWS[:1], without="aligned")
    messages.append(tool_formats.compressed_image(topic, time_s, encoding, data))
    bag = tool_formats.ros2_bag(tmp_path / "bag", messages)
    if "rvl" in encoding:
        unreadable(bag, r"compressedDepth rvl' is not read, .*--depth network")
    if "png" in encoding:
        (frame,) = open_capture(bag)
        np.testing.assert_allclose(frame.depth_m, VIEWS[0].depth_m, rtol=1e-3)
    else:
        with RosBagReader(bag, CaptureOptions(depth="auto" if encoding == "jpeg" else "network")).records() as read:
            assert read(0).depth_name is None


def test_depth_that_is_not_called_so(tmp_path: Path) -> None:
    """As an OAK records it; its confidence is no depth, and neither is another colour camera."""
    messages = renamed({DEPTH: "/oak/stereo/image_raw"}, tool_formats.ros_messages(VIEWS))
    for topic in ("/oak/stereo/camera_info", "/oak/confidence/camera_info"):
        messages.append(tool_formats.camera(topic, "oak"))
    messages += [other_image(view, "/oak/confidence/image_raw", OPTICAL, "16UC1", 900) for view in VIEWS]
    capture = open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages))
    same_views(capture, VIEWS, depth_atol=6e-4)
    (note,) = capture.notes
    assert "/oak/stereo/image_raw, of 16UC1: taken for depth" in str(note)


def test_depth_that_is_recorded_out_of_its_order_is_that_of_the_same_time(tmp_path: Path) -> None:
    messages = [message for message in tool_formats.ros_messages(VIEWS) if message[0] != DEPTH]
    for view, other in zip(VIEWS, VIEWS[::-1], strict=True):
        later_s = other.time_s - view.time_s
        pixels = formats.millimetres(view)
        messages.append(tool_formats.image_message(DEPTH, view.time_s, OPTICAL, "16UC1", pixels, later_s=later_s))
    same_views(open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages)), VIEWS, depth_atol=6e-4)


def test_depth_of_the_colours_frame_comes_before_the_nearest_name(tmp_path: Path) -> None:
    messages = renamed({DEPTH: "/depth_to_rgb/image_raw"}, tool_formats.ros_messages(VIEWS))
    messages += [other_image(view, "/camera/color/depth/image_raw", "tof", "16UC1", 9000) for view in VIEWS]
    same_views(open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages)), VIEWS, depth_atol=6e-4)


@pytest.mark.parametrize(
    ("bent", "frame_id", "image", "colour"),
    [
        ("color", "tof", "image_raw", "image_raw"),
        ("depth", "tof", "image_raw", "image_raw"),
        ("color", OPTICAL, "image_depth_rect", "image_raw"),
        ("depth", OPTICAL, "image_raw", "image_rect_color"),
    ],
)
def test_lenses_of_colour_and_of_depth(tmp_path: Path, bent: str, frame_id: str, image: str, colour: str) -> None:
    """An edge of depth stays where it is, whichever of the two cameras has the lens."""
    d = (0.5, -0.3, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
    y, x = np.mgrid[:96, :128].astype(np.float64) + 0.5
    pixels, k = np.stack([x, y], axis=-1).reshape(-1, 1, 2), np.diag([4 * formats.FX, 4 * formats.FY, 1.0])
    k[:2, 2] = 4 * formats.CX, 4 * formats.CY
    tangents = cv2.undistortPoints(pixels, k, np.array(d if bent == "depth" else [0.0] * 4)).reshape(96, 128, 2)
    stored = np.where(tangents[..., 0] > 0.4, 1000, 3000).astype(np.uint16)
    messages = tool_formats.ros_messages(VIEWS[:1], without="aligned")
    messages = [message for message in messages if message[0] != "/camera/color/camera_info"]
    messages = renamed({COLOUR: f"/camera/color/{colour}"}, messages)
    messages.append(tool_formats.transform(0.0, OPTICAL, "tof", np.eye(4), fixed=True))
    topic = f"/camera/depth/{image}"
    messages.append(tool_formats.image_message(topic, VIEWS[0].time_s, frame_id, "16UC1", stored))
    for part in ("color", "depth"):
        own = d if part == bent else [0.0] * 8
        messages.append(tool_formats.camera(f"/camera/{part}/camera_info", "x", model="rational_polynomial", d=own))
    (frame,) = open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages))
    height, width = frame.depth_m.shape
    row = frame.depth_m[height // 2]
    edge = (np.flatnonzero((row > 0) & (row < 2)).min() / width * 32 - frame.intrinsics.cx) / frame.intrinsics.fx
    assert abs(edge - 0.4) < 0.01


@pytest.mark.parametrize("depth", ["/depth", "/left/depth"])
def test_depth_beside_rectified_colour_is_rectified(tmp_path: Path, depth: str) -> None:
    """As of stereo; without a CameraInfo of its own."""
    messages = tool_formats.ros_messages(VIEWS, without="camera_info")
    messages = renamed({COLOUR: "/left/image_rect", DEPTH: depth}, messages)
    messages.append(tool_formats.camera("/left/camera_info", OPTICAL, d=(-0.3, 0.1, 0.0, 0.0, 0.0)))
    same_views(open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages)), VIEWS, depth_atol=6e-4)


# Refused by name


def test_what_is_no_recording_is_named(tmp_path: Path) -> None:
    for name, words in (
        ("room.usdz", "a model, not a recording; Scaniverse"),
        ("splat.spz", "a model, not a recording"),
        ("map.db", "rtabmap-export --images --poses_camera"),
        ("walk.avi", "a video of a kind that is not read"),
        ("photo.heic", "one photo"),
        ("photo.AVIF", "one photo"),
        ("photo.dng", "a raw photo; export it"),
        ("walk.ts", "a video of a kind that is not read"),
        ("walk.LRV", "a video of a kind that is not read"),
        ("walk.insv", "all directions; export a reframed"),
        ("walk.360", "all directions"),
        ("scan.tar.gz", "an archive of a kind that is not read; unpack it"),
        ("scan.7z", "an archive"),
        ("walk.svo2", "a recording that is not read; export a ROS bag"),
    ):
        (tmp_path / name).write_bytes(b"x" * 99)
        refused(tmp_path / name, words, error=UnknownFormatError)
    for name in ("database.db", "images/1.jpg"):
        formats.save(tmp_path / "colmap" / name, b"x")
    refused(tmp_path / "colmap", "COLMAP's database and no model", error=UnknownFormatError)
    formats.save(tmp_path / "scan/scene.glb", b"x")
    refused(tmp_path / "scan", r"scene\.glb is a model", error=UnknownFormatError)
    formats.save(tmp_path / "scan/thumb.jpg", b"x")
    formats.save(tmp_path / "scan/metadata.json", b"{}")
    refused(tmp_path / "scan", r"scene\.glb is a model", error=UnknownFormatError)
    for name in ("data.jsonl", "calibration.json", "data.mov", "metadata.json"):
        formats.save(tmp_path / "spectacular" / name, b"{}")
    refused(tmp_path / "spectacular", "sai-cli process --format nerfstudio", error=UnknownFormatError)
    for name, words in (
        ("cameras.xml", "the cameras that Metashape found; export them from there as COLMAP"),
        ("room.xml", "the cameras that Metashape found"),
        ("scene.sfm", "that Meshroom found"),
        ("cams.csv", "that RealityCapture found"),
        ("2.jpg", "holds 1.jpg, 2.jpg without focal lengths and poses in a form that is read: let COLMAP find them"),
    ):
        formats.save(tmp_path / "other" / name / "1.jpg", b"x")
        formats.save(tmp_path / "other" / name / name, b"#name,x,y <chunk>")
        refused(tmp_path / "other" / name, words, error=UnknownFormatError)
    formats.save(tmp_path / "other/capture.json", b'{"resolution": [640, 480]}')
    refused(tmp_path / "other", r"it states no format.* another program's; write its frames into a trans")


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (["keyframes/images/1.jpg", "keyframes/depth/1.png"], "nearest is polycam, which lacks keyframes/cameras"),
        (["frame_00000.jpg", "depth_00000.png"], r"nearest is 3d-scanner-app, which lacks frame_\*\.json"),
        (["lowres_wide/a_1.0.png", "lowres_depth/a_1.0.png", "lowres_wide_intrinsics/a"], r"lacks lowres_wide\.traj"),
        (["rgb.mp4", "depth/000000.png"], r"nearest is stray-scanner, which lacks odometry\.csv and camera_matrix"),
        (["sparse/0/cameras.bin", "images/1.jpg"], r"nearest is colmap, which lacks sparse/0/images\.\* or"),
        (["images/1.jpg", "metadata.json"], r"holds images/1\.jpg without focal lengths"),  # of any program
        (["rgb/1.jpg", "depth/1.png", "a.json"], r"holds depth/1\.png, rgb/1\.jpg without focal lengths"),
        (["input/1.jpg"], r"holds input/1\.jpg without focal lengths"),
        *(
            (["color/1.jpg", file], rf"is read: write those of {file} into transforms\.json, or as COLMAP")
            for file in (
                *("scene/trajectory.log", "a/b/c/cameras.sfm", "out/sfm_data.bin", "sparse_3/0/cameras.txt"),
                *("extrinsics/20140804.txt", "transformations.json"),
            )
        ),
        (["color/1.jpg", "a/b/c/d/cameras.sfm"], "let COLMAP find them"),
        (["depth/1.raw", "metadata.json"], r"Set `format` to force one\. Known are \.r3d"),
    ],
)
def test_the_nearest_format_and_what_it_lacks_are_named(tmp_path: Path, files: list[str], message: str) -> None:
    for name in files:
        formats.save(tmp_path / "folder" / name, b"x")
    with pytest.raises(UnknownFormatError, match=message) as caught:
        open_capture(tmp_path / "folder")
    assert ("Known are" in str(caught.value)) == ("Known are" in message)  # the list only where no advice is there
