"""Pinhole projection, its inverse and its limits; rigid poses and invalid ones."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomlight.camera import Intrinsics, check_rigid, pose_from_quaternion, rigid_inverse, transform_points
from rooms import camera_at, rotation_about_y

CAMERA = Intrinsics(fx=200.0, fy=210.0, cx=81.5, cy=59.0, width=160, height=120)


def test_projecting_the_rays_gives_their_pixel_centres():
    depth = np.linspace(0.3, 7, 120 * 160).reshape(120, 160)
    xy, z = CAMERA.project(CAMERA.rays() * depth[..., None])
    columns, rows = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    assert xy == pytest.approx(np.stack([columns, rows], axis=-1), abs=1e-3)  # float32 rays
    assert z == pytest.approx(depth)


def test_rows_count_downwards_and_points_behind_the_camera_have_no_pixel():
    rays = CAMERA.rays()
    assert rays[0, 0, 0] < 0 < rays[0, -1, 0]
    assert rays[-1, 0, 1] < 0 < rays[0, 0, 1]
    assert (rays[..., 2] == -1).all()
    xy, z = CAMERA.project(np.array([[0.1, 0.1, 1.0], [0.1, 0.1, 0.0], [0.0, 0.0, -1.0]]))
    assert np.isnan(xy[:2]).all()
    assert xy[2] == pytest.approx([CAMERA.cx, CAMERA.cy])
    assert z.tolist() == [-1, 0, 1]


@given(st.integers(1, 999), st.integers(1, 999))
def test_a_resized_camera_sees_the_same_view(width, height):
    resized = CAMERA.resized(width, height)
    point = np.array([[0.2, -0.3, -2.0]])
    before, after = CAMERA.project(point)[0], resized.project(point)[0]
    assert after / [width, height] == pytest.approx(before / [160, 120])


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("fx", 0.0, "focal length fx"),
        ("fx", -200.0, "focal length fx"),
        ("fy", np.nan, "focal length fy"),
        ("fy", np.inf, "focal length fy"),
        ("cx", np.nan, "principal point cx"),
        ("cx", 321.0, "principal point cx"),
        ("cy", -121.0, "principal point cy"),
        ("width", 0, "image size|principal point"),
        ("height", -3, "image size|principal point"),
    ],
)
def test_an_impossible_lens_is_refused_by_name(field, value, message):
    with pytest.raises(ValueError, match=message) as caught:
        dataclasses.replace(CAMERA, **{field: value})
    assert str(value) in str(caught.value)


def test_text_rounding_is_repaired_to_a_rotation():
    pose = np.round(camera_at((1.0, 2.0, -3.0), 33, -12), 3)
    clean = check_rigid(pose)
    assert clean[:3, :3] @ clean[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(clean[:3, :3]) == pytest.approx(1)
    assert clean == pytest.approx(pose, abs=1e-3)


def _with(entries):
    pose = camera_at((0.5, 1.5, 0.0), 20)
    for where, value in entries.items():
        pose[where] = value
    return pose


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (_with({(0, 0): np.nan}), "NaN or infinity"),
        (_with({(1, 3): np.inf}), "NaN or infinity"),
        (_with({(3, 0): 0.5}), "last row"),
        (camera_at((1.0, 2.0, 3.0)).T, "by columns: transpose it"),
        (_with({(3, 3): 2.0}), "last row"),
        (camera_at((0, 0, 0)) @ np.diag([1.0, 1, -1, 1]), "mirror image"),
        (camera_at((0, 0, 0)) @ np.diag([2.0, 2, 2, 1]), "scales"),
        (camera_at((0, 0, 0)) @ np.diag([1.0, 1.05, 1, 1]), "scales"),
        (np.zeros((4, 4)) + np.diag([0, 0, 0, 1.0]), "scales|mirror"),
    ],
)
def test_an_invalid_pose_is_refused_with_the_reason(pose, message):
    with pytest.raises(ValueError, match=message):
        check_rigid(pose)


def test_the_inverse_undoes():
    pose = camera_at((1.0, 2.0, -3.0), 140, 25)
    assert pose @ rigid_inverse(pose) == pytest.approx(np.eye(4), abs=1e-12)
    points = np.random.default_rng(0).normal(size=(5, 7, 3))
    assert transform_points(rigid_inverse(pose), transform_points(pose, points)) == pytest.approx(points)


@given(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1), st.floats(0.5, 4))
def test_a_quaternion_of_any_length_or_sign_is_the_same_rotation(quaternion, length):
    q, translation = np.array(quaternion), np.array([1.0, 2.0, 3.0])
    pose = pose_from_quaternion(q, translation)
    assert check_rigid(pose) == pytest.approx(pose, abs=1e-9)
    assert pose_from_quaternion(-length * q, translation) == pytest.approx(pose, abs=1e-9)
    assert pose[:3, 3].tolist() == [1, 2, 3]
    for lost in ((0.0, 0, 0, 0), (np.nan, 0, 0, 1), (np.inf, 0, 0, 1)):
        with pytest.raises(ValueError, match="quaternion"):
            pose_from_quaternion(np.array(lost), translation)


@given(st.floats(-3.1, 3.1))
def test_a_quaternion_about_y_turns_as_the_matrix_does(angle):
    q = np.array([0, np.sin(angle / 2), 0, np.cos(angle / 2)])
    assert pose_from_quaternion(q, np.zeros(3))[:3, :3] == pytest.approx(rotation_about_y(angle), abs=1e-9)


def test_intrinsics_are_plain_numbers_so_that_rays_stay_float32():
    camera = Intrinsics(np.float64(200.0), np.float64(210.0), np.float64(81.5), np.float64(59.0), 160, 120)
    assert all(type(getattr(camera, name)) is float for name in ("fx", "fy", "cx", "cy"))
    assert camera.rays().dtype == np.float32
    assert (camera.rays() == CAMERA.rays()).all()
