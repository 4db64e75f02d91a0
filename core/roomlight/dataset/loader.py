"""Reads a dataset: any sequence by number, or all of them in a shuffled stream for training. Needs no PyTorch.

Nothing is extracted: a sequence is read by its place in its shard, its checksum compared (each time: 1.5 ms for 2.5
MB), and only the frames asked for are decoded.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import UInt8, UInt16

from roomlight.dataset import sequence_files as layout
from roomlight.dataset.archive import unpack
from roomlight.dataset.folder import Manifest, read_manifest, shard_files
from roomlight.dataset.recording import Recording, Split
from roomlight.dataset.shards import Entry, index_path, read_index, read_packed, remedy
from roomlight.errors import DatasetError, ImageError

DepthKind = Literal["exact", "arkit"]


@dataclass(frozen=True, eq=False)
class Example:
    """A sequence as a network meets it: the recording (only the frames asked for), and the depth its phone gave.

    depth_mm is z-depth, 0 = unknown, of the recording's frames: the exact one, or 256 x 192 as a LiDAR phone's;
    confidence is 0, 1 or 2 as ARKit's.
    """

    recording: Recording
    depth_mm: UInt16[np.ndarray, "f dh dw"]
    confidence: UInt8[np.ndarray, "f dh dw"]


@dataclass(frozen=True)
class StreamOptions:
    """How to go through a dataset once.

    seed, epoch:  of the order and of the phones' depth; another epoch is another order.
    frames:       which to decode, None for all; a network of a single view wants (0,).
    part:         (k, n) gives every n-th shard from the k-th on, for one of n training processes.
    buffer:       sequences that the shuffling looks ahead over: neighbours in a shard are walks through one room, so
                  it should be several shards.
    workers:      threads that decode ahead. The order does not depend on them.
    damaged:      "raise" the DatasetError of a damaged sequence, or "skip" it.
    """

    seed: int = 0
    epoch: int = 0
    frames: Sequence[int] | None = None
    depth: DepthKind = "exact"
    part: tuple[int, int] = (0, 1)
    shuffle: bool = True
    buffer: int = 128
    workers: int = 2
    damaged: Literal["raise", "skip"] = "raise"


@dataclass(frozen=True)
class _Place:
    tar: Path
    entry: Entry


class Dataset:
    """The finished sequences of a folder, in the order of their names; those finished later are not seen.

    Damage shows when a sequence is read, as a DatasetError that names it; the others are not touched by it.
    """

    def __init__(self, folder: Path, split: Split | None = None) -> None:
        """Read the indices, of one split or of both; DatasetError where the folder is no dataset."""
        self.folder = folder
        self.manifest: Manifest = read_manifest(folder)
        places: list[_Place] = []
        self.damaged_lines: list[str] = []
        for tar in shard_files(folder, split):
            index = read_index(tar)
            places += [_Place(tar, entry) for entry in index.entries]
            self.damaged_lines += [f"{index_path(tar)}: line {number} is damaged" for number in index.damaged]
        self._places = sorted(places, key=lambda place: place.entry.name)
        self._numbers = {place.entry.name: number for number, place in enumerate(self._places)}

    def __len__(self) -> int:
        """How many sequences are finished."""
        return len(self._places)

    def __getitem__(self, number: int) -> Recording:
        """A whole sequence; `read` decodes less of it."""
        return self.read(number)

    def __iter__(self) -> Iterator[Recording]:
        """Every sequence, in order."""
        return (self.read(number) for number in range(len(self)))

    @property
    def names(self) -> list[str]:
        """The sequences' names, in order."""
        return [place.entry.name for place in self._places]

    def number_of(self, name: str) -> int:
        """The place of a sequence in the order; DatasetError where there is none of this name."""
        if name not in self._numbers:
            first = f", from {self.names[0]} to {self.names[-1]}" if len(self) else ""
            raise DatasetError(f"{self.folder}: has no sequence {name!r}; it has {len(self)}{first}")
        return self._numbers[name]

    def size_of(self, number: int) -> int:
        """Bytes of a sequence in its shard."""
        return self._places[number].entry.length

    def frames_of(self, number: int) -> int:
        """How many frames a sequence has."""
        _ = self._places[number]  # IndexError where there is none
        return self.manifest.settings.frames

    def files(self, number: int) -> dict[str, memoryview]:
        """The files of a sequence by name, their checksum compared; DatasetError where it does not match."""
        place = self._places[number]
        try:
            return unpack(read_packed(place.tar, place.entry), place.entry.name)
        except ValueError as error:
            raise self._foreign(place, error) from error

    def read(self, number: int, *, frames: Sequence[int] | None = None, probes: bool = True) -> Recording:
        """A sequence, only these frames of it decoded (None: all), with or without its probes."""
        return self._decoded(number, self.files(number), frames=frames, probes=probes)

    def stream(self, options: StreamOptions | None = None) -> Iterator[Example]:
        """Every sequence once, shuffled: shards in a random order, sequences within a window over them.

        The same options give the same examples in the same order.
        """
        options = options or StreamOptions()
        ahead: deque[Future[Example | None]] = deque()
        with ThreadPoolExecutor(max(1, options.workers), thread_name_prefix="dataset") as pool:
            try:
                for number in self._order(options):
                    ahead.append(pool.submit(self._example, number, options))
                    if len(ahead) > 2 * max(1, options.workers):
                        yield from _present(ahead.popleft())
                while ahead:
                    yield from _present(ahead.popleft())
            finally:
                for future in ahead:
                    future.cancel()

    def _order(self, options: StreamOptions) -> Iterator[int]:
        rng = np.random.default_rng([options.seed, options.epoch])
        shards: dict[Path, list[int]] = {}
        for number, place in enumerate(self._places):
            shards.setdefault(place.tar, []).append(number)
        part, parts = options.part
        mine = [shards[tar] for tar in sorted(shards)]
        if options.shuffle:
            mine = [mine[k] for k in rng.permutation(len(mine))]
        window: list[int] = []
        for numbers in mine[part::parts]:
            if not options.shuffle:
                yield from numbers
                continue
            for number in numbers:
                window.append(number)
                if len(window) > options.buffer:
                    yield _drawn(window, rng)
        while window:
            yield _drawn(window, rng)

    def _example(self, number: int, options: StreamOptions) -> Example | None:
        try:
            recording = self.read(number, frames=options.frames)
        except DatasetError:
            if options.damaged == "skip":
                return None
            raise
        from roomlight.dataset.arkit_depth import arkit_like, exact

        if options.depth == "exact":
            return Example(recording, *exact(recording.depth_mm))
        # by name, not by place: a dataset that grows keeps its phones
        rng = np.random.default_rng([options.seed, options.epoch, *recording.name.encode()])
        return Example(recording, *arkit_like(recording.depth_mm, recording.surface, recording.colour, rng))

    def _decoded(
        self, number: int, files: dict[str, memoryview], *, frames: Sequence[int] | None, probes: bool
    ) -> Recording:
        place = self._places[number]
        try:
            return layout.decode(files, f"{place.tar}: {place.entry.name}", frames=frames, probes=probes)
        except (ValueError, KeyError, TypeError, ImageError) as error:
            raise self._foreign(place, error) from error

    def _foreign(self, place: _Place, error: Exception) -> DatasetError:
        """Bytes have their checksum and are no sequence all the same: another program's, or another version's."""
        return DatasetError(f"{place.tar}: sequence {place.entry.name} cannot be read ({error}); {remedy(place.tar)}")


def _drawn(window: list[int], rng: np.random.Generator) -> int:
    """One of the window at random, taken out."""
    at = int(rng.integers(len(window)))
    window[at], window[-1] = window[-1], window[at]
    return window.pop()


def _present(future: Future[Example | None]) -> Iterator[Example]:
    example = future.result()
    if example is not None:
        yield example
