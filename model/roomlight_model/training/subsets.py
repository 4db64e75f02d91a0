"""The sequences that a run trains on, and those that are held out to score it.

View and video stages hold out every twelfth room of every dataset, so that no stage trains on a room that another one
scores; the shipped single-view weights are older than this rule. Buildings differ between splits alone: a panorama that
lights a held-out room lights others too. The small networks hold out the test splits; where there are none, such rooms.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np

from roomlight.conventions import panorama_solid_angles, srgb8_to_linear
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Recording
from roomlight.errors import DatasetError

ProgressCallback = Callable[[int, int], object]
"""Receives (done, total)."""
_HELD_OUT_EVERY: Final = 12


class Subset:
    """Some sequences of several datasets, numbered from 0."""

    def __init__(self, places: Sequence[tuple[Dataset, int]]) -> None:
        """Take sequences as pairs of dataset and number in it."""
        self._places = tuple(places)

    def __len__(self) -> int:
        return len(self._places)

    def read(self, index: int, /, **options: Any) -> Recording:
        """Read a sequence; `options` are those of its dataset's `read`."""
        recordings, number = self._places[index]
        return recordings.read(number, **options)

    def frames_of(self, index: int, /) -> int:
        """Return the number of frames of a sequence."""
        recordings, number = self._places[index]
        return recordings.frames_of(number)

    def without_bright_surroundings(self, most: float, progress: ProgressCallback | None = None) -> "Subset":
        """Return the sequences whose `surround` is at most `most`.

        Raises:
            DatasetError: No sequence is left.
        """
        surrounds: list[float] = []
        for index in range(len(self)):
            surrounds.append(surround(self.read(index, frames=[0])))
            if progress:
                progress(index + 1, len(self))
        places = [place for place, ratio in zip(self._places, surrounds, strict=True) if ratio <= most]
        if not places:
            raise DatasetError(
                f"none of {len(self)} sequences has surroundings at most {most} times as bright as its first frame "
                f"(the least: {min(surrounds, default=0):.2f}); raise `surround_max`"
            )
        return Subset(places)


Recordings = Dataset | Subset
"""Sequences by number."""


def each_sequence(
    datasets: Sequence[Recordings], progress: ProgressCallback | None = None
) -> Iterator[tuple[Recordings, int]]:
    """Yield every sequence as its dataset and its number there; `progress` is called when one has been used."""
    sequences = [(dataset, index) for dataset in datasets for index in range(len(dataset))]
    for done, sequence in enumerate(sequences, 1):
        yield sequence
        if progress:
            progress(done, len(sequences))


def train_val_split(datasets: Sequence[Dataset], scored: int | None = None) -> tuple[Subset, Subset]:
    """Split into the sequences to train on, without every twelfth room, and those to score.

    The latter are the first ones of the first dataset's held-out rooms, at most `scored`; None: those of every dataset,
    once each.

    Raises:
        DatasetError: No sequence is left to train on.
    """
    places = [(dataset, number) for dataset in datasets for number in range(len(dataset))]
    training = [(dataset, number) for dataset, number in places if dataset.room_of(number) % _HELD_OUT_EVERY]
    if not training:
        raise DatasetError(
            f"the {len(places)} sequences are all of held-out rooms, every twelfth from the first; generate more rooms"
        )
    chosen = datasets[:1] if scored is not None else dict.fromkeys(datasets)
    places = [(dataset, number) for dataset in chosen for number in range(len(dataset))]
    held_out = [(dataset, number) for dataset, number in places if dataset.room_of(number) % _HELD_OUT_EVERY == 0]
    return Subset(training), Subset(held_out[:scored])


def test_split(datasets: Sequence[Dataset]) -> list[Dataset]:
    """Return the test splits of the datasets' folders, where there are any."""
    folders = {dataset.folder: dataset for dataset in datasets if dataset.manifest.sequences.get("test")}
    splits = [Dataset(folder, "test") for folder in folders]
    return [split for split in splits if len(split)]


def describe(datasets: Sequence[Dataset]) -> list[dict[str, Any]]:
    """Describe datasets for a model's card: the settings and the number of sequences of each."""
    return [{**vars(dataset.manifest.settings), "sequences": len(dataset)} for dataset in datasets]


def surround(recording: Recording) -> float:
    """Return the ratio of the brightness around the probes to the first frame's, as means of log(1 + light).

    The means are by solid angle and by pixel. The ratio is below 1 if the frame shows the lit side of a room, as in
    most real videos.
    """
    around = recording.probe_panoramas.astype(np.float32).mean(axis=-1)
    share = panorama_solid_angles(around.shape[1]) / (4 * np.pi)
    frame = np.log1p(srgb8_to_linear(recording.colour[0]).mean(axis=-1))
    return float((np.log1p(around).mean(axis=0) * share).sum() / max(frame.mean(), 1e-6))
