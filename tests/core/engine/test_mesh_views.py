"""What a point sees of many meshes: each direction of one of them, surfaces that several show once."""

import dataclasses

import numpy as np
import pytest

from roomlight.engine.observations import CLOSER_M
from roomlight.engine.surface.mesh import FrameMesh, MeshesView, distinct
from rooms import BoxRoom, camera_at

HEIGHT = 60
ROOM = BoxRoom(block=((-0.6, 0.0, -1.6), (0.5, 1.3, -1.0)))
POSITION = np.array([0.1, 1.2, 0.4])


def frames(*yaws, camera=(0.3, 1.5, 1.2)):
    return [ROOM.frame(camera_at(camera, yaw, -6)) for yaw in yaws]


def view_of(meshes):
    view = MeshesView(POSITION, HEIGHT)
    view.add(list(meshes))
    return view


def blended(meshes):
    """The reference: views of single meshes under the conservative rule."""
    radiance, clipped, guessed = np.zeros((HEIGHT, 2 * HEIGHT, 3)), *np.zeros((2, HEIGHT, 2 * HEIGHT))
    depth = np.full((HEIGHT, 2 * HEIGHT), np.inf, np.float32)
    for mesh in meshes:
        one = mesh.render_panorama(POSITION, height=HEIGHT)
        closer = one.mask & (one.depth_m <= depth - np.float32(CLOSER_M))
        radiance[closer], depth[closer] = one.radiance[closer], one.depth_m[closer]
        clipped[closer] = 0 if one.clipped is None else one.clipped[closer]
        guessed[closer] = 0 if one.guessed is None else one.guessed[closer]
    return radiance, depth, clipped, guessed


def test_surfaces_of_the_first_mesh_stay_unless_a_later_one_is_closer():
    first, second, third = frames(0, 20, -30)
    clipped = np.ones(second.clipped.shape, bool)
    closer = dataclasses.replace(third, depth_m=np.float32(0.7) * third.depth_m)
    second = dataclasses.replace(second, clipped=clipped, guessed=np.float32(0.5) * clipped)
    meshes = [FrameMesh(frame) for frame in (first, second, closer)]
    view = view_of(enumerate(meshes))
    partial, (radiance, depth, share, guessed) = view.partial(), blended(meshes)
    np.testing.assert_array_equal(partial.mask, np.isfinite(depth))
    np.testing.assert_array_equal(partial.depth_m, np.where(partial.mask, depth, 0))
    np.testing.assert_array_equal(partial.radiance, radiance)
    np.testing.assert_array_equal(partial.clipped, share)
    np.testing.assert_array_equal(partial.guessed, guessed)
    assert 0.01 < (share > 0).mean() < 0.5


def test_each_direction_has_the_camera_of_its_mesh():
    meshes = [FrameMesh(frame) for frame in (*frames(0), *frames(60, camera=(-0.4, 1.3, 0.9)))]
    cameras = np.array([mesh.camera_to_world[:3, 3] for mesh in meshes])
    view, masks = view_of(enumerate(meshes)), [mesh.render_panorama(POSITION, height=HEIGHT).mask for mesh in meshes]
    seen_from = view.viewed_from(cameras)
    for own, other in ((0, 1), (1, 0)):
        alone = masks[own] & ~masks[other]
        assert alone.sum() > 100
        assert abs(seen_from[alone] - (cameras[own] - POSITION)).max() < 1e-6
    assert not seen_from[~masks[0] & ~masks[1]].any()


def test_a_view_is_added_as_one_mesh():
    meshes = [FrameMesh(frame) for frame in frames(0, 50)]
    first, second = view_of([(0, meshes[0])]), view_of([(1, meshes[1])])
    first.add_view(second)
    both = view_of(enumerate(meshes)).partial()
    for name in ("radiance", "mask", "depth_m"):
        np.testing.assert_array_equal(getattr(first.partial(), name), getattr(both, name))


def test_measured_surfaces_win_over_completed_ones_in_any_order():
    measured, completed = frames(0, 20)
    completed = dataclasses.replace(completed, depth_m=np.float32(0.6) * completed.depth_m)
    nothing = np.zeros_like(completed.depth_m)
    meshes = [FrameMesh(measured), FrameMesh(completed, sensor_depth_m=nothing)]
    alone = meshes[0].render_panorama(POSITION, height=HEIGHT)
    first, last = view_of([(0, meshes[0])]), view_of([(1, meshes[1])])
    last.add_view(first)
    for view in (view_of(enumerate(meshes)), view_of([(1, meshes[1]), (0, meshes[0])]), last):
        both = view.partial()
        assert (both.mask & ~alone.mask).any()
        np.testing.assert_array_equal(both.depth_m[alone.mask], alone.depth_m[alone.mask])
        np.testing.assert_array_equal(both.measured, alone.mask)


def test_what_an_earlier_mesh_shows_is_left_out_and_nothing_else():
    meshes = [FrameMesh(frame) for frame in frames(0, 12, 24, 36)]
    rest = distinct(meshes)
    assert [number for number, _ in rest] == [0, 1, 2, 3]
    assert all(len(mesh.faces) < 0.6 * len(meshes[number].faces) for number, mesh in rest[1:])
    all_seen, seen = view_of(enumerate(meshes)).partial(), view_of(rest).partial()
    assert not (seen.mask & ~all_seen.mask).any()
    assert (seen.mask != all_seen.mask).sum() <= 0.01 * all_seen.mask.sum()
    both = seen.mask & all_seen.mask
    assert np.percentile(abs(seen.depth_m - all_seen.depth_m)[both], 98) < 0.05


@pytest.mark.parametrize("turned", [0, 0.5])
def test_a_mesh_that_shows_nothing_new_is_left_out(turned):
    narrow = ROOM.frame(camera_at((0.3, 1.5, 1.2), turned, -6))
    narrow.depth_m[:40] = narrow.depth_m[-40:] = 0
    narrow.depth_m[:, :40] = narrow.depth_m[:, -40:] = 0
    assert [number for number, _ in distinct([*map(FrameMesh, [*frames(0), narrow])])] == [0]


def test_a_surface_before_another_stays():
    far, near = frames(0, 0)
    near = dataclasses.replace(near, depth_m=np.float32(0.9) * near.depth_m)
    rest = distinct([FrameMesh(far), FrameMesh(near)])
    assert len(rest[1][1].faces) > 0.9 * len(FrameMesh(near).faces)


def test_meshes_without_depth_are_left_out():
    frame = frames(0)[0]
    assert distinct([FrameMesh(dataclasses.replace(frame, depth_m=np.zeros_like(frame.depth_m)))]) == []
