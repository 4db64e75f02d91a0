"""The stage `objects`: the light that lights things, from what random streams have shown a probe.

The loss is what one sees: errors of pictures of matte, glossy and metal spheres under the estimated light, cut at white
as a camera cuts them. The logarithm of what matte surfaces receive joins them, so that half as bright and twice as
bright cost the same. A weak log-L2 of the panoramas keeps light plausible that these pictures do not show.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Final, Literal

import cv2
import numpy as np
import torch
from annotated_types import Ge
from jaxtyping import Float, Float16, Float32
from torch import Tensor

from roomlight.conventions import panorama_rays, panorama_solid_angles
from roomlight.engine.lighting import LIGHTING_PANELS, lighting_panels
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.options import ModelName
from roomlight.engine.panorama.panels import HEIGHT
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import DatasetError, FrameError
from roomlight.spheres import DIFFUSE_ALBEDO, GLOSSY_ALBEDO
from roomlight_model.accumulate import luminance
from roomlight_model.object_light_network import ObjectLightNetwork
from roomlight_model.training.batches import Tensors
from roomlight_model.training.examples import example_of, limited
from roomlight_model.training.losses import Losses
from roomlight_model.training.small_stage import SmallOptions, SmallStage
from roomlight_model.training.subsets import ProgressCallback, Recordings, each_sequence

MATERIALS: Final = ("diffuse", "glossy", "metal")
"""Pictures whose errors are the loss: spheres of these materials."""
USUAL_ERRORS: Final = (0.16, 0.2, 0.2)
"""Usual errors of `MATERIALS`, by which the loss divides them."""
LOG_WEIGHT: Final = 0.3
BRIGHTNESS_WEIGHT: Final = 0.5
MODELS: Final[tuple[ModelName, ...]] = ("classical", "single")
"""Models of the streams, in turn: the network changes the light of both."""
_STREAMS: Final = 2
"""Streams of each recording."""
_FROM_START: Final = 0.5
"""Share of streams that begin at a recording's first frame."""
_TINT: Final = 0.1
"""Standard deviation of the logarithm of random channel gains."""
_LOBES: Final = 64
_GLOSS: Final = 0.058
"""Share of light that the glossy sphere of `roomlight.spheres` reflects in its lobe, in the mean over its picture."""
_GLOSS_POWER: Final = 200
_METAL_POWER: Final = 24
_DARK: Final = 0.01
"""Radiance that is added before a logarithm of brightness."""
_BEYOND_WHITE: Final = 0.1
"""Slope of what is beyond white in a picture, so that too bright light has a gradient."""


@dataclass(frozen=True)
class ObjectsOptions(SmallOptions):
    """Options of the stage `objects`: those of every small network.

    Raises:
        OptionError: A value is out of range.
    """

    stage: Literal["objects"] = "objects"
    steps: Annotated[int, Ge(1)] = 6000


@dataclass(frozen=True, eq=False)
class ProbePanels(Tensors):
    """What streams have shown probes, and the true light there, at the network's resolution.

    Attributes:
        panels: As `roomlight.engine.lighting.lighting_panels`.
        truth: Linear RGB in the units of the panels.
    """

    panels: Float16[np.ndarray, "n 10 h w"]
    truth: Float16[np.ndarray, "n 3 h w"]

    @classmethod
    def read(
        cls,
        datasets: Sequence[Recordings],
        *,
        seed: int,
        streams: int = _STREAMS,
        models: Sequence[ModelName] = MODELS,
        progress: ProgressCallback | None = None,
    ) -> "ProbePanels":
        """Stream every recording over random frames with random depth, and keep its probes at two moments.

        The length of a stream is drawn evenly in its logarithm: a panorama changes most at its start. A recording of
        one frame is streamed once.

        Args:
            models: The sessions have one of these models each, in turn.
            progress: Receives (done, total) recordings.

        Raises:
            DatasetError: No recording has a probe.
            ModelError: The weights of a model are missing.
        """
        rng = np.random.default_rng([seed, 12])
        loaded = {model: choose_graphs(SessionOptions(model=model)) for model in models}
        panels, truth, streamed = list[np.ndarray](), list[np.ndarray](), 0
        for dataset, index in each_sequence(datasets, progress):
            for _ in range(streams if dataset.frames_of(index) > 1 else 1):
                model = models[streamed % len(models)]
                session = Session(SessionOptions(model=model), graphs=loaded[model])
                for probe_panels, light in _stream(session, dataset, index, rng):
                    panels.append(probe_panels)
                    truth.append(light)
                streamed += 1
        if not panels:
            raise DatasetError("no recording has a probe to learn from; generate a dataset with probes")
        return cls(np.stack(panels), np.stack(truth))


@dataclass(frozen=True, eq=False)
class PanelsBatch(Tensors):
    """Panels of the network and the true radiance."""

    panels: Float32[Tensor, "b 10 h w"]
    truth: Float32[Tensor, "b 3 h w"]


class ObjectsStage(SmallStage[ObjectsOptions, ProbePanels]):
    """Trains `ObjectLightNetwork` on probes."""

    def batch(self, step: int) -> PanelsBatch:
        """Augment and stack the examples of a step."""
        numbers = [index for index, _ in self.options.draw_examples(len(self), step)]
        return panels_batch(self.training.take(numbers), self.options.rng(step, self.options.batch))

    def losses(self, network: ObjectLightNetwork, batch: PanelsBatch, _: torch.Generator) -> Losses:
        """Return the errors of pictures, divided by their usual errors, of brightness, and the panorama's log-L2."""
        lighting = object_light(network, batch.panels)
        errors = picture_errors(lighting, batch.truth) / torch.tensor(USUAL_ERRORS)
        pictures = errors.sum(dim=1).mean()
        logs = (torch.log1p(lighting) - torch.log1p(batch.truth)).square().mean()
        brightness = brightness_errors(lighting, batch.truth).mean()
        loss = pictures + LOG_WEIGHT * logs + BRIGHTNESS_WEIGHT * brightness
        return {"loss": loss, "pictures": pictures, "log_l2": logs, "brightness": brightness}

    def scores(self, network: ObjectLightNetwork) -> Mapping[str, float]:
        """Score held-out examples: errors relative to those in the light that the session has, and their mean."""
        ours, before = list[Tensor](), list[Tensor]()
        with torch.no_grad():
            for examples in self.held_out_parts(32):
                batch = panels_batch(examples)
                ours.append(picture_errors(object_light(network, batch.panels), batch.truth))
                before.append(picture_errors(batch.panels[:, 6:9], batch.truth))
        ratios = (torch.cat(ours).mean(dim=0) / torch.cat(before).mean(dim=0)).tolist()
        return {"loss": float(np.mean(ratios)), **dict(zip(MATERIALS, ratios, strict=True))}


def panels_batch(examples: ProbePanels, rng: np.random.Generator | None = None) -> PanelsBatch:
    """Stack examples; with `rng` rotated about the vertical, mirrored, channels permuted and scaled at random."""
    both = np.concatenate([examples.panels, examples.truth], axis=1).astype(np.float32)
    if rng is not None:
        both = np.roll(both, int(rng.integers(2 * HEIGHT)), axis=3)
        if rng.random() < 0.5:
            both = both[..., ::-1]
        if rng.random() < 0.3:
            order = rng.permutation(3)
            both = both[:, [*order, 3, 4, 5, *(6 + order), 9, *(10 + order)]]
        gains = np.exp(rng.normal(0, _TINT, (len(examples), 3, 1, 1))).astype(np.float32)
        for first in (0, 6, 10):
            both[:, first : first + 3] *= gains
        both[:, 9:10] *= gains.mean(axis=1, keepdims=True)
    stacked = torch.from_numpy(np.ascontiguousarray(both))
    return PanelsBatch(stacked[:, :LIGHTING_PANELS], stacked[:, LIGHTING_PANELS:])


def object_light(network: torch.nn.Module, panels: Float32[Tensor, "b 10 h w"]) -> Float32[Tensor, "b 3 h w"]:
    """Return the light that lights things, as the engine's (`roomlight.engine.lighting.LightingModel.panorama`)."""
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=torch.is_grad_enabled()):
        change = network(panels)
    known, guessed, light = panels[:, 3:4], panels[:, 9:10], panels[:, 6:9]
    free = torch.maximum(1 - known, (guessed / luminance(light).clamp(min=1e-6)).clamp(0, 1))
    return torch.expm1((torch.log1p(light) + change.float() * free).clamp(0, 11))


def picture_errors(lighting: Float[Tensor, "b 3 h w"], truth: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3"]:
    """Return the root of the mean squared error of each of `MATERIALS`."""
    spheres = [
        _squared_below_white(ours, theirs).mean((1, 2))
        for ours, theirs in zip(_spheres(lighting), _spheres(truth), strict=True)
    ]
    return torch.sqrt(torch.stack(spheres, dim=1) + 1e-5)


def brightness_errors(lighting: Float[Tensor, "b 3 h w"], truth: Float[Tensor, "b 3 h w"]) -> Float[Tensor, " b"]:
    """Return the mean absolute error of the logarithm of the luminance that matte surfaces receive."""
    ours, theirs = (luminance(light).flatten(1) @ _reflection_lobe(1) for light in (lighting, truth))
    return (torch.log(ours + _DARK) - torch.log(theirs + _DARK)).abs().mean(dim=1)


def _spheres(light: Float[Tensor, "b 3 h w"]) -> list[Float[Tensor, "b 3 k"]]:
    """Return pixels of the diffuse, the glossy and the metal sphere."""
    matte, gloss, metal = (light.flatten(2) @ _reflection_lobe(power) for power in (1, _GLOSS_POWER, _METAL_POWER))
    return [DIFFUSE_ALBEDO * matte, GLOSSY_ALBEDO * matte + _GLOSS * gloss, metal]


def _squared_below_white(predicted: Float[Tensor, "*n"], wanted: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    """Return the squared differences of pictures that white cuts."""
    above = 1 + _BEYOND_WHITE * torch.log(predicted.clamp(min=1))
    inside = torch.where(predicted < 1, predicted, above) - wanted
    return torch.where(wanted >= 1, (1 - predicted).clamp(min=0), inside).square()


@cache
def _reflection_lobe(power: int) -> Float32[Tensor, "n k"]:
    """Return weights of directions in reflections at fixed normals, cosine to a power (1: matte); each sums to 1."""
    normals = np.random.default_rng(3).normal(size=(_LOBES, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosine = np.maximum(panorama_rays(HEIGHT).astype(np.float64) @ normals.T, 0)
    solid_angles = np.broadcast_to(panorama_solid_angles(HEIGHT), (HEIGHT, 2 * HEIGHT)).astype(np.float32)
    weights = cosine**power * solid_angles.reshape(-1, 1)
    return torch.from_numpy((weights / weights.sum(0)).astype(np.float32))


def _stream(
    session: Session, dataset: Recordings, index: int, rng: np.random.Generator
) -> list[tuple[Float16[np.ndarray, "10 h w"], Float16[np.ndarray, "3 h w"]]]:
    """Push random frames of a recording; return the panels and the truth of its probes at two moments."""
    count = dataset.frames_of(index)
    length = int(np.exp(rng.uniform(0, np.log(count + 0.999))))
    first = 0 if rng.random() < _FROM_START else int(rng.integers(count - length + 1))
    moments = {length - 1, int(rng.integers(length))}
    recording = dataset.read(index, frames=list(range(first, first + length)))
    example = example_of(recording, rng, depth="both")
    handles = [session.track((float(x), float(y), float(z))) for x, y, z in example.positions]
    panels = list[tuple[np.ndarray, np.ndarray]]()
    for number, frame in enumerate((example.frame, *example.later)):
        try:
            session.push(replace(frame, index=number))
        except FrameError:  # a frame without depth cannot begin a stream
            return panels
        if number in moments:
            for handle, truth in zip(handles, example.truth, strict=True):
                panels.append(
                    (lighting_panels(session.panorama_state(handle)).astype(np.float16), reduced_truth(truth))
                )
    return panels


def reduced_truth(truth: Float32[np.ndarray, "h w 3"]) -> Float16[np.ndarray, "3 ph pw"]:
    """Reduce a panorama to the network's resolution; its energy stays, up to `BRIGHTEST` in a pixel."""
    means = cv2.resize(truth, (2 * HEIGHT, HEIGHT), interpolation=cv2.INTER_AREA)
    return np.moveaxis(limited(means), -1, 0).astype(np.float16)
