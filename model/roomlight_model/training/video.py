"""The video stages: options, data, the recursion of the engine's video form, and losses through time.

| stage       | trains             | light compared, in every frame after the first |
|-------------|--------------------|------------------------------------------------|
| video-sglv  | SG*, SGGRU*        | as single-sglv                                 |
| video-blend | Blend*, BlendGRU*  | as single-blend                                |
| video-joint | all recurrent ones | as single-joint                                |

The single-view networks run the first frame and stay as they are. Losses are means over the other frames, with the
smoothness between consecutive ones. The networks of a frame are recomputed in the backward pass
(`torch.utils.checkpoint`): only the states between the frames are kept.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import torch
from annotated_types import Ge, Interval
from jaxtyping import Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from roomlight.engine.panorama.blend import CLOSER_M
from roomlight.errors import ModelError
from roomlight_model.accumulate import Observation, Panorama
from roomlight_model.checkpoint import Checkpoint
from roomlight_model.networks import BlendState, SGState, SingleModel, VideoModel
from roomlight_model.sphere_rendering import shade
from roomlight_model.training.batches import fill_detail
from roomlight_model.training.light_changes import LightChanges
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
from roomlight_model.training.sequences import (
    LightChange,
    PreparedWalk,
    WalkBatch,
    collate_walks,
    draw_length,
    read_walk,
    with_views,
)
from roomlight_model.training.single_view import SingleViewOptions, channels_last, train_only
from roomlight_model.training.subsets import Recordings
from roomlight_model.training.validation import WalkValidation

VideoStageName = Literal["video-sglv", "video-blend", "video-joint"]
_VALIDATION_RAYS: Final = 2048


@dataclass(frozen=True)
class VideoOptions(SingleViewOptions):
    """Options of a video stage, beside those of the single-view stages.

    Attributes:
        stage: What is trained; see `training.video`.
        batch: Sequences in a batch.
        frames: Largest number of frames of a sequence, 2 or more.
        smoothness_weight: Weight of the difference between the panoramas of consecutive frames.
        light_changes: Share of sequences whose light changes at a frame (`training.light_changes`).
        revisits: Share of sequences that stop at a frame or return the way they came, so that the networks see the
            same places again.

    Raises:
        OptionError: A value is out of range.
    """

    stage: VideoStageName = "video-sglv"  # pyright: ignore[reportIncompatibleVariableOverride]
    batch: Annotated[int, Ge(1)] = 2
    learning_rate: Annotated[float, Interval(gt=0, le=1)] = 3e-4
    frames: Annotated[int, Ge(2)] = 31
    smoothness_weight: Annotated[float, Interval(ge=0, le=100)] = 0.01
    light_changes: Annotated[float, Interval(ge=0, le=1)] = 0.0
    revisits: Annotated[float, Interval(ge=0, le=1)] = 0.0


class VideoStage:
    """One of the video stages on some walks."""

    def __init__(
        self,
        options: VideoOptions,
        training: Recordings,
        held_out: Recordings,
        *,
        device: torch.device,
        start_from: Checkpoint | None,
        data: list[dict[str, Any]] | None = None,
        change_light: LightChange | None = None,
    ) -> None:
        """Take the data and the weights to start from.

        Args:
            options: The stage and its hyperparameters; the widths become those of `start_from`.
            held_out: Walks that are scored and not trained on.
            start_from: Single-view weights, or those of the video stage before.
            data: The description of the datasets for the card.
            change_light: Changes the light of sequences at a frame; None changes it as `options.light_changes` says.

        Raises:
            ModelError: `start_from` is missing or holds other networks.
        """
        if start_from is None or start_from.form not in ("single", "video"):
            raise ModelError(
                f"stage {options.stage} starts from trained weights: give `start_from` a single-view checkpoint or "
                "model folder, or the checkpoint of the video stage before"
            )
        self.options = options = replace(options, model=start_from.config)
        self.device, self.data, self.start_from = device, data or [], start_from
        self.piece_size = 1  # the frames of a sequence are work enough for a thread
        self._training, self._held_out = training, held_out
        if change_light is None and options.light_changes:
            change_light = LightChanges(options.light_changes)
        self._change_light = change_light

    # --- data

    def __len__(self) -> int:
        return len(self._training)

    def batch(self, step: int) -> WalkBatch:
        """Draw, augment and collate the sequences of a step, all of one length: they run side by side."""
        options = self.options
        drawn = list(options.draw_examples(len(self), step))
        most = min(options.frames, *(self._training.frames_of(index) for index, _ in drawn))
        length = draw_length(most, options.rng(step, options.batch)) if options.augment else most
        walks = [
            PreparedWalk.of(
                read_walk(
                    self._training,
                    index,
                    own,
                    depth=options.depth,
                    length=length,
                    augment=options.augment,
                    change_light=self._change_light,
                    revisits=options.revisits,
                ),
                options.volume_shape,
            )
            for index, own in drawn
        ]
        height = None if options.stage == "video-sglv" else options.panorama_height
        batch = collate_walks(walks, panorama_height=height)
        if height is None:
            return batch
        return with_views(batch, walks, panorama_height=height)

    # --- networks

    def network(self) -> VideoModel:
        """Build the networks; those that the stage trains require a gradient."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.options.seed)
            model = VideoModel(self.options.trained_model)
        if isinstance(self.start_from.model, SingleModel):
            model.single.load_state_dict(self.start_from.model.state_dict())
            model.warm_start()
        else:
            model.load_state_dict(self.start_from.model.state_dict())
        volume = (model.sg_encoder, model.sg_decoder, model.sg_gru0, model.sg_gru1)
        panorama = (model.blend_encoder, model.blend_decoder, model.blend_gru0, model.blend_gru1)
        train_only(model, self.options.stage, volume=volume, panorama=panorama)
        channels_last((*volume, model.single.sg_encoder, model.single.sg_decoder))
        return model.to(self.device)

    # --- forward and loss

    def losses(self, model: VideoModel, batch: WalkBatch, generator: torch.Generator) -> Losses:
        """Return the mean losses over all frames after the first."""
        sequence = Unroll(model, batch, self.options, generator=generator)
        frames = [sequence.advance(frame) for frame in range(1, batch.frames)]
        return {name: torch.stack([now[name] for now in frames]).sum() / len(frames) for name in frames[0]}

    # --- validation

    def scores(self, model: VideoModel) -> Mapping[str, float]:
        """Score held-out walks, all frames and intervals of them, beside each frame alone."""
        return self._validation.scores(partial(self._unroll, model)) if len(self._held_out) else {}

    def draw(self, model: VideoModel, path: Path) -> None:
        """Write the true and predicted panoramas of held-out walks."""
        if len(self._held_out):
            self._validation.draw(partial(self._unroll, model), path)

    def _unroll(self, model: VideoModel, batch: WalkBatch) -> "Unroll":
        # joint training also keeps the volume alone accurate; what counts here is what a probe shows
        stage = "video-sglv" if self.options.stage == "video-sglv" else "video-blend"
        options = replace(self.options, stage=stage, rays=_VALIDATION_RAYS, bf16=False)
        return Unroll(model, batch.to(self.device), options, generator=torch.Generator().manual_seed(0))

    @cached_property
    def _validation(self) -> WalkValidation:
        options = self.options
        return WalkValidation(
            self._held_out,
            frames=options.frames,
            depth=options.depth,
            volume_shape=options.volume_shape,
            panorama_height=options.panorama_height,
            with_probes=options.stage != "video-sglv",
        )


class Unroll:
    """One pass over a batch of sequences. Random directions are drawn once, from `generator`, on the CPU."""

    def __init__(
        self,
        model: VideoModel,
        batch: WalkBatch,
        options: VideoOptions,
        *,
        generator: torch.Generator,
    ) -> None:
        """Draw the directions of the losses and run the first frame."""
        self._model, self._batch, self._options = model, batch, options
        self._device = batch.origins.device
        self._blends = options.stage != "video-sglv"
        self._trains_volume = options.stage != "video-blend"
        self._sphere = draw_sphere(
            batch, pixels=options.sphere_pixels, samples=options.sphere_samples, generator=generator
        )
        height = batch.lights.shape[-2]
        self._pixels = torch.randint(2 * height * height, (*batch.origins.shape[:2], options.rays), generator=generator)
        self._pixels = self._pixels.to(self._device)
        along = panorama_directions(height, self._device)[self._pixels]
        self._directions = torch.cat([along, self._sphere.directions.flatten(2, 3)], dim=2)
        self.probe_state: BlendState | None = None
        with torch.no_grad():
            with _autocast(options, self._device):
                self.volume_state = _in_float32(model.start(batch.volume[:, 0]))
            self._hdr, self._light = self._observe(0)

    def first_losses(self) -> Losses:
        """Return the losses of the first frame; call it before `advance`."""
        return self._losses(0, self._light)

    def panoramas(self) -> Float[Tensor, "b p 3 h w"]:
        """Return the panoramas after the latest frame: blended, or the volume's in the stage that trains only it."""
        if self.probe_state is not None:
            return self.probe_state.panorama.radiance.unflatten(0, self._batch.origins.shape[:2])
        return render_panoramas(self.volume_state.volume, self._batch, height=self._batch.lights.shape[-2])

    def advance(self, frame: int) -> Losses:
        """Run one frame after the first and return its losses."""
        with torch.set_grad_enabled(self._trains_volume and torch.is_grad_enabled()):
            self.volume_state = self._volume_step(self._batch.volume[:, frame], self.volume_state)
        before = self._light
        self._hdr, self._light = self._observe(frame)
        return self._losses(frame, before)

    def _observe(self, frame: int) -> tuple[Tensor, Tensor]:
        """Render the volume at the probes; return (HDR, the light of the loss): along rays, or blended panoramas."""
        batch = self._batch
        with torch.set_grad_enabled(self._trains_volume and torch.is_grad_enabled()):
            if not self._blends:
                light = render_rays(self.volume_state.volume, batch, self._directions)
                return light, light
            hdr = render_panoramas(self.volume_state.volume, batch, height=batch.lights.shape[-2])
        self.probe_state = self._probe_step(self._observation(frame, hdr.flatten(0, 1)), self.probe_state)
        return hdr, self.probe_state.panorama.radiance.unflatten(0, hdr.shape[:2])

    def _losses(self, frame: int, before: Tensor) -> Losses:
        """Compare the light of a frame with its truth, and with the light before."""
        options, truth, light = self._options, self._batch.truth(frame), self._light
        sphere = self._sphere
        if self._blends:
            reflected = radiance_along(sphere, light)
            log_l2, smoothness = log_l2_loss(light, truth), log_l2_loss(light, before)
            if options.stage == "video-joint":  # keeps the volume accurate where nothing is blended in
                log_l2 = (log_l2 + log_l2_loss(self._hdr, truth)) / 2
        else:  # light along the directions: random pixels, then the sphere's
            wanted = truth.flatten(3).transpose(2, 3).gather(2, self._pixels[..., None].expand(-1, -1, -1, 3))
            at_pixels, at_sphere = light[:, :, : options.rays], light[:, :, options.rays :]
            reflected = at_sphere.unflatten(2, sphere.weights.shape[2:])
            log_l2 = log_l2_loss(at_pixels, wanted)
            smoothness = log_l2_loss(at_pixels, before[:, :, : options.rays])
        rendering = rendering_loss(shade(sphere, reflected), shade(sphere, radiance_along(sphere, truth)))
        total = log_l2 + options.rendering_weight * rendering + options.smoothness_weight * smoothness
        return {"loss": total, "log_l2": log_l2, "rendering": rendering, "smoothness": smoothness}

    def _volume_step(self, volume: Float[Tensor, "b 5 z y x"], state: SGState) -> SGState:
        def step(volume: Tensor, state: SGState) -> SGState:
            with _autocast(self._options, self._device):
                return _in_float32(self._model.step(volume, state))

        return _recomputed(step, volume, state)

    def _probe_step(self, observation: Observation, state: BlendState | None) -> BlendState:
        margin = (CLOSER_M / self._batch.depth_max_m).repeat_interleave(self._batch.origins.shape[1])

        def step(observation: Observation, state: BlendState | None) -> BlendState:
            with _autocast(self._options, self._device):
                if state is None:
                    return self._model.blend_start(observation)
                return self._model.blend_step(observation, state, margin=margin[:, None, None, None])

        return _recomputed(step, observation, state)

    def _observation(self, frame: int, hdr: Float[Tensor, "n 3 h w"]) -> Observation:
        """Return the probes' panoramas of a frame, with a fill of what was seen so far; the fill has no gradient."""
        batch = self._batch
        if batch.detail is None or batch.mask is None or batch.distance_m is None:
            raise ValueError("sequences for blending need the probes' views: add them with `with_views`")
        detail, mask, distance_m = (
            values[:, frame].flatten(0, 1) for values in (batch.detail, batch.mask, batch.distance_m)
        )
        depth_max_m = batch.depth_max_m.repeat_interleave(batch.origins.shape[1])
        state = None if self.probe_state is None else self.probe_state.panorama
        filled = [
            fill_detail(
                None if state is None else Panorama(*(part[k] for part in state[:3])), *values, float(depth_max_m[k])
            )
            for k, values in enumerate(zip(detail, mask, distance_m, hdr, strict=True))
        ]
        depth = distance_m / depth_max_m[:, None, None, None]
        clipped, guessed = (
            None if values is None else values[:, frame].flatten(0, 1) for values in (batch.clipped, batch.guessed)
        )
        return Observation(hdr, torch.stack(filled).to(hdr.device), mask, depth, clipped, guessed)


def _autocast(options: VideoOptions, device: torch.device) -> torch.autocast:
    return torch.autocast(device.type, dtype=torch.bfloat16, enabled=options.bf16)


def _recomputed(step: Callable[[Any, Any], Any], given: Any, state: Any) -> Any:
    """Run a step whose inner values are recomputed in the backward pass, if there will be one."""
    if not torch.is_grad_enabled():
        return step(given, state)
    return checkpoint(step, given, state, use_reentrant=False, preserve_rng_state=False)  # there is no dropout


def _in_float32(state: SGState) -> SGState:
    """Keep hidden states in full precision under autocast; they add up over the frames."""
    return state._replace(h0=state.h0.float(), h1=state.h1.float())
