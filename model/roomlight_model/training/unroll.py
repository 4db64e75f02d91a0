"""Losses and gradients of sequences: the recursion of the engine's video form, with back-propagation through time.

The networks of one frame are recomputed in the backward pass (`torch.utils.checkpoint`), so that the states between
frames are all that is kept, and only for the frames of a window: then gradients are taken and the states detached.
Ray marching keeps its inputs alone, which are such states. The first frame is the single-view networks', without a
gradient; losses are means over the others.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from roomlight.engine.panorama.blend import CLOSER_M, PanoramaState, filled_detail
from roomlight_model.accumulate import Panorama
from roomlight_model.networks import BlendState, Observation, SGState, VideoModel
from roomlight_model.sphere_rendering import shade
from roomlight_model.training.options import TrainOptions
from roomlight_model.training.sequences import WalkBatch
from roomlight_model.training.stages import (
    Losses,
    draw_sphere,
    light_along,
    log_l2_loss,
    panorama_directions,
    rendered,
    rendered_panoramas,
    rendering_loss,
    summed,
)
from roomlight_model.training.step_clock import StepClock

_FLOAT_BYTES: Final = 4


def window_mb(options: TrainOptions) -> float:
    """Return the memory in MB that the states of a window take for one batch, next to one frame's activations."""
    sg, (z, y, x) = options.model.sg, options.volume_shape
    h, probes = options.panorama_height, 3
    half, eighth = (z // 2) * (y // 2) * (x // 2), (z // 8) * (y // 8) * (x // 8)
    floats = 0
    if options.stage != "video-blend":
        floats += sg.channels * half + 4 * sg.channels * eighth + 2 * 11 * z * y * x  # states; gradients of a volume
    if options.stage != "video-sglv":
        blend = options.model.blend
        floats += probes * 2 * h * h * (4 * 3 + 4)  # HDR, filled detail, blended, truth; mask, depths, weight
        floats += probes * (blend.channels * (h // 2) * h + 4 * blend.channels * (h // 8) * (h // 4))
    frames = min(options.window, options.frames - 1)
    return _FLOAT_BYTES * floats * frames * options.batch / 1e6


class Unroll:
    """One pass over a batch of sequences. Random directions are drawn once, from `generator`, on the CPU."""

    def __init__(
        self,
        model: VideoModel,
        batch: WalkBatch,
        options: TrainOptions,
        *,
        generator: torch.Generator,
        device: torch.device,
        clock: StepClock | None = None,
    ) -> None:
        """Draw the directions of the losses and run the first frame."""
        self._model, self._batch, self._options, self._device, self._clock = model, batch, options, device, clock
        self._blends = options.stage != "video-sglv"
        self._trains_volume = options.stage != "video-blend"
        self._sphere = draw_sphere(batch, options, generator=generator) if options.sphere_pixels else None
        height = batch.lights.shape[-2]
        self._pixels = torch.randint(2 * height * height, (*batch.origins.shape[:2], options.rays), generator=generator)
        self._pixels = self._pixels.to(device)
        self._directions = panorama_directions(height, device)[self._pixels]
        if self._sphere is not None:
            self._directions = torch.cat([self._directions, self._sphere.directions.flatten(2, 3)], dim=2)
        self._volume_state: SGState | None = None
        with torch.no_grad():
            if batch.hdr is None:
                with self._part("forward"), self._autocast():
                    self._volume_state = _in_float32(model.start(batch.volume[:, 0]))
            self.probe_state: BlendState | None = None
            self._hdr, self._light = self._observe(0)

    def gradients(self, parameters: Sequence[nn.Parameter]) -> tuple[Losses, list[Tensor | None]]:
        """Run the other frames; return the mean losses, detached, and the gradients of their total."""
        frames = self._batch.frames
        gradients: list[Tensor | None] = [None for _ in parameters]
        losses: list[Losses] = []
        for start in range(1, frames, self._options.window):
            stop = min(start + self._options.window, frames)
            window = [self.advance(frame) for frame in range(start, stop)]
            total = torch.stack([one.total for one in window]).sum() / (frames - 1)
            with self._part("backward"):
                found = torch.autograd.grad(total, parameters, allow_unused=True)
                gradients = [_added(one, other) for one, other in zip(gradients, found, strict=True)]
            losses += [Losses(*(loss.detach() for loss in one)) for one in window]
            self._detach()
        means = [torch.stack([one[k] for one in losses]).mean() for k in range(len(Losses._fields))]
        return Losses(*means), gradients

    @property
    def volume_state(self) -> SGState:
        """The 3D state after the latest frame; a batch with renderings (`with_renderings`) has none."""
        assert self._volume_state is not None
        return self._volume_state

    def first_losses(self) -> Losses:
        """Return the losses of the first frame; call it before `advance`."""
        return self._losses(0, self._hdr, self._light, self._light)

    def panoramas(self) -> Float[Tensor, "b p 3 h w"]:
        """Return the panoramas after the latest frame: blended, or the volume's in the stage that trains only it."""
        if self.probe_state is not None:
            return self.probe_state.panorama.radiance.unflatten(0, self._batch.origins.shape[:2])
        height = self._batch.lights.shape[-2]
        return rendered_panoramas(self.volume_state.volume, self._batch, height=height, device=self._device)

    def advance(self, frame: int) -> Losses:
        """Run one frame after the first and return its losses."""
        if self._volume_state is not None:
            with self._part("forward"), torch.set_grad_enabled(self._trains_volume and torch.is_grad_enabled()):
                self._volume_state = self._volume_step(self._batch.volume[:, frame], self._volume_state)
        before = self._light
        self._hdr, self._light = self._observe(frame)
        with self._part("blend" if self._blends else "march"):
            return self._losses(frame, self._hdr, self._light, before)

    def _losses(self, frame: int, hdr: Tensor, light: Tensor, before: Tensor) -> Losses:
        truth = self._batch.truth(frame)
        if not self._blends:  # light along the directions: random pixels, then the sphere's
            wanted = truth.flatten(3).transpose(2, 3).gather(2, self._pixels[..., None].expand(-1, -1, -1, 3))
            rays = self._options.rays
            log_l2, smooth = (
                log_l2_loss(light[:, :, :rays], wanted),
                log_l2_loss(light[:, :, :rays], before[:, :, :rays]),
            )
            lit = light[:, :, rays:]
        else:
            log_l2, smooth = log_l2_loss(light, truth), log_l2_loss(light, before)
            if self._options.stage == "video-joint":  # keeps the volume accurate where nothing is blended in
                log_l2 = (log_l2 + log_l2_loss(hdr, truth)) / 2
            lit = None
        if self._sphere is None:
            return summed(log_l2, torch.zeros_like(log_l2), self._options, smoothness=smooth)
        sphere = self._sphere
        along = light_along(sphere, light) if lit is None else lit.unflatten(2, sphere.weights.shape[2:])
        rendering = rendering_loss(shade(sphere, along), shade(sphere, light_along(sphere, truth)))
        return summed(log_l2, rendering, self._options, smoothness=smooth)

    def _observe(self, frame: int) -> tuple[Tensor, Tensor]:
        """Render the volume at the probes; return (HDR, the light of the loss): along rays, or blended panoramas."""
        batch = self._batch
        with self._part("march"), torch.set_grad_enabled(self._trains_volume and torch.is_grad_enabled()):
            if not self._blends:
                light = rendered(self.volume_state.volume, batch, self._directions)
                return light, light
            if batch.hdr is not None:
                hdr = batch.hdr[:, frame]
            else:
                height = batch.lights.shape[-2]
                hdr = rendered_panoramas(self.volume_state.volume, batch, height=height, device=self._device)
        with self._part("blend"):
            self.probe_state = self._probe_step(self._observation(frame, hdr.flatten(0, 1)), self.probe_state)
            return hdr, self.probe_state.panorama.radiance.unflatten(0, hdr.shape[:2])

    def _volume_step(self, volume: Float[Tensor, "b 5 z y x"], state: SGState) -> SGState:
        def step(volume: Tensor, state: SGState) -> SGState:
            with self._autocast():
                return _in_float32(self._model.step(volume, state))

        return _recomputed(step, volume, state)

    def _probe_step(self, seen: Observation, state: BlendState | None) -> BlendState:
        margin = (CLOSER_M / self._batch.depth_max_m).repeat_interleave(self._batch.origins.shape[1])[
            :, None, None, None
        ]

        def step(seen: Observation, state: BlendState | None) -> BlendState:
            with self._autocast():
                if state is None:
                    return self._model.blend_start(seen)
                return self._model.blend_step(seen, state, margin=margin)

        return _recomputed(step, seen, state)

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
            _filled(
                None if state is None else Panorama(*(part[k] for part in state[:3])), *values, float(depth_max_m[k])
            )
            for k, values in enumerate(zip(detail, mask, distance_m, hdr, strict=True))
        ]
        depth = distance_m / depth_max_m[:, None, None, None]
        clipped, guessed = (
            None if values is None else values[:, frame].flatten(0, 1) for values in (batch.clipped, batch.guessed)
        )
        return Observation(hdr, torch.stack(filled).to(hdr.device), mask, depth, clipped, guessed)

    def _detach(self) -> None:
        self._volume_state = _detached(self._volume_state)
        if self.probe_state is not None:
            self.probe_state = _detached(self.probe_state)
        self._hdr, self._light = self._hdr.detach(), self._light.detach()

    def _autocast(self) -> torch.autocast:
        return torch.autocast(self._device.type, dtype=torch.bfloat16, enabled=self._options.bf16)

    def _part(self, name: str) -> AbstractContextManager[None]:
        return nullcontext() if self._clock is None else self._clock.part(name)


@torch.no_grad()
def with_renderings(batch: WalkBatch, model: VideoModel, options: TrainOptions, *, device: torch.device) -> WalkBatch:
    """Return the batch with the 3D networks' panoramas in place of its volumes; for the stage that does not train them.

    Raises:
        ValueError: The stage trains the 3D networks.
    """
    if options.stage != "video-blend":
        raise ValueError(f"{options.stage} trains the 3D networks; their panoramas are not fixed")
    here, height = batch.to(device), batch.lights.shape[-2]
    panoramas: list[Tensor] = []
    state: SGState | None = None
    for frame in range(batch.frames):
        volume = here.volume[:, frame]
        with torch.autocast(device.type, dtype=torch.bfloat16, enabled=options.bf16):
            state = _in_float32(model.start(volume) if state is None else model.step(volume, state))
        panoramas.append(rendered_panoramas(state.volume, here, height=height, device=device))
    nothing = batch.volume.new_empty((*batch.volume.shape[:3], 0, 0, 0))
    return replace(batch, volume=nothing, hdr=torch.stack(panoramas, dim=1).to(batch.volume.device))


def _filled(
    state: Panorama | None, detail: Tensor, mask: Tensor, distance_m: Tensor, hdr: Tensor, depth_max_m: float
) -> Float[Tensor, "3 h w"]:
    """Return one probe's detail with the serving engine's fill outside the mesh."""
    height = mask.shape[-2]
    kept = PanoramaState.fresh(height, depth_max_m)
    if state is not None:
        kept.radiance[:] = _image(state.radiance)
        kept.depth_m[:] = _image(state.depth)[..., 0] * np.float32(depth_max_m)
        kept.seen[:] = _image(state.weight)[..., 0]
    filled = filled_detail(
        kept, _image(detail), _image(distance_m)[..., 0], mask=_image(mask)[..., 0] > 0, hdr=_image(hdr)
    )
    return torch.from_numpy(np.ascontiguousarray(np.moveaxis(filled, -1, 0)))


def _image(planes: Float[Tensor, "c h w"]) -> Float[np.ndarray, "h w c"]:
    return np.moveaxis(planes.detach().float().cpu().numpy(), 0, -1)


def _recomputed(step: Callable[[Any, Any], Any], given: Any, state: Any) -> Any:
    """Run a step whose inner values are recomputed in the backward pass, if there will be one."""
    if not torch.is_grad_enabled():
        return step(given, state)
    return checkpoint(step, given, state, use_reentrant=False, preserve_rng_state=False)  # there is no dropout


def _detached(state: Any) -> Any:
    """Return a named tuple of tensors, nested or not, without gradients."""
    if isinstance(state, Tensor):
        return state.detach()
    return None if state is None else type(state)(*(_detached(part) for part in state))


def _in_float32(state: SGState) -> SGState:
    """Keep hidden states in full precision under autocast; they add up over the frames."""
    return state._replace(h0=state.h0.float(), h1=state.h1.float())


def _added(sum_: Tensor | None, gradient: Tensor | None) -> Tensor | None:
    if sum_ is None or gradient is None:
        return gradient if sum_ is None else sum_
    return sum_ + gradient
