"""Turn walks into training sequences: cut, sub-sample, augment, and convert to batches of tensors.

Frames keep their order. All are in units of the first one, whose camera defines the volume. Initial volumes, meshes and
what a probe sees of them come from the serving engine's code.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from roomlight.engine.panorama.blend import farthest_depth_m
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.volume.grid import VolumeGrid, initial_volume
from roomlight.frame import Frame
from roomlight_model.training.batches import Probes, at_height, probe_columns, restored_frames
from roomlight_model.training.examples import DepthKind, Example, augmented, example_of, near
from roomlight_model.training.subsets import Recordings

_WHOLE = 0.25
"""Share of steps with the largest number of frames; the others draw the logarithm of the number uniformly."""
_FROM_THE_START = 0.5
"""Share of sequences that begin with the walk's first frame, near which the probes are."""
_MAX_STRIDE = 4
_OF_MESHES: Final = ("detail", "mask", "distance_m", "clipped", "guessed")
"""Fields of `WalkBatch` that frames' meshes fill."""
_OF_FRAMES: Final = ("volume", "light_of", *_OF_MESHES)
"""Fields of `WalkBatch` whose second axis is the frame."""


@dataclass(frozen=True, eq=False)
class WalkExample:
    """Consecutive frames of a walk, with the true light of every frame at some points.

    Attributes:
        example: The frames, points and mirroring. Its `truth` is the first light.
        lights: Every light that the sequence has: the points' panoramas, in units of the first frame.
        light_of: For each frame, the number of its light. Generated rooms have one light.
    """

    example: Example
    lights: Float[np.ndarray, "s p h w 3"]
    light_of: Int[np.ndarray, " t"]

    @property
    def frames(self) -> tuple[Frame, ...]:
        """The frames in order, as the sensor measured them."""
        return (self.example.frame, *self.example.later)


LightChange = Callable[[WalkExample, np.random.Generator], WalkExample]
"""An augmentation that changes the light from some frame on: it returns the sequence with other images for those
frames, another entry of `lights`, and its number in `light_of`. All sequences of a batch need as many lights."""


def draw_length(most: int, rng: np.random.Generator) -> int:
    """Draw a number of frames from 2 to `most`, so that the networks learn short and long pasts."""
    if rng.random() < _WHOLE:
        return most
    return min(most, int(np.exp(rng.uniform(np.log(2), np.log(most + 1)))))


def draw_frames(count: int, length: int, rng: np.random.Generator) -> list[int]:
    """Draw `length` equally spaced frames of a walk of `count`.

    Raises:
        ValueError: The walk has fewer frames.
    """
    if length > count:
        raise ValueError(f"a walk of {count} frames has no {length}")
    strides = min(_MAX_STRIDE, (count - 1) // max(length - 1, 1)) if length > 1 else 1
    stride = int(rng.integers(1, strides + 1))
    last_start = count - 1 - stride * (length - 1)
    start = 0 if rng.random() < _FROM_THE_START else int(rng.integers(last_start + 1))
    return list(range(start, start + stride * (length - 1) + 1, stride))


def revisit(numbers: Sequence[int], rng: np.random.Generator) -> list[int]:
    """Replace the end of a sequence: it stays at a frame, or returns the way it came. The length stays the same."""
    changes_at = int(rng.integers(1, len(numbers)))
    if rng.random() < 0.5:
        return [*numbers[:changes_at], *[numbers[changes_at - 1]] * (len(numbers) - changes_at)]
    period = max(2 * (changes_at - 1), 1)
    places = [k % period for k in range(len(numbers))]
    return [numbers[min(place, period - place) if changes_at > 1 else 0] for place in places]


def read_walk(
    recordings: Recordings,
    index: int,
    rng: np.random.Generator,
    *,
    depth: DepthKind,
    length: int,
    augment: bool,
    change_light: LightChange | None = None,
    revisits: float = 0.0,
) -> WalkExample:
    """Read a sequence of `length` frames of a walk; without `augment` the first ones, as they are.

    With `augment`, a share `revisits` of the sequences shows places again (`revisit`).

    A sequence whose first frame's volume does not contain every point begins with the walk's first frame instead.
    """
    count = recordings.frames_of(index)
    numbers = draw_frames(count, length, rng) if augment else list(range(length))
    if augment and length > 1 and revisits and rng.random() < revisits:
        numbers = revisit(numbers, rng)
    example = example_of(recordings.read(index, frames=numbers), rng, depth=depth)
    if numbers[0] and not near(example):
        numbers = [number - numbers[0] for number in numbers]
        example = example_of(recordings.read(index, frames=numbers), rng, depth=depth)
    if augment:
        example = augmented(example, rng)
    walk = WalkExample(example, example.truth[None], np.zeros(length, np.int64))
    return walk if change_light is None or not augment else change_light(walk, rng)


@dataclass(frozen=True, eq=False)
class WalkBatch(Probes):
    """Sequences of as many frames as tensors; t is the frame, s the light."""

    volume: Float[Tensor, "b t 5 z y x"]
    """Initial volumes of the frames, in the first frame's grid."""
    depth_max_m: Float[Tensor, " b"]
    lights: Float[Tensor, "b s p 3 h w"]
    light_of: Int[Tensor, "b t"]
    detail: Float[Tensor, "b t p 3 h w"] | None = None
    """Each frame's mesh rendered at each probe, 0 outside it; for the blending stages."""
    mask: Float[Tensor, "b t p 1 h w"] | None = None
    distance_m: Float[Tensor, "b t p 1 h w"] | None = None
    """Distance of the mesh, at most `roomlight.engine.panorama.blend.farthest_depth_m`; 0 outside it."""
    clipped: Float[Tensor, "b t p 1 h w"] | None = None
    """Share of the mesh's surface whose pixels were clipped."""
    guessed: Float[Tensor, "b t p 1 h w"] | None = None
    """Luminance of `detail` that was estimated for these pixels."""

    @property
    def frames(self) -> int:
        """Number of frames of each sequence."""
        return self.light_of.shape[1]

    def cut(self, start: int, stop: int) -> "WalkBatch":
        """Return the batch with these frames alone."""
        values = {name: value for name in _OF_FRAMES if (value := getattr(self, name)) is not None}
        return replace(self, **{name: value[:, start:stop] for name, value in values.items()})

    def truth(self, frame: int) -> Float[Tensor, "b p 3 h w"]:
        """Return the true light at the probes in a frame."""
        return self.lights[torch.arange(len(self.lights), device=self.lights.device), self.light_of[:, frame]]


@dataclass(frozen=True, eq=False)
class PreparedWalk:
    """A sequence as the serving engine sees it: restored frames and the volume's grid."""

    walk: WalkExample
    frames: list[Frame]
    grid: VolumeGrid

    @classmethod
    def of(cls, walk: WalkExample, volume_shape: tuple[int, int, int]) -> "PreparedWalk":
        """Complete depth, restore clipped light, and make the grid of the first frame."""
        frames = restored_frames(walk.example)
        return cls(walk, frames, VolumeGrid.from_frame(frames[0], shape=volume_shape))


def collate_walks(walks: Sequence[PreparedWalk], *, panorama_height: int | None) -> WalkBatch:
    """Build a batch without the probes' views; a `panorama_height` resamples the truth."""
    columns: dict[str, list[np.ndarray]] = {}
    for prepared in walks:
        example = prepared.walk.example
        volumes = np.stack([initial_volume(prepared.grid, frame) for frame in prepared.frames])
        lights = np.stack([at_height(light, panorama_height) for light in prepared.walk.lights])
        row = {
            **probe_columns(example, prepared.grid),
            "volume": volumes[..., ::-1] if example.mirrored else volumes,
            "depth_max_m": np.asarray(prepared.grid.depth_max_m),
            "lights": np.moveaxis(lights, -1, 2),
        }
        for name, value in row.items():
            columns.setdefault(name, []).append(np.asarray(value, np.float32))
    tensors = {name: torch.from_numpy(np.stack(values)) for name, values in columns.items()}
    return WalkBatch(**tensors, light_of=torch.from_numpy(np.stack([prepared.walk.light_of for prepared in walks])))


def with_views(batch: WalkBatch, walks: Sequence[PreparedWalk], *, panorama_height: int) -> WalkBatch:
    """Add what the probes see of each frame's mesh."""
    planes: dict[str, list[np.ndarray]] = {name: [] for name in _OF_MESHES}
    for prepared in walks:
        farthest_m = farthest_depth_m(prepared.grid.depth_max_m)
        positions = prepared.walk.example.positions
        views = [
            [mesh.render_panorama(position, height=panorama_height).within(farthest_m) for position in positions]
            for mesh in map(FrameMesh, prepared.frames)
        ]
        planes["detail"].append(np.array([[np.moveaxis(view.radiance, -1, 0) for view in row] for row in views]))
        planes["mask"].append(np.array([[view.mask[None] for view in row] for row in views], np.float32))
        planes["distance_m"].append(np.array([[view.depth_m[None] for view in row] for row in views]))
        nothing = np.zeros((1, panorama_height, 2 * panorama_height), np.float32)
        for name in ("clipped", "guessed"):
            rows = [[getattr(view, name) for view in row] for row in views]
            planes[name].append(
                np.array([[nothing if plane is None else plane[None] for plane in row] for row in rows])
            )
    return replace(batch, **{name: torch.from_numpy(np.stack(values)) for name, values in planes.items()})
