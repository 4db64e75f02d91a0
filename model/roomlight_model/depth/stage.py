"""The stage `depth`: depth of single pictures, from recordings with exact depth.

Every draw cuts another field of view out of a frame, with another aspect, and gives it another exposure, colour, blur
and noise, so that a few thousand frames last for many steps. Scale comes from how high a phone is held: views from
near the floor are thinned out, and rooms without furniture, whose size nothing tells, are enlarged or reduced until
the camera is at that height.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Annotated, Final, Literal

import cv2
import numpy as np
import torch
from annotated_types import Ge, Interval
from jaxtyping import Float, Float16, Float32, UInt8, UInt16
from torch import Tensor
from torch.nn import functional

from roomlight.camera import Intrinsics
from roomlight.errors import DatasetError, ModelError
from roomlight.monocular.network import DEPTH_SIDE, LEAST_RISE, MOST_RISE
from roomlight_model.depth.network import DepthNetwork
from roomlight_model.training.batches import Tensors
from roomlight_model.training.losses import Losses
from roomlight_model.training.run_folder import RunOptions
from roomlight_model.training.small_stage import SmallStage
from roomlight_model.training.subsets import ProgressCallback, Recordings, each_sequence

GRADIENT_WEIGHT: Final = 0.5
"""Weight of the differences between neighbouring errors, at four scales: edges and planes (Li and Snavely 2018)."""
SHAPE_WEIGHT: Final = 0.5
"""Weight of the error without each picture's mean, which a stream's poses correct (Eigen et al. 2014)."""
_HALF: Final = DEPTH_SIDE // 2
_FRAME_SIDE: Final = 256
"""Side of the squares that frames are kept as."""
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


@dataclass(frozen=True)
class DepthOptions(RunOptions):
    """Options of the stage `depth`: those of every run.

    Attributes:
        encoder: A file of published EfficientNet-Lite0 weights to start from; None: fresh weights.

    Raises:
        OptionError: A value is out of range.
    """

    stage: Literal["depth"] = "depth"
    steps: Annotated[int, Ge(1)] = 8000
    batch: Annotated[int, Ge(1)] = 96
    learning_rate: Annotated[float, Interval(gt=0, le=1)] = 5e-4
    warm_up: Annotated[int, Ge(0)] = 300
    ema: Annotated[float, Interval(ge=0, le=1)] = 0.9985
    validate_steps: Annotated[int, Ge(1)] = 1000
    encoder: Path | None = None


@dataclass(frozen=True, eq=False)
class DepthFrames(Tensors):
    """Frames with exact depth, stretched to squares; `lenses` knows how.

    Attributes:
        colour: 8-bit sRGB.
        depth_m: z-depth, 0 = unknown.
        lenses: Focal lengths and principal point in units of the frame's sides: fx, fy, cx, cy.
        ups: The world's up in the camera's axes.
        heights_m: Of the camera over the floor; 0 in rooms of true size: with furniture, which tells it, or of Blender.
    """

    colour: UInt8[Tensor, "n 3 f f"]
    depth_m: Float16[Tensor, "n f f"]
    lenses: Float32[Tensor, "n 4"]
    ups: Float32[Tensor, "n 3"]
    heights_m: Float32[Tensor, " n"]

    @classmethod
    def of(
        cls,
        pictures: Sequence[UInt8[np.ndarray, "h w 3"]],
        depths_mm: Sequence[UInt16[np.ndarray, "h w"]],
        lenses: Sequence[Intrinsics],
        ups: Sequence[Float[np.ndarray, "3"]],
        heights_m: Sequence[float],
    ) -> "DepthFrames":
        """Stretch pictures and their depth (millimetres, 0 = unknown) to squares."""
        side = (_FRAME_SIDE, _FRAME_SIDE)
        colour = [cv2.resize(picture, side, interpolation=cv2.INTER_AREA) for picture in pictures]
        depth = [cv2.resize(depth, side, interpolation=cv2.INTER_NEAREST_EXACT) for depth in depths_mm]
        units = [[lens.fx / lens.width, lens.fy / lens.height, lens.cx / lens.width, lens.cy / lens.height]
                 for lens in lenses]  # fmt: skip
        return cls(
            torch.from_numpy(np.moveaxis(np.stack(colour), -1, 1).copy()),
            torch.from_numpy((np.stack(depth) / np.float32(1000)).astype(np.float16)),
            torch.tensor(units, dtype=torch.float32),
            torch.from_numpy(np.stack(ups).astype(np.float32)),
            torch.tensor(heights_m, dtype=torch.float32),
        )

    @classmethod
    def read(cls, datasets: Sequence[Recordings], *, progress: ProgressCallback | None = None) -> "DepthFrames":
        """Read the frames of every sequence, but few that are near the floor.

        Raises:
            DatasetError: There is no sequence.
        """
        parts, low = list[DepthFrames](), 0
        for dataset, index in each_sequence(datasets, progress):
            recording = dataset.read(index, probes=False)
            of_true_size = bool(recording.facts.get("furniture")) or recording.facts.get("room_type") == "blender"
            heights, kept = recording.camera_to_world[:, 1, 3], list[int]()
            for k, height_m in enumerate(heights):
                low += height_m < _LOW_M
                if height_m >= _LOW_M or low % _LOW_EVERY == 0:
                    kept.append(k)
            if kept:
                parts.append(
                    cls.of(
                        [recording.colour[k] for k in kept],
                        [recording.depth_mm[k] for k in kept],
                        [recording.intrinsics] * len(kept),
                        [recording.camera_to_world[k, 1, :3] for k in kept],
                        [0.0 if of_true_size else float(heights[k]) for k in kept],
                    )
                )
        if not parts:
            raise DatasetError("the datasets hold no sequence to learn depth from; generate one with --any-view")
        return cls(*(torch.cat([vars(part)[name] for part in parts]) for name in vars(parts[0])))


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
        numbers = [number for number, _ in self.options.draw_examples(len(self), step)]
        return depth_batch(self.training.take(numbers).to(self.device), self.options.rng(step, self.options.batch))

    def network(self) -> DepthNetwork:
        """Build the network.

        Raises:
            ModelError: The published encoder cannot be read or is another network.
        """
        network: DepthNetwork = super().network()
        if self.start_from is None and self.options.encoder is not None:
            network.start_encoder(_published(self.options.encoder))
        return network.to(self.device, memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]

    def losses(self, network: DepthNetwork, batch: DepthBatch, _: torch.Generator) -> Losses:
        """Return the loss: likelihood of the log error under its own scale, its shape, its gradients."""
        with torch.autocast(self.device.type, dtype=torch.bfloat16):
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
            for frames in self.held_out_parts(32):
                batch = depth_batch(frames.to(self.device))
                error = (network(batch.planes)[:, :1] - batch.log_depth).clamp(-3, 3).cpu()
                for log_error, truth, known in zip(error, batch.log_depth.cpu(), batch.known.cpu() > 0, strict=True):
                    own = log_error[known]
                    if len(own):
                        relative.append(float((own.exp() - 1).abs().mean()))
                        within.append(float((own.abs() < np.log(1.25)).float().mean()))
                        scaled.append(float(((own - own.median()).exp() - 1).abs().mean()))
                        constant.append(float((2.5 / truth[known].exp() - 1).abs().mean()))
        means = [float(np.mean(values)) for values in (relative, within, scaled, constant)]
        return dict(zip(("loss", "within_25", "scaled", "constant"), means, strict=True))


def depth_batch(frames: DepthFrames, rng: np.random.Generator | None = None) -> DepthBatch:
    """Make inputs and truth; with a random stream each frame is cut and varied, without it is whole."""
    count, device = len(frames), frames.colour.device
    corner, size, mirrored = np.zeros((count, 2)), np.ones((count, 2)), np.zeros(count, bool)
    ups, resized = frames.ups, torch.full((count,), _PHONE_M[0], device=device)
    if rng is not None:
        stretch = np.exp(rng.uniform(-0.2, 0.2, (count, 1)))
        size = np.minimum(1.0, rng.uniform(*_CUT, (count, 1)) * np.concatenate([stretch, 1 / stretch], axis=1))
        corner, mirrored = rng.uniform(size=(count, 2)) * (1 - size), rng.random(count) < 0.5
        ups = _measured(ups, rng)
        resized = _tensor(rng.normal(*_PHONE_M, count), device)
    resized = (resized / frames.heights_m.clamp(min=0.01)).clamp(*_RESIZED)
    resized = torch.where(frames.heights_m > 0, resized, torch.ones_like(resized))

    def places(side: int) -> tuple[Float32[Tensor, "b s"], Float32[Tensor, "b s"]]:
        """Return where a square's columns and rows lie in the frame, of its sides; mirrored from right to left."""
        middle = (np.arange(side) + 0.5) / side
        columns = np.where(mirrored[:, None], 1 - middle, middle)
        return tuple(
            _tensor(corner[:, k, None] + size[:, k, None] * at, device) for k, at in ((0, columns), (1, middle))
        )  # pyright: ignore[reportReturnType]

    columns, rows = places(DEPTH_SIDE)
    shape = (count, DEPTH_SIDE, DEPTH_SIDE)
    grid = 2 * torch.stack([columns[:, None].expand(shape), rows[:, :, None].expand(shape)], dim=-1) - 1
    image = functional.grid_sample(frames.colour.float() / 255, grid, padding_mode="border", align_corners=False)
    if rng is not None:
        image = _varied(image, rng)
    side = frames.depth_m.shape[-1]
    across, down = ((side * at).long().clamp(0, side - 1) for at in places(_HALF))
    examples = torch.arange(count, device=device)[:, None, None]
    depth = frames.depth_m[examples, down[:, :, None], across[:, None]].float() * resized[:, None, None]
    known = (depth > 0.05)[:, None]
    flipped = _tensor(np.where(mirrored, -1.0, 1.0), device)
    rays = _rays(frames.lenses, columns, rows, ups, flipped, _tensor(size, device))
    log_depth = torch.log(torch.where(known[:, 0], depth, torch.ones_like(depth)))[:, None]
    return DepthBatch(torch.cat([image, rays], dim=1), log_depth, known.float())


def _tensor(values: Float[np.ndarray, "..."], device: torch.device) -> Float32[Tensor, "..."]:
    return torch.from_numpy(np.asarray(values, np.float32)).to(device)


def _rays(
    lenses: Float32[Tensor, "b 4"],
    columns: Float32[Tensor, "b s"],
    rows: Float32[Tensor, "b s"],
    ups: Float32[Tensor, "b 3"],
    flipped: Float32[Tensor, " b"],
    size: Float32[Tensor, "b 2"],
) -> Float32[Tensor, "b 4 s s"]:
    """Return `roomlight.monocular.network.ray_planes` of many cuts."""
    fx, fy, cx, cy = lenses.T[..., None]
    x, y = (columns - cx) / fx, (rows - cy) / fy
    across, down = torch.broadcast_tensors(x[:, None], y[:, :, None])
    rise = (ups[:, :1, None] * across - ups[:, 1:2, None] * down - ups[:, 2:, None]).clamp(-MOST_RISE, MOST_RISE)
    focal = (fx * fy / (size[:, :1] * size[:, 1:])).sqrt()[..., None]
    floor = -torch.log(rise.abs().clamp(min=LEAST_RISE) * focal)
    floor = torch.where((ups != 0).any(dim=1)[:, None, None], floor, torch.zeros_like(floor))
    return torch.stack([across * flipped[:, None, None], down, rise, floor], dim=1)


def _measured(ups: Float32[Tensor, "b 3"], rng: np.random.Generator) -> Float32[Tensor, "b 3"]:
    """Return gravity as a phone measures it, or 0: some sources do not know it."""
    turned = functional.normalize(ups + _tensor(rng.normal(0, _TILT_ERROR, ups.shape), ups.device), dim=1)
    return turned * _tensor(np.where(rng.random((len(ups), 1)) < _TILT_UNKNOWN, 0.0, 1.0), ups.device)


def _varied(image: Float32[Tensor, "b 3 h w"], rng: np.random.Generator) -> Float32[Tensor, "b 3 h w"]:
    """Expose, tint, blur and disturb pictures as other cameras would."""
    count, device = len(image), image.device

    def per_picture(values: Float[np.ndarray, " b"] | Float[np.ndarray, "b 3"]) -> Float32[Tensor, "b c 1 1"]:
        return _tensor(values.reshape(count, -1, 1, 1), device)

    gain = np.exp(rng.uniform(np.log(_GAIN[0]), np.log(_GAIN[1]), (count, 1)) + rng.normal(0, 0.12, (count, 3)))
    linear = torch.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)
    linear = (linear * per_picture(gain)).clamp(1e-6, 1)
    image = torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    grey = image.mean(dim=1, keepdim=True)
    image = grey + per_picture(rng.uniform(0.3, 1.5, count)) * (image - grey)
    image = image.clamp(1e-6, 1) ** per_picture(np.exp(rng.normal(0, 0.2, count)))
    image = _blurred(image, np.where(rng.random(count) < 0.4, rng.uniform(0.3, 1.5, count), 0.0))
    noise = torch.randn(
        image.shape, generator=torch.Generator(device).manual_seed(int(rng.integers(2**31))), device=device
    )
    image = image + per_picture(np.where(rng.random(count) < 0.6, rng.uniform(0.005, 0.05, count), 0.0)) * noise
    grey = image.mean(dim=1, keepdim=True).expand_as(image)
    return torch.where(per_picture(rng.random(count)) < 0.1, grey, image).clamp(0, 1)


def _blurred(image: Float32[Tensor, "b 3 h w"], sigma: Float[np.ndarray, " b"]) -> Float32[Tensor, "b 3 h w"]:
    """Blur each picture by its own deviation, pixels; 0 leaves it."""
    count, _, high, wide = image.shape
    taps = np.exp(-0.5 * (np.arange(-4, 5) / np.maximum(sigma, 1e-2)[:, None]) ** 2)
    weights = _tensor(taps / taps.sum(axis=1, keepdims=True), image.device)[:, None]
    planes = functional.pad(image, (4, 4, 4, 4), mode="replicate").transpose(0, 1)
    planes = functional.conv2d(planes, weights[:, :, None], groups=count)
    return functional.conv2d(planes, weights[..., None], groups=count).transpose(0, 1).reshape(count, 3, high, wide)


def _mean(values: Float[Tensor, "b 1 h w"], known: Float[Tensor, "b 1 h w"]) -> Float[Tensor, ""]:
    """Return the mean over pictures of each one's mean, so that the pieces of a batch add up to the batch."""
    return ((values * known).sum((1, 2, 3)) / known.sum((1, 2, 3)).clamp(min=1)).mean()


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
