"""Materials: energy, the lobe's table, and what is refused. The BRDFs' twin is `shading_reference`."""

from dataclasses import replace

import numpy as np
import pytest
from kernel_calls import compiled
from shading_reference import bilinear, exact_plane_radiance, lobe_share, look_at, paths, plane_radiance

from roomlight.camera import Intrinsics
from roomlight.compositing.kernels.surfaces import read_texture
from roomlight.compositing.light.lighting import LightSampler, ProbeSet
from roomlight.compositing.objects.materials import Material, diffuse, glass, glossy, lobe_table, mirror, rough_metal
from roomlight.compositing.objects.primitives import plane
from roomlight.compositing.objects.textures import MAX_TEXTURE_SIZE, Texture, texture_arrays
from roomlight.compositing.rendering.renderer import render_objects
from roomlight.compositing.rendering.tracer import TracedObjects
from roomlight.conventions import panorama_directions, panorama_solid_angles
from roomlight.errors import ObjectError

WHITE = np.ones((16, 32, 3), np.float32)
"""The white furnace: the same light from everywhere."""
ONES = (1.0, 1.0, 1.0)
LAYERED = Material(ONES, clearcoat=0.7, clearcoat_roughness=0.2, sheen=ONES, sheen_roughness=0.5)


@pytest.mark.parametrize("degrees", [0.0, 45.0, 60.0, 80.0])
@pytest.mark.parametrize(
    ("material", "samples", "tolerance"),
    [
        # 16,384 paths: the noise of a mean is below 0.002 where paths differ at all
        *((one, 256, 0.004) for one in (mirror(), diffuse(ONES), glossy(ONES), glass(), LAYERED)),
        # the table is read between its cosines
        *((rough_metal(roughness), 1024, 0.01) for roughness in (0.1, 0.25, 0.5, 1.0)),
        *((Material(ONES, metallic=metallic, roughness=0.5), 1024, 0.006) for metallic in (0.25, 0.5, 0.75)),
    ],
)
def test_white_materials_keep_all_light(material: Material, samples: int, tolerance: float, degrees: float) -> None:
    assert plane_radiance(material, WHITE, degrees, samples=samples).mean() == pytest.approx(1, abs=tolerance)


def test_lobe_table_agrees_with_dense_integration() -> None:
    table = lobe_table()
    for row, column in ((20, 12), (40, 20), (63, 31)):
        cosine, roughness = row / 63, column / 31
        view = np.array([np.sqrt(1 - cosine**2), cosine, 0])
        both = [float(lobe_share(view, roughness**2, *pair)) for pair in ((1.0, 0.0), (0.0, 1.0))]
        np.testing.assert_allclose(table[row, column, :2], both, atol=0.004)
        light = panorama_directions(512).reshape(-1, 3).astype(float)
        weight = np.repeat(panorama_solid_angles(512)[:, 0].astype(float), 1024) * np.maximum(light[:, 1], 0)
        n_h = (light + view)[:, 1] / np.linalg.norm(light + view, axis=1)
        power = 1 / roughness**2
        charlie = (2 + power) * np.sqrt(1 - np.minimum(n_h, 1) ** 2) ** power / (2 * np.pi)
        visible = 1 / (4 * np.maximum(light[:, 1] + cosine - light[:, 1] * cosine, 1e-9))
        assert table[row, column, 2] == pytest.approx((charlie * visible * weight).sum(), abs=0.004)


def test_a_clear_coat_reflects_by_fresnel_over_what_is_under_it() -> None:
    panorama = np.random.default_rng(5).random((16, 32, 3)).astype(np.float32)
    panorama[3, 5] = 20
    for roughness, degrees in ((0.4, 40.0), (0.7, 75.0)):
        coated = Material((0.6, 0.3, 0.1), roughness=0.6, clearcoat=0.8, clearcoat_roughness=roughness)
        values = plane_radiance(coated, panorama, degrees, samples=1024)
        coat = exact_plane_radiance(rough_metal(roughness), panorama, degrees)
        under = exact_plane_radiance(replace(coated, clearcoat=0.0), panorama, degrees)
        share = 0.8 * (0.04 + 0.96 * (1 - np.cos(np.radians(degrees))) ** 5)
        exact = under + share * (coat - under)
        assert np.all(np.abs(values.mean(axis=0) - exact) < 4 * values.std(axis=0) / 8 + 0.006 * exact)


def test_sheen_takes_its_share_from_what_is_under_it() -> None:
    cloth = Material((0.5, 0.5, 0.5), specular=0.0, sheen=(0.8, 0.4, 0.0), sheen_roughness=12 / 31)
    share = lobe_table()[20, 12, 2]
    values = plane_radiance(cloth, WHITE, np.degrees(np.arccos(20 / 63)), samples=256).mean(axis=0)
    np.testing.assert_allclose(values, np.array([0.8, 0.4, 0.0]) * share + 0.5 * (1 - 0.8 * share), atol=0.004)


def test_relief_is_under_the_coat() -> None:
    """A normal texture that leans by 30 degrees turns what the base reflects, not what a smooth coat does."""
    leaning = np.full((1, 1, 3), (255, 128, 221), np.uint8)
    panorama = np.zeros((32, 64, 3), np.float32)
    panorama[7:9] = 1.0  # a ring: at 45 degrees the mirrored ray meets it
    coat = Material((0.0, 0.0, 0.0), specular=0.0, clearcoat=1.0, normal_texture=Texture.from_linear8(leaning))
    values = [plane_radiance(each, panorama, 45.0, samples=64).mean() for each in (coat, replace(coat, clearcoat=0.0))]
    assert values[0] == pytest.approx(0.042, abs=0.002)
    assert values[1] == 0


@pytest.mark.parametrize(
    "material",
    [
        Material((0.5, 0.2, 0.1), specular=0.0, clearcoat=1.0, clearcoat_roughness=0.3),
        Material((0.1, 0.1, 0.1), specular=0.0, sheen=(0.9, 0.5, 0.1), sheen_roughness=0.6),
    ],
)
def test_layers_look_the_same_in_previews(material: Material) -> None:
    item = TracedObjects([plane(1000.0, 1000.0, material)])
    camera, pose = Intrinsics(800.0, 800.0, 4.0, 4.0, 8, 8), look_at(np.array([900.0, 400.0, 0.0]), np.zeros(3))
    light = ProbeSet.single(np.linspace(2, 0.5, 16, dtype=np.float32)[:, None, None] * np.ones((1, 32, 3), np.float32))
    traced, preview = (
        render_objects(item, camera, pose, light, quality=quality).radiance.mean(axis=(0, 1))
        for quality in (paths(1024), "preview")
    )
    np.testing.assert_allclose(preview, traced, rtol=0.06)


@pytest.mark.parametrize(
    "material", [glossy(), rough_metal(0.3, (0.9, 0.6, 0.3)), Material(metallic=0.5, roughness=0.6)]
)
def test_shading_agrees_with_the_readable_brdf(material: Material) -> None:
    panorama = np.random.default_rng(5).random((16, 32, 3)).astype(np.float32)
    panorama[3, 5] = 20
    values = plane_radiance(material, panorama, 40.0, samples=512)
    exact = exact_plane_radiance(material, panorama, 40.0)
    error = values.std(axis=0) / 8  # of the mean of 64 pixels
    assert np.all(np.abs(values.mean(axis=0) - exact) < 4 * error + 0.004 * exact)


@pytest.mark.slow
def test_light_and_lobe_sampling_agree_under_a_small_lamp() -> None:
    panorama = np.full((32, 64, 3), 0.1, np.float32)
    panorama[8, 20] = 500.0  # 6 degrees wide: nearly all of the light
    for material in (diffuse(), rough_metal(0.2), rough_metal(0.7)):
        values = plane_radiance(material, panorama, 30.0, samples=256)
        exact = exact_plane_radiance(material, panorama, 30.0)
        error = values.std(axis=0) / 8
        assert np.all(np.abs(values.mean(axis=0) - exact) < 4 * error + 0.006 * exact), material
        # one kind of sampling alone would scatter by more than the mean itself
        assert values.std() < 0.2 * values.mean()


def test_samples_of_the_light_integrate_to_its_power() -> None:
    rng = np.random.default_rng(2)
    panorama = rng.random((24, 48, 3)).astype(np.float32) ** 4
    panorama[5, 7] = 100
    sampler = LightSampler(panorama)
    directions, density = sampler.sample(rng.random((100_000, 2)))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-5)
    rows = 8 * len(panorama)
    power = (bilinear(panorama, rows) * panorama_solid_angles(rows)[..., None]).sum(axis=(0, 1))
    estimates = sampler.radiance(directions) / density[:, None]
    error = estimates.std(axis=0) / np.sqrt(len(estimates))
    assert np.all(np.abs(estimates.mean(axis=0) - power) < 4 * error + 0.002 * power)


def test_black_panorama_is_sampled_evenly() -> None:
    sampler = LightSampler(np.zeros((8, 16, 3), np.float32))
    _, density = sampler.sample(np.random.default_rng(0).random((100, 2)))
    np.testing.assert_allclose(density, 1 / (4 * np.pi), rtol=1e-5)


def test_probe_weights_are_one_at_a_probe_and_sum_to_one() -> None:
    first = LightSampler(WHITE, (0.0, 0.0, 0.0))
    probes = ProbeSet([first, LightSampler(WHITE * 3, (2.0, 0.0, 0.0))])
    np.testing.assert_allclose(probes.weights((0.0, 0.0, 0.0)), [1, 0], atol=1e-6)
    np.testing.assert_allclose(probes.weights((1.0, 0.0, 0.0)), [0.5, 0.5], atol=1e-6)
    middle = probes.mixed((1.0, 0.0, 0.0)).radiance(np.array([[0.0, 1, 0]]))
    np.testing.assert_allclose(middle, [[2, 2, 2]], atol=1e-5)


@pytest.mark.parametrize("values", [
    {"roughness": 1.5}, {"metallic": -0.1}, {"base_colour": (0.5, 2.0, 0.5)}, {"ior": 0.5}, {"opacity": float("nan")},
    {"emissive": (float("inf"), 0.0, 0.0)}, {"alpha_cutoff": 2.0},
])  # fmt: skip
def test_material_values_out_of_range_are_refused(values: dict) -> None:
    with pytest.raises(ObjectError, match=next(iter(values))):
        Material(**values)


def test_textures_are_reduced_to_the_limit_and_not_empty() -> None:
    texture = Texture.from_srgb8(np.full((4, 3000, 3), 255, np.uint8))
    assert texture.texels.shape[1] == MAX_TEXTURE_SIZE
    assert texture.texels.min() == 65535
    with pytest.raises(ObjectError, match="texel"):
        Texture(np.zeros((0, 4, 4), np.uint16))


def test_emission_is_added_to_reflection() -> None:
    lamp = Material(base_colour=(0.0, 0.0, 0.0), specular=0.0, emissive=(2.0, 1.0, 0.5))
    lit = plane_radiance(lamp, WHITE, 20.0, samples=1)
    np.testing.assert_allclose(lit[0], [2, 1, 0.5], rtol=1e-5)


def test_bent_normals_throw_no_light_into_the_surface() -> None:
    steep = Texture.from_linear(np.array([[[0.5 + np.sqrt(0.75) / 2, 0.5, 0.75]]], np.float32))  # 60 degrees
    for material in (mirror(), rough_metal(0.1)):
        values = plane_radiance(replace(material, normal_texture=steep), WHITE, 0.0, samples=64)
        assert values.mean() == pytest.approx(1, abs=0.02)


def test_clamped_textures_go_on_with_their_edges() -> None:
    image = np.array([[[0.0] * 3, [1.0] * 3]], np.float32)
    plain = Texture.from_linear(image)
    arrays = texture_arrays([plain, replace(plain, clamped=(True, False))])
    assert [compiled(read_texture)(arrays, 0, u, 0.5)[0] for u in (1.25, 1.75)] == [0, 1]
    assert [compiled(read_texture)(arrays, 1, u, 0.5)[0] for u in (-0.3, 0.25, 0.5, 0.75, 1.25)] == [0, 0, 0.5, 1, 1]


def test_textures_colour_the_surface_by_its_uvs() -> None:
    image = np.zeros((2, 2, 3), np.float32)
    image[0, 0], image[0, 1], image[1, 0], image[1, 1] = (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)
    material = Material(base_colour=(1.0, 1.0, 1.0), specular=0.0, base_colour_texture=Texture.from_linear(image))
    scene = TracedObjects([plane(2.0, 2.0, material)])
    camera = Intrinsics(40.0, 40.0, 20.0, 20.0, 40, 40)
    # from above, image right = +x (u), image down = +z (v)
    pose = look_at((0, 2, 0), (0, 0, 0))
    picture = render_objects(scene, camera, pose, ProbeSet.single(WHITE), quality=paths(16, 2))
    for row, column, colour in ((10, 10, (1, 0, 0)), (10, 29, (0, 1, 0)), (29, 10, (0, 0, 1)), (29, 29, (1, 1, 1))):
        np.testing.assert_allclose(picture.radiance[row, column], colour, atol=0.06)
