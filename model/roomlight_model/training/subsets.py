"""The sequences that a run trains on, and the held-out ones of its validation; both follow growing folders.

The first rooms of the first folder are held out: a dataset grows at its end, so that they stay the same between stages
and runs. The test split is not used.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from roomlight.conventions import panorama_solid_angles, srgb8_to_linear
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Recording
from roomlight.errors import DatasetError
from roomlight_model.training.examples import Recordings
from roomlight_model.training.options import HELD_OUT

ProgressCallback = Callable[[int, int], object]
"""Receives (done, total)."""


class Subset:
    """Some sequences of several datasets, numbered from 0; may grow while others read."""

    def __init__(self, places: Sequence[tuple[Recordings, int]]) -> None:
        """Take sequences as pairs of dataset and number in it."""
        self._places = tuple(places)

    def __len__(self) -> int:
        """Return the number of sequences."""
        return len(self._places)

    def read(self, index: int, /, *, frames: list[int]) -> Recording:
        """Read a sequence with the requested frames."""
        recordings, number = self._places[index]
        return recordings.read(number, frames=frames)

    def frames_of(self, index: int, /) -> int:
        """Return the number of frames of a sequence."""
        recordings, number = self._places[index]
        return recordings.frames_of(number)

    def shares(self) -> list[tuple[Recordings, int]]:
        """Return each dataset with the number of its sequences in the subset."""
        datasets = {id(dataset): dataset for dataset, _ in self._places}
        counts = Counter(id(dataset) for dataset, _ in self._places)
        return [(dataset, counts[key]) for key, dataset in datasets.items()]

    def replace_by(self, other: "Subset") -> int:
        """Replace the sequences by another subset's, atomically for readers; returns how many were added."""
        before, self._places = len(self._places), other._places
        return len(self._places) - before


def train_val_split(datasets: Sequence[Recordings], held_out: int = HELD_OUT) -> tuple[Subset, Subset]:
    """Split into training and held-out sequences: the first ones of the first dataset, at most a quarter of it."""
    kept = min(held_out, len(datasets[0]) // 4)
    places = [(dataset, number) for dataset in datasets for number in range(len(dataset))]
    return Subset(places[kept:]), Subset(places[:kept])


def surround(recording: Recording) -> float:
    """Return the ratio of the brightness around the probes to the first frame's, as means of log(1 + light).

    The means are by solid angle and by pixel. The ratio is below 1 if the frame shows the lit side of a room, as in
    most real videos.
    """
    around = recording.probe_panoramas.astype(np.float32).mean(axis=-1)
    share = panorama_solid_angles(around.shape[1]) / (4 * np.pi)
    frame = np.log1p(srgb8_to_linear(recording.colour[0]).mean(axis=-1))
    return float((np.log1p(around).mean(axis=0) * share).sum() / max(frame.mean(), 1e-6))


class TrainingRooms:
    """The train splits of dataset folders; `grow` adds sequences that were finished since."""

    def __init__(
        self,
        folders: Sequence[Path],
        *,
        surround_max: float = 0.0,
        held_out: int = HELD_OUT,
        progress: ProgressCallback | None = None,
    ) -> None:
        """Open the folders and choose the sequences.

        Args:
            folders: Dataset folders; the first one has the held-out sequences.
            surround_max: Train only on sequences whose `surround` is at most this; 0 trains on all. Held-out
                sequences are not filtered.
            held_out: Largest number of held-out sequences. A resumed run passes its first number, because a folder
                that has grown would hold out more.
            progress: Receives (done, total) sequences while `surround` is computed.

        Raises:
            DatasetError: A folder is not a dataset, or no sequence is left to train on.
        """
        self._folders, self._most, self._progress = tuple(folders), surround_max, progress
        self._surrounds: dict[tuple[int, str], float] = {}
        datasets = self._open()
        chosen, self.held_out = train_val_split(datasets, held_out)
        self._kept = frozenset(datasets[0].names[: len(self.held_out)])
        self.training = Subset(self._places(datasets))
        if not len(self.training) and len(chosen):
            where = ", ".join(str(folder) for folder in folders)
            raise DatasetError(
                f"{where}: none of {len(chosen)} sequences has surroundings at most {surround_max} "
                f"times as bright as its first frame (the least: {min(self._surrounds.values()):.2f}); "
                "raise `surround_max`"
            )

    def grow(self) -> int:
        """Read the folders again and return how many training sequences were added; held-out ones stay the same."""
        return self.training.replace_by(Subset(self._places(self._open())))

    def described(self) -> list[dict[str, Any]]:
        """Describe the training data for a model's card: seed, frames and number of sequences of each dataset."""
        return [
            {"seed": settings.seed, "frames": settings.frames, "sequences": count}
            for dataset, count in self.training.shares()
            if isinstance(dataset, Dataset)
            for settings in [dataset.manifest.settings]
        ]

    def _places(self, datasets: Sequence[Dataset]) -> list[tuple[Recordings, int]]:
        """Return the sequences to train on."""
        named = [
            (folder, name, (dataset, number))
            for folder, dataset in enumerate(datasets)
            for number, name in enumerate(dataset.names)
            if folder or name not in self._kept
        ]
        if not self._most:
            return [place for _, _, place in named]
        for done, (folder, name, (dataset, number)) in enumerate(named, 1):
            if (folder, name) not in self._surrounds:
                self._surrounds[folder, name] = surround(dataset.read(number, frames=[0]))
                if self._progress:
                    self._progress(done, len(named))
        return [place for folder, name, place in named if self._surrounds[folder, name] <= self._most]

    def _open(self) -> list[Dataset]:
        return [Dataset(folder, "train") for folder in self._folders]
