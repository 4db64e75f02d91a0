"""The fused surfaces of a session: complete, free of what is gone, and cheap where frames show the same."""

import numpy as np
import pytest

from roomlight.camera import transform_points
from roomlight.compositing.placement.room_geometry import MAX_PIECES, RoomGeometry
from roomlight.engine.surface.mesh import FrameMesh
from rooms import BoxRoom, camera_at, pan
from sessions import session_of

ROOM = BoxRoom()
BLOCKED = BoxRoom(block=((-0.6, 0.0, -1.6), (0.5, 1.3, -1.0)))
POSE = camera_at((0.3, 1.5, 1.2), 4, -10)


def cast_at(geometry, frame):
    """Fused distance against the true one along the frame's rays."""
    return geometry.depth_image(frame.intrinsics, frame.camera_to_world), frame.depth_m


def fused(*frames):
    geometry = RoomGeometry()
    for index, frame in enumerate(frames):
        geometry.add(index, FrameMesh(frame))
    return geometry


def test_fused_depth_is_the_rooms():
    found, true = cast_at(fused(*pan(BLOCKED, 6, step_degrees=8)), pan(BLOCKED, 1, start_degrees=17)[0])
    known = found > 0
    assert known.mean() > 0.9
    wrong = np.abs(found - true)[known] / true[known]
    assert np.percentile(wrong, 90) < 0.002
    assert (wrong > 0.05).mean() < 0.03  # beside edges, where no triangle is


def test_what_a_later_frame_sees_through_is_removed():
    geometry = fused(BLOCKED.frame(POSE))
    before, _ = cast_at(geometry, BLOCKED.frame(POSE))
    geometry.add(1, FrameMesh(ROOM.frame(POSE)))  # the block was taken away
    after, true = cast_at(geometry, ROOM.frame(POSE))
    gone = (before > 0) & (before < true - 0.2)
    assert gone.sum() > 1000
    assert ((after[gone] > 0) & (after[gone] < true[gone] - 0.2)).mean() < 0.01
    inside = np.zeros_like(gone)
    inside[4:-4, 4:-4] = True
    assert (after[inside] > 0).mean() > 0.97


def test_what_comes_back_after_a_later_frame_saw_through_is_added_again():
    blocked, free = BLOCKED.frame(POSE), ROOM.frame(POSE)
    before, _ = cast_at(fused(blocked), blocked)
    after, _ = cast_at(fused(blocked, blocked, free, blocked), blocked)
    block = (before > 0) & (before < free.depth_m - 0.2)
    assert block.sum() > 1000
    assert (np.abs(after - before)[block] < 0.01).mean() > 0.97


def test_the_same_view_adds_hardly_a_triangle():
    geometry = fused(ROOM.frame(POSE))
    first = geometry.triangles
    geometry.add(1, FrameMesh(ROOM.frame(POSE)))
    assert geometry.triangles < 1.06 * first


def test_a_closer_view_replaces_the_coarse_triangles():
    geometry = fused(ROOM.frame(camera_at((0, 1.5, 2.3))), ROOM.frame(camera_at((0, 1.5, -1.3))))
    point = np.array([[0.0, 1.5, -2.5]], np.float32)
    near = np.linalg.norm(geometry.points() - point, axis=1) < 0.15
    spacing = 1.2 / ROOM.frame(POSE).intrinsics.fx
    assert near.sum() == pytest.approx(np.pi * 0.15**2 / (spacing**2 / 2), rel=0.25)


def test_completed_depth_is_no_surface():
    frame = ROOM.frame(POSE)
    frame.depth_m[40:80, 60:100] = 0
    session, geometry = session_of([frame], height=16), RoomGeometry()
    geometry.update(session)
    assert geometry.version == 1
    geometry.update(session)
    assert geometry.version == 1
    found, _ = cast_at(geometry, frame)
    assert (found[44:76, 64:96] == 0).all()
    assert (found[4:36, 4:-4] > 0).mean() > 0.99  # a ray through a vertex may slip through


def test_hits_face_the_ray_and_without_frames_nothing_is_hit():
    empty = RoomGeometry().cast(np.zeros((2, 3), np.float32), np.eye(3, dtype=np.float32)[:2])
    assert np.isinf(empty.distance_m).all()
    geometry = fused(ROOM.frame(POSE))
    direction = transform_points(POSE, np.array([0.0, 0, -1])) - POSE[:3, 3]
    for origin, along in ((POSE[:3, 3], direction), (POSE[:3, 3] + 20 * direction, -direction)):
        hits = geometry.cast(origin[None].astype(np.float32), along[None].astype(np.float32))
        assert float(hits.normals[0] @ along) < 0


@pytest.mark.slow
def test_the_number_of_pieces_is_bounded():
    geometry = fused(*[ROOM.frame(POSE, width=16, height=12)] * (MAX_PIECES + 3))
    assert len(geometry._pieces) == MAX_PIECES
