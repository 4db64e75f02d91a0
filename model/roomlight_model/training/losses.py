"""The light of predicted volumes at the probes, and the paper's losses on it (equations L2 and LR).

Single-view and video stages share these functions. Radiance is linear, in units of the first frame's white.
"""

from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from roomlight.conventions import panorama_rays
from roomlight_model.ray_marching import march
from roomlight_model.sphere_rendering import SphereSamples, disc, look_up, sample_sphere, sphere_normals
from roomlight_model.training.batches import Probes
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
