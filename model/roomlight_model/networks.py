"""The whole models: `SingleModel` for one image, `VideoModel` for sequences (paper, network section).

Rendering and the partial mesh come between the 3D and the 2D networks, so that each model has two halves: the caller
runs the first, renders panoramas at its probes, and runs the second. Shapes have a batch dimension.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from roomlight_model.accumulate import Observation, Panorama, accepted, accumulate, blend, fill_in, first_panorama
from roomlight_model.config import ModelConfig
from roomlight_model.panorama_networks import (
    SINGLE_PANELS,
    VIDEO_PANELS,
    BlendDecoder,
    BlendEncoder,
    BlendGRU,
    single_panels,
    video_panels,
)
from roomlight_model.volume_networks import SGGRU, SGDecoder, SGEncoder, SGVolume, mean_colour, merge


class SGState(NamedTuple):
    """State of the 3D recursion: hidden states and the previous volume."""

    h0: Float[Tensor, "b c0 z0 y0 x0"]
    h1: Float[Tensor, "b c1 z1 y1 x1"]
    volume: SGVolume
    unit: Float[Tensor, "b 3 1 1 1"]
    """The first frame's mean colour, in whose units the hidden states are."""


class BlendState(NamedTuple):
    """State of the 2D recursion of one probe: hidden states and the accumulated panorama."""

    h0: Float[Tensor, "b c0 h0 w0"]
    h1: Float[Tensor, "b c1 h1 w1"]
    panorama: Panorama


class SingleModel(nn.Module):
    """Single-view prediction: SGEncoder, SGDecoder, BlendEncoder, BlendDecoder."""

    form = "single"

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.sg_encoder = SGEncoder(config.sg)
        self.sg_decoder = SGDecoder(config.sg, recurrent=False)
        self.blend_encoder = BlendEncoder(config.blend, panels=SINGLE_PANELS)
        self.blend_decoder = BlendDecoder(config.blend)

    def forward(self, volume: Float[Tensor, "b 5 z y x"]) -> SGVolume:
        """Predict the lighting volume of an initial volume: V = SGDecoder(SGEncoder(V_tilde))."""
        f0, f1 = self.sg_encoder(volume)
        return self.sg_decoder(f0, f1, volume)

    def blend(
        self, hdr: Float[Tensor, "b 3 h w"], ldr: Float[Tensor, "b 3 h w"], mask: Float[Tensor, "b 1 h w"]
    ) -> tuple[Float[Tensor, "b 3 h w"], Float[Tensor, "b 1 h w"]]:
        """Return (L, L_M) at a probe from the volume's rendering, the mesh's (filled outside its mask) and its mask."""
        f0, f1 = self.blend_encoder(single_panels(hdr, ldr, mask))
        weight = self.blend_decoder(f0, f1, mask)
        return blend(fill_in(hdr, ldr, mask, weight=weight), ldr, weight * mask), weight


class VideoModel(nn.Module):
    """Recurrent prediction; frame 0 uses the single-view networks, which the model contains."""

    form = "video"

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.single = SingleModel(config)
        self.sg_encoder = SGEncoder(config.sg)
        self.sg_gru0 = SGGRU(config.sg.channels, gate_kernel=1)
        self.sg_gru1 = SGGRU(4 * config.sg.channels)
        self.sg_decoder = SGDecoder(config.sg, recurrent=True)
        self.blend_encoder = BlendEncoder(config.blend, panels=VIDEO_PANELS)
        self.blend_gru0 = BlendGRU(config.blend.channels)
        self.blend_gru1 = BlendGRU(4 * config.blend.channels)
        self.blend_decoder = BlendDecoder(config.blend)

    def warm_start(self) -> None:
        """Copy the single-view weights into the recurrent networks: the start of the paper's video training.

        Weights without a single-view counterpart: V_u keeps its initial values, the GRUs nearly pass the mean of state
        and feature on, the input panels of the previous panorama and of depth get 0.
        """
        for gru in (self.sg_gru0, self.sg_gru1, self.blend_gru0, self.blend_gru1):
            gru.pass_features()
        self.sg_encoder.load_state_dict(self.single.sg_encoder.state_dict())
        self.blend_decoder.load_state_dict(self.single.blend_decoder.state_dict())
        _copy_rows(self.sg_decoder, self.single.sg_decoder)
        _copy_panels(self.blend_encoder, self.single.blend_encoder)

    def start(self, volume: Float[Tensor, "b 5 z y x"]) -> SGState:
        """Run frame 0 through the single-view networks; their features become the hidden states."""
        f0, f1 = self.single.sg_encoder(volume)
        return SGState(f0, f1, self.single.sg_decoder(f0, f1, volume), mean_colour(volume))

    def step(self, volume: Float[Tensor, "b 5 z y x"], state: SGState) -> SGState:
        """Run frame i > 0; initial volumes share the first frame's grid."""
        f0, f1 = self.sg_encoder(volume, state.unit)  # eq. 3dRNN
        h0 = self.sg_gru0(state.h0, f0)
        h1 = self.sg_gru1(state.h1, f1)
        current = self.sg_decoder(h0, h1, volume, state.unit)  # eq. 3dMerge
        return SGState(h0, h1, merge(current, state.volume.alpha, state.volume.lobes), state.unit)

    def blend_start(self, seen: Observation) -> BlendState:
        """Run frame 0 at a probe by single-view blending; its features become the hidden states."""
        f0, f1 = self.single.blend_encoder(single_panels(seen.hdr, seen.ldr, seen.mask))
        weight = self.single.blend_decoder(f0, f1, seen.mask).to(seen.mask.dtype)
        filled = seen._replace(hdr=fill_in(seen.hdr, seen.ldr, seen.mask, weight=weight))
        return BlendState(f0, f1, first_panorama(filled, weight * seen.mask))

    def blend_step(
        self, seen: Observation, state: BlendState, *, margin: float | Float[Tensor, "b 1 1 1"]
    ) -> BlendState:
        """Run frame i > 0 at a probe; `margin` is the conservative rule's, in units of each volume's depth_max_m."""
        panels = video_panels(
            state.panorama.radiance,
            seen.hdr,
            seen.ldr,
            mask=seen.mask,
            depth=seen.depth,
            accumulated_depth=state.panorama.depth,
        )
        f0, f1 = self.blend_encoder(panels)
        h0 = self.blend_gru0(state.h0, f0)
        h1 = self.blend_gru1(state.h1, f1)
        weight = self.blend_decoder(h0, h1, seen.mask).to(seen.mask.dtype)
        filled = seen._replace(hdr=fill_in(seen.hdr, seen.ldr, seen.mask, weight=weight))
        weight = accepted(weight * seen.mask, seen, state.panorama, margin=margin)
        return BlendState(h0, h1, accumulate(state.panorama, filled, weight))


def _copy_rows(video: SGDecoder, single: SGDecoder) -> None:
    """Copy a decoder into one with more heads: V_u is the last row and keeps its start."""
    own, given = video.state_dict(), single.state_dict()
    with torch.no_grad():
        for name, value in given.items():
            own[name][: len(value)].copy_(value)


def _copy_panels(video: BlendEncoder, single: BlendEncoder) -> None:
    """Copy an encoder of 8 panels into one of 13: HDR, LDR and masks sit at 3..10 there, the rest is 0."""
    own, given = video.state_dict(), single.state_dict()
    with torch.no_grad():
        for name, value in given.items():
            if own[name].shape == value.shape:
                own[name].copy_(value)
            else:
                own[name].zero_()
                own[name][:, 3 : 3 + SINGLE_PANELS] = value
