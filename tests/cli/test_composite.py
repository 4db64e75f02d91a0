"""`roomlight composite` on a small recording: pictures, layers, a film, and every refusal."""

import dataclasses
import json
import os
import re

import av
import cv2
import numpy as np
import OpenEXR
import pytest
from gltf_files import ply

from present import present
from roomlight_cli import compositing
from roomlight_cli.progress import Progress
from rooms import BoxRoom, camera_at
from written_captures import edited_copy, write_capture

ROOM = BoxRoom(lamp=((0.3, 3.0, 0.0), 0.5), lamp_radiance=20.0)
FAST = ("--quality", "preview", "--height", "16", "--model", "classical")
TINY = ply(np.array([[0, 0, 0], [1e-5, 0, 0], [0, 1e-5, 0]]), [[0, 1, 2]], "ascii")
BALL = ("--object", "sphere", "--size", "0.4", "--pixel", "32,36")


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    poses = [camera_at((0.2, 1.4, 1.4), 4.0 * index, -30) for index in range(3)]
    frames = [ROOM.frame(pose, index=index, width=64, height=48) for index, pose in enumerate(poses)]
    return write_capture(tmp_path_factory.mktemp("captures") / "box", frames)


def picture(path):
    return present(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))


def test_pictures_and_layers_are_written(roomlight, capture, tmp_path):
    done = roomlight("composite", capture, *BALL, *FAST, "--layers", "--out", tmp_path / "out")
    assert (done.code, done.err) == (0, "")
    assert re.search(r"^object 'sphere' stands on a surface 1\.\d m away\n3 frames; pictures:", done.out, re.M)
    names = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.*")}
    layers = ("image.png", "frame.exr", "objects.exr", "alpha.png", "shadow.exr", "depth.exr", "object_id.exr")
    numbers = ("000000", "000001", "000002")
    paths = ("{0}/{0}.{2}.{1}".format(*name.split("."), number) for name in layers for number in numbers)
    assert names == {f"{number}.png" for number in numbers} | {*paths}
    assert (picture(tmp_path / "out/000001.png") == picture(tmp_path / "out/image/image.000001.png")).all()
    alpha = picture(tmp_path / "out/alpha/alpha.000000.png")
    assert alpha.dtype == np.uint16
    assert alpha.max() > 60_000


def test_headers_of_a_recording_with_times_have_timecode_and_depth_is_channel_z(roomlight, tmp_path):
    frame = ROOM.frame(camera_at((0.2, 1.4, 1.4), 0.0, -30), width=64, height=48)
    k = dataclasses.replace(frame.intrinsics, fx=frame.intrinsics.fx / 2)
    timed = [dataclasses.replace(frame, intrinsics=k, index=index, timestamp_s=0.1 * index) for index in range(4)]
    recording, out = write_capture(tmp_path / "whole", timed), tmp_path / "out"
    recording = edited_copy(recording, tmp_path / "timed", lambda index: index["frames"][3].update(exposure=0.5))
    options = ("--picture", "exr", "--layers", "--online", "--every", "3")
    assert roomlight("composite", recording, *BALL, *FAST, *options, "--out", out).code == 0
    for name in ("000003.exr", *(f"{layer}/{layer}.000003.exr" for layer in ("objects", "shadow", "depth"))):
        header = OpenEXR.File(str(out / name)).header()
        assert (header["framesPerSecond"], header["timeCode"].frame) == (10, 3)
        assert (header["roomlight:source"], header["roomlight:timestamp_s"]) == ("000003.jpg", "0.300000")
        assert (header["pixelAspectRatio"], header["roomlight:exposure"]) == (2, "0.5")
        assert header["roomlight:gain"] == "2 2 2"
        assert header["roomlight:intrinsics"] == f"{k.fx:.9g} {k.fy:.9g} {k.cx:g} {k.cy:g}"
        matrix = np.array(header["roomlight:camera_to_world"].split(), np.float64).reshape(4, 4)
        np.testing.assert_allclose(matrix, frame.camera_to_world, atol=1e-8)
    objects = OpenEXR.File(str(out / "objects/objects.000003.exr"), separate_channels=True).channels()
    alpha = picture(out / "alpha/alpha.000003.png") / 65535
    np.testing.assert_allclose(objects["A"].pixels, alpha, atol=5e-4)
    assert (objects["R"].pixels[alpha == 0] == 0).all()
    whole, frame, shadow = (
        OpenEXR.File(str(out / name)).channels()["RGB"].pixels.astype(np.float32)
        for name in ("000003.exr", "frame/frame.000003.exr", "shadow/shadow.000003.exr")
    )
    linear = frame * shadow * (1 - alpha[..., None]) + np.dstack([objects[name].pixels for name in "RGB"])
    np.testing.assert_allclose(whole, linear, rtol=2e-3, atol=1e-4)
    channels = OpenEXR.File(str(out / "depth/depth.000003.exr")).channels()
    assert list(channels) == ["Z"]
    assert channels["Z"].pixels.dtype == np.float32
    assert 1.0 < channels["Z"].pixels.max() < 3.0
    numbers = OpenEXR.File(str(out / "object_id/object_id.000003.exr")).channels()["id"].pixels
    assert (numbers == np.where(channels["Z"].pixels > 0, 0, -1)).all()


def test_the_header_of_a_frame_whose_name_is_not_utf8_has_the_rest_of_the_name(roomlight, capture, tmp_path):
    name = os.fsdecode(b"caf\xe9.jpg")
    copy = edited_copy(capture, tmp_path / "copy", lambda index: index["frames"][0].update(colour=name))
    (copy / "colour/000000.jpg").rename(copy / name)
    options = ("--picture", "exr", "--max-frames", "1", "--out", tmp_path / "out")
    done = roomlight("composite", copy, *BALL[:-1], "32,2", *FAST, *options)
    assert (done.code, done.err) == (0, "")
    assert "object 'sphere' hangs on a wall, 3.9 m away" in done.out
    assert OpenEXR.File(str(tmp_path / "out/000000.exr")).header()["roomlight:source"] == "caf?.jpg"


def test_overwrite_leaves_no_picture_of_an_earlier_run(roomlight, capture, tmp_path):
    out, command = tmp_path / "out", ("composite", capture, *BALL, *FAST, "--online", "--out", tmp_path / "out")
    assert roomlight(*command, "--layers", "--max-frames", "2").code == 0
    (out / "notes.txt").write_text("held")
    (out / "alpha" / "notes.txt").write_text("held")
    assert roomlight(*command, "--overwrite", "--picture", "jpeg", "--max-frames", "1").code == 0
    left = {str(path.relative_to(out)) for path in out.rglob("*.*")}
    assert left == {"000000.jpg", "notes.txt", "alpha/notes.txt"}
    assert {path.name for path in out.iterdir()} == {"000000.jpg", "notes.txt", "alpha"}
    own = roomlight(*command[:-1], capture / "colour", "--overwrite", "--picture", "jpeg")
    assert "holds the recording's own pictures" in own.err
    assert len(list((capture / "colour").iterdir())) == 3
    masks = capture / "masks"
    masks.mkdir()
    (masks / "000002.png").write_bytes(b"")
    assert roomlight(*command[:-1], masks, "--overwrite", "--picture", "jpeg", "--max-frames", "1").code == 0
    assert {path.name for path in masks.iterdir()} == {"000000.jpg", "000002.png"}


def test_parts_of_a_recording_are_the_pictures_of_the_whole(roomlight, capture, tmp_path):
    motion = {"unit": "frames", "keys": [{"at": 0}, {"at": 2, "offset_m": [0.3, 0, 0]}]}
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps({"objects": [{"name": "a", "shape": "sphere", "pixel": [20, 36], "motion": motion}]}))
    command = "composite", capture, "--scene", scene, *FAST, "--online", "--layers", "--picture", "exr", "--out"
    assert roomlight(*command, tmp_path / "whole").code == 0
    assert "2 frames" in roomlight(*command, tmp_path / "parts", "--last-frame", "1").out
    again = roomlight(*command, tmp_path / "parts", "--first-frame", "1")
    assert "has pictures of these frames, 000001 to 000001; give others by --first-frame" in again.err
    assert "1 frame; pictures:" in roomlight(*command, tmp_path / "parts", "--first-frame", "2").out
    assert roomlight(*command, tmp_path / "parts", "--first-frame", "1", "--last-frame", "1", "--overwrite").code == 0
    whole, parts = (
        {path.relative_to(out): path.read_bytes() for path in out.rglob("*.*")}
        for out in (tmp_path / "whole", tmp_path / "parts")
    )
    assert whole == parts
    none = roomlight(*command, tmp_path / "none", "--first-frame", "3")
    assert "the recording has no usable frame from index 3 on" in none.err


@pytest.mark.parametrize(
    ("out", "said"),
    [("out", "stopped; out keeps 3 pictures; go on with --first-frame 3"), ("a.mp4", "stopped; no film was written")],
)
def test_ctrl_c_says_what_is_kept(roomlight, capture, tmp_path, monkeypatch, out, said):
    def stop(_, __, done, total):
        if done == total:
            raise KeyboardInterrupt

    monkeypatch.setattr(Progress, "count_of", stop)
    stopped = roomlight("composite", capture, *BALL, *FAST, "--online", "--out", out, cwd=tmp_path)
    assert stopped.code == 130
    assert said in stopped.err
    assert not list(tmp_path.glob("*.mp4*"))


def test_a_film_shows_the_moving_object_and_a_tiny_one_is_told(roomlight, capture, tmp_path):
    motion = {"unit": "frames", "keys": [{"at": 0}, {"at": 2, "offset_m": [0.6, 0, 0]}]}
    ball = {"name": "ball", "shape": "sphere", "size_m": 0.4, "pixel": [20, 36], "motion": motion}
    tiny = {"name": "tiny", "file": "tiny.ply", "position": [0.2, 0.5, 0]}
    (tmp_path / "tiny.ply").write_bytes(TINY)
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps({"objects": [ball, tiny]}))
    film = tmp_path / "film.mp4"
    done = roomlight("composite", capture, "--scene", scene, *FAST, "--fps", "10", "--online", "--out", film)
    assert done.code == 0, done.err
    assert "tiny.ply: its size of 1e-05 m: its numbers are taken for metres; state size_m" in done.err
    assert done.err.endswith("warning: object 'tiny', 1e-05 m long, covers no pixel of any picture\n")
    with av.open(str(film)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.average_rate) == ("h264", 10)
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert len(frames) == 3
    assert frames[0].shape == (48, 64, 3)


def test_a_film_of_pictures_of_two_sizes_is_refused_while_the_room_is_read(roomlight, tmp_path):
    sizes = enumerate([(64, 48), (48, 64)])
    frames = [ROOM.frame(camera_at((0.2, 1.4, 1.4)), index=n, width=w, height=h) for n, (w, h) in sizes]
    done = roomlight("composite", write_capture(tmp_path / "a", frames), *BALL, *FAST, "--out", tmp_path / "a.mp4")
    assert done.code == 1
    assert "has 48 x 64 pixels and the first 64 x 48; give a folder" in done.err


@pytest.mark.slow
def test_a_film_of_odd_sides_is_told_to_lack_a_row_and_a_column(roomlight, tmp_path):
    recording = write_capture(tmp_path / "odd", [ROOM.frame(camera_at((0.2, 1.4, 1.4)), width=65, height=49)])
    done = roomlight("composite", recording, *BALL, *FAST, "--online", "--out", tmp_path / "a.mp4")
    assert done.code == 0
    assert "the film shows 64 x 48 of 65 x 49 pixels" in done.err


@pytest.mark.parametrize("place", [{"pixel": [32, 36]}, {"pixel": [32, 36], "frame": 1}])
def test_a_pixel_without_its_frame_is_noted_if_the_first_frame_is_skipped(roomlight, capture, tmp_path, place):
    recording = edited_copy(capture, tmp_path / "recording", lambda _: None)
    (recording / "depth/000000.png").write_bytes(b"")
    (tmp_path / "scene.json").write_text(json.dumps({"objects": [{"name": "a", "shape": "sphere"} | place]}))
    done = roomlight("composite", recording, "--scene", tmp_path / "scene.json", *FAST, "--out", tmp_path / "out")
    assert done.code == 0
    assert ("000001.jpg: the frames before it are skipped" in done.err) == ("frame" not in place)
    assert re.search(r"skipped \S*000000\.png: ", done.err)


def test_progress_counts_the_frames_of_each_pass(roomlight, capture, tmp_path, monkeypatch):
    shown = []
    monkeypatch.setattr(Progress, "count_of", lambda _, *state: shown.append(state))
    assert roomlight("composite", capture, *BALL, *FAST, "--out", tmp_path / "out").code == 0
    first, second = "reading the room (pass 1 of 2)", "compositing (pass 2 of 2)"
    begun = (f"{second}: places, light and first picture", 0, 3)
    assert shown == [*((first, done, 3) for done in range(4)), begun, *((second, done, 3) for done in range(1, 4))]


@pytest.mark.slow
def test_what_makes_long_work_shorter_is_told(roomlight, capture, tmp_path, monkeypatch):
    monkeypatch.setattr(compositing, "LONG_S", 0.0)
    options = ("--model", "classical", "--height", "16", "--online", "--out", tmp_path / "out")
    done = roomlight("composite", capture, *BALL, *options)
    assert done.err.count("left at the pace of one picture; --quality preview is faster") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give either --scene"),
        (("--object", "sphere"), "--object needs --pixel"),
        (("--object", "sphere", "--pixel", "3"), "a pixel is U,V"),
        (("--object", "blob", "--pixel", "3,3"), "neither a file nor one of the shapes sphere"),
        (("--object", "sphere", "--size", "-1", "--pixel", "3,3"), "Invalid value: --size is -1.0"),
        (("--object", "sphere", "--pixel", "300,3"), "must lie in the image of 64 x 48 pixels"),
        (("--scene", "missing.json"), "missing.json: cannot be read"),
        (("--scene", "missing.json", "--size", "1"), "--size: belongs to --object"),
        (("--scene", "missing.json", "--yaw", "90", "--up", "z"), "--yaw, --up: belongs to --object"),
        ((*BALL, "--layers", "--out", "film.mp4"), "a film has no layers"),
        ((*BALL, "--picture", "png", "--out", "film.mp4"), "a film has no --picture format"),
        ((*BALL, "--fps", "25", "--out", "new"), "--fps is of films"),
        ((*BALL, "--out", "film.webm"), "films are written as .mp4"),
        ((*BALL, "--out", "held.txt"), "is a file"),
        ((*BALL, "--out", "full"), "exists already"),
        ((*BALL, "--out", "made"), "has pictures 000002 to 000003; go on with --first-frame 4"),
        (
            (*BALL, "--first-frame", "3", "--last-frame", "2", "--out", "new"),
            "--last-frame 2 is before --first-frame 3",
        ),
    ],
)
def test_a_wrong_call_writes_nothing(roomlight, capture, tmp_path, arguments, message):
    (tmp_path / "held.txt").write_text("held")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "held.txt").write_text("held")
    (tmp_path / "made").mkdir()
    for number in (2, 3):
        (tmp_path / "made" / f"{number:06d}.png").touch()
    before = sorted(tmp_path.rglob("*"))
    out = () if "--out" in arguments else ("--out", "new")
    done = roomlight("composite", capture, *arguments, *FAST, *out, cwd=tmp_path)
    assert done.code != 0
    assert message in " ".join(done.err.replace("\u2502", " ").split())
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("out", "reason"),
    [
        ("held.txt/a/film.mp4", "Not a directory"),
        ("held.txt/a", "Not a directory"),
        ("new/" + "a" * 246 + ".mp4", "File name too long"),
        ("a" * 256, "File name too long"),
    ],
)
def test_what_cannot_be_written_is_told_before_the_room_is_read(roomlight, capture, tmp_path, monkeypatch, out, reason):
    monkeypatch.setattr(compositing, "open_capture", lambda *_: pytest.fail("the recording was opened"))
    (tmp_path / "held.txt").write_text("held")
    done = roomlight("composite", capture, *BALL, *FAST, "--out", tmp_path / out)
    assert done.code == 1
    assert f"({reason})" in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["held.txt"]


def test_a_scene_that_is_wrong_is_told_by_the_names_of_its_fields(roomlight, capture, tmp_path):
    scene = tmp_path / "scene.json"
    scene.write_text(
        '{"objects": [{"name": "a", "shape": "sphere", "pose": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], '
        '"yaw_degrees": 3}]}'
    )
    done = roomlight("composite", capture, "--scene", scene, "--out", tmp_path / "new")
    assert "objects[0]: yaw_degrees has no effect on a pose" in " ".join(done.err.split())
