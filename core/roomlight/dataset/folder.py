"""A dataset folder: its manifest `dataset.json`, the lock of the process that writes, and the names of its files.

Sequences are numbered from 0 in each split. `sequences_per_room` consecutive sequences are walks through one room, and
`shard_size` consecutive sequences are one shard. The number of a sequence therefore determines its name, its room and
its shard, whichever process generates it.
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

from pydantic import TypeAdapter, ValidationError

from roomlight import __version__
from roomlight.dataset.recording import Split
from roomlight.errors import DatasetError, OutputError
from roomlight.files import sync_folder, write_atomic

MANIFEST: Final = "dataset.json"
LOCK: Final = "dataset.lock"
FORMAT: Final = "roomlight-dataset"
VERSION: Final = 1
FRAMES: Final = 31
"""Default number of frames in a sequence."""
GENERATOR: Final = f"{__version__}+6"
"""RoomLight's version and the generator's: the latter rises when the same seed gives other rooms, so that a dataset is
not continued with them. 2: flat colours, and furniture of the library. 4: lamps with sharp edges.
5: mirrors and coats without bias. 6: probes see all of the sun; coats in rooms lit by panoramas as in others."""


@dataclass(frozen=True)
class DatasetSettings:
    """The settings that determine the bytes of a dataset.

    Attributes:
        seed: Seed of all rooms.
        shard_size: Sequences in a shard.
        sequences_per_room: Camera walks through each room.
        frames: Frames in a sequence.
        furniture: SHA-256 of the furniture library (`digest`); None without one.
        renderer: `module:function` that renders the recordings of a room.
        generator: `GENERATOR`.
        panoramas: SHA-256 of the folder of panoramas that light the rooms; None for generated light.
        furniture_share: Share of the rooms lit by panoramas that have furniture; None for generated light.
        scenes: Names of the Blender files of the rooms, and the start of their SHA-256; None for rooms of our own.
        samples: Paths a pixel of frames of Blender files; None for rooms of our own.
    """

    seed: int
    shard_size: int
    sequences_per_room: int
    frames: int
    furniture: str | None
    renderer: str
    generator: str
    panoramas: str | None = None
    furniture_share: float | None = None
    scenes: str | None = None
    samples: int | None = None


@dataclass(frozen=True)
class Manifest:
    """`dataset.json`: the settings, and the number of requested sequences of each split."""

    settings: DatasetSettings
    sequences: dict[str, int] = field(default_factory=dict)

    def with_sequences(self, split: Split, sequences: int) -> "Manifest":
        """Return the manifest with at least this many sequences requested for a split."""
        most = max(sequences, self.sequences.get(split, 0))
        return replace(self, sequences=dict(sorted({**self.sequences, split: most}.items())))

    def to_bytes(self) -> bytes:
        """Return the content of `dataset.json`."""
        values = {"format": FORMAT, "version": VERSION, **vars(self.settings), "sequences": self.sequences}
        return (json.dumps(values, indent=1) + "\n").encode()


def sequence_name(split: str, number: int) -> str:
    """Return the name of a sequence, such as `train-000012`."""
    return f"{split}-{number:06d}"


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a dataset folder.

    Raises:
        DatasetError: The folder has no manifest, or the manifest is damaged or of another version.
    """
    path = folder / MANIFEST
    try:
        data = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise DatasetError(f"{folder}: is not a dataset: it has no {MANIFEST}; give a generated folder") from None
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror or error})") from error
    try:
        values: dict[str, Any] = json.loads(data)
        if (values["format"], values["version"]) != (FORMAT, VERSION):
            raise DatasetError(f"{path}: is {values['format']} {values['version']}; {FORMAT} {VERSION} is read")
        return TypeAdapter(Manifest).validate_python({"settings": values, "sequences": values["sequences"]})
    except (ValueError, TypeError, KeyError) as error:
        first = error.errors(include_url=False)[0] if isinstance(error, ValidationError) else None
        reason = f"{first['loc'][-1]}: {first['msg']}" if first else f"{type(error).__name__}: {error}"
        raise DatasetError(
            f"{path}: is damaged ({reason}); restore it from a copy, or write it by hand from the settings of the "
            "generate command"
        ) from error


def update_manifest(folder: Path, settings: DatasetSettings, *, split: Split, sequences: int) -> Manifest:
    """Write the folder's manifest, or check that it has these settings; call it with the lock held.

    Raises:
        DatasetError: The dataset was generated with other settings; the message names the differences.
        OutputError: The manifest cannot be written.
    """
    if (folder / MANIFEST).exists():
        old = read_manifest(folder)
        _check_equal(folder, old.settings, settings)
        manifest = old.with_sequences(split, sequences)
        if manifest == old:
            return old
    else:
        manifest = Manifest(settings).with_sequences(split, sequences)
    write_atomic(folder / MANIFEST, manifest.to_bytes())
    sync_folder(folder)
    return manifest


def create_folder(folder: Path) -> None:
    """Create the folder if it does not exist.

    Raises:
        OutputError: The path is a file, holds files but no manifest, or cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        names = {entry.name for entry in folder.iterdir()}
    except FileExistsError:
        raise OutputError(f"{folder}: is a file; give a folder for the dataset") from None
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from error
    if MANIFEST not in names and names - {LOCK}:
        raise OutputError(
            f"{folder}: holds {min(names - {LOCK})!r} but no {MANIFEST}, so it is not a dataset; "
            "choose a new or empty folder"
        )


@contextmanager
def locked(folder: Path, name: str = LOCK) -> Generator[None]:
    """Hold the folder's lock, a file of this name, so that no other process writes to it; a missing folder is made.

    The system releases the lock when the process ends, even if it is killed; the lock file that remains has no effect.

    Raises:
        OutputError: Another process holds the lock; the message names it.
    """
    path = folder / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.pread(handle, 200, 0).decode("utf-8", "replace").strip() or "another process"
            raise OutputError(
                f"{folder}: {holder} is writing to this folder; wait until it is done, stop it, "
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
    """Return the numbers of the sequences in each shard of `size` sequences."""
    return [range(first, min(first + size, sequences)) for first in range(0, sequences, size)]


def shard_files(folder: Path, split: str | None = None) -> list[Path]:
    """Return the shards that have an index, in order, of one split or of all."""
    named = re.compile(rf"{split or '(train|test)'}-[0-9]{{5,}}")
    return sorted(path.with_suffix(".tar") for path in folder.glob("*.jsonl") if named.fullmatch(path.stem))


def _value_text(value: object) -> object:
    return "none" if value is None else value


def _check_equal(folder: Path, old: DatasetSettings, new: DatasetSettings) -> None:
    differences = [
        f"{name.replace('_', ' ')} {_value_text(vars(old)[name])}, not {_value_text(value)}"
        for name, value in vars(new).items()
        if vars(old)[name] != value
    ]
    if differences:
        raise DatasetError(
            f"{folder}: was generated with {'; '.join(differences)}; use the same settings, or another folder"
        )
