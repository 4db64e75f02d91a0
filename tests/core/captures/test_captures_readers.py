"""Every reader gives the same frames of the same room, in RoomLight's conventions, from that format's own bytes."""

import inspect
import sqlite3
from collections.abc import Callable
from pathlib import Path

import cv2
import formats
import numpy as np
import pytest
from builders import BUILDERS, FORMAT_OF
from capture_checks import edit, first_of, refused, unreadable
from damage import copied

from roomlight.captures import FORMATS, Capture, CaptureOptions, open_capture
from roomlight.conventions import srgb8_to_linear
from roomlight.errors import FrameError, OptionError, UnknownFormatError

VIEWS = formats.scene()
HAS_TIMES = {"nerfcapture", "stray-scanner", "record3d", "record3d-export", "tum", "roomlight", "polycam"}
HAS_TIMES |= {"3d-scanner-app", "arkitscenes", "scannet", "scannetpp", "rtabmap", "ros-bag"}
PICTURES = ("images", "lowres_wide")
HAS_CONFIDENCE = {"stray-scanner", "record3d", "roomlight", "polycam", "3d-scanner-app", "arkitscenes"}


def test_every_format_gives_the_same_cameras_and_pictures(built: tuple[str, Path]) -> None:
    name, path = built
    capture = open_capture(path)
    assert capture.format == FORMAT_OF[name]
    assert capture.format in FORMATS
    frames = list(capture)
    assert capture.skipped == []
    assert [frame.index for frame in frames] == [0, 1, 2, 3]
    assert capture.frame_count == len(VIEWS)
    for frame, view in zip(frames, VIEWS, strict=True):
        np.testing.assert_allclose(frame.camera_to_world, view.pose, atol=1e-6)
        k = frame.intrinsics
        np.testing.assert_allclose(
            [k.fx, k.fy, k.cx, k.cy], [formats.FX, formats.FY, formats.CX, formats.CY], rtol=1e-9
        )
        assert (k.width, k.height) == (formats.WIDTH, formats.HEIGHT)
        # JPEG and H.264 halve the colour's resolution and round: 8 of 255 at worst on this smooth room, 2 on the mean.
        error = np.abs(frame.image - srgb8_to_linear(view.srgb8))
        assert error.mean() < 0.01
        assert error.max() < 0.12
        known = view.confidence >= 1 if name in HAS_CONFIDENCE else np.ones_like(view.confidence, bool)
        assert not frame.depth_m[~known].any()
        # Half floats (the EXR export) keep 11 bits: 1 mm at 2 m.
        np.testing.assert_allclose(frame.depth_m[known], view.depth_m[known], rtol=5e-4, atol=6e-4)
        assert frame.source.startswith(str(path))
        if name in HAS_TIMES:
            assert frame.timestamp_s == pytest.approx(view.time_s, abs=1e-6)
    if name in HAS_TIMES:
        assert capture.frames_per_second == pytest.approx(30, rel=1e-3)
    else:
        assert capture.frames_per_second is None


def test_every_and_max_frames_select_records_by_their_own_index(built: tuple[str, Path]) -> None:
    name, path = built
    capture = open_capture(path, CaptureOptions(every=2))
    assert capture.frame_count == 2
    frames = list(capture)
    assert [frame.index for frame in frames] == [0, 2]
    np.testing.assert_allclose(frames[1].camera_to_world, VIEWS[2].pose, atol=1e-6)
    assert np.abs(frames[1].image - srgb8_to_linear(VIEWS[2].srgb8)).mean() < 0.01
    assert open_capture(path, CaptureOptions(every=3, max_frames=1)).frame_count == 1
    if name in HAS_TIMES:
        assert capture.frames_per_second == pytest.approx(15, rel=1e-3)


def test_a_capture_can_be_read_repeatedly_and_by_two_passes_at_once(built: tuple[str, Path]) -> None:
    _, path = built
    capture = open_capture(path)
    one, other = iter(capture), iter(capture)
    begun = [(next(one), next(other)) for _ in range(2)]
    whole, *passes = list(capture), [begun[0][1], begun[1][1], *other], [begun[0][0], begun[1][0], *one]
    for again in (whole, *passes):
        assert [frame.index for frame in again] == [0, 1, 2, 3]
        for frame, same in zip(whole, again, strict=True):
            np.testing.assert_array_equal(same.image, frame.image)
            np.testing.assert_array_equal(same.depth_m, frame.depth_m)
    np.testing.assert_array_equal(capture.frame_at(2).image, whole[2].image)
    with pytest.raises(FrameError, match="no frame 4; frames are 0 to 3"):
        capture.frame_at(4)


def test_forcing_another_reader_is_refused_with_a_file(built: tuple[str, Path]) -> None:
    name, path = built
    for other in set(FORMATS) - {FORMAT_OF[name]}:
        refused(path, path.stem, CaptureOptions(format=other))
    assert open_capture(path, CaptureOptions(format=FORMAT_OF[name])).frame_count == 4


def test_confidence_threshold_is_the_users(built: tuple[str, Path]) -> None:
    name, path = built
    all_kept = first_of(path, CaptureOptions(min_confidence=0)).depth_m
    only_high = first_of(path, CaptureOptions(min_confidence=2)).depth_m
    assert all_kept.all()
    expected = VIEWS[0].confidence >= 2 if name in HAS_CONFIDENCE else np.ones_like(all_kept, bool)
    np.testing.assert_array_equal(only_high > 0, expected)
    if name in HAS_CONFIDENCE:
        unreadable(path, "confidence of 3 or more", CaptureOptions(min_confidence=3))


def poses(path: Path, **options) -> list[np.ndarray]:
    return [frame.camera_to_world for frame in open_capture(path, CaptureOptions(**options))]


def test_overrides_of_conventions(tmp_path: Path) -> None:
    path = formats.roomlight(tmp_path / "capture", VIEWS)
    opencv = poses(path, camera_convention="opencv")
    inverse = poses(path, pose_direction="world-to-camera")
    z_up = poses(path, world_up="z")
    vector_up = poses(path, world_up=(0.0, 0.0, 2.0))
    for index, view in enumerate(VIEWS):
        np.testing.assert_allclose(opencv[index], view.pose @ formats.FLIP, atol=1e-9)
        np.testing.assert_allclose(inverse[index], np.linalg.inv(view.pose), atol=1e-9)
        np.testing.assert_allclose(z_up[index], np.linalg.inv(formats.Y_UP_TO_Z_UP) @ view.pose, atol=1e-9)
        np.testing.assert_allclose(vector_up[index], z_up[index], atol=1e-12)


def test_override_of_the_depth_unit(built: tuple[str, Path]) -> None:
    name, path = built
    unit_m = {"tum": 1 / 5000, "nerfcapture": 10 / 65535, "record3d": 1.0, "record3d-export": 1.0}.get(name, 0.001)
    plain, doubled = (first_of(path, CaptureOptions(depth_unit_m=u)) for u in (unit_m, 2 * unit_m))
    np.testing.assert_allclose(doubled.depth_m, 2 * plain.depth_m, rtol=1e-6)
    for factor in (1e-5, 1e4):
        if 1e-9 <= unit_m * factor <= 1e3:
            unreadable(path, r"depth unit looks wrong.*depth_unit_m", CaptureOptions(depth_unit_m=unit_m * factor))


@pytest.mark.parametrize(
    "options",
    [
        {"world_up": "up"},
        {"world_up": (0.0, 0.0, 0.0)},
        {"world_up": (0.0, float("nan"), 1.0)},
        {"world_up": (0.0, 1e300, 1.0)},
        {"depth_unit_m": 0.0},
        {"depth_unit_m": float("nan")},
        {"every": 0},
        {"max_frames": 0},
    ],
)
def test_options_out_of_range_are_refused(options: dict) -> None:
    (name,) = options
    with pytest.raises(OptionError, match=rf"^{name} is .*must be"):
        CaptureOptions(**options)


def test_unknown_format_names_and_paths(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("nothing")
    for path in (tmp_path, tmp_path / "notes.txt"):
        refused(path, str(path), error=UnknownFormatError)
    refused(
        tmp_path,
        r"format is 'betamax'; it must be one of roomlight, ",
        CaptureOptions(format="betamax"),
        error=OptionError,
    )
    with pytest.raises(OptionError, match="options is of the type str; it must be CaptureOptions"):
        inspect.unwrap(open_capture)(tmp_path, "tum")
    for name, message in (("missing", "no such file"), ("x" * 5000, "cannot be opened")):
        refused(tmp_path / name, message)
    images = tmp_path / "images"
    for names, listed in (
        (("photo.jpg", "depth.png"), r"holds depth\.png, photo\.jpg without focal .*transforms\.json"),
        (("0.exr", "1.exr", "2.exr"), r"holds 0\.exr, 1\.exr, 2\.exr and 2 more without"),
    ):
        for name in names:
            formats.save(images / name, b"")
        refused(images, listed, error=UnknownFormatError)


@pytest.mark.parametrize("name", BUILDERS)
def test_frames_are_decoded_one_at_a_time(name: str, whole: Callable[[str], Path], tmp_path: Path) -> None:
    path = copied(whole(name), tmp_path)
    if path.suffix == ".sens":  # the last frame's depth does not unpack
        path.write_bytes(path.read_bytes()[:-20] + bytes(20))
    elif (stored := path / "capture.db3").exists():  # the last depth image lacks its end
        with sqlite3.connect(stored) as base:
            last = "(SELECT max(id) FROM messages)"
            base.execute(f"UPDATE messages SET data = substr(data, 1, 900) WHERE id = {last}")
        base.close()
    elif path.is_file():  # an archive: cut the last member's picture short instead
        formats.zipped(path, formats.record3d_members(VIEWS) | {"rgbd/3.jpg": b"no picture"})
    else:
        pictures = [file for file in path.rglob("*.*") if file.suffix in (".png", ".exr")]
        sorted(file for file in pictures if "depth" in str(file.relative_to(path)))[-1].unlink()
    capture = open_capture(path)
    frames = iter(capture)
    for index in range(3):
        assert next(frames).index == index
        assert capture.skipped == []
    assert list(frames) == []
    assert [skipped.index for skipped in capture.skipped] == [3]
    assert str(path) in capture.skipped[0].file
    assert str(path) in capture.skipped[0].reason


def test_images_are_never_read_when_opening(whole: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch) -> None:
    paths = [whole(name) for name in BUILDERS]
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("an image was decoded on opening"))
    assert all(isinstance(open_capture(path), Capture) for path in paths)


# What only one format has


def test_probes_come_in_our_world(tmp_path: Path) -> None:
    (probe,) = open_capture(formats.nerfstudio(tmp_path / "a", VIEWS)).probes
    np.testing.assert_allclose(probe.position, (0.1, 0.2, 0.3), atol=1e-12)  # z-up (0.1, -0.3, 0.2)
    assert probe.panorama().shape == (4, 8, 3)
    (native,) = open_capture(formats.roomlight(tmp_path / "b", VIEWS)).probes
    assert native.position == (0.1, 0.2, 0.3)


def test_transforms_world_up_key_and_unit(transforms: Path) -> None:
    def change(index: dict) -> None:
        index["world_up"], index["depth_unit_scale_factor"] = "y", 0.002
        for frame, view in zip(index["frames"], VIEWS, strict=True):
            frame["transform_matrix"] = view.pose.tolist()[:3]
        index["frames"][1]["transform_matrix"] = VIEWS[1].pose.ravel().tolist()

    edit(transforms / "transforms.json", change)
    frame, second, *_ = open_capture(transforms / "transforms.json")
    np.testing.assert_allclose(frame.camera_to_world, VIEWS[0].pose, atol=1e-12)
    np.testing.assert_allclose(second.camera_to_world, VIEWS[1].pose, atol=1e-12)
    np.testing.assert_allclose(frame.depth_m, 2 * VIEWS[0].depth_m, rtol=1e-5)


@pytest.mark.parametrize(
    ("turned", "level", "model"),
    [
        ([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]], True, ""),  # nerfstudio's since 2024
        ([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]], True, ""),  # and before
        ([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]], True, "cameras.bin"),  # until 2023
        ([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]], True, "cameras.txt"),  # z-up, of Spectacular AI
        (np.eye(4).tolist(), False, ""),
        ("none", False, ""),
    ],
)
def test_up_of_a_colmap_world_that_nerfstudio_turned(transforms: Path, turned: list, level: bool, model: str) -> None:
    matrix = np.array([*turned[:3], [0, 0, 0, 1]]) if level else np.eye(4)

    def change(index: dict) -> None:
        if model:
            formats.save(transforms / "colmap/sparse/0" / model, b"")
        else:
            index["applied_transform"] = turned
        for frame, view in zip(index["frames"], VIEWS, strict=True):
            frame["transform_matrix"] = (matrix @ formats.FLIP @ view.pose).tolist()

    edit(transforms / "transforms.json", change)
    up = first_of(transforms).camera_to_world[1, :3] @ VIEWS[0].pose[1, :3]
    assert up == pytest.approx(1.0) if level else up < 0.9


@pytest.mark.parametrize("key", ["enable_depth_loading", "aabb", "aabb_scale", "camera_angle_x"])
def test_depth_of_instant_ngp_is_not_taken_for_nerfcaptures(tmp_path: Path, key: str) -> None:
    """Its world is z-up; it has the same keys of depth, and one lens. To a NeRFCapture file its users add its keys."""
    path = formats.nerfcapture(tmp_path / "capture", VIEWS)
    edit(path / "transforms.json", lambda index: index.update({key: 1.0}))
    np.testing.assert_allclose(first_of(path).camera_to_world, VIEWS[0].pose, atol=1e-6)

    def change(index: dict) -> None:
        for frame in index["frames"]:
            index.update({name: frame.pop(name) for name in ("fl_x", "fl_y", "cx", "cy", "w", "h")})

    edit(path / "transforms.json", change)
    frame, as_z_up = first_of(path), first_of(path, CaptureOptions(world_up="z"))
    np.testing.assert_array_equal(frame.camera_to_world, as_z_up.camera_to_world)
    np.testing.assert_allclose(frame.depth_m, VIEWS[0].depth_m, atol=1e-3)
    assert not open_capture(path).notes


def test_transforms_depth_key_chooses_among_several(transforms: Path) -> None:
    small = cv2.resize(formats.millimetres(VIEWS[0]), (16, 12), interpolation=cv2.INTER_NEAREST)
    formats.save(transforms / "lidar.png", formats.image(".png", small))
    keys = {"depth_lidar_file_path": "lidar.png"}
    edit(transforms / "transforms.json", lambda index: [frame.update(keys) for frame in index["frames"]])
    assert first_of(transforms, CaptureOptions(depth_key="depth_lidar_file_path")).depth_m.shape == (12, 16)
    refused(transforms, r"depth_radar.*depth_file_path, depth_lidar_file_path", CaptureOptions(depth_key="depth_radar"))


def test_transforms_focal_length_from_the_angle_and_npy_depth(transforms: Path) -> None:
    millimetres = formats.millimetres(VIEWS[0]).astype(np.int32)
    millimetres[0, 0] = 65535
    np.save(transforms / "depth.npy", millimetres)

    def change(index: dict) -> None:
        for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
            del index[key]
        index["camera_angle_x"] = 2 * np.arctan(0.5 * formats.WIDTH / formats.FX)
        index["frames"][0]["depth_file_path"] = "depth.npy"

    edit(transforms / "transforms.json", change)
    frame = first_of(transforms)
    assert frame.depth_m[0, 0] == 0
    k = frame.intrinsics
    assert (k.fx, k.fy, k.cx, k.cy) == pytest.approx((formats.FX, formats.FX, 16, 12))
    np.testing.assert_allclose(frame.depth_m[1:], VIEWS[0].depth_m[1:], atol=1e-6)


@pytest.mark.parametrize("model", ["OPENCV", "OPENCV_FISHEYE", "calibration.txt"])
def test_lens_distortion_is_removed(transforms: Path, tmp_path: Path, model: str) -> None:
    """A plane's depth and a linear colour ramp on it stay what they are where the straightened camera looks."""
    k1, path = -0.08, transforms
    edit(transforms / "transforms.json", lambda index: index.update(k1=k1, camera_model=model))
    if model == "calibration.txt":
        path = formats.tum(tmp_path / "tum", VIEWS)
        (path / "camera-intrinsics.txt").unlink()
        (path / model).write_text(f"{formats.FX} {formats.FY} {formats.CX - 0.5} {formats.CY - 0.5} {k1} 0 0 0\n")
    frames = list(capture := open_capture(path))
    assert len(frames) == 4
    frame, view = frames[0], VIEWS[0]
    assert f"a pinhole with fx {frame.intrinsics.fx:.6g}" in str(capture.notes[-1])
    rays = frame.intrinsics.rays()
    x, y = rays[..., 0], -rays[..., 1]
    r = np.hypot(x, y)
    bent = 1 + k1 * r**2 if model != "OPENCV_FISHEYE" else np.arctan(r) * (1 + k1 * np.arctan(r) ** 2) / r
    column = np.rint(formats.CX + formats.FX * x * bent - 0.5).astype(int)
    row = np.rint(formats.CY + formats.FY * y * bent - 0.5).astype(int)
    assert column.min() >= -1
    assert column.max() <= formats.WIDTH  # within half a pixel of the old picture: nothing is invented
    inside = (column >= 0) & (row >= 0) & (column < formats.WIDTH) & (row < formats.HEIGHT)
    there = view.depth_m[row[inside], column[inside]]
    assert np.median(np.abs(frame.depth_m[inside] - there)) < 1e-3


def test_seven_scenes_defaults(tmp_path: Path) -> None:
    """Without its two optional files: the data set's two cameras, and up = -y of an upright OpenCV camera."""
    path = tmp_path / "capture"
    grey = np.full((480, 640, 3), 90, np.uint8)
    depth = np.full((480, 640), 2000, np.uint16)
    depth[:40], depth[40:80], depth[200:280, 430:440] = 0, 65535, 1500
    formats.save(path / "frame-000000.color.png", formats.image(".png", grey))
    formats.save(path / "frame-000000.depth.png", formats.image(".png", depth))
    formats.save(path / "frame-000000.pose.txt", b"1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    (frame,) = (capture := open_capture(path))
    np.testing.assert_allclose(frame.camera_to_world[:3, 3], [0.0255, 0.0, 0.0022], atol=4e-4)
    np.testing.assert_allclose(frame.camera_to_world[:3, :3], np.eye(3), atol=0.01)
    assert "gravity-direction.txt" in str(capture.notes)
    assert "gravity" not in str(open_capture(path, CaptureOptions(world_up="-y")).notes)
    k = frame.intrinsics
    assert (k.fx, k.fy, k.cx, k.cy) == (525, 525, 320, 240)
    assert not frame.depth_m[: len(frame.depth_m) // 8].any()
    known, near = frame.depth_m > 0, (frame.depth_m > 0) & (frame.depth_m < 1.75)
    assert np.median(frame.depth_m[known]) == pytest.approx(2.0, abs=0.01)
    column = (435 - 320) / 585 * 525 - 525 * (0.0256 / 1.5 + 0.0079)  # the depth camera sees it further right
    assert np.nonzero(near)[1].mean() * 640 / known.shape[1] == pytest.approx(320 + column, abs=2)
    formats.save(path / "frame-000000.depth.png", formats.image(".png", depth[:424, :512]))
    unreadable(path, r"frame-000000\.depth\.png: the image is 512 x 424, .*write camera-intrinsics\.txt")


def test_stray_scanner_old_depth_and_new_columns(tmp_path: Path) -> None:
    path = formats.stray_scanner(tmp_path / "capture", VIEWS)
    for file in (path / "depth").glob("*.png"):
        millimetres = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        assert millimetres is not None
        np.save(file.with_suffix(".npy"), millimetres)
        file.unlink()
    lines = (path / "odometry.csv").read_text().splitlines()
    lines = [lines[0] + ", fx, fy, cx, cy"] + [f"{line}, 1200, 1210, 950, 710" for line in lines[1:]]
    (path / "odometry.csv").write_text("\n".join(lines))
    frames = list(open_capture(path, CaptureOptions(min_confidence=0)))
    np.testing.assert_allclose(frames[3].depth_m, VIEWS[3].depth_m, atol=1e-6)
    assert frames[0].intrinsics.fx == pytest.approx(20.0)
    path = formats.stray_scanner(tmp_path / "other", VIEWS)
    k = f"{formats.FX}, 0, {formats.CX}\n0, {formats.FY}, {formats.CY}\n0, 0, 1\n"  # at the video's own size
    (path / "camera_matrix.csv").write_text(k)
    assert first_of(path).intrinsics.fx == pytest.approx(formats.FX)


def test_record3d_numbers_match_poses_not_positions(tmp_path: Path) -> None:
    path = formats.record3d_export(tmp_path / "capture", VIEWS)
    for number in (0, 2):
        (path / f"rgb/{number}.jpg").unlink()
        (path / f"depth/{number}.exr").unlink()
    frames = list(open_capture(path))
    assert [frame.index for frame in frames] == [0, 1]
    np.testing.assert_allclose(frames[1].camera_to_world, VIEWS[3].pose, atol=1e-6)
    assert frames[0].timestamp_s == pytest.approx(VIEWS[1].time_s)


def test_record3d_per_frame_intrinsics_and_unpacked_folder(tmp_path: Path) -> None:
    for name, data in formats.record3d_members(VIEWS).items():
        formats.save(tmp_path / "capture" / name, data)
    lens = [[formats.FX + index, formats.FY, formats.CX, formats.CY] for index in range(4)]
    edit(tmp_path / "capture/metadata", lambda index: index.update(perFrameIntrinsicCoeffs=lens))
    frames = list(open_capture(tmp_path / "capture"))
    assert [frame.intrinsics.fx for frame in frames] == [formats.FX + index for index in range(4)]


def test_tum_takes_only_what_is_near_in_time(tmp_path: Path) -> None:
    path = formats.tum(tmp_path / "capture", VIEWS)
    lines = (path / "depth.txt").read_text().splitlines()
    time_s, name = lines[1].split()
    lines[1] = f"{float(time_s) - 0.03} {name}"
    (path / "depth.txt").write_text("\n".join(lines))
    capture = open_capture(path)
    assert [frame.index for frame in capture] == [1, 2, 3]
    assert "depth.txt" in capture.skipped[0].reason


def test_native_exposure_brings_radiance_to_the_reference(native: Path) -> None:
    edit(native / "capture.json", lambda index: index["frames"][0].update(exposure=2.0))
    frame = first_of(native)
    assert np.abs(frame.image - srgb8_to_linear(VIEWS[0].srgb8) / 2).mean() < 0.01
    assert np.abs(frame.recorded - srgb8_to_linear(VIEWS[0].srgb8)).mean() < 0.02


@pytest.mark.parametrize("kind", ["nerfstudio", "colmap", "polycam", "record3d-export", "arkitscenes", "roomlight"])
def test_resampled_pictures_get_a_resampled_camera(tmp_path: Path, kind: str) -> None:
    path = BUILDERS[kind](tmp_path / "capture", VIEWS)
    whole = first_of(path)
    pictures = [file for file in path.rglob("*.*") if file.suffix == ".jpg" or file.parent.name in PICTURES]
    for file in pictures:
        cv2.imwrite(str(file), cv2.resize(np.asarray(cv2.imread(str(file))), (formats.WIDTH // 2, formats.HEIGHT // 2)))
    capture = open_capture(path)
    frame = next(iter(capture))
    assert frame.intrinsics == whole.intrinsics.resized(formats.WIDTH // 2, formats.HEIGHT // 2)
    assert any("scaled to the picture" in note.effect for note in capture.notes)
    cropped = np.zeros((formats.HEIGHT // 2, formats.WIDTH, 3), np.uint8)
    for file in pictures:
        cv2.imwrite(str(file), cropped)
    unreadable(path, "but its intrinsics are for")
