"""Generate a dataset with a process a core: assign shards to workers, count sequences, replace workers that die.

The bytes of a dataset depend on its settings alone: not on how many workers there were, how often they were killed,
or in how many runs it grew. Each worker writes its shard itself; only counts pass through this process.
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Final

from annotated_types import Ge, Interval

from roomlight.dataset.folder import (
    FRAMES,
    GENERATOR,
    MANIFEST,
    DatasetSettings,
    create_folder,
    locked,
    sequence_name,
    shards_of,
    update_manifest,
)
from roomlight.dataset.recording import Split
from roomlight.dataset.shards import is_finished, read_index, shard_path
from roomlight.errors import DatasetError, OptionError
from roomlight.rules import check_options
from roomlight.threads import core_count
from roomlight_generator.blender.check import check_scenes
from roomlight_generator.furniture_digest import furniture_digest
from roomlight_generator.panoramas.library import files_digest, panoramas_digest, split_files
from roomlight_generator.worker import ShardTask
from roomlight_generator.worker_pool import Message, WorkerPool

RENDERER: Final = "roomlight_generator.sequences.render:render_room"
PANORAMA_RENDERER: Final = "roomlight_generator.panoramas.render:render_room"
VIEWS: Final = "roomlight_generator.sequences.any_view:render_views"
PANORAMA_VIEWS: Final = "roomlight_generator.sequences.any_view:render_panorama_views"
BLENDER_RENDERER: Final = "roomlight_generator.blender.render:render_room"
FURNITURE_SHARE: Final = 0.7
"""Default share of the rooms lit by panoramas that have furniture."""


@dataclass(frozen=True)
class GenerateOptions:
    """Options of a dataset.

    To continue a dataset, `sequences` may grow; the other options must be those that it was made with.

    Attributes:
        sequences: Sequences that the folder has in the end; those of earlier runs count.
        seed: The same seed gives the same rooms.
        split: train and test have no room, no furniture model and no texture in common.
        shard_size: Sequences per file (16 are 40 MB); a worker makes one file at a time.
        sequences_per_room: Walks through each room; they share the solution of its light.
        frames: Frames per walk; 1 makes single views and is four times as fast.
        furniture: A .sh3f library, or a cache of several; default: the installed libraries.
        renderer: `module:function` that renders a room's recordings (`RenderRoom`); None for RoomLight's own.
        panoramas: Folder of equirectangular HDR panoramas (.exr, .hdr) that light the rooms: real light.
        furniture_share: Share of the rooms lit by panoramas that have furniture.
        any_view: Instead of walks with probes, single views from anywhere in the room, without probes (for depth).
        scenes: Blender files, a room each, that are rendered instead of generated rooms.
        samples: Paths a pixel of frames of Blender files; probes have four times as many.

    Raises:
        OptionError: An option is out of range, or of what is not asked for.
        DatasetError: A shard does not hold whole rooms.
    """

    sequences: Annotated[int, Ge(1)]
    seed: Annotated[int, Ge(0)] = 0
    split: Split = "train"
    shard_size: Annotated[int, Ge(1)] = 16
    sequences_per_room: Annotated[int, Ge(1)] = 4
    frames: Annotated[int, Ge(1)] = FRAMES
    furniture: Path | None = None
    renderer: str | None = None
    panoramas: Path | None = None
    furniture_share: Annotated[float, Interval(ge=0, le=1)] = FURNITURE_SHARE
    any_view: bool = False
    scenes: tuple[Path, ...] = ()
    samples: Annotated[int, Ge(1)] = 64

    def __post_init__(self) -> None:
        check_options(self)
        if self.any_view and (self.scenes or self.renderer):
            other = "renderer" if self.renderer else "scenes"
            raise OptionError(f"any_view is True and {other} is given, which decides itself; leave one out")
        if self.panoramas is None and self.furniture_share != FURNITURE_SHARE:
            raise OptionError("`furniture_share` is of rooms that `panoramas` light; add that, or leave it out")
        if self.shard_size % self.sequences_per_room:
            raise DatasetError(
                f"a shard of {self.shard_size} sequences does not hold whole rooms of {self.sequences_per_room}; "
                "make the first a multiple of the second"
            )

    @property
    def renderer_name(self) -> str:
        """The renderer's `module:function`."""
        if self.renderer is not None or self.scenes:
            return self.renderer or BLENDER_RENDERER
        own = (VIEWS, PANORAMA_VIEWS) if self.any_view else (RENDERER, PANORAMA_RENDERER)
        return own[self.panoramas is not None]


@dataclass(frozen=True)
class GenerationProgress:
    """The state of a run.

    Attributes:
        wanted: Sequences that the folder has in the end.
        finished: Sequences finished, in earlier runs too.
        made: Sequences made in this run.
        bytes: Bytes of all finished sequences.
        core_s: Processor time of the sequences made.
    """

    wanted: int
    finished: int
    made: int
    bytes: int
    core_s: float
    elapsed_s: float
    note: str | None = None

    @property
    def per_hour(self) -> float | None:
        """Sequences an hour in this run; None before the first."""
        return 3600 * self.made / self.elapsed_s if self.made and self.elapsed_s > 0 else None

    @property
    def left_s(self) -> float | None:
        """Seconds left at this rate; None before the first sequence."""
        return None if self.per_hour is None else (self.wanted - self.finished) * 3600 / self.per_hour


ProgressCallback = Callable[[GenerationProgress], None]


@dataclass(frozen=True)
class GenerateReport:
    """A finished run.

    Attributes:
        sequences: Sequences in the split, of all runs.
        asked: As many as were asked for in the run that asked for most.
        made: Sequences made in this run.
        bytes: Bytes of all sequences.
        core_s: Processor time of each sequence made, in the order in which they were finished.
    """

    sequences: int
    asked: int
    made: int
    bytes: int
    elapsed_s: float
    core_s: tuple[float, ...] = field(repr=False)


def generate(
    out: Path, options: GenerateOptions, *, workers: int | None = None, progress: ProgressCallback | None = None
) -> GenerateReport:
    """Make a dataset in the folder `out`, or continue the dataset there.

    However the call ends, finished sequences stay, and the same call continues. `workers` None is a process a core;
    `progress` is called when a sequence is finished, and with messages.

    Raises:
        OutputError: if the folder holds other files, is locked by another process or cannot be written.
        DatasetError: if the dataset was made with other settings, a shard to continue is damaged, a room cannot be
            made, Blender scenes are refused, or the folder of panoramas has none for the split.
    """
    if options.panoramas is not None:
        split_files(options.panoramas, options.split)  # says now, not from a worker, that there are none
    create_folder(out)
    furnished = not options.scenes and (options.panoramas is None or options.furniture_share > 0)
    settings = DatasetSettings(
        seed=options.seed,
        shard_size=options.shard_size,
        sequences_per_room=options.sequences_per_room,
        frames=options.frames,
        furniture=furniture_digest(options.furniture) if furnished else None,
        renderer=options.renderer_name,
        generator=GENERATOR,
        panoramas=None if options.panoramas is None else panoramas_digest(options.panoramas),
        furniture_share=None if options.panoramas is None else options.furniture_share,
        scenes=", ".join(f"{path.name} {files_digest([('', path)])[:12]}" for path in options.scenes) or None,
        samples=options.samples if options.scenes else None,
    )
    with locked(out):
        if options.renderer_name == BLENDER_RENDERER and not (out / MANIFEST).exists():
            check_scenes(options.scenes)  # a scene that is refused later could not be left out any more
        manifest = update_manifest(out, settings, split=options.split, sequences=options.sequences)
        asked = manifest.sequences[options.split]
        shards, all_shards = _shards(out, options, options.sequences), _shards(out, options, asked)
        todo = deque(
            ShardTask(tar, numbers.start, numbers.stop, options, options.renderer_name)
            for tar, numbers in shards.items()
            if not is_finished(tar, _names(options.split, numbers))
        )
        counts = _RunCounts(options.sequences, *_count(shards, options.split), progress or (lambda _: None))
        counts.report()
        WorkerPool(workers or core_count(), on_message=counts.add).run(todo)
        finished, size = _count(all_shards, options.split)
    return GenerateReport(finished, asked, len(counts.core_s), size, counts.elapsed_s, tuple(counts.core_s))


def _shards(out: Path, options: GenerateOptions, sequences: int) -> dict[Path, range]:
    """Return the shards of a number of sequences, and which of them each holds."""
    return {
        shard_path(out, options.split, numbers.start // options.shard_size): numbers
        for numbers in shards_of(sequences, options.shard_size)
    }


def _names(split: str, numbers: range) -> set[str]:
    return {sequence_name(split, number) for number in numbers}


def _count(shards: dict[Path, range], split: str) -> tuple[int, int]:
    """Count the finished sequences and their bytes."""
    lengths = [
        entry.length
        for tar, numbers in shards.items()
        for entry in read_index(tar).entries
        if entry.name in _names(split, numbers)
    ]
    return len(lengths), sum(lengths)


class _RunCounts:
    """Counts the messages of the workers and reports progress."""

    def __init__(self, wanted: int, finished: int, size: int, progress: ProgressCallback) -> None:
        self._wanted, self._finished, self._bytes = wanted, finished, size
        self._progress = progress
        self._start = time.monotonic()
        self.core_s: list[float] = []

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self._start

    def add(self, message: Message) -> None:
        if message["what"] == "sequence":
            self._finished += 1
            self._bytes += message["bytes"]
            self.core_s.append(message["core_s"])
            self.report()
        else:
            self.report(message["text"])

    def report(self, note: str | None = None) -> None:
        made = len(self.core_s)
        core_s = sum(self.core_s, 0.0)
        self._progress(
            GenerationProgress(self._wanted, self._finished, made, self._bytes, core_s, self.elapsed_s, note)
        )
