"""Examples for the networks on panoramas: what random streams have shown a probe, and the true light there."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
import torch
from jaxtyping import Float16, Float32
from torch import Tensor

from roomlight.compositing.light.object_light import OBJECT_PANELS, object_panels
from roomlight.dataset.loader import Dataset
from roomlight.engine.options import ModelName
from roomlight.engine.panorama.panels import BRIGHTEST, HEIGHT
from roomlight.engine.session import Session, SessionOptions, choose_graphs
from roomlight.errors import DatasetError, FrameError
from roomlight_model.training.examples import example_of

_FROM_START: Final = 0.5
"""Share of streams that begin at a recording's first frame."""
_TINT: Final = 0.1
"""Standard deviation of the logarithm of random channel gains."""
ProgressCallback = Callable[[int, int], object]


@dataclass(frozen=True, eq=False)
class CompletionExamples:
    """Panels of the networks and the true radiance, at the networks' resolution.

    Attributes:
        panels: As `roomlight.compositing.light.object_light.object_panels`; the completion network takes all but the
            last.
        truth: Linear RGB in the units of the panels.
    """

    panels: Float16[np.ndarray, "n 10 h w"]
    truth: Float16[np.ndarray, "n 3 h w"]

    def __len__(self) -> int:
        """Return the number of examples."""
        return len(self.panels)

    def split(self, seed: int) -> "tuple[CompletionExamples, CompletionExamples]":
        """Split off a twelfth, at random, to score: rooms are shared with training, so it shows progress alone."""
        order = np.random.default_rng([seed, 13]).permutation(len(self))
        held = max(1, len(self) // 12)
        parts = [CompletionExamples(self.panels[part], self.truth[part]) for part in (order[held:], order[:held])]
        return parts[0], parts[1]

    @classmethod
    def read(
        cls,
        datasets: Sequence[Dataset],
        *,
        seed: int,
        streams_each: int = 2,
        models: Sequence[ModelName] = ("classical",),
        progress: ProgressCallback | None = None,
    ) -> "CompletionExamples":
        """Stream every recording `streams_each` times, over random frames with random depth, and keep two moments.

        The length of a stream is drawn evenly in its logarithm: a panorama changes most at its start. A recording of
        one frame is streamed once. The sessions have one of the `models` each, in turn.

        Raises:
            DatasetError: No recording has a probe.
            ModelError: The weights of a model are missing.
        """
        rng = np.random.default_rng([seed, 12])
        total, done, streams = sum(map(len, datasets)), 0, 0
        loaded = {model: choose_graphs(SessionOptions(model=model)) for model in models}
        panels, truth = list[np.ndarray](), list[np.ndarray]()
        for dataset in datasets:
            for index in range(len(dataset)):
                count = dataset.frames_of(index)
                for _ in range(streams_each if count > 1 else 1):
                    model = models[streams % len(models)]
                    session = Session(SessionOptions(model=model), graphs=loaded[model])
                    for shown, light in _stream(session, dataset, index, rng):
                        panels.append(shown)
                        truth.append(light)
                    streams += 1
                done += 1
                if progress:
                    progress(done, total)
        if not panels:
            raise DatasetError("no recording has a probe to learn from; generate a dataset with probes")
        return cls(np.stack(panels), np.stack(truth))


def completion_batch(
    examples: CompletionExamples, chosen: Sequence[int], rng: np.random.Generator, *, augment: bool
) -> tuple[Float32[Tensor, "b 10 h w"], Float32[Tensor, "b 3 h w"]]:
    """Stack examples; augmented by rotation about the vertical, mirroring, permuted channels and channel gains."""
    both = np.concatenate([examples.panels[list(chosen)], examples.truth[list(chosen)]], axis=1).astype(np.float32)
    if augment:
        both = np.roll(both, int(rng.integers(2 * HEIGHT)), axis=3)
        if rng.random() < 0.5:
            both = both[..., ::-1]
        if rng.random() < 0.3:
            order = rng.permutation(3)
            both = both[:, [*order, 3, 4, 5, *(6 + order), 9, *(10 + order)]]
        gains = np.exp(rng.normal(0, _TINT, (len(chosen), 3, 1, 1))).astype(np.float32)
        for first in (0, 6, 10):
            both[:, first : first + 3] *= gains
        both[:, 9:10] *= gains.mean(axis=1, keepdims=True)
    stacked = torch.from_numpy(np.ascontiguousarray(both))
    return stacked[:, :OBJECT_PANELS], stacked[:, OBJECT_PANELS:]


def _stream(
    session: Session, dataset: Dataset, index: int, rng: np.random.Generator
) -> list[tuple[Float16[np.ndarray, "10 h w"], Float16[np.ndarray, "3 h w"]]]:
    count = dataset.frames_of(index)
    length = int(np.exp(rng.uniform(0, np.log(count + 0.999))))
    first = 0 if rng.random() < _FROM_START else int(rng.integers(count - length + 1))
    marks = {length - 1, int(rng.integers(length))}
    recording = dataset.read(index, frames=list(range(first, first + length)))
    example = example_of(recording, rng, depth="both")
    handles = [session.track((float(x), float(y), float(z))) for x, y, z in example.positions]
    found = list[tuple[np.ndarray, np.ndarray]]()
    for number, frame in enumerate((example.frame, *example.later)):
        try:
            session.push(replace(frame, index=number))
        except FrameError:  # a frame without depth cannot begin a stream
            return found
        if number in marks:
            found += [(_panels(session, handle), _reduced(example.truth[k])) for k, handle in enumerate(handles)]
    return found


def _panels(session: Session, handle: int) -> Float16[np.ndarray, "10 h w"]:
    return object_panels(session.panorama_state(handle)).astype(np.float16)


def _reduced(truth: Float32[np.ndarray, "h w 3"]) -> Float16[np.ndarray, "3 ph pw"]:
    limited = np.minimum(truth, np.float32(BRIGHTEST))
    means = cv2.resize(limited, (2 * HEIGHT, HEIGHT), interpolation=cv2.INTER_AREA)
    return np.moveaxis(means, -1, 0).astype(np.float16)
