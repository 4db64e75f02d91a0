"""Read the sequences of a dataset by number. Needs no PyTorch.

Nothing is extracted: a sequence is read at its offset in its shard, its checksum is compared (each time: 1.5 ms for
2.5 MB), and only the requested frames are decoded.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

from roomlight.dataset import sequence_files
from roomlight.dataset.archive import unpack
from roomlight.dataset.folder import Manifest, read_manifest, shard_files
from roomlight.dataset.recording import Recording, Split
from roomlight.dataset.shards import Entry, read_index, read_packed, remedy
from roomlight.errors import DatasetError, ImageError

DepthKind = Literal["exact", "arkit"]
"""Depth of a walk: as rendered, or as a phone measures it."""


class Dataset:
    """The finished sequences of a folder in the order of their names, as of when it was opened.

    Damage is found when a sequence is read: a DatasetError names it, and other sequences stay readable.
    """

    def __init__(self, folder: Path, split: Split | None = None) -> None:
        """Read the indices of one split, or of both.

        Raises:
            DatasetError: The folder is not a dataset, or an index cannot be read.
        """
        self.folder = folder
        self.manifest: Manifest = read_manifest(folder)
        places = [(tar, entry) for tar in shard_files(folder, split) for entry in read_index(tar).entries]
        self._places = sorted(places, key=lambda place: place[1].name)
        self._numbers = {entry.name: number for number, (_, entry) in enumerate(self._places)}

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, number: int) -> Recording:
        return self.read(number)

    def __iter__(self) -> Iterator[Recording]:
        return (self.read(number) for number in range(len(self)))

    @property
    def names(self) -> list[str]:
        """The names of the sequences, in order."""
        return [entry.name for _, entry in self._places]

    def number_of(self, name: str) -> int:
        """Return a sequence's number. Raises DatasetError for an unknown name."""
        if name not in self._numbers:
            first = f", from {self.names[0]} to {self.names[-1]}" if len(self) else ""
            raise DatasetError(f"{self.folder}: has no sequence {name!r}; it has {len(self)}{first}")
        return self._numbers[name]

    def frames_of(self, number: int) -> int:
        """Return the number of frames of a sequence. Raises IndexError for an unknown number."""
        _ = self._places[number]  # raises IndexError
        return self.manifest.settings.frames

    def room_of(self, number: int) -> int:
        """Return the number of a sequence's room. Raises IndexError for an unknown number."""
        _, entry = self._places[number]
        return int(entry.name.rpartition("-")[2]) // self.manifest.settings.sequences_per_room

    def files(self, number: int) -> dict[str, memoryview]:
        """Read the files of a sequence by name. Raises DatasetError if their checksum does not match."""
        tar, entry = self._places[number]
        try:
            return unpack(read_packed(tar, entry), entry.name)
        except ValueError as error:
            raise _foreign(tar, entry, error) from error

    def read(
        self, number: int, *, frames: Sequence[int] | None = None, probes: bool = True, clipped: bool = False
    ) -> Recording:
        """Read a sequence with the requested frames (None: all), with or without its probes.

        `clipped` decodes the radiance of clipped pixels too; sequences made before it was stored have None.

        Raises:
            DatasetError: The sequence is damaged.
            IndexError: There is no such sequence or frame.
        """
        files, (tar, entry) = self.files(number), self._places[number]
        label = f"{tar}: {entry.name}"
        try:
            return sequence_files.decode(files, label, frames=frames, probes=probes, clipped=clipped)
        except (ValueError, KeyError, TypeError, ImageError) as error:
            raise _foreign(tar, entry, error) from error


def _foreign(tar: Path, entry: Entry, error: Exception) -> DatasetError:
    """Return the error for bytes that have their checksum but are not a sequence, such as another version's."""
    return DatasetError(f"{tar}: sequence {entry.name} cannot be read ({error}); {remedy(tar)}")
