"""The folder of one saved session.

    state                     values, engine state, last message; replaced as a whole (`roomlight.engine.state.records`)
    12-0f3a…9c.frame          message of the keyframe 12, as it came; the name has 16 digits of its SHA-256
    40-77b2…01.pixels         pixels of the keyframe 40

Files of keyframes are written once, before the state that names them. Everything here blocks: it runs on threads.
"""

import contextlib
import hashlib
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pydantic import ValidationError

from roomlight.engine.state.encoding import SavedSession, records_of_snapshot, session_of_records
from roomlight.engine.state.kept_frames import base_arrays, base_of, base_values
from roomlight.engine.state.records import Record, array_records, arrays_of, pack_records, unpack_records
from roomlight.engine.state.snapshot import KeptFrame
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.errors import OutputError, StateError, WireError
from roomlight.files import write_durable
from roomlight.wire.frame_message import UNLIMITED, FrameMessage, parse
from roomlight_server.state.journal import MAX_MESSAGE_BYTES, body_of
from roomlight_server.state.live_state import LiveState, SavedBase, SavedValues

STATE: Final = "state"


@dataclass(frozen=True)
class Reading:
    """A saved session that was read: all checksums are right, no image is decoded yet.

    Attributes:
        values: of the server.
        session: of the engine.
        messages: messages of kept frames and of the last frame, by index.
        pixels: kept frames that are stored as pixels, by index.
    """

    values: SavedValues
    session: SavedSession
    messages: dict[int, FrameMessage]
    pixels: dict[int, FrameMesh]


def write_session(
    folder: Path, live: LiveState, messages: dict[int, bytes], bases: dict[int, SavedBase]
) -> tuple[dict[int, SavedBase], int]:
    """Write a session: new files of keyframes, then the state, then remove files that are no longer named.

    Args:
        folder: Folder of the session; made if it is missing.
        messages: Messages of keyframes that are not on disk yet.
        bases: Files of keyframes that are on disk.

    Returns:
        The files of keyframes that the state names, and all bytes of the session on disk.

    Raises:
        OSError: The folder cannot be made.
        OutputError: A file cannot be written; the state that was there is unchanged.
    """
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.is_symlink():
        raise OutputError(f"{folder}: is a link; remove it, so that the session is saved in the state directory")
    named = {kept.index: _base(folder, kept, messages, bases) for kept in live.snapshot.keyframes}
    latest, records, elsewhere = None, list[Record](), set(named)
    if live.latest is not None:
        index, body = live.latest.index, body_of(live.latest.message)
        if index in named and named[index].kind == "message":
            latest = index
        elif len(body) <= MAX_MESSAGE_BYTES:
            latest, records = index, [Record("LAST", {"index": index}, body)]
            if live.snapshot.latest is not None and live.latest.message.depth is not None:
                elsewhere.add(index)
    values = live.values.model_copy(update={"bases": named, "latest": latest})
    head = Record("SERV", values.model_dump(mode="json"))
    file = pack_records([head, *records_of_snapshot(live.snapshot, elsewhere=elsewhere), *records])
    write_durable(folder / STATE, file)
    return named, len(file) + _tidy(folder, {base.file for base in named.values()})


def _base(folder: Path, kept: KeptFrame, messages: dict[int, bytes], bases: dict[int, SavedBase]) -> SavedBase:
    """Return the file of a keyframe; write it if it is not on disk yet."""
    on_disk = bases.get(kept.index)
    if on_disk is not None and (folder / on_disk.file).exists():
        return on_disk
    if kept.index in messages:
        data, kind, suffix = messages[kept.index], "message", "frame"
    else:
        data = pack_records([Record("BASE", base_values(kept.mesh)), *array_records(base_arrays(kept))])
        kind, suffix = "pixels", "pixels"
    digest = hashlib.sha256(data).hexdigest()
    base = SavedBase(file=f"{kept.index}-{digest[:16]}.{suffix}", sha256=digest, kind=kind)
    write_durable(folder / base.file, data)
    return base


def _tidy(folder: Path, named: set[str]) -> int:
    """Remove files that the state does not name, and return the bytes of those that it names."""
    size = 0
    for path in folder.iterdir():
        if path.name in named:
            size += path.stat().st_size
        elif path.name != STATE:
            path.unlink(missing_ok=True)
    return size


def read_session(folder: Path, owner: str, name: str) -> Reading:
    """Read a session and check every checksum.

    Raises:
        OSError: A file cannot be read.
        StateError: A file is damaged, missing, of another version, or belongs to another session.
    """
    source = f"saved state of session {name}"
    if folder.is_symlink():
        raise StateError(f"{source}: its folder is a link, which is not followed")
    try:
        return _read(folder, owner, name, source)
    except (KeyError, ValueError, IndexError, TypeError, WireError) as error:
        raise StateError(f"{source}: its values do not fit each other ({error!r})") from error


def _read(folder: Path, owner: str, name: str, source: str) -> Reading:
    records = unpack_records((folder / STATE).read_bytes(), source)
    try:
        values = SavedValues.model_validate(next(record.values for record in records if record.tag == "SERV"))
    except (StopIteration, ValidationError) as error:
        raise StateError(f"{source}: its values are invalid ({type(error).__name__})") from error
    if (values.owner, values.name) != (owner, name):
        raise StateError(f"{source}: belongs to another session or owner")
    session = session_of_records(records, source)
    messages: dict[int, FrameMessage] = {}
    pixels: dict[int, FrameMesh] = {}
    for index, base in values.bases.items():
        data = _checked(folder / base.file, base.sha256, f"{source}: file {base.file}")
        if base.kind == "message":
            messages[index] = parse(data, UNLIMITED)
        else:
            pixels[index] = _pixels(data, f"{source}: file {base.file}")
    for record in records:
        if record.tag == "LAST":
            messages[record.values["index"]] = parse(record.data, UNLIMITED)
    return Reading(values, session, messages, pixels)


def _checked(path: Path, digest: str, source: str) -> bytes:
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise StateError(f"{source}: is missing") from error
    if hashlib.sha256(data).hexdigest() != digest:
        raise StateError(f"{source}: is damaged (its checksum differs)")
    return data


def _pixels(data: bytes, source: str) -> FrameMesh:
    records = unpack_records(data, source)
    return base_of(records[0].values, arrays_of(records, source))


def session_folders(root: Path) -> list[Path]:
    """Return the folders of all saved sessions; links are not followed. Empty if the directory cannot be read."""
    with contextlib.suppress(OSError):
        return [folder for folder in root.iterdir() if folder.is_dir() and not folder.is_symlink()]
    return []


def erase(folder: Path) -> None:
    """Remove a session from the disk; the state first, so that half of a session is never restored.

    Raises:
        OSError: A file cannot be removed.
    """
    if folder.is_symlink():  # what it leads to is not ours
        folder.unlink(missing_ok=True)
        return
    (folder / STATE).unlink(missing_ok=True)
    with contextlib.suppress(FileNotFoundError):
        shutil.rmtree(folder)
