"""From recordings to what the networks are trained on: initial volumes, partial panoramas, the true light.

Made on CPU threads with the same torch-free code that serves; every random choice comes from (seed, step), so that a
run that was killed goes on as if it had not been.
"""

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from roomlight.balls import resize_panorama
from roomlight.clipping import restore_clipped
from roomlight.conventions import srgb8_to_linear
from roomlight.depth import complete_depth
from roomlight.fill import continued
from roomlight.frame import CLIPPED_SRGB8, Frame
from roomlight.mesh import FrameMesh
from roomlight.volume import VolumeGrid, initial_volume
from roomlight_model.dataset.arkit_depth import arkit_like
from roomlight_model.dataset.recording import GLASS, Recording
from roomlight_model.training.options import DepthKind

_OTHER_FRAMES = 0.5
"""The share of examples that show another frame than the first: more views for the same rooms."""
_SEEN_THROUGH = 0.5
"""The share of exact depth maps in which panes are holes, as depth cameras and artists' scenes have them: there what is
clipped is a window."""
_CONTRASTS = (0.85, 1.7)
"""Powers of light. Generated rooms are more evenly lit than many that are filmed: a frame's mean over its median is
1.4 in the middle of the data, 2.2 to 4 in some artists' scenes and real rooms."""
_BRIGHTEST = 60_000.0
"""What a lamp may come to by that, in units of white."""


@runtime_checkable
class Recordings(Protocol):
    """Sequences by number; `frames` says which of them are to be decoded."""

    def __len__(self) -> int:
        """How many there are."""
        ...

    def frames_of(self, index: int, /) -> int:
        """How many frames one of them has."""
        ...

    def read(self, index: int, /, *, frames: list[int]) -> Recording:
        """One sequence with those frames only, in that order, and all its probes."""
        ...


@dataclass(frozen=True, eq=False)
class Example:
    """One frame with the true light at some points.

    frame: linear image in its own exposure (1.0 is white), depth as the sensor gives it. depth_m: the same, completed.
    positions: world, metres. truth: radiance in the same units as the image.
    """

    frame: Frame
    depth_m: Float[np.ndarray, "dh dw"]
    positions: Float[np.ndarray, "p 3"]
    truth: Float[np.ndarray, "p h w 3"]
    mirrored: bool = False

    @property
    def completed(self) -> Frame:
        """The frame with depth everywhere."""
        return replace(self.frame, depth_m=self.depth_m)


@dataclass(frozen=True, eq=False)
class Batch:
    """Examples as tensors. Points and directions in world axes are turned into each volume's frame by `turn`."""

    volume: Float[Tensor, "b 5 z y x"]
    lower_m: Float[Tensor, "b 3"]
    voxel_m: Float[Tensor, "b 3"]
    turn: Float[Tensor, "b 3 3"]
    """World to volume axes; a mirrored example's holds the reflection too."""
    origins: Float[Tensor, "b p 3"]
    """Probes in the volume's frame."""
    to_viewer: Float[Tensor, "b p 3"]
    """Unit world vectors from the probes toward the camera."""
    truth: Float[Tensor, "b p 3 h w"]
    partial: Float[Tensor, "b p 3 h w"] | None = None
    """What the frame's mesh shows at each probe, and beyond it a fill, for the blending stages."""
    mask: Float[Tensor, "b p 1 h w"] | None = None
    """What of that the mesh shows."""

    def to(self, device: torch.device) -> "Batch":
        """The same on another device."""
        moved = {name: value.to(device) for name, value in vars(self).items() if isinstance(value, Tensor)}
        return replace(self, **moved)

    def pieces(self, size: int) -> list["Batch"]:
        """The same examples in batches of `size`, the last of what is left."""
        parts = {name: value.split(size) for name, value in vars(self).items() if isinstance(value, Tensor)}
        return [
            replace(self, **{name: part[number] for name, part in parts.items()})
            for number in range(len(parts["volume"]))
        ]


def read_example(
    recordings: Recordings, index: int, rng: np.random.Generator, *, depth: DepthKind, augment: bool
) -> Example:
    """A random frame of a sequence, with its depth as measured or as a phone would have measured it."""
    other = augment and rng.random() < _OTHER_FRAMES
    number = int(rng.integers(recordings.frames_of(index))) if other else 0
    recording = recordings.read(index, frames=[number])
    example = example_of(recording, 0, rng, depth=depth)
    if number and not _near(example):
        example = example_of(recordings.read(index, frames=[0]), 0, rng, depth=depth)
    return _augmented(example, rng) if augment else example


def example_of(recording: Recording, at: int, rng: np.random.Generator, *, depth: DepthKind) -> Example:
    """The example that one decoded frame of a recording makes; both: half phone-like, a quarter with holes at panes."""
    colour = recording.colour[at]
    depth_mm = recording.depth_mm[at]
    if depth == "arkit" or (depth == "both" and rng.random() < 0.5):
        chosen = slice(at, at + 1)
        phone, _ = arkit_like(recording.depth_mm[chosen], recording.surface[chosen], recording.colour[chosen], rng)
        depth_mm = phone[0]
    elif depth == "both" and rng.random() < _SEEN_THROUGH:
        depth_mm = np.where(recording.surface[at] == GLASS, np.uint16(0), depth_mm)
    measured = depth_mm.astype(np.float32) / np.float32(1000)
    frame = Frame(
        index=0,
        image=srgb8_to_linear(colour),
        clipped=(colour >= CLIPPED_SRGB8).any(-1),
        depth_m=measured,
        intrinsics=recording.intrinsics,
        camera_to_world=recording.camera_to_world[at],
    )
    truth = recording.probe_panoramas.astype(np.float32) * np.float32(recording.exposure[at])
    return Example(frame, complete_depth(measured), recording.probe_positions, truth)


def collate(examples: list[Example], *, volume_shape: tuple[int, int, int], panorama_height: int | None) -> Batch:
    """A batch; panorama_height, where given, asks for partial panoramas of that height (and truth resampled to it).

    All examples have equally many probes.
    """
    columns: dict[str, list[np.ndarray]] = {}

    def put(name: str, value: np.ndarray) -> None:
        columns.setdefault(name, []).append(np.asarray(value, np.float32))

    for example in examples:
        frame = restore_clipped(example.frame, example.depth_m)
        grid = VolumeGrid.from_frame(frame, shape=volume_shape)
        flip = np.diag([-1.0 if example.mirrored else 1.0, 1.0, 1.0])
        volume = initial_volume(grid, frame)
        put("volume", volume[..., ::-1] if example.mirrored else volume)
        put("lower_m", grid.lower_m)
        put("voxel_m", grid.voxel_m)
        turn = flip @ grid.world_to_volume[:3, :3]
        put("turn", turn)
        away = example.positions - frame.camera_to_world[:3, 3]
        put("origins", away @ turn.T)
        put("to_viewer", -away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6))
        put("truth", np.moveaxis(_at_height(example.truth, panorama_height), -1, 1))
        if panorama_height is not None:
            mesh = FrameMesh(frame)
            seen = [mesh.look_from(position, height=panorama_height) for position in example.positions]
            filled = [continued(one.radiance, one.mask.astype(np.float32)) for one in seen]
            put("partial", np.stack([np.moveaxis(one, -1, 0) for one in filled]))
            put("mask", np.stack([one.mask[None] for one in seen]))
    return Batch(**{name: torch.from_numpy(np.stack(values)) for name, values in columns.items()})


def _near(example: Example) -> bool:
    """Whether every probe is inside the frame's own volume: elsewhere it has nothing to say."""
    grid = VolumeGrid.from_frame(example.completed)
    return all(grid.contains((float(x), float(y), float(z))) for x, y, z in example.positions)


def _augmented(example: Example, rng: np.random.Generator) -> Example:
    """Mirrored (half of the time), of other contrast (a quarter), colours exchanged (a fifth), weighted (a quarter).

    Gains are 1 or more and the image is clipped again after them: white stays the camera's limit.
    """
    image, truth = example.frame.image, example.truth
    if rng.random() < 0.25:
        image, truth = _contrasted(image, truth, float(np.exp(rng.uniform(*np.log(_CONTRASTS)))))
    if rng.random() < 0.2:
        order = rng.permutation(3)
        image, truth = image[..., order], truth[..., order]
    if rng.random() < 0.25:
        gains = np.exp(rng.uniform(0, 0.35, 3))
        gains = (gains / gains.min() * rng.uniform(1.0, 1.15)).astype(np.float32)
        image, truth = np.minimum(image * gains, 1), truth * gains
    clipped = example.frame.clipped | (image >= 1).any(-1)
    frame = replace(example.frame, image=np.ascontiguousarray(image), clipped=clipped)
    return replace(example, frame=frame, truth=truth, mirrored=bool(rng.random() < 0.5))


def _contrasted(
    image: Float[np.ndarray, "h w 3"], truth: Float[np.ndarray, "p ph pw 3"], power: float
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "p ph pw 3"]]:
    """A room whose light is that power of this one's, white staying white: darker corners and brighter lamps, or less
    of both. It is then exposed as brightly as this one, as far as that is a gain."""
    other = image ** np.float32(power)
    gain = np.float32(np.clip(image.mean() / max(float(other.mean()), 1e-4), 1, 2.5))
    lit = np.minimum(truth ** np.float32(power) * gain, np.float32(_BRIGHTEST))
    return np.minimum(other * gain, 1), lit


def _at_height(panoramas: Float[np.ndarray, "p h w 3"], height: int | None) -> Float[np.ndarray, "p h2 w2 3"]:
    if height is None or panoramas.shape[1] == height:
        return panoramas
    return np.stack([resize_panorama(panorama, height) for panorama in panoramas])
