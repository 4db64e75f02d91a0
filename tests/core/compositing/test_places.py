"""Places on surfaces: resting on them, flush with walls, and refused where nothing is known."""

from dataclasses import replace

import numpy as np
import pytest

from present import present
from roomlight.camera import transform_points
from roomlight.compositing.placement.places import (
    Box,
    fit_plane,
    nearby_support,
    place_at,
    place_at_pixel,
    place_by_pose,
)
from roomlight.compositing.placement.room_geometry import RoomGeometry
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.errors import SceneError
from rooms import BoxRoom, camera_at, pixel_of

ROOM = BoxRoom(block=((-0.6, 0.0, -1.6), (0.5, 0.7, -1.0)))
EYE = (0.2, 1.4, 1.2)
BOX = Box(np.array([-0.1, -0.05, -0.2]), np.array([0.1, 0.25, 0.15]))
CORNERS = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.05, 0.25) for z in (-0.2, 0.15)])


def view(pitch_degrees, noise_m=0.0):
    frame = ROOM.frame(camera_at(EYE, pitch_degrees=pitch_degrees), width=320, height=240, depth_size=(256, 192))
    if noise_m:
        noise = np.random.default_rng(3).normal(0, noise_m, frame.depth_m.shape).astype(np.float32)
        frame = replace(frame, depth_m=frame.depth_m + noise)
    return frame, known_by(frame)


def known_by(frame):
    geometry = RoomGeometry()
    geometry.add(0, FrameMesh(frame))
    return geometry


def placed_at(target, frame, geometry, **more):
    """Place the box at the pixel of a frame that shows a point."""
    return place_at_pixel(geometry, frame, *pixel_of(frame, target), BOX, **more)


@pytest.mark.parametrize("noise_m", [0.0, 0.004])
@pytest.mark.parametrize(
    ("pitch", "target", "axis", "height"),
    [(-35, (0.9, 0, -0.8), 1, 0.0), (-25, (0.0, 0.7, -1.3), 1, 0.7), (30, (0.6, 3.0, -1.2), 1, 3.0)],
)
def test_object_rests_on_the_plane_behind_the_pixel(pitch, target, axis, height, noise_m):
    placed = placed_at(target, *view(pitch, noise_m))
    corners = transform_points(placed.object_to_world, CORNERS)
    gap = corners[:, axis].min() - height if height < 3 else height - corners[:, axis].max()
    assert abs(gap) < 0.005
    assert placed.kind == ("ceiling" if height == 3 else "floor")
    support = present(placed.support)
    assert support.normal == pytest.approx([0, -1 if height == 3 else 1, 0])
    assert placed.object_to_world[:3, 1] == pytest.approx([0, 1, 0])  # upright, also under a ceiling
    assert support.point[[0, 2]] == pytest.approx(np.array(target)[[0, 2]], abs=0.02)


@pytest.mark.parametrize(
    ("tilt_degrees", "estimated", "kind"),
    [(8, False, "floor"), (12, False, "slope"), (45, True, "floor"), (55, True, "wall")],
)
def test_object_stands_upright_on_what_is_nearly_level_and_leans_on_a_slope(tilt_degrees, estimated, kind):
    frame, _ = view(-35)
    tilt = np.eye(4)
    cos, sin = np.cos(np.radians(tilt_degrees)), np.sin(np.radians(tilt_degrees))
    tilt[:2, :2] = [[cos, -sin], [sin, cos]]
    tilted = replace(frame, camera_to_world=tilt @ frame.camera_to_world, depth_estimated=estimated)
    placed = place_at_pixel(known_by(tilted), tilted, *pixel_of(frame, (0.9, 0, -0.8)), BOX)
    assert placed.kind == kind
    up = tilt[:3, 1] if kind == "slope" else [0, 1, 0]
    assert placed.object_to_world[:3, 1] == pytest.approx(up, abs=0.002)


def test_a_floor_whose_estimated_depth_is_uneven_is_a_floor():
    frame, _ = view(-35)
    rows, columns = np.indices(frame.depth_m.shape)
    uneven = frame.depth_m * np.exp(0.07 * np.sin(rows / 4) * np.sin(columns / 4)).astype(np.float32)
    frame = replace(frame, depth_m=uneven, depth_estimated=True)
    geometry, box = known_by(frame), Box(0.2 * BOX.low, 0.2 * BOX.high)
    for x in np.linspace(-0.4, 1.2, 9):
        assert place_at_pixel(geometry, frame, *pixel_of(frame, (x, 0, -0.8)), box).kind == "floor"


def test_object_does_not_lean_on_the_rim_of_a_table_in_coarse_depth():
    frame = ROOM.frame(camera_at(EYE, pitch_degrees=-35), width=320, height=240, depth_size=(64, 48))
    geometry = known_by(frame)
    for x in np.linspace(-0.5, 0.4, 19):  # 8 of them leaned
        placed = placed_at((x, 0.68, -1.0), frame, geometry)
        assert placed.object_to_world[:3, 1] == pytest.approx([0, 1, 0], abs=1e-6)


@pytest.mark.parametrize("noise_m", [0.0, 0.004])
def test_object_hangs_flush_on_a_wall(noise_m):
    placed = placed_at((1.0, 1.5, -2.5), *view(0, noise_m))
    corners = transform_points(placed.object_to_world, CORNERS)
    assert placed.kind == "wall"
    assert abs(corners[:, 2].min() + 2.5) < (0.008 if noise_m else 0.005)
    front = placed.object_to_world[:3, 2]
    assert front == pytest.approx([0, 0, 1], abs=0.02 if noise_m else 1e-5)  # it looks into the room
    assert placed.object_to_world[:3, 1] == pytest.approx([0, 1, 0], abs=1e-6)


def test_yaw_turns_about_the_normal():
    turned = placed_at((0.9, 0, -0.8), *view(-35), yaw_degrees=90.0)
    assert turned.object_to_world[:3, 2] == pytest.approx([1, 0, 0], abs=1e-6)


def test_near_an_edge_the_pixels_own_surface_is_fitted():
    placed = placed_at((0.0, 0.7, -1.06), *view(-25))
    assert placed.kind == "floor"
    assert present(placed.support).point[1] == pytest.approx(0.7, abs=0.005)


def test_another_frame_fills_a_hole_behind_the_pixel():
    frame, geometry = view(-35)
    blind = replace(frame, depth_m=np.zeros_like(frame.depth_m))
    placed = placed_at((0.9, 0, -0.8), blind, geometry)
    assert present(placed.support).point == pytest.approx([0.9, 0, -0.8], abs=0.01)


def test_places_that_cannot_be_are_refused():
    frame, geometry = view(-35)
    blind = replace(frame, depth_m=np.zeros_like(frame.depth_m))
    with pytest.raises(SceneError, match=r"no surface is known behind 100,50.*; give a position$"):
        place_at_pixel(RoomGeometry(), blind, 100.0, 50.0, BOX)
    blind.depth_m[30, 110] = blind.depth_m[150, 100] = 1.0  # of 192 x 256
    with pytest.raises(SceneError, match=r"gave no depth there .*; the nearest pixel with depth is 138,38$"):
        place_at_pixel(RoomGeometry(), blind, 100.0, 50.0, BOX)
    masked = replace(blind, seen=np.indices(blind.image.shape[:2])[0] > 50)
    with pytest.raises(SceneError, match=r"behind 100,50: it is masked or transparent and no other frame showed it; "):
        place_at_pixel(RoomGeometry(), masked, 100.0, 50.0, BOX)
    for u, v in ((-1.0, 5.0), (320.0, 5.0), (5.0, 240.0), (float("nan"), 5.0)):
        with pytest.raises(SceneError, match="320 x 240 pixels"):
            place_at_pixel(geometry, frame, u, v, BOX)
    for position in ((np.nan, 0, 0), (0, 2e4, 0)):
        with pytest.raises(SceneError, match="within 10000 m"):
            place_at(np.array(position), BOX)
    with pytest.raises(SceneError, match=r"pose: .*scales"):
        place_by_pose(np.diag([2.0, 2, 2, 1]), BOX)


@pytest.mark.parametrize(
    ("anchor", "expected"), [("base", (0, -0.05, -0.025)), ("centre", (0, 0.1, -0.025)), ("origin", (0, 0, 0))]
)
def test_the_anchor_is_put_onto_the_place(anchor, expected):
    placed = place_at(np.array([1.0, 2, 3]), BOX, yaw_degrees=30.0, anchor=anchor)
    assert transform_points(placed.object_to_world, np.array(expected, float)) == pytest.approx([1, 2, 3])


@pytest.mark.parametrize("depth_estimated", [False, True])
@pytest.mark.parametrize(
    ("pitch", "position", "anchor", "normal"),
    [
        (-35, (0.9, 0, -0.8), "base", (0, 1, 0)),
        (0, (1.0, 1.5, -2.5), "back", (0, 0, 1)),
        (30, (0.6, 3.0, -1.2), "top", (0, -1, 0)),
    ],
)
def test_an_object_placed_by_position_has_the_surface_that_it_touches(pitch, position, anchor, normal, depth_estimated):
    _, geometry = view(pitch)
    for gap_m, is_near in ((0.0, True), (0.1, depth_estimated), (0.3, False)):
        placed = place_at(np.array(position) + gap_m * np.array(normal), BOX, anchor=anchor)
        support = nearby_support(geometry, placed, BOX, depth_estimated=depth_estimated)
        assert (support is not None) == is_near
        if support is not None:
            assert support.normal == pytest.approx(normal)
            assert support.height_of(transform_points(placed.object_to_world, CORNERS)).min() == pytest.approx(0)


def test_a_wall_that_leans_by_20_degrees_is_a_support_only_where_depth_is_estimated():
    _, geometry = view(0)
    placed = place_by_pose(camera_at((1.0, 1.5, -2.5), pitch_degrees=20), BOX, anchor="back")
    assert nearby_support(geometry, placed, BOX, depth_estimated=False) is None
    assert nearby_support(geometry, placed, BOX, depth_estimated=True) is not None


def test_a_line_of_points_makes_no_plane():
    line = np.linspace(0, 1, 50)[:, None] * np.array([[0.1, 0, 0]])
    assert fit_plane(line.astype(np.float32), np.zeros(3), toward=np.array([0.0, 1, 0]), tolerance_m=0.01) is None
