"""The vertex grid of a mesh as a depth image: its camera projects every vertex onto its own pixel centre."""

import numpy as np
import pytest

from roomlight.camera import rigid_inverse, transform_points
from roomlight.engine.session import Session, SessionOptions
from roomlight.engine.surface.mesh import FrameMesh
from rooms import BoxRoom, camera_at, pan

ROOM = BoxRoom(block=((-0.6, 0.0, -1.6), (0.5, 1.3, -1.0)))


@pytest.mark.parametrize("depth_size", [(160, 120), (320, 240), (256, 192), (61, 46)])
def test_grid_camera_projects_vertices_to_pixel_centres(depth_size):
    frame = ROOM.frame(camera_at((0.3, 1.5, 1.2), 8, -6), depth_size=depth_size)
    mesh = FrameMesh(frame)
    height, width = mesh.grid_depth_m.shape
    xy, depth = mesh.grid_camera.project(transform_points(rigid_inverse(mesh.camera_to_world), mesh.vertices))
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    assert np.abs(xy.reshape(height, width, 2) - np.stack([columns, rows], axis=-1)).max() < 2e-3
    assert depth.reshape(height, width) == pytest.approx(mesh.grid_depth_m, abs=1e-5)


def test_measured_marks_the_sensors_own_depth():
    frame = ROOM.frame(camera_at((0.3, 1.5, 1.2), 8, -6))
    frame.depth_m[30:60, 40:70] = 0
    session = Session(SessionOptions(model="classical", height=16))
    session.push(frame)
    ((index, mesh),) = session.meshes
    assert index == 0
    assert not mesh.measured[30:60, 40:70].any()
    assert (mesh.grid_depth_m[30:60, 40:70] > 0).all()  # completed from the hole's rim
    assert mesh.measured.sum() == mesh.measured.size - 30 * 30


def test_session_lists_keyframes_and_the_last_frame():
    session = Session(SessionOptions(model="classical", height=16, keyframes=3))
    assert session.meshes == []
    for frame in pan(ROOM, 6):
        session.push(frame)
    indices = [index for index, _ in session.meshes]
    assert indices == sorted(indices)
    assert indices[-1] == 5
    assert len(indices) in (3, 4)
