"""The stage `clipping`: the radiance of clipped pixels, from frames with their true radiance.

A generated recording holds the radiance of its clipped pixels, so that every frame is known in HDR. Each draw exposes a
frame anew: other pixels clip, and their truth is known too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

import cv2
import numpy as np
import torch
from annotated_types import Ge
from jaxtyping import Float, Float16, Float32
from torch import Tensor

from roomlight.engine.networks.clipping import SIDE, Placement, clipping_planes
from roomlight.errors import DatasetError
from roomlight_model.clipping_network import ClippingNetwork
from roomlight_model.training.batches import Tensors
from roomlight_model.training.examples import example_of
from roomlight_model.training.losses import Losses
from roomlight_model.training.small_stage import SmallOptions, SmallStage
from roomlight_model.training.subsets import ProgressCallback, Recordings, each_sequence

CLIPPED: Final = 0.956
"""Radiance from which an 8-bit sRGB value counts as clipped (`roomlight.frame.CLIPPED_SRGB8`)."""
ENERGY_WEIGHT: Final = 0.3
"""Weight of the error of a frame's whole clipped light beside that of its pixels."""
_GAINS: Final = (0.5, 2.5)
"""Range of exposures relative to the recorded one. Brighter frames clip more, darker ones less."""
_BRIGHTEST: Final = 2000.0
"""Greatest radiance, in units of white: the sun's disc is no more than a bright lamp."""
_FULL_AREA: Final = 30.0
"""Clipped pixels (at half the input's resolution) from which a frame counts fully."""


@dataclass(frozen=True)
class ClippingOptions(SmallOptions):
    """Options of the stage `clipping`: those of every small network.

    Raises:
        OptionError: A value is out of range.
    """

    stage: Literal["clipping"] = "clipping"
    steps: Annotated[int, Ge(1)] = 3000


@dataclass(frozen=True, eq=False)
class ClippingFrames(Tensors):
    """Frames in the network's square, at most one per example.

    Attributes:
        radiance: Linear RGB in units of the recorded white, clipped pixels with their true radiance.
        geometry: The input's planes from `inside the frame` on, which do not depend on exposure.
    """

    radiance: Float16[np.ndarray, "n 3 s s"]
    geometry: Float16[np.ndarray, "n 7 s s"]

    @classmethod
    def read(
        cls, datasets: Sequence[Recordings], *, seed: int, progress: ProgressCallback | None = None
    ) -> "ClippingFrames":
        """Read a frame of every sequence, drawn at random; sequences whose recordings lack the truth are left out.

        Args:
            progress: Receives (done, total) sequences.

        Raises:
            DatasetError: No sequence has the radiance of clipped pixels.
        """
        rng = np.random.default_rng([seed, 11])
        radiance, geometry = list[np.ndarray](), list[np.ndarray]()
        for dataset, index in each_sequence(datasets, progress):
            number = int(rng.integers(dataset.frames_of(index)))
            recording = dataset.read(index, frames=[number], clipped=True)
            if recording.clipped_radiance is not None:
                example = example_of(recording, rng, depth="both")
                truth = recording.clipped_radiance[0].astype(np.float32)
                # JPEG moves pixels across the limit: the truth is where it was stored
                stored = truth.any(-1, keepdims=True)
                radiance.append(_square(np.where(stored, truth, example.frame.image)))
                geometry.append(clipping_planes(example.frame, example.depth_m)[4:].astype(np.float16))
        if not radiance:
            raise DatasetError(
                "no sequence holds the radiance of clipped pixels; generate a new dataset (older versions left it out)"
            )
        return cls(np.stack(radiance), np.stack(geometry))


@dataclass(frozen=True, eq=False)
class ClippingBatch(Tensors):
    """Exposed frames.

    Attributes:
        planes: The network's input.
        truth: The true radiance of clipped pixels, at half resolution.
        weight: Share of clipped pixels, at half resolution.
    """

    planes: Float32[Tensor, "b 11 s s"]
    truth: Float32[Tensor, "b 3 h h"]
    weight: Float32[Tensor, "b 1 h h"]


class ClippingStage(SmallStage[ClippingOptions, ClippingFrames]):
    """Trains `ClippingNetwork` on frames. A batch is one piece: the loss weighs its frames against each other."""

    def __init__(
        self, options: ClippingOptions, training: ClippingFrames, held_out: ClippingFrames, **shared: Any
    ) -> None:
        """Take the frames, and what `SmallStage` takes.

        Raises:
            DatasetError: No held-out frame has a clipped pixel.
            ModelError: `start_from` holds another network.
        """
        if not (held_out.radiance >= CLIPPED).any():
            raise DatasetError(
                f"none of the {len(held_out)} held-out frames has a clipped pixel: nothing could be scored; "
                "give a larger dataset"
            )
        super().__init__(options, training, held_out, **shared)

    def batch(self, step: int) -> ClippingBatch:
        """Expose the frames of a step anew."""
        numbers = [index for index, _ in self.options.draw_examples(len(self), step)]
        return clipping_batch(self.training.take(numbers), self.options.rng(step, self.options.batch))

    def losses(self, network: ClippingNetwork, batch: ClippingBatch, _: torch.Generator) -> Losses:
        """Return squared errors of log radiance: of pixels, and of each frame's clipped light."""
        with torch.autocast("cpu", dtype=torch.bfloat16):
            predicted = network(batch.planes)
        *errors, share = _errors(predicted.float(), batch)
        pixels, energy = ((error * share).sum() / share.sum().clamp(min=1e-6) for error in errors)
        return {"loss": pixels + ENERGY_WEIGHT * energy, "pixels": pixels, "energy": energy}

    def scores(self, network: ClippingNetwork) -> Mapping[str, float]:
        """Score held-out frames: squared log errors of pixels and light, and of the constant 2 x white beside them."""
        parts = list[Tensor]()
        with torch.no_grad():
            for frames in self.held_out_parts(16):
                batch = clipping_batch(frames)
                twice_white, _, _ = _errors(torch.full_like(batch.truth, float(np.log(2))), batch)
                pixels, light, share = _errors(network(batch.planes).float(), batch)
                parts.append(torch.stack([pixels, light, twice_white, torch.ones_like(share)]) @ share)
        *sums, total = torch.stack(parts).sum(dim=0).tolist()
        return dict(zip(("loss", "light", "constant_2"), (part / total for part in sums), strict=True))


def clipping_batch(frames: ClippingFrames, rng: np.random.Generator | None = None) -> ClippingBatch:
    """Expose frames and stack the network's input and truth; without `rng` as they were recorded."""
    radiance = torch.from_numpy(frames.radiance.astype(np.float32))
    geometry = torch.from_numpy(frames.geometry.astype(np.float32))
    if rng is not None:
        low, high = np.log(_GAINS)
        gain = np.exp(rng.uniform(low, high, (len(frames), 1, 1, 1)))
        tint = np.exp(rng.normal(0, 0.05, (len(frames), 3, 1, 1)))
        radiance = radiance * torch.from_numpy((gain * tint).astype(np.float32))
        if rng.random() < 0.5:
            radiance, geometry = radiance.flip(3), geometry.flip(3)
            geometry[:, 3] = -geometry[:, 3]
        if rng.random() < 0.2:
            radiance = radiance[:, torch.from_numpy(rng.permutation(3))]
    inside = geometry[:, :1]
    saturated = (radiance >= CLIPPED).float()
    clipped = saturated.amax(1, keepdim=True) * inside
    pool = torch.nn.functional.avg_pool2d
    weight = pool(clipped, 2)
    return ClippingBatch(
        planes=torch.cat([radiance.clamp(max=1) * inside, clipped, geometry], dim=1),
        truth=pool(radiance.clamp(max=_BRIGHTEST) * clipped, 2) / weight.clamp(min=1e-6),
        weight=weight,
    )


def _errors(
    log_radiance: Float[Tensor, "b 3 h w"], batch: ClippingBatch
) -> tuple[Float[Tensor, " b"], Float[Tensor, " b"], Float[Tensor, " b"]]:
    """Return each frame's squared log errors of pixels and of its clipped light, and how much it counts, 0 to 1."""
    truth, weight = batch.truth.clamp(min=0.1), batch.weight
    area = weight.sum((1, 2, 3))
    squared = (log_radiance - truth.log()).square().mean(1, keepdim=True)
    pixels = (squared * weight).sum((1, 2, 3)) / area.clamp(min=1e-6)
    light = (log_radiance.exp() * weight).mean(1).sum((1, 2)).clamp(min=1e-4)
    true_light = (truth * weight).mean(1).sum((1, 2)).clamp(min=1e-4)
    return pixels, (light.log() - true_light.log()).square(), (area / _FULL_AREA).clamp(max=1)


def _square(image: Float32[np.ndarray, "h w 3"]) -> Float16[np.ndarray, "3 s s"]:
    place = Placement.of(image.shape[1], image.shape[0])
    square = np.zeros((SIDE, SIDE, 3), np.float32)
    place.inside(square)[:] = cv2.resize(image, (place.width, place.height), interpolation=cv2.INTER_AREA)
    return np.moveaxis(np.minimum(square, 60_000), -1, 0).astype(np.float16)
