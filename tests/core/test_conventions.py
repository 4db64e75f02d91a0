"""The code against the table of conventions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomlight.conventions import (
    direction_to_uv,
    linear_to_srgb,
    linear_to_srgb8,
    panorama_directions,
    panorama_solid_angles,
    rotation_to_y_up,
    srgb8_to_linear,
    srgb_to_linear,
    uv_to_direction,
)


def test_where_the_axes_lie():
    for direction, uv in (
        ((1, 0, 0), (0.5, 0.5)),  # "the centre column looks along +X"
        ((0, 0, 1), (0.75, 0.5)),  # "right of it comes +Z"
        ((0, 0, -1), (0.25, 0.5)),
    ):
        assert direction_to_uv(np.array(direction, np.float64)) == pytest.approx(uv, abs=1e-6)
    directions = panorama_directions(64)
    assert directions[0, :, 1].min() > 0.999  # +Y is in the top row
    assert directions[-1, :, 1].max() < -0.999


@given(st.floats(0, 0.999), st.floats(0.01, 0.99))
def test_direction_to_pixel_and_back(u, v):
    uv = np.array([u, v])
    direction = uv_to_direction(uv)
    assert np.linalg.norm(direction) == pytest.approx(1, abs=1e-12)
    back = direction_to_uv(direction)
    wrapped = abs(back[0] - u)
    assert min(wrapped, 1 - wrapped) < 1e-9
    assert back[1] == pytest.approx(v, abs=1e-9)


@pytest.mark.parametrize("height", [1, 16, 120, 121])
def test_solid_angles_cover_the_sphere(height):
    # float32 rows: 1e-6 relative
    assert panorama_solid_angles(height).sum() * 2 * height == pytest.approx(4 * np.pi, rel=1e-5)


def test_srgb_round_trip_of_every_8_bit_value():
    values = np.arange(256, dtype=np.uint8)
    assert (linear_to_srgb8(srgb8_to_linear(values)) == values).all()
    assert linear_to_srgb(np.array([-1.0, 7.0])) == pytest.approx([0.0, 1.0])  # what a camera clips


@pytest.mark.parametrize("part", [np.s_[:], np.s_[::2, 1:], np.s_[..., :2], np.s_[:0]])
def test_a_picture_decodes_by_table_to_the_same_bits(part):
    picture = np.arange(4 * 64 * 3, dtype=np.uint8).reshape(4, 64, 3)[part]
    expected = srgb_to_linear(picture.astype(np.float32) / np.float32(255))
    np.testing.assert_array_equal(srgb8_to_linear(picture), expected)


@given(st.floats(0, 1))
def test_srgb_is_its_own_inverse(value):
    encoded = linear_to_srgb(np.array([value]))
    assert srgb_to_linear(encoded)[0] == pytest.approx(value, abs=1e-6)


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1))
def test_any_up_is_turned_to_plus_y_by_a_rotation(up):
    rotation = rotation_to_y_up(np.array(up))[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-6)
    assert np.linalg.det(rotation) == pytest.approx(1, abs=1e-6)
    # within 1e-4: near upside down the shortest rotation is replaced by 180 degrees about x
    assert rotation @ (np.array(up) / np.linalg.norm(up)) == pytest.approx([0, 1, 0], abs=1e-4)


def test_z_up_worlds_become_x_z_minus_y_and_an_up_without_direction_is_refused():
    assert rotation_to_y_up(np.array([0.0, 0, 1]))[:3, :3] @ [1, 2, 3] == pytest.approx([1, 3, -2])
    for up in ((0.0, 0.0, 0.0), (np.nan, 0.0, 1.0)):
        with pytest.raises(ValueError, match="world up"):
            rotation_to_y_up(np.array(up))
