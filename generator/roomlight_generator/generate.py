"""Generates a dataset with a process a core: hands out shards, counts what comes back, starts again what dies.

The bytes of a dataset depend on its settings alone: not on how many workers there were, how often they were killed,
or in how many runs it grew. Each worker writes its shard itself; nothing but counts goes through this process.
"""

import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from roomlight.dataset.folder import FRAMES, Settings, begin, locked, prepare, sequence_name, shards_of
from roomlight.dataset.recording import Split
from roomlight.dataset.shards import is_finished, read_index, shard_path
from roomlight.errors import DatasetError
from roomlight_generator.furniture_digest import digest
from roomlight_generator.worker import ShardTask
from roomlight_generator.worker_pool import work_through

RENDERER: Final = "roomlight_generator.sequences.render:render_room"


@dataclass(frozen=True)
class GenerateOptions:
    """What to generate. More sequences than a folder has continue it; everything else must be as it was made.

    sequences:           in the split, in all.
    shard_size:          sequences a file: 16 are 40 MB, so that a worker is never long without news.
    sequences_per_room:  walks through one room, which share its light's solution.
    frames:              in each sequence; 1 makes single views, of which an hour gives four times as many.
    furniture:           a furniture library or cache to use instead of the installed one.
    """

    sequences: int
    seed: int = 0
    split: Split = "train"
    shard_size: int = 16
    sequences_per_room: int = 4
    frames: int = FRAMES
    furniture: Path | None = None
    renderer: str = RENDERER

    def __post_init__(self) -> None:
        """DatasetError for numbers that make no dataset."""
        if min(self.sequences, self.shard_size, self.sequences_per_room, self.frames) < 1 or self.seed < 0:
            raise DatasetError(
                f"{self.sequences} sequences, {self.shard_size} a shard, {self.sequences_per_room} a room, "
                f"{self.frames} frames, seed {self.seed}: each must be 1 or more, and the seed 0 or more"
            )
        if self.shard_size % self.sequences_per_room:
            raise DatasetError(
                f"a shard of {self.shard_size} sequences does not hold whole rooms of {self.sequences_per_room}; "
                "make the first a multiple of the second"
            )


@dataclass(frozen=True)
class Progress:
    """Where a run stands. finished counts from earlier runs too, made only this run's; `news` is worth a line."""

    wanted: int
    finished: int
    made: int
    bytes: int
    core_s: float
    elapsed_s: float
    news: str | None = None

    @property
    def per_hour(self) -> float | None:
        """Sequences an hour in this run, once there is one."""
        return 3600 * self.made / self.elapsed_s if self.made and self.elapsed_s > 0 else None

    @property
    def left_s(self) -> float | None:
        """Seconds to go at this rate."""
        return None if self.per_hour is None else (self.wanted - self.finished) * 3600 / self.per_hour


@dataclass(frozen=True)
class GenerateReport:
    """A run that reached its end. core_s: processor seconds of each sequence made, in the order they were finished."""

    sequences: int
    made: int
    bytes: int
    elapsed_s: float
    core_s: tuple[float, ...] = field(repr=False)


def generate(
    out: Path,
    options: GenerateOptions,
    *,
    workers: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> GenerateReport:
    """Make the folder `out` a dataset with so many sequences, or go on with one; `workers` None is a process a core.

    OutputError where the folder is foreign, locked by another or cannot be written; DatasetError where it was made
    with other settings, a shard to go on with is damaged, or a room cannot be made. Whatever ends it, finished
    sequences stay, and the same call goes on.
    """
    prepare(out)
    settings = Settings(
        seed=options.seed,
        shard_size=options.shard_size,
        sequences_per_room=options.sequences_per_room,
        frames=options.frames,
        furniture=digest(options.furniture),
        renderer=options.renderer,
    )
    with locked(out):
        begin(out, settings, split=options.split, sequences=options.sequences)
        shards = {
            shard_path(out, options.split, numbers.start // options.shard_size): numbers
            for numbers in shards_of(options.sequences, options.shard_size)
        }
        todo = deque(
            _task(tar, numbers, options)
            for tar, numbers in shards.items()
            if not is_finished(tar, _names(options.split, numbers))
        )
        run = _Run(options.sequences, *_count(shards, options.split), progress or (lambda _: None))
        run.tell()
        work_through(todo, workers=workers or len(os.sched_getaffinity(0)), hear=run.hear)
        finished, size = _count(shards, options.split)
    return GenerateReport(finished, len(run.core_s), size, run.elapsed_s, tuple(run.core_s))


def _names(split: str, numbers: range) -> set[str]:
    return {sequence_name(split, number) for number in numbers}


def _count(shards: dict[Path, range], split: str) -> tuple[int, int]:
    """How many sequences are finished, and their bytes."""
    lengths = [
        entry.length
        for tar, numbers in shards.items()
        for entry in read_index(tar).entries
        if entry.name in _names(split, numbers)
    ]
    return len(lengths), sum(lengths)


def _task(tar: Path, numbers: range, options: GenerateOptions) -> ShardTask:
    return ShardTask(
        tar=str(tar),
        split=options.split,
        first=numbers.start,
        last=numbers.stop,
        seed=options.seed,
        sequences_per_room=options.sequences_per_room,
        frames=options.frames,
        furniture=None if options.furniture is None else str(options.furniture.resolve()),
        renderer=options.renderer,
    )


class _Run:
    """The counts."""

    def __init__(self, wanted: int, finished: int, size: int, progress: Callable[[Progress], None]) -> None:
        self._wanted, self._finished, self._bytes = wanted, finished, size
        self._progress = progress
        self._start = time.monotonic()
        self.core_s: list[float] = []

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self._start

    def hear(self, message: dict[str, Any]) -> None:
        if message["what"] == "sequence":
            self._finished += 1
            self._bytes += message["bytes"]
            self.core_s.append(message["core_s"])
            self.tell()
        else:
            self.tell(message["text"])

    def tell(self, news: str | None = None) -> None:
        made = len(self.core_s)
        self._progress(
            Progress(self._wanted, self._finished, made, self._bytes, sum(self.core_s, 0.0), self.elapsed_s, news)
        )
