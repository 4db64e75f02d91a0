"""Real things in front of objects: exact where depth decides, at the colour edge where it does not."""

import numpy as np
import pytest

from roomlight.compositing.picture.crop import Crop, CropCamera
from roomlight.compositing.picture.occlusion import (
    RealDepth,
    depth_edges,
    on_carrier,
    real_depth,
    visibility,
    without_islands,
)
from roomlight.compositing.placement.places import Plane
from rooms import camera_at, pinhole

WHOLE = Crop(0, 0, 160, 120)
EDGE = 71
"""Column where the near surface (left) ends."""


def guide_with_edge(noise=0.0):
    guide = np.full((120, 160, 3), 0.65, np.float32)
    guide[:, :EDGE] = (0.3, 0.35, 0.3)
    return guide + np.random.default_rng(2).normal(0, noise, guide.shape).astype(np.float32)


def step_depth(width=160, height=120):
    columns = (np.arange(width) + 0.5) * 160 / width
    return np.broadcast_to(np.where(columns < EDGE, 1.0, 3.0), (height, width)).astype(np.float32)


def test_full_depth_hides_exactly():
    real, whole = real_depth(step_depth(), 160, 120, WHOLE), np.full((120, 160), 2.0, np.float32)
    seen = visibility(whole, real, guide_with_edge())
    assert seen[:, : EDGE - 1].max() == 0
    assert seen[:, EDGE + 1 :].min() == 1
    assert seen[:, EDGE - 1].max() < 0.01  # beside the edge colour decides
    assert seen[:, EDGE].min() > 0.99
    small = np.zeros((120, 160), np.float32)
    small[40:80, 40:100] = 2.0
    seen = visibility(small, real, guide_with_edge())
    assert (seen[small == 0] == 1).all()  # pixels without object count as visible
    assert seen[60, 50] == 0
    unknown = real_depth(np.zeros((30, 40), np.float32), 160, 120, WHOLE)
    assert (visibility(whole, unknown, guide_with_edge()) == 1).all()


def test_what_hides_an_object_reaches_its_outline_or_the_edge_of_the_image():
    visible, covered = np.ones((40, 60), np.float32), np.zeros((40, 60), bool)
    covered[:, 10:50] = True
    visible[10:14, 20:30] = 0  # an island
    visible[20:24, 30:50] = 0
    visible[36:, 20:30] = 0
    visible[~covered] = 1
    expected = visible.copy()
    expected[10:14, 20:30] = 1
    assert (without_islands(visible, covered) == expected).all()


@pytest.mark.parametrize("noise", [0.0, 0.015])
def test_coarse_depth_hides_along_the_colour_edge(noise):
    coarse = step_depth(40, 30)
    coarse[:, 17] = 3.0  # the sensor sees the edge a pixel, four of the image's, too far left
    seen = visibility(np.full((120, 160), 2.0, np.float32), real_depth(coarse, 160, 120, WHOLE), guide_with_edge(noise))
    inner = seen[10:-10]
    assert inner[:, : EDGE - 1].max() < 0.1
    assert inner[:, EDGE + 1 :].min() > 0.9


def test_without_a_colour_edge_the_alpha_is_soft():
    flat = np.full((120, 160, 3), 0.5, np.float32)
    seen = visibility(np.full((120, 160), 2.0, np.float32), real_depth(step_depth(40, 30), 160, 120, WHOLE), flat)
    steps = np.diff(seen[60])
    assert steps.max() < 0.5
    assert seen[60, 40] == 0
    assert seen[60, 110] == 1


def test_a_weak_colour_edge_is_followed_to_a_fraction_of_a_pixel():
    is_far = np.arange(160) >= EDGE
    guide = np.where(is_far[None, :, None], 0.58, 0.5) + np.random.default_rng(2).normal(0, 0.03, (120, 160, 3))
    coarse = step_depth(64, 48)
    coarse[::2, 28] = 3.0  # every second row of the sensor's edge is off by a pixel
    real = real_depth(coarse, 160, 120, WHOLE)
    seen = visibility(np.full((120, 160), 2.0, np.float32), real, guide.astype(np.float32))
    assert np.abs(seen - is_far).sum(axis=1).mean() < 0.15  # 0.34 without doubtful depth and without contrast


def test_a_narrow_hole_is_decided_by_colour():
    depth = step_depth()
    depth[:, EDGE - 3 : EDGE + 3] = 0
    seen = visibility(np.full((120, 160), 2.0, np.float32), real_depth(depth, 160, 120, WHOLE), guide_with_edge())
    assert seen[:, : EDGE - 1].max() < 0.05
    assert seen[:, EDGE + 1 :].min() > 0.95


def test_the_plane_under_an_object_never_hides_it():
    pose = camera_at((0.0, 1.0, 1.0), pitch_degrees=-45)
    camera = CropCamera.of(pinhole(160, 120))
    down = (camera.rays() @ pose[:3, :3].T.astype(np.float32))[..., 1]
    noise = np.random.default_rng(1).normal(0, 0.008, down.shape).astype(np.float32)
    depth = np.where(down < -0.3, 1.0 / -np.minimum(down, -0.3), 0).astype(np.float32)
    real = RealDepth(np.where(depth > 0, depth + noise, 0), np.ones(depth.shape, bool), 1.0)
    floor = Plane(np.zeros(3), np.array([0.0, 1, 0]))
    first = np.zeros(depth.shape, np.int32)
    assert on_carrier(real, camera, pose, [floor], first)[depth > 0].mean() > 0.95
    below = Plane(np.array([0.0, 2.0, 0]), np.array([0.0, 1, 0]))  # faces away from the camera
    assert not on_carrier(real, camera, pose, [below], first).any()
    # A table hides what stands on the floor, though another object stands on the table.
    objects = np.where(np.arange(160) < 80, 0, -1) * np.ones((120, 1), int)
    objects[:, 120:] = 1
    other = on_carrier(real, camera, pose, [floor, None], objects)
    assert other[:, :90][depth[:, :90] > 0].mean() > 0.95
    assert not other[:, 110:].any()
    assert not on_carrier(real, camera, pose, [floor, None], np.full(depth.shape, -1)).any()


def test_what_stands_on_the_same_plane_before_an_object_hides_it_down_to_its_foot():
    """Seen along a table, the foot of a box is as near to the table's plane as noise is."""
    real = RealDepth(np.full((20, 20), 2.0, np.float32), np.ones((20, 20), bool), 1.0)
    guide, carrier = np.zeros((20, 20, 3), np.float32), np.ones((20, 20), bool)
    for behind_m, expected in ((0.15, 1.0), (0.3, 0.0)):
        seen = visibility(np.full((20, 20), 2.0 + behind_m, np.float32), real, guide, carrier)
        assert (seen == expected).all()


def test_a_grazing_floor_has_no_depth_edges():
    rows = np.arange(60, dtype=np.float32)[:, None] + 3
    floor = np.broadcast_to(80 / rows, (60, 80)).astype(np.float32)
    assert not depth_edges(floor).any()
    floor = floor.copy()
    floor[20:30, 20:30] *= 0.8
    edges = depth_edges(floor)
    assert edges[20:30, 19:21].all()
    assert not edges[23:27, 23:27].any()


def test_depth_is_linear_within_a_surface():
    slope = np.add.outer(0.02 * np.arange(30), 0.01 * np.arange(40)).astype(np.float32) + 2
    crop = Crop(20, 10, 140, 100)
    assert set(np.unique(real_depth(step_depth(40, 30), 160, 120, crop).depth_m)) == {1.0, 3.0}  # not across edges
    real = real_depth(slope, 160, 120, crop)
    rows, columns = ((np.arange(first, last) + 0.5) / 4 - 0.5 for first, last in ((10, 100), (20, 140)))
    assert real.certain.all()
    assert real.depth_m == pytest.approx(np.add.outer(0.02 * rows, 0.01 * columns) + 2, abs=1e-5)
    part = real.part(Crop(30, 20, 50, 60).inside(crop))
    assert (part.depth_m == real.depth_m[10:50, 10:30]).all()
