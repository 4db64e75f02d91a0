"""From recordings to what the networks are trained on: initial volumes, partial panoramas, the true light.

Made on CPU threads with the same torch-free code that serves; every random choice comes from (seed, step), so that a
run that was killed goes on as if it had not been.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from roomlight.balls import resize_panorama
from roomlight.blend import CLOSER_M, PanoramaState, accumulate, farthest_depth_m, filled_detail
from roomlight.clipping import restore_clipped
from roomlight.conventions import srgb8_to_linear
from roomlight.depth import complete_depth
from roomlight.frame import CLIPPED_SRGB8, Frame
from roomlight.fusion import FusedVolume
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
    """One frame, or several of a walk, with the true light at some points.

    frame: linear image in its own exposure (1.0 is white), depth as the sensor gives it. depth_m: the same, completed.
    positions: world, metres. truth: radiance in the same units as the image. later: frames after it, in order, likewise
    and in the first one's units.
    """

    frame: Frame
    depth_m: Float[np.ndarray, "dh dw"]
    positions: Float[np.ndarray, "p 3"]
    truth: Float[np.ndarray, "p h w 3"]
    mirrored: bool = False
    later: tuple[Frame, ...] = ()

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
    """What the last frame's mesh shows at each probe, and beyond it a fill, for the blending stages."""
    mask: Float[Tensor, "b p 1 h w"] | None = None
    """What of that the mesh shows."""
    before: Float[Tensor, "b p 3 h w"] | None = None
    """What the frames before it showed there."""
    kept: Float[Tensor, "b p 1 h w"] | None = None
    """Where that is what a probe has: the last frame shows nothing nearer."""

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
    recordings: Recordings, index: int, rng: np.random.Generator, *, depth: DepthKind, augment: bool, frames: int = 1
) -> Example:
    """A random frame of a sequence, with its depth as measured or as a phone would have measured it.

    frames: up to so many together, from the first frames of a stream to all of it, spread evenly over what was seen by
    then. Without augmentation they are the first frame, and the rest spread over the whole sequence.
    """
    count = recordings.frames_of(index)
    other = augment and rng.random() < _OTHER_FRAMES
    first = int(rng.integers(count)) if other else 0
    numbers = _spread(first, count, frames, rng if augment else None)
    example = _example_of_all(recordings.read(index, frames=numbers), rng, depth=depth)
    if first and not _near(example):
        numbers = _spread(0, count, frames, rng)
        example = _example_of_all(recordings.read(index, frames=numbers), rng, depth=depth)
    return _augmented(example, rng) if augment else example


def example_of(
    recording: Recording, at: int, rng: np.random.Generator, *, depth: DepthKind, later: Sequence[int] = ()
) -> Example:
    """The example that one decoded frame of a recording makes, or with it some `later` ones; both: half phone-like, a
    quarter with holes at panes."""
    chosen = [at, *later]
    depth_mm = recording.depth_mm[chosen]
    if depth == "arkit" or (depth == "both" and rng.random() < 0.5):
        depth_mm, _ = arkit_like(depth_mm, recording.surface[chosen], recording.colour[chosen], rng)
    elif depth == "both" and rng.random() < _SEEN_THROUGH:
        depth_mm = np.where(recording.surface[chosen] == GLASS, np.uint16(0), depth_mm)
    frames = [
        Frame(
            index=order,
            image=srgb8_to_linear(recording.colour[number])
            * np.float32(recording.exposure[at] / recording.exposure[number]),
            clipped=(recording.colour[number] >= CLIPPED_SRGB8).any(-1),
            depth_m=measured.astype(np.float32) / np.float32(1000),
            intrinsics=recording.intrinsics,
            camera_to_world=recording.camera_to_world[number],
        )
        for order, (number, measured) in enumerate(zip(chosen, depth_mm, strict=True))
    ]
    truth = recording.probe_panoramas.astype(np.float32) * np.float32(recording.exposure[at])
    return Example(
        frames[0], complete_depth(frames[0].depth_m), recording.probe_positions, truth, later=tuple(frames[1:])
    )


def collate(examples: list[Example], *, volume_shape: tuple[int, int, int], panorama_height: int | None) -> Batch:
    """A batch; panorama_height, where given, asks for partial panoramas of that height (and truth resampled to it).

    All examples have equally many probes.
    """
    columns: dict[str, list[np.ndarray]] = {}

    def put(name: str, value: np.ndarray) -> None:
        columns.setdefault(name, []).append(np.asarray(value, np.float32))

    for example in examples:
        frames = [restore_clipped(example.frame, example.depth_m)]
        frames += [restore_clipped(frame, complete_depth(frame.depth_m)) for frame in example.later]
        grid = VolumeGrid.from_frame(frames[0], shape=volume_shape)
        flip = np.diag([-1.0 if example.mirrored else 1.0, 1.0, 1.0])
        volume = _mean_volume(grid, frames)
        put("volume", volume[..., ::-1] if example.mirrored else volume)
        put("lower_m", grid.lower_m)
        put("voxel_m", grid.voxel_m)
        turn = flip @ grid.world_to_volume[:3, :3]
        put("turn", turn)
        away = example.positions - frames[0].camera_to_world[:3, 3]
        put("origins", away @ turn.T)
        put("to_viewer", -away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6))
        put("truth", np.moveaxis(_at_height(example.truth, panorama_height), -1, 1))
        if panorama_height is not None:
            meshes = [FrameMesh(frame) for frame in frames]
            looks = [_look(meshes, position, grid, panorama_height) for position in example.positions]
            for name, planes in zip(_Look._fields, zip(*looks, strict=True), strict=True):
                put(name, np.stack([np.moveaxis(plane, -1, 0) for plane in planes]))
    return Batch(**{name: torch.from_numpy(np.stack(values)) for name, values in columns.items()})


def _spread(first: int, count: int, most: int, rng: np.random.Generator | None) -> list[int]:
    """At most `most` frames from `first` on: spread evenly to a moment of the stream, the last one without `rng`.

    Moments are drawn evenly in the logarithm of the frames seen by then: a stream changes most when it begins.
    """
    if most == 1:
        return [first]
    left = count - first
    reach = left if rng is None else min(left, int(np.exp(rng.uniform(0, np.log(left + 1)))))
    return sorted({first + round(float(step)) for step in np.linspace(0, reach - 1, min(most, reach))})


def _example_of_all(recording: Recording, rng: np.random.Generator, *, depth: DepthKind) -> Example:
    return example_of(recording, 0, rng, depth=depth, later=range(1, len(recording.colour)))


def _mean_volume(grid: VolumeGrid, frames: Sequence[Frame]) -> Float[np.ndarray, "5 z y x"]:
    """What the serving engine shows the networks after these frames."""
    if len(frames) == 1:
        return initial_volume(grid, frames[0])
    fused = FusedVolume.fresh(grid.shape)
    for frame in frames:
        fused.add(initial_volume(grid, frame))
    volume = np.empty((5, *grid.shape), np.float32)
    fused.write(volume)
    return volume


class _Look(NamedTuple):
    """What `Batch` holds of one probe, under the same names."""

    partial: Float[np.ndarray, "h w 3"]
    mask: Bool[np.ndarray, "h w 1"]
    before: Float[np.ndarray, "h w 3"]
    kept: Bool[np.ndarray, "h w 1"]


def _look(meshes: Sequence[FrameMesh], position: Float[np.ndarray, "3"], grid: VolumeGrid, height: int) -> _Look:
    """As the serving engine has it at the last frame, if every detail of the frames before came in whole."""
    state = PanoramaState.fresh(height, grid.depth_max_m)
    nothing = np.zeros((height, 2 * height, 3), np.float32)
    farthest_m = np.float32(farthest_depth_m(grid.depth_max_m))
    *earlier, last = (mesh.look_from(position, height=height) for mesh in meshes)
    for look in earlier:
        depth_m, weight = np.minimum(look.depth_m, farthest_m), look.mask.astype(np.float32)
        accumulate(state, hdr=nothing, detail=look.radiance, detail_depth_m=depth_m, weight=weight)
    depth_m = np.minimum(last.depth_m, farthest_m)
    filled = filled_detail(state, last.radiance, depth_m, mask=last.mask, hdr=nothing)
    kept = (state.seen > 0) & ~(last.mask & (state.depth_m - depth_m >= CLOSER_M))
    return _Look(filled, last.mask[..., None], state.radiance, kept[..., None])


def _near(example: Example) -> bool:
    """Whether every probe is inside the frame's own volume: elsewhere it has nothing to say."""
    grid = VolumeGrid.from_frame(example.completed)
    return all(grid.contains((float(x), float(y), float(z))) for x, y, z in example.positions)


def _augmented(example: Example, rng: np.random.Generator) -> Example:
    """Mirrored (half of the time), of other contrast (a quarter), colours exchanged (a fifth), weighted (a quarter).

    Gains are 1 or more and the image is clipped again after them: white stays the camera's limit.
    """
    frames, truth = [example.frame, *example.later], example.truth
    images = [frame.image for frame in frames]
    if rng.random() < 0.25:
        images, truth = _contrasted(images, truth, float(np.exp(rng.uniform(*np.log(_CONTRASTS)))))
    if rng.random() < 0.2:
        order = rng.permutation(3)
        images, truth = [image[..., order] for image in images], truth[..., order]
    if rng.random() < 0.25:
        gains = np.exp(rng.uniform(0, 0.35, 3))
        gains = (gains / gains.min() * rng.uniform(1.0, 1.15)).astype(np.float32)
        images, truth = [np.minimum(image * gains, 1) for image in images], truth * gains
    first, *later = (
        replace(frame, image=np.ascontiguousarray(image), clipped=frame.clipped | (image >= 1).any(-1))
        for frame, image in zip(frames, images, strict=True)
    )
    mirrored = bool(rng.random() < 0.5)
    return replace(example, frame=first, later=tuple(later), truth=truth, mirrored=mirrored)


def _contrasted(
    images: Sequence[Float[np.ndarray, "h w 3"]], truth: Float[np.ndarray, "p ph pw 3"], power: float
) -> tuple[list[Float[np.ndarray, "h w 3"]], Float[np.ndarray, "p ph pw 3"]]:
    """A room whose light is that power of this one's, white staying white: darker corners and brighter lamps, or less
    of both. It is then exposed as brightly as this one, as far as that is a gain."""
    others = [image ** np.float32(power) for image in images]
    gain = np.float32(np.clip(images[0].mean() / max(float(others[0].mean()), 1e-4), 1, 2.5))
    lit = np.minimum(truth ** np.float32(power) * gain, np.float32(_BRIGHTEST))
    return [np.minimum(other * gain, 1) for other in others], lit


def _at_height(panoramas: Float[np.ndarray, "p h w 3"], height: int | None) -> Float[np.ndarray, "p h2 w2 3"]:
    if height is None or panoramas.shape[1] == height:
        return panoramas
    return np.stack([resize_panorama(panorama, height) for panorama in panoramas])
