"""SGLV ray marching for training on CPUs: a compiled kernel with a hand-written gradient, for batches.

The readable twin is `ray_marching_reference.render_rays`; it also computes on GPUs and in double precision. Frame: each
volume's own, metres.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from roomlight.engine.volume.sglv import MAX_SAMPLES, Far
from roomlight.threads import parallel_for
from roomlight_model.kernels.ray_marching import (
    CHANNELS,
    SAMPLES,
    RayArrays,
    VolumeArrays,
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
        names = ("alpha", "lobes", "lower_m", "voxel_m", "origin", "directions")
        rays = zip(alpha, lobes, lower_m, voxel_m, origins, directions, strict=True)
        parts = (dict(zip(names, part, strict=True)) for part in rays)
        return torch.stack([render_rays(**part, samples=samples, far=far)[0] for part in parts])
    result: Tensor = _March.apply(  # pyright: ignore[reportAssignmentType]
        alpha.float(), lobes.float(), lower_m, voxel_m, origins, directions, samples, far == "boundary"
    )
    return result


class _March(torch.autograd.Function):
    """Runs one thread per volume: gradients are scattered, and two threads must not write to one volume."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        """Return radiance [b, n, 3]; only the inputs are kept for the backward pass."""
        alpha, lobes, *rest, samples, boundary = inputs
        channels = torch.cat([lobes, alpha[..., None], torch.zeros_like(alpha)[..., None]], dim=-1).contiguous()
        ctx.save_for_backward(channels, *rest)
        ctx.samples, ctx.boundary = samples, boundary
        radiance = torch.empty_like(rest[-1])
        _run((channels, *rest), samples, boundary, radiance)
        return radiance

    @staticmethod
    def backward(ctx: Any, *outputs: Any) -> Any:
        """Return the gradients of alpha and lobes."""
        gradient = torch.zeros_like(ctx.saved_tensors[0])
        _run(ctx.saved_tensors, ctx.samples, ctx.boundary, outputs[0].contiguous(), gradient)
        return (gradient[..., 10], gradient[..., :10], *[None] * 6)


def _run(
    tensors: Sequence[Tensor], samples: int, boundary: bool, radiance: Tensor, gradient: Tensor | None = None
) -> None:
    """Fill `radiance` [b, n, 3]; or, where it is an outer gradient, the gradient [b, z, y, x, 12] of the volumes."""
    channels, lower_m, voxel_m, origins, directions = (
        np.ascontiguousarray(tensor.detach().numpy(), np.float32) for tensor in tensors
    )
    of_rays = radiance.detach().numpy()
    of_volumes = np.zeros((len(channels), 1, 1, 1, CHANNELS), np.float32) if gradient is None else gradient.numpy()

    def volumes(start: int, stop: int) -> None:
        for b in range(start, stop):
            march_forward_backward(
                VolumeArrays(channels[b], lower_m[b], voxel_m[b]),
                RayArrays(origins[b], directions[b]),
                samples,
                boundary,
                of_rays[b],
                of_volumes[b],
                gradient is not None,
            )

    parallel_for(volumes, len(channels))
