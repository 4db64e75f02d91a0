"""Agreement with Mitsuba 3, an unbiased path tracer: a sphere of each material under a panorama with a lamp."""

from types import ModuleType

import numpy as np
import pytest
from shading_reference import lit_room, look_at, paths

from roomlight.camera import Intrinsics
from roomlight.compositing.light.lighting import LightSampler, ProbeSet
from roomlight.compositing.objects.materials import Material, diffuse, glass, rough_metal
from roomlight.compositing.objects.primitives import sphere
from roomlight.compositing.rendering.renderer import render_objects
from roomlight.compositing.rendering.tracer import TracedObjects

SIZE = 24


@pytest.fixture(scope="module")
def mitsuba() -> ModuleType:
    module = pytest.importorskip("mitsuba")
    module.set_variant("scalar_rgb")
    return module


def _mitsuba_panorama(panorama: np.ndarray) -> np.ndarray:
    """Resample so that Mitsuba, whose panorama looks along -z at its centre, reads it by the same directions."""
    rows = len(panorama) * 4
    theta = (np.arange(rows) + 0.5) / rows * np.pi
    phi = (np.arange(2 * rows) + 0.5) / (2 * rows) * 2 * np.pi
    # Mitsuba: u = atan2(x, -z) / 2 pi
    x = np.sin(theta)[:, None] * np.sin(phi)
    z = -np.sin(theta)[:, None] * np.cos(phi)
    y = np.broadcast_to(np.cos(theta)[:, None], x.shape)
    directions = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    return LightSampler(panorama).radiance(directions).reshape(rows, 2 * rows, 3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("material", "bsdf"),
    [
        (diffuse((0.8, 0.5, 0.2)), {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.5, 0.2]}}),
        # at this roughness light that bounces between microfacets, which Mitsuba leaves out, is below 1 %
        (rough_metal(0.25), {"type": "roughconductor", "material": "none", "alpha": 0.0625, "distribution": "ggx"}),
        (glass(1.5), {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}),
    ],
    ids=["diffuse", "metal", "glass"],
)
def test_spheres_agree_with_mitsuba(mitsuba: ModuleType, material: Material, bsdf: dict) -> None:
    panorama = lit_room()
    degrees = 30.0
    scene = mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 12, "rr_depth": 1000},
            "light": {"type": "envmap", "bitmap": mitsuba.Bitmap(_mitsuba_panorama(panorama))},
            "sphere": {"type": "sphere", "radius": 0.5, "bsdf": bsdf},
            "sensor": {
                "type": "perspective",
                "fov": degrees,
                "to_world": mitsuba.ScalarTransform4f().look_at(origin=[0, 0.5, 2.5], target=[0, 0, 0], up=[0, 1, 0]),
                "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": 256},
            },
        }
    )
    truth = np.array(mitsuba.render(scene, seed=1))[..., :3]
    focal = float(SIZE / 2 / np.tan(np.radians(degrees / 2)))
    camera = Intrinsics(focal, focal, SIZE / 2, SIZE / 2, SIZE, SIZE)
    pose, light = look_at((0, 0.5, 2.5), (0, 0, 0)), ProbeSet.single(panorama)
    ours = render_objects(TracedObjects([sphere(0.5, material)]), camera, pose, light, quality=paths(256, 12))
    inside = ours.alpha == 1
    assert inside.sum() > 150
    mean = truth[inside].mean()
    # pixels scatter by a few percent on either side with 256 paths; the means of over 150 of them do not
    np.testing.assert_allclose(ours.radiance[inside].mean(axis=0), truth[inside].mean(axis=0), rtol=0.02)
    assert np.abs(ours.radiance - truth)[inside].mean() < 0.08 * mean
