"""Which sequences a run trains on and which it keeps for its own curve; both follow folders that grow.

Held out are the first rooms of the first folder: a dataset grows at its end, so they stay the same ones from stage to
stage and from night to night. What the test split is for is not looked at here.
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


class Subset:
    """Some sequences of several datasets, numbered from 0; may grow while others read."""

    def __init__(self, places: Sequence[tuple[Recordings, int]]) -> None:
        """`places` are (dataset, number in it)."""
        self._places = tuple(places)

    def __len__(self) -> int:
        """How many."""
        return len(self._places)

    def read(self, index: int, /, *, frames: list[int]) -> Recording:
        """One of them, with the frames asked for."""
        recordings, number = self._places[index]
        return recordings.read(number, frames=frames)

    def frames_of(self, index: int, /) -> int:
        """How many frames one of them has."""
        recordings, number = self._places[index]
        return recordings.frames_of(number)

    def shares(self) -> list[tuple[Recordings, int]]:
        """Each of the datasets, and how many of its sequences these are."""
        datasets = {id(dataset): dataset for dataset, _ in self._places}
        counts = Counter(id(dataset) for dataset, _ in self._places)
        return [(dataset, counts[key]) for key, dataset in datasets.items()]

    def replace_by(self, other: "Subset") -> int:
        """Take the other's sequences from now on (readers see the old ones or the new); returns how many are new."""
        before, self._places = len(self._places), other._places
        return len(self._places) - before


def train_val_split(datasets: Sequence[Recordings], held_out: int = HELD_OUT) -> tuple[Subset, Subset]:
    """(to train on, held out): the first sequences of the first dataset are held out, at most a quarter of it."""
    kept = min(held_out, len(datasets[0]) // 4)
    places = [(dataset, number) for dataset in datasets for number in range(len(dataset))]
    return Subset(places[kept:]), Subset(places[:kept])


def surround(recording: Recording) -> float:
    """How bright it is all around the probes, over the first frame: means of log(1 + light), by solid angle and pixel.

    Under 1 where the frame shows the lit side of a room, as people film it.
    """
    around = recording.probe_panoramas.astype(np.float32).mean(axis=-1)
    share = panorama_solid_angles(around.shape[1]) / (4 * np.pi)
    frame = np.log1p(srgb8_to_linear(recording.colour[0]).mean(axis=-1))
    return float((np.log1p(around).mean(axis=0) * share).sum() / max(frame.mean(), 1e-6))


class TrainingRooms:
    """The train splits of some dataset folders; `grow` sees what was finished since."""

    def __init__(
        self,
        folders: Sequence[Path],
        *,
        surround_max: float = 0.0,
        held_out: int = HELD_OUT,
        progress: Callable[[int, int], object] | None = None,
    ) -> None:
        """held_out: at most so many are kept from training; a run that goes on gives what it began with, since a folder
        that has grown meanwhile would keep more. surround_max: train on sequences whose `surround` is no more than
        this (0: on all); what is held out is not chosen. `progress` hears how many of the sequences were looked at for
        it. DatasetError where a folder is no dataset, or none of its sequences is left.
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
                f"times as bright as its first frame (the least: {min(self._surrounds.values()):.2f}); allow more"
            )

    def grow(self) -> int:
        """Look at the folders again; returns how many sequences came to be trained on. Held out stays what it is."""
        return self.training.replace_by(Subset(self._places(self._open())))

    def described(self) -> list[dict[str, Any]]:
        """For a model's card: each dataset's seed, frames a sequence, and how many of its sequences are trained on."""
        return [
            {"seed": settings.seed, "frames": settings.frames, "sequences": count}
            for dataset, count in self.training.shares()
            if isinstance(dataset, Dataset)
            for settings in [dataset.manifest.settings]
        ]

    def _places(self, datasets: Sequence[Dataset]) -> list[tuple[Recordings, int]]:
        """What is to be trained on."""
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
