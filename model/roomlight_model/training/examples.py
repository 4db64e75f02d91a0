"""Turn recordings into training examples: choose frames, choose the depth, augment.

Runs on CPU threads. Every random choice follows from (seed, step), so that a resumed run repeats an uninterrupted one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from roomlight.dataset.arkit_depth import arkit_like
from roomlight.dataset.recording import GLASS, Recording
from roomlight.depth import complete_depth
from roomlight.engine.panorama.panels import BRIGHTEST
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.frame import Frame
from roomlight_model.training.subsets import Recordings

DepthKind = Literal["exact", "arkit", "both"]
"""Depth as rendered, as a phone measures it, or half of each."""

_OTHER_FRAMES = 0.5
"""Share of examples that start at another frame than the first: more views of the same rooms."""
_SEEN_THROUGH = 0.5
"""Share of exact depth maps in which panes are holes, as in depth cameras and artists' scenes, where clipped pixels
without depth are windows."""
_CONTRASTS = (0.85, 1.7)
"""Range of exponents of radiance. Generated rooms are lit more evenly than many real ones: the ratio of a frame's mean
to its median has a median of 1.4 in the data, and is 2.2 to 4 in some artists' scenes and real rooms."""


@dataclass(frozen=True, eq=False)
class Example:
    """One frame, or several of a walk, with the true light at some points.

    Attributes:
        frame: The first frame: linear image in its own exposure (1.0 is white), depth as the sensor measures it.
        depth_m: Its depth, completed.
        positions: Points in the world, metres.
        truth: Their panoramas, radiance in the units of the image.
        mirrored: Whether the batch mirrors the example.
        later: Later frames, in order, in the units of the first frame.
        whites: For each frame the radiance at which its camera clips: 4 at a quarter of the first frame's exposure.
    """

    frame: Frame
    depth_m: Float[np.ndarray, "dh dw"]
    positions: Float[np.ndarray, "p 3"]
    truth: Float[np.ndarray, "p h w 3"]
    mirrored: bool = False
    later: tuple[Frame, ...] = ()
    whites: tuple[float, ...] = (1.0,)

    @property
    def completed(self) -> Frame:
        """The first frame with completed depth."""
        return replace(self.frame, depth_m=self.depth_m)


def read_example(
    recordings: Recordings, index: int, rng: np.random.Generator, *, depth: DepthKind, augment: bool, frames: int = 1
) -> Example:
    """Read a random frame of a sequence, or several frames.

    Args:
        depth: Exact depth, simulated phone depth, or both in turn.
        augment: Whether to draw frames at random and to augment. Otherwise the example has the first frame and
            later ones spread over the whole sequence.
        frames: Largest number of frames, spread evenly over a random length of the stream.
    """
    count = recordings.frames_of(index)
    other = augment and rng.random() < _OTHER_FRAMES
    first = int(rng.integers(count)) if other else 0
    numbers = _spread(first, count, frames, rng if augment else None)
    example = example_of(recordings.read(index, frames=numbers), rng, depth=depth)
    if first and not near(example):
        numbers = _spread(0, count, frames, rng)
        example = example_of(recordings.read(index, frames=numbers), rng, depth=depth)
    return augmented(example, rng) if augment else example


def example_of(recording: Recording, rng: np.random.Generator, *, depth: DepthKind) -> Example:
    """Build an example of a recording's decoded frames, in units of the first one.

    Depth "both" draws phone depth for half of the examples and holes at panes for a quarter.
    """
    depth_mm = recording.depth_mm
    if depth == "arkit" or (depth == "both" and rng.random() < 0.5):
        depth_mm = arkit_like(depth_mm, recording.surface, recording.colour, rng)
    elif depth == "both" and rng.random() < _SEEN_THROUGH:
        depth_mm = np.where(recording.surface == GLASS, np.uint16(0), depth_mm)
    first, *later = (recording.frame(number, measured) for number, measured in enumerate(depth_mm))
    whites = tuple((recording.exposure[0] / recording.exposure).astype(np.float32).tolist())
    return Example(
        first,
        complete_depth(first.depth_m),
        recording.probe_positions,
        recording.true_panoramas(),
        later=tuple(later),
        whites=whites,
    )


def _spread(first: int, count: int, most: int, rng: np.random.Generator | None) -> list[int]:
    """Spread at most `most` frames evenly from `first` to a random frame, or to the last one without `rng`.

    The logarithm of the stream's length is drawn uniformly: a stream changes most at its start.
    """
    if most == 1:
        return [first]
    left = count - first
    reach = left if rng is None else min(left, int(np.exp(rng.uniform(0, np.log(left + 1)))))
    return sorted({first + round(float(step)) for step in np.linspace(0, reach - 1, min(most, reach))})


def near(example: Example) -> bool:
    """Return whether every probe is inside the frame's volume; elsewhere the volume has no light of its own."""
    grid = VolumeGrid.from_frame(example.completed)
    return all(grid.contains((float(x), float(y), float(z))) for x, y, z in example.positions)


def augmented(example: Example, rng: np.random.Generator) -> Example:
    """Mirror (half of the examples), change contrast (a quarter), permute channels (a fifth), weight them (a quarter).

    Gains are at least 1 and each image is clipped again after them: its white stays the camera's limit.
    """
    frames, truth, whites = [example.frame, *example.later], example.truth, example.whites
    images = [frame.image for frame in frames]
    if rng.random() < 0.25:
        power = float(np.exp(rng.uniform(*np.log(_CONTRASTS))))
        images, truth = _contrasted(images, truth, power)
        whites = tuple(white**power for white in whites)
    if rng.random() < 0.2:
        order = rng.permutation(3)
        images, truth = [image[..., order] for image in images], truth[..., order]
    if rng.random() < 0.25:
        gains = np.exp(rng.uniform(0, 0.35, 3))
        gains = (gains / gains.min() * rng.uniform(1.0, 1.15)).astype(np.float32)
        images, truth = [image * gains for image in images], truth * gains
    first, *later = map(exposed, frames, images, whites)
    mirrored = bool(rng.random() < 0.5)
    return replace(example, frame=first, later=tuple(later), truth=truth, mirrored=mirrored, whites=whites)


def exposed(frame: Frame, radiance: Float[np.ndarray, "h w 3"], white: float) -> Frame:
    """Return the frame with another image: this radiance, clipped at `white`."""
    limit = np.float32(white)
    return replace(frame, image=np.minimum(radiance, limit), clipped=frame.clipped | (radiance >= limit).any(-1))


def _contrasted(
    images: Sequence[Float[np.ndarray, "h w 3"]], truth: Float[np.ndarray, "p ph pw 3"], power: float
) -> tuple[list[Float[np.ndarray, "h w 3"]], Float[np.ndarray, "p ph pw 3"]]:
    """Raise radiance to a power that keeps the first white: darker corners and brighter lamps, or less of both.

    A gain of 1 to 2.5 then restores the exposure of the image.
    """
    others = [image ** np.float32(power) for image in images]
    gain = np.float32(np.clip(images[0].mean() / max(float(others[0].mean()), 1e-4), 1, 2.5))
    return [other * gain for other in others], limited(truth ** np.float32(power) * gain)


def limited(light: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Dim what is brighter than `BRIGHTEST` in any channel, such as the sun, without changing its hue."""
    return light * np.minimum(1, np.float32(BRIGHTEST) / np.maximum(light.max(axis=-1, keepdims=True), 1))
