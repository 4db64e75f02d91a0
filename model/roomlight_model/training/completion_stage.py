"""The stage `completion`: loss and scores of the network that completes panoramas."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from roomlight.conventions import panorama_rays, panorama_solid_angles
from roomlight.engine.networks.graphs import PartForm
from roomlight.engine.panorama.panels import HEIGHT, PANELS
from roomlight_model.completion_network import CompletionNetwork
from roomlight_model.training.completion_examples import CompletionExamples, completion_batch
from roomlight_model.training.stages import EVEN, relative_error

SPHERE_WEIGHT: Final = 0.01
"""Weight of the error of light on surfaces: without it the network predicts the mean of the logarithm everywhere, and
with that too little energy."""
_SCALE: Final = 0.06
_LOBES: Final = 64
_GLOSSY_POWER: Final = 24


@dataclass(frozen=True)
class CompletionStage:
    """Trains `CompletionNetwork`; held-out examples score it."""

    examples: CompletionExamples
    held_out: CompletionExamples

    @property
    def form(self) -> PartForm:
        """The form of the network."""
        return "completion"

    def network(self) -> CompletionNetwork:
        """Build the network."""
        return CompletionNetwork()

    def __len__(self) -> int:
        """Return the number of training examples."""
        return len(self.examples)

    def loss(self, network: torch.nn.Module, chosen: list[int], rng: np.random.Generator) -> Float[Tensor, ""]:
        """Return the loss of a batch: log-L2 relative to the classical fill's, and the light on surfaces."""
        panels, truth = completion_batch(self.examples, chosen, rng, augment=True)
        panels = panels[:, :PANELS]
        error, fill, surfaces = _errors(completed(network, panels), panels, truth)
        return relative_error(error, fill).mean() * _SCALE + SPHERE_WEIGHT * surfaces.mean()

    def scores(self, network: torch.nn.Module) -> Mapping[str, float]:
        """Score held-out examples: mean ratio of log-L2 to the classical fill's (`loss`), energy, both log-L2."""
        ratios, ours, classical, energy = list[float](), list[float](), list[float](), list[float]()
        rng, weight = np.random.default_rng(0), solid_angles()
        with torch.no_grad():
            for first in range(0, len(self.held_out), 32):
                chosen = range(first, min(first + 32, len(self.held_out)))
                panels, truth = completion_batch(self.held_out, chosen, rng, augment=False)
                panels = panels[:, :PANELS]
                light = completed(network, panels)
                error, fill, _ = _errors(light, panels, truth)
                ratios += ((error + EVEN / 4) / (fill + EVEN / 4)).tolist()
                ours += error.tolist()
                classical += fill.tolist()
                energy += ((light * weight).sum((1, 2, 3)) / (truth * weight).sum((1, 2, 3)).clamp(min=1e-6)).tolist()
        return {
            "loss": float(np.mean(ratios)),
            "energy": float(np.median(energy)),
            "log_l2": float(np.mean(ours)),
            "classical_log_l2": float(np.mean(classical)),
        }


def completed(network: torch.nn.Module, panels: Float32[Tensor, "b 9 h w"]) -> Float32[Tensor, "b 3 h w"]:
    """Return the completed panorama, as the engine's (`CompletionModel.complete`)."""
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=torch.is_grad_enabled()):
        change = network(panels)
    return changed_light(panels[:, 6:], change, 1 - panels[:, 3:4])


def changed_light(
    light: Float[Tensor, "b 3 h w"], change: Float[Tensor, "b 3 h w"], share: Float[Tensor, "b 1 h w"]
) -> Float32[Tensor, "b 3 h w"]:
    """Return `roomlight.engine.panorama.panels.changed_light`."""
    return torch.expm1((torch.log1p(light) + change.float() * share).clamp(0, 11))


def _errors(
    light: Float[Tensor, "b 3 h w"], panels: Float[Tensor, "b 9 h w"], truth: Float[Tensor, "b 3 h w"]
) -> tuple[Float[Tensor, " b"], Float[Tensor, " b"], Float[Tensor, " b"]]:
    """Return log-L2 of the light, of the classical fill, and the squared log error of light on surfaces."""
    wanted = torch.log1p(truth)
    error = (torch.log1p(light) - wanted).square().mean((1, 2, 3))
    fill = (torch.log1p(panels[:, 6:]) - wanted).square().mean((1, 2, 3))
    lobes = torch.cat([reflection_lobe(power) for power in (1, _GLOSSY_POWER)], dim=1)
    ours, theirs = (image.flatten(2) @ lobes for image in (light, truth))
    return error, fill, (torch.log(ours + 0.02) - torch.log(theirs + 0.02)).square().mean((1, 2))


@cache
def solid_angles() -> Float32[Tensor, "h w"]:
    """Return the solid angles of the panels' pixels."""
    angles = np.broadcast_to(panorama_solid_angles(HEIGHT), (HEIGHT, 2 * HEIGHT))
    return torch.from_numpy(np.ascontiguousarray(angles, np.float32))


@cache
def reflection_lobe(power: int) -> Float32[Tensor, "n k"]:
    """Return weights of directions in reflections at fixed normals, cosine to a power (1: matte); each sums to 1."""
    normals = np.random.default_rng(3).normal(size=(_LOBES, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosine = np.maximum(panorama_rays(HEIGHT).astype(np.float64) @ normals.T, 0)
    weights = cosine**power * solid_angles().numpy().reshape(-1, 1)
    return torch.from_numpy((weights / weights.sum(0)).astype(np.float32))
