"""Whole recordings with objects, and scenes of one object on a pixel."""

from dataclasses import replace

import numpy as np
import pytest

import roomlight as rl
from roomlight.compositing.objects.primitives import sphere
from roomlight.compositing.picture.layer_files import encode_picture
from roomlight.compositing.placement.scene import SHAPE_SIZE_M, AtPixel, SceneObject
from roomlight.engine.session import SessionOptions
from roomlight.errors import CaptureError, ObjectError, OptionError, SceneError
from roomlight.images import decode_colour
from rooms import BoxRoom, camera_at

ROOM = BoxRoom(lamp=((0.3, 3.0, 0.0), 0.5), lamp_radiance=20.0)
FRAMES = [
    ROOM.frame(camera_at((0.2, 1.4, 1.4), 4.0 * index, -30), index=index, width=64, height=48) for index in range(3)
]
OPTIONS = SessionOptions(model="classical", height=16)
BALL = rl.scene_of_object("sphere", (32.0, 36.0), size_m=0.4)


def made(frames, scene=None, **more):
    return list(rl.composite_capture(frames, scene or BALL, quality="preview", options=OPTIONS, **more))


def test_every_frame_has_the_object_where_it_stands():
    pictures = made(FRAMES)
    assert [one.frame.index for one in pictures] == [0, 1, 2]
    assert all(one.alpha.max() > 0.9 for one in pictures)
    columns = [np.average(np.arange(64), weights=one.alpha.sum(axis=0)) for one in pictures]
    assert columns[0] < columns[1] < columns[2] or columns[0] > columns[1] > columns[2]  # the camera turns one way


def test_online_pictures_know_only_earlier_frames():
    first = made(FRAMES[:1], online=True)[0]
    assert (made(FRAMES, online=True)[0].image == first.image).all()


def test_no_frame_of_a_long_recording_loses_its_gain(monkeypatch):
    first = replace(FRAMES[0], auto_exposed=True)
    frames = [replace(first, index=n, image=first.image * np.float32(share)) for n, share in enumerate((1, 0.4, 1, 1))]
    gains = [picture.gain for picture in made(frames)]
    assert gains[1][1] > 2 > gains[2][1]
    monkeypatch.setattr("roomlight.engine.session.MOST_GAINS", 1)
    assert [picture.gain for picture in made(frames)] == gains


def test_a_room_that_the_camera_leaves_keeps_its_surfaces():
    turned = [ROOM.frame(camera_at((0.2, 1.4, 1.4), 60.0, -30), index=3, width=64, height=48)]
    away = np.eye(4)
    away[0, 3] = 40.0  # metres: another room
    first = replace(FRAMES[0], depth_m=FRAMES[0].depth_m.copy())
    first.depth_m[28:44, 24:40] = 0  # around the pixel, whose surface only other frames show
    other = [replace(frame, index=4 + frame.index, camera_to_world=away @ frame.camera_to_world) for frame in FRAMES]
    assert made([first, *FRAMES[1:], *turned, *other])[0].alpha.max() > 0.9


def test_recordings_that_do_not_fit_are_refused(monkeypatch):
    with pytest.raises(OptionError, match="can be read once"):
        made(iter(FRAMES))
    assert len(made(iter(FRAMES), online=True)) == 3
    with pytest.raises(CaptureError, match="no usable frame"):
        made([], online=True)
    late = [SceneObject("late", sphere(0.1), AtPixel(32.0, 36.0, frame=99))]
    pictures = rl.composite_capture(FRAMES, late, quality="preview", options=OPTIONS)
    for refused in (lambda: made(FRAMES, late, online=True), lambda: next(pictures)):
        with pytest.raises(SceneError, match=r"objects\[0\] \(late\): frame: .* no frame 99 among .* index 0 to 2"):
            refused()
    outside = [SceneObject("outside", sphere(0.1), AtPixel(300.0, 3.0))]
    monkeypatch.setattr(rl.Session, "push", lambda *_: pytest.fail("a frame was read for its light"))
    with pytest.raises(SceneError, match=r"objects\[0\] \(outside\): pixel: must lie in the image"):
        made(FRAMES, outside)


@pytest.mark.parametrize("shape", SHAPE_SIZE_M)
def test_each_shape_has_a_size(shape):
    (held,) = rl.scene_of_object(shape, (3.0, 4.0)).objects
    low, high = held.geometry.bounds()
    assert (high - low).max() == pytest.approx(SHAPE_SIZE_M[shape], rel=1e-3)


def test_a_file_keeps_its_size_and_takes_a_material(tmp_path):
    file = tmp_path / "tetra.obj"
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    (held,) = rl.scene_of_object(file, (3.0, 4.0), material="mirror").objects
    assert held.name == "tetra"
    assert held.geometry.bounds()[1].max() == 1
    assert held.geometry.parts[0][1].roughness == 0
    file.write_text("v 0 0 0\n")
    with pytest.raises(ObjectError, match="tetra"):
        rl.scene_of_object(file, (3.0, 4.0))
    with pytest.raises(SceneError, match="kind"):
        rl.scene_of_object("sphere", (3.0, 4.0), material="velvet")


def test_pictures_are_encoded_in_each_format():
    (one,) = made(FRAMES[:1], online=True)
    linear, _ = decode_colour(encode_picture(one, "exr"), "picture")
    assert np.abs(linear - one.radiance).max() < 1e-3 * one.radiance.max()
    assert encode_picture(one, "png")[:4] == b"\x89PNG"
    jpeg, _ = decode_colour(encode_picture(one, "jpeg"), "picture")
    assert np.abs(jpeg - np.clip(one.radiance, 0, 1)).mean() < 0.02
