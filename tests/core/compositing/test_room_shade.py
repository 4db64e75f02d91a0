"""Shadows where real surfaces hide the lamp already: the floor beside a block, under a ball that hangs over it."""

import numpy as np
import pytest
from light_rooms import lit, unit
from shading_reference import moved
from test_shadows import from_axis

from present import present
from roomlight.compositing.light.lighting import LightSampler
from roomlight.compositing.objects.materials import diffuse
from roomlight.compositing.objects.primitives import sphere
from roomlight.compositing.picture.crop import CropCamera
from roomlight.compositing.placement.room_geometry import RoomGeometry
from roomlight.compositing.rendering.room_shade import lamp_of
from roomlight.compositing.rendering.shadows import Caster, ShadowQuality, coarse_ratio, surface_grid
from roomlight.compositing.rendering.tracer import TracedObjects
from roomlight.engine.surface.mesh import FrameMesh
from rooms import BoxRoom, camera_at

ROOM = BoxRoom(block=((-0.9, 0.0, -1.2), (-0.3, 0.6, -0.6)))
TOWARD = unit(-0.3, 1.0, 0.0)
SUN = lit(120, [(TOWARD, 2.0, 3000.0)], level=0.5)
CENTRE = (-0.5, 1.0, -0.9)


@pytest.fixture(scope="module")
def scene():
    """Return the grid of surfaces that a camera sees, and the fused geometry."""
    geometry = RoomGeometry()
    for index, (eye, yaw) in enumerate((((0.9, 1.6, 0.4), 45), ((0.2, 1.5, 1.4), 20), ((-0.2, 2.0, 0.6), 15))):
        geometry.add(index, FrameMesh(ROOM.frame(camera_at(eye, yaw, -40))))
    frame = ROOM.frame(camera_at((0.6, 1.6, 0.6), 25, -40), width=256, height=192, depth_size=(256, 192))
    camera = CropCamera.of(frame.intrinsics)
    return surface_grid(frame.depth_m, camera, frame.camera_to_world, []), geometry


def ratio(grid, room):
    held = TracedObjects([moved(sphere(0.3, diffuse((0.0, 0.0, 0.0))), *CENTRE)])
    spheres, light = np.array([[*CENTRE, 0.3]], np.float32), LightSampler(SUN, CENTRE)
    caster = Caster(held, spheres, np.array([0], np.int32), light, light, None, room)
    return coarse_ratio(caster, grid, ShadowQuality(step=1, samples=64, bounces=0))[0].mean(axis=-1)


def in_line(grid, top):
    """Return where the ball is between a surface and the sun, on the block's top or on the floor in its shade."""
    _, across = from_axis(grid, CENTRE, TOWARD)
    x, y, z = np.moveaxis(grid.points, -1, 0)
    if top:
        return grid.known & (across < 0.2) & (np.abs(y - 0.6) < 0.02) & (x < -0.36) & (x > -0.8)
    inside = (x > -0.26) & (x < -0.18) & (z > -1.1) & (z < -0.7)
    return grid.known & (across < 0.26) & (y < 0.02) & inside


def test_floor_in_the_shade_of_a_block_is_not_darkened_by_the_sun(scene):
    grid, geometry = scene
    shaded = in_line(grid, top=False)
    assert shaded.sum() > 20
    assert ratio(grid, None)[shaded].mean() < 0.5
    assert ratio(grid, geometry)[shaded].mean() > 0.75


def test_the_lit_top_of_the_block_keeps_its_shadow(scene):
    grid, geometry = scene
    lit_top = in_line(grid, top=True)
    assert lit_top.sum() > 50
    without, with_room = ratio(grid, None)[lit_top].mean(), ratio(grid, geometry)[lit_top].mean()
    assert without < 0.3
    assert with_room == pytest.approx(without, abs=0.05)


def test_the_lamp_is_the_brightest_direction_and_even_light_has_none():
    lamp = present(lamp_of(LightSampler(SUN)))
    assert lamp.direction @ TOWARD > np.cos(np.radians(2.5))
    assert lamp.intensity == pytest.approx([3000 * np.pi * np.radians(2) ** 2] * 3, rel=0.2)
    for even in (lit(60, [], level=1.0), lit(120, [(TOWARD, 2.0, 1.0)], level=1.0)):
        assert lamp_of(LightSampler(even)) is None
