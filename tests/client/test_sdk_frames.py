"""Frames as messages: bit-exact where promised, and malformed frames are never sent."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from roomlight.conventions import linear_to_srgb8
from roomlight.engine.preparation import WORKING_SIZE
from roomlight.errors import FrameError, WireError
from roomlight.frame import Frame
from roomlight.wire.decoding import decode_frame
from roomlight.wire.frame_encoding import EXACT_SIZE, CameraFrame, pack_camera_frame, pack_frame
from roomlight.wire.frame_message import parse
from rooms import BoxRoom, camera_at

POSE = camera_at((0.2, 1.4, 1.2), yaw_degrees=31.0)


@pytest.fixture(scope="module")
def frame() -> Frame:
    return replace(BoxRoom().frame(POSE, width=640, height=480), timestamp_s=1.25)


def same(one: Frame, other: Frame) -> bool:
    return (
        (one.image == other.image).all()
        and (one.clipped == other.clipped).all()
        and (one.depth_m == other.depth_m).all()
        and (one.camera_to_world == other.camera_to_world).all()
        and one.intrinsics == other.intrinsics
        and one.timestamp_s == other.timestamp_s
    )


def decoded(body: bytes, **options) -> Frame:
    return decode_frame(parse(body), 0, **options)


def test_an_exact_frame_equals_the_engines_resized_frame(frame):
    assert EXACT_SIZE == WORKING_SIZE
    arrived = decoded(pack_frame(frame))
    assert same(arrived.resized(*WORKING_SIZE), frame.resized(*WORKING_SIZE))


@settings(max_examples=25, deadline=None)
@given(st.integers(8, 700), st.integers(8, 700), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_exact_frames_of_any_size_and_depth_arrive_unchanged(width, height, divisor, seed):
    random = np.random.default_rng(seed)
    room = BoxRoom().frame(POSE, width=16, height=12)
    image = random.gamma(0.5, 2.0, (height, width, 3)).astype(np.float32)
    depth = random.uniform(-0.5, 9.0, (max(2, height // divisor), max(2, width // divisor))).astype(np.float32)
    if abs(depth.shape[1] / depth.shape[0] - width / height) > 0.02 * width / height:
        depth = random.uniform(-0.5, 9.0, (height, width)).astype(np.float32)
    frame = Frame(3, image, image[..., 0] > 2, depth, room.intrinsics.resized(width, height), POSE)
    assume(frame.depth_m.any())
    try:
        expected = frame.resized(*WORKING_SIZE)
    except FrameError:  # a strip of a few pixels, whose aspect changes by rounding: the engine refuses it, too
        with pytest.raises(FrameError):
            pack_frame(frame)
        return
    assert same(decoded(pack_frame(frame)).resized(*WORKING_SIZE), expected)


def test_depth_lost_by_resizing_is_sent_at_full_size(frame):
    sparse = replace(frame, depth_m=np.where(np.arange(640) == 0, frame.depth_m, 0).astype(np.float32))
    assert not sparse.resized(*WORKING_SIZE).depth_m.any()
    assert same(decoded(pack_frame(sparse)).resized(*WORKING_SIZE), sparse.resized(*WORKING_SIZE))
    wide = replace(frame, depth_m=np.zeros((960, 1280), np.float32))
    wide.depth_m[10::20, 12::20] = 2
    assert (decoded(pack_frame(wide, colour="jpeg")).depth_m > 0).sum() == 48 * 64


@pytest.mark.parametrize(("colour", "max_bytes"), [("jpeg", 120_000), ("png", 1_000_000)])
def test_eight_bit_frames_are_small_and_close(frame, colour, max_bytes):
    shown = replace(frame, image=np.clip(frame.image, 0, 1))
    body = pack_frame(shown, colour=colour)
    assert len(body) < max_bytes
    arrived = decoded(body)
    # half a step of 8-bit sRGB is 0.0046 at white; JPEG at quality 92 adds a few
    assert np.abs(arrived.image - shown.image).mean() < (0.002 if colour == "png" else 0.006)
    assert np.abs(arrived.depth_m - shown.depth_m).max() < 0.00051  # half a millimetre, and float32's rounding


@pytest.mark.parametrize("white", [4.0, 0.5, 0.98])
def test_a_frame_that_clips_at_another_radiance_keeps_its_range(frame, white):
    image = np.clip(frame.image * 2 * white, 0, white).astype(np.float32)
    bright = replace(frame, image=image, clipped=image.max(axis=-1) >= white)
    assert 0.01 < bright.clipped.mean() < 0.9
    arrived = decoded(pack_frame(bright, colour="png"))
    assert parse(pack_frame(bright, colour="png")).header.exposure == {0.98: 1}.get(white, 1 / white)
    assert np.abs(arrived.image - bright.image).max() <= 0.005 * white
    assert (arrived.clipped >= bright.clipped).all()


def test_lights_finer_than_the_sent_pixels_keep_the_exposure(frame):
    lines = np.zeros((960, 1280), bool)
    lines[::8] = True
    image = np.where(lines[..., None], np.ones(3, np.float32), np.float32(0.2))
    fine = replace(frame, image=image, clipped=lines, intrinsics=frame.intrinsics.resized(1280, 960))
    for exposure in (1, 0.5):
        assert parse(pack_frame(replace(fine, exposure=exposure), colour="png")).header.exposure == exposure


def camera_frame(**changes) -> CameraFrame:
    shot = BoxRoom().frame(POSE, width=64, height=48)
    srgb8 = linear_to_srgb8(shot.image)
    jpeg = cv2.imencode(".jpg", np.ascontiguousarray(srgb8[..., ::-1]))[1].tobytes()
    depth = np.rint(shot.depth_m * 1000).astype(np.uint16)
    return replace(CameraFrame(jpeg, depth, shot.intrinsics, shot.camera_to_world), **changes)


def test_a_camera_frame_is_sent_unchanged():
    confidence = np.full((48, 64), 2, np.uint8)
    frame = camera_frame(timestamp_s=2.0, exposure=0.5, tracking_state="limited", confidence=confidence)
    message = parse(pack_camera_frame(frame))
    assert bytes(message.colour) == frame.colour
    assert message.header.depth is not None
    assert message.header.depth.format == "uint16_mm"
    assert (message.header.exposure, message.header.tracking_state) == (0.5, "limited")
    assert frame.depth is not None
    assert (decode_frame(message, 0).depth_m == frame.depth.astype(np.float32) * np.float32(0.001)).all()


@pytest.mark.parametrize(
    ("dtype", "depth_format"),
    [("float16", "float16_m"), ("float32", "float32_m"), ("float64", "float32_m"), (">f4", "float32_m")],
)
def test_every_depth_type_is_sent_in_its_format(dtype, depth_format):
    depth_m = BoxRoom().frame(POSE, width=64, height=48).depth_m
    message = parse(pack_camera_frame(camera_frame(depth=depth_m.astype(dtype))))
    assert message.header.depth is not None
    assert message.header.depth.format == depth_format
    assert decode_frame(message, 0).depth_m == pytest.approx(depth_m, rel=1e-3)


def test_the_colour_encoding_is_detected():
    srgb8 = np.zeros((48, 64, 3), np.uint8)
    png = cv2.imencode(".png", srgb8)[1].tobytes()
    for colour, encoding in ((srgb8, "rgb8"), (png, "png"), (b"\0\0\0\x18ftypheic", "heic")):
        assert parse(pack_camera_frame(camera_frame(colour=colour))).header.colour.encoding == encoding


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"colour": b"BM no image"}, "colour"),
        ({"colour": np.zeros((40, 64, 3), np.uint8)}, "colour"),
        ({"depth": np.zeros((48, 64), np.int32)}, "depth"),
        ({"depth": np.ones((48, 60), np.float32)}, "depth"),
        ({"confidence": np.ones((24, 32), np.uint8)}, "confidence"),
        ({"camera_to_world": np.full((4, 4), np.nan)}, "camera_to_world"),
        ({"camera_to_world": np.diag([2.0, 2.0, 2.0, 1.0])}, "camera_to_world"),
        ({"exposure": 0.0}, "exposure"),
        ({"timestamp_s": float("inf")}, "timestamp_s"),
    ],
)
def test_invalid_frames_are_refused_with_the_field(changes, field):
    with pytest.raises(WireError) as refused:
        pack_camera_frame(camera_frame(**changes))
    assert refused.value.field.startswith(field)
    assert refused.value.rule
