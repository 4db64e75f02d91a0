"""The keyframe store: bounded, refuses frames without new cells, and keeps coverage."""

import numpy as np
import pytest

from roomlight.engine.surface.keyframes import KeyframeStore
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.volume.grid import VolumeGrid
from rooms import BoxRoom, camera_at, pan

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
