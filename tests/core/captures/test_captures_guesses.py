"""What files leave open is compared with what they hold, and what is unusual in them is said."""

import json
import re
import shutil
import struct
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import formats
import numpy as np
import pytest
import tool_formats
from capture_checks import edit, first_of, notes_of, one_skipped, refused, same_views
from slow_images import chunk

from roomlight.camera import Intrinsics
from roomlight.captures import CaptureOptions, open_capture
from roomlight.captures.consistency import DepthCheck, Mismatch, looks_turned
from roomlight.captures.photo import PhotoOptions, read_photo
from roomlight.errors import UnknownFormatError
from roomlight.frame import Frame
from roomlight.images import write_png
from roomlight.sample import sample_capture

VIEWS = formats.scene()
LENS = {"fl_x": 140, "fl_y": 140, "cx": 80, "cy": 60, "w": 160, "h": 120}


def turning(count: int) -> list[formats.View]:
    """The room from a camera that turns about the vertical."""
    views = formats.scene(count)
    for index, view in enumerate(views):
        view.pose[:3, :3] = formats.rotation("y", 10 + 25.0 * index)
    return views


@pytest.mark.parametrize(
    ("turn", "said", "up"),
    [(0.0, "level about the y axis", "y"), (180.0, "level about the y axis", "-y"), (-90.0, "hang upside down", "-z")],
)
def test_a_world_whose_up_is_another_is_pointed_out(tmp_path: Path, turn: float, said: str, up: str) -> None:
    """ARKit's poses in a transforms.json, whose world counts as z-up; and poses of a world whose z is down."""
    views = turning(9)
    path = formats.nerfstudio(tmp_path / "level", views)
    assert not notes_of(path)

    def change(index: dict) -> None:
        for frame, view in zip(index["frames"], views, strict=True):
            pose = np.pad(formats.rotation("x", turn), (0, 1)) @ view.pose
            frame["transform_matrix"] = [*pose[:3].tolist(), [0, 0, 0, 1]]

    edit(path / "transforms.json", change)
    (note,) = notes_of(path)
    assert said in note
    assert f"--world-up {up}" in note
    assert not notes_of(path, CaptureOptions(world_up=up))


@pytest.mark.parametrize(("roll", "up"), [(0.0, "y"), (-90.0, "y"), (90.0, "-y")])
def test_a_world_on_its_side_is_pointed_out_at_the_rate_of_a_video(tmp_path: Path, roll: float, up: str) -> None:
    """Six views hardly differ; a phone is held upright with its home button down, or else the other way round."""
    views = formats.scene(40)
    for index, view in enumerate(views):
        nod = formats.rotation("x", 5.0 * np.sin(index))
        view.pose[:3, :3] = formats.rotation("y", 10 + 2.0 * index) @ nod @ formats.rotation("z", roll)
    path = formats.nerfstudio(tmp_path / "level", views)
    assert "--world-up" not in str(notes_of(path))

    def change(index: dict) -> None:
        for frame, view in zip(index["frames"], views, strict=True):
            frame["transform_matrix"] = view.pose.tolist()

    edit(path / "transforms.json", change)
    (note,) = [note for note in notes_of(path) if "--world-up" in note]
    assert f"--world-up {up}," in note


def test_a_pass_that_goes_on_gives_the_notes_of_a_whole_one(tmp_path: Path) -> None:
    """Where the first pose is the identity the world's up is told by that note alone."""
    views = turning(16)
    path = formats.nerfstudio(tmp_path / "resized_room", views)  # no folder of ScanNet++'s, whose world is z-down
    np.testing.assert_allclose(next(iter(open_capture(path))).camera_to_world, views[0].pose, atol=1e-9)
    poses = [np.linalg.inv(views[0].pose) @ view.pose for view in views]
    edit(
        path / "transforms.json",
        lambda index: [
            frame.update(transform_matrix=pose.tolist()) for frame, pose in zip(index["frames"], poses, strict=True)
        ],
    )
    capture = open_capture(path)
    states = [capture.passed() for _ in capture]
    note, unmet = map(str, capture.notes)
    assert "first pose is the identity" in note
    assert "depth of different frames does not meet" in unmet  # it is of the unturned views
    again = open_capture(path)
    assert len(list(again.frames(states[12]))) == 3
    assert again.notes == capture.notes


@pytest.mark.parametrize(
    ("bars", "crop"),
    [
        (np.s_[:, np.r_[:20, 140:160]], "crop=120:120:20:0"),
        (np.s_[np.r_[:30, 90:120]], "crop=160:60:0:30"),
        (np.s_[:, :20], None),  # one side: a dark door
    ],
)
def test_black_bars_are_pointed_out(transforms: Path, bars: tuple, crop: str | None) -> None:
    picture = np.full((120, 160, 3), 90, np.uint8)
    picture[bars] = 3
    picture[5, 60:70] = 255  # a clock
    for file in (transforms / "images").iterdir():
        file.write_bytes(formats.image(".png", picture))
    edit(transforms / "transforms.json", lambda index: [frame.update(LENS) for frame in index["frames"]])
    said = [note for note in notes_of(transforms) if "black bars" in note]
    assert len(said) == (crop is not None)
    assert crop is None or crop in said[0]


def test_a_camera_of_another_size_is_noted_on_a_later_frame_too(transforms: Path) -> None:
    edit(transforms / "transforms.json", lambda index: index["frames"][2].update(cx=30))
    assert any("00003.png: a principal point at (30," in note for note in notes_of(transforms, frames=4))


def test_several_colmap_models_are_noted(tmp_path: Path) -> None:
    path = formats.colmap(tmp_path / "capture", VIEWS)
    shutil.copytree(path / "sparse/0", path / "sparse/1")
    assert any("sparse/1" in note.left_out for note in open_capture(path).notes)


def test_a_fisheye_of_rtabmap_is_noted_also_without_coefficients(tmp_path: Path) -> None:
    path = tool_formats.rtabmap(tmp_path / "capture", VIEWS)
    for file in (path / "room_calib").iterdir():
        file.write_text(file.read_text() + "distortion_model: equidistant\n")
    (note,) = notes_of(path)
    assert "the lens distortion: images are taken for rectified" in note


def test_parts_of_a_data_set_without_the_whole_are_named(transforms: Path) -> None:
    part = (transforms / "transforms.json").rename(transforms / "transforms_train.json")
    refused(transforms, r"holds transforms_train\.json, and no transforms\.json; open one", error=UnknownFormatError)
    for options in (CaptureOptions(), CaptureOptions(format="nerfstudio")):
        capture = open_capture(part, options)
        assert (capture.format, capture.path) == ("nerfstudio", transforms)
        same_views(capture, VIEWS)
    refused(part, r"transforms_train\.json: is a file; the tum format is a folder", CaptureOptions(format="tum"))


@pytest.mark.parametrize(("mark", "point"), [("\t", "."), (";", "."), (";", ",")])
def test_tum_lists_of_spreadsheets(tmp_path: Path, mark: str, point: str) -> None:
    path = formats.tum(tmp_path / "tum", VIEWS)
    number = re.compile(rf"(?<![^{mark}])(-?\d+)\.(?=\d)")  # names hold a point too
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        lines = [re.sub(r"[ ,]+", mark, line) for line in (path / name).read_text().splitlines()]
        (path / name).write_text("\n".join(number.sub(rf"\1{point}", line) for line in lines))
    same_views(open_capture(path), VIEWS, atol=1e-4)


def test_what_a_folder_of_tum_lacks_is_said(tmp_path: Path) -> None:
    path = formats.tum(tmp_path / "tum", VIEWS)
    (path / "groundtruth.txt").rename(path / "CameraTrajectory.txt")
    refused(path, r"tum: has no poses; save CameraTrajectory\.txt as groundtruth\.txt \(time tx ty tz qx qy qz qw\)")
    (path / "CameraTrajectory.txt").rename(path / "poses.txt")
    refused(path, r"tum: has no poses; save the trajectory as groundtruth\.txt")
    (path / "poses.txt").rename(path / "groundtruth.txt")
    (path / "rgb.txt").rename(path / "color.txt")
    refused(path, r"tum: has no list of its pictures; write it as rgb\.txt \(time file\)")


def test_poses_of_markers_are_refused(tmp_path: Path) -> None:
    path = formats.tum(tmp_path / "rgbd_bonn_balloon", VIEWS)
    refused(path, r"Bonn RGB-D Dynamic are those of markers; write the camera's .*without rgbd_bonn_")
    same_views(open_capture(path.rename(tmp_path / "balloon")), VIEWS)


def test_tum_lists_with_dates(tmp_path: Path) -> None:
    path = formats.tum(tmp_path / "tum", VIEWS)

    def dated(time: re.Match[str]) -> str:
        return datetime.fromtimestamp(float(time[0]), UTC).isoformat()

    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        (path / name).write_text(re.sub(r"^[\d.]+", dated, (path / name).read_text(), flags=re.MULTILINE))
    assert "timestamps" not in str(notes_of(path, frames=4))
    (path / "rgb.txt").write_text("yesterday rgb/0.png")
    refused(path, r"rgb\.txt: line 1: starts with 'yesterday', not with a time")


def test_times_of_stray_scanner_that_are_no_numbers_are_noted(stray: Path) -> None:
    lines = (stray / "odometry.csv").read_text().splitlines()
    lines[2] = re.sub(r"^[^,]*", "x", lines[2])
    (stray / "odometry.csv").write_text("\n".join(lines))
    assert [frame.timestamp_s is None for frame in open_capture(stray)] == [False, True, False, False]
    assert any("1 timestamps are no numbers" in note for note in notes_of(stray))


def test_tum_lists_in_nanoseconds(tmp_path: Path) -> None:
    """ORB-SLAM3's trajectory of a EuRoC recording, beside lists in seconds."""
    path = formats.tum(tmp_path / "tum", VIEWS)
    lines = [line.split() for line in (path / "groundtruth.txt").read_text().splitlines() if line[0] != "#"]
    stamped = [" ".join([str(round(1e9 * float(time))), *rest]) for time, *rest in lines]
    (path / "groundtruth.txt").write_text("\n".join(stamped))
    same_views(open_capture(path), VIEWS)
    (note,) = notes_of(path)
    assert "read as nanoseconds" in note


@pytest.mark.parametrize(
    ("build", "stored", "renamed"),
    [(formats.arkit_scenes, "lowres_depth", "highres_depth"), (formats.nerfstudio, "depth", "Depths")],
)
def test_depth_that_no_frame_leads_to_is_noted(
    tmp_path: Path, build: Callable[..., Path], stored: str, renamed: str
) -> None:
    path = build(tmp_path / "capture", VIEWS[:2])
    (path / stored).rename(path / renamed)
    if (path / "transforms.json").exists():
        edit(path / "transforms.json", lambda index: [frame.pop("depth_file_path") for frame in index["frames"]])
    assert f"{renamed}: no frame's depth is read from there" in str(notes_of(path, frames=2))
    assert renamed not in str(notes_of(path, CaptureOptions(depth="network"), frames=2))


def test_keys_of_roomlight_s_own_format_that_are_not_read_are_listed(native: Path) -> None:
    def change(index: dict) -> None:
        index["unit"] = "mm"
        index["frames"][0].update(mask="m.png")
        index["frames"][1]["intrinsics"].update(k1=0.1)

    assert open_capture(native).notes == ()
    edit(native / "capture.json", change)
    (note,) = open_capture(native).notes
    assert "k1, mask, unit" in note.left_out


def test_a_video_with_wide_pixels(stray: Path) -> None:
    expected, video = first_of(stray).image, stray / "rgb.mp4"
    formats.remuxed(video, stray / "new.mp4", lambda stream: setattr(stream, "sample_aspect_ratio", 2)).replace(video)
    np.testing.assert_array_equal(first_of(stray).image, expected)
    assert any("2 times as wide as high" in note for note in notes_of(stray))
    camera = stray / "camera_matrix.csv"
    for aspect, noted in ((2.02, False), (1.5, True)):  # by a calibration, and of another shape
        rows = np.loadtxt(camera, delimiter=",")
        rows[1, 1] = rows[0, 0] * aspect
        np.savetxt(camera, rows, delimiter=",")
        assert any("times as wide as high" in note for note in notes_of(stray)) == noted


@pytest.mark.parametrize(("unit_m", "factor"), [(1 / 1000, None), (1 / 2000, 0.5), (1 / 500, 2.0)])
def test_depth_in_another_unit_than_the_poses_is_pointed_out(
    tmp_path: Path, unit_m: float, factor: float | None
) -> None:
    views = formats.scene(12)
    path = formats.nerfstudio(tmp_path / "many", views)
    for index, view in enumerate(views):
        depth = formats.image(".png", formats.millimetres(view, unit_m))
        formats.save(path / f"depth/frame_{index + 1:05d}.png", depth)
    notes = notes_of(path)
    assert len(notes) == (factor is not None)
    if factor is not None:
        assert f"about {factor:.2g} times as large" in notes[0]
        assert not notes_of(path, CaptureOptions(depth_unit_m=unit_m))


def test_units_of_one_frame_override_those_of_all(transforms: Path) -> None:
    def change(index: dict) -> None:
        index.update(depth_unit_scale_factor=0.002, applied_scale=0.5)
        index["frames"][1].update(depth_unit_scale_factor=0.001, applied_scale=1.0)

    edit(transforms / "transforms.json", change)
    first, second, *_ = open_capture(transforms)
    np.testing.assert_allclose(first.depth_m, 2 * VIEWS[0].depth_m, rtol=1e-5)
    np.testing.assert_allclose(second.depth_m, VIEWS[1].depth_m, rtol=1e-5)
    np.testing.assert_allclose(first.camera_to_world[:3, 3], 2 * VIEWS[0].pose[:3, 3], rtol=1e-6)
    np.testing.assert_allclose(second.camera_to_world, VIEWS[1].pose, atol=1e-9)


def with_xmp(jpeg: bytes, text: bytes) -> bytes:
    xmp = b"http://ns.adobe.com/xap/1.0/\0" + text
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(xmp) + 2) + xmp + jpeg[2:]


def test_panoramas_and_pixels_that_are_not_square(transforms: Path) -> None:
    panorama = b'<rdf:Description GPano:ProjectionType="equirectangular"/>'
    marked = with_xmp(formats.image(".jpg", VIEWS[0].srgb8), panorama)
    (transforms / "images/frame_00001.png").write_bytes(marked)
    png = formats.image(".png", VIEWS[1].srgb8)
    shape = chunk(b"pHYs", struct.pack(">IIB", 1, 2, 0))
    (transforms / "images/frame_00002.png").write_bytes(png[:33] + shape + png[33:])
    capture = one_skipped(transforms, 0, "panorama (GPano)")
    assert any("2 times as wide as high" in note.left_out for note in capture.notes)
    edit(transforms / "transforms.json", lambda index: index.update(fl_x=index["fl_y"] / 2))
    (odd,) = notes_of(transforms)  # the intrinsics are of the second frame's pixels, but not of the third's
    assert "frame_00003.png: focal lengths of 13.5 and 27" in odd


BUNDLE_FUSION = """m_versionNumber = 4
m_colorWidth = 64
m_colorHeight = 48
m_depthWidth = 32
m_depthHeight = 24
m_depthShift = 5000
m_calibrationColorIntrinsic = 56 0 32.5 0 0 54 23 0 0 0 1 0 0 0 0 1
m_calibrationColorExtrinsic = 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1
m_calibrationDepthIntrinsic = 28 0 16 0 0 27 11.25 0 0 0 1 0 0 0 0 1
m_calibrationDepthExtrinsic = 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1
m_frames.size = 4
"""


@pytest.mark.parametrize("name", ["data/info.txt", "data/_info.txt", "info.txt"])
def test_cameras_of_bundle_fusions_info_are_read(tmp_path: Path, name: str) -> None:
    path = formats.seven_scenes(tmp_path / "data", VIEWS)
    (path / "camera-intrinsics.txt").unlink()
    (tmp_path / name).write_text(BUNDLE_FUSION)
    frames = list(capture := open_capture(path, CaptureOptions(depth="file")))
    assert not [note for note in capture.notes if "focal length" in note.effect]
    camera = frames[0].intrinsics
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (28, 27, 16.5, 11.75)
    np.testing.assert_allclose(frames[0].depth_m, VIEWS[0].depth_m / 5, atol=1e-6)
    (tmp_path / name).write_text(BUNDLE_FUSION.replace("= 28 0 16 0 0 27", "= 26.25 0 15 0 0 26.25"))
    assert first_of(path).depth_m.shape != VIEWS[0].depth_m.shape  # projected into the colour image
    (tmp_path / name).write_text(BUNDLE_FUSION.replace("= 56 0", "= x 0"))
    refused(path, r"info\.txt: m_calibrationColorIntrinsic holds a word")
    (tmp_path / name).write_text("my room")
    assert any("525" in note.effect for note in open_capture(path).notes)


@pytest.mark.parametrize("name", ["seq-01", "rgbd-frames", "data"])
def test_intrinsics_above_the_frames_are_read(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = formats.seven_scenes(tmp_path / name, VIEWS)
    (path / "camera-intrinsics.txt").rename(tmp_path / "camera-intrinsics.txt")
    monkeypatch.chdir(path)
    for folder in (path, Path()):
        same_views(open_capture(folder), VIEWS, depth_atol=1e-6)


def test_exposure_that_is_not_applied_is_noted(tmp_path: Path) -> None:
    path = formats.scanner_app(tmp_path / "capture", VIEWS)
    edit(path / "frame_00000.json", lambda stated: stated.update(exposureDuration=0.01))
    assert "exposureDuration" in notes_of(path)[0]


@pytest.mark.parametrize(
    "text",
    [
        b'<Container:Item Item:Semantic="Depth"/>',
        b'<rdf:Description xmlns:DepthMap="http://ns.google.com/photos/dd/1.0/depthmap/"/>',
    ],
)
def test_a_depth_map_inside_a_jpeg_is_noted(transforms: Path, text: bytes) -> None:
    marked = with_xmp(formats.image(".jpg", VIEWS[0].srgb8), text)
    (transforms / "images/frame_00001.png").write_bytes(marked)
    (note,) = notes_of(transforms)
    assert "frame_00001.png: its depth map:" in note


@pytest.fixture(scope="module")
def seen_room() -> Frame:
    """A frame of which the depth network makes something."""
    return list(open_capture(sample_capture(), CaptureOptions(every=12)))[1]


@pytest.mark.parametrize(
    ("depth_of", "said"),
    [
        (lambda depth: depth, ""),
        (lambda depth: 3 / depth, r"as 1 / depth \(disparity\) is: .*--depth network"),
        (lambda depth: depth / 8, r"depth is 0.1\d* times what the picture lets expect: .*state depth_unit_m"),
        (lambda depth: depth / depth.max(), "its largest depth is 1, as where depth is normalised"),
        (lambda depth: 65.5 / depth * depth.min(), "its largest depth is 65.5, as"),
        (lambda depth: np.where(depth > np.quantile(depth, 0.8), 65, depth), ""),  # cut off at 65 m
        (lambda depth: 6 * depth, r"depth is \d[.\d]* times what the picture lets expect"),
    ],
)
@pytest.mark.parametrize("kind", ["photo", "capture"])
def test_depth_that_the_picture_contradicts_is_pointed_out(
    tmp_path: Path, seen_room: Frame, depth_of: Callable[[np.ndarray], np.ndarray], said: str, kind: str
) -> None:
    picture, depth = tmp_path / "image.png", tmp_path / "depth.npy"
    write_png(picture, np.clip(seen_room.image, 0, 1))
    np.save(depth, depth_of(seen_room.depth_m).astype(np.float32))
    if kind == "photo":
        notes = list(map(str, read_photo(picture, depth, PhotoOptions(fov_deg=60.0, world_up="y")).notes))
    else:
        lens = seen_room.intrinsics
        entry = {"file_path": "image.png", "depth_file_path": "depth.npy", "transform_matrix": np.eye(4).tolist()}
        index = {"fl_x": lens.fx, "fl_y": lens.fy, "cx": lens.cx, "cy": lens.cy, "world_up": "y", "frames": [entry]}
        (tmp_path / "transforms.json").write_text(json.dumps(index))
        notes = [note for note in notes_of(tmp_path) if "first pose is the identity" not in note]
        assert "lets expect" not in str(notes_of(tmp_path, CaptureOptions(depth_unit_m=1.0)))
    assert re.search(said, " ".join(notes)) if said else not notes


@pytest.mark.parametrize(("step", "way"), [(1, Mismatch(turn="mirrored")), (-1, Mismatch())])
def test_maps_that_are_mirrored_or_of_other_frames_are_pointed_out(step: int, way: Mismatch) -> None:
    check, lens = DepthCheck(), Intrinsics(28.0, 27.0, 16.0, 12.0, 32, 24)
    picture, views = np.zeros((24, 32, 3), np.float32), formats.scene(12)
    for view, other in zip(views, views[::step], strict=True):
        mirrored = np.ascontiguousarray(other.depth_m[:, ::-1], np.float32)
        check.add(Frame(0, picture, picture[..., 0] > 0, mirrored, lens, view.pose, source="frame"))
    assert check.mismatch() == way


def test_a_picture_tells_whether_its_map_is_turned(seen_room: Frame) -> None:
    turned = replace(seen_room, depth_m=np.ascontiguousarray(seen_room.depth_m[:, ::-1]))
    assert looks_turned([turned], "mirrored")
    assert not looks_turned([seen_room], "mirrored")
