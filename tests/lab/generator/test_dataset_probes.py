"""Probes are clear of surfaces, in view, in range and apart."""

import numpy as np
import pytest
from analytic_room import SOFA, TABLE, clearance_m, depth_m, free_space

from present import present
from roomlight_generator.sequences.probes import APART_M, DISTANCE_M, PROBE_CLEARANCE_M, place_probes
from roomlight_generator.sequences.walk import FreeSpace, camera_walk, phone_intrinsics

SIZE_M = (5.0, 2.6, 4.0)
ROOM = free_space(SIZE_M, (TABLE, SOFA))
FEW, MANY = 12, 60


def first_view(seed: int):
    rng = np.random.default_rng([seed, 1])
    camera = phone_intrinsics(rng)
    walk = present(camera_walk(ROOM, rng, intrinsics=camera, frames=2))
    pose = walk[0]
    return rng, camera, pose, depth_m(ROOM, camera.resized(160, 120), pose)


def place_in_views(seeds):
    views = []
    for seed in seeds:
        rng, camera, pose, depth = first_view(seed)
        points = place_probes(ROOM, rng, intrinsics=camera, camera_to_world=pose, depth_m=depth)
        if points is not None:
            views.append((camera, pose, depth, points))
    return views


@pytest.fixture(scope="module")
def placed():
    return place_in_views(range(FEW))


@pytest.fixture(scope="module")
def placed_in_many(placed):
    return [*placed, *place_in_views(range(FEW, MANY))]


def test_most_views_have_places_for_probes(placed):
    assert len(placed) >= 0.75 * FEW


def test_probes_keep_their_clearance(placed):
    for *_, points in placed:
        assert points.shape == (3, 3)
        # an edge may pass between two of 256 rays, a tenth of the clearance nearer than required
        assert clearance_m(points, np.array(SIZE_M), (TABLE, SOFA)).min() > 0.9 * PROBE_CLEARANCE_M


def test_probes_are_seen_by_the_first_camera(placed):
    for camera, pose, _, points in placed:
        xy, depth = camera.project((points - pose[:3, 3]) @ pose[:3, :3])
        assert (depth > 0).all()
        assert (xy > 0).all()
        assert (xy < [camera.width, camera.height]).all()
        away = points - pose[:3, 3]
        distance = np.linalg.norm(away, axis=1)
        eyes = np.tile(pose[:3, 3], (3, 1)).astype(np.float32)
        reach = ROOM.distances(eyes, (away / distance[:, None]).astype(np.float32))
        assert (reach > distance).all()
        assert (distance >= DISTANCE_M[0]).all()
        assert (distance <= DISTANCE_M[1]).all()


@pytest.mark.slow
@pytest.mark.statistical
def test_probes_keep_apart_and_use_the_range(placed_in_many):
    gaps, distances = [], []
    for _, pose, _, points in placed_in_many:
        gaps.append(min(np.linalg.norm(points[i] - points[j]) for i, j in ((0, 1), (0, 2), (1, 2))))
        distances += list(np.linalg.norm(points - pose[:3, 3], axis=1))
    assert np.mean(np.array(gaps) >= APART_M) > 0.95
    assert np.percentile(distances, 10) < 1.2
    assert np.percentile(distances, 90) > 2.2


def test_the_same_state_gives_the_same_points():
    once, again = (
        place_probes(ROOM, rng, intrinsics=camera, camera_to_world=pose, depth_m=depth)
        for rng, camera, pose, depth in (first_view(3), first_view(3))
    )
    np.testing.assert_array_equal(once, again)


def test_without_clearance_there_is_no_place():
    rng, camera, pose, depth = first_view(6)
    full = FreeSpace(ROOM.walkable, ROOM.origin, ROOM.cell_m, lambda origins, _: np.full(len(origins), 0.1, np.float32))
    assert place_probes(full, rng, intrinsics=camera, camera_to_world=pose, depth_m=depth) is None


def test_an_open_sky_view_still_has_points_in_mid_air():
    rng, camera, pose, depth = first_view(8)
    outside = FreeSpace(
        ROOM.walkable, ROOM.origin, ROOM.cell_m, lambda origins, _: np.full(len(origins), np.inf, np.float32)
    )
    points = present(place_probes(outside, rng, intrinsics=camera, camera_to_world=pose, depth_m=np.zeros_like(depth)))
    assert points.shape == (3, 3)
