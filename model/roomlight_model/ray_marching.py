"""SGLV ray marching for training on CPUs: a compiled kernel with a hand-written gradient, for batches.

The readable twin is `ray_marching_reference.render_rays`; it also computes on GPUs and in double precision. Frame: each
volume's own, metres.
"""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from roomlight.engine.volume.sglv import MAX_SAMPLES, Far
from roomlight.threads import parallel_for
from roomlight_model.kernels.ray_marching import (
    SAMPLES,
    RayArrays,
    VolumeArrays,
    VolumeGradient,
    march_forward_backward,
)
from roomlight_model.ray_marching_reference import render_rays


def march(
    alpha: Float[Tensor, "b z y x"],
    lobes: Float[Tensor, "b z y x 10"],
    *,
    lower_m: Float[Tensor, "b 3"],
    voxel_m: Float[Tensor, "b 3"],
    origins: Float[Tensor, "b n 3"],
    directions: Float[Tensor, "b n 3"],
    samples: int = MAX_SAMPLES,
    far: Far = "boundary",
) -> Float[Tensor, "b n 3"]:
    """Compute the radiance along unit directions, each ray from its own origin; differentiable in alpha and lobes.

    Samples are one mean voxel edge apart (equations 1, 2: `roomlight.engine.volume.sglv`).

    Raises:
        ValueError: More than 256 samples a ray.
    """
    if samples > SAMPLES:
        raise ValueError(f"{samples} samples a ray: the kernel holds {SAMPLES}")
    if alpha.device.type != "cpu" or alpha.dtype == torch.float64:
        return torch.stack(
            [_by_grid_sample(*part, samples=samples, far=far) for part in zip(
                alpha, lobes, lower_m, voxel_m, origins, directions, strict=True
            )]
        )  # fmt: skip
    result: Tensor = _March.apply(  # pyright: ignore[reportAssignmentType]
        alpha.float(), lobes.float(), lower_m, voxel_m, origins, directions, samples, far == "boundary"
    )
    return result


def _by_grid_sample(
    alpha: Tensor, lobes: Tensor, lower_m: Tensor, voxel_m: Tensor, origins: Tensor, directions: Tensor, **options: Any
) -> Tensor:
    radiance, _ = render_rays(
        alpha, lobes, lower_m=lower_m, voxel_m=voxel_m, origin=origins, directions=directions, **options
    )
    return radiance


class _March(torch.autograd.Function):
    """Runs one thread per volume: gradients are scattered, and two threads must not write to one volume."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        """Return radiance [b, n, 3]; only the inputs are kept for the backward pass."""
        alpha, lobes, lower_m, voxel_m, origins, directions, samples, boundary = inputs
        ctx.save_for_backward(alpha, lobes, lower_m, voxel_m, origins, directions)
        ctx.samples, ctx.boundary = samples, boundary
        radiance = torch.empty_like(directions)
        _run(inputs, torch.zeros_like(directions), radiance=radiance, gradients=None)
        return radiance

    @staticmethod
    def backward(ctx: Any, *outputs: Any) -> Any:
        """Return the gradients of alpha and lobes."""
        inputs = (*ctx.saved_tensors, ctx.samples, ctx.boundary)
        gradients = torch.zeros_like(inputs[0]), torch.zeros_like(inputs[1])
        _run(inputs, outputs[0].contiguous(), radiance=None, gradients=gradients)
        return (*gradients, *[None] * 6)


def _run(
    inputs: tuple[Any, ...], g_radiance: Tensor, *, radiance: Tensor | None, gradients: tuple[Tensor, Tensor] | None
) -> None:
    alpha, lobes, lower_m, voxel_m, origins, directions = (
        np.ascontiguousarray(tensor.detach().numpy(), np.float32) for tensor in inputs[:6]
    )
    samples, boundary = inputs[6:]
    outer = g_radiance.detach().numpy()
    shown = np.empty((1, 1, 3), np.float32) if radiance is None else radiance.numpy()
    spare = np.empty((1, 1, 1, 1), np.float32), np.empty((1, 1, 1, 1, 10), np.float32)
    g_alpha, g_lobes = spare if gradients is None else (gradients[0].numpy(), gradients[1].numpy())

    def volumes(start: int, stop: int) -> None:
        for b in range(start, stop):
            march_forward_backward(
                VolumeArrays(alpha[b], lobes[b], lower_m[b], voxel_m[b]),
                RayArrays(origins[b], directions[b]),
                samples,
                boundary,
                outer[b],
                shown[min(b, len(shown) - 1)],
                VolumeGradient(g_alpha[min(b, len(g_alpha) - 1)], g_lobes[min(b, len(g_lobes) - 1)]),
                gradients is not None,
            )

    parallel_for(volumes, len(alpha))
