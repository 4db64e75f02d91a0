import itertools

import numpy as np
import pytest
from light_rooms import lit, room, rotate_directions_90, rotate_panorama_90

from roomlight.light.cube import CubeMap
from roomlight.light.cube_geometry import cube_directions, cube_solid_angles, direction_to_face, texel_index
from roomlight.light.prefilter import MIN_SIZE, prefilter
from roomlight.light.spherical_harmonics import project


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
    mips = prefilter(CubeMap.from_panorama(room(60), size=64))
    assert [level.size for level in mips.levels] == [64, 32, 16, 8, 4]
    assert mips.levels[-1].size == MIN_SIZE
    assert mips.roughness == (0, 0.25, 0.5, 0.75, 1)
    assert len(mips.to_bytes()) == sum(6 * size * size * 8 for size in (64, 32, 16, 8, 4))


def test_the_first_level_is_the_mirror_image() -> None:
    cube = CubeMap.from_panorama(room(60), size=16)
    assert prefilter(cube).levels[0] is cube


def test_agrees_with_dense_integration() -> None:
    """Limits are twice the measured errors; a lamp of 3 degrees at 200 times the walls is the hard part."""
    cube = CubeMap.from_panorama(room(120), size=32)
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


def test_the_roughest_level_is_irradiance_over_pi() -> None:
    panorama = room(120)
    level = prefilter(CubeMap.from_panorama(panorama, size=64)).levels[-1]
    irradiance = project(panorama).irradiance().evaluate(cube_directions(level.size)) / np.pi
    found = level.faces.reshape(-1, 3)
    # Nine harmonics of a cosine are themselves 4 % rms off (see the harmonics' own test).
    assert rms(found - irradiance) < 0.05 * irradiance.mean()


def test_rougher_is_smoother() -> None:
    mips = prefilter(CubeMap.from_panorama(lit(120, [((1, 0.2, 0.3), 4, 50.0)], level=0.2), size=64))
    peaks = [level.faces.max() for level in mips.levels]
    assert all(a > 1.3 * b for a, b in itertools.pairwise(peaks))
    assert min(level.faces.min() for level in mips.levels) > 0.19


@pytest.mark.parametrize("axis", range(6))
def test_lobes_stay_about_their_lamp(axis: int) -> None:
    lamp = np.zeros(3)
    lamp[axis // 2] = 1 - 2 * (axis % 2)
    for level in prefilter(CubeMap.from_panorama(lit(120, [(lamp, 4, 10.0)]), size=32)).levels:
        pull = (level.faces[..., 0].reshape(-1) * weights(level.size)) @ cube_directions(level.size)
        assert pull @ lamp / np.linalg.norm(pull) > 0.999


def test_turning_the_room_turns_every_level() -> None:
    before = prefilter(CubeMap.from_panorama(room(120), size=32))
    after = prefilter(CubeMap.from_panorama(rotate_panorama_90(room(120)), size=32))
    for a, b in zip(before.levels[1:], after.levels[1:], strict=True):
        face, across, down = direction_to_face(rotate_directions_90(cube_directions(a.size)))
        column, row = (np.floor((t + 1) / 2 * a.size).astype(int) for t in (across, down))
        moved = b.faces.reshape(-1, 3)[texel_index(face, column, row, size=a.size)]
        # Samples fall differently about a rotated normal: twice the error of sampling.
        assert rms(moved - a.faces.reshape(-1, 3)) < 0.08 * a.faces.mean()


@pytest.mark.parametrize("size", [1, 4, 12, 48])
def test_sizes_without_a_chain_of_levels(size: int) -> None:
    with pytest.raises(ValueError, match=f"a power of two of 8 pixels or more; got {size}"):
        prefilter(CubeMap(np.zeros((6, size, size, 3), np.float32)))
