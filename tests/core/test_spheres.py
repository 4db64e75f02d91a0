import numpy as np
import pytest
from light_rooms import room

from roomlight.conventions import panorama_directions, panorama_solid_angles
from roomlight.spheres import (
    GLOSSY_ALBEDO,
    GLOSSY_F0,
    GLOSSY_ROUGHNESS,
    MATTE_ROUGHNESS,
    Material,
    SphereRenderer,
    resize_panorama,
    view_toward,
)

MATERIALS: tuple[Material, ...] = ("mirror", "glossy", "matte", "diffuse")
VIEW = (0.3, -0.2, -1.0)


def dense(spheres: SphereRenderer, panorama: np.ndarray, material: Material) -> np.ndarray:
    """The slow reference: every pixel of the panorama into every pixel of the sphere, by the formulas."""
    height = len(panorama)
    light = panorama_directions(height).reshape(-1, 3).astype(np.float64)
    solid_angle = np.repeat(panorama_solid_angles(height)[:, 0], 2 * height)
    radiance = panorama.reshape(-1, 3)
    viewer = -np.array(VIEW) / np.linalg.norm(VIEW)
    half = light + viewer
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    pixels = []
    for normal in spheres.normals.astype(np.float64):
        n_l, n_v = np.maximum(light @ normal, 0), normal @ viewer
        if material == "diffuse":
            brdf = np.full(len(light), 1 / np.pi)
        else:
            roughness = GLOSSY_ROUGHNESS if material == "glossy" else MATTE_ROUGHNESS
            alpha, k = roughness**2, (roughness + 1) ** 2 / 8
            n_h, v_h = half @ normal, half @ viewer
            distribution = alpha**2 / (np.pi * (n_h**2 * (alpha**2 - 1) + 1) ** 2)
            shadowing = n_l / (n_l * (1 - k) + k) * n_v / (n_v * (1 - k) + k)
            fresnel = GLOSSY_F0 + (1 - GLOSSY_F0) * 2 ** ((-5.55473 * v_h - 6.98316) * v_h)
            brdf = distribution * shadowing / np.maximum(4 * n_l * n_v, 1e-12)
            if material == "glossy":
                brdf = GLOSSY_ALBEDO / np.pi + fresnel * brdf
            else:
                brdf /= (brdf * n_l * solid_angle).sum()
        pixels.append((brdf * n_l * solid_angle) @ radiance)
    return np.array(pixels)


@pytest.mark.parametrize(
    ("material", "of_mean", "rms"),
    # The limits are twice the measured errors: 64 samples for the lobe, 32 and 16 rows for matte and diffuse.
    [("glossy", 0.01, 0.03), ("matte", 0.01, 0.12), ("diffuse", 0.01, 0.03)],
)
def test_spheres_agree_with_dense_integration(material: Material, of_mean: float, rms: float) -> None:
    spheres = SphereRenderer(VIEW, size=20)
    panorama = room(120)
    expected = dense(spheres, panorama, material)
    pixels = spheres.pixels(panorama, material)
    assert pixels.mean() == pytest.approx(expected.mean(), rel=of_mean)
    assert np.sqrt(np.mean((pixels - expected) ** 2)) < rms * expected.mean()


@pytest.mark.parametrize("height", [8, 60, 120, 250])
@pytest.mark.parametrize("material", ["mirror", "matte", "diffuse"])
def test_white_furnace(material: Material, height: int) -> None:
    spheres = SphereRenderer((1.0, 0.5, 0.2), size=16)
    panorama = np.broadcast_to(np.array([0.5, 1.0, 7.0], np.float32), (height, 2 * height, 3)).copy()
    pixels = spheres.pixels(panorama, material)
    np.testing.assert_allclose(pixels, np.broadcast_to(panorama[0, 0], pixels.shape), rtol=1e-5)


def test_the_glossy_sphere_adds_no_energy() -> None:
    pixels = SphereRenderer(VIEW, size=32).pixels(np.ones((120, 240, 3), np.float32), "glossy")
    assert (pixels > GLOSSY_ALBEDO + 0.03).all()
    assert (pixels < 1.0).all()


@pytest.mark.parametrize(
    ("light", "column", "row"),
    [
        ((0.0, 0.0, 1.0), 0.5, 0.5),  # behind the camera: the middle of the sphere
        ((1.0, 0.0, 0.0), 0.5 + 0.5 * np.sin(np.pi / 4), 0.5),  # to the right
        ((-1.0, 0.0, 0.0), 0.5 - 0.5 * np.sin(np.pi / 4), 0.5),
        ((0.0, 1.0, 0.0), 0.5, 0.5 - 0.5 * np.sin(np.pi / 4)),  # above: nearer to row 0
        ((0.0, -1.0, 0.0), 0.5, 0.5 + 0.5 * np.sin(np.pi / 4)),
    ],
)
def test_the_mirror_shows_a_light_where_it_is(light: tuple[float, float, float], column: float, row: float) -> None:
    directions = panorama_directions(90)
    panorama = np.repeat(((directions @ np.array(light, np.float32)) > 0.995).astype(np.float32)[..., None], 3, axis=2)
    spheres = SphereRenderer((0.0, 0.0, -1.0), size=64)
    image = spheres.render(panorama, "mirror")[..., 0] * spheres.mask
    rows, columns = np.nonzero(image > 0.5)
    assert (columns.mean() + 0.5) / 64 == pytest.approx(column, abs=0.02)
    assert (rows.mean() + 0.5) / 64 == pytest.approx(row, abs=0.02)


@pytest.mark.parametrize("view", [(0.0, -1.0, 0.0), (0.0, 2.0, 0.0)])
def test_straight_down_and_up_are_views_too(view: tuple[float, float, float]) -> None:
    spheres = SphereRenderer(view, size=16)
    assert np.isfinite(spheres.pixels(room(30), "glossy")).all()


def test_views_and_sizes_are_checked() -> None:
    for view in ((0.0, 0.0, 0.0), (float("nan"), 0.0, 1.0)):
        with pytest.raises(ValueError, match="not zero"):
            SphereRenderer(view)
    with pytest.raises(ValueError, match="4 pixels or more, got 2"):
        SphereRenderer(VIEW, size=2)
    with pytest.raises(ValueError, match="twice as wide"):
        SphereRenderer(VIEW).pixels(np.zeros((10, 10, 3), np.float32), "mirror")


def test_mask_and_coverage_are_a_disc() -> None:
    spheres = SphereRenderer(VIEW, size=64)
    area = np.pi / 4 * 64**2
    assert spheres.mask.sum() == pytest.approx(area, rel=0.01)
    assert spheres.coverage.sum() == pytest.approx(area, rel=0.002)
    assert len(spheres.normals) == spheres.mask.sum()
    np.testing.assert_allclose(np.linalg.norm(spheres.normals, axis=-1), 1, rtol=1e-5)


def test_the_view_toward_a_probe() -> None:
    pose = np.eye(4)
    pose[:3, 3] = [1.0, 2.0, 3.0]
    assert view_toward(pose, (1.0, 2.0, 1.0)) == pytest.approx((0.0, 0.0, -2.0))
    assert view_toward(pose, (1.0, 2.0, 3.0)) == pytest.approx((0.0, 0.0, -1.0))


@pytest.mark.parametrize(("height", "rows"), [(120, 60), (120, 16), (120, 50), (33, 8)])
def test_shrinking_a_panorama_keeps_its_light(height: int, rows: int) -> None:
    panorama = room(height)
    small = resize_panorama(panorama, rows)
    energy = (panorama * panorama_solid_angles(height)[..., None]).sum(axis=(0, 1))
    # where the rows are not a multiple, a row on a border is split by area in the image, not on the sphere
    np.testing.assert_allclose(
        (small * panorama_solid_angles(rows)[..., None]).sum(axis=(0, 1)), energy, rtol=0.02 if height % rows else 1e-3
    )


def test_enlarging_a_panorama_wraps_and_keeps_its_range() -> None:
    panorama = room(30)
    large = resize_panorama(panorama, 60)
    assert large.shape == (60, 120, 3)
    assert large.min() >= panorama.min() - 1e-5
    assert large.max() <= panorama.max() + 1e-5
    # 3/4 and 1/4 of the two columns at the seam
    expected = 0.75 * panorama[:, 0] + 0.25 * panorama[:, -1]
    expected = 0.75 * expected[10] + 0.25 * expected[9]
    np.testing.assert_allclose(large[20, 0], expected, rtol=0.02)
    assert resize_panorama(panorama, 30) is panorama
