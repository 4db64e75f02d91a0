"""The keyframe store: bounded, refuses frames without new cells, and keeps coverage."""

from dataclasses import replace

import numpy as np
import pytest

from roomlight.engine.surface.change import contradicts
from roomlight.engine.surface.keyframes import KeyframeStore
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.volume.grid import VolumeGrid
from rooms import BoxRoom, camera_at, pan
from sessions import session_from, session_of, state_of

ROOM = BoxRoom()
SIZE = {"width": 80, "height": 60}


@pytest.fixture(scope="module")
def two_pans():
    """Two pans around the room in steps of 20 degrees, and their grid."""
    frames = pan(ROOM, 36, step_degrees=20, **SIZE)
    return VolumeGrid.from_frame(frames[0]), [FrameMesh(frame) for frame in frames]


def _store(two_pans, capacity, chosen=None):
    grid, meshes = two_pans
    store = KeyframeStore(grid, capacity)
    for index in range(len(meshes)) if chosen is None else chosen:
        store.offer(index, meshes[index])
    return store


def _covered_cells(store):
    """The number of cells that at least one keyframe shows."""
    return np.logical_or.reduce([key.cells for key in store]).sum()


@pytest.mark.parametrize("capacity", [1, 2, 5, 24])
def test_the_store_is_bounded_and_in_order_of_time(two_pans, capacity):
    grid, meshes = two_pans
    store = KeyframeStore(grid, capacity)
    to_and_fro = [*range(0, len(meshes), 2), *range(1, len(meshes), 2)]
    for index, mesh in zip(to_and_fro, meshes, strict=True):
        store.offer(index, mesh)
        assert len(store) <= capacity
    indices = [key.index for key in store]
    assert indices == sorted(set(indices))
    assert len(indices) == len(store) > 0


@pytest.mark.parametrize("capacity", [3, 5, 8])
def test_kept_frames_cover_more_than_the_first_or_last_frames(two_pans, capacity):
    count = len(two_pans[1])
    chosen = _covered_cells(_store(two_pans, capacity))
    first = _covered_cells(_store(two_pans, capacity, range(capacity)))
    last = _covered_cells(_store(two_pans, capacity, range(count - capacity, count)))
    assert chosen > 1.1 * max(first, last)


def test_a_large_store_keeps_nearly_all_observed_cells(two_pans):
    all_cells = _covered_cells(_store(two_pans, 1000))
    assert _covered_cells(_store(two_pans, 10)) > 0.9 * all_cells


def test_frames_are_distinguished_without_their_indices(two_pans):
    grid, meshes = two_pans
    by_index, by_itself = (KeyframeStore(grid, 2) for _ in range(2))
    for index, mesh in enumerate(meshes[:9]):
        assert by_itself.offer(0, mesh) == by_index.offer(index, mesh)


def test_frames_without_new_cells_or_depth_are_refused(two_pans):
    grid, meshes = two_pans
    store = KeyframeStore(grid, 5)
    blind = ROOM.frame(camera_at((0, 1.5, 0)), **SIZE)
    blind.depth_m[:] = 0
    assert not store.offer(0, FrameMesh(blind))
    assert len(store) == 0
    assert store.offer(0, meshes[0])
    assert not store.offer(1, meshes[0])
    assert len(store) == 1
    for capacity in (0, -1):
        with pytest.raises(ValueError, match=str(capacity)):
            KeyframeStore(grid, capacity)


def test_keyframes_after_a_close_up_cover_the_room():
    """With D_max of 0.4 m the volume is smaller than a metre: the room around it lies outside."""
    close = ROOM.frame(camera_at((0.0, 1.5, -2.1)), **SIZE)
    grid = VolumeGrid.from_frame(close)
    assert grid.depth_max_m < 0.7
    store = KeyframeStore(grid, 24)
    kept = [store.offer(i, FrameMesh(frame)) for i, frame in enumerate(pan(ROOM, 8, step_degrees=45, **SIZE))]
    assert sum(kept) >= 6
    assert _covered_cells(store) > 100


def test_offers_during_iteration_do_not_change_it(two_pans):
    grid, meshes = two_pans
    store = KeyframeStore(grid, 3)
    store.offer(0, meshes[0])
    for key in store:
        assert key.index == 0
        store.offer(9, meshes[9])
    assert len(store) == 2


BLOCKED = BoxRoom(block=((-0.4, 0.0, -0.9), (0.3, 1.9, -0.5)))
"""Somebody stands before the camera."""


def _look(room=ROOM, index=0, position=(0.0, 1.5, 1.0), light=1.0, yaw=0.0):
    frame = room.frame(camera_at(position, yaw), index=index, **SIZE)
    return replace(frame, image=np.float32(light) * frame.image)


@pytest.mark.parametrize(
    ("before", "now", "contradicted"),
    [
        (ROOM, _look(), False),
        (ROOM, _look(BLOCKED), False),  # what is hidden may still be there
        (BLOCKED, _look(), True),
        (BLOCKED, _look(BLOCKED, position=(0.05, 1.5, 1.0)), False),  # a pose that is off by 5 cm
        (ROOM, _look(light=1.8), False),
        (ROOM, _look(light=2.2), True),
        (ROOM, _look(light=0.4), True),
    ],
    ids=["same", "somebody comes", "somebody goes", "pose", "noise", "brighter", "darker"],
)
def test_a_frame_contradicts_what_it_sees_through_and_other_light(before, now, contradicted):
    seen = replace(now, camera_to_world=_look().camera_to_world)
    assert contradicts(FrameMesh(seen), FrameMesh(_look(before))) == contradicted


def test_two_frames_that_contradict_replace_a_keyframe_also_after_loading():
    session = session_of([_look(BLOCKED), _look(index=1)])
    assert [index for index, _ in session.meshes] == [0, 1]
    loaded = session_from(state_of(session))
    for each in (session, loaded):
        each.push(_look(index=2))
        assert [index for index, _ in each.meshes] == [1, 2]  # the last frame is 2
    assert state_of(session) == state_of(loaded)


def test_somebody_who_stands_before_the_camera_replaces_no_keyframe():
    around = pan(ROOM, 12, step_degrees=30, **SIZE)
    session = session_of([*around, *(_look(BLOCKED, 12 + n) for n in range(3))])
    assert set(range(11)) <= {index for index, _ in session.meshes}


def test_somebody_who_walks_along_in_view_does_not_cost_the_room():
    frames = []
    for index in range(60):
        pose = camera_at((0.0, 1.4, 0.0), 4 * index)
        x, _, z = 0.8 * -pose[:3, 2]
        person = BoxRoom(block=((x - 0.12, 0.0, z - 0.12), (x + 0.12, 1.8, z + 0.12)))
        frames.append([room.frame(pose, index=index, **SIZE) for room in (ROOM, person)])
    alone, beside = (session_of(each, height=32).light_at((0.0, 1.2, 0.0)) for each in zip(*frames, strict=True))
    assert beside.coverage > 0.85 * alone.coverage


@pytest.mark.parametrize("yaws", [(20, 20, 20), range(8, 56, 8)], ids=["still", "pan"])
def test_what_later_frames_contradict_comes_last_also_after_loading(yaws):
    bright = [_look(index=n, yaw=yaw) for n, yaw in enumerate(yaws, 1)]
    session = session_of([_look(light=0.2), *bright], height=32)
    assert session.meshes[0][0] == 0  # no other one shows what is at its right
    sessions = session, session_from(state_of(session)), session_of(bright, height=32)
    light, loaded, alone = (each.light_at((0.0, 1.5, 1.0)) for each in sessions)
    seen = alone.observed == 1
    np.testing.assert_allclose(light.reflection[seen], alone.reflection[seen], rtol=0.02)
    np.testing.assert_array_equal(loaded.reflection, light.reflection)


def test_a_keyframe_with_a_hand_before_the_lens_is_dropped():
    hand = _look()
    hand.depth_m[:, 4:-4] = 0.45
    session = session_of([hand, *(_look(index=n, position=(0.0, 1.5, 1.1)) for n in (1, 2))])
    assert [index for index, _ in session.meshes] == [1, 2]
