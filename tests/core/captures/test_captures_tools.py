"""Layouts of data sets and tools beside those that `test_captures_readers` covers, and what is refused by name."""

import json
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import formats
import numpy as np
import pytest
import tool_formats
from capture_checks import edit, first_of, notes_of, one_skipped, refused, same_views, unreadable
from tool_formats import COLOUR, DEPTH, OPTICAL, Message

from roomlight.captures import CaptureOptions, open_capture
from roomlight.captures.formats.packed_depth import lz4_block
from roomlight.captures.formats.ros.bag import RosBagReader
from roomlight.conventions import srgb8_to_linear
from roomlight.errors import UnknownFormatError

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


def test_scannetpp_masks_and_missing_parts(tmp_path: Path) -> None:
    path = tool_formats.scannetpp(tmp_path / "iphone", VIEWS)
    mask = np.full((24, 32), 255, np.uint8)
    mask[:6] = 0
    formats.save(path / "rgb_masks/frame_000010.png", formats.image(".png", mask))
    (path / "rgb_mask.mkv").write_bytes(b"x")
    plain, masked, *_ = open_capture(path)
    assert plain.seen is None
    assert masked.seen is not None
    assert not masked.seen[:6].any()
    shutil.rmtree(path / "rgb_masks")
    assert any("rgb_mask.mkv" in note.left_out for note in open_capture(path).notes)
    shutil.rmtree(path / "rgb")
    refused(path, r"neither rgb/ nor rgb\.mkv")


def test_depth_of_another_camera_is_projected_into_the_colour_image(tmp_path: Path) -> None:
    """A wall at 2 m and one at 1 m before its right half, seen by a depth camera 10 cm to the right."""
    depth = np.full((48, 64), 2000, np.uint16)
    near = np.zeros((48, 64), bool)
    near[:, 40:] = True
    depth[near] = 1000
    views = [formats.View(VIEWS[0].srgb8, depth / np.float32(1000), VIEWS[0].confidence, VIEWS[0].pose, 0.0)]
    path = formats.scannet(tmp_path / "capture", views)
    data = bytearray(path.read_bytes())
    at = 12 + 15
    k = np.eye(4, dtype="<f4")
    k[:2, :3] = [[60.0, 0, 31.5], [0, 60.0, 23.5]]
    moved = np.eye(4, dtype="<f4")
    moved[0, 3] = 0.1  # the depth camera's place, seen by the colour camera
    data[at + 128 : at + 192], data[at + 192 : at + 256] = k.tobytes(), moved.tobytes()
    data[at + 272 : at + 280] = struct.pack("<2i", 64, 48)
    path.write_bytes(data)
    (frame,) = open_capture(path)
    rows, columns = np.nonzero(np.isclose(frame.depth_m, 1.0, atol=1e-3))
    left = columns.min() / frame.depth_m.shape[1] * formats.WIDTH
    edge = (40 + 0.5 - 32.0) / 60.0 * 1.0 + 0.1  # x of the near wall's edge at 1 m
    assert left == pytest.approx(formats.CX + formats.FX * edge, abs=1.2)
    assert len(rows) > 100
    assert np.isin(np.round(frame.depth_m, 3), [0.0, 1.0, 2.0]).all()


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
        values = [view.time_s, *base[:3, 3], *tool_formats.quaternion_of_any(base[:3, :3])]
        lines.append(" ".join(map(str, values)))
    (path / "room_camera_poses.txt").unlink()
    (path / "room_poses.txt").write_text("\n".join(lines))
    for frame, view in zip(open_capture(path), VIEWS, strict=True):
        np.testing.assert_allclose(frame.camera_to_world, view.pose, atol=1e-6)
        assert frame.timestamp_s == pytest.approx(view.time_s)
    formats.save(path / f"room_calib/{VIEWS[1].time_s:.6f}.yaml", tool_formats.opencv_yaml("x").encode())
    one_skipped(path, 1, "local_transform", "--poses_camera")


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
    one_skipped(path, 1, "COLMAP map of 32 x 24")


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
    black = formats.image(".png", np.zeros((formats.HEIGHT, formats.WIDTH, 3), np.uint8))
    for picture in (path / "images").iterdir():
        picture.write_bytes(black)
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


@pytest.mark.parametrize("opened", ["sparse/0", "sparse"])
def test_a_colmap_model_is_read_with_the_pictures_above_it(tmp_path: Path, opened: str) -> None:
    path = formats.colmap(tmp_path / "capture", VIEWS[:2])
    same_views(open_capture(path / opened), VIEWS[:2], depth_atol=1e-6)
    assert any(f"read from {path}" in note for note in notes_of(path / opened))
    workspace(path)
    capture = open_capture(path / opened)
    assert any("sparse/0 is of others" in note.effect for note in capture.notes)
    assert next(iter(capture)).image.shape == (24, 32, 3)


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
    refused(tool_formats.ros2_bag(tmp_path, messages), says)


def test_topics_of_realsense_are_known(tmp_path: Path) -> None:
    notes_of(tool_formats.ros2_bag(tmp_path, renamed(REALSENSE, tool_formats.ros_messages(VIEWS))), frames=4)


BAG = b"#ROSBAG V2.0\n" + bytes(99)
MCAP = b"\x89MCAP0\r\n\1" + struct.pack("<QI", 12, 4) + b"ros1\0\0\0\0"


@pytest.mark.parametrize(
    ("name", "data", "says"),
    [
        ("d.bag", BAG, r"d\.bag: is not a readable ROS bag .*; copy it again; rosbag reindex"),
        ("d.BAG", BAG, r"; rename it to end in \.bag"),
        ("d.mcap", MCAP, "its profile is 'ros1'; record it with ROS 2"),
    ],
)
def test_a_file_that_is_no_readable_bag_says_so(tmp_path: Path, name: str, data: bytes, says: str) -> None:
    (tmp_path / name).write_bytes(data)
    refused(tmp_path / name, says)


def as_zstd(data: bytes) -> bytes:
    """A frame of Zstandard in raw blocks."""
    parts = [data[at : at + 100_000] for at in range(0, len(data), 100_000)]
    heads = [(int(part is parts[-1]) | len(part) << 3).to_bytes(3, "little") for part in parts]
    blocks = b"".join(head + part for head, part in zip(heads, parts, strict=True))
    return b"\x28\xb5\x2f\xfd\xa0" + struct.pack("<I", len(data)) + blocks


def test_a_bag_of_compressed_files(tmp_path: Path) -> None:
    """As `ros2 bag record --compression-mode file` writes it."""
    path = tool_formats.ros_bag(tmp_path / "bag", VIEWS)
    stored = path / "bag_0.db3"
    formats.save(tmp_path / "alone/a.db3", stored.read_bytes())  # without metadata.yaml
    assert open_capture(tmp_path / "alone").frame_count == len(VIEWS)
    (path / "bag_0.db3.zstd").write_bytes(as_zstd(stored.read_bytes()))
    stored.unlink()
    text = (path / "metadata.yaml").read_text().replace("bag_0.db3", "bag_0.db3.zstd")
    for key, value in (("format", "zstd"), ("mode", "FILE")):
        text = text.replace(f'"compression_{key}": ""', f'"compression_{key}": "{value}"')
    (path / "metadata.yaml").write_text(text)
    assert len(list(open_capture(path))) == len(VIEWS)
    refused(path / "bag_0.db3.zstd", "is a compressed part of a bag; open its folder")


def without_tf() -> list[Message]:
    return tool_formats.ros_messages(VIEWS, without="/tf")


def poses_of(topic: str, child: str | None = None, *, beside: float = 0.0, kind: str = "PoseStamped") -> list[Message]:
    """Poses of the camera, or `beside` it: Odometry of `child`, for None a `kind`."""
    messages: list[Message] = []
    for view in VIEWS:
        pose = formats.Y_UP_TO_Z_UP @ view.pose @ formats.FLIP
        pose[0, 3] += beside
        cdr = tool_formats.Cdr().header(view.time_s, "odom" if beside else "map")
        if child is not None:
            cdr.text(child)
        cdr.put("d", *pose[:3, 3], *tool_formats.quaternion_of_any(pose[:3, :3]))
        cdr.put("d", *[0.0] * (78 if child is not None else 36 if "Covariance" in kind else 0))
        whole = f"geometry_msgs/msg/{kind}" if child is None else "nav_msgs/msg/Odometry"
        messages.append((topic, whole, view.time_s, cdr.bytes()))
    return messages


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


def test_a_second_parent_in_tf_is_noted(tmp_path: Path) -> None:
    second = tool_formats.transform(VIEWS[1].time_s, "odom", "base_link", np.eye(4))
    capture = open_capture(tool_formats.ros2_bag(tmp_path / "bag", [*tool_formats.ros_messages(VIEWS), second]))
    (note,) = capture.notes
    assert "poses of base_link in odom beside those in map: those in map, which come first, are read" in str(note)
    same_views(capture, VIEWS)


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
        cdr = tool_formats.Cdr().header(time_s, OPTICAL).text(f"rgb8; {encoding} compressed")
        data = cdr.raw(formats.image(".jpg", rgb)).bytes()
        colour = f"{COLOUR}/compressed", "sensor_msgs/msg/CompressedImage", time_s, data
    else:
        data = tool_formats.image_message(time_s, OPTICAL, encoding, np.ascontiguousarray(pixels[encoding]))
        colour = COLOUR, "sensor_msgs/msg/Image", time_s, data
    path = tool_formats.ros2_bag(tmp_path / "bag", [*tool_formats.ros_messages(VIEWS[:1], without=COLOUR), colour])
    if encoding == "libx264":
        unreadable(path, "colour of 'rgb8; libx264 compressed' is a video's, which is not read; record JPEG")
        return
    (frame,) = open_capture(path)
    expected = np.repeat(rgb[..., 1:2], 3, axis=2) if encoding == "mono8" else rgb
    error = np.abs(frame.image - srgb8_to_linear(expected))[2:-2, 2:-2]
    assert error.mean() < (0.03 if encoding == "bayer_rggb8" else 0.012)


def with_info(path: Path, **camera: Any) -> Path:
    info = tool_formats.camera("/camera/color/camera_info", tool_formats.camera_message(OPTICAL, **camera))
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
    info = tool_formats.camera_message(OPTICAL, d=(-0.2, 0.05, 0.0, 0.0, 0.0))
    messages = [tool_formats.camera(f"{space}/camera_info", info)]
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
    data = tool_formats.image_message(view.time_s, frame, encoding, np.full(shape, value, dtype))
    return topic, "sensor_msgs/msg/Image", view.time_s + 0.01, data


def test_depth_is_that_of_the_colours_camera(tmp_path: Path) -> None:
    """A second camera has aligned depth; the first has depth of its own frame, and no word `aligned`."""
    names = {
        COLOUR: "/cam1/color/image_raw",
        "/camera/color/camera_info": "/cam1/color/camera_info",
        DEPTH: "/cam1/depth/image_rect_raw",
    }
    messages = renamed(names, tool_formats.ros_messages(VIEWS))
    messages.append(tool_formats.camera("/cam2/color/camera_info", tool_formats.camera_message("cam2_optical")))
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
    messages.append(tool_formats.camera(f"{topic}/camera_info", tool_formats.camera_message("infra1_optical")))
    depth_m = first_of(tool_formats.ros2_bag(tmp_path / "told", messages)).depth_m
    assert not depth_m[:, :3].any()
    assert depth_m[:, -3:].all()


def test_pictures_of_other_programs_are_no_camera_and_no_depth(tmp_path: Path) -> None:
    messages = tool_formats.ros_messages(VIEWS)
    for view in VIEWS:
        messages.append(other_image(view, "/a_detections/color_image", "x", "bgr8", 0))
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
    cdr = tool_formats.Cdr().header(time_s, OPTICAL).text(encoding).raw(b"RVL" if "rvl" in encoding else data)
    topic = "/camera/depth_to_color/image_raw/compressed"
    messages = tool_formats.ros_messages(VIEWS[:1], without="aligned")
    messages.append((topic, "sensor_msgs/msg/CompressedImage", time_s, cdr.bytes()))
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
        messages.append(tool_formats.camera(topic, tool_formats.camera_message("oak")))
    messages += [other_image(view, "/oak/confidence/image_raw", OPTICAL, "16UC1", 900) for view in VIEWS]
    capture = open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages))
    same_views(capture, VIEWS, depth_atol=6e-4)
    (note,) = capture.notes
    assert "/oak/stereo/image_raw, of 16UC1: taken for depth" in str(note)


def test_depth_of_the_colours_frame_comes_before_the_nearest_name(tmp_path: Path) -> None:
    messages = renamed({DEPTH: "/depth_to_rgb/image_raw"}, tool_formats.ros_messages(VIEWS))
    messages += [other_image(view, "/camera/color/depth/image_raw", "tof", "16UC1", 9000) for view in VIEWS]
    same_views(open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages)), VIEWS, depth_atol=6e-4)


@pytest.mark.parametrize("bent", ["color", "depth"])
def test_lenses_of_colour_and_of_another_cameras_depth(tmp_path: Path, bent: str) -> None:
    """An edge of depth stays where it is, whichever of the two cameras has the lens."""
    d = (0.5, -0.3, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
    y, x = np.mgrid[:96, :128].astype(np.float64) + 0.5
    pixels, k = np.stack([x, y], axis=-1).reshape(-1, 1, 2), np.diag([4 * formats.FX, 4 * formats.FY, 1.0])
    k[:2, 2] = 4 * formats.CX, 4 * formats.CY
    tangents = cv2.undistortPoints(pixels, k, np.array(d if bent == "depth" else [0.0] * 4)).reshape(96, 128, 2)
    stored = np.where(tangents[..., 0] > 0.4, 1000, 3000).astype(np.uint16)
    messages = [
        message
        for message in tool_formats.ros_messages(VIEWS[:1], without="aligned")
        if message[0] != "/camera/color/camera_info"
    ]
    messages.append(tool_formats.transform(0.0, OPTICAL, "tof", np.eye(4), fixed=True))
    image = tool_formats.image_message(VIEWS[0].time_s, "tof", "16UC1", stored)
    messages.append(("/camera/depth/image_raw", "sensor_msgs/msg/Image", VIEWS[0].time_s, image))
    for part in ("color", "depth"):
        own = d if part == bent else [0.0] * 8
        info = tool_formats.camera_message("x", model="rational_polynomial", d=own)
        messages.append(tool_formats.camera(f"/camera/{part}/camera_info", info))
    (frame,) = open_capture(tool_formats.ros2_bag(tmp_path / "bag", messages))
    height, width = frame.depth_m.shape
    row = frame.depth_m[height // 2]
    edge = (np.flatnonzero((row > 0) & (row < 2)).min() / width * 32 - frame.intrinsics.cx) / frame.intrinsics.fx
    assert abs(edge - 0.4) < 0.01


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
        ("scene.sfm", "that Meshroom found"),
        ("cams.csv", "that RealityCapture found"),
        ("2.jpg", "holds 1.jpg, 2.jpg without focal lengths and camera poses: let COLMAP find them"),
    ):
        formats.save(tmp_path / "other" / name / "1.jpg", b"x")
        formats.save(tmp_path / "other" / name / name, b"#name,x,y")
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
        (["images/1.jpg", "metadata.json"], r"recognised\. Set"),  # of any program
    ],
)
def test_the_nearest_format_and_what_it_lacks_are_named(tmp_path: Path, files: list[str], message: str) -> None:
    for name in files:
        formats.save(tmp_path / "folder" / name, b"x")
    with pytest.raises(UnknownFormatError, match=message) as caught:
        open_capture(tmp_path / "folder")
    assert "Known are .r3d" in str(caught.value)
