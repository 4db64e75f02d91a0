"""Examples for the network of clipped radiance: frames with their true radiance, exposed anew at every draw.

A generated recording holds the radiance of its clipped pixels, so that every frame is known in HDR: at another exposure
other pixels clip, and their truth is known too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import torch
from jaxtyping import Float16, Float32
from torch import Tensor

from roomlight.dataset.loader import Dataset
from roomlight.engine.networks.clipping import SIDE, Placement, clipping_planes
from roomlight.errors import DatasetError
from roomlight_model.training.examples import example_of

CLIPPED: Final = 0.956
"""Radiance from which an 8-bit sRGB value counts as clipped (`roomlight.frame.CLIPPED_SRGB8`)."""
_GAINS: Final = (0.5, 2.5)
"""Range of exposures relative to the recorded one. Brighter frames clip more, darker ones less."""
_BRIGHTEST: Final = 2000.0
"""Greatest radiance, in units of white: the sun's disc is no more than a bright lamp."""

ProgressCallback = Callable[[int, int], object]


@dataclass(frozen=True, eq=False)
class ClippingFrames:
    """Frames in the network's square, at most one per example.

    Attributes:
        radiance: Linear RGB in units of the recorded white, clipped pixels with their true radiance.
        geometry: The input's planes from `inside the frame` on, which do not depend on exposure.
    """

    radiance: Float16[np.ndarray, "n 3 s s"]
    geometry: Float16[np.ndarray, "n 7 s s"]

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.radiance)

    def split(self, seed: int) -> "tuple[ClippingFrames, ClippingFrames]":
        """Split off a twelfth, at random, to score: rooms are shared with training, so it shows progress alone."""
        order = np.random.default_rng([seed, 13]).permutation(len(self))
        held = max(1, len(self) // 12)
        parts = [ClippingFrames(self.radiance[part], self.geometry[part]) for part in (order[held:], order[:held])]
        return parts[0], parts[1]

    @classmethod
    def read(
        cls, datasets: Sequence[Dataset], *, seed: int, frames_each: int = 1, progress: ProgressCallback | None = None
    ) -> "ClippingFrames":
        """Read frames of every sequence, drawn at random; sequences whose recordings lack the truth are left out.

        Raises:
            DatasetError: No sequence has the radiance of clipped pixels.
        """
        rng = np.random.default_rng([seed, 11])
        total, radiance, geometry = sum(map(len, datasets)), list[np.ndarray](), list[np.ndarray]()
        done = 0
        for dataset in datasets:
            for index in range(len(dataset)):
                count = dataset.frames_of(index)
                drawn = rng.choice(count, min(frames_each, count), replace=False)
                for number in sorted(int(frame) for frame in drawn):
                    recording = dataset.read(index, frames=[number], clipped=True)
                    if recording.clipped_radiance is None:
                        continue
                    example = example_of(recording, rng, depth="both")
                    frame = example.frame
                    truth = recording.clipped_radiance[0].astype(np.float32)
                    # JPEG moves pixels across the limit: the truth is where it was stored
                    stored = truth.any(-1, keepdims=True)
                    radiance.append(_square(np.where(stored, truth, frame.image)))
                    geometry.append(clipping_planes(frame, example.depth_m)[4:].astype(np.float16))
                done += 1
                if progress:
                    progress(done, total)
        if not radiance:
            raise DatasetError(
                "no sequence holds the radiance of clipped pixels; generate a new dataset (older versions left it out)"
            )
        return cls(np.stack(radiance), np.stack(geometry))


def clipping_batch(
    frames: ClippingFrames, chosen: Sequence[int], rng: np.random.Generator, *, augment: bool
) -> tuple[Float32[Tensor, "b 11 s s"], Float32[Tensor, "b 3 h h"], Float32[Tensor, "b 1 h h"]]:
    """Expose frames and stack the network's input, the true radiance at half resolution and its weight (clipped)."""
    radiance = torch.from_numpy(frames.radiance[list(chosen)].astype(np.float32))
    geometry = torch.from_numpy(frames.geometry[list(chosen)].astype(np.float32))
    if augment:
        low, high = np.log(_GAINS)
        gain = np.exp(rng.uniform(low, high, (len(chosen), 1, 1, 1)))
        tint = np.exp(rng.normal(0, 0.05, (len(chosen), 3, 1, 1)))
        radiance = radiance * torch.from_numpy((gain * tint).astype(np.float32))
        if rng.random() < 0.5:
            radiance, geometry = radiance.flip(3), geometry.flip(3)
            geometry[:, 3] = -geometry[:, 3]
        if rng.random() < 0.2:
            radiance = radiance[:, torch.from_numpy(rng.permutation(3))]
    inside = geometry[:, :1]
    saturated = (radiance >= CLIPPED).float()
    clipped = saturated.amax(1, keepdim=True) * inside
    planes = torch.cat([radiance.clamp(max=1) * inside, clipped, geometry], dim=1)
    pool = torch.nn.functional.avg_pool2d
    weight = pool(clipped, 2)
    truth = pool(radiance.clamp(max=_BRIGHTEST) * clipped, 2) / weight.clamp(min=1e-6)
    return planes, truth, weight


def _square(image: Float32[np.ndarray, "h w 3"]) -> Float16[np.ndarray, "3 s s"]:
    place = Placement.of(image.shape[1], image.shape[0])
    square = np.zeros((SIDE, SIDE, 3), np.float32)
    place.inside(square)[:] = cv2.resize(image, (place.width, place.height), interpolation=cv2.INTER_AREA)
    return np.moveaxis(np.minimum(square, 60_000), -1, 0).astype(np.float16)
