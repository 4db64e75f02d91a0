"""The Monte Carlo rendering layer: its sampler's density, its energy, and its agreement with dense integration."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import chisquare

from roomlight.conventions import panorama_directions
from roomlight.spheres import GLOSSY_ALBEDO, SphereRenderer
from roomlight_model.sphere_rendering import brdf_and_density, disc, look_up, sample_sphere, shade, sphere_normals

TO_VIEWER = torch.nn.functional.normalize(torch.tensor([0.3, 0.2, 0.9], dtype=torch.float64), dim=0)
PLACES = torch.tensor([[0.0, 0.0], [0.5, 0.2], [-0.4, 0.7], [0.1, -0.9]], dtype=torch.float64)


def uniform_sphere(count, generator):
    return torch.nn.functional.normalize(torch.randn((count, 3), generator=generator, dtype=torch.float64), dim=-1)


def seeded(seed):
    return torch.Generator().manual_seed(seed)


@pytest.mark.statistical
@pytest.mark.parametrize("place", range(4))
def test_directions_follow_their_stated_density(place):
    """Chi-square over cells of the sphere: expected counts by integrating the density inside each."""
    normals = sphere_normals(TO_VIEWER, PLACES[place : place + 1])
    count, rows, columns, fine = 40_000, 12, 24, 12
    drawn = sample_sphere(normals.expand(count // 20, 3), TO_VIEWER, samples=20, generator=seeded(0)).directions
    drawn = drawn.reshape(-1, 3)
    v = (torch.acos(drawn[:, 1].clamp(-1, 1)) / math.pi * rows).long().clamp(max=rows - 1)
    u = ((torch.atan2(drawn[:, 2], drawn[:, 0]) / (2 * math.pi) + 0.5) * columns).long().clamp(max=columns - 1)
    seen = torch.bincount(v * columns + u, minlength=rows * columns).double().numpy()
    height = rows * fine
    directions = torch.from_numpy(panorama_directions(height)).double().reshape(-1, 3)
    sine = torch.sin((torch.arange(height) + 0.5) / height * math.pi).double()
    solid_angle = (math.pi / height) ** 2 * sine.repeat_interleave(2 * height)
    _, density = brdf_and_density(normals, TO_VIEWER, directions[None], 0.5)
    mass = (density[0] * solid_angle).reshape(rows, fine, columns, fine).sum((1, 3)).reshape(-1).numpy()
    assert mass.sum() == pytest.approx(1.0, abs=0.02)
    expected = mass / mass.sum() * count
    big = expected > 20
    seen = np.append(seen[big], seen[~big].sum())
    expected = np.append(expected[big], expected[~big].sum())
    kept = expected > 0
    # strata make counts vary less than independent draws would: only an excess is an error
    assert chisquare(seen[kept], expected[kept] * seen[kept].sum() / expected[kept].sum()).pvalue > 1e-3


def test_a_white_room_gives_the_albedo_and_a_little_more():
    """White furnace: the diffuse part returns its albedo, the coat the rest of what Fresnel and shadowing leave."""
    normals = sphere_normals(TO_VIEWER, PLACES)
    samples = sample_sphere(normals, TO_VIEWER, samples=4096, generator=seeded(1))
    white = shade(samples, torch.ones((*samples.weights.shape, 3), dtype=torch.float64))
    assert (white > GLOSSY_ALBEDO).all()
    assert (white < GLOSSY_ALBEDO + 0.35).all()
    assert white[0, 0] == pytest.approx(GLOSSY_ALBEDO + 0.05, abs=0.01)


@pytest.mark.statistical
def test_unbiased_against_65536_uniform_directions():
    panorama = torch.rand((1, 3, 16, 32), generator=seeded(2), dtype=torch.float64) + 0.2
    panorama[0, :, 4, 20] = 40.0  # a lamp
    normals = sphere_normals(TO_VIEWER, PLACES)
    uniform = uniform_sphere(65_536, seeded(3))
    value, _ = brdf_and_density(normals, TO_VIEWER, uniform.expand(4, -1, -1), 0.5)
    light = look_up(panorama, uniform[None])[0]
    dense = 4 * math.pi * (value[..., None] * light)
    wanted, error = dense.mean(1), dense.std(1) / 256
    samples = sample_sphere(normals.repeat(300, 1), TO_VIEWER, samples=16, generator=seeded(0))
    flat = look_up(panorama, samples.directions.reshape(1, -1, 3)).reshape(*samples.weights.shape, 3)
    ours = shade(samples, flat).reshape(300, len(PLACES), 3)
    tolerance = 4 * torch.sqrt(error**2 + ours.var(0) / len(ours))
    assert ((ours.mean(0) - wanted).abs() < tolerance).all()


def test_it_agrees_with_the_numpy_sphere_renderer():
    """`SphereRenderer` is another estimator of the same image."""
    rng = np.random.default_rng(7)
    panorama = rng.uniform(0.1, 1.0, (30, 60, 3)).astype(np.float32)
    to_viewer = TO_VIEWER.numpy()
    sphere = SphereRenderer(tuple((-to_viewer).tolist()), size=16)
    picture = sphere.pixels(panorama, "glossy")
    samples = sample_sphere(torch.from_numpy(sphere.normals).double(), TO_VIEWER, samples=2048, generator=seeded(8))
    flat = look_up(torch.from_numpy(panorama).double().permute(2, 0, 1)[None], samples.directions.reshape(1, -1, 3))
    ours = shade(samples, flat.reshape(*samples.weights.shape, 3)).numpy()
    # the sphere renderer prefilters the lobe, which at the rim lets in light from behind the surface: leave the rim out
    facing = sphere.normals @ to_viewer.astype(np.float32) > 0.5
    assert np.abs(ours - picture)[facing].mean() < 0.015 * picture[facing].mean()


def test_gradients_reach_the_light_alone():
    panorama = torch.rand((2, 3, 8, 16), generator=seeded(1)).requires_grad_()
    to_viewer = TO_VIEWER.float().expand(2, 3)
    normals = sphere_normals(to_viewer, disc(6, batch=(2,), generator=seeded(2)))
    samples = sample_sphere(normals, to_viewer, samples=8, generator=seeded(3))
    light = look_up(panorama, samples.directions.reshape(2, -1, 3)).reshape(2, 6, 8, 3)
    shade(samples, light).sum().backward()
    assert panorama.grad is not None
    assert torch.isfinite(panorama.grad).all()
    assert panorama.grad.abs().sum() > 0


def test_one_sample_is_refused():
    normals = sphere_normals(TO_VIEWER, PLACES)
    with pytest.raises(ValueError, match="at least two samples"):
        sample_sphere(normals, TO_VIEWER, samples=1)


def test_look_up_wraps_and_keeps_to_the_convention():
    panorama = torch.from_numpy(np.random.default_rng(1).uniform(0, 1, (16, 32, 3)).astype(np.float32))
    directions = torch.from_numpy(panorama_directions(16)).reshape(1, -1, 3)
    read = look_up(panorama.permute(2, 0, 1)[None], directions)
    torch.testing.assert_close(read[0].reshape(16, 32, 3), panorama, atol=2e-5, rtol=0)
