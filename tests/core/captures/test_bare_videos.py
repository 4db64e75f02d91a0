"""Videos without poses, depth and lens: frames with all three, what was estimated is said, options that do not fit."""

import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import formats
import numpy as np
import pytest
from capture_checks import notes_of, refused, unreadable
from heic_files import box

from box_room import LENS, exact_depth, frame, pose
from depth_models import SIZE, write_depth_model
from roomlight.camera import rigid_inverse
from roomlight.captures import CaptureOptions, bare_video, open_capture
from roomlight.captures.video import VideoFrames
from roomlight.conventions import linear_to_srgb8, srgb8_to_linear
from roomlight.errors import OptionError
from roomlight.imaging.video_writer import VideoWriter
from roomlight.monocular import motion
from written_captures import write_capture

POSES = [pose(0.02 * k, turn=0.03 * k) for k in range(6)]
FOV_DEG = float(np.degrees(2 * np.arctan(160 / LENS.fx)))


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    truth = exact_depth(POSES[2], LENS.resized(SIZE[1], SIZE[0]))
    return write_depth_model(tmp_path_factory.mktemp("model") / "metric.onnx", {"depth": truth[None]})


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    return [linear_to_srgb8(frame(k, at).image) for k, at in enumerate(POSES)]


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory, pictures: list[np.ndarray]) -> Path:
    return written(tmp_path_factory.mktemp("video") / "walk.mp4", pictures)


def written(path: Path, pictures: list[np.ndarray], rate: float = 5.0) -> Path:
    with VideoWriter(path, frames_per_second=rate) as writer:
        for picture in pictures:
            writer.write(picture)
    return path


def test_a_video_alone_has_poses_depth_and_a_lens(video: Path, model: Path) -> None:
    capture = open_capture(video, CaptureOptions(depth_model=model, fov_deg=FOV_DEG))
    assert capture.format == "video"
    steps: list[tuple[str, int, int]] = []
    capture.prepare(lambda *step: steps.append(step))
    assert steps[0] == ("estimating camera poses", 0, 6)
    assert steps[-1] == ("estimating camera poses", 6, 6)
    frames = list(capture)
    assert [read.index for read in frames] == list(range(6))
    assert [read.timestamp_s for read in frames] == pytest.approx([0.2 * k for k in range(6)])
    for read, at in zip(frames, POSES, strict=True):
        assert read.depth_m.any()
        assert read.intrinsics.fx == pytest.approx(LENS.fx, rel=0.02)
        true = rigid_inverse(POSES[0].astype(np.float64)) @ at
        own = rigid_inverse(frames[0].camera_to_world) @ read.camera_to_world
        np.testing.assert_allclose(own[:3, :3], true[:3, :3], atol=0.01)
        np.testing.assert_allclose(own[:3, 3], true[:3, 3], atol=0.04)
    said = " ".join(str(note) for note in capture.notes)
    assert "its camera poses are estimated" in said
    assert "its depth is estimated" in said
    assert "by a factor of two where the camera only turns" in said
    assert not [told for told in ("focal length", "fit the others badly") if told in said]


@pytest.mark.slow
def test_the_first_frame_has_its_scale_from_those_after_it(tmp_path: Path) -> None:
    walk = [pose(0.1 * k) for k in range(8)]
    path = write_capture(tmp_path / "walk", [frame(k, at, depth=True) for k, at in enumerate(walk)])
    far = 1.5 * exact_depth(walk[0], LENS.resized(SIZE[1], SIZE[0]))
    wrong = write_depth_model(tmp_path / "metric.onnx", {"depth": far[None]})
    first = next(iter(open_capture(path, CaptureOptions(depth="network", depth_model=wrong))))
    assert first.depth_estimated
    known = first.depth_m > 0
    assert float(np.median((first.depth_m / exact_depth(walk[0]))[known])) == pytest.approx(1, abs=0.1)


@pytest.mark.slow
def test_up_can_be_stated(video: Path, model: Path) -> None:
    capture = open_capture(video, CaptureOptions(depth_model=model, world_up=(0.0, 1.0, 0.2)))
    first = next(iter(capture))
    np.testing.assert_allclose(first.camera_to_world[1, :3], np.array([0, 1, 0.2]) / np.hypot(1, 0.2), atol=1e-9)
    assert not [note for note in capture.notes if "which way is up" in note.left_out]


def test_a_dark_video_is_refused_with_the_reason(tmp_path: Path, model: Path) -> None:
    path = written(tmp_path / "dark.mp4", [np.zeros((64, 96, 3), np.uint8)] * 3)
    unreadable(
        path,
        r"none of its 3 frames can be used.*at 0\.0 s.*too dark to see the room",
        CaptureOptions(depth_model=model),
    )


@pytest.mark.slow
def test_a_cut_loses_frames_and_says_so(tmp_path: Path, model: Path, pictures: list[np.ndarray]) -> None:
    path = written(tmp_path / "cut.mp4", [*pictures, *(picture[:, ::-1].copy() for picture in pictures[:3])])
    capture = open_capture(path, CaptureOptions(depth_model=model))
    frames = list(capture)
    assert len(frames) == 6
    assert [skipped.index for skipped in capture.skipped] == [6, 7, 8]
    assert "a cut" in capture.skipped[0].reason
    assert "at 1.2 s" in capture.skipped[0].file
    assert [note for note in capture.notes if "6 of 9 frames, from 0.0 to 1.0 s" in note.left_out]
    (note,) = [note for note in capture.notes if "focal length is not stated" in note.left_out]
    fov_deg = np.degrees(2 * np.arctan(160 / frames[0].intrinsics.fx))
    assert f"{fov_deg:.0f} degrees" in note.effect
    assert "--fov" in note.advice
    assert "hardly a phone's" not in note.effect


@pytest.mark.slow
def test_misfits_a_lens_that_hardly_a_phone_has_and_a_panorama_s_shape_are_pointed_out(
    tmp_path: Path, model: Path, pictures: list[np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(motion, "MISFIT_PX", 1e-6)
    monkeypatch.setattr(bare_video, "USUAL_FOV_DEG", (20.0, 30.0))
    wide = written(tmp_path / "wide.mp4", [picture[:160] for picture in pictures])
    notes = str(notes_of(wide, CaptureOptions(depth_model=model)))
    assert "5 of 6 pictures, from 0.2 to 1.0 s, fit the others badly: their turns may be off" in notes
    assert "fits the pictures best, which is hardly a phone's" in notes
    assert "twice as wide as high" in notes


def test_the_field_of_view_of_a_single_picture_is_said_to_be_assumed(
    tmp_path: Path, model: Path, pictures: list[np.ndarray]
) -> None:
    path = written(tmp_path / "still.mp4", pictures[:1])
    said = " ".join(notes_of(path, CaptureOptions(depth_model=model), frames=1))
    assert "a horizontal field of view of 64 degrees is assumed, as of phones' main cameras" in said


def test_frames_before_a_cut_without_encoding_are_not_counted(tmp_path: Path) -> None:
    """As `ffmpeg -ss -c copy` leaves it: packets before the cut are there to decode others, marked by an edit list."""
    pictures = [np.full((64, 96, 3), 20 * k, np.uint8) for k in range(10)]
    whole = written(tmp_path / "whole.mp4", pictures)
    cut = formats.remuxed(whole, tmp_path / "cut.mp4", lambda _: None, later_s=0.8)
    with VideoFrames(cut, "cut") as frames:
        assert frames.times_s == pytest.approx([0.2 * k for k in range(6)])
        levels = [linear_to_srgb8(frames.frame(k).image).mean() for k in range(6)]
    assert levels == pytest.approx([20 * k for k in range(4, 10)], abs=3)


def test_pictures_of_another_aspect_than_the_first_are_skipped(
    tmp_path: Path, model: Path, pictures: list[np.ndarray]
) -> None:
    """A browser's recorder goes on with the other size when the phone is turned."""
    path = tmp_path / "turned.webm"
    turned = [np.ascontiguousarray(np.rot90(picture)) for picture in pictures[:1]]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libvpx", rate=5, options={"cpu-used": "8", "deadline": "realtime"})
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        for size, part, start in (((320, 240), pictures[:2], 0), ((240, 320), turned, 2)):
            encoder = av.CodecContext.create("libvpx", "w")
            encoder.width, encoder.height, encoder.pix_fmt = *size, "yuv420p"
            encoder.time_base, encoder.options = Fraction(1, 5), {"cpu-used": "8", "deadline": "realtime"}
            for number, rgb in enumerate(part):
                picture = av.VideoFrame.from_ndarray(rgb, format="rgb24").reformat(format="yuv420p")
                picture.pts, picture.time_base = start + number, Fraction(1, 5)
                packets = encoder.encode(picture) + (encoder.encode(None) if number == len(part) - 1 else [])
                for packet in packets:
                    packet.stream, packet.time_base = stream, Fraction(1, 5)
                    container.mux(packet)
    capture = open_capture(path, CaptureOptions(depth_model=model, fov_deg=FOV_DEG))
    assert {frame.image.shape for frame in capture} == {(240, 320, 3)}
    assert [skipped.index for skipped in capture.skipped] == [2]
    assert "its aspect is 0.75, the first picture's 1.33" in capture.skipped[0].reason


def test_a_camera_whose_lens_bends_lines_is_pointed_out(tmp_path: Path) -> None:
    path = formats.video(tmp_path / "GX010001.MP4", [formats.scene(1)[0].srgb8])
    assert open_capture(path).notes == ()
    named = formats.remuxed(
        path, tmp_path / "named.mp4", lambda stream: stream.metadata.update(handler_name="\tGoPro AVC  ")
    )
    assert any("GoPro AVC, whose lens bends" in note.left_out for note in open_capture(named).notes)


def with_box(data: bytes, path: str, added: bytes) -> bytes:
    """Append a box to the one at a path of kinds; the video's data lies before them, and stays where it is."""
    kind, _, rest = path.partition("/")
    at = 8 if data[4:8] == b"\0\0\0\1" else 0  # stsd's version and number of entries
    while data[at + 4 : at + 8] != kind.encode():
        at += int.from_bytes(data[at : at + 4])
    end = at + int.from_bytes(data[at : at + 4])
    inner = with_box(data[at + 8 : end], rest, added) if rest else data[at + 8 : end] + added
    return data[:at] + box(kind.encode(), inner) + data[end:]


FULL = bytes(4)  # version and flags
EQUIRECTANGULAR = box(b"proj", box(b"prhd", bytes(16)) + box(b"equi", bytes(20)))
SPHERE_V2 = box(b"sv3d", box(b"svhd", FULL + b"a camera\0") + EQUIRECTANGULAR)
SPHERE_V1 = box(
    b"uuid",
    bytes.fromhex("ffcc8263f8554a938814587a02521fdd")
    + b'<rdf:SphericalVideo xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:GSpherical='
    b'"http://ns.google.com/videos/1.0/spherical/"><GSpherical:Spherical>true</GSpherical:Spherical>'
    b"<GSpherical:Stitched>true</GSpherical:Stitched><GSpherical:StitchingSoftware>-</GSpherical:StitchingSoftware>"
    b"<GSpherical:ProjectionType>equirectangular</GSpherical:ProjectionType></rdf:SphericalVideo>",
)


@pytest.mark.parametrize(
    ("path", "added", "says"),
    [
        ("moov/trak/mdia/minf/stbl/stsd/avc1", SPHERE_V2, "is a 360-degree video"),
        ("moov/trak", SPHERE_V1, "is a 360-degree video"),
        ("moov/trak/mdia/minf/stbl/stsd/avc1", box(b"st3d", FULL + b"\2"), "shows two cameras' pictures side by side"),
        ("moov/trak/mdia/minf/stbl/stsd/avc1", box(b"st3d", FULL + b"\1"), "shows two cameras' pictures one above"),
    ],
    ids=["V2", "V1", "side by side", "one above the other"],
)
def test_what_the_metadata_calls_no_pinhole_is_refused(tmp_path: Path, path: str, added: bytes, says: str) -> None:
    video = formats.video(tmp_path / "walk.mp4", [view.srgb8 for view in formats.scene(2)])
    data = video.read_bytes()
    video.write_bytes(with_box(data, path, added))
    unreadable(video, rf"walk\.mp4: {says}")
    video.write_bytes(with_box(data, "moov/trak/mdia/minf/stbl/stsd/avc1", box(b"st3d", FULL + b"\0")))
    with VideoFrames(video, "walk") as frames:  # of one camera
        assert frames.frame(0).image.shape == (24, 32, 3)


def stated_matrix(data: bytes, a: int, b: int, c: int, d: int) -> bytes:
    """The video with a display matrix, by which x becomes a x + c y and y becomes b x + d y."""
    at = data.index(b"tkhd") + 44
    return data[:at] + struct.pack(">9i", a << 16, b << 16, 0, c << 16, d << 16, 0, 0, 0, 1 << 30) + data[at + 36 :]


@pytest.mark.parametrize(
    ("matrix", "shown"),
    [
        ((1, 0, 0, 1), lambda stored: stored),
        ((-1, 0, 0, 1), np.fliplr),
        ((-1, 0, 0, -1), lambda stored: stored[::-1, ::-1]),
        ((1, 0, 0, -1), np.flipud),
        ((0, 1, 1, 0), lambda stored: stored.swapaxes(0, 1)),
        ((0, 1, -1, 0), lambda stored: np.rot90(stored, -1)),  # phones held upright
        ((0, -1, -1, 0), lambda stored: np.rot90(stored, 2).swapaxes(0, 1)),
        ((0, -1, 1, 0), np.rot90),
    ],
)
def test_a_video_is_turned_and_mirrored_as_players_show_it(
    tmp_path: Path, matrix: tuple[int, int, int, int], shown: Callable[[np.ndarray], np.ndarray]
) -> None:
    path = tmp_path / "walk.mp4"
    formats.video(path, [view.srgb8 for view in formats.scene(1)])
    path.write_bytes(stated_matrix(path.read_bytes(), *matrix))
    with VideoFrames(path, "walk") as frames:
        stored = frames.frame(0)
    with VideoFrames(path, "walk", upright=True) as frames:
        np.testing.assert_array_equal(frames.frame(0).image, shown(stored.image))
    mirrored = matrix[0] * matrix[3] - matrix[1] * matrix[2] < 0
    assert ("it is shown mirrored" in str(stored.notes)) == mirrored
    assert bool(stored.notes) == (matrix != (1, 0, 0, 1))


@pytest.mark.parametrize(
    ("container", "name"), [("matroska", "walk.mp4"), ("mp4", "walk.webm"), ("mp4", "walk.mkv"), ("3gp", "walk.3gp")]
)
def test_a_video_is_told_by_its_first_bytes(tmp_path: Path, container: str, name: str) -> None:
    formats.video(tmp_path / name, [np.full((24, 32, 3), 128, np.uint8)], file={"format": container})
    assert open_capture(tmp_path / name).format == "video"
    with VideoFrames(tmp_path / name, name) as frames:
        assert frames.frame(0).image.shape == (24, 32, 3)


def test_transparent_pixels_of_a_video_are_not_seen(tmp_path: Path) -> None:
    rgba = np.dstack([formats.scene(1)[0].srgb8, np.full((24, 32), 255, np.uint8)])
    rgba[:, :8, 3] = 0
    formats.video(tmp_path / "a.mkv", [rgba], codec="ffv1", stored="bgra", file={"format": "matroska"})
    with VideoFrames(tmp_path / "a.mkv", "a") as frames:
        picture = frames.frame(0)
    assert picture.seen is not None
    np.testing.assert_array_equal(picture.seen, rgba[..., 3] > 0)
    np.testing.assert_allclose(picture.image, srgb8_to_linear(rgba[..., :3]), atol=1e-6)


def test_rows_of_two_moments_are_pointed_out(tmp_path: Path) -> None:
    interlaced = {"flags": "+ildct+ilme", "x264-params": "tff=1"}
    path = formats.video(tmp_path / "tv.mp4", [np.full((64, 96, 3), 90, np.uint8)], rate=25, options=interlaced)
    with VideoFrames(path, "tv") as frames:
        assert "interlaced" in str(frames.frame(0).notes[0])


def test_sound_alone_is_no_video(tmp_path: Path) -> None:
    path = tmp_path / "sound.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=48000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 4800), np.float32), format="fltp", layout="mono")
        sound.sample_rate = 48000
        container.mux(stream.encode(sound))
        container.mux(stream.encode())
    refused(path, r"sound\.mp4: is not a readable video \(it holds no pictures\)")


def test_five_frames_a_second_are_used(tmp_path: Path) -> None:
    path = written(tmp_path / "fast.mp4", [np.full((64, 96, 3), 9 * k, np.uint8) for k in range(24)], rate=24.0)
    capture = open_capture(path)
    assert capture.frame_count == 5
    assert capture.frames_per_second == pytest.approx(5, rel=0.1)
    assert open_capture(path, CaptureOptions(max_frames=2)).frame_count == 2


def test_a_long_video_is_read_in_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bare_video, "MOST_FRAMES", 3)
    path = written(tmp_path / "long.mp4", [np.full((64, 96, 3), 9 * k, np.uint8) for k in range(8)])
    capture = open_capture(path)
    assert capture.frame_count == 3
    assert "after 1 s" in capture.notes[0].left_out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (CaptureOptions(depth="file"), "a video without depth; depth=auto estimates it"),
        (CaptureOptions(depth_unit_m=0.001), "depth_unit_m is for stored poses and depth"),
        (CaptureOptions(camera_convention="opencv"), "camera_convention is for stored poses"),
    ],
)
def test_options_for_what_a_video_has_not_are_refused(video: Path, options: CaptureOptions, message: str) -> None:
    refused(video, message, options, error=OptionError)


def test_a_field_of_view_is_for_videos_alone(tmp_path: Path) -> None:
    whole = write_capture(tmp_path / "whole", [frame(0, POSES[0], depth=True)])
    refused(
        whole,
        "fov_deg is for videos without poses; a recording of the roomlight format",
        CaptureOptions(fov_deg=60.0),
        error=OptionError,
    )


def test_what_is_no_video_is_named(tmp_path: Path) -> None:
    (tmp_path / "walk.mov").write_bytes(b"x" * 99)
    refused(tmp_path / "walk.mov", r"walk\.mov: is not a readable video \(it is cut off.*copy or export it again")


@pytest.mark.parametrize("told_by", ["end", "comment", "hues"])
def test_record3ds_rgbd_video_is_refused(tmp_path: Path, told_by: str) -> None:
    """Its left half is depth as hues; its JSON is at the end of the file, a comment before the pictures, or lost."""
    path, stated = tmp_path / "walk.mp4", '{"rangeOfEncodedDepth": [0, 3], "intrinsicMatrix": [9]}'
    picture = np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8)
    if told_by == "hues":
        picture[:, :160] = np.where(np.arange(160)[:, None] < 80, (255, 0, 80), (0, 255, 40))
    comment, file = {"comment": stated} if told_by == "comment" else {}, {"options": {"movflags": "faststart"}}
    formats.video(path, [picture], rate=5, options={"crf": "0"}, file=file, metadata=comment)
    if told_by == "end":
        path.write_bytes(path.read_bytes() + stated.encode())
    unreadable(path, r"walk\.mp4: is Record3D's RGBD video.*export the recording as \.r3d")


def test_the_largest_stream_in_colour_is_read(tmp_path: Path) -> None:
    path = tmp_path / "walk.mkv"
    packets: list[Any] = []
    with av.open(str(path), "w") as file:
        for codec, stored, width in (("ffv1", "gray16le", 96), ("libx264", "yuv420p", 32), ("libx264", "yuv420p", 64)):
            stream: Any = file.add_stream(codec, rate=5)
            stream.width, stream.height, stream.pix_fmt = width, 48, stored
            packets += [*stream.encode(av.VideoFrame(width, 48, stored)), *stream.encode()]
        file.mux(packets)
    with VideoFrames(path, "walk.mkv") as video:
        picture = video.frame(0)
    assert picture.image.shape == (48, 64, 3)
    assert "96 x 48 gray16le, 32 x 48 yuv420p, 64 x 48" in picture.notes[0].left_out


def test_a_stated_focal_length_is_taken(tmp_path: Path) -> None:
    path = formats.video(
        tmp_path / "phone.mov",
        [np.zeros((64, 96, 3), np.uint8)],
        file={"format": "mov", "options": {"movflags": "use_metadata_tags"}},
        metadata={"com.apple.quicktime.camera.focal_length.35mm_equivalent": "26"},
    )
    with VideoFrames(path, "phone") as frames:
        assert frames.focal_35mm == 26
    lens, known = bare_video.BareVideoReader(path, CaptureOptions())._lens(1920, 1080)
    assert known
    assert np.degrees(2 * np.arctan(960 / lens.fx)) == pytest.approx(67.3, abs=0.1)
    upright, known = bare_video.BareVideoReader(path, CaptureOptions(fov_deg=40.0))._lens(1080, 1920)
    assert known
    assert np.degrees(2 * np.arctan(540 / upright.fx)) == pytest.approx(40)
