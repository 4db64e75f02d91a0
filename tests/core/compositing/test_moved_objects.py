"""Objects that move together: rays, surfaces and light are those of a scene built anew."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from shading_reference import moved

from roomlight.compositing.light.lighting import LightSampler, ProbeSet
from roomlight.compositing.objects.materials import diffuse, mirror
from roomlight.compositing.objects.primitives import cube, plane, sphere
from roomlight.compositing.objects.textures import Texture
from roomlight.compositing.rendering.light_samples import light_samples
from roomlight.compositing.rendering.tracer import TracedObjects


def turned(angle: float = 0.7) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 0] = pose[2, 2] = np.cos(angle)
    pose[0, 2], pose[2, 0] = np.sin(angle), -np.sin(angle)
    pose[:3, 3] = 0.3, -0.2, 1.1
    return pose


def objects() -> list:
    return [sphere(0.2, mirror()), moved(cube(0.3, diffuse((0.5, 0.4, 0.3))), 0.6, 0.1)]


def test_moved_scene_is_a_scene_built_anew() -> None:
    shifted = TracedObjects(objects()).moved(np.eye(4)).moved(turned())  # moves count from the first place
    built = TracedObjects([one.transformed(turned()) for one in objects()])
    rng = np.random.default_rng(0)
    origins = rng.uniform(-1, 2, (4000, 3)).astype(np.float32)
    toward = np.array([0.5, -0.2, 0.9]) + rng.normal(0, 0.3, (4000, 3)) - origins
    directions = (toward / np.linalg.norm(toward, axis=1, keepdims=True)).astype(np.float32)
    a, b = shifted.trace(origins, directions), built.trace(origins, directions)
    same = a.face == b.face
    assert same.mean() > 0.999  # a ray through an edge may meet either triangle
    assert (a.face >= 0).mean() > 0.3
    hit = same & (a.face >= 0)
    assert_allclose(a.distance_m[hit], b.distance_m[hit], atol=1e-4)
    assert (shifted.blocked(origins, directions) == built.blocked(origins, directions)).mean() > 0.999
    for name in ("corners", "normals"):
        assert_allclose(getattr(shifted.surfaces, name), getattr(built.surfaces, name), atol=1e-6)
    assert_array_equal(shifted.surfaces.object_id, built.surfaces.object_id)
    assert_allclose(shifted.bounds, built.bounds, atol=1e-6)


def test_a_scene_built_anew_takes_the_textures_of_the_same_materials() -> None:
    image = np.arange(192, dtype=np.uint8).reshape(8, 8, 3)
    painted = [replace(diffuse(), base_colour_texture=Texture.from_srgb8(image + np.uint8(k))) for k in range(2)]
    first = TracedObjects([sphere(0.2, painted[0]), cube(0.3, painted[1])])
    same = TracedObjects([item.transformed(turned()) for item in first.objects], like=first.moved(turned()))
    assert same.textures is first.textures
    assert same.texture_means() is first.texture_means()
    other = TracedObjects(first.objects[::-1], like=first)
    assert_allclose(other.texture_means(), first.texture_means()[[1, 0, 2]])


def test_a_turned_plate_shades_less_ground() -> None:
    lying = TracedObjects([plane(0.4, 0.4)])
    before = lying.shade_radii[0]
    upright = np.eye(4)
    upright[1:3, 1:3] = [[0, -1], [1, 0]]
    assert lying.moved(upright).shade_radii[0] < 0.1 * before
    assert lying.moved(turned()).shade_radii[0] == pytest.approx(before, rel=1e-5)
    with pytest.raises(ValueError, match="rigid"):
        lying.moved(np.diag([1.01, 1.01, 1.01, 1.0]))


def test_samples_of_mixed_light_rest_while_the_shares_change() -> None:
    rng = np.random.default_rng(1)
    first = LightSampler(rng.random((16, 32, 3)).astype(np.float32), (0.0, 0.0, 0.0))
    second = LightSampler(rng.random((16, 32, 3)).astype(np.float32) * 3, (1.0, 0.0, 0.0))
    probes = ProbeSet([first, second])
    left, right = (light_samples(probes.mixed((x, 0.0, 0.0)), 16) for x in (0.2, 0.7))
    assert_array_equal(left.directions, right.directions)
    assert not np.allclose(left.weights, right.weights)


def test_samples_of_mixed_light_estimate_its_irradiance() -> None:
    rng = np.random.default_rng(2)
    panoramas = [rng.random((16, 32, 3)).astype(np.float32) * scale for scale in (1, 4)]
    probes = ProbeSet([LightSampler(one, (float(k), 0.0, 0.0)) for k, one in enumerate(panoramas)])
    mixed = probes.mixed((0.4, 0.0, 0.0))
    up = np.array([0.0, 1.0, 0.0])
    samples = light_samples(mixed, 64, toward=up)
    estimate = (samples.weights * np.maximum(samples.directions @ up, 0)[..., None]).sum(axis=1).mean(axis=0)
    single = light_samples(LightSampler(mixed.panorama), 64, toward=up)
    direct = (single.weights * np.maximum(single.directions @ up, 0)[..., None]).sum(axis=1).mean(axis=0)
    assert_allclose(estimate, direct, rtol=0.01)  # 1,024 samples each
