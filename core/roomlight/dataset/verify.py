"""Find damaged sequences by their checksums, and remove them so that the generator replaces them."""

import os
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from roomlight.dataset.archive import filler
from roomlight.dataset.folder import locked, read_manifest, shard_files
from roomlight.dataset.shards import Entry, index_path, read_index, read_packed, replace_index
from roomlight.errors import DatasetError, OutputError


@dataclass(frozen=True)
class VerifyReport:
    """The result of `verify`.

    Attributes:
        whole: Number of sequences that have their checksum.
        bytes: Their size.
        damaged: One message for each damaged sequence or index line.
        missing: Number of sequences that `dataset.json` asks for and no index has.
    """

    whole: int
    bytes: int
    damaged: tuple[str, ...]
    missing: int


def verify(folder: Path, *, repair: bool = False, progress: Callable[[int, int], None] | None = None) -> VerifyReport:
    """Read every sequence and compare its checksum; `progress` receives (done, total) sequences.

    `repair` removes damaged sequences: their lines leave the index, their bytes become a tar member named
    `.damaged-...`, and the shard counts as unfinished.

    Raises:
        DatasetError: The folder is not a dataset.
        OutputError: A shard cannot be repaired, or another process is writing to the dataset.
    """
    requested = sum(read_manifest(folder).sequences.values())
    with locked(folder) if repair else nullcontext():
        return _verify(folder, requested, repair, progress)


def _verify(folder: Path, requested: int, repair: bool, progress: Callable[[int, int], None] | None) -> VerifyReport:
    shards = [(tar, read_index(tar)) for tar in shard_files(folder)]
    total = sum(len(index.entries) for _, index in shards)
    whole = done = size = 0
    damaged: list[str] = []
    for tar, index in shards:
        good: list[Entry] = []
        for entry in index.entries:
            try:
                read_packed(tar, entry)
            except DatasetError as error:
                damaged.append(str(error))
            else:
                good.append(entry)
                size += entry.length
            done += 1
            if progress:
                progress(done, total)
        damaged += [f"{index_path(tar)}: line {number} is damaged" for number in index.damaged]
        if repair and (index.damaged or len(good) < len(index.entries)):
            _repair(tar, good)
        whole += len(good)
    lines = total + sum(len(index.damaged) for _, index in shards)
    return VerifyReport(whole, size, tuple(damaged), max(0, requested - lines))


def _repair(tar: Path, good: list[Entry]) -> None:
    """Write the index first: after that the damaged bytes belong to no sequence."""
    replace_index(tar, good)
    try:
        handle = os.open(tar, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            at = 0
            for entry in good:
                if entry.offset > at:
                    os.pwrite(handle, filler(f".damaged-{tar.stem}-{at}", entry.offset - at), at)
                at = entry.end
            os.ftruncate(handle, at)
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError as error:
        raise OutputError(f"{tar}: cannot be written ({error.strerror or error})") from error
