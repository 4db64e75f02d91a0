"""The stage `objects`: loss and scores of the network that gives the light of virtual objects.

The loss is what one sees: errors of pictures of matte, glossy, metal and mirror spheres under the estimated light, cut
at white as a camera cuts them, and of the shadow of a sphere. A weak log-L2 of the panoramas keeps light plausible that
these pictures do not show.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor
from torch.nn import functional

from roomlight.conventions import LUMINANCE
from roomlight.engine.networks.graphs import PartForm
from roomlight.spheres import DIFFUSE_ALBEDO, GLOSSY_ALBEDO
from roomlight_model.completion_network import ObjectLightNetwork
from roomlight_model.sphere_shadow import ROWS, SHADED, shadow_tables
from roomlight_model.training.completion_examples import CompletionExamples, completion_batch
from roomlight_model.training.completion_stage import changed_light, reflection_lobe, solid_angles

LOOKS: Final = ("diffuse", "glossy", "metal", "mirror", "shadow")
USUAL: Final = (0.16, 0.2, 0.2, 0.22, 0.1)
"""Usual errors of `LOOKS`, by which the loss divides them."""
LOG_WEIGHT: Final = 0.3
_GLOSS: Final = 0.058
"""Share of light that the glossy sphere of `roomlight.spheres` reflects in its lobe, in the mean over its picture."""
_GLOSS_POWER: Final = 200
_METAL_POWER: Final = 24
_BEYOND_WHITE: Final = 0.1
"""Slope of what is beyond white in a picture, so that too bright light has a gradient."""


@dataclass(frozen=True)
class ObjectsStage:
    """Trains `ObjectLightNetwork`; held-out examples score it."""

    examples: CompletionExamples
    held_out: CompletionExamples

    @property
    def form(self) -> PartForm:
        """The form of the network."""
        return "objects"

    def network(self) -> ObjectLightNetwork:
        """Build the network."""
        return ObjectLightNetwork()

    def __len__(self) -> int:
        """Return the number of training examples."""
        return len(self.examples)

    def loss(self, network: torch.nn.Module, chosen: list[int], rng: np.random.Generator) -> Float[Tensor, ""]:
        """Return the loss of a batch."""
        panels, truth = completion_batch(self.examples, chosen, rng, augment=True)
        shown, casting = lights(network, panels)
        looks = look_errors(shown, casting, truth) / torch.tensor(USUAL)
        wanted = torch.log1p(truth)
        logs = sum((torch.log1p(light) - wanted).square().mean() for light in (shown, casting))
        return looks.sum(dim=1).mean() + LOG_WEIGHT * logs

    def scores(self, network: torch.nn.Module) -> Mapping[str, float]:
        """Score held-out examples: errors relative to those in the light that the session has, and their mean."""
        ours, before = list[Tensor](), list[Tensor]()
        rng = np.random.default_rng(0)
        with torch.no_grad():
            for first in range(0, len(self.held_out), 32):
                chosen = range(first, min(first + 32, len(self.held_out)))
                panels, truth = completion_batch(self.held_out, chosen, rng, augment=False)
                ours.append(look_errors(*lights(network, panels), truth))
                before.append(look_errors(panels[:, 6:9], panels[:, 6:9], truth))
        ratios = (torch.cat(ours).mean(dim=0) / torch.cat(before).mean(dim=0)).tolist()
        return {"loss": float(np.mean(ratios)), **dict(zip(LOOKS, ratios, strict=True))}


def lights(
    network: torch.nn.Module, panels: Float32[Tensor, "b 10 h w"]
) -> tuple[Float32[Tensor, "b 3 h w"], Float32[Tensor, "b 3 h w"]]:
    """Return the light of objects, and that of their shadows, as the engine's (`ObjectLightModel.light`)."""
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=torch.is_grad_enabled()):
        changes = network(panels)
    known, guessed, light = panels[:, 3:4], panels[:, 9:10], panels[:, 6:9]
    free = torch.maximum(1 - known, (guessed / _luminance(light).clamp(min=1e-6)).clamp(0, 1))
    shown, casting = (changed_light(light, change, free) for change in changes.chunk(2, dim=1))
    return shown, casting


def look_errors(
    shown: Float[Tensor, "b 3 h w"], casting: Float[Tensor, "b 3 h w"], truth: Float[Tensor, "b 3 h w"]
) -> Float[Tensor, "b 5"]:
    """Return the root of the mean squared error of each of `LOOKS`."""
    spheres = [
        _beside_white(ours, theirs).mean((1, 2)) for ours, theirs in zip(_spheres(shown), _spheres(truth), strict=True)
    ]
    mirror = (_beside_white(casting, truth) * solid_angles() / solid_angles().mean()).mean((1, 2, 3))
    wanted = _shadow(truth)
    shaded = (wanted < float(np.exp(-SHADED))).float()
    shadow = ((_shadow(casting) - wanted).square() * shaded).sum(dim=1) / shaded.sum(dim=1).clamp(min=1)
    return torch.sqrt(torch.stack([*spheres, mirror, shadow], dim=1) + 1e-5)


def _spheres(light: Float[Tensor, "b 3 h w"]) -> list[Float[Tensor, "b 3 k"]]:
    """Return pixels of the diffuse, the glossy and the metal sphere."""
    matte, gloss, metal = (light.flatten(2) @ reflection_lobe(power) for power in (1, _GLOSS_POWER, _METAL_POWER))
    return [DIFFUSE_ALBEDO * matte, GLOSSY_ALBEDO * matte + _GLOSS * gloss, metal]


def _beside_white(found: Float[Tensor, "*n"], wanted: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    """Return the squared differences of pictures that white cuts."""
    above = 1 + _BEYOND_WHITE * torch.log(found.clamp(min=1))
    inside = torch.where(found < 1, found, above) - wanted
    return torch.where(wanted >= 1, (1 - found).clamp(min=0), inside).square()


def _shadow(light: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b n"]:
    """Return `roomlight_model.sphere_shadow.shadow_of_sphere`."""
    cosine, blocked = _shadow_tables()
    small = functional.interpolate(_luminance(light), size=(ROWS, 2 * ROWS), mode="area")
    power = small.flatten(1)[:, : len(cosine)] * cosine
    return 1 - (power @ blocked.T) / power.sum(dim=1, keepdim=True).clamp(min=1e-6)


def _luminance(light: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 1 h w"]:
    weights = torch.from_numpy(np.asarray(LUMINANCE, np.float32))
    return (light * weights[:, None, None]).sum(dim=1, keepdim=True)


@cache
def _shadow_tables() -> tuple[Float32[Tensor, " d"], Float32[Tensor, "n d"]]:
    cosine, blocked = shadow_tables()
    return torch.from_numpy(cosine), torch.from_numpy(blocked)
