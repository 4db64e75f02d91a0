"""Every rule for bad input: the frame is skipped or the capture refused, and the message names file and reason."""

import io
import json
import os
import re
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import formats
import numpy as np
import pytest
import tool_formats
from builders import BUILDERS
from capture_checks import edit, first_of, one_skipped, refused, unreadable
from PIL import Image

from roomlight.captures import CaptureOptions, open_capture
from roomlight.captures import source as source_module
from roomlight.captures.decoding import decode_depth_map
from roomlight.errors import CaptureError, FrameError, ImageError

VIEWS = formats.scene()
SRGB, MILLIMETRES = VIEWS[1].srgb8, formats.millimetres(VIEWS[1])
NAN = float("nan")


# One bad frame


@pytest.mark.parametrize(
    ("matrix", "says"),
    [
        (np.full((4, 4), NAN).tolist(), "lost tracking"),
        (np.full((4, 4), float("inf")).tolist(), "lost tracking"),
        (np.diag([2.0, 2, 2, 1]).tolist(), "scales"),
        (np.diag([-1.0, 1, 1, 1]).tolist(), "mirror"),
        ([[1, 0, 0, 1e9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "from the origin"),
        ([[1, 0, 0, 10**400], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "too large"),
        ([[1e200, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "too large"),
        ([[1, 0], [0, 1]], "4 x 4"),
        ("eye", "4 x 4"),
        ([[1, 0, 0, "0"], [0, 1, 0, 0], [0, 0, 1, 0]], "not a number"),
        (None, "4 x 4"),
        (np.vstack([np.eye(4)[:3], [1, 2, 3, 1]]).ravel().tolist(), "16 numbers, not row by row"),
    ],
)
def test_an_invalid_pose_skips_the_frame(transforms: Path, matrix: object, says: str) -> None:
    edit(transforms / "transforms.json", lambda index: index["frames"][1].update(transform_matrix=matrix))
    one_skipped(transforms, 1, says)


def test_black_pictures_at_the_start_are_skipped(transforms: Path) -> None:
    picture = json.loads((transforms / "transforms.json").read_bytes())["frames"][0]["file_path"]
    cv2.imwrite(str(transforms / picture), np.zeros_like(SRGB))
    one_skipped(transforms, 0, "its image is black")


@pytest.mark.parametrize(
    ("kind", "name"), [("tum", "rgb.txt"), ("arkitscenes", "lowres_wide.traj"), ("rtabmap", "room_camera_poses.txt")]
)
def test_a_line_that_was_cut_off_is_left_out(tmp_path: Path, kind: str, name: str) -> None:
    path = BUILDERS[kind](tmp_path / "capture", VIEWS[:2])
    (path / name).write_text((path / name).read_text().rstrip() + "\n1.5\n2.5\n")
    frames = list(capture := open_capture(path))
    assert len(frames) == 2
    (note,) = capture.notes
    assert re.search(rf"{name}: line \d+: .* \(the first of 2 such lines\)$", note.left_out)


@pytest.mark.parametrize(
    ("change", "values", "word"),
    [
        (lambda frame, value: frame["intrinsics"].update(fx=value), [0, -28, NAN, 1e-3, 1e308, "28", None], "fx"),
        (lambda frame, value: frame.update(exposure=value), [0, -1, NAN, 1e9, "1", True], "exposure"),
    ],
)
def test_an_invalid_number_skips_the_frame(native: Path, change: Callable, values: list, word: str) -> None:
    for value in values:
        edit(native / "capture.json", lambda index, value=value: change(index["frames"][1], value))
        one_skipped(native, 1, word)


def test_an_entry_that_is_not_a_frame_is_skipped(native: Path) -> None:
    for entry in (None, 7, "x", [], {}):
        edit(native / "capture.json", lambda index, entry=entry: index["frames"].__setitem__(2, entry))
        one_skipped(native, 2, "capture.json: frame 2")


def test_a_zero_quaternion_and_a_missing_column(tmp_path: Path) -> None:
    path = formats.stray_scanner(tmp_path / "capture", VIEWS)
    lines = (path / "odometry.csv").read_text().splitlines()
    whole = lines[3]
    lines[3] = "5.0, 000002, 0, 0, 0, 0, 0, 0, 0"
    (path / "odometry.csv").write_text("\n".join(lines))
    one_skipped(path, 2, "odometry.csv: line 4", "lost tracking")
    lines[3] = ",".join(whole.split(",")[:6])
    (path / "odometry.csv").write_text("\n".join(lines))
    one_skipped(path, 2, "qy is missing")


def test_a_lost_pose_of_seven_scenes(tmp_path: Path) -> None:
    path = formats.seven_scenes(tmp_path / "capture", VIEWS)
    pose = path / "frame-000004.pose.txt"
    for row, says in (("-1.#IND 0 0 0\n", "not a number"), ("nan nan nan nan\n", "lost tracking")):
        pose.write_text(row * 4)
        one_skipped(path, 1, pose.name, says)
    pose.unlink()
    one_skipped(path, 1, pose.name, "No such file")


def test_a_missing_depth_file_and_a_frame_without_depth(transforms: Path) -> None:
    (transforms / "depth/frame_00002.png").unlink()
    one_skipped(transforms, 1, "depth/frame_00002.png", "No such file")
    edit(transforms / "transforms.json", lambda index: index["frames"][1].pop("depth_file_path"))
    one_skipped(transforms, 1, "frame 1", "has no depth")


def test_depth_of_another_aspect_and_confidence_of_another_size(native: Path) -> None:
    formats.save(native / "depth/000001.png", formats.image(".png", formats.millimetres(VIEWS[1])[:12]))
    one_skipped(native, 1, "32 x 12", "confidence is 32 x 24")
    edit(native / "capture.json", lambda index: index["frames"][1].pop("confidence"))
    one_skipped(native, 1, "32 x 12", "another aspect")


@pytest.mark.parametrize("kind", ["seven-scenes", "tum"])
def test_a_data_sets_own_camera_is_scaled_to_its_aspect_alone(tmp_path: Path, kind: str) -> None:
    path = BUILDERS[kind](tmp_path / "capture", VIEWS)
    assert open_capture(path).notes == ()
    (path / "camera-intrinsics.txt").unlink()
    assert any("focal length of 525 pixels" in note.effect for note in open_capture(path).notes)
    camera = first_of(path).intrinsics
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((26.25, 26.25, 16, 12))
    if kind == "tum":  # as ETH3D's SLAM benchmark has it
        (path / "calibration.txt").write_text("26 27 15.5 11.5\n")
        camera = next(iter(open_capture(path))).intrinsics
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (26, 27, 16, 12)
        (path / "calibration.txt").unlink()
    for picture in path.rglob("*.color.jpg" if kind == "seven-scenes" else "rgb/*.png"):
        picture.write_bytes(formats.image(".png", VIEWS[0].srgb8[:18]))
    unreadable(path, r"32 x 18.*640 x 480.*write camera-intrinsics\.txt")


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("calibration.txt", "26 27 15.5 11.5" + 9 * " 0.1", r"holds 13 numbers, more than fx fy cx cy k1"),
        ("calibration.txt", "26 27 15.5 11.5 640 480", r"distortion .*640.* is out of range"),
        ("camera-intrinsics.txt", "26 0 15\n0 27 11\n0 0 1\n-0.2 0.08 0 0", r"'-0\.2 0\.08 0 0'; if it is a lens"),
    ],
)
def test_more_than_a_matrix_in_a_file_of_intrinsics_is_refused(
    tmp_path: Path, file: str, text: str, words: str
) -> None:
    path = formats.tum(tmp_path / "capture", VIEWS)
    (path / "camera-intrinsics.txt").rename(path / file).write_text(text)
    refused(path, words)


@pytest.mark.parametrize(
    ("file", "picture", "words"),
    [
        *(
            ("colour/000001.jpg", data, [])
            for data in (b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"GIF89a", b"#?RADIANCE\n\n-Y 1")
        ),
        ("colour/000001.jpg", formats.png_with_size(formats.image(".png", SRGB), 60_000, 60_000), ["60000 x 60000"]),
        ("colour/000001.jpg", formats.image(".jpg", cv2.resize(SRGB, (16, 10))), ["16 x 10", "32 x 24"]),
        ("depth/000001.png", formats.image(".png", np.zeros((24, 32), np.uint16)), ["no pixel has a known depth"]),
        ("depth/000001.png", formats.image(".png", MILLIMETRES // 1000), ["depth unit looks wrong", "depth_unit_m"]),
        ("depth/000001.png", formats.image(".png", SRGB[..., 0]), ["16-bit"]),
        ("confidence/000001.png", formats.image(".png", MILLIMETRES), ["8-bit grey"]),
    ],
)
def test_an_unusable_picture_skips_the_frame(native: Path, file: str, picture: bytes, words: list[str]) -> None:
    (native / file).write_bytes(picture)
    one_skipped(native, 1, file, *words)


@pytest.mark.parametrize("values", [np.full((24, 32), 1500, np.uint16), np.full((24, 32), 1.5, np.float32), None])
def test_depth_of_a_tiff(native: Path, values: np.ndarray | None) -> None:
    stored = np.zeros((24, 32, 3), np.uint8) if values is None else values
    Image.fromarray(stored).save(native / "depth/000001.png", "TIFF", compression="tiff_lzw")
    if values is None:
        one_skipped(native, 1, "depth/000001.png", "32 x 24 of the kind RGB; convert it to .npy or EXR")
    else:
        assert open_capture(native).frame_at(1).depth_m.max() == pytest.approx(1.5)
    (native / "depth/000001.png").write_bytes((native / "depth/000001.png").read_bytes()[:200])
    one_skipped(native, 1, "depth/000001.png", "does not decode")


def test_npy_depth_of_false_size_or_with_objects_is_refused(native: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "object.npy", np.array([{}, {}], dtype=object), allow_pickle=True)
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (99999, 99999), }\n"
    giant = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header
    for data in ((tmp_path / "object.npy").read_bytes(), giant, giant[:20], b"\x93NUMPY\x09\x09" + b"x" * 30):
        (native / "depth/000001.png").write_bytes(data)
        one_skipped(native, 1, "depth/000001.png")


# Paths that lead out


@pytest.mark.parametrize("name", ["../secret.png", "/etc/hostname", "images/../../secret.png", "a\0b", "x" * 5000])
def test_a_path_out_of_the_folder(transforms: Path, name: str) -> None:
    formats.save(transforms.parent / "secret.png", formats.image(".png", VIEWS[0].srgb8))
    edit(transforms / "transforms.json", lambda index: index["frames"][0].update(file_path=name))
    capture = open_capture(transforms)
    assert sum(1 for _ in capture) == 3
    (skipped,) = capture.skipped
    assert str(transforms) in skipped.reason
    assert len(skipped.reason) < 1200


def test_links_may_lead_only_inside_the_folder(transforms: Path) -> None:
    outside = transforms.parent / "outside.png"
    formats.save(outside, formats.image(".png", VIEWS[1].srgb8))
    target = transforms / "images/frame_00002.png"
    target.unlink()
    target.symlink_to(outside)
    one_skipped(transforms, 1, "leads out of the folder")
    target.unlink()
    target.symlink_to(target)
    one_skipped(transforms, 1, "images/frame_00002.png")
    target.unlink()
    target.symlink_to("frame_00001.png")  # inside is allowed
    assert len(list(open_capture(transforms))) == 4
    pictures = (transforms / "images").rename(transforms.parent / "pictures")
    (transforms / "images").symlink_to(pictures)  # and so is a folder that is a link
    assert len(list(open_capture(transforms))) == 4
    target = pictures / "frame_00003.png"
    target.unlink()
    target.symlink_to(outside)
    one_skipped(transforms, 2, "leads out of the folder")


def test_a_folder_of_depth_that_is_a_broken_link_is_no_recording_without_depth(tmp_path: Path) -> None:
    path = tool_formats.scannet_frames(tmp_path / "capture", VIEWS)
    (path / "depth").rename(tmp_path / "depth")
    (path / "depth").symlink_to(tmp_path / "unplugged")
    unreadable(path, r"depth/0\.png: cannot be read")
    (tmp_path / "depth").rename(tmp_path / "unplugged")
    assert not first_of(path).depth_estimated


def test_an_index_or_a_probe_that_leads_out_refuses_the_capture(transforms: Path) -> None:
    index = transforms / "transforms.json"
    edit(index, lambda stated: stated["probes"][0].update(file_path="../../x.exr"))
    refused(transforms, "probe's panorama")
    index.rename(transforms.parent / "elsewhere.json")
    index.symlink_to(transforms.parent / "elsewhere.json")
    refused(transforms, r"transforms\.json: leads out")


def test_a_probe_whose_panorama_is_no_panorama(transforms: Path) -> None:
    formats.exr(transforms / "probes/00.exr", {"RGB": np.zeros((4, 4, 3), np.float16)})
    (probe,) = open_capture(transforms).probes
    with pytest.raises(ImageError, match="twice as wide"):
        probe.panorama()
    edit(transforms / "transforms.json", lambda index: index["probes"][0].pop("file_path"))
    (probe,) = open_capture(transforms).probes
    with pytest.raises(ImageError, match="no panorama file"):
        probe.panorama()


def test_a_folder_or_a_pipe_in_place_of_a_file(transforms: Path) -> None:
    target = transforms / "depth/frame_00003.png"
    target.unlink()
    target.mkdir()
    one_skipped(transforms, 2, "not a regular file")
    target.rmdir()
    os.mkfifo(target)  # reading it would wait for ever
    one_skipped(transforms, 2, "not a regular file")


# The whole capture


def index_with(**keys: object) -> bytes:
    return json.dumps({"fl_x": 1, **keys, "frames": [{"depth_path": "x"}]}).encode()


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "empty"),
        (b"{", "not valid JSON"),
        (b"\xff\xfe{}", "not valid JSON"),
        (b'{"frames": ' + b"9" * 5000 + b"}", "not valid JSON"),
        (b'{"frames": ' + b"[" * 200_000, "nested too deeply"),
        (b"[]", "object"),
        (b"{}", "frames"),
        (b'{"frames": {}}', "not a list"),
        (b'{"frames": []}', "no frames|intrinsics"),
        (b'{"frames": [{}]}', "neither fl_x"),
        (b'{"frames": [{"depth_path": "x"}]}', "neither fl_x"),
        (index_with(fl_x=0), "fl_x is 0"),
        (index_with(fl_x=NAN), "fl_x is nan"),
        (index_with(w=1e12), "w is 1e"),
        (index_with(w=2.5), "w is 2.5"),
        (index_with(world_up="w"), "world_up is 'w'"),
        (index_with(world_up=[0, 0, 0]), "world_up"),
        (index_with(world_up=3), "world_up"),
        (index_with(depth_unit_scale_factor=-1), "depth_unit_scale_factor"),
        (index_with(probes=[{"position": [1, 2]}]), "position"),
        (index_with(probes=[{"position": [1, 2, NAN]}]), "position"),
    ],
)
def test_a_broken_index_refuses_the_capture(transforms: Path, data: bytes, says: str) -> None:
    (transforms / "transforms.json").write_bytes(data)
    with pytest.raises(CaptureError, match=says) as raised:
        open_capture(transforms)
    assert str(transforms) in str(raised.value)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b'{"format": "other"}', "format"),
        (b'{"format": "roomlight-capture", "version": 2}', "version"),
        (b'{"format": "roomlight-capture", "version": 1}', "frames"),
        (b'{"format": "roomlight-capture", "version": 1, "frames": []}', "no frames"),
        (b'{"format": "roomlight-capture", "version": 1, "frames": [], "probes": 3}', "probes"),
    ],
)
def test_a_native_index_of_another_format_is_refused(native: Path, data: bytes, says: str) -> None:
    (native / "capture.json").write_bytes(data)
    refused(native, says)


def test_an_index_larger_than_the_limit_is_not_read(transforms: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = transforms / "transforms.json"
    with file.open("r+b") as handle:  # a hole: nothing is written to the disk
        handle.truncate(source_module.MAX_INDEX_BYTES + 1)
    monkeypatch.setattr(Path, "read_bytes", lambda *_: pytest.fail("read"))
    refused(transforms, f"up to {source_module.MAX_INDEX_BYTES}")


def test_if_every_frame_is_bad_the_error_gives_a_reason(transforms: Path) -> None:
    for file in (transforms / "images").iterdir():
        file.unlink()
    capture = open_capture(transforms)
    with pytest.raises(CaptureError, match=r"none of its 4 frames.*frame_00001\.png.*No such file"):
        list(capture)
    assert len(capture.skipped) == 4


TUM = [b"", b"# nothing\n", b"noon rgb/1.png\n", b"1.0\n", b"inf rgb/1.png\n"]
LENS = [b"0 0 16\n0 27 12\n0 0 1", b"28 0 16", b"a b c\n" * 3, b"28 0 nan\n0 27 12\n0 0 1", b"\xff"]


@pytest.mark.parametrize(
    ("name", "file", "contents"),
    [
        ("seven-scenes", "camera-intrinsics.txt", LENS),
        ("seven-scenes", "gravity-direction.txt", [b"0 0 0", b"0 1", b"down", b"nan 0 0", b"0 1e300 0"]),
        *(("tum", file, TUM) for file in ("rgb.txt", "depth.txt", "groundtruth.txt")),
        *(
            ("stray-scanner", file, [b"\0\1 no \xff", None])
            for file in ("rgb.mp4", "camera_matrix.csv", "odometry.csv")
        ),
    ],
)
def test_a_broken_file_of_all_frames_refuses_the_capture(
    tmp_path: Path, name: str, file: str, contents: list[bytes | None]
) -> None:
    path = BUILDERS[name](tmp_path / "capture", VIEWS)
    for content in contents:
        if content is None:
            (path / file).unlink()
        else:
            (path / file).write_bytes(content)
        unreadable(path, re.escape(file))


# Counts that differ


def test_odometry_longer_than_the_video(tmp_path: Path) -> None:
    path = formats.stray_scanner(tmp_path / "capture", VIEWS)
    lines = (path / "odometry.csv").read_text().splitlines()
    lines.append(lines[-1].replace("000003", "000004"))
    (path / "odometry.csv").write_text("\n".join(lines))
    for kind in ("depth", "confidence"):
        formats.save(path / f"{kind}/000004.png", (path / f"{kind}/000003.png").read_bytes())
    capture = open_capture(path)
    assert len(list(capture)) == 4
    assert "has 4 frames, so there is no frame 4" in capture.skipped[0].reason
    (path / "depth/000002.png").unlink()
    (path / "confidence/000001.png").unlink()  # which a frame may lack
    assert [frame.index for frame in capture] == [0, 1, 3]


def test_a_video_of_another_aspect_or_an_unknown_codec_refuses_the_capture(stray: Path) -> None:
    data = (stray / "rgb.mp4").read_bytes()
    (stray / "rgb.mp4").write_bytes(data.replace(b"avc1", b"zzzz"))
    unreadable(stray, r"rgb\.mp4")
    (stray / "camera_matrix.csv").write_text("1600, 0, 965\n0, 1600, 715\n0, 0, 1")
    formats.video(stray / "rgb.mp4", [np.zeros((24, 64, 3), np.uint8)] * 4)
    unreadable(stray, r"64 x 24.*another aspect")


def test_a_truncated_video_loses_only_its_end(tmp_path: Path) -> None:
    views = formats.scene(12)
    path = formats.stray_scanner(tmp_path / "capture", views)
    data = bytearray((path / "rgb.mp4").read_bytes())
    start = data.index(b"mdat") + 4
    end = data.index(b"moov") - 4
    data[start + (end - start) * 2 // 3 : end] = bytes(end - start - (end - start) * 2 // 3)
    (path / "rgb.mp4").write_bytes(data)
    capture = open_capture(path)
    frames = list(capture)
    assert 3 <= len(frames) < 12
    assert len(frames) + len(capture.skipped) == 12
    assert all("rgb.mp4" in skipped.reason for skipped in capture.skipped)


def test_more_pictures_than_poses(tmp_path: Path) -> None:
    path = formats.record3d_export(tmp_path / "capture", VIEWS)
    edit(path / "metadata.json", lambda index: index["poses"].pop())
    one_skipped(path, 3, "rgb/3.jpg", "has no pose; the metadata has 3")


@pytest.mark.parametrize(
    "change",
    [{"K": [0] * 9}, {"K": [1, 2]}, {"K": None}, {"w": 0}, {"h": "x"}, {"dw": -1}, {"dh": 1e9}, {"poses": None}],
)
def test_invalid_metadata_refuses_the_capture(tmp_path: Path, change: dict) -> None:
    path = formats.record3d_export(tmp_path / "capture", VIEWS)
    edit(path / "metadata.json", lambda index: index.update(change))
    refused(path, r"metadata\.json")


def test_frame_at_raises_what_iterating_skips(native: Path) -> None:
    (native / "depth/000001.png").unlink()
    capture = open_capture(native, CaptureOptions(every=2))
    with pytest.raises(FrameError, match=r"depth/000001\.png"):
        capture.frame_at(1)
    assert capture.frame_at(2).index == 2


@pytest.mark.parametrize(
    ("pages", "says"), [(2, "holds 2 pictures"), (1, r"does not decode \(of an unknown layout\)"), (0, "an .npz holds")]
)
def test_depth_of_other_containers_is_refused(pages: int, says: str) -> None:
    """Of two pages, of a page of 64-bit floats, and an .npz."""
    stream = io.BytesIO()
    if pages:
        page = np.full((24, 32), 1500, np.uint16)
        Image.fromarray(page).save(stream, "TIFF", save_all=True, append_images=[Image.fromarray(page)] * (pages - 1))
    else:
        np.savez(stream, depth=np.ones((24, 32)))
    data = stream.getvalue() if pages != 1 else cv2.imencode(".tiff", np.ones((24, 32)))[1].tobytes()
    with pytest.raises(ImageError, match=says):
        decode_depth_map(data, "d", unit_m=None)
