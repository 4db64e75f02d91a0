"""`FusedVolume`: means of initial volumes over the frames that observed a voxel."""

import numpy as np

from roomlight.engine.volume.fusion import FusedVolume

SHAPE = (3, 4, 5)


def volumes(count, seed=0):
    """Initial volumes as of frames: surfaces, empty voxels, and voxels that were not observed."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        kind = random.integers(0, 3, SHAPE)
        alpha = np.where(kind == 1, random.uniform(0.01, 1, SHAPE), 0).astype(np.float32)
        colour = random.uniform(0, 4, (3, *SHAPE)).astype(np.float32)
        yield np.concatenate([alpha * colour, alpha[None], np.where(kind == 2, -1, 0)[None]]).astype(np.float32)


def fused(frames):
    fusion = FusedVolume.fresh(SHAPE)
    for frame in frames:
        fusion.add(frame)
    out = np.full((5, *SHAPE), np.nan, np.float32)
    fusion.write(out)
    return out


def test_nothing_seen_is_an_empty_volume():
    np.testing.assert_array_equal(fused([]), np.zeros((5, *SHAPE), np.float32))


def test_it_is_the_mean_over_the_frames_that_saw_a_voxel():
    frames = list(volumes(6, seed=1))
    out = fused(frames)
    for at in np.ndindex(SHAPE):
        seen = [frame[:, *at] for frame in frames if frame[3, *at] > 0 or frame[4, *at] < 0]
        wanted = np.mean([one[:4] for one in seen], axis=0) if seen else np.zeros(4)
        np.testing.assert_allclose(out[:4, *at], wanted, rtol=1e-5)
        assert out[4, *at] == (-1 if seen and all(one[3] == 0 for one in seen) else 0)
