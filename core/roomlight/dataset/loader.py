"""Read a dataset: any sequence by number, or all sequences in a shuffled stream for training. Needs no PyTorch.

Nothing is extracted: a sequence is read at its offset in its shard, its checksum is compared (each time: 1.5 ms for
2.5 MB), and only the requested frames are decoded.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import UInt8, UInt16

from roomlight.dataset import sequence_files
from roomlight.dataset.archive import unpack
from roomlight.dataset.folder import Manifest, read_manifest, shard_files
from roomlight.dataset.recording import Recording, Split
from roomlight.dataset.shards import Entry, index_path, read_index, read_packed, remedy
from roomlight.errors import DatasetError, ImageError

DepthKind = Literal["exact", "arkit"]


@dataclass(frozen=True, eq=False)
class StreamedSequence:
    """A sequence of a stream: the recording with the requested frames, and their measured depth.

    Attributes:
        recording: The recording.
        depth_mm: z-depth of its frames in millimetres, 0 = unknown: exact, or 256 x 192 as a LiDAR phone's.
        confidence: 0, 1 or 2 as ARKit's.
    """

    recording: Recording
    depth_mm: UInt16[np.ndarray, "f dh dw"]
    confidence: UInt8[np.ndarray, "f dh dw"]


@dataclass(frozen=True)
class StreamOptions:
    """Options of one pass over a dataset.

    Attributes:
        seed: Seed of the order and of the simulated depth.
        epoch: Number of the pass; each has another order.
        frames: Frames to decode, None for all; a single-view network needs (0,).
        depth: Exact depth, or simulated phone depth.
        part: (k, n) selects every n-th shard from the k-th on, for one of n training processes.
        shuffle: Whether to shuffle shards and sequences.
        buffer: Length of the shuffling window in sequences. Neighbours in a shard are walks through one room, so that
            the window should span several shards.
        clipped: Whether to decode the radiance of clipped pixels (`Recording.clipped_radiance`).
        workers: Threads that decode ahead; the order does not depend on them.
        damaged: "raise" the DatasetError of a damaged sequence, or "skip" the sequence.
    """

    seed: int = 0
    epoch: int = 0
    frames: Sequence[int] | None = None
    depth: DepthKind = "exact"
    part: tuple[int, int] = (0, 1)
    shuffle: bool = True
    buffer: int = 128
    clipped: bool = False
    workers: int = 2
    damaged: Literal["raise", "skip"] = "raise"


@dataclass(frozen=True)
class _StoredSequence:
    tar: Path
    entry: Entry


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
        places: list[_StoredSequence] = []
        self.damaged_lines: list[str] = []
        for tar in shard_files(folder, split):
            index = read_index(tar)
            places += [_StoredSequence(tar, entry) for entry in index.entries]
            self.damaged_lines += [f"{index_path(tar)}: line {number} is damaged" for number in index.damaged]
        self._places = sorted(places, key=lambda place: place.entry.name)
        self._numbers = {place.entry.name: number for number, place in enumerate(self._places)}

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, number: int) -> Recording:
        return self.read(number)

    def __iter__(self) -> Iterator[Recording]:
        return (self.read(number) for number in range(len(self)))

    @property
    def names(self) -> list[str]:
        """The names of the sequences, in order."""
        return [place.entry.name for place in self._places]

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
        name = self._places[number].entry.name
        return int(name.rpartition("-")[2]) // self.manifest.settings.sequences_per_room

    def files(self, number: int) -> dict[str, memoryview]:
        """Read the files of a sequence by name. Raises DatasetError if their checksum does not match."""
        place = self._places[number]
        try:
            return unpack(read_packed(place.tar, place.entry), place.entry.name)
        except ValueError as error:
            raise self._foreign(place, error) from error

    def read(
        self, number: int, *, frames: Sequence[int] | None = None, probes: bool = True, clipped: bool = False
    ) -> Recording:
        """Read a sequence with the requested frames (None: all), with or without its probes.

        `clipped` decodes the radiance of clipped pixels too; sequences made before it was stored have None.

        Raises:
            DatasetError: The sequence is damaged.
            IndexError: There is no such sequence or frame.
        """
        files, place = self.files(number), self._places[number]
        label = f"{place.tar}: {place.entry.name}"
        try:
            return sequence_files.decode(files, label, frames=frames, probes=probes, clipped=clipped)
        except (ValueError, KeyError, TypeError, ImageError) as error:
            raise self._foreign(place, error) from error

    def stream(self, options: StreamOptions | None = None) -> Iterator[StreamedSequence]:
        """Yield every sequence once: shards in random order, sequences shuffled within a sliding window.

        The same options give the same sequences in the same order.
        """
        options = options or StreamOptions()
        ahead: deque[Future[StreamedSequence | None]] = deque()
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
        ordered = [shards[tar] for tar in sorted(shards)]
        if options.shuffle:
            ordered = [ordered[k] for k in rng.permutation(len(ordered))]
        window: list[int] = []
        for numbers in ordered[part::parts]:
            if not options.shuffle:
                yield from numbers
                continue
            for number in numbers:
                window.append(number)
                if len(window) > options.buffer:
                    yield _drawn(window, rng)
        while window:
            yield _drawn(window, rng)

    def _example(self, number: int, options: StreamOptions) -> StreamedSequence | None:
        try:
            recording = self.read(number, frames=options.frames, clipped=options.clipped)
        except DatasetError:
            if options.damaged == "skip":
                return None
            raise
        from roomlight.dataset.arkit_depth import arkit_like, exact

        if options.depth == "exact":
            return StreamedSequence(recording, *exact(recording.depth_mm))
        # seeded by name, not by number: sequences of a growing dataset keep their depth sensors
        rng = np.random.default_rng([options.seed, options.epoch, *recording.name.encode()])
        return StreamedSequence(recording, *arkit_like(recording.depth_mm, recording.surface, recording.colour, rng))

    def _foreign(self, place: _StoredSequence, error: Exception) -> DatasetError:
        """Return the error for bytes that have their checksum but are not a sequence, such as another version's."""
        return DatasetError(f"{place.tar}: sequence {place.entry.name} cannot be read ({error}); {remedy(place.tar)}")


def _drawn(window: list[int], rng: np.random.Generator) -> int:
    """Remove a random entry of the window and return it."""
    at = int(rng.integers(len(window)))
    window[at], window[-1] = window[-1], window[at]
    return window.pop()


def _present(future: Future[StreamedSequence | None]) -> Iterator[StreamedSequence]:
    example = future.result()
    if example is not None:
        yield example
