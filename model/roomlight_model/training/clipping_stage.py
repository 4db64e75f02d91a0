"""The stage `clipping`: loss and scores of the network of clipped radiance."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from roomlight.engine.networks.graphs import PartForm
from roomlight.errors import DatasetError
from roomlight_model.clipping_network import ClippingNetwork
from roomlight_model.training.clipping_examples import CLIPPED, ClippingFrames, clipping_batch

ENERGY_WEIGHT: Final = 0.3
"""Weight of the error of a frame's whole clipped light beside that of its pixels."""
_LEAST: Final = 30.0
"""Clipped pixels (at half the input's resolution) from which a frame counts fully."""


@dataclass(frozen=True)
class ClippingStage:
    """Trains `ClippingNetwork` on frames; held-out frames score it.

    Raises:
        DatasetError: No held-out frame has a clipped pixel.
    """

    frames: ClippingFrames
    held_out: ClippingFrames

    def __post_init__(self) -> None:
        if not (self.held_out.radiance >= CLIPPED).any():
            raise DatasetError(
                f"none of the {len(self.held_out)} held-out frames has a clipped pixel: nothing could be scored; "
                "give a larger dataset"
            )

    @property
    def form(self) -> PartForm:
        """The form of the network."""
        return "clipping"

    def network(self) -> ClippingNetwork:
        """Build the network."""
        return ClippingNetwork()

    def __len__(self) -> int:
        """Return the number of training examples."""
        return len(self.frames)

    def loss(self, network: torch.nn.Module, chosen: list[int], rng: np.random.Generator) -> Float[Tensor, ""]:
        """Return the loss of a batch: squared errors of log radiance, of pixels and of each frame's clipped light."""
        planes, truth, weight = clipping_batch(self.frames, chosen, rng, augment=True)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            predicted = network(planes)
        pixels, energy = _errors(predicted.float(), truth, weight)
        return pixels + ENERGY_WEIGHT * energy

    def scores(self, network: torch.nn.Module) -> Mapping[str, float]:
        """Score held-out frames: squared log errors of pixels and light, and of the constants 2 x white beside them."""
        rng = np.random.default_rng(0)
        ours, constant, light = list[float](), list[float](), list[float]()
        with torch.no_grad():
            for first in range(0, len(self.held_out), 16):
                chosen = range(first, min(first + 16, len(self.held_out)))
                planes, truth, weight = clipping_batch(self.held_out, chosen, rng, augment=False)
                if not weight.any():
                    continue
                pixels, energy = _errors(network(planes).float(), truth, weight)
                ours.append(float(pixels))
                light.append(float(energy))
                constant.append(float(_errors(torch.full_like(truth, float(np.log(2))), truth, weight)[0]))
        return {"loss": float(np.mean(ours)), "light": float(np.mean(light)), "constant_2": float(np.mean(constant))}


def _errors(
    log_radiance: Float[Tensor, "b 3 h w"], truth: Float[Tensor, "b 3 h w"], weight: Float[Tensor, "b 1 h w"]
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    known = truth.clamp(min=0.1)
    area = weight.sum((1, 2, 3))
    share = (area / _LEAST).clamp(max=1)
    total = share.sum().clamp(min=1e-6)
    each = ((log_radiance - known.log()).square().mean(1, keepdim=True) * weight).sum((1, 2, 3)) / area.clamp(min=1e-6)
    light = (log_radiance.exp() * weight).mean(1).sum((1, 2)).clamp(min=1e-4)
    true_light = (known * weight).mean(1).sum((1, 2)).clamp(min=1e-4)
    return (each * share).sum() / total, ((light.log() - true_light.log()).square() * share).sum() / total
