"""A dataset folder: `dataset.json`, which settings made it; the lock of who writes; the names of its sequences.

Sequences are numbered from 0 in each split; `sequences_per_room` in a row are walks through one room, and `shard_size`
in a row are one shard. So the number of a sequence says its name, its room and its shard, whoever makes it and when.
"""

import fcntl
import json
import os
import re
import socket
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from roomlight import __version__
from roomlight.dataset.recording import Split
from roomlight.dataset.shards import sync_folder
from roomlight.errors import DatasetError, OutputError
from roomlight.files import write_atomic

MANIFEST: Final = "dataset.json"
LOCK: Final = "dataset.lock"
FORMAT: Final = "roomlight-dataset"
VERSION: Final = 1
FRAMES: Final = 31
"""In a sequence, where nothing else is asked for."""
_RENAMED: Final = {
    "roomlight_model.dataset.room_sequences:render_room": "roomlight_generator.sequences.render:render_room"
}
"""Renderers that moved; datasets made under the old name can be continued."""


@dataclass(frozen=True)
class Settings:
    """What decides the bytes of a dataset.

    frames:     in each sequence.
    furniture:  SHA-256 of the furniture library (`digest`), None where all furniture is procedural.
    renderer:   `module:function` that makes the recordings of a room.
    generator:  RoomLight's version.
    """

    seed: int
    shard_size: int
    sequences_per_room: int
    frames: int
    furniture: str | None
    renderer: str
    generator: str = __version__


@dataclass(frozen=True)
class Manifest:
    """`dataset.json`: the settings, and how many sequences were asked for in each split."""

    settings: Settings
    sequences: dict[str, int] = field(default_factory=dict)

    def wanting(self, split: Split, sequences: int) -> "Manifest":
        """The same dataset with at least so many sequences asked for."""
        most = max(sequences, self.sequences.get(split, 0))
        return replace(self, sequences=dict(sorted({**self.sequences, split: most}.items())))

    def to_bytes(self) -> bytes:
        """The file's content."""
        values = {"format": FORMAT, "version": VERSION, **vars(self.settings), "sequences": self.sequences}
        return (json.dumps(values, indent=1) + "\n").encode()


def sequence_name(split: str, number: int) -> str:
    """`train-000012`."""
    return f"{split}-{number:06d}"


def read_manifest(folder: Path) -> Manifest:
    """`dataset.json` of a folder; DatasetError where there is none or it is not one."""
    path = folder / MANIFEST
    try:
        data = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise DatasetError(f"{folder}: is no dataset (it has no {MANIFEST}); name one that generate made") from None
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror or error})") from error
    try:
        values: dict[str, Any] = json.loads(data)
        if (values["format"], values["version"]) != (FORMAT, VERSION):
            raise DatasetError(f"{path}: is {values['format']} {values['version']}; {FORMAT} {VERSION} is read")
        settings = Settings(
            seed=int(values["seed"]),
            shard_size=int(values["shard_size"]),
            sequences_per_room=int(values["sequences_per_room"]),
            frames=int(values.get("frames", FRAMES)),
            furniture=values["furniture"],
            renderer=_RENAMED.get(values["renderer"], str(values["renderer"])),
            generator=str(values["generator"]),
        )
        return Manifest(settings, {str(split): int(count) for split, count in values["sequences"].items()})
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise DatasetError(
            f"{path}: is damaged ({type(error).__name__}: {error}); restore it from a copy, or write it by hand: it "
            "holds the settings that generate was given"
        ) from error


def begin(folder: Path, settings: Settings, *, split: Split, sequences: int) -> Manifest:
    """Make the folder a dataset of these settings, or check that it is one; call it with the lock held.

    DatasetError where it was made with other settings, naming the difference; OutputError where it cannot be written.
    """
    if (folder / MANIFEST).exists():
        old = read_manifest(folder)
        _check_equal(folder, old.settings, settings)
        manifest = old.wanting(split, sequences)
        if manifest == old:
            return old
    else:
        manifest = Manifest(settings).wanting(split, sequences)
    write_atomic(folder / MANIFEST, manifest.to_bytes())
    sync_folder(folder)
    return manifest


def prepare(folder: Path) -> None:
    """Make the folder if there is none; OutputError where it holds something that is no dataset, or is no folder."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        names = {entry.name for entry in folder.iterdir()}
    except FileExistsError:
        raise OutputError(f"{folder}: is a file; name a folder for the dataset") from None
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from error
    if MANIFEST not in names and names - {LOCK}:
        raise OutputError(
            f"{folder}: holds {min(names - {LOCK})!r} and no {MANIFEST}, so it is no dataset; "
            "choose a new or empty folder"
        )


@contextmanager
def locked(folder: Path) -> Generator[None]:
    """Be the only one who writes to the folder; OutputError that names the holder where another does.

    The system drops the lock when its holder ends, however it ends, so a file that a killed one left does not matter.
    """
    path = folder / LOCK
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.pread(handle, 200, 0).decode("utf-8", "replace").strip() or "a process that does not say which"
            raise OutputError(
                f"{folder}: {holder} is writing to this dataset; wait until it is done, stop it, "
                "or choose another folder"
            ) from None
        os.ftruncate(handle, 0)
        os.pwrite(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode(), 0)
        try:
            yield
        finally:
            os.ftruncate(handle, 0)
    finally:
        os.close(handle)


def shards_of(sequences: int, size: int) -> list[range]:
    """The numbers of the sequences in each shard of `size`."""
    return [range(first, min(first + size, sequences)) for first in range(0, sequences, size)]


def shard_files(folder: Path, split: str | None = None) -> list[Path]:
    """The shards that have an index, in order; of one split, or of all."""
    named = re.compile(rf"{split or '(train|test)'}-[0-9]{{5,}}")
    return sorted(path.with_suffix(".tar") for path in folder.glob("*.jsonl") if named.fullmatch(path.stem))


def _told(value: object) -> object:
    return "procedural alone" if value is None else value


def _check_equal(folder: Path, old: Settings, new: Settings) -> None:
    differences = [
        f"{name.replace('_', ' ')} {_told(vars(old)[name])}, not {_told(value)}"
        for name, value in vars(new).items()
        if vars(old)[name] != value
    ]
    if differences:
        raise DatasetError(
            f"{folder}: was made with {'; '.join(differences)}; give the settings it was made with, or another folder"
        )
