"""From recordings to examples: which frames, whose depth, augmented how.

Made on CPU threads; every random choice comes from (seed, step), so that a run that was killed goes on as if it had
not been.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from roomlight.conventions import srgb8_to_linear
from roomlight.dataset.arkit_depth import arkit_like
from roomlight.dataset.recording import GLASS, Recording
from roomlight.depth import complete_depth
from roomlight.engine.volume import VolumeGrid
from roomlight.frame import CLIPPED_SRGB8, Frame
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
    example = example_of(recordings.read(index, frames=numbers), rng, depth=depth)
    if first and not _near(example):
        numbers = _spread(0, count, frames, rng)
        example = example_of(recordings.read(index, frames=numbers), rng, depth=depth)
    return _augmented(example, rng) if augment else example


def example_of(recording: Recording, rng: np.random.Generator, *, depth: DepthKind) -> Example:
    """The example that a recording's decoded frames make together, in the first one's units; both: half phone-like, a
    quarter with holes at panes."""
    depth_mm = recording.depth_mm
    if depth == "arkit" or (depth == "both" and rng.random() < 0.5):
        depth_mm, _ = arkit_like(depth_mm, recording.surface, recording.colour, rng)
    elif depth == "both" and rng.random() < _SEEN_THROUGH:
        depth_mm = np.where(recording.surface == GLASS, np.uint16(0), depth_mm)
    first, *later = (
        Frame(
            index=number,
            image=srgb8_to_linear(colour) * np.float32(recording.exposure[0] / recording.exposure[number]),
            clipped=(colour >= CLIPPED_SRGB8).any(-1),
            depth_m=measured.astype(np.float32) / np.float32(1000),
            intrinsics=recording.intrinsics,
            camera_to_world=recording.camera_to_world[number],
        )
        for number, (colour, measured) in enumerate(zip(recording.colour, depth_mm, strict=True))
    )
    truth = recording.probe_panoramas.astype(np.float32) * np.float32(recording.exposure[0])
    return Example(first, complete_depth(first.depth_m), recording.probe_positions, truth, later=tuple(later))


def _spread(first: int, count: int, most: int, rng: np.random.Generator | None) -> list[int]:
    """At most `most` frames from `first` on: spread evenly to a moment of the stream, the last one without `rng`.

    Moments are drawn evenly in the logarithm of the frames seen by then: a stream changes most when it begins.
    """
    if most == 1:
        return [first]
    left = count - first
    reach = left if rng is None else min(left, int(np.exp(rng.uniform(0, np.log(left + 1)))))
    return sorted({first + round(float(step)) for step in np.linspace(0, reach - 1, min(most, reach))})


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
