"""The partial mesh: exact on planes, open at depth edges, invisible from behind, and the frame at its camera."""

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roomlight.camera import rigid_inverse, transform_points
from roomlight.conventions import panorama_directions
from roomlight.engine.surface.mesh import EDGE_RATIO, MAX_VERTICES, FrameMesh, MeshGrid, grid_faces
from rooms import BoxRoom, camera_at, pan
from sessions import session_of

ROOM = BoxRoom(block=((-0.6, 0.0, -1.6), (0.5, 1.3, -1.0)))
POSE = camera_at((0.3, 1.5, 1.2), 8, -6)


def _in_frustum(frame, position, height, *, margin_px):
    """Panorama pixels whose direction the camera sees, their image coordinates, and the mask (margin in pixels)."""
    directions = panorama_directions(height).astype(np.float64)
    in_camera = transform_points(rigid_inverse(frame.camera_to_world), position + directions)
    xy, depth = frame.intrinsics.project(in_camera)
    size = np.array([frame.intrinsics.width, frame.intrinsics.height])
    with np.errstate(invalid="ignore"):
        inside = (depth > 0) & (xy > margin_px).all(-1) & (xy < size - margin_px).all(-1)
    return inside, np.nan_to_num(xy, nan=-1.0), 1 / np.maximum(depth, 1e-9)


def _away_from_edges(frame, xy, inside, *, reach_px):
    """Whether the depth and colour around the pixel are smooth: no edge within `reach_px`."""
    kernel = np.ones((2 * reach_px + 1,) * 2, np.uint8)
    spread = cv2.dilate(frame.depth_m, kernel) / cv2.erode(frame.depth_m, kernel)
    contrast = (cv2.dilate(frame.image, kernel) - cv2.erode(frame.image, kernel)).max(axis=-1)
    column, row = (xy[..., 0].astype(int) % frame.intrinsics.width, xy[..., 1].astype(int) % frame.intrinsics.height)
    return inside & (spread[row, column] < 1.05 * 1.05) & (contrast[row, column] < 0.15)


@settings(max_examples=8, deadline=None)
@given(yaw=st.floats(-180, 180), pitch=st.floats(-50, 50))
def test_a_probe_at_the_camera_sees_the_frame_inside_its_frustum(yaw, pitch):
    frame = ROOM.frame(camera_at((0.3, 1.5, 1.2), yaw, pitch))
    position = frame.camera_to_world[:3, 3]
    height = 360  # one image pixel for one of the panorama: the texture's finest level
    seen = FrameMesh(frame).render_panorama(position, height=height)
    inside, xy, stretch = _in_frustum(frame, position, height, margin_px=2)
    check = _away_from_edges(frame, xy, inside, reach_px=2)
    assert check.sum() > 0.4 * inside.sum()
    assert seen.mask[check].all()
    maps = (xy - 0.5).astype(np.float32)
    image = cv2.remap(frame.image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR)
    depth = cv2.remap(frame.depth_m, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR)
    # remap's weights have a resolution of 1/32 pixel: with a contrast under 0.15 that is 0.005
    assert abs(seen.radiance - image)[check].max() < 0.01
    # Linear interpolation of depth instead of along the triangle: under 5 % of edge ratio, squared, over 8
    np.testing.assert_allclose(seen.depth_m[check], (depth * stretch)[check], rtol=0.01)


def test_outside_the_frustum_nothing_is_seen_from_the_camera():
    frame = ROOM.frame(POSE)
    seen = FrameMesh(frame).render_panorama(POSE[:3, 3])
    inside, _, _ = _in_frustum(frame, POSE[:3, 3], 120, margin_px=-0.5)
    assert not seen.mask[~inside].any()
    assert (seen.radiance[~seen.mask] == 0).all()
    assert (seen.depth_m[~seen.mask] == 0).all()


def test_depth_is_the_distance_from_the_probe_wherever_it_stands():
    room = BoxRoom()
    frame = room.frame(camera_at((0.3, 1.5, 1.2), 0))
    probe = np.array([-0.4, 1.1, -0.6])
    seen = FrameMesh(frame).render_panorama(probe)
    radiance, distance = room.panorama(probe, 120)
    assert seen.mask.mean() > 0.15
    relative = abs(seen.depth_m / distance - 1)[seen.mask]
    # walls are planes, which the mesh has exactly; a corner of the room is cut by at most one vertex's spacing
    assert np.quantile(relative, 0.95) < 1e-3
    assert relative.max() < 0.05
    assert np.quantile(abs(seen.radiance - radiance).max(axis=-1)[seen.mask], 0.95) < 0.03


def test_no_triangle_crosses_a_depth_edge_or_has_an_unknown_corner():
    depth = ROOM.frame(POSE).depth_m
    corners = depth.reshape(-1)[grid_faces(depth)[0]]
    assert (corners.max(axis=1) <= EDGE_RATIO * corners.min(axis=1)).all()
    step = np.full((8, 10), 2.0, np.float32)
    step[:, 5:] = 2.0 * EDGE_RATIO * 1.001
    faces, _ = grid_faces(step)
    assert len(faces) == 2 * 7 * (9 - 1)  # one column of quads is left out
    assert (step.reshape(-1)[faces].max(axis=1) == step.reshape(-1)[faces].min(axis=1)).all()
    depth = np.full((5, 6), 2.0, np.float32)
    depth[2, 3] = 0
    faces, _ = grid_faces(depth)
    assert 2 * 6 + 3 not in faces
    assert len(faces) == 2 * 4 * 5 - 6  # the six triangles around the vertex
    frame = ROOM.frame(POSE)
    nothing = dataclasses.replace(frame, depth_m=np.zeros_like(frame.depth_m))
    seen = FrameMesh(nothing).render_panorama(POSE[:3, 3], height=24)
    assert seen.radiance.shape == (24, 48, 3)
    assert not seen.mask.any()
    assert (seen.radiance == 0).all()


def test_triangles_face_the_camera_and_are_unseen_from_behind():
    frame = BoxRoom().frame(camera_at((0.0, 1.5, 0.0), 0))
    mesh = FrameMesh(frame)
    from_inside = mesh.render_panorama(np.array([0.5, 1.2, 0.5]), height=32)
    from_behind_the_wall = mesh.render_panorama(np.array([0.0, 1.5, -4.0]), height=32)
    assert from_inside.mask.any()
    facing_wall = panorama_directions(32)[..., 2] > 0.9  # towards +z: the far wall's back
    assert not from_behind_the_wall.mask[facing_wall].any()


@given(st.integers(2, 700), st.integers(2, 700), st.integers(4, 5000))
@settings(deadline=None)
def test_the_vertex_limit_is_kept_by_skipping_samples(height, width, budget):
    depth = np.arange(1, height * width + 1, dtype=np.float32).reshape(height, width)
    grid = MeshGrid.of(depth, depth, budget)
    vertices, uv = grid.depth_m, grid.uv()
    assert vertices.size <= budget
    rows, columns = uv[..., 1] * height - 0.5, uv[..., 0] * width - 0.5
    found = depth[np.rint(rows).astype(int), np.rint(columns).astype(int)]
    assert (found == vertices).all()


def test_large_depth_maps_are_thinned_and_still_right():
    frame = BoxRoom().frame(camera_at((0.3, 1.5, 1.2), 0), width=640, height=480)
    mesh = FrameMesh(frame)
    assert len(mesh.vertices) <= MAX_VERTICES
    seen = mesh.render_panorama(np.array([0.3, 1.5, 1.2]), height=48)
    _, distance = BoxRoom().panorama((0.3, 1.5, 1.2), 48)
    assert np.quantile(abs(seen.depth_m / distance - 1)[seen.mask], 0.95) < 1e-3


def test_low_resolution_depth_carries_the_full_image():
    sharp = BoxRoom().frame(POSE)
    coarse = BoxRoom().frame(POSE, depth_size=(40, 30))
    position = POSE[:3, 3]
    fine, few = (FrameMesh(f).render_panorama(position, height=48) for f in (sharp, coarse))
    both = fine.mask & few.mask
    assert both.sum() > 0.8 * fine.mask.sum()
    assert np.quantile(abs(fine.radiance - few.radiance)[both], 0.95) < 0.01


def _checkered(frame, size_px):
    """The frame with squares of black and white instead of its image."""
    row, column = np.indices(frame.depth_m.shape) // size_px
    image = np.repeat(((row + column) % 2).astype(np.float32)[..., None], 3, axis=-1)
    return dataclasses.replace(frame, image=image)


def test_texture_finer_than_a_panorama_pixel_is_averaged():
    frame = _checkered(BoxRoom().frame(POSE, width=320, height=240), 1)
    seen = FrameMesh(frame).render_panorama(POSE[:3, 3], height=48)  # 14 image pixels for one
    assert abs(seen.radiance[seen.mask] - 0.5).max() < 0.01


def test_a_surface_near_the_probe_stays_sharp():
    """From 15 cm off a wall 3.7 m from the camera, an image pixel is as large as many of the panorama's."""
    frame = _checkered(BoxRoom().frame(camera_at((0.3, 1.5, 1.2)), width=320, height=240), 2)
    seen = FrameMesh(frame).render_panorama(np.array([0.3, 1.5, -2.35]), height=120)
    near = seen.mask & (seen.depth_m < 0.2)
    assert near.sum() > 1000
    # bilinear ramps between squares of 2 pixels: half of all values are not grey but beyond 1/4 and 3/4
    assert np.mean(abs(seen.radiance[near] - 0.5) > 0.25) > 0.4


@pytest.mark.parametrize(("width", "height"), [(32, 24), (17, 9), (8, 6), (321, 241)])
def test_every_level_of_the_texture_keeps_its_place(width, height):
    """An image that is a ramp in x and y reads the same from any level; sides that halve to fractions included."""
    frame = BoxRoom().frame(POSE, width=width, height=height, depth_size=(64, round(64 * height / width)))
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    ramp = np.stack([x, y, 0.5 * (x + y)], axis=-1).astype(np.float32)
    mesh = FrameMesh(dataclasses.replace(frame, image=ramp))
    position = POSE[:3, 3]
    inside, xy, _ = _in_frustum(frame, position, 24, margin_px=0)
    # beyond the centres of a level's outermost pixels, an eighth of the image wide at most, colour is constant
    uv = xy / [width, height]
    check = inside & (uv > 0.15).all(-1) & (uv < 0.85).all(-1)
    seen = mesh.render_panorama(position, height=24)
    check &= seen.mask
    assert check.sum() > 3
    np.testing.assert_allclose(seen.radiance[check][:, :2], uv[check], atol=0.02)


@pytest.mark.parametrize("depth_size", [(160, 120), (320, 240), (256, 192), (61, 46)])
def test_grid_camera_projects_vertices_to_pixel_centres(depth_size):
    mesh = FrameMesh(ROOM.frame(POSE, depth_size=depth_size))
    height, width = mesh.grid_depth_m.shape
    xy, depth = mesh.grid_camera.project(transform_points(rigid_inverse(mesh.camera_to_world), mesh.vertices))
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    assert np.abs(xy.reshape(height, width, 2) - np.stack([columns, rows], axis=-1)).max() < 2e-3
    assert depth.reshape(height, width) == pytest.approx(mesh.grid_depth_m, abs=1e-5)


def test_measured_marks_the_sensors_own_depth():
    frame = ROOM.frame(POSE)
    frame.depth_m[30:60, 40:70] = 0
    ((index, mesh),) = session_of([frame], height=16).meshes
    assert index == 0
    assert not mesh.measured[30:60, 40:70].any()
    assert (mesh.grid_depth_m[30:60, 40:70] > 0).all()  # completed from the hole's rim
    assert mesh.measured.sum() == mesh.measured.size - 30 * 30


def test_session_lists_keyframes_and_the_last_frame():
    assert session_of(height=16).meshes == []
    indices = [index for index, _ in session_of(pan(ROOM, 6), height=16, keyframes=3).meshes]
    assert indices == sorted(indices)
    assert indices[-1] == 5
    assert len(indices) in (3, 4)
