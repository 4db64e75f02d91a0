"""The compiled ray marching and its hand-written gradient against the differentiable twin."""

import pytest
import torch

from roomlight_model.ray_marching import march
from roomlight_model.ray_marching_reference import render_rays

SHAPE = (16, 15, 21)


@pytest.fixture
def volumes():
    generator = torch.Generator().manual_seed(3)
    alpha = torch.rand((3, *SHAPE), generator=generator) * 0.4
    lobes = torch.rand((3, *SHAPE, 10), generator=generator)
    lobes[..., 6] *= 6
    lower = torch.tensor([[-2.0, -1.5, -2.0]]).repeat(3, 1)
    voxel = torch.tensor([[4 / 21, 3 / 15, 4 / 16]]).repeat(3, 1)
    origins = torch.rand((3, 120, 3), generator=generator) * 2 - 1
    origins[:, 0] = 9.0  # outside: some rays miss
    directions = torch.nn.functional.normalize(torch.randn((3, 120, 3), generator=generator), dim=-1)
    directions[:, 1] = torch.tensor([0.0, 1.0, 0.0])  # along an axis
    return alpha, lobes, {"lower_m": lower, "voxel_m": voxel, "origins": origins, "directions": directions}


def by_twin(alpha, lobes, rays, far):
    return torch.stack(
        [
            render_rays(
                alpha[b],
                lobes[b],
                lower_m=rays["lower_m"][b],
                voxel_m=rays["voxel_m"][b],
                origin=rays["origins"][b],
                directions=rays["directions"][b],
                far=far,
            )[0]
            for b in range(len(alpha))
        ]
    )


@pytest.mark.parametrize("far", ["boundary", "none"])
@pytest.mark.parametrize("opaque", [False, True])
def test_values_and_gradients_equal_the_twins(volumes, far, opaque):
    alpha, lobes, rays = volumes
    if opaque:  # rays that end early, and voxels of full opacity
        alpha = torch.where(alpha > 0.3, torch.ones_like(alpha), alpha)
    alpha.requires_grad_()
    lobes.requires_grad_()
    ours, twin = march(alpha, lobes, far=far, **rays), by_twin(alpha, lobes, rays, far)
    torch.testing.assert_close(ours, twin, rtol=1e-4, atol=3e-5)
    outer = torch.randn(ours.shape, generator=torch.Generator().manual_seed(4))
    for own, wanted in zip(
        torch.autograd.grad((ours * outer).sum(), (alpha, lobes)),
        torch.autograd.grad((twin * outer).sum(), (alpha, lobes)),
        strict=True,
    ):
        torch.testing.assert_close(own, wanted, rtol=1e-3, atol=2e-4)


def test_doubles_go_to_the_twin_and_keep_their_precision(volumes):
    alpha, lobes, rays = volumes
    rays = {name: values.double() for name, values in rays.items()}
    values = march(alpha.double(), lobes.double(), **rays)
    assert values.dtype == torch.float64
    torch.testing.assert_close(values, by_twin(alpha.double(), lobes.double(), rays, "boundary"))


def test_too_many_samples_are_refused(volumes):
    alpha, lobes, rays = volumes
    with pytest.raises(ValueError, match="300 samples a ray: the kernel holds 256"):
        march(alpha, lobes, samples=300, **rays)


def test_rays_that_miss_are_black_and_give_no_gradient(volumes):
    alpha, lobes, rays = volumes
    alpha.requires_grad_()
    rays["origins"] = torch.full_like(rays["origins"], 50.0)
    rays["directions"] = torch.tensor([1.0, 0.0, 0.0]).expand_as(rays["directions"]).contiguous()
    values = march(alpha, lobes, **rays)
    assert not values.any()
    assert not torch.autograd.grad(values.sum(), alpha)[0].any()
