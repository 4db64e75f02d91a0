"""One rule for one fact in every format: lenses, times, units, names, text encodings, masks, colour, and notes."""

import codecs
import json
import shutil
import unicodedata
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import formats
import lzfse
import numpy as np
import pytest
from capture_checks import edit, first_of, notes_of, one_skipped, refused, same_views, unreadable
from PIL import ExifTags, Image

from roomlight.camera import Intrinsics
from roomlight.captures import CaptureOptions, fields, open_capture
from roomlight.captures.decoding import decode_confidence, decode_depth_map
from roomlight.captures.lenses import Lens, lens_of, undistorted
from roomlight.captures.times import MAX_GAP_S, timeline
from roomlight.captures.video import VideoFrames
from roomlight.conventions import srgb8_to_linear
from roomlight.errors import CaptureError, ImageError, UnknownFormatError
from roomlight.sample import sample_capture

VIEWS = formats.scene()
CAMERA = Intrinsics(80.0, 80.0, 48.0, 36.0, 96, 72)


def lens(*coefficients: float, fisheye: bool = False) -> Lens:
    return Lens(tuple(map(float, coefficients)), fisheye)


# Lenses


@pytest.mark.parametrize(
    ("bent", "radius"),
    [
        (lens(0, 0, 0, 0, fisheye=True), np.arctan),
        (
            lens(0.02, 0.01, 0, 0, fisheye=True),
            lambda r: np.arctan(r) * (1 + 0.02 * np.arctan(r) ** 2 + 0.01 * np.arctan(r) ** 4),
        ),
        (lens(-0.1, 0.01, 0, 0, 0, 0, 0, 0), lambda r: r * (1 - 0.1 * r**2 + 0.01 * r**4)),
        (
            lens(0.1, 0.01, 0, 0, 0.001, 0, 0.5, 0.2),
            lambda r: r * (1 + 0.1 * r**2 + 0.01 * r**4 + 0.001 * r**6) / (1 + 0.5 * r**4 + 0.2 * r**6),
        ),
    ],
    ids=["equidistant", "fisheye", "opencv", "rational"],
)
def test_pixels_look_where_the_lens_model_says(bent: Lens, radius: Callable[[np.ndarray], np.ndarray]) -> None:
    """An image that stores each pixel's own coordinates shows, straightened, which pixel each ray came from."""
    columns, rows = np.meshgrid(np.arange(96) + 0.5, np.arange(72) + 0.5)
    coordinates = np.stack([columns, rows, rows], axis=-1).astype(np.float32)
    images = [(coordinates, cv2.INTER_LINEAR), (np.zeros((36, 48), np.float32), cv2.INTER_NEAREST)]
    (image, half), straight = undistorted(images, CAMERA, bent)
    assert straight.fy == pytest.approx(straight.fx)  # pixels stay square, the height follows the view
    assert image.shape[:2] == (straight.height, straight.width)
    assert (straight.width, half.shape) == (96, (round(straight.height / 2), 48))
    rays = straight.rays()
    r = np.hypot(rays[..., 0], rays[..., 1])
    scale = radius(r) / np.maximum(r, 1e-9)
    inner = (slice(1, -1), slice(1, -1))
    np.testing.assert_allclose(image[inner][..., 0], (48 + 80 * rays[..., 0] * scale)[inner], atol=0.06)
    np.testing.assert_allclose(image[inner][..., 1], (36 - 80 * rays[..., 1] * scale)[inner], atol=0.06)


@pytest.mark.parametrize(
    "keys",
    [
        {"camera_model": "OPENCV_FISHEYE"},
        {"camera_model": "opencv-fisheye", "k1": 0},
        {"camera_model": "SIMPLE_RADIAL_FISHEYE", "k1": 0.0},
        {"is_fisheye": True},
        {"is_fisheye": "true"},
        {"lens_mode": "OpenCVFisheye"},
        {"distortion_model": "kannala_brandt"},
        {"camera_model": " OPENCV_FISHEYE "},
    ],
)
def test_a_fisheye_is_one_by_every_name(transforms: Path, keys: dict) -> None:
    edit(transforms / "transforms.json", lambda index: (index.pop("camera_model"), index["frames"][1].update(keys)))
    plain, bent, *_ = open_capture(transforms)
    assert plain.intrinsics.fx == formats.FX
    assert bent.intrinsics.fx < 0.98 * formats.FX


def test_coefficients_written_as_text_are_read(transforms: Path) -> None:
    """As nerfstudio copied them from the tables of RealityCapture."""

    def change(index: dict) -> None:
        for frame, stated in zip(index["frames"], (-0.1, "-0.1", "nan", "x"), strict=True):
            frame.update(k1=stated, k2="0")

    edit(transforms / "transforms.json", change)
    plain, text = capture = open_capture(transforms)
    assert plain.intrinsics == text.intrinsics
    assert ["k1 is nan" in capture.skipped[0].reason, "k1 is 'x'" in capture.skipped[1].reason] == [True, True]


@pytest.mark.parametrize(
    ("keys", "named"),
    [
        ({"camera_model": "EQUIRECTANGULAR"}, "EQUIRECTANGULAR"),
        ({"camera_model": "FISHEYE624", "distortion_params": [0.4] * 12}, "FISHEYE624"),
        ({"camera_model": "ORTHOPHOTO"}, "ORTHOPHOTO"),
        ({"camera_model": "THIN_PRISM_FISHEYE"}, "THIN_PRISM_FISHEYE"),
        ({"camera_model": "VR180_L"}, "VR180_L"),
        ({"lens_mode": "LatLong"}, "LatLong"),
        ({"ftheta_p0": 0, "ftheta_p1": 0.01}, "ftheta"),
        ({"xi": 1.2}, "xi"),
        ({"projection": "Equirectangular"}, "projection"),
        ({"distortion_coefficients": [0.1, 0.02]}, "distortion_coefficients"),
        ({"distortion_params": [0.1, 0.2, 0, 0]}, "distortion_params"),
        ({"k4": 0.1}, "k4 of a polynomial lens (Metashape, RealityCapture)"),
        ({"is_fisheye": True, "p1": 0.01}, "fisheye"),
    ],
)
def test_other_lenses_are_refused_by_name(transforms: Path, keys: dict, named: str) -> None:
    edit(transforms / "transforms.json", lambda index: index["frames"][1].update(keys))
    one_skipped(transforms, 1, named, "ndistort")


def test_a_lens_that_folds_the_image_is_refused() -> None:
    for bent in (lens(-3.0, 0, 0, 0, 0, 0, 0, 0), lens(-8.0, 0, 0, 0, fisheye=True)):
        with pytest.raises(ValueError, match="distortion"):
            undistorted([(np.zeros((72, 96, 3), np.float32), cv2.INTER_LINEAR)], CAMERA, bent)
    assert lens_of({}, {"camera_model": "PINHOLE"}).straight


# Times


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6, 1e9])
@pytest.mark.parametrize("rate", [0.4, 5, 30, 120])
@pytest.mark.parametrize("start_s", [65505.28, 1.7e9])
def test_the_unit_of_time_is_recognised(unit: float, rate: int, start_s: float) -> None:
    if start_s < 1e9 and (rate < 1 or (unit == 1e3 and rate == 120)):
        return  # 8.3 ms: also a photo every 8.3 s, which is what the file says
    stamps: list[float | None] = [round((start_s + index / rate) * unit, 3) for index in range(9)]
    found = timeline(stamps, "x")
    assert found.step_s == pytest.approx(1 / rate, rel=0.06)
    assert bool(found.notes) == (unit != 1)


def test_ticks_of_windows_are_recognised() -> None:
    found = timeline([638e15 + round(index / 30 * 1e7) for index in range(9)], "x")
    assert found.step_s == pytest.approx(1 / 30, rel=1e-3)
    assert "ticks of 100 nanoseconds" in str(found.notes)


@pytest.mark.parametrize("rate", [24000 / 1001, 24, 30000 / 1001, 30, 60000 / 1001, 60])
def test_rounded_times_have_the_rate_that_they_are_of(rate: float) -> None:
    stamps: list[float | None] = [round(100 + index / rate, 3) for index in range(90)]
    step_s = timeline(stamps, "x").step_s
    assert step_s is not None
    assert 1 / step_s == pytest.approx(rate, rel=1e-9)
    step_s = timeline([*stamps[:40], *stamps[60:]], "x").step_s  # with a gap
    assert step_s == pytest.approx(1 / rate, rel=0.05)
    few = timeline([0.0, 0.9 / rate, 2.1 / rate, 3.06 / rate], "x").step_s  # uneven by themselves
    assert few == pytest.approx(1.02 / rate, rel=0.005)


def test_slides_a_minute_apart_are_no_milliseconds() -> None:
    slides: list[float | None] = [0.0, 60.0, 120.0, 180.0]
    assert timeline(slides, "x").times_s == (0.0, 0.06, 0.12, 0.18)
    known = timeline(slides, "x", seconds=True)
    assert known.times_s == (0.0, MAX_GAP_S, 2 * MAX_GAP_S, 3 * MAX_GAP_S)
    assert "3 steps of time, the first of 60 s" in str(known.notes[0])


def test_numbers_of_frames_are_no_times(tmp_path: Path) -> None:
    path = formats.polycam(tmp_path / "capture", VIEWS)
    for folder in (path / "keyframes").iterdir():
        for number, file in enumerate(sorted(folder.iterdir())):
            file.rename(file.with_name(f"{number}{file.suffix}"))  # Polycam's own names are microseconds
    capture = open_capture(path)
    assert [frame.timestamp_s for frame in capture] == [None] * 4
    assert "timestamps a median of 1e-06 s apart, which no camera is" in str(capture.notes)
    assert timeline([0.0, 0.001, 0.002], "x").times_s == (0.0, 0.001, 0.002)
    (note,) = timeline([0.0, 1.0, 2.0, 4.0], "x").notes
    assert "1 apart as numbers of frames are" in str(note)
    assert not timeline([0.5, 1.5, 2.5], "x").notes


def test_gaps_and_steps_back_are_bounded_and_said() -> None:
    found = timeline([0.0, 0.1, 4e9, 4e9 + 0.1, 3.0, None, 3.1], "room")
    times = [time for time in found.times_s if time is not None]
    assert found.times_s[5] is None
    assert (np.diff(times) >= 0).all()
    assert max(np.diff(times)) <= MAX_GAP_S
    assert "room: 2 steps of time, the first of 4e+09 s before record 2" in str(found.notes[0])
    slow: list[float | None] = [0.0, 3.0, 5.0, 9.0]
    assert timeline(slow, "x") == timeline(slow, "y")
    assert list(timeline(slow, "x").times_s) == slow


# Depth units


@pytest.mark.parametrize("suffix", [".exr", ".npy", ".png", ".tif"])
@pytest.mark.parametrize(
    ("unit_m", "stated", "option"),
    [(None, None, None), (0.002, 0.002, None), (0.002, None, 0.002), (0.004, 0.1, 0.004)],
)
def test_a_stated_unit_holds_for_every_kind_of_depth_file(
    transforms: Path, suffix: str, unit_m: float | None, stated: float | None, option: float | None
) -> None:
    file = transforms / f"depth{suffix}"
    values = VIEWS[0].depth_m / np.float32(unit_m or (0.001 if suffix == ".png" else 1.0))
    if suffix == ".exr":
        formats.exr(file, {"Z": values})
    elif suffix == ".npy":
        np.save(file, values)
    elif suffix == ".tif":
        Image.fromarray(values).save(file)
    else:
        formats.save(file, formats.image(".png", np.rint(values).astype(np.uint16)))
    keys = {"depth_file_path": file.name, "depth_unit_scale_factor": stated}
    edit(transforms / "transforms.json", lambda index: index["frames"][0].update(keys))
    depth_m = first_of(transforms, CaptureOptions(depth_unit_m=option)).depth_m
    np.testing.assert_allclose(depth_m, VIEWS[0].depth_m, atol=0.0021)


# Names and text


@pytest.mark.parametrize(
    ("stored", "named"),
    [
        ("images/0.png", "images\\0.png"),
        ("images/0.png", "images\\0"),
        ("images/IMG_0.PNG", "images/IMG_0"),
        ("images/IMG_0.PNG", "Images/img_0.png"),
        ("images/my image.png", "images/my%20image.png"),
        ("images/100%.png", "images/100%.png"),
        ("images/cam.0001.png", "./images/cam.0001"),
        (unicodedata.normalize("NFD", "images/Küche 1.png"), unicodedata.normalize("NFC", "images/Küche 1.png")),
        (unicodedata.normalize("NFC", "images/Küche 1.png"), unicodedata.normalize("NFD", "images/Küche 1.png")),
    ],
)
def test_names_of_other_systems_are_found(transforms: Path, stored: str, named: str) -> None:
    shutil.move(transforms / "images/frame_00001.png", transforms / stored)
    edit(transforms / "transforms.json", lambda index: index["frames"][0].update(file_path=named))
    capture = open_capture(transforms)
    assert len(list(capture)) == 4
    assert capture.skipped == []


@pytest.mark.parametrize("root", ["", "/home/me/scan", "D:\\scans", "file:///data/scan"])
def test_absolute_paths_of_files_in_the_folder_are_read(transforms: Path, root: str) -> None:
    def change(index: dict) -> None:
        for frame, key in ((frame, key) for frame in index["frames"] for key in ("file_path", "depth_file_path")):
            frame[key] = f"{root or transforms}/{frame[key]}"
        index["frames"][1]["file_path"] = "/etc/passwd"
        index["frames"][2]["file_path"] = str(transforms / "images/none.png")

    edit(transforms / "transforms.json", change)
    frames = list(capture := open_capture(transforms))
    assert {frame.source for frame in frames} == {f"{transforms}/images/frame_0000{at}.png" for at in (1, 4)}
    reasons = "; ".join(skipped.reason for skipped in capture.skipped)
    assert "/etc/passwd: not a path inside the folder" in reasons
    assert f"{transforms}/images/none.png: cannot be read" in reasons
    assert [note.effect.split("/")[0] for note in capture.notes] == ([] if not root else ["depth"])


def test_two_files_of_another_case_are_ambiguous(transforms: Path) -> None:
    (transforms / "images/A.png").write_bytes((transforms / "images/frame_00001.png").read_bytes())
    shutil.move(transforms / "images/frame_00001.png", transforms / "images/a.png")
    edit(transforms / "transforms.json", lambda index: index["frames"][0].update(file_path="images/a.PNG"))
    one_skipped(transforms, 0, "A.png and a.png")


def test_two_files_for_a_name_without_a_suffix_are_an_error(transforms: Path) -> None:
    formats.save(transforms / "images/frame_00001.jpg", formats.image(".jpg", 255 - VIEWS[0].srgb8))
    edit(transforms / "transforms.json", lambda index: index["frames"][0].update(file_path="images/frame_00001"))
    one_skipped(transforms, 0, "is there as frame_00001.png and frame_00001.jpg; name one of them")
    path = formats.colmap(transforms.parent / "colmap", VIEWS)
    np.save(path / "depth/frame_00001.npy", VIEWS[0].depth_m)  # beside a picture of it
    one_skipped(path, 0, "is there as frame_00001.png and frame_00001.npy")


def rewritten(text: str, kind: str) -> bytes:
    if kind == "bom":
        return codecs.BOM_UTF8 + text.encode()
    if kind == "utf-16":
        return text.encode("utf-16")
    if kind == "semicolon":
        return text.replace(",", ";").encode()
    if kind == "decimal comma":
        return text.replace(",", ";").replace(".", ",").encode()
    if kind == "tab":
        return text.replace(", ", "\t").encode()
    if kind == "quoted":
        return "\n".join(",".join(f'"{v.strip()}"' for v in line.split(",")) for line in text.splitlines()).encode()
    return (text.replace("\n", "\r\n") if kind == "crlf" else text.title()).encode()


@pytest.mark.parametrize("kind", ["bom", "utf-16", "semicolon", "decimal comma", "tab", "quoted", "crlf", "title"])
def test_tables_of_spreadsheet_programs(tmp_path: Path, kind: str) -> None:
    path = formats.stray_scanner(tmp_path / "capture", VIEWS[:2])
    (path / "odometry.csv").write_bytes(rewritten((path / "odometry.csv").read_text(), kind))
    first, second = open_capture(path)
    np.testing.assert_allclose(second.camera_to_world, VIEWS[1].pose, atol=1e-6)
    assert first.timestamp_s == pytest.approx(5.0)


def test_text_of_tum_and_json_with_marks(tmp_path: Path) -> None:
    path = formats.tum(tmp_path / "tum", VIEWS)
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        text = (path / name).read_text()
        (path / name).write_bytes(codecs.BOM_UTF8 + b"# caf\xe9\r\n" + text.replace("\n", "\r\n").encode())
    assert len(list(open_capture(path))) == 4
    path = formats.nerfstudio(tmp_path / "nerf", VIEWS)
    (path / "transforms.json").write_bytes(codecs.BOM_UTF8 + (path / "transforms.json").read_bytes())
    assert len(list(open_capture(path))) == 4


def test_numbers_between_blanks_may_have_decimal_commas(tmp_path: Path) -> None:
    path = formats.tum(tmp_path / "tum", VIEWS)
    lines = (path / "rgb.txt").read_text().splitlines()
    (path / "rgb.txt").write_text("\n".join(line.replace(".", ",", 1) for line in lines))
    for name in ("groundtruth.txt", "camera-intrinsics.txt"):
        (path / name).write_text((path / name).read_text().replace(".", ","))
    same_views(frames := list(open_capture(path)), VIEWS)
    assert {frame.intrinsics.fx for frame in frames} == {28.0}


@pytest.mark.parametrize("line", ["1,2,3,4", "1, 2, 3, 4", "1 2 3 4", "1;2;3;4", "1.0,2.0 3.0,4.0"])
def test_commas_separate_where_they_are_no_points(line: str) -> None:
    assert fields.numbers_of_line(line, 4, "the row") == [1, 2, 3, 4]


@pytest.mark.parametrize("written", [str, lambda time: f"2024-05-01T12:00:0{time:.3f}Z"])
def test_times_written_as_text_are_read(transforms: Path, written: Callable[[float], str]) -> None:
    def stamped(index: dict[str, Any]) -> None:
        for number, frame in enumerate(reversed(index["frames"])):  # the last listed is the first
            frame["timestamp"] = written(0.2 * number)

    edit(transforms / "transforms.json", stamped)
    capture = open_capture(transforms)
    frames = list(capture)
    np.testing.assert_allclose(np.diff([frame.timestamp_s or 0 for frame in frames]), 0.2, atol=1e-3)
    np.testing.assert_allclose(frames[0].camera_to_world, VIEWS[3].pose, atol=1e-6)
    assert not any("timestamp" in str(note) for note in capture.notes)


# Masks


def test_transparent_and_masked_pixels_are_not_seen(transforms: Path) -> None:
    pixels = np.dstack([VIEWS[0].srgb8, np.full((24, 32), 255, np.uint8)])
    pixels[:6] = 0
    formats.save(transforms / "images/frame_00001.png", cv2.imencode(".png", pixels[..., [2, 1, 0, 3]])[1].tobytes())
    mask = np.full((12, 16), 255, np.uint8)
    mask[:, :4] = 0
    formats.save(transforms / "masks/1.png", formats.image(".png", mask))
    edit(transforms / "transforms.json", lambda index: index["frames"][1].update(mask_path="masks/1.png"))
    moving = np.where(mask == 0, 255, 0).astype(np.uint8)
    formats.save(transforms / "images/dynamic_mask_frame_00003.png", formats.image(".png", moving))
    in_alpha = np.dstack([np.full((12, 16, 3), 255, np.uint8), mask])
    formats.save(transforms / "masks/4.png", cv2.imencode(".png", in_alpha)[1].tobytes())
    edit(transforms / "transforms.json", lambda index: index["frames"][3].update(mask_path="masks/4.png"))
    transparent, masked, left_out, alpha = open_capture(transforms)
    for frame in (left_out, alpha):
        np.testing.assert_array_equal(frame.seen, masked.seen)
    edit(transforms / "transforms.json", lambda index: index.update(mask_path="masks/1.png"))
    np.testing.assert_array_equal(list(open_capture(transforms))[2].seen, masked.seen)
    for frame, hidden in ((transparent, np.s_[:6]), (masked, np.s_[:, :8])):
        assert frame.seen is not None
        assert not frame.seen[hidden].any()
        assert frame.seen.sum() == 576
        assert not frame.depth_m[hidden].any()
        assert (frame.depth_m > 0).sum() == 576
        assert frame.image[hidden].min() > 0.02  # the colour around, not black


@pytest.mark.parametrize("keys", [("camera_angle_x", "camera_angle_y"), ("x_fov", "y_fov")], ids=["radians", "degrees"])
def test_angles_of_view_that_differ_give_pixels_that_are_not_square(transforms: Path, keys: tuple[str, str]) -> None:
    angles = (1.0, 0.5) if keys[0] == "camera_angle_x" else np.degrees((1.0, 0.5)).tolist()
    edit(transforms / "transforms.json", lambda index: (index.pop("fl_x"), index.pop("fl_y")))
    edit(transforms / "transforms.json", lambda index: index.update(zip(keys, angles, strict=True)))
    camera = first_of(transforms).intrinsics
    assert camera.fx == pytest.approx(camera.width / 2 / np.tan(0.5))
    assert camera.fy == pytest.approx(camera.height / 2 / np.tan(0.25))


def test_the_lens_of_a_frame_overrides_that_of_all(transforms: Path) -> None:
    """An angle takes the place of both focal lengths, a focal length that of its own."""

    def change(index: dict) -> None:
        index.update(fl_x=50.0, fl_y=40.0)
        for frame in index["frames"][:2]:
            frame.update(fl_x=None, fl_y=None)
        index["frames"][0].update(camera_angle_x=2 * np.arctan(0.5 * formats.WIDTH / formats.FX))
        index["frames"][1].update(fl_x=formats.FX)

    edit(transforms / "transforms.json", change)
    for frame, fy in zip(open_capture(transforms), (formats.FX, 40.0), strict=False):
        assert (frame.intrinsics.fx, frame.intrinsics.fy) == pytest.approx((formats.FX, fy))


def test_small_pictures_of_nerfstudio_are_read(transforms: Path) -> None:
    (transforms / "images").rename(transforms / "images_4")
    notes_of(transforms, frames=4)


def test_what_instant_ngp_reads_besides_is_read(transforms: Path) -> None:
    """Comments, a BMP without its suffix."""
    path = transforms / "transforms.json"
    edit(path, lambda index: index.update(x_fov=60.0, note='a "//" /* b'))
    edit(path, lambda index: index["frames"][0].update(file_path="images/frame_00001"))
    text = path.read_text()
    path.write_text("// written by hand\n/* also\nthis */" + text + "/* open")
    formats.save(transforms / "images/frame_00001.bmp", formats.image(".bmp", VIEWS[0].srgb8))
    (transforms / "images/frame_00001.png").unlink()
    notes_of(transforms, frames=4)
    path.write_text(text.replace("fl_", "other_").replace("60.0", "180.0"))
    unreadable(transforms, r"x_fov is 180\.0; it must be below 180 degrees")


def test_an_index_in_a_code_page_of_windows(transforms: Path) -> None:
    (transforms / "images/frame_00001.png").rename(transforms / "images/fläche.png")
    path = transforms / "transforms.json"
    edit(path, lambda index: index["frames"][0].update(file_path="images/fläche.png"))
    text = json.dumps(json.loads(path.read_text()), ensure_ascii=False)
    path.write_bytes(text.encode("latin-1"))
    assert len(list(open_capture(transforms))) == 4


# Colour of video, orientation


def test_wide_colours_of_a_video_are_read_by_their_curve_or_refused(stray: Path) -> None:
    def encode(code: int, curve: int) -> None:
        tags = {"color_primaries": 9, "color_trc": curve, "colorspace": 9}
        formats.video(stray / "rgb.mp4", [np.full((24, 32, 3), code, np.uint8)] * 4, options={"crf": "1"}, tags=tags)

    encode(200, 18)  # HLG, BT.2100: (exp((0.784 - c) / a) + b) / 12 of the scene's light
    np.testing.assert_allclose(first_of(stray).image, 0.32, atol=0.02)
    encode(100, 9)  # logarithmic
    unreadable(stray, r"rgb\.mp4: has a transfer curve of code 9")


@pytest.mark.parametrize("stated", [True, False])
def test_a_unit_upside_down_is_named(transforms: Path, stated: bool) -> None:
    if stated:
        edit(transforms / "transforms.json", lambda index: index.update(depth_unit_scale_factor=1000))
    capture = open_capture(transforms, CaptureOptions(depth_unit_m=None if stated else 1000.0))
    with pytest.raises(CaptureError, match=r"up to 100000 m; unless.*the depth unit looks wrong; set depth_unit_m"):
        list(capture)


def oriented(path: Path, view: formats.View, orientation: int) -> None:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    Image.fromarray(view.srgb8).save(path, exif=exif)


def test_exif_orientation_of_a_capture_is_said_and_not_applied(transforms: Path) -> None:
    whole = first_of(transforms).image
    oriented(transforms / "images/frame_00001.png", VIEWS[0], 3)
    np.testing.assert_array_equal(first_of(transforms).image, whole)
    assert any("orientation 3" in note for note in notes_of(transforms))


def test_intrinsics_of_the_upright_view_name_the_orientation(transforms: Path) -> None:
    oriented(transforms / "images/frame_00002.png", VIEWS[1], 6)
    edit(transforms / "transforms.json", lambda index: index["frames"][1].update(w=24, h=32))
    one_skipped(transforms, 1, "EXIF orientation 6: the image is stored as 32 x 24", "for 24 x 32", "turn its pixels")


# What is marked, unread, nested, guessed


def test_frames_that_are_marked_bad_or_masked_are_skipped(transforms: Path) -> None:
    for mark in (True, 1, "true"):
        edit(transforms / "transforms.json", lambda index, mark=mark: index["frames"][2].update(is_bad=mark))
        one_skipped(transforms, 2, "is_bad")
    formats.save(transforms / "mask.png", formats.image(".png", np.zeros((24, 32), np.uint8)))
    edit(transforms / "transforms.json", lambda index: index["frames"][2].update(is_bad=False, mask_path="mask.png"))
    one_skipped(transforms, 2, "no pixel that is seen")


@pytest.mark.parametrize(
    ("frame", "shared", "says"),
    [
        ({"rolling_shutter_s": 0.01}, {}, "rolling_shutter_s"),
        ({"timestamp": "00:01:02;05"}, {}, "4 timestamps are no numbers"),
        ({}, {"depth_scale": 1000.0, "depth_far": 10.0}, "depth_far, depth_scale"),
    ],
)
def test_what_is_not_read_of_an_index_is_noted_once(transforms: Path, frame: dict, shared: dict, says: str) -> None:
    edit(
        transforms / "transforms.json",
        lambda index: (index.update(shared), [stated.update(frame) for stated in index["frames"]]),
    )
    (note,) = notes_of(transforms, frames=4)
    assert says in note
    assert [read.timestamp_s for read in open_capture(transforms)] == [None] * 4


def test_keys_of_spectacular_ai_that_change_nothing_are_not_noted(transforms: Path) -> None:
    keys = {"camera_linear_velocity": [0, 0, 0], "camera_angular_velocity": [0, 0, 0], "motion_blur_score": 1.5}

    def change(index: dict) -> None:
        index.update(auto_scale_poses_override=False)
        for frame in index["frames"]:
            frame.update(keys)

    edit(transforms / "transforms.json", change)
    assert not notes_of(transforms, frames=4)


def test_applied_scale_is_taken_back(transforms: Path) -> None:
    def scale(index: dict) -> None:
        index["applied_scale"] = 2.0
        for frame in index["frames"]:
            frame["transform_matrix"] = [[*row[:3], 2 * row[3]] for row in frame["transform_matrix"][:3]]

    edit(transforms / "transforms.json", scale)
    same_views(open_capture(transforms), VIEWS, atol=1e-9)


def test_a_world_that_is_its_first_camera_is_pointed_out(tmp_path: Path) -> None:
    path = formats.tum(tmp_path / "tum", VIEWS)
    lines = (path / "groundtruth.txt").read_text().splitlines()
    first, *rest = [line for line in lines if not line.startswith("#")]
    (path / "groundtruth.txt").write_text("\n".join([f"{first.split()[0]} 0 0 0 0 0 0 1", *rest]))
    (note,) = notes_of(path)
    assert "looks straight up" in note
    assert "--world-up -y" in note
    assert not notes_of(path, CaptureOptions(world_up="-y"))


def test_the_first_cameras_up_of_record3d_is_pointed_out(tmp_path: Path) -> None:
    """The app may count turns from the first camera."""
    path = formats.record3d_export(tmp_path / "capture", VIEWS)
    assert "up is that" not in str(notes_of(path))
    turn = VIEWS[0].pose[:3, :3].T
    poses = [[*formats.quaternion(turn @ view.pose[:3, :3]), *(turn @ view.pose[:3, 3]).tolist()] for view in VIEWS]
    edit(path / "metadata.json", lambda index: index.update(poses=poses, initPose=[0, 0, 0, 1, 0, 0, 0]))
    (note,) = [note for note in notes_of(path) if "turn" in note]
    assert "rgb/0.jpg: the first pose is without a turn: up is that of the first camera; state world_up" in note
    assert "up is that" not in str(notes_of(path, CaptureOptions(world_up="y")))
    edit(path / "metadata.json", lambda index: index.update(initPose=[0, 0, 1, 0, 0, 0, 0]))
    assert "initPose [0, 0, 1, 0, 0, 0, 0]: poses are read as they stand" in str(open_capture(path).notes[0])


def test_times_of_record3d_by_its_rate(tmp_path: Path) -> None:
    path = formats.record3d_export(tmp_path / "capture", VIEWS)
    (path / "rgb/1.jpg").unlink()
    edit(path / "metadata.json", lambda index: (index.pop("frameTimestamps"), index.update(fps=20)))
    assert [frame.timestamp_s for frame in open_capture(path)] == pytest.approx([0, 0.1, 0.15])
    edit(path / "metadata.json", lambda index: index.update(fps=0))
    assert [frame.timestamp_s for frame in open_capture(path)] == [None] * 3


def test_archives_and_folders_with_a_folder_above(tmp_path: Path) -> None:
    members = formats.record3d_members(VIEWS)
    beside = {f"__MACOSX/2024-05-01/._{name.rpartition('/')[2]}": b"x" for name in members}
    formats.zipped(tmp_path / "a.r3d", beside | {f"2024-05-01/{name}": data for name, data in members.items()})
    assert len(list(open_capture(tmp_path / "a.r3d"))) == 4
    inner = formats.nerfstudio(tmp_path / "outer/middle/2024-05-01", VIEWS)
    assert open_capture(tmp_path / "outer").path == inner
    formats.nerfstudio(tmp_path / "outer/middle/2024-05-02", VIEWS)
    refused(tmp_path / "outer/middle", r"holds 2 captures \(2024-05-01, 2024-05-02\)", error=UnknownFormatError)


@pytest.mark.parametrize("size", [(640, 480), (256, 192), (24, 32)])
def test_record3d_depth_size_follows_from_its_bytes(tmp_path: Path, size: tuple[int, int]) -> None:
    long, short = max(size), min(size)
    depth = np.full((short, long), 2.0, np.float32)
    depth[: short // 2] = 1.0
    members = formats.record3d_members(VIEWS)
    metadata = json.loads(members["metadata"])
    del metadata["dw"], metadata["dh"]
    members["metadata"] = json.dumps(metadata).encode()
    for number in range(4):
        members[f"rgbd/{number}.depth"] = lzfse.compress(depth.tobytes())
        members[f"rgbd/{number}.conf"] = lzfse.compress(np.full(depth.size, 2, np.uint8).tobytes())
    for name, data in members.items():
        formats.save(tmp_path / "capture" / name, data)
    np.testing.assert_array_equal(next(iter(open_capture(tmp_path / "capture"))).depth_m, depth)


# Formats of other tools


def test_a_frame_of_stray_scanner_without_confidence_is_read(stray: Path) -> None:
    (stray / "confidence/000001.png").unlink()
    first, second, *others = open_capture(stray)
    assert (bool(first.depth_m.all()), bool(second.depth_m.all()), len(others)) == (False, True, 2)


def test_the_picture_that_stray_scanners_edit_list_hides_is_the_first_rows(tmp_path: Path) -> None:
    """The app's clock of the video starts at 0, and its first frame at -1/60 s."""
    views = [replace(view, srgb8=np.full((24, 32, 3), 40 * at + 20, np.uint8)) for at, view in enumerate(VIEWS)]
    path = formats.stray_scanner(tmp_path / "capture", views)
    plain = [frame.image.mean() for frame in open_capture(path)]
    formats.remuxed(path / "rgb.mp4", tmp_path / "late.mp4", lambda _: None, later_s=1 / 30)
    with VideoFrames(tmp_path / "late.mp4", "late") as presented:
        assert len(presented.times_s) == 3
    shutil.move(tmp_path / "late.mp4", path / "rgb.mp4")
    capture = open_capture(path)
    assert [frame.image.mean() for frame in capture] == pytest.approx(plain, abs=1e-4)
    assert [float(capture.frame_at(at).image.mean()) for at in (2, 0)] == pytest.approx([plain[2], plain[0]], abs=1e-4)
    assert capture.notes == ()
    formats.video(path / "rgb.mp4", [view.srgb8 for view in views[1:]])  # encoded again, without what was hidden
    notes = notes_of(path, frames=3)
    assert [("3 pictures for 4 rows" in note, "one too late" in note) for note in notes] == [(True, True)]


def test_polycam_without_loops_and_in_its_other_layout(tmp_path: Path) -> None:
    for name, corrected in (("a", False), ("b", True)):
        path = formats.polycam(tmp_path / name, VIEWS)
        if not corrected:  # the uncorrected cameras belong to the uncorrected images
            for kind in ("images", "cameras"):
                shutil.rmtree(path / f"keyframes/corrected_{kind}")
            assert first_of(path).camera_to_world[0, 3] == 99.0
        for folder in (path / "keyframes").iterdir():
            folder.rename(path / folder.name)
        (path / "keyframes").rmdir()
        assert open_capture(path).format == "polycam"
        assert (first_of(path).camera_to_world[0, 3] == 99.0) != corrected
    np.testing.assert_allclose(first_of(path).camera_to_world, VIEWS[0].pose, atol=1e-9)


def test_polycams_corrected_poses_are_those_of_its_images(tmp_path: Path) -> None:
    """As version 6 exports: `corrected_cameras` without `corrected_images`; a frame may lack its corrected pose."""
    path = formats.polycam(tmp_path / "capture", VIEWS)
    shutil.rmtree(path / "keyframes/corrected_images")
    for camera in (path / "keyframes/corrected_cameras").iterdir():
        edit(camera, lambda stated: stated.update(fx=1, width=1))  # of the undistorted picture
    frames = list(capture := open_capture(path))
    same_views(frames, VIEWS)
    assert {frame.intrinsics.fx for frame in frames} == {formats.FX}
    np.testing.assert_allclose(frames[0].image, srgb8_to_linear(255 - VIEWS[0].srgb8), atol=0.1)
    assert capture.notes == ()
    (path / "keyframes/corrected_cameras/5000000.json").unlink()
    one_skipped(path, 0, "corrected_cameras/5000000.json", "No such file")


def test_a_folder_of_polycam_with_litter_alone_is_not_read(tmp_path: Path) -> None:
    path = formats.polycam(tmp_path / "capture", VIEWS)
    for kind, litter in (("images", ".DS_Store"), ("images", "._5000000.jpg"), ("cameras", ".DS_Store")):
        shutil.rmtree(path / f"keyframes/corrected_{kind}", ignore_errors=True)
        formats.save(path / f"keyframes/corrected_{kind}/{litter}", b"x")
    assert [frame.camera_to_world[0, 3] for frame in open_capture(path)] == [99.0] * 4


@pytest.mark.parametrize(("levels", "high"), [((0, 54, 255), 1), ((0, 127, 255), 1), ((0, 54, 54), 0), ((0, 1, 2), 1)])
def test_medium_confidence_of_polycam_is_not_high(levels: tuple[int, int, int], high: int) -> None:
    stored = np.repeat(np.array([levels], np.uint8), 4, axis=0)
    decoded = decode_confidence(formats.image(".png", stored), "confidence")
    assert decoded[0].tolist() == [0, 1, 1 + high]


def test_several_runs_of_polycams_tracker_are_noted_where_its_raw_poses_are_read(tmp_path: Path) -> None:
    path = formats.polycam(tmp_path / "capture", VIEWS)
    for at, camera in enumerate(sorted((path / "keyframes/cameras").iterdir())):
        edit(camera, lambda stated, at=at: stated.update(tracking_segment=at // 2, t_03=0.0))
    shutil.rmtree(path / "keyframes/corrected_images")
    assert "tracking_segment" not in str(notes_of(path))
    shutil.rmtree(path / "keyframes/corrected_cameras")
    (note,) = [note for note in notes_of(path, frames=4) if "tracking_segment" in note]
    assert f"cameras/{round(VIEWS[2].time_s * 1e6)}.json: another tracking_segment" in note


def test_the_size_that_polycams_corrected_cameras_lack_is_that_of_the_raw_ones(tmp_path: Path) -> None:
    path = formats.polycam(tmp_path / "capture", VIEWS)
    for camera in (path / "keyframes/corrected_cameras").iterdir():
        edit(camera, lambda stated: (stated.pop("width"), stated.pop("height")))
    edit(path / "keyframes/cameras/5000000.json", lambda stated: stated.update(width=64, height=48))
    (path / "keyframes/cameras/5033333.json").unlink()
    first, second, *others = open_capture(path)
    assert first.intrinsics.fx == formats.FX / 2
    assert (second.intrinsics.fx, second.intrinsics.width) == (formats.FX, 32)
    assert len(others) == 2


def test_the_black_border_of_polycams_undistortion_is_not_seen(tmp_path: Path) -> None:
    views = [replace(view, srgb8=np.full((24, 32, 3), 90, np.uint8)) for view in VIEWS[:2]]
    views[0].srgb8[:, 0] = views[0].srgb8[12, 16] = 0
    path = formats.polycam(tmp_path / "capture", views)
    for picture in (path / "keyframes/corrected_images").iterdir():
        picture.with_suffix(".png").write_bytes(formats.image(".png", views[picture.stem != "5000000"].srgb8))
        picture.unlink()
    bordered, whole = capture = open_capture(path)
    assert bordered.seen is not None
    assert not bordered.seen[:, :3].any()
    assert bordered.seen[:, 3:].all()  # black inside is a black thing
    assert not bordered.depth_m[:, 0].any()
    assert whole.seen is None
    (note,) = capture.notes
    assert "black pixels at the edges" in note.left_out
    (path / "keyframes/corrected_images/5000000.png").unlink()
    (note,) = open_capture(path).notes
    assert "corrected_images: holds 1 of the 2 pictures that were taken" in note.left_out


def test_names_of_seven_scenes_in_capitals_keep_their_depth(tmp_path: Path) -> None:
    path = formats.seven_scenes(tmp_path / "capture", VIEWS)
    for file in path.glob("frame-*"):
        file.rename(file.with_suffix(file.suffix.upper()))
    same_views(open_capture(path), VIEWS, depth_atol=1e-6)
    depth = path / "frame-000000.depth.PNG"
    data = formats.image(".pgm", formats.millimetres(VIEWS[0]))
    depth.rename(depth.with_suffix(".pgm")).write_bytes(data.replace(b"P5\n", b"P5\n# 3RScan\n"))
    same_views(open_capture(path), VIEWS, depth_atol=1e-6)
    depth.with_suffix(".pgm").write_bytes(data[:-1])
    one_skipped(path, 0, "frame-000000.depth.pgm", "a map of 32 x 24 does not have")


@pytest.mark.parametrize("header", [b"P5\n6 4\n# c\n65535\n", b"P5# c\n6 # c\n4 999 "])
def test_headers_of_a_pgm(header: bytes) -> None:
    values = np.full((4, 6), 700, ">u2").tobytes()
    np.testing.assert_allclose(decode_depth_map(header + values + b"\n", "d", unit_m=None), 0.7)
    for wrong in (header + values + b"12", b"P5 6 4 255\n" + values):
        with pytest.raises(ImageError, match=r"a map of 6 x 4 does not have|depth of a PGM needs 16 bits, .* has 255"):
            decode_depth_map(wrong, "d", unit_m=None)


def test_names_of_the_scanner_app_in_capitals_keep_their_depth(tmp_path: Path) -> None:
    path = formats.scanner_app(tmp_path / "capture", VIEWS)
    for file in list(path.iterdir()):
        file.rename(file.with_name(file.name.upper()))
    capture = open_capture(path)
    assert next(iter(capture)).depth_m.shape == VIEWS[0].depth_m.shape
    assert capture.notes == ()


@pytest.mark.parametrize("folder", ["vga_wide", "wide"])
def test_arkitscenes_in_another_size(tmp_path: Path, folder: str) -> None:
    path = formats.arkit_scenes(tmp_path / "capture", VIEWS)
    for kind in ("", "_intrinsics"):
        (path / f"lowres_wide{kind}").rename(path / f"{folder}{kind}")
    if folder == "wide":
        (path / "lowres_depth").rename(path / "highres_depth")
        for file in list((path / "confidence").iterdir()):
            file.write_bytes(formats.image(".png", np.full((6, 8), 2, np.uint8)))
    same_views(open_capture(path, CaptureOptions(depth="file")), VIEWS)


def test_arkitscenes_without_a_pose_near_in_time(tmp_path: Path) -> None:
    path = formats.arkit_scenes(tmp_path / "capture", VIEWS)
    lines = (path / "lowres_wide.traj").read_text().splitlines()
    (path / "lowres_wide.traj").write_text("\n".join([lines[0], *lines[3:]]))
    capture = open_capture(path)
    assert [frame.index for frame in capture] == [0, 3] or len(capture.skipped) == 0
    (path / "lowres_wide.traj").write_text(lines[0])
    capture = open_capture(path)
    assert [frame.index for frame in capture] == [0, 1]
    assert "the pose nearest in time is 0.067 s away" in capture.skipped[0].reason


def test_poses_of_arkitscenes_are_interpolated(tmp_path: Path) -> None:
    """The trajectory has 10 poses a second, the images of the raw data 60: here each second pose is left out."""
    path = formats.arkit_scenes(tmp_path / "capture", VIEWS[:3])
    lines = (path / "lowres_wide.traj").read_text().splitlines()
    (path / "lowres_wide.traj").write_text("\n".join(lines[::2]))
    first, between, last = (frame.camera_to_world for frame in open_capture(path))
    turns = [cv2.Rodrigues(a[:3, :3].T @ b[:3, :3])[0] for a, b in ((first, between), (between, last))]
    np.testing.assert_allclose(turns[0], turns[1], atol=1e-4)
    assert np.linalg.norm(turns[0]) > 0.01
    np.testing.assert_allclose(between[:3, 3], (first[:3, 3] + last[:3, 3]) / 2, atol=1e-4)


def test_a_truncated_sens_keeps_its_whole_frames(tmp_path: Path) -> None:
    path = formats.scannet(tmp_path / "capture", VIEWS)
    path.write_bytes(path.read_bytes()[:-100])
    capture = open_capture(path)
    assert len(list(capture)) == 3
    assert "3 of them are whole" in capture.notes[0].effect
    lost = bytearray(formats.scannet(tmp_path / "lost", VIEWS).read_bytes())
    at = lost.index(np.asarray((formats.Y_UP_TO_Z_UP @ VIEWS[1].pose @ formats.FLIP), "<f4").tobytes())
    lost[at : at + 64] = np.full(16, -np.inf, "<f4").tobytes()
    (tmp_path / "lost.sens").write_bytes(lost)
    one_skipped(tmp_path / "lost.sens", 1, "lost tracking")


@pytest.mark.parametrize("points", [None, "", "1.0 2.0 -1", "1.0 2.0 -1 3.5 4e0 7 8.5 9.5 -1 2.0 1.0 5"])
def test_every_image_of_a_colmap_text_is_read(tmp_path: Path, points: str | None) -> None:
    """Converters leave out the lines of points, which a model may leave empty."""
    path = formats.colmap_text(tmp_path / "capture", VIEWS)
    lines = (path / "sparse/images.txt").read_text().splitlines()
    kept = [points if line == "1.0 2.0 -1" else line for line in lines]
    (path / "sparse/images.txt").write_text("\n".join(line for line in kept if line is not None))
    same_views(open_capture(path), VIEWS)


def test_pixels_outside_the_circle_of_a_fisheye_are_not_seen(transforms: Path) -> None:
    edit(transforms / "transforms.json", lambda index: index.update(fisheye_crop_radius=10.0))
    assert first_of(transforms).seen is None  # a pinhole has no circle
    edit(transforms / "transforms.json", lambda index: index.update(camera_model="OPENCV_FISHEYE"))
    frame, camera = first_of(transforms), first_of(transforms).intrinsics
    assert frame.seen is not None
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    away = np.hypot((columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy)
    stated = np.arctan(away) * formats.FX  # pixels from the principal point, which is near the image's centre
    assert frame.seen[stated < 9].all()
    assert not frame.seen[stated > 11].any()
    assert not frame.depth_m[~frame.seen].any()


@pytest.mark.parametrize("build", [formats.polycam, formats.record3d_export, formats.scanner_app])
def test_keys_of_apps_that_bear_on_geometry_are_noted(tmp_path: Path, build: Callable) -> None:
    path, keys = build(tmp_path / "capture", VIEWS), ("k1", "depthScale", "imageOrientation", "is_bad", "lens_model")
    assert "not read" not in str(notes_of(path))
    for file in path.rglob("*.json"):
        edit(file, lambda stated: stated.update(dict.fromkeys(keys, 1), blur_score=3.0))
    (note,) = [note for note in notes_of(path, frames=4) if "not read" in note]
    assert f"the keys {', '.join(sorted(keys))}: they" in note


def test_a_colmap_model_says_what_it_does_not_know(tmp_path: Path) -> None:
    path = formats.colmap_text(tmp_path / "capture", VIEWS)
    text = (path / "sparse/cameras.txt").read_text()

    def state(model: str, parameters: str) -> None:
        (path / "sparse/cameras.txt").write_text(f"{text.replace('PINHOLE', model).rstrip()} {parameters}\n")

    state("OPENCV_FISHEYE", "0 0 0 0")
    capture = open_capture(path)
    assert next(iter(capture)).intrinsics.fx < 0.98 * formats.FX
    assert "scale and up direction" in capture.notes[0].left_out
    for model, parameters, says in (
        ("FOV", "0.9", "FOV"),
        ("EUCM", "0.5 1", "EUCM cannot be used: .* is not read; undistort"),
        ("OTHER", "1", "OTHER cannot be used: it is not read; undistort"),
    ):
        state(model, parameters)
        unreadable(path, says)


@pytest.mark.parametrize(
    ("shared", "frame", "noted"),
    [
        ({}, {}, False),
        ({"applied_transform": np.eye(4).tolist()[:3]}, {}, False),
        ({"applied_transform": [[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0]]}, {}, True),  # of Metashape
        ({"applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]]}, {}, True),
        ({"applied_transform": [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]]}, {}, True),
        ({}, {"colmap_im_id": 1}, True),
        ({}, {"sharpness": 30.0}, True),  # of instant-ngp's scripts
        ({}, {"colmap_im_id": 1, "depth_file_path": "depth/frame_00001.png"}, True),  # of COLMAP's points
        ({}, {"sharpness": 30.0, "depth_file_path": "depth/frame_00001.png"}, False),
        ({"orientation_override": "none"}, {"k4": 0.0}, True),  # of RealityCapture
        ({"orientation_override": "none"}, {}, False),
    ],
)
def test_the_scale_of_photogrammetry_is_noted_in_nerfstudios_files(
    transforms: Path, shared: dict, frame: dict, noted: bool
) -> None:
    def change(index: dict) -> None:
        index.update(shared)
        for entry in index["frames"]:
            del entry["depth_file_path"]
            entry.update(frame)

    def is_noted(**stated: float) -> bool:
        return "the scale of COLMAP" in str(open_capture(transforms, CaptureOptions(**stated)).notes)

    edit(transforms / "transforms.json", change)
    assert (is_noted(), is_noted(camera_height_m=1.5)) == (noted, False)
    formats.save(transforms / "colmap/sparse/0/cameras.bin", b"")
    assert is_noted() == (noted or "depth_file_path" not in frame)
    (transforms / "keyframes/cameras").mkdir(parents=True)  # of Polycam, whose converter writes sharpness too
    assert "the scale of" not in str(open_capture(transforms / "transforms.json").notes)


def test_nothing_of_the_sample_is_left_out() -> None:
    assert not open_capture(sample_capture()).notes
