"""The single-view stages: options, data, forward pass and losses (paper, "Training").

| stage        | trains             | light compared at                                    |
|--------------|--------------------|------------------------------------------------------|
| single-sglv  | SGEncoder, decoder | random pixels of the probes' panoramas + sphere rays |
| single-blend | Blend*             | whole panoramas + the sphere's directions in them    |
| single-joint | all four           | as single-blend                                      |
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from annotated_types import Ge, Interval
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from roomlight.errors import ModelError, OptionError
from roomlight_model.accumulate import blend, fill_in
from roomlight_model.checkpoint import Checkpoint
from roomlight_model.config import ModelConfig
from roomlight_model.networks import SingleModel
from roomlight_model.sphere_rendering import shade
from roomlight_model.training.batches import Batch, collate
from roomlight_model.training.examples import DepthKind, read_example
from roomlight_model.training.losses import (
    Losses,
    draw_sphere,
    log_l2_loss,
    panorama_directions,
    radiance_along,
    render_panoramas,
    render_rays,
    rendering_loss,
)
from roomlight_model.training.run_folder import RunOptions
from roomlight_model.training.subsets import Recordings
from roomlight_model.training.validation import SingleViewValidation
from roomlight_model.volume_networks import SGVolume

SingleViewStageName = Literal["single-sglv", "single-blend", "single-joint"]


@dataclass(frozen=True)
class SingleViewOptions(RunOptions):
    """Options of a single-view stage, beside those of every run.

    Attributes:
        stage: What is trained; see `training.single_view`.
        rendering_weight: Weight of the rendering loss.
        rays: Rays drawn at random from each probe's panorama in the first stage.
        sphere_pixels: Pixels of the rendering layer's sphere.
        sphere_samples: Directions of each of its pixels.
        volume_shape: Resolution [z, y, x] of training (half of the paper's costs an eighth) and of the exported
            graphs. Opacity is per voxel, so that weights need training at the resolution they are used at.
        panorama_height: Rows of the panoramas in the blending stages and of the exported blending graphs.
        depth: Exact depth, simulated phone depth, or both.
        frames: Largest number of frames of a walk in an example: the volume is their mean (`engine.volume.fusion`),
            panoramas accumulate.
        augment: Whether to draw frames at random and augment them.
        surround_max: Train only on sequences whose surroundings are at most this many times as bright as their
            first frame (`training.subsets.surround`); 0 trains on all.
        held_out: Sequences that are scored, at most, of the first folder's rooms that are kept from training
            (`training.subsets`).
        bf16: Whether the networks compute in bfloat16.
        model: Widths of the networks; those of the weights that the stage starts from replace them.

    Raises:
        OptionError: A value is out of range.
    """

    stage: SingleViewStageName = "single-sglv"
    rendering_weight: Annotated[float, Interval(ge=0, le=100)] = 0.3
    rays: Annotated[int, Ge(8)] = 384
    sphere_pixels: Annotated[int, Ge(1)] = 24
    sphere_samples: Annotated[int, Ge(2)] = 12
    volume_shape: tuple[int, int, int] = (32, 30, 42)
    panorama_height: Annotated[int, Ge(8)] = 60
    depth: DepthKind = "both"
    frames: Annotated[int, Ge(1)] = 1
    augment: bool = True
    surround_max: Annotated[float, Interval(ge=0, le=100)] = 0.0
    held_out: Annotated[int, Ge(0)] = 48  # 12 rooms of four walks, 24 of two
    bf16: bool = True
    model: ModelConfig = field(default_factory=ModelConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.volume_shape) < 8:
            raise OptionError(f"volume_shape is {self.volume_shape}; every side must be 8 or more")
        if self.panorama_height % 2:
            raise OptionError(f"panorama_height is {self.panorama_height}; it must be even")

    @property
    def trained_model(self) -> ModelConfig:
        """The networks' configuration at the sizes of training, for checkpoints and exported graphs."""
        sg = replace(self.model.sg, volume_shape=self.volume_shape)
        return replace(self.model, sg=sg, blend=replace(self.model.blend, height=self.panorama_height))


class SingleViewStage:
    """One of the single-view stages on some sequences."""

    def __init__(
        self,
        options: SingleViewOptions,
        training: Recordings,
        held_out: Recordings,
        *,
        device: torch.device,
        start_from: Checkpoint | None = None,
        data: list[dict[str, Any]] | None = None,
    ) -> None:
        """Take the data and the weights to start from.

        Args:
            options: The stage and its hyperparameters; the widths become those of `start_from`.
            held_out: Sequences that are scored and not trained on.
            start_from: Single-view weights; None starts with fresh ones.
            data: The description of the datasets for the card.

        Raises:
            ModelError: `start_from` holds other networks.
        """
        if start_from is not None:
            if start_from.form != "single":
                raise ModelError(
                    f"stage {options.stage} cannot start from {start_from.form} weights; give `start_from` single-view "
                    "ones"
                )
            options = replace(options, model=start_from.config)
        self.options, self.device, self.data = options, device, data or []
        self.piece_size = 2  # views in a pass on one thread; see `training.losses`
        self._training, self._held_out, self.start_from = training, held_out, start_from

    # --- data

    def __len__(self) -> int:
        return len(self._training)

    def batch(self, step: int) -> Batch:
        """Read, augment and collate the examples of a step."""
        options = self.options
        examples = [
            read_example(
                self._training, index, rng, depth=options.depth, augment=options.augment, frames=options.frames
            )
            for index, rng in options.draw_examples(len(self), step)
        ]
        height = None if options.stage == "single-sglv" else options.panorama_height
        return collate(examples, volume_shape=options.volume_shape, panorama_height=height)

    # --- networks

    def network(self) -> SingleModel:
        """Build the networks; those that the stage trains require a gradient."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.options.seed)
            model = SingleModel(self.options.trained_model)
        if self.start_from is not None:
            model.load_state_dict(self.start_from.model.state_dict())
        volume, panorama = (model.sg_encoder, model.sg_decoder), (model.blend_encoder, model.blend_decoder)
        train_only(model, self.options.stage, volume=volume, panorama=panorama)
        channels_last(volume)
        return model.to(self.device)

    # --- forward and loss

    def losses(self, model: SingleModel, batch: Batch, generator: torch.Generator) -> Losses:
        """Return the losses of a batch."""
        options = self.options
        trains_volume = options.stage != "single-blend" and torch.is_grad_enabled()
        with self._autocast(), torch.set_grad_enabled(trains_volume):
            sglv = model(batch.volume)
        if options.stage == "single-sglv":
            log_l2, rendering = self._ray_losses(sglv, batch, generator)
        else:
            log_l2, rendering = self._panorama_losses(model, sglv, batch, generator)
        total = log_l2 + options.rendering_weight * rendering
        return {"loss": total, "log_l2": log_l2, "rendering": rendering}

    def _ray_losses(self, sglv: SGVolume, batch: Batch, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Compare random pixels of the probes' panoramas, and the light that a glossy sphere reflects."""
        options, (b, p, _, h, w) = self.options, batch.truth.shape
        pixels = torch.randint(h * w, (b, p, options.rays), generator=generator).to(self.device)
        directions = panorama_directions(h, self.device)[pixels]
        truth = batch.truth.flatten(3).transpose(2, 3).gather(2, pixels[..., None].expand(-1, -1, -1, 3))
        sphere = draw_sphere(batch, pixels=options.sphere_pixels, samples=options.sphere_samples, generator=generator)
        to_sphere = sphere.directions.flatten(2, 3)
        radiance = render_rays(sglv, batch, torch.cat([directions, to_sphere], dim=2))
        at_pixels, at_sphere = radiance.split([options.rays, to_sphere.shape[2]], dim=2)
        shaded = shade(sphere, at_sphere.unflatten(2, sphere.weights.shape[2:]))
        true_shaded = shade(sphere, radiance_along(sphere, batch.truth))
        return log_l2_loss(at_pixels, truth), rendering_loss(shaded, true_shaded)

    def _panorama_losses(
        self, model: SingleModel, sglv: SGVolume, batch: Batch, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Compare whole blended panoramas, and the light that a glossy sphere reflects in them."""
        options = self.options
        hdr, blended = predict_panoramas(model, sglv, batch, bf16=options.bf16)
        log_l2 = log_l2_loss(blended, batch.truth)
        if options.stage == "single-joint":  # keeps the volume accurate where nothing is blended in
            log_l2 = (log_l2 + log_l2_loss(hdr, batch.truth)) / 2
        sphere = draw_sphere(batch, pixels=options.sphere_pixels, samples=options.sphere_samples, generator=generator)
        shaded, true_shaded = (shade(sphere, radiance_along(sphere, light)) for light in (blended, batch.truth))
        return log_l2, rendering_loss(shaded, true_shaded)

    def _autocast(self) -> torch.autocast:
        return torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.options.bf16)

    # --- validation

    def scores(self, model: SingleModel) -> Mapping[str, float]:
        """Score held-out sequences: log-L2 and rendering loss of each method, and the stage's own loss."""
        return self._validation.scores(lambda batch: self._predict(model, batch)) if len(self._held_out) else {}

    def draw(self, model: SingleModel, path: Path) -> None:
        """Write frames, true and predicted panoramas of held-out sequences."""
        if len(self._held_out):
            self._validation.draw(lambda batch: self._predict(model, batch), path)

    def _predict(self, model: SingleModel, batch: Batch) -> dict[str, Float[Tensor, "b p 3 h w"]]:
        """Predict the panoramas of the networks that the stage trains, by name, at the height of `batch.truth`."""
        here = batch.to(self.device)
        sglv = model(here.volume)
        if self.options.stage == "single-sglv":
            return {"sglv": render_panoramas(sglv, here, height=batch.truth.shape[-2])}
        hdr, blended = predict_panoramas(model, sglv, here, weight_height=self.options.panorama_height, bf16=False)
        return {"sglv": hdr, "blended": blended}

    @cached_property
    def _validation(self) -> SingleViewValidation:
        options = self.options
        return SingleViewValidation(
            self._held_out,
            volume_shape=options.volume_shape,
            frames=options.frames,
            rendering_weight=options.rendering_weight,
        )


def predict_panoramas(
    model: SingleModel,
    sglv: SGVolume,
    batch: Batch,
    *,
    bf16: bool,
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
    hdr = render_panoramas(sglv, batch, height=batch.truth.shape[-2])
    panels = hdr.flatten(0, 1), batch.partial.flatten(0, 1), batch.mask.flatten(0, 1)
    with torch.autocast(hdr.device.type, dtype=torch.bfloat16, enabled=bf16):
        if weight_height is None:
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
    return blend(fill_in(hdr, ldr, mask, weight=weight), ldr, weight * mask)


def train_only(model: nn.Module, stage: str, *, volume: tuple[nn.Module, ...], panorama: tuple[nn.Module, ...]) -> None:
    """Let only the networks require a gradient that a stage trains: `-sglv`, `-blend`, or both in `-joint`."""
    model.requires_grad_(False)
    if not stage.endswith("-blend"):
        for module in volume:
            module.requires_grad_(True)
    if not stage.endswith("-sglv"):
        for module in panorama:
            module.requires_grad_(True)


def channels_last(networks: tuple[nn.Module, ...]) -> None:
    """Set channels-last memory: a step of the 3D networks takes 157 ms of CPU time in bf16 and 349 in fp32; without
    it 206 and 1,570.
    """
    for network in networks:
        network.to(memory_format=torch.channels_last_3d)  # pyright: ignore[reportCallIssue]
