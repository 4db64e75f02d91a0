"""The stage `depth`: depth of single pictures, from recordings with exact depth.

Every draw cuts another field of view out of a frame, with another aspect, and gives it another exposure, colour, blur
and noise, so that a few thousand frames last for many steps. Scale comes from how high a phone is held: views from
near the floor are thinned out, and rooms without furniture, whose size nothing tells, are enlarged or reduced until
the camera is at that height.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Annotated, Final, Literal

import cv2
import numpy as np
import torch
from annotated_types import Ge, Interval
from jaxtyping import Float, Float32, UInt8, UInt16
from torch import Tensor

from roomlight.camera import Intrinsics
from roomlight.conventions import linear_to_srgb, srgb8_to_linear
from roomlight.dataset.loader import Dataset
from roomlight.errors import DatasetError, ModelError
from roomlight.monocular.network import DEPTH_CHANNELS, DEPTH_SIDE, ray_planes
from roomlight_model.depth.network import DepthNetwork
from roomlight_model.training.batches import Tensors
from roomlight_model.training.losses import Losses
from roomlight_model.training.run_folder import RunOptions
from roomlight_model.training.small_stage import SmallStage

GRADIENT_WEIGHT: Final = 0.5
"""Weight of the differences between neighbouring errors, at four scales: edges and planes (Li and Snavely 2018)."""
SHAPE_WEIGHT: Final = 0.5
"""Weight of the error without each picture's mean, which a stream's poses correct (Eigen et al. 2014)."""
_HALF: Final = DEPTH_SIDE // 2
_CUT: Final = (0.45, 1.0)
"""Range of the cut's sides, of the frame's."""
_GAIN: Final = (0.5, 2.2)
_PHONE_M: Final = (1.45, 0.15)
"""Mean and deviation of a phone's height over the floor."""
_RESIZED: Final = (0.6, 1.8)
"""Range of the factor by which a room without furniture is enlarged."""
_LOW_M: Final = 0.9
_LOW_EVERY: Final = 3
"""Of the views from below `_LOW_M`, this many-th stays."""
_TILT_UNKNOWN: Final = 0.2
"""Share of the examples without gravity."""
_TILT_ERROR: Final = 0.015
"""Deviation of gravity's error: a degree."""

ProgressCallback = Callable[[int, int], object]


@dataclass(frozen=True)
class DepthOptions(RunOptions):
    """Options of the stage `depth`: those of every run.

    Attributes:
        encoder: A file of published EfficientNet-Lite0 weights to start from; None: fresh weights.

    Raises:
        OptionError: A value is out of range.
    """

    stage: Literal["depth"] = "depth"
    steps: Annotated[int, Ge(1)] = 2000
    batch: Annotated[int, Ge(1)] = 8
    learning_rate: Annotated[float, Interval(gt=0, le=1)] = 5e-4
    warm_up: Annotated[int, Ge(0)] = 50
    ema: Annotated[float, Interval(ge=0, le=1)] = 0.995
    validate_steps: Annotated[int, Ge(1)] = 200
    encoder: Path | None = None


@dataclass(frozen=True, eq=False)
class DepthFrames:
    """Frames with exact depth.

    Attributes:
        colour: 8-bit sRGB.
        depth_mm: Millimetres, 0 = unknown.
        lenses: Their intrinsics.
        ups: The world's up in the camera's axes.
        heights_m: Of the camera over the floor; 0 in rooms of true size: with furniture, which tells it, or of Blender.
    """

    colour: list[UInt8[np.ndarray, "h w 3"]]
    depth_mm: list[UInt16[np.ndarray, "h w"]]
    lenses: list[Intrinsics]
    ups: list[Float[np.ndarray, "3"]]
    heights_m: list[float]

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.colour)

    def take(self, numbers: Sequence[int]) -> "DepthFrames":
        """Return the frames with these numbers."""
        parts = (self.colour, self.depth_mm, self.lenses, self.ups, self.heights_m)
        return DepthFrames(*([part[number] for number in numbers] for part in parts))  # pyright: ignore[reportArgumentType]

    @classmethod
    def read(cls, datasets: Sequence[Dataset], *, progress: ProgressCallback | None = None) -> "DepthFrames":
        """Read the frames of every sequence, but few that are near the floor.

        Raises:
            DatasetError: There is no sequence.
        """
        sequences = [(dataset, index) for dataset in datasets for index in range(len(dataset))]
        frames, low = cls([], [], [], [], []), 0
        for done, (dataset, index) in enumerate(sequences, 1):
            recording = dataset.read(index, probes=False)
            of_true_size = bool(recording.facts.get("furniture")) or recording.facts.get("room_type") == "blender"
            for k, pose in enumerate(recording.camera_to_world):
                height_m = float(pose[1, 3])
                low += height_m < _LOW_M
                if height_m < _LOW_M and low % _LOW_EVERY:
                    continue
                frames.colour.append(recording.colour[k])
                frames.depth_mm.append(recording.depth_mm[k])
                frames.lenses.append(recording.intrinsics)
                frames.ups.append(pose[1, :3].astype(np.float64))
                frames.heights_m.append(0.0 if of_true_size else height_m)
            if progress:
                progress(done, len(sequences))
        if not len(frames):
            raise DatasetError("the datasets hold no sequence to learn depth from; generate one with --any-view")
        return frames


@dataclass(frozen=True, eq=False)
class DepthBatch(Tensors):
    """Pictures and their depth.

    Attributes:
        planes: The network's input.
        log_depth: Logarithm of the true depth in metres, at half resolution.
        known: 1 where it is known.
    """

    planes: Float32[Tensor, "b 7 s s"]
    log_depth: Float32[Tensor, "b 1 h h"]
    known: Float32[Tensor, "b 1 h h"]


class DepthStage(SmallStage[DepthOptions, DepthFrames]):
    """Trains `DepthNetwork`, from fresh weights, a checkpoint or a published encoder."""

    @property
    def piece_size(self) -> int:
        """Pictures in one forward pass."""
        return 4

    def batch(self, step: int) -> DepthBatch:
        """Cut and vary the frames of a step anew."""
        drawn = list(self.options.draw_examples(len(self), step))
        return depth_batch(self.training.take([number for number, _ in drawn]), [rng for _, rng in drawn])

    def network(self) -> DepthNetwork:
        """Build the network.

        Raises:
            ModelError: The published encoder cannot be read or is another network.
        """
        network: DepthNetwork = super().network()
        if self.before is None and self.options.encoder is not None:
            network.start_encoder(_published(self.options.encoder))
        if self.before is not None or self.options.encoder is not None:
            network.keep_early_layers()
        return network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]

    def losses(self, network: DepthNetwork, batch: DepthBatch, _: torch.Generator) -> Losses:
        """Return the loss: likelihood of the log error under its own scale, its shape, its gradients."""
        with torch.autocast("cpu", dtype=torch.bfloat16):
            predicted = network(batch.planes).float()
        error, scale, known = predicted[:, :1] - batch.log_depth, predicted[:, 1:], batch.known
        size = error.abs().clamp(max=2)
        likelihood = _mean(size * torch.exp(-scale) + scale, known)
        own = (error * known).sum((2, 3), keepdim=True) / known.sum((2, 3), keepdim=True).clamp(min=1)
        shape = _mean((error - own).abs().clamp(max=2), known)
        edges = _gradients(error, known)
        loss = 0.3 * likelihood + _mean(size, known) + SHAPE_WEIGHT * shape + GRADIENT_WEIGHT * edges
        return {"loss": loss, "error": _mean(size, known), "shape": shape, "edges": edges}

    def scores(self, network: DepthNetwork) -> Mapping[str, float]:
        """Score held-out frames: mean relative error, share within 25 %, and the same of the constant 2.5 m."""
        relative, within, constant, scaled = list[float](), list[float](), list[float](), list[float]()
        with torch.no_grad():
            for frames in self.held_out_parts(16):
                batch = depth_batch(frames)
                error = (network(batch.planes)[:, :1] - batch.log_depth).clamp(-3, 3)
                for log_error, truth, known in zip(error, batch.log_depth, batch.known > 0, strict=True):
                    own = log_error[known]
                    if len(own):
                        relative.append(float((own.exp() - 1).abs().mean()))
                        within.append(float((own.abs() < np.log(1.25)).float().mean()))
                        scaled.append(float(((own - own.median()).exp() - 1).abs().mean()))
                        constant.append(float((2.5 / truth[known].exp() - 1).abs().mean()))
        means = [float(np.mean(values)) for values in (relative, within, scaled, constant)]
        return dict(zip(("loss", "within_25", "scaled", "constant"), means, strict=True))


def depth_batch(frames: DepthFrames, rngs: Sequence[np.random.Generator] | None = None) -> DepthBatch:
    """Stack inputs and truth; with random streams each frame is cut and varied, without it is whole."""
    planes = np.empty((len(frames), DEPTH_CHANNELS, DEPTH_SIDE, DEPTH_SIDE), np.float32)
    depth = np.empty((len(frames), 1, _HALF, _HALF), np.float32)
    for k in range(len(frames)):
        rng = None if rngs is None else rngs[k]
        planes[k], depth[k, 0] = _example(frames.colour[k], frames.depth_mm[k], frames.lenses[k], frames.ups[k], rng)
        if frames.heights_m[k]:
            depth[k] *= _resizing(frames.heights_m[k], rng)
    known = depth > 0.05
    log_depth = np.log(np.where(known, depth, 1)).astype(np.float32)
    return DepthBatch(torch.from_numpy(planes), torch.from_numpy(log_depth), torch.from_numpy(known.astype(np.float32)))


def _example(
    colour: UInt8[np.ndarray, "h w 3"],
    depth_mm: UInt16[np.ndarray, "h w"],
    lens: Intrinsics,
    up: Float[np.ndarray, "3"],
    rng: np.random.Generator | None,
) -> tuple[Float32[np.ndarray, "7 s s"], Float32[np.ndarray, "h2 h2"]]:
    """Cut, flip and vary one frame."""
    height, width = depth_mm.shape
    left, top, right, bottom = 0, 0, width, height
    if rng is not None:
        share = rng.uniform(*_CUT)
        stretch = np.exp(rng.uniform(-0.2, 0.2))
        cut = [max(32, round(side * min(1.0, share * by))) for side, by in ((width, stretch), (height, 1 / stretch))]
        left, top = (int(rng.integers(side - size + 1)) for side, size in zip((width, height), cut, strict=True))
        right, bottom = left + cut[0], top + cut[1]
    part = np.ascontiguousarray(colour[top:bottom, left:right])
    lens = Intrinsics(lens.fx, lens.fy, lens.cx - left, lens.cy - top, right - left, bottom - top)
    rays = ray_planes(lens, up if rng is None else _measured(up, rng))
    square = cv2.resize(part, (DEPTH_SIDE, DEPTH_SIDE), interpolation=cv2.INTER_AREA)
    image = square.astype(np.float32) / 255 if rng is None else _varied(square, rng)
    depth = cv2.resize(depth_mm[top:bottom, left:right], (_HALF, _HALF), interpolation=cv2.INTER_NEAREST_EXACT)
    if rng is not None and rng.random() < 0.5:
        image, depth, rays = image[:, ::-1], depth[:, ::-1], rays[:, :, ::-1].copy()
        rays[0] *= -1
    return np.concatenate([np.moveaxis(image, -1, 0), rays]), depth.astype(np.float32) / 1000


def _measured(up: Float[np.ndarray, "3"], rng: np.random.Generator) -> Float[np.ndarray, "3"] | None:
    """Return gravity as a phone measures it, or None: some sources do not know it."""
    turned = up + rng.normal(0, _TILT_ERROR, 3)
    return None if rng.random() < _TILT_UNKNOWN else turned / np.linalg.norm(turned)


def _resizing(height_m: float, rng: np.random.Generator | None) -> np.float32:
    """Return the factor that brings a camera to the height of a phone."""
    wanted = _PHONE_M[0] if rng is None else rng.normal(*_PHONE_M)
    return np.float32(np.clip(wanted / height_m, *_RESIZED))


def _varied(picture: UInt8[np.ndarray, "h w 3"], rng: np.random.Generator) -> Float32[np.ndarray, "h w 3"]:
    """Expose, tint, blur and disturb a picture as another camera would."""
    linear = srgb8_to_linear(picture)
    gain = np.exp(rng.uniform(*np.log(_GAIN))) * np.exp(rng.normal(0, 0.12, 3))
    image = linear_to_srgb(np.clip(linear * gain.astype(np.float32), 0, 1)).astype(np.float32)
    grey = image.mean(axis=-1, keepdims=True)
    image = grey + np.float32(rng.uniform(0.3, 1.5)) * (image - grey)
    image = np.clip(image, 0, 1) ** np.float32(np.exp(rng.normal(0, 0.2)))
    if rng.random() < 0.4:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 1.5))
    if rng.random() < 0.6:
        image += rng.normal(0, rng.uniform(0.005, 0.05), image.shape).astype(np.float32)
    if rng.random() < 0.1:
        image = np.repeat(image.mean(axis=-1, keepdims=True), 3, axis=-1)
    return np.clip(image, 0, 1).astype(np.float32)


def _mean(values: Float[Tensor, "b 1 h w"], known: Float[Tensor, "b 1 h w"]) -> Float[Tensor, ""]:
    return (values * known).sum() / known.sum().clamp(min=1)


def _gradients(error: Float[Tensor, "b 1 h w"], known: Float[Tensor, "b 1 h w"]) -> Float[Tensor, ""]:
    """Return the mean difference between neighbouring errors over four scales."""
    total = error.new_zeros(())
    for scale in range(4):
        step = 2**scale
        small, there = error[..., ::step, ::step], known[..., ::step, ::step]
        across = (small[..., 1:] - small[..., :-1]).abs().clamp(max=1)
        down = (small[..., 1:, :] - small[..., :-1, :]).abs().clamp(max=1)
        total = (
            total
            + _mean(across, there[..., 1:] * there[..., :-1])
            + _mean(down, there[..., 1:, :] * there[..., :-1, :])
        )
    return total / 4


def _published(path: Path) -> Mapping[str, Tensor]:
    try:
        weights = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, ValueError, EOFError, UnpicklingError) as error:
        raise ModelError(f"{path}: the encoder's weights cannot be read ({str(error).splitlines()[0]})") from error
    if not isinstance(weights, Mapping):
        raise ModelError(f"{path}: holds a {type(weights).__name__} where weights by name are expected")
    return weights
