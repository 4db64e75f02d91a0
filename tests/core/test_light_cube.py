import numpy as np
import pytest
from light_rooms import lit, mean_light, room

from roomlight.conventions import panorama_directions, panorama_solid_angles
from roomlight.light.cube import CubeMap, halved, observed_cube
from roomlight.light.cube_geometry import (
    FACES,
    cube_directions,
    cube_solid_angles,
    direction_to_face,
    face_to_direction,
    padded_indices,
    texel_index,
)
from roomlight.light.resample import panorama_to_cube

LEFT = TOP = 0.1
RIGHT = BOTTOM = 0.9
# Directions a little off a face's axis, and where OpenGL's table (s_c, t_c, m_a) puts them on that face.
CORNERS = [
    ("+X", (1, 0.8, 0.8), LEFT, TOP),
    ("+X", (1, -0.8, -0.8), RIGHT, BOTTOM),
    ("-X", (-1, 0.8, 0.8), RIGHT, TOP),
    ("-X", (-1, -0.8, -0.8), LEFT, BOTTOM),
    ("+Y", (0.8, 1, 0.8), RIGHT, BOTTOM),
    ("+Y", (-0.8, 1, -0.8), LEFT, TOP),
    ("-Y", (0.8, -1, 0.8), RIGHT, TOP),
    ("-Y", (-0.8, -1, -0.8), LEFT, BOTTOM),
    ("+Z", (0.8, 0.8, 1), RIGHT, TOP),
    ("+Z", (-0.8, -0.8, 1), LEFT, BOTTOM),
    ("-Z", (0.8, 0.8, -1), LEFT, TOP),
    ("-Z", (-0.8, -0.8, -1), RIGHT, BOTTOM),
]


def mean_of(cube):
    """Mean radiance over the sphere of a cube's faces, by solid angle."""
    return (cube.faces * cube_solid_angles(cube.size)[..., None]).sum(axis=(0, 1, 2), dtype=np.float64) / (4 * np.pi)


@pytest.mark.parametrize(("face", "direction", "across", "down"), CORNERS)
def test_a_lamp_is_in_the_corner_of_opengls_table(face, direction, across, down) -> None:
    size = 32
    faces = CubeMap.from_panorama(lit(120, [(direction, 4, 10.0)]), size=size).faces
    found, row, column = np.unravel_index(np.argmax(faces[..., 0]), faces.shape[:3])
    assert FACES[found] == face
    assert abs((column + 0.5) / size - across) < 0.06
    assert abs((row + 0.5) / size - down) < 0.06


def test_directions_and_faces_are_inverse() -> None:
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    face, across, down = direction_to_face(directions)
    assert np.abs([across, down]).max() <= 1
    np.testing.assert_allclose(face_to_direction(face, across, down), directions, atol=1e-12)


def test_texels_cover_the_sphere() -> None:
    for size in (1, 2, 16, 37):
        assert 6 * cube_solid_angles(size).sum() == pytest.approx(4 * np.pi, rel=1e-12)
    weighted = cube_directions(16) * np.tile(cube_solid_angles(16).reshape(-1), 6)[:, None]
    np.testing.assert_allclose(weighted.sum(axis=0), 0, atol=1e-12)


def test_a_step_beyond_an_edge_is_the_neighbouring_texel() -> None:
    size = 8
    directions = cube_directions(size)
    neighbours = padded_indices(size).reshape(6, size + 2, size + 2)
    own = np.arange(6 * size * size).reshape(6, size, size)
    np.testing.assert_array_equal(neighbours[:, 1:-1, 1:-1], own)
    for rim, inner in ((neighbours[:, 0, 1:-1], own[:, 0]), (neighbours[:, 1:-1, -1], own[:, :, -1])):
        assert (rim // size**2 != inner // size**2).all()
        # Texels on both sides of an edge are one texel apart there: 2 / 8 across a face of 90 degrees, seen slanted.
        cosines = (directions[rim] * directions[inner]).sum(axis=-1)
        assert np.degrees(np.arccos(cosines)).max() < 16
    one = np.array([0])
    assert texel_index(one, np.array([-1]), one, size=size)[0] == own[4, 0, 7]  # left of +X is +Z's right edge


@pytest.mark.parametrize(
    ("height", "size"),
    [
        (120, 16),
        (120, 64),
        (16, 128),
        pytest.param(16, 256, marks=pytest.mark.slow),
        (4, 16),
        (33, 32),
        (301, 32),
        (600, 16),
    ],
)
def test_keeps_the_light(height: int, size: int) -> None:
    noise = np.random.default_rng(size).random((height, 2 * height, 3), np.float32) ** 8 * 50
    # Rows that do not divide evenly are shared by area, not by solid angle, before they are resampled.
    rtol = 1e-4 if height in (16, 120) else 2e-3
    for panorama in (room(height), noise, lit(height, [], level=3.0)):
        cube = CubeMap.from_panorama(panorama, size=size)
        np.testing.assert_allclose(mean_of(cube), mean_light(panorama), rtol=rtol)
        assert cube.faces.min() >= panorama.min() * (1 - 1e-5)
        assert cube.faces.max() <= panorama.max() * (1 + 1e-5)


@pytest.mark.parametrize(("size", "height", "rms"), [(32, 120, 0.02), (64, 120, 0.01)])
def test_cube_to_panorama_to_cube(size: int, height: int, rms: float) -> None:
    """Light with detail of 20 degrees is recovered; a constant and the mean up to rounding."""
    directions = panorama_directions(height)
    smooth = (1 + np.cos(9 * directions[..., :1]) * directions[..., 1:2] + 0.5 * directions).astype(np.float32)
    cube = CubeMap.from_panorama(smooth, size=size)
    there = cube.to_panorama(height)
    back = CubeMap.from_panorama(there, size=size)
    assert np.sqrt(np.mean((there - smooth) ** 2)) < rms
    assert np.sqrt(np.mean((back.faces - cube.faces) ** 2)) < rms
    np.testing.assert_allclose(mean_light(there), mean_of(cube), rtol=1e-4)
    np.testing.assert_allclose(mean_of(back), mean_of(cube), rtol=1e-4)
    even = CubeMap(np.full((6, size, size, 3), 2.5, np.float32))
    np.testing.assert_allclose(even.to_panorama(height), 2.5, rtol=1e-5)


def test_texels_are_the_means_of_what_they_cover() -> None:
    """Against a slow reference: pixels of a much finer panorama, each counted in the texel its centre falls in."""
    coarse = CubeMap.from_panorama(room(120), size=16)
    fine = np.repeat(np.repeat(room(120), 5, axis=0), 5, axis=1)
    directions = panorama_directions(600).reshape(-1, 3).astype(np.float64)
    face, across, down = direction_to_face(directions)
    column, row = (np.clip(((t + 1) * 8).astype(int), 0, 15) for t in (across, down))
    texel = texel_index(face, column, row, size=16)
    weight = np.repeat(panorama_solid_angles(600)[:, 0], 1200)
    sums = np.stack([np.bincount(texel, weight * fine[..., c].reshape(-1), 6 * 256) for c in range(3)], axis=-1)
    expected = sums / np.bincount(texel, weight, 6 * 256)[:, None]
    found = coarse.faces.reshape(-1, 3)
    # The kernel reads pixels bilinearly: a lamp's edge is a pixel (a quarter of a texel) softer.
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.12 * np.sqrt(np.mean(expected**2))
    assert np.median(np.abs(found / expected - 1)) < 1e-3


def test_the_sparse_kernel_equals_its_matrix() -> None:
    resample = panorama_to_cube(16, 16)
    matrix = np.zeros((6 * 256, 16 * 32))
    np.add.at(matrix, (np.repeat(np.arange(6 * 256), np.diff(resample.starts)), resample.sources), resample.weights)
    values = np.random.default_rng(0).random((16 * 32, 5), np.float32)
    np.testing.assert_allclose(resample(values), matrix @ values, rtol=1e-5)
    np.testing.assert_allclose(matrix.sum(axis=1), 1, rtol=1e-6)
    assert matrix.min() >= 0


def test_halved_faces_keep_the_light() -> None:
    cube = CubeMap.from_panorama(room(60), size=32)
    np.testing.assert_allclose(mean_of(CubeMap(halved(cube.faces))), mean_of(cube), rtol=1e-5)


def test_half_floats_bytes_and_alpha() -> None:
    faces = np.random.default_rng(0).random((6, 16, 16, 3)).astype(np.float32)
    faces[2, 0, 0] = [1e9, -1e9, 0.5]
    cube = CubeMap(faces)
    image = cube.rgba16f()
    assert image.dtype == np.float16
    assert image[2, 0, 0].tolist() == [65504, -65504, 0.5, 1]
    assert (image[..., 3] == 1).all()
    np.testing.assert_allclose(image[3, ..., :3], faces[3], atol=2**-11)
    data = cube.to_bytes()
    assert len(data) == 6 * 16 * 16 * 8
    at = 8 * ((4 * 16 + 3) * 16 + 5)  # face +Z, row 3, column 5
    np.testing.assert_array_equal(np.frombuffer(data[at : at + 8], "<f2"), image[4, 3, 5])
    alpha = np.linspace(0, 1, 6 * 256).reshape(6, 16, 16)
    np.testing.assert_allclose(cube.rgba16f(alpha)[..., 3], alpha, atol=2**-11)


def test_observed_cube_shows_what_was_seen() -> None:
    observed = (panorama_directions(64)[..., 1] > 0).astype(np.float32)  # the upper half
    alpha = observed_cube(observed, size=16)
    assert alpha.shape == (6, 16, 16)
    assert alpha[2].min() > 0.99  # +Y
    assert alpha[3].max() < 0.01
    assert alpha[0, :7].min() > 0.99  # the upper rows of +X
    assert alpha[0, 9:].max() < 0.01
    assert (alpha * cube_solid_angles(16)).sum() == pytest.approx(2 * np.pi, rel=1e-4)
    tall = observed_cube(np.ones((600, 1200), np.float32), size=16)
    np.testing.assert_allclose(tall, 1, rtol=1e-5)


def test_panoramas_and_sizes_out_of_range() -> None:
    cube = CubeMap.from_panorama(room(16), size=16)
    for size in (0, 1, 15, 48, 512, -16):
        with pytest.raises(ValueError, match=f"16, 32, 64, 128, 256 pixels, got {size}"):
            CubeMap.from_panorama(room(16), size=size)
        with pytest.raises(ValueError, match=f"got {size}"):
            observed_cube(np.zeros((16, 32), np.float32), size=size)
    for height in (0, 3, 513):
        with pytest.raises(ValueError, match=f"4 to 512 rows, got {height}"):
            cube.to_panorama(height)
    with pytest.raises(ValueError, match="up to 256 pixels"):
        CubeMap(np.zeros((6, 512, 512, 3), np.float32)).to_panorama(16)
    with pytest.raises(ValueError, match="twice as wide"):
        CubeMap.from_panorama(np.zeros((16, 16, 3), np.float32))
    faces = np.zeros((6, 4, 4, 3), np.float32)
    faces[5, 1, 2, 0] = np.inf
    with pytest.raises(ValueError, match=r"face -Z, row 1, column 2"):
        CubeMap(faces)
