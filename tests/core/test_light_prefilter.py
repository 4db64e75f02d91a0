import numpy as np
import pytest
from light_rooms import room

from roomlight.light.cube import CubeMap
from roomlight.light.cube_geometry import cube_directions, cube_solid_angles
from roomlight.light.prefilter import MIN_SIZE, prefilter


def weights(size):
    return np.tile(cube_solid_angles(size).reshape(-1), 6)


def dense(cube, size, roughness):
    """The slow reference: every texel of the cube into every texel of the level, by the formula."""
    n_l = cube_directions(size) @ cube_directions(cube.size).T
    n_h_squared = (1 + n_l) / 2  # the half vector halves the angle between normal and light
    alpha = roughness**2
    kernel = alpha**2 / (np.pi * (n_h_squared * (alpha**2 - 1) + 1) ** 2) * np.maximum(n_l, 0) * weights(cube.size)
    return kernel @ cube.faces.reshape(-1, 3) / kernel.sum(axis=1, keepdims=True)


def rms(difference):
    return np.sqrt(np.mean(np.square(difference)))


@pytest.mark.parametrize("size", [8, 16, 32, 64])
def test_white_furnace(size: int) -> None:
    mips = prefilter(CubeMap(np.broadcast_to(np.array([0.5, 1.0, 7.0], np.float32), (6, size, size, 3)).copy()))
    for level in mips.levels:
        np.testing.assert_allclose(level.faces, np.broadcast_to([0.5, 1.0, 7.0], level.faces.shape), rtol=1e-5)


def test_levels_and_roughness_are_stated() -> None:
    cube = CubeMap.from_panorama(room(60), size=64)
    mips = prefilter(cube)
    assert mips.levels[0] is cube  # the mirror image
    assert [level.size for level in mips.levels] == [64, 32, 16, 8, 4]
    assert mips.levels[-1].size == MIN_SIZE
    assert mips.roughness == (0, 0.25, 0.5, 0.75, 1)
    assert len(mips.to_bytes()) == sum(6 * size * size * 8 for size in (64, 32, 16, 8, 4))


def test_agrees_with_dense_integration() -> None:
    """Limits are twice the measured errors; a lamp of 3 degrees at 200 times the walls is the hard part."""
    cube = CubeMap.from_panorama(room(60), size=32)
    mips = prefilter(cube)
    for level, roughness, limit in list(zip(mips.levels, mips.roughness, (0, 0.05, 0.02, 0.02), strict=True))[1:]:
        expected, found = dense(cube, level.size, roughness), level.faces.reshape(-1, 3)
        assert rms(found - expected) < limit * expected.mean()
        assert np.abs(found - expected).max() < 0.06 * expected.max()


def test_keeps_the_light() -> None:
    """A lobe of the same shape in every direction moves light and adds none."""
    cube = CubeMap.from_panorama(room(120), size=32)
    mean = weights(32) @ cube.faces.reshape(-1, 3)
    for level in prefilter(cube).levels:
        np.testing.assert_allclose(weights(level.size) @ level.faces.reshape(-1, 3), mean, rtol=0.01)


@pytest.mark.parametrize("size", [1, 4, 12, 48])
def test_sizes_without_a_chain_of_levels(size: int) -> None:
    with pytest.raises(ValueError, match=f"a power of two of 8 pixels or more; got {size}"):
        prefilter(CubeMap(np.zeros((6, size, size, 3), np.float32)))
