"""Walks keep their distance from surfaces, their height and their speed."""

import numpy as np
import pytest
from analytic_room import SOFA, TABLE, clearance_m, depth_m, free_space, shrunk

from roomlight.camera import check_rigid
from roomlight_generator.sequences.walk import (
    CLEARANCE_M,
    FIELD_OF_VIEW_DEGREES,
    HEIGHT_M,
    FreeSpace,
    camera_walk,
    motion,
    phone_intrinsics,
)

SIZE_M = (5.0, 2.6, 4.0)
ROOMS = (
    free_space(SIZE_M, (TABLE, SOFA)),
    free_space((3.2, 2.5, 3.0), (((-1.6, 0.0, -0.8), (-0.2, 0.5, 1.2)),)),
    free_space((7.0, 3.0, 6.0), (TABLE, ((2.0, 0.0, -3.0), (3.5, 0.9, -2.0)), ((-3.5, 0.0, 1.0), (-3.0, 2.1, 3.0)))),
)


def try_walk(free: FreeSpace, seed: int, frames: int = 31):
    rng = np.random.default_rng(seed)
    camera = phone_intrinsics(rng)
    return camera_walk(free, rng, intrinsics=camera, frames=frames), camera


def walk(free: FreeSpace, seed: int, frames: int = 31):
    poses, camera = try_walk(free, seed, frames)
    assert poses is not None
    return poses, camera


@pytest.fixture(scope="module")
def walks():
    return [(ROOMS[seed % 3], *walk(ROOMS[seed % 3], seed)) for seed in range(15)]


@pytest.fixture(scope="module")
def many_walks(walks):
    return [*walks, *((ROOMS[seed % 3], *walk(ROOMS[seed % 3], seed)) for seed in range(len(walks), 100))]


@pytest.mark.slow
@pytest.mark.statistical
def test_walks_move_as_the_papers_on_average(many_walks):
    means = [[values.mean() for values in motion(poses)] for _, poses, _ in many_walks]
    steps, turns = np.array(means).T
    # of 100 walks the mean has a deviation of its own: 0.005 m and 0.23 degrees
    assert abs(steps.mean() - 0.09) < 0.012
    assert abs(turns.mean() - 4.78) < 0.5
    assert np.percentile(steps, 5) < 0.02
    assert np.percentile(steps, 95) > 0.16
    assert np.percentile(turns, 5) < 2.5
    assert np.percentile(turns, 95) > 7.5


def test_no_surface_is_near_the_camera(walks):
    for free, poses, _ in walks:
        if free is ROOMS[0]:
            # the fan of 256 rays may miss what is just under its reach between two rays: 3 mm on a plane
            assert clearance_m(poses[:, :3, 3], np.array(SIZE_M), (TABLE, SOFA)).min() > CLEARANCE_M - 0.005


def test_the_camera_is_at_a_persons_height_over_walkable_floor(walks):
    for free, poses, _ in walks:
        assert free.walkable_at(poses[:, :3, 3]).all()
        assert poses[:, 1, 3].min() >= HEIGHT_M[0]
        assert poses[:, 1, 3].max() <= HEIGHT_M[1]


def test_cameras_are_nearly_level_and_look_about_horizontally(walks):
    poses = np.concatenate([poses for _, poses, _ in walks])
    roll = np.degrees(np.arcsin(poses[:, 1, 0]))
    pitch = np.degrees(np.arcsin(-poses[:, 1, 2]))
    assert np.abs(roll).max() < 8
    assert 0.5 < roll.std() < 3
    assert pitch.min() >= -52
    assert pitch.max() <= 37


def test_poses_are_rigid_and_follow_each_other_smoothly(walks):
    for _, poses, _ in walks:
        assert poses.shape == (31, 4, 4)
        for pose in poses:
            np.testing.assert_allclose(check_rigid(pose), pose, atol=1e-9)
        steps, turns = motion(poses)
        assert steps.max() < 0.9
        assert turns.max() < 45


def test_views_show_the_room(walks):
    for free, poses, camera in walks[:40]:
        first = depth_m(free, camera.resized(40, 30), poses[0])
        assert np.median(first) > 1.1
        for pose in poses[::10]:
            assert (depth_m(free, camera.resized(40, 30), pose) < 0.7).mean() < 0.5


def test_the_same_state_gives_the_same_walk_to_the_bit():
    first, second = walk(ROOMS[0], 7)[0], walk(ROOMS[0], 7)[0]
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, walk(ROOMS[0], 8)[0])


def test_without_walkable_floor_there_is_no_walk():
    assert try_walk(shrunk(ROOMS[0], slice(0)), 1)[0] is None


def test_clear_agrees_with_the_exact_distance():
    points = np.random.default_rng(0).uniform([-2.5, 0, -2], [2.5, 2.6, 2], (300, 3))
    exact = clearance_m(points, np.array(SIZE_M), (TABLE, SOFA))
    points, exact = points[exact > 0], exact[exact > 0]
    clear = ROOMS[0].clear(points, 0.25)
    assert clear[exact >= 0.25].all()
    assert not clear[exact < 0.24].any() or exact[clear].min() > 0.2  # at a box's edge rays pass left and right
    assert (clear == (exact >= 0.25)).mean() > 0.98


def test_motion_is_measured_between_neighbours():
    poses = np.tile(np.eye(4), (3, 1, 1))
    angle = np.radians(10)
    poses[1:, :3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    poses[2, :3, 3] = [0.3, 0, 0.4]
    steps, turns = motion(poses)
    np.testing.assert_allclose(turns, [10, 0], atol=1e-6)
    np.testing.assert_allclose(steps, [0, 0.5])


def test_phone_cameras_have_phones_fields_of_view():
    for seed in range(50):
        camera = phone_intrinsics(np.random.default_rng(seed))
        field = 2 * np.degrees(np.arctan(camera.width / 2 / camera.fx))
        assert FIELD_OF_VIEW_DEGREES[0] <= field <= FIELD_OF_VIEW_DEGREES[1]
        assert camera.fx == camera.fy
        assert (camera.width, camera.height) == (320, 240)
        assert abs(camera.cx / 320 - 0.5) < 0.0201
        assert abs(camera.cy / 240 - 0.5) < 0.0201
