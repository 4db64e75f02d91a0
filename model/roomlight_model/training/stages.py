"""The stages of training: trained networks and losses (paper, equations L2, LR and their sum).

| stage        | trains             | light compared at                                    |
|--------------|--------------------|------------------------------------------------------|
| single-sglv  | SGEncoder, decoder | random pixels of the probes' panoramas + sphere rays |
| single-blend | Blend*             | whole panoramas + the sphere's directions in them    |
| single-joint | all four           | as single-blend                                      |
| video-sglv   | SG*, SGGRU*        | as single-sglv, in every frame after the first       |
| video-blend  | Blend*, BlendGRU*  | as single-blend, in every frame after the first      |
| video-joint  | all recurrent ones | as single-joint, in every frame after the first      |

The video stages (`training.unroll`) train the recurrent networks; the single-view ones, which run the first frame,
stay as they are. They add the smoothness loss.
"""

from functools import cache
from typing import Final, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from roomlight.conventions import panorama_rays
from roomlight_model.accumulate import blend
from roomlight_model.networks import SingleModel, VideoModel
from roomlight_model.ray_marching import march
from roomlight_model.sphere_rendering import SphereSamples, disc, look_up, sample_sphere, shade, sphere_normals
from roomlight_model.training.batches import Batch, Probes
from roomlight_model.training.options import TrainingStage, TrainOptions
from roomlight_model.volume_networks import SGVolume

EVEN: Final = 0.02
"""Added to the fill's error, by which each example's error is divided: an easy room counts as a hard one."""
WORSE_WEIGHT: Final = 1.0
"""Weight of the part of an example's error that exceeds the fill's: harm counts more than help."""
RELATIVE_SCALE: Final = 0.1
"""Typical error of the fill: relative errors keep the size of plain ones, beside the other losses."""


class Losses(NamedTuple):
    """The loss and its parts: means, so that the learning rate does not depend on the resolution."""

    total: Float[Tensor, ""]
    log_l2: Float[Tensor, ""]
    rendering: Float[Tensor, ""]
    smoothness: Float[Tensor, ""]
    """0 in the single-view stages."""


def trained_modules(model: SingleModel | VideoModel, stage: TrainingStage) -> list[nn.Module]:
    """Return the networks that a stage trains."""
    sg: list[nn.Module] = [model.sg_encoder, model.sg_decoder]
    blend: list[nn.Module] = [model.blend_encoder, model.blend_decoder]
    if isinstance(model, VideoModel):
        sg += [model.sg_gru0, model.sg_gru1]
        blend += [model.blend_gru0, model.blend_gru1]
    return {"sglv": sg, "blend": blend, "joint": sg + blend}[stage.split("-")[1]]


def predict(model: SingleModel, batch: Batch, options: TrainOptions, *, device: torch.device) -> SGVolume:
    """Predict the volumes of a batch, without a gradient if the stage does not train the 3D networks."""
    trains = options.stage != "single-blend" and torch.is_grad_enabled()
    with torch.autocast(device.type, dtype=torch.bfloat16, enabled=options.bf16), torch.set_grad_enabled(trains):
        return model(batch.volume)


def stage_losses(
    model: SingleModel,
    sglv: SGVolume,
    batch: Batch,
    options: TrainOptions,
    *,
    generator: torch.Generator,
    device: torch.device,
) -> Losses:
    """Compute the losses of a batch's volumes; random directions come from `generator`, on the CPU."""
    if options.stage == "single-sglv":
        return _sglv_losses(sglv, batch, options, generator=generator)
    return _blend_losses(model, sglv, batch, options, generator=generator, device=device)


def rendered(sglv: SGVolume, batch: Probes, directions: Float[Tensor, "b p n 3"]) -> Float[Tensor, "b p n 3"]:
    """Render the volume at the probes along world directions."""
    b, p, n, _ = directions.shape
    origins = batch.origins[:, :, None].expand(b, p, n, 3).reshape(b, p * n, 3)
    in_volume = torch.einsum("bij,bpnj->bpni", batch.world_to_volume_rotation, directions).reshape(b, p * n, 3)
    radiance = march(
        sglv.alpha.float(),
        sglv.lobes.float(),
        lower_m=batch.lower_m,
        voxel_m=batch.voxel_m,
        origins=origins.contiguous(),
        directions=in_volume.contiguous(),
    )
    return radiance.reshape(b, p, n, 3)


def rendered_panoramas(
    sglv: SGVolume, batch: Probes, *, height: int, device: torch.device
) -> Float[Tensor, "b p 3 h w"]:
    """Render the volume's panoramas at the probes."""
    b, p = batch.origins.shape[:2]
    rays = panorama_directions(height, device).expand(b, p, -1, 3)
    return rendered(sglv, batch, rays).reshape(b, p, height, 2 * height, 3).permute(0, 1, 4, 2, 3)


def predicted_panoramas(
    model: SingleModel,
    sglv: SGVolume,
    batch: Batch,
    *,
    bf16: bool,
    device: torch.device,
    weight_height: int | None = None,
) -> tuple[Float[Tensor, "b p 3 h w"], Float[Tensor, "b p 3 h w"]]:
    """Compute the volume's panoramas at the probes and the blended ones, which keep the detail of earlier frames.

    `weight_height` is the height at which the blending network runs if it is not the panoramas'; its weight is then
    resampled, as in the serving engine.

    Raises:
        ValueError: The batch has no partial panoramas.
    """
    if batch.partial is None or batch.mask is None:
        raise ValueError("a batch for blending needs partial panoramas: collate it with a panorama_height")
    hdr = rendered_panoramas(sglv, batch, height=batch.truth.shape[-2], device=device)
    panels = hdr.flatten(0, 1), batch.partial.flatten(0, 1), batch.mask.flatten(0, 1)
    with torch.autocast(device.type, dtype=torch.bfloat16, enabled=bf16):
        if weight_height is None or weight_height == hdr.shape[-2]:
            blended, _ = model.blend(*panels)
        else:
            blended = _blended_at(model, *panels, height=weight_height)
    blended = blended.float().unflatten(0, batch.truth.shape[:2])
    if batch.before is not None and batch.kept is not None:
        blended = torch.where(batch.kept > 0, batch.before, blended)
    return hdr, blended


def _blended_at(
    model: SingleModel,
    hdr: Float[Tensor, "n 3 h w"],
    ldr: Float[Tensor, "n 3 h w"],
    mask: Float[Tensor, "n 1 h w"],
    *,
    height: int,
) -> Float[Tensor, "n 3 h w"]:
    size = (height, 2 * height)
    small_hdr, small_ldr = (functional.interpolate(panel, size=size, mode="area") for panel in (hdr, ldr))
    _, weight = model.blend(small_hdr, small_ldr, functional.interpolate(mask, size=size, mode="nearest-exact"))
    weight = functional.interpolate(weight, size=mask.shape[-2:], mode="bilinear")
    return blend(hdr, ldr, weight)


def _sglv_losses(sglv: SGVolume, batch: Batch, options: TrainOptions, *, generator: torch.Generator) -> Losses:
    b, p, _, h, w = batch.truth.shape
    device = batch.truth.device
    pixels = torch.randint(h * w, (b, p, options.rays), generator=generator).to(device)
    directions = panorama_directions(h, device)[pixels]
    truth = batch.truth.flatten(3).transpose(2, 3)  # [b, p, h w, 3]
    wanted = truth.gather(2, pixels[..., None].expand(-1, -1, -1, 3))
    if options.sphere_pixels == 0:
        log_l2 = log_l2_loss(rendered(sglv, batch, directions), wanted)
        return summed(log_l2, torch.zeros_like(log_l2), options)
    samples = draw_sphere(batch, options, generator=generator)
    light = light_along(samples, batch.truth)
    along = samples.directions.flatten(2, 3)
    radiance = rendered(sglv, batch, torch.cat([directions, along], dim=2))
    seen, lit = radiance.split([options.rays, along.shape[2]], dim=2)
    log_l2 = log_l2_loss(seen, wanted)
    sphere = shade(samples, lit.unflatten(2, samples.weights.shape[2:]))
    return summed(log_l2, rendering_loss(sphere, shade(samples, light)), options)


def _blend_losses(
    model: SingleModel,
    sglv: SGVolume,
    batch: Batch,
    options: TrainOptions,
    *,
    generator: torch.Generator,
    device: torch.device,
) -> Losses:
    hdr, blended = predicted_panoramas(model, sglv, batch, bf16=options.bf16, device=device)
    log_l2, weight = relative_errors(blended, batch) if options.relative else (log_l2_loss(blended, batch.truth), 1)
    if options.stage == "single-joint":  # keeps the volume accurate where nothing is blended in
        log_l2 = (log_l2 + (weight * log_errors(hdr, batch.truth)).mean()) / 2
    samples = draw_sphere(batch, options, generator=generator)
    sphere, wanted = (shade(samples, light_along(samples, light)) for light in (blended, batch.truth))
    return summed(log_l2, rendering_loss(sphere, wanted), options)


def draw_sphere(batch: Probes, options: TrainOptions, *, generator: torch.Generator) -> SphereSamples:
    """Draw directions for a glossy sphere's pixels at every probe, seen from the first camera."""
    points = disc(options.sphere_pixels, batch=batch.origins.shape[:2], generator=generator).to(batch.origins.device)
    normals = sphere_normals(batch.to_viewer, points)
    return sample_sphere(normals, batch.to_viewer, samples=options.sphere_samples, generator=generator)


def light_along(samples: SphereSamples, panoramas: Float[Tensor, "b p 3 h w"]) -> Float[Tensor, "b p k s 3"]:
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


def log_errors(prediction: Float[Tensor, "b ..."], truth: Float[Tensor, "b ..."]) -> Float[Tensor, " b"]:
    """Return `log_l2_loss` of each example."""
    difference = torch.log1p(prediction.clamp(min=0)) - torch.log1p(truth.clamp(min=0))
    return difference.square().flatten(1).mean(1)


def relative_errors(blended: Float[Tensor, "b p 3 h w"], batch: Batch) -> tuple[Float[Tensor, ""], Float[Tensor, " b"]]:
    """Return the mean error relative to the fill of what was observed, and each example's divisor as a weight.

    A network that is worse than no network in an easy room loses as much as it gains in a hard one; `WORSE_WEIGHT`
    counts the part of the error that exceeds the fill's again.
    """
    assert batch.partial is not None
    fill = batch.partial
    if batch.before is not None and batch.kept is not None:
        fill = torch.where(batch.kept > 0, batch.before, fill)
    error, least = log_errors(blended, batch.truth), log_errors(fill, batch.truth)
    return RELATIVE_SCALE * relative_error(error, least).mean(), RELATIVE_SCALE / (least + EVEN)


def relative_error(error: Float[Tensor, " b"], fill: Float[Tensor, " b"]) -> Float[Tensor, " b"]:
    """Return each example's error divided by the fill's; the part that exceeds it counts again (`WORSE_WEIGHT`)."""
    return (error + WORSE_WEIGHT * (error - fill).clamp(min=0)) / (fill + EVEN)


def rendering_loss(prediction: Tensor, truth: Tensor) -> Float[Tensor, ""]:
    """Return the mean squared difference of shaded pixels, clamped at white (eq. renderinLoss)."""
    return (prediction.clamp(max=1) - truth.clamp(max=1)).square().mean()


def summed(
    log_l2: Float[Tensor, ""],
    rendering: Float[Tensor, ""],
    options: TrainOptions,
    *,
    smoothness: Float[Tensor, ""] | None = None,
) -> Losses:
    """Return the losses with their weighted sum."""
    smooth = torch.zeros_like(log_l2) if smoothness is None else smoothness
    total = log_l2 + options.rendering_weight * rendering + options.smoothness_weight * smooth
    return Losses(total, log_l2, rendering, smooth)
