"""`roomlight light`: one photograph with depth in, panoramas and the main light out; errors say what to do."""

import json
import re
from itertools import islice

import cv2
import numpy as np
import OpenEXR
import pytest
from PIL import ExifTags, Image

from depth_models import SIZE, write_depth_model
from roomlight import sample_capture
from roomlight.captures import open_capture
from roomlight.captures.photo import DEFAULT_FOV_DEG, PhotoOptions, read_photo
from roomlight.conventions import linear_to_srgb8
from roomlight.engine.session import SessionOptions
from roomlight.errors import FrameError, OptionError, OutputError
from roomlight.images import read_panorama
from roomlight.imaging.exif import oriented
from roomlight.imaging.video_writer import VideoWriter
from roomlight.placement import point_at_pixel
from roomlight_cli.commands import light as light_command
from roomlight_cli.photo import PhotoPoints, check_output, light_photo
from rooms import BoxRoom, camera_at

pytestmark = pytest.mark.usefixtures("small_pictures")
CLASSICAL = SessionOptions(model="classical")


@pytest.fixture
def room(tmp_path):
    """A photograph of a box room taken level from its middle, a lamp in the ceiling ahead, and its depth."""
    shot = BoxRoom(size_m=(5.0, 2.6, 4.5), lamp=((0.5, 2.6, -0.6), 0.4)).frame(
        camera_at((0.0, 1.4, 1.2)), width=64, height=48
    )
    cv2.imwrite(str(tmp_path / "photo.png"), linear_to_srgb8(np.clip(shot.image, 0, 1))[..., ::-1])
    cv2.imwrite(str(tmp_path / "depth.png"), np.rint(shot.depth_m * 1000).astype(np.uint16))
    fov = float(np.degrees(2 * np.arctan(0.5 * 64 / shot.intrinsics.fx)))
    return tmp_path, shot, fov


def frame_of(room):
    folder, _, fov = room
    return read_photo(folder / "photo.png", folder / "depth.png", PhotoOptions(fov_deg=fov)).frame


def write_jpeg(path, pixels, *, orientation=1, focal_35mm=None):
    """Write upright sRGB pixels as a phone does: stored by the sensor's rows and columns, with EXIF."""
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    if focal_35mm is not None:
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = focal_35mm
    Image.fromarray(stored(pixels, orientation)).save(path, quality=95, exif=exif)


def stored(pixels, orientation):
    """Undo EXIF's orientation, by Pillow's own operations."""
    undo = {
        1: None, 2: Image.Transpose.FLIP_LEFT_RIGHT, 3: Image.Transpose.ROTATE_180,
        4: Image.Transpose.FLIP_TOP_BOTTOM, 5: Image.Transpose.TRANSPOSE, 6: Image.Transpose.ROTATE_90,
        7: Image.Transpose.TRANSVERSE, 8: Image.Transpose.ROTATE_270,
    }[orientation]  # fmt: skip
    image = Image.fromarray(pixels)
    return np.asarray(image if undo is None else image.transpose(undo))


def test_a_photo_gives_panoramas_spheres_and_the_main_light(room, roomlight):
    folder, _, fov = room
    result = roomlight(
        "light", folder / "photo.png", "--depth", folder / "depth.png", "--fov", fov, "--probe", "0,-0.2,-1.5",
        "--probe", "0,-0.2,-50", "--out", folder / "out", "--model", "classical",
        "--form", "usdz", "--form", "glb", "--form", "json",
    )  # fmt: skip
    assert result.code == 0, result.err
    lines = result.out.splitlines()
    assert lines[0] == f"field of view {fov:.1f} degrees, horizontal: from --fov"
    assert lines[1].endswith(" % of the sphere around it seen")
    assert re.search(r"main light \d+ degrees above the horizon", lines[2])
    assert "outside the lighting volume" in result.out
    report = json.loads((folder / "out" / "light.json").read_text())
    assert report["model"] == "classical"
    assert [probe["inside_volume"] for probe in report["probes"]] == [True, False]
    for probe in report["probes"]:
        assert all((folder / "out" / name).is_file() for name in probe["files"].values())
        assert probe["files"]["usdz"].endswith(".usdz")
    assert read_panorama(folder / "out" / "probe-00.exr").shape == (120, 240, 3)
    assert (folder / "out" / "probe-01.glb").read_bytes().startswith(b"glTF")
    assert "main_light" in json.loads((folder / "out" / "probe-01.json").read_text())


def test_files_of_an_earlier_run_with_more_points_do_not_stay(room):
    frame, out = frame_of(room), room[0] / "out"
    light_photo([frame], [(0.0, -0.2, -1.5), (0.2, -0.2, -1.5)], out, options=CLASSICAL, forms=("glb",))
    (out / "probe-01-notes.txt").write_text("held")
    light_photo([frame], [(0.0, -0.2, -1.5)], out, options=CLASSICAL)
    names = {"light.json", "probe-00.exr", "probe-00.png", "probe-00-spheres.png", "probe-01-notes.txt"}
    assert {path.name for path in out.iterdir()} == names


def test_an_output_that_cannot_be_written_is_told_before_any_work(room):
    for out, message in (("photo.png", "is a file; the output needs a folder"), ("photo.png/out", "cannot be written")):
        with pytest.raises(OutputError, match=message):
            check_output(room[0] / out, overwrite=True)


def test_light_that_a_folder_holds_is_replaced_with_overwrite_alone(room, roomlight):
    out = room[0] / "out"
    (out / "other").mkdir(parents=True)
    check_output(out, overwrite=False)
    (out / "probe-00.exr").write_text("of another photo")
    refused = roomlight("light", "photo.png", "--pixel", "1,1", "--out", "out", cwd=room[0])
    assert refused.code == 1
    assert "out: holds probe-00.exr already; choose another --out, or replace it with --overwrite" in refused.err
    check_output(out, overwrite=True)


def test_the_exr_holds_the_engine_s_light_with_the_lamp_ahead_above_and_in_view(room):
    folder, frame = room[0], frame_of(room)
    (one,) = light_photo([frame], [(0.0, -0.5, -1.0)], folder / "out", options=CLASSICAL)
    written = read_panorama(folder / "out" / one.files[0])
    with OpenEXR.File(str(folder / "out" / one.files[0]), header_only=True) as file:
        assert file.header()["roomlight:use"] == "lighting"
    np.testing.assert_allclose(written, one.light.panorama, rtol=1e-3, atol=1e-4)  # half floats
    elevation, azimuth = one.heading
    assert elevation > 20
    assert abs(azimuth) < 90


def test_the_field_of_view_is_horizontal(room):
    frame, intrinsics = frame_of(room), room[1].intrinsics
    assert frame.intrinsics.fx == pytest.approx(intrinsics.fx)
    assert frame.intrinsics.cx == 32
    assert frame.camera_to_world.tolist() == np.eye(4).tolist()


@pytest.mark.parametrize(
    ("depth", "error", "message"),
    [
        (lambda shot: (shot.depth_m * 1000).astype(np.float32), FrameError, r"median depth would be .* depth_unit_m"),
        (lambda _: np.zeros((48, 64), np.uint16), FrameError, r"depth\.npy: no pixel has a depth"),
        (lambda _: np.full((48, 48), 2000, np.uint16), FrameError, "another aspect"),
    ],
    ids=["floats in millimetres", "no depth", "another shape"],
)
def test_unusable_depth_is_refused(room, depth, error, message):
    folder, shot, fov = room
    np.save(folder / "depth.npy", depth(shot))
    with pytest.raises(error, match=message):
        read_photo(folder / "photo.png", folder / "depth.npy", PhotoOptions(fov_deg=fov))


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ("photo.png --probe 1,2", 2, "a position or direction is X,Y,Z"),
        ("photo.png --probe 0,0,-1 --fov 170", 2, "150"),
        ("photo.png --pixel 1", 2, "a pixel is U,V"),
        ("photo.png --pixel 1,1 --form gif", 2, "is not one of exr, hdr, png, npy,"),
        ("photo.png", 2, "give the points to light"),
        ("photo.png --probe 0,0,99999", 1, "99999"),
        ("missing.png --probe 0,0,-1", 1, "missing.png"),
        ("photo.png --probe 0,0,-1 --weights nowhere", 1, "nowhere"),
        ("photo.png --pixel 64,5", 1, "--pixel is 64,5; the image is 64 x 48 pixels"),
    ],
)
def test_unusable_input_is_refused(room, arguments, code, message, roomlight):
    options = ("--depth", "depth.png", "--out", "out", "--world-up", "y")
    result = roomlight("light", *arguments.split(), *options, cwd=room[0])
    assert result.code == code
    assert message in result.err
    assert code == 2 or result.err.count("\n") == 1


def test_a_video_of_a_kind_that_is_not_read_is_named(tmp_path, roomlight):
    (tmp_path / "walk.avi").write_bytes(b"RIFF")
    result = roomlight("light", "walk.avi", "--probe", "0,0,-1", "--out", "out", cwd=tmp_path)
    assert result.code == 1
    assert "walk.avi: is a video of a kind that is not read; convert it to .mp4" in result.err


def test_a_pixel_is_lit_above_its_surface(room):
    frame = frame_of(room)
    expected = point_at_pixel(frame, 20.0, 40.0, above_m=0.2)
    points = PhotoPoints(((0.0, 0.0, -1.0),), ((20.0, 40.0),), above_m=0.2)
    assert points.positions(frame) == [(0.0, 0.0, -1.0), expected]


def test_an_unknown_field_of_view_and_a_point_behind_the_camera_get_warnings(room, roomlight):
    files = ("photo.png", "--depth", "depth.png", "--out", "out", "--model", "classical", "--height", "16")
    result = roomlight("light", *files, "--probe", "0,0,3", "--probe", "0,-0.2,-1.5", cwd=room[0])
    assert result.code == 0, result.err
    assert f"field of view {DEFAULT_FOV_DEG:.1f} degrees, horizontal: the default" in result.out
    assert "warning: the photo does not state its field of view; give --fov" in result.out
    behind, ahead = result.out.split("(0.00, -0.20, -1.50) m:")
    assert "warning: this point is behind the camera" in behind
    assert "this point is behind" not in ahead


def test_the_light_is_written_before_a_reader_of_the_output_can_leave(room, roomlight, monkeypatch):
    def left(_):
        raise BrokenPipeError

    monkeypatch.setattr(light_command, "say", left)
    files = ("photo.png", "--depth", "depth.png", "--out", "out", "--model", "classical", "--height", "16")
    with pytest.raises(BrokenPipeError):
        roomlight("light", *files, "--probe", "0,-0.2,-1.5", cwd=room[0])
    assert (room[0] / "out" / "light.json").exists()


# --- field of view and orientation from EXIF -------------------------------------------------------------------------


@pytest.mark.parametrize("orientation", [1, 6])
def test_the_field_of_view_comes_from_exif(room, orientation):
    folder, shot, _ = room
    upright = np.rint(linear_to_srgb8(np.clip(shot.image, 0, 1))).astype(np.uint8)
    write_jpeg(folder / "photo.jpg", upright, orientation=orientation, focal_35mm=26)
    photo = read_photo(folder / "photo.jpg", folder / "depth.png")
    assert photo.fov_source == "exif"
    assert photo.focal_35mm == 26
    # the 35 mm equivalence is by the diagonal: 80 pixels here, 43.27 mm on film
    assert photo.frame.intrinsics.fx == pytest.approx(26 * 80 / 43.2666, rel=1e-3)
    given = read_photo(folder / "photo.jpg", folder / "depth.png", PhotoOptions(fov_deg=50.0))
    assert (given.fov_deg, given.fov_source) == (50.0, "option")


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_exif_s(orientation):
    pixels = np.arange(12, dtype=np.float32).reshape(3, 4)
    assert (oriented(stored(pixels, orientation), orientation) == pixels).all()


@pytest.mark.parametrize(("stated", "other"), [("upright", "stored"), ("stored", "upright")])
def test_a_depth_orientation_that_does_not_fit_is_refused(room, stated, other):
    folder, shot, fov = room
    write_jpeg(folder / "photo.jpg", linear_to_srgb8(np.clip(shot.image, 0, 1)), orientation=6)
    np.save(folder / "depth.npy", shot.depth_m if stated == "stored" else stored(shot.depth_m, 6))
    with pytest.raises(OptionError, match=rf"depth_orientation is {stated}; .* fits the photo only as {other}"):
        read_photo(folder / "photo.jpg", folder / "depth.npy", PhotoOptions(fov_deg=fov, depth_orientation=stated))


@pytest.mark.parametrize("orientation", [5, 6, 7, 8])
@pytest.mark.parametrize("depth_is", ["upright", "stored"])
def test_depth_of_a_rotated_photo_is_fitted_by_aspect(room, orientation, depth_is):
    folder, shot, fov = room
    upright = linear_to_srgb8(np.clip(shot.image, 0, 1))
    write_jpeg(folder / "photo.jpg", upright, orientation=orientation)
    depth = shot.depth_m if depth_is == "upright" else stored(shot.depth_m, orientation)
    np.save(folder / "depth.npy", depth)
    frame = read_photo(folder / "photo.jpg", folder / "depth.npy", PhotoOptions(fov_deg=fov)).frame
    assert frame.image.shape == (48, 64, 3)
    assert (frame.depth_m == shot.depth_m).all()
    assert np.abs(frame.image - shot.image).mean() < 0.05  # JPEG, of 64 x 48 pixels


def test_an_ambiguous_orientation_needs_an_option(room):
    folder, shot, fov = room
    write_jpeg(folder / "photo.jpg", linear_to_srgb8(np.clip(shot.image, 0, 1)), orientation=3)
    np.save(folder / "depth.npy", stored(shot.depth_m, 3))
    files = (folder / "photo.jpg", folder / "depth.npy")
    with pytest.raises(OptionError, match=r"orientation is 3.* depth_orientation as upright .* or stored"):
        read_photo(*files, PhotoOptions(fov_deg=fov))
    turned = read_photo(*files, PhotoOptions(fov_deg=fov, depth_orientation="stored")).frame
    assert (turned.depth_m == shot.depth_m).all()
    kept = read_photo(*files, PhotoOptions(fov_deg=fov, depth_orientation="upright")).frame
    assert (kept.depth_m == stored(shot.depth_m, 3)).all()


@pytest.mark.slow
def test_a_video_alone_is_lit_by_all_its_frames(tmp_path, roomlight):
    frames = list(islice(open_capture(sample_capture()), 6))
    with VideoWriter(tmp_path / "walk.mp4", frames_per_second=5.0) as writer:
        writer.write(np.zeros((240, 320, 3), np.uint8))
        for one in frames:
            writer.write(linear_to_srgb8(one.image))
    depth = cv2.resize(frames[2].depth_m, SIZE[::-1], interpolation=cv2.INTER_NEAREST)
    write_depth_model(tmp_path / "m.onnx", {"depth": 1 / depth[None]})  # without a sidecar it is taken for disparity
    files = ("walk.mp4", "--depth-model", "m.onnx", "--pixel", "160,200", "--model", "classical", "--out", "out")
    result = roomlight("light", *files, cwd=tmp_path)
    assert result.code == 0, result.err
    assert "its camera poses are estimated" in result.err
    assert "its focal length is not stated" in result.err
    assert "the pixel is of walk.mp4: frame 1, at 0.2 s: the frames before it are skipped" in result.err
    report = json.loads((tmp_path / "out" / "light.json").read_text())
    assert len(report["probes"]) == 1
    assert read_panorama(tmp_path / "out" / "probe-00.exr").max() > 0
    refused = roomlight("light", *files, "--depth", "depth.png", "--overwrite", cwd=tmp_path)
    assert refused.code == 1
    assert "depth is for photographs; walk.mp4 is a video, whose depth is estimated" in refused.err
