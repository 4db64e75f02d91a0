"""Volume initialisation: the paper's numbers at known places, the kernel against its readable reference; and means
of initial volumes over the frames that observed a voxel."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roomlight.camera import rigid_inverse
from roomlight.engine.kernels.reference import initial_volume_reference
from roomlight.engine.volume.fusion import FusedVolume
from roomlight.engine.volume.grid import DEPTH_MAX_FLOOR_M, VOLUME_SHAPE, VolumeGrid, initial_volume
from roomlight.errors import FrameError
from roomlight.frame import Frame
from rooms import BoxRoom, camera_at, pinhole

ROOM = BoxRoom()
SMALL = (16, 15, 21)  # a quarter of the paper's shape
TINY = (3, 4, 5)


def _plane_frame(depth_m=4.0, *, image=0.5, camera_to_world=None, width=160, height=120):
    shape = (height, width)
    pose = np.eye(4) if camera_to_world is None else camera_to_world
    return Frame(
        0,
        np.full((*shape, 3), image, np.float32),
        np.zeros(shape, bool),
        np.full(shape, depth_m, np.float32),
        pinhole(width, height),
        pose,
    )


def _depths_and_offsets(grid, frame):
    """z-depth of every voxel in the camera, and the surface's distance in front of it, in voxel sides."""
    camera_from_volume = rigid_inverse(frame.camera_to_world) @ grid.volume_to_world
    points = grid.centres_m() @ camera_from_volume[:3, :3].T + camera_from_volume[:3, 3]
    xy, depth = frame.intrinsics.project(points)
    with np.errstate(invalid="ignore"):
        seen = (depth > 0) & (xy > 0.001).all(-1) & (xy < [159.999, 119.999]).all(-1)
        outside = (depth <= 0) | (xy < -0.001).any(-1) | (xy > [160.001, 120.001]).any(-1)
    return seen, outside, (frame.depth_m[0, 0] - depth) / grid.edge_m


def test_the_volume_is_the_papers_table_in_the_first_camera():
    pose = camera_at((1.0, 1.5, -0.5), 70, 10)
    grid = VolumeGrid.from_frame(_plane_frame(2.0, camera_to_world=pose))
    assert grid.shape == VOLUME_SHAPE == (64, 60, 84)
    assert grid.depth_max_m == 2.0
    assert grid.lower_m == pytest.approx([-2.2, -1.6, -2.4])
    assert grid.upper_m == pytest.approx([2.2, 1.6, 1.0])
    assert grid.voxel_m == pytest.approx([grid.edge_m] * 3, rel=0.02)
    assert grid.contains((1.0, 1.5, -0.5))
    assert grid.contains(tuple(pose[:3, 3] - 2.3 * pose[:3, 2]))  # to 1.2 D_max in front
    assert not grid.contains(tuple(pose[:3, 3] + 1.1 * pose[:3, 2]))  # to 0.5 D_max behind
    small = VolumeGrid.from_frame(_plane_frame(2.0), shape=SMALL)
    centres = small.centres_m()
    assert centres.shape == (*SMALL, 3)
    assert centres[0, 0, 0] == pytest.approx(small.lower_m + small.voxel_m / 2)
    assert centres[-1, -1, -1] == pytest.approx(small.upper_m - small.voxel_m / 2)


def test_depth_sets_the_size_of_the_volume():
    for depth_m in (0.02, 0.3, 0.49):  # a close-up gets the least size
        grid = VolumeGrid.from_frame(_plane_frame(depth_m))
        assert grid.depth_max_m == DEPTH_MAX_FLOOR_M
        assert grid.upper_m[0] - grid.lower_m[0] == pytest.approx(1.1)
    frame = _plane_frame(2.0)
    frame.depth_m[5, 5] = 900.0
    assert VolumeGrid.from_frame(frame).depth_max_m == pytest.approx(2.0)
    with pytest.raises(FrameError, match="frame 0: no pixel has a depth"):
        VolumeGrid.from_frame(_plane_frame(0.0))


def test_opacity_around_a_plane_is_the_papers_ramp():
    frame = _plane_frame(4.0)
    grid = VolumeGrid.from_frame(frame)
    seen, outside, offset = _depths_and_offsets(grid, frame)
    volume = initial_volume(grid, frame)
    alpha = volume[3]
    # 4(1 - offset) in front, 4(5 + offset) behind, clipped
    expected = np.clip(np.where(offset > 0, 4 * (1 - offset), 4 * (5 + offset)), 0, 1)
    # float32 coordinates of 1e-7 x 5 m over 0.1 m voxels, times the ramp's 4
    np.testing.assert_allclose(alpha[seen], expected[seen], atol=1e-4)
    assert (alpha[seen & (offset >= 1.001)] == 0).all()
    assert (alpha[seen & (offset <= 0.749) & (offset >= -4.749)] == 1).all()
    assert (alpha[seen & (offset <= -5.001)] == 0).all()
    assert (volume[:, outside] == 0).all()


def test_colour_is_alpha_times_image_and_empty_is_ahead_of_it():
    frame = ROOM.frame(camera_at((0, 1.5, 0), 30))
    grid = VolumeGrid.from_frame(frame)
    volume = initial_volume(grid, frame)
    bright = dataclasses.replace(frame, image=3 * frame.image)
    np.testing.assert_allclose(initial_volume(grid, bright)[:3], 3 * volume[:3], rtol=1e-5)
    assert (volume[3:] == initial_volume(grid, bright)[3:]).all()
    assert set(np.unique(volume[4])) == {-1.0, 0.0}
    assert not ((volume[4] < 0) & (volume[3] > 0)).any()
    flat = _plane_frame(3.0)
    seen, _, offset = _depths_and_offsets(VolumeGrid.from_frame(flat), flat)
    emptiness = initial_volume(VolumeGrid.from_frame(flat), flat)[4]
    assert (emptiness[seen & (offset > 3.001)] == -1).all()
    assert (emptiness[offset < 2.999] == 0).all()


def _random_frame(seed, *, depth_size, unknown, pose, image_size=(48, 36)):
    rng = np.random.default_rng(seed)
    width, height = image_size
    depth = rng.uniform(0.5, 5.0, depth_size[::-1]).astype(np.float32)
    depth[rng.random(depth.shape) < unknown] = 0
    image = rng.uniform(0, 4, (height, width, 3)).astype(np.float32)
    return Frame(1, image, image[..., 0] > 3, depth, pinhole(width, height), pose)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    depth_size=st.sampled_from([(48, 36), (32, 24), (16, 12), (96, 72)]),
    unknown=st.sampled_from([0.0, 0.2, 0.9]),
    yaw=st.floats(-180, 180),
    pitch=st.floats(-80, 80),
    shift=st.tuples(*[st.floats(-4, 4)] * 3),
    far_unknown=st.booleans(),
)
def test_the_kernel_equals_its_readable_reference(seed, depth_size, unknown, yaw, pitch, shift, far_unknown):
    first = camera_at((0.3, 1.5, 0.2), 25, -8)
    grid = VolumeGrid(first, 4.0, SMALL)
    moved = camera_at(np.array((0.3, 1.5, 0.2)) + shift, yaw, pitch)
    frame = _random_frame(seed, depth_size=depth_size, unknown=unknown, pose=moved)
    fast = initial_volume(grid, frame, far_unknown=far_unknown)
    slow = initial_volume_reference(grid, frame, far_unknown=far_unknown)
    # The kernel is float32 (1e-6 of 5 m: 1e-5 voxels, amplified by the ramp and by noise as depth, 5 m from one
    # pixel to the next). A voxel within that of a threshold (frustum, unknown, e) may fall on its other side.
    apart = (abs(fast - slow) > 2e-2).any(axis=0)
    assert apart.mean() < 2e-3
    assert np.median(abs(fast - slow)[:, ~apart]) < 1e-4
    assert np.isfinite(fast).all()


def test_unknown_pixels_are_on_the_far_boundary_none_is_empty():
    frame = _plane_frame(4.0)
    grid = VolumeGrid.from_frame(frame)
    frame.depth_m[:] = 0
    volume = initial_volume(grid, frame)
    assert (volume[4] == 0).all()
    opaque = np.argwhere(volume[3] > 0.5)
    assert len(opaque)
    shape = np.array(grid.shape)
    # a shell about one voxel inside the walls through which the rays leave, five voxels of ramp along z behind it:
    # none of it may be deep inside, and the front wall's first layer must be covered
    rim = np.minimum(opaque, shape - 1 - opaque).min(axis=1)
    assert rim.max() <= 4
    assert volume[3, 0, 20:40, 30:54].min() == 1
    assert (initial_volume(grid, frame, far_unknown=False) == 0).all()


def volumes(count, seed=0):
    """Initial volumes as of frames: surfaces, empty voxels, and voxels that were not observed."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        kind = random.integers(0, 3, TINY)
        alpha = np.where(kind == 1, random.uniform(0.01, 1, TINY), 0).astype(np.float32)
        colour = random.uniform(0, 4, (3, *TINY)).astype(np.float32)
        yield np.concatenate([alpha * colour, alpha[None], np.where(kind == 2, -1, 0)[None]]).astype(np.float32)


def fused(frames):
    fusion = FusedVolume.fresh(TINY)
    for frame in frames:
        fusion.add(frame)
    out = np.full((5, *TINY), np.nan, np.float32)
    fusion.write(out)
    return out


def test_the_fused_volume_is_the_mean_over_the_frames_that_saw_a_voxel():
    np.testing.assert_array_equal(fused([]), np.zeros((5, *TINY), np.float32))
    frames = list(volumes(6, seed=1))
    out = fused(frames)
    for at in np.ndindex(TINY):
        seen = [frame[:, *at] for frame in frames if frame[3, *at] > 0 or frame[4, *at] < 0]
        wanted = np.mean([one[:4] for one in seen], axis=0) if seen else np.zeros(4)
        np.testing.assert_allclose(out[:4, *at], wanted, rtol=1e-5)
        assert out[4, *at] == (-1 if seen and all(one[3] == 0 for one in seen) else 0)
