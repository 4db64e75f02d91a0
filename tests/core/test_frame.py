"""A frame checks that its parts fit each other, and shrinks without inventing light or surfaces."""

import dataclasses

import numpy as np
import pytest
import torch

from roomlight.errors import FrameError
from roomlight.frame import Frame
from rooms import BoxRoom, camera_at, pinhole

FRAME = BoxRoom().frame(camera_at((0.2, 1.5, 0.1), 15), index=7, depth_size=(80, 60))


def _changed(**parts):
    return dataclasses.replace(FRAME, **parts)


def _unchecked(**parts):
    """Not through __init__, where the test run's check of annotations would come first."""
    frame = object.__new__(Frame)
    for field in dataclasses.fields(Frame):
        object.__setattr__(frame, field.name, parts.get(field.name, getattr(FRAME, field.name)))
    return frame


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"intrinsics": FRAME.intrinsics.resized(320, 240)}, "160 x 120 but its intrinsics are for 320 x 240"),
        ({"depth_m": FRAME.depth_m[:1, :1]}, "1 x 1 is too small"),
        ({"depth_m": FRAME.depth_m[:, :60]}, "60 x 60 has another aspect"),
        (
            {"depth_m": 1000 * FRAME.depth_m},
            r"the median depth is \d+ m, more than 100 m; is it in millimetres or centimetres\?",
        ),
        ({"camera_to_world": np.full((4, 4), np.nan)}, "NaN or infinity"),
        ({"camera_to_world": 2 * np.eye(4)}, "last row"),
        ({"camera_to_world": camera_at((0.0, 0.0, 2e4))}, r"2e\+04 m from the origin"),
    ],
)
def test_mismatched_parts_are_refused_with_the_frames_name(parts, message):
    with pytest.raises(FrameError, match=message) as caught:
        _changed(**parts)
    assert "room frame 7" in str(caught.value)
    with pytest.raises(FrameError, match=r"^frame 7: "):
        _changed(source="", **parts)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"image": np.zeros((120, 160, 3), np.uint8)}, "uint8 of shape .*srgb8_to_linear"),
        ({"image": np.zeros((120, 160, 4), np.float32)}, r"\(120, 160, 4\), not linear float RGB"),
        ({"depth_m": None}, "the depth is None, not float metres"),
        ({"image": np.zeros((120, 160), np.float32)}, r"\(120, 160\), not linear float RGB"),
        ({"depth_m": np.full((60, 80), 2000, np.uint16)}, "uint16 of shape .* not float metres"),
        ({"depth_m": np.ones((60, 80, 1), np.float32)}, r"\(60, 80, 1\), not float metres"),
        ({"clipped": np.zeros((120, 160), np.float32)}, "clipping mask is float32 of shape .*; it must be bool"),
        ({"seen": np.zeros((60, 80), bool)}, r"seen pixels is bool of shape \(60, 80\); it must"),
        ({"guessed": np.full((120, 160), np.nan, np.float32)}, "estimated luminance, .* must fit the image"),
        ({"index": 1.0}, "the index is 1.0, not a whole number"),
        ({"index": -1}, "the index is -1; frames are numbered from 0 on"),
        ({"timestamp_s": "soon"}, "timestamp_s is 'soon', not a number of seconds"),
        ({"timestamp_s": np.nan}, "timestamp_s is nan, not a number of seconds"),
        ({"image": torch.zeros(120, 160, 3)}, r"the image is of the type Tensor \(pass its \.numpy\(\)\), not linear"),
        ({"exposure": 0}, "the exposure is 0; relative to the reference it is above 0"),
        ({"clipped": None}, "clipping mask is None; it must be bool"),
        ({"guessed": [[0.0]]}, "estimated luminance, of the type list, must fit the image"),
        ({"intrinsics": None}, "intrinsics is of the type NoneType; it must be Intrinsics"),
    ],
)
def test_arrays_of_another_dtype_are_refused_by_frame(parts, message):
    with pytest.raises(FrameError, match=f"^room frame 7: .*{message}"):
        _unchecked(**parts).__post_init__()


def test_masks_of_whole_numbers_and_numpys_index_become_plain():
    mask = np.zeros((120, 160), np.uint8)
    mask[10:20] = 255  # as OpenCV's masks are
    frame = _unchecked(clipped=mask, seen=mask, index=np.int64(7))
    frame.__post_init__()
    assert type(frame.index) is int
    for found in (frame.clipped, frame.seen):
        assert found is not None
        assert found.dtype == bool
        np.testing.assert_array_equal(found, mask > 0)
    assert frame != FRAME
    assert frame in [FRAME, frame]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -0.01])
def test_invalid_radiance_is_refused_with_its_count(value):
    image = FRAME.image.copy()
    image[3, 5:7, 0] = value
    with pytest.raises(FrameError, match=r"^room frame 7: 2 of 57600 radiances"):
        _changed(image=image)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0])
def test_invalid_depth_becomes_unknown(value):
    depth = FRAME.depth_m.copy()
    depth[10:20, 30] = value
    frame = _changed(depth_m=depth)
    assert (frame.depth_m[10:20, 30] == 0).all()
    assert (frame.depth_m > 0).sum() == depth.size - 10


def test_arrays_of_other_types_become_contiguous_float32_and_valid_ones_are_not_copied():
    mirrored = np.asfortranarray(FRAME.image[..., ::-1].astype(np.float64))
    frame = _changed(image=mirrored, depth_m=FRAME.depth_m.astype(np.float16))
    for array in (frame.image, frame.depth_m):
        assert array.dtype == np.float32
        assert array.flags.c_contiguous
    assert (frame.image == FRAME.image[..., ::-1]).all()
    again = _changed(index=8)
    assert again.image is FRAME.image
    assert again.depth_m is FRAME.depth_m


def test_the_pose_is_cleaned():
    rounded = np.round(FRAME.camera_to_world, 3)
    rotation = _changed(camera_to_world=rounded).camera_to_world[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)


def test_shrinking_keeps_the_mean_energy_and_the_aspect_and_enlarges_nothing():
    small = FRAME.resized(40, 40)
    assert small.image.shape == (30, 40, 3)
    # 4 x 4 blocks divide the image evenly: area averages keep the mean up to float32 sums
    assert small.image.mean(axis=(0, 1)) == pytest.approx(FRAME.image.mean(axis=(0, 1)), rel=1e-5)
    assert (small.intrinsics.width, small.intrinsics.height) == (40, 30)
    assert np.isin(small.depth_m, FRAME.depth_m).all()
    assert FRAME.resized(100, 100).depth_m is FRAME.depth_m
    assert FRAME.resized(4000, 4000).image is FRAME.image


def test_the_box_is_swapped_for_an_upright_image():
    upright = dataclasses.replace(
        FRAME,
        image=np.ascontiguousarray(FRAME.image.transpose(1, 0, 2)),
        clipped=FRAME.clipped.T,
        depth_m=FRAME.depth_m.T,
        intrinsics=pinhole(120, 160),
    )
    assert upright.resized(40, 30).image.shape == (40, 30, 3)
    assert upright.resized(30, 40).image.shape == (40, 30, 3)


def test_a_pixel_is_clipped_when_half_of_it_was():
    clipped = FRAME.clipped.copy()
    clipped[:4, :2] = True  # half of the first 4 x 4 block
    clipped[:4, 4] = True  # a quarter of the second
    small = _changed(clipped=clipped).resized(40, 30)
    assert small.clipped[0, 0]
    assert small.clipped.sum() == 1
