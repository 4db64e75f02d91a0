"""A frame holds its parts to each other, and shrinks without inventing light or surfaces."""

import dataclasses

import numpy as np
import pytest

from roomlight.errors import FrameError
from rooms import BoxRoom, camera_at

FRAME = BoxRoom().frame(camera_at((0.2, 1.5, 0.1), 15), index=7, depth_size=(80, 60))


def _changed(**parts):
    return dataclasses.replace(FRAME, **parts)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"intrinsics": FRAME.intrinsics.resized(320, 240)}, "160 x 120 but its intrinsics are for 320 x 240"),
        ({"depth_m": FRAME.depth_m[:1, :1]}, "1 x 1 is no depth map"),
        ({"depth_m": FRAME.depth_m[:, :60]}, "60 x 60 has another aspect"),
        ({"camera_to_world": np.full((4, 4), np.nan)}, "NaN or infinity"),
        ({"camera_to_world": 2 * np.eye(4)}, "last row"),
    ],
)
def test_parts_that_do_not_fit_are_refused_by_frame(parts, message):
    with pytest.raises(FrameError, match=message) as caught:
        _changed(**parts)
    assert "room frame 7" in str(caught.value)


def test_without_a_source_the_index_names_the_frame():
    with pytest.raises(FrameError, match=r"^frame 7: "):
        _changed(source="", depth_m=FRAME.depth_m[:, :60])


def test_the_pose_is_cleaned():
    rounded = np.round(FRAME.camera_to_world, 3)
    rotation = _changed(camera_to_world=rounded).camera_to_world[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)


def test_shrinking_keeps_the_mean_energy_and_the_aspect():
    small = FRAME.resized(40, 40)
    assert small.image.shape == (30, 40, 3)
    # 4 x 4 blocks divide the image evenly: area averages keep the mean up to float32 sums
    assert small.image.mean(axis=(0, 1)) == pytest.approx(FRAME.image.mean(axis=(0, 1)), rel=1e-5)
    assert (small.intrinsics.width, small.intrinsics.height) == (40, 30)


def test_shrunk_depth_is_some_depth_that_was_measured():
    assert np.isin(FRAME.resized(40, 30).depth_m, FRAME.depth_m).all()


def test_depth_smaller_than_the_target_stays_as_it_is():
    assert FRAME.resized(100, 100).depth_m is FRAME.depth_m


def test_nothing_is_enlarged():
    assert FRAME.resized(4000, 4000).image is FRAME.image


def test_a_pixel_is_clipped_when_half_of_it_was():
    clipped = FRAME.clipped.copy()
    clipped[:4, :2] = True  # half of the first 4 x 4 block
    clipped[:4, 4] = True  # a quarter of the second
    small = _changed(clipped=clipped).resized(40, 30)
    assert small.clipped[0, 0]
    assert small.clipped.sum() == 1
