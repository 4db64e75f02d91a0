"""Shards: `train-00000.tar` holds sequences one after the other, and `train-00000.jsonl` lists the finished ones.

A line of the index is one finished sequence: its name, offset and length, the SHA-256 of its bytes, and a checksum of
the line itself. The bytes are written and synced before the line, so that a sequence exists if and only if its line is
valid and its bytes have the line's checksum. Data that a killed process or a full disk leaves at the end of either file
belongs to no sequence; the next `ShardWriter` truncates it.
"""

import fcntl
import hashlib
import json
import os
import zlib
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from roomlight.dataset.archive import end_of_archive
from roomlight.errors import DatasetError, OutputError
from roomlight.files import sync_folder, temporary_beside


@dataclass(frozen=True)
class Entry:
    """A finished sequence: `length` bytes of the shard from `offset` on, with the SHA-256 `sha256` (hexadecimal)."""

    name: str
    offset: int
    length: int
    sha256: str

    @property
    def end(self) -> int:
        """Offset of the first byte after the sequence."""
        return self.offset + self.length

    def line(self) -> bytes:
        """Return the entry's line of the index; `check` is the CRC-32 of the line without `check`."""
        plain = json.dumps({"name": self.name, "offset": self.offset, "length": self.length, "sha256": self.sha256})
        return f'{plain[:-1]}, "check": "{zlib.crc32(plain.encode()):08x}"}}\n'.encode()


@dataclass(frozen=True)
class ShardIndex:
    """The content of an index file.

    Attributes:
        entries: The finished sequences, in the order of their offsets.
        damaged: Numbers (from 1) of invalid lines that valid lines follow; a killed process does not leave these.
        size: Bytes of the file up to the end of the last valid line; the rest was never finished.
    """

    entries: tuple[Entry, ...]
    damaged: tuple[int, ...]
    size: int


def shard_path(folder: Path, split: str, number: int) -> Path:
    """Return the path of a shard's tar file."""
    return folder / f"{split}-{number:05d}.tar"


def index_path(tar: Path) -> Path:
    """Return the path of a shard's index."""
    return tar.with_suffix(".jsonl")


def remedy(tar: Path) -> str:
    """Return the part of an error message that says how to repair a damaged shard."""
    return (
        f"`roomlight dataset verify {tar.parent} --repair` removes damaged sequences, and generating again with the "
        f"same settings replaces them (or delete {tar.name} and {index_path(tar).name})"
    )


def read_index(tar: Path) -> ShardIndex:
    """Read the index of a shard; it is empty if the file does not exist. Raises DatasetError if it is unreadable."""
    path = index_path(tar)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return ShardIndex((), (), 0)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror or error})") from error
    entries: list[Entry] = []
    bad: list[int] = []
    at = size = 0
    damaged: tuple[int, ...] = ()
    for number, line in enumerate(data.split(b"\n")[:-1], 1):
        at += len(line) + 1
        entry = _parse(line + b"\n")
        if entry is None or (entries and entry.offset < entries[-1].end):
            bad.append(number)
            continue
        entries.append(entry)
        size, damaged = at, tuple(bad)
    return ShardIndex(tuple(entries), damaged, size)


def _parse(line: bytes) -> Entry | None:
    """Parse a line; None unless it is byte for byte the line of an entry."""
    try:
        values: Any = json.loads(line)
        entry = Entry(values["name"], values["offset"], values["length"], values["sha256"])
        return entry if entry.line() == line else None
    except (ValueError, TypeError, KeyError):
        return None


def read_packed(tar: Path, entry: Entry) -> bytes:
    """Read a sequence's bytes and compare their checksum.

    Raises:
        DatasetError: The bytes cannot be read or do not match; the message names shard, sequence and remedy.
    """
    try:
        with tar.open("rb") as file:
            packed = os.pread(file.fileno(), entry.length, entry.offset)
    except OSError as error:
        raise DatasetError(
            f"{tar}: sequence {entry.name} cannot be read ({error.strerror or error}); {remedy(tar)}"
        ) from error
    if len(packed) < entry.length:
        raise DatasetError(f"{tar}: ends inside sequence {entry.name}, finished by its index; {remedy(tar)}")
    if hashlib.sha256(packed).hexdigest() != entry.sha256:
        raise DatasetError(f"{tar}: sequence {entry.name} has another checksum than its index states; {remedy(tar)}")
    return packed


def replace_index(tar: Path, entries: Sequence[Entry]) -> None:
    """Replace a shard's index, atomically. Raises OutputError."""
    path = index_path(tar)
    partial = temporary_beside(path)
    with _writing(path):
        with partial.open("wb") as file:
            file.writelines(entry.line() for entry in entries)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        sync_folder(path.parent)


def is_finished(tar: Path, names: set[str]) -> bool:
    """Return whether the shard has all of these sequences and its end-of-archive mark, without reading the bytes."""
    index = read_index(tar)
    if index.damaged or not names <= {entry.name for entry in index.entries}:
        return False
    end = max((entry.end for entry in index.entries), default=0)
    try:
        return tar.stat().st_size == end + len(end_of_archive(end)) and index.size == index_path(tar).stat().st_size
    except OSError:
        return False


class ShardWriter:
    """Appends sequences to one shard, for one process at a time; use it in a `with` statement.

    Opening restores the shard's last consistent state: an unfinished end of tar or index is truncated, and finished
    sequences are read and checked.
    """

    def __init__(self, tar: Path) -> None:
        """Open the shard; waits for another process that has it open, such as a worker whose parent was just killed.

        Raises:
            DatasetError: A sequence that others follow is damaged.
            OutputError: The files cannot be written.
        """
        self.path = tar
        with ExitStack() as opened:
            self._tar = _open(tar, os.O_RDWR | os.O_CREAT)
            opened.callback(os.close, self._tar)
            fcntl.flock(self._tar, fcntl.LOCK_EX)
            self._index = _open(index_path(tar), os.O_RDWR | os.O_CREAT | os.O_APPEND)
            opened.callback(os.close, self._index)
            self.entries = self._whole_entries(read_index(tar))
            self._end = self.entries[-1].end if self.entries else 0
            with _writing(tar):
                self._cut()
                sync_folder(tar.parent)
            self._opened = opened.pop_all()

    def __enter__(self) -> "ShardWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    @property
    def names(self) -> set[str]:
        """The names of the shard's sequences."""
        return {entry.name for entry in self.entries}

    def append(self, name: str, packed: bytes) -> Entry:
        """Append a sequence; it is on the disk when this returns. Raises OutputError."""
        entry = Entry(name, self._end, len(packed), hashlib.sha256(packed).hexdigest())
        try:
            with _writing(self.path):
                _write_all(self._tar, packed, self._end)
                os.fsync(self._tar)
            with _writing(index_path(self.path)):
                _append_all(self._index, entry.line())
                os.fsync(self._index)
        except OutputError:
            with suppress(OSError):  # free the space; otherwise the next writer does
                self._cut()
            raise
        self.entries.append(entry)
        self._end = entry.end
        return entry

    def finish(self) -> None:
        """Write the end-of-archive mark; a later writer removes it to continue. Raises OutputError."""
        with _writing(self.path):
            _write_all(self._tar, end_of_archive(self._end), self._end)
            os.fsync(self._tar)

    def _cut(self) -> None:
        """Truncate both files after the finished sequences; the index first, as no line may refer to missing bytes."""
        os.ftruncate(self._index, sum(len(entry.line()) for entry in self.entries))
        os.fsync(self._index)
        os.ftruncate(self._tar, self._end)
        os.fsync(self._tar)

    def _whole_entries(self, index: ShardIndex) -> list[Entry]:
        """Return the valid sequences. Invalid ones at the end were never finished (a disk that lost a sync)."""
        if index.damaged:
            raise DatasetError(f"{index_path(self.path)}: line {index.damaged[0]} is damaged; {remedy(self.path)}")
        entries = list(index.entries)
        problems = [_problem(self.path, entry) for entry in entries]
        while problems and problems[-1] is not None:
            entries.pop()
            problems.pop()
        for problem in problems:
            if problem is not None:
                raise problem
        return entries


def _problem(tar: Path, entry: Entry) -> DatasetError | None:
    try:
        read_packed(tar, entry)
    except DatasetError as error:
        return error
    return None


def _open(path: Path, flags: int) -> int:
    with _writing(path):
        return os.open(path, flags, 0o644)


def _write_all(handle: int, data: bytes, offset: int) -> None:
    view = memoryview(data)
    while view:
        written = os.pwrite(handle, view, offset)
        view, offset = view[written:], offset + written


def _append_all(handle: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(handle, view) :]


@contextmanager
def _writing(path: Path) -> Generator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror or error}); finished sequences are kept, "
            "and the same command continues from there"
        ) from error
