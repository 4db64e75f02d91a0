"""Which sequences a run trains on and which it keeps for its own curve; both follow folders that grow.

Held out are the first rooms of the first folder: a dataset grows at its end, so they stay the same ones from stage to
stage and from night to night. What the test split is for is not looked at here.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from roomlight_model.dataset.loader import Dataset
from roomlight_model.dataset.recording import Recording
from roomlight_model.training.examples import Recordings

HELD_OUT: Final = 48
"""Sequences kept from training, at most a quarter of all: 12 rooms of four walks, 24 of two."""


class Part:
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

    def replace_by(self, other: "Part") -> int:
        """Take the other's sequences from now on (readers see the old ones or the new); returns how many are new."""
        before, self._places = len(self._places), other._places
        return len(self._places) - before


def split_off(datasets: Sequence[Recordings], held_out: int = HELD_OUT) -> tuple[Part, Part]:
    """(to train on, held out): the first sequences of the first dataset are held out, at most a quarter of it."""
    kept = min(held_out, len(datasets[0]) // 4)
    places = [(dataset, number) for dataset in datasets for number in range(len(dataset))]
    return Part(places[kept:]), Part(places[:kept])


class TrainingRooms:
    """The train splits of some dataset folders; `grow` sees what was finished since."""

    def __init__(self, folders: Sequence[Path]) -> None:
        """DatasetError where a folder is no dataset."""
        self._folders = tuple(folders)
        datasets = self._open()
        self.training, self.held_out = split_off(datasets)
        self._kept = frozenset(datasets[0].names[: len(self.held_out)])

    def grow(self) -> int:
        """Look at the folders again; returns how many sequences came to be trained on. Held out stays what it is."""
        first, *others = self._open()
        places = [(first, number) for number, name in enumerate(first.names) if name not in self._kept]
        places += [(dataset, number) for dataset in others for number in range(len(dataset))]
        return self.training.replace_by(Part(places))

    def _open(self) -> list[Dataset]:
        return [Dataset(folder, "train") for folder in self._folders]
