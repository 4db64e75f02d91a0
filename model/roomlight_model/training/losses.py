"""The light of predicted volumes at the probes, the paper's losses on it (equations L2 and LR), and their gradients.

Single-view and video stages share these losses. Radiance is linear, in units of the first frame's white.

On CPUs the pieces of a batch run on threads of their own. oneDNN's 3D convolutions have too little work at the coarse
levels to share between threads, which then wait for each other; two halves of a batch on a thread each do not.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from roomlight.conventions import panorama_rays
from roomlight_model.ray_marching import march
from roomlight_model.sphere_rendering import SphereSamples, disc, look_up, sample_sphere, sphere_normals
from roomlight_model.training.batches import Probes, Tensors
from roomlight_model.training.run_folder import RunOptions
from roomlight_model.volume_networks import SGVolume

Losses = dict[str, Float[Tensor, ""]]
"""A stage's losses by name. "loss" is the one whose gradient trains; the others are its parts, for the curves."""


def render_rays(sglv: SGVolume, probes: Probes, directions: Float[Tensor, "b p n 3"]) -> Float[Tensor, "b p n 3"]:
    """Render the volumes at the probes along world directions."""
    b, p, n, _ = directions.shape
    origins = probes.origins[:, :, None].expand(b, p, n, 3).reshape(b, p * n, 3)
    in_volume = torch.einsum("bij,bpnj->bpni", probes.world_to_volume_rotation, directions).reshape(b, p * n, 3)
    radiance = march(
        sglv.alpha.float(),
        sglv.lobes.float(),
        lower_m=probes.lower_m,
        voxel_m=probes.voxel_m,
        origins=origins.contiguous(),
        directions=in_volume.contiguous(),
    )
    return radiance.reshape(b, p, n, 3)


def render_panoramas(sglv: SGVolume, probes: Probes, *, height: int) -> Float[Tensor, "b p 3 h w"]:
    """Render the volumes' panoramas at the probes."""
    b, p = probes.origins.shape[:2]
    rays = panorama_directions(height, probes.origins.device).expand(b, p, -1, 3)
    return render_rays(sglv, probes, rays).reshape(b, p, height, 2 * height, 3).permute(0, 1, 4, 2, 3)


def draw_sphere(probes: Probes, *, pixels: int, samples: int, generator: torch.Generator) -> SphereSamples:
    """Draw directions for a glossy sphere's pixels at every probe, seen from the first camera."""
    points = disc(pixels, batch=probes.origins.shape[:2], generator=generator).to(probes.origins.device)
    normals = sphere_normals(probes.to_viewer, points)
    return sample_sphere(normals, probes.to_viewer, samples=samples, generator=generator)


def radiance_along(samples: SphereSamples, panoramas: Float[Tensor, "b p 3 h w"]) -> Float[Tensor, "b p k s 3"]:
    """Read panoramas along the sphere's directions."""
    flat = samples.directions.flatten(2, 3).flatten(0, 1)
    return look_up(panoramas.flatten(0, 1), flat).reshape(samples.directions.shape)


@cache
def panorama_directions(height: int, device: torch.device) -> Float[Tensor, "n 3"]:
    """Return the unit directions of a panorama's pixels, row by row."""
    return torch.from_numpy(panorama_rays(height).copy()).to(device)


def log_l2_loss(prediction: Tensor, truth: Tensor) -> Float[Tensor, ""]:
    """Return the mean squared difference of log(1 + light) (eq. logl2)."""
    return (torch.log1p(prediction.clamp(min=0)) - torch.log1p(truth.clamp(min=0))).square().mean()


def rendering_loss(prediction: Tensor, truth: Tensor) -> Float[Tensor, ""]:
    """Return the mean squared difference of shaded pixels, clamped at white (eq. renderinLoss)."""
    return (prediction.clamp(max=1) - truth.clamp(max=1)).square().mean()


class _Piece(NamedTuple):
    losses: dict[str, float]
    gradients: Sequence[Tensor | None]
    share: float
    """Share of the batch's examples."""


class BatchGradients:
    """Computes a batch's losses and writes their gradients to the parameters' `grad`."""

    def __init__(
        self,
        losses: Callable[[Any, torch.Generator], Losses],
        parameters: Sequence[nn.Parameter],
        options: RunOptions,
        *,
        device: torch.device,
        piece_size: int,
    ) -> None:
        """Prepare the threads.

        Args:
            options: The batch's size and the seed of random directions.
            device: Where the networks run; only a CPU's batches are split.
            piece_size: Examples in one forward pass on a CPU; fixed, so that results do not depend on the cores.
        """
        self._losses, self._parameters, self._options, self._device = losses, tuple(parameters), options, device
        pieces = -(-options.batch // piece_size) if device.type == "cpu" else 1
        threads = torch.get_num_threads()
        self._pool = ThreadPoolExecutor(
            min(pieces, threads),
            thread_name_prefix="gradients",
            initializer=torch.set_num_threads,  # applies to the calling thread
            initargs=(max(1, threads // pieces),),
        )
        self._piece_size = piece_size if pieces > 1 else options.batch

    def of(self, batch: Tensors, step: int) -> dict[str, float]:
        """Compute gradients and return the mean losses; random directions follow from (seed, step)."""
        pieces = batch.pieces(self._piece_size)

        def compute(number: int) -> _Piece:
            return self._piece(pieces[number], (step, number), len(pieces[number]) / len(batch))

        done = [compute(0)] if len(pieces) == 1 else list(self._pool.map(compute, range(len(pieces))))
        with torch.no_grad():
            for index, parameter in enumerate(self._parameters):
                _accumulate(parameter, [(piece.gradients[index], piece.share) for piece in done])
        return {name: sum(piece.losses[name] * piece.share for piece in done) for name in done[0].losses}

    def _piece(self, batch: Tensors, keys: tuple[int, int], share: float) -> _Piece:
        generator = torch.Generator().manual_seed(int(self._options.rng(*keys).integers(2**31)))
        losses = self._losses(batch.to(self._device), generator)
        gradients = torch.autograd.grad(losses["loss"], self._parameters, allow_unused=True)
        return _Piece({name: float(value.detach()) for name, value in losses.items()}, gradients, share)


def _accumulate(parameter: nn.Parameter, pieces: Sequence[tuple[Tensor | None, float]]) -> None:
    """Set grad = sum of share x gradient, with the parameter's strides: the fused optimiser needs the same strides."""
    known = [(gradient, share) for gradient, share in pieces if gradient is not None]
    if not known:
        parameter.grad = None
        return
    if parameter.grad is None:
        parameter.grad = torch.empty_like(parameter)
    first, share = known[0]
    parameter.grad.copy_(first).mul_(share)
    for gradient, share in known[1:]:
        parameter.grad.add_(gradient, alpha=share)
