"""Files: written complete or not at all, and read from a folder whose names come from other systems and strangers."""

import contextlib
import json
import math
import os
import re
import stat
import unicodedata
import urllib.parse
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path, PurePosixPath
from typing import Any, Final, cast

from roomlight.errors import FrameError, OutputError

MAX_FILE_BYTES: Final = 512 * 1024 * 1024
"""Largest image, depth map or archive member: a 48-megapixel float EXR is 576 MB raw, half of that compressed."""

_ABSOLUTE: Final = re.compile(r"[/\\]|[A-Za-z]:[/\\]")


def write_atomic(path: Path, data: bytes) -> None:
    """Write bytes under a temporary name, then rename: a reader never sees half a file. Makes missing folders.

    Raises:
        OutputError: the file cannot be written.
    """
    temporary = temporary_beside(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):  # the temporary file may not exist
            temporary.unlink()
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error


def move_folder(partial: Path, out: Path, *, last: str) -> None:
    """Rename a finished folder to `out`; into an empty folder, where a shell may be, its entries are moved.

    Args:
        partial: The folder.
        out: Absent or an empty folder.
        last: The entry without which a reader takes `out` for unfinished.

    Raises:
        OSError: An entry cannot be moved.
    """
    if not out.exists():
        partial.replace(out)
        return
    for entry in sorted(partial.iterdir(), key=lambda entry: entry.name == last):
        entry.replace(out / entry.name)
    partial.rmdir()


def check_writable(path: Path) -> None:
    """Check before long work that a file can be written, missing folders included; leaves nothing behind.

    Raises:
        OutputError: it cannot.
    """
    missing: list[Path] = []
    tried = temporary_beside(path, ".test")  # as long as temporary names are
    try:
        if path.parent.exists() and not path.parent.is_dir():
            raise OutputError(f"{path.parent}: is a file; the output needs a folder")
        if path.is_dir():
            raise OutputError(f"{path}: is a folder; the output needs the name of a file")
        missing.extend(folder for folder in path.absolute().parents if not folder.exists())
        path.parent.mkdir(parents=True, exist_ok=True)
        tried.touch()
        tried.unlink()
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        for folder in missing:
            with contextlib.suppress(OSError):  # it may not have been made
                folder.rmdir()


def remove_outputs(out: Path, files: Iterable[str], *, folders: str | None = None) -> None:
    """Remove what an earlier run left in a folder: files of these patterns, then folders of one that are empty.

    Raises:
        OutputError: one cannot be removed.
    """
    try:
        for pattern in files:
            for file in out.glob(pattern):
                file.unlink()
        for folder in out.glob(folders) if folders else ():
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
    except OSError as error:
        raise OutputError(f"{out}: cannot be used for output ({error.strerror or error})") from error


def write_durable(path: Path, data: bytes) -> None:
    """Write bytes that survive a loss of power, readable by this user only (0600); otherwise as `write_atomic`.

    The folder must exist.

    Raises:
        OutputError: the file cannot be written; a file that was there is unchanged.
    """
    temporary = temporary_beside(path)
    try:
        temporary.unlink(missing_ok=True)
        with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):  # the temporary file may not exist
            temporary.unlink()
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error


def temporary_beside(path: Path, ending: str = ".part") -> Path:
    """Return the name of a temporary file or folder beside a path. Raises OutputError where the path names nothing."""
    if not path.name:
        raise OutputError(f"{str(path)!r} names no file to write")
    return path.with_name(f".{path.name}{ending}")


def sync_folder(folder: Path) -> None:
    """Write a folder's list of names to the disk; does nothing on Windows, which cannot."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_json(path: Path, values: Any) -> None:
    """Write `json_text`, indented, as `write_atomic` does.

    Raises:
        OutputError: the file cannot be written.
    """
    write_atomic(path, (json_text(values, indent=1) + "\n").encode())


def json_text(values: Any, *, indent: int | None = None) -> str:
    """Return plain values and arrays as JSON; NaN and infinity, which JSON does not have, become null."""
    return json.dumps(_finite(values), indent=indent, allow_nan=False)


def _finite(values: Any) -> Any:
    if isinstance(values, Mapping):
        return {key: _finite(value) for key, value in cast(Mapping[str, Any], values).items()}
    if hasattr(values, "tolist"):  # of NumPy, which this module does not import: help takes no time
        return _finite(values.tolist())
    if isinstance(values, list | tuple):
        return [_finite(value) for value in cast(Iterable[Any], values)]
    return None if isinstance(values, float) and not math.isfinite(values) else values


class FolderSource:
    """A folder to read from. Names are relative to it, with forward slashes.

    A path or a link out of the folder, a directory or a pipe in place of a file, or a size over the limit is refused
    before any byte is read, with an error that names the file. Folders in it that are links are followed with
    `follow_folders`; the server's uploads and unpacked zips have none. A name that is not there as written is looked
    for with backslashes as slashes, in another case, in another normal form of Unicode, and with percent signs decoded.
    Two files that fit are an error.
    """

    def __init__(self, root: Path, *, follow_folders: bool = True) -> None:
        self.root, self._follows = root, follow_folders
        self._resolved = root.resolve()
        self._listings: dict[Path, tuple[int, dict[str, list[str]]]] = {}

    def opened(self) -> AbstractContextManager[object]:
        """Return an empty context: a folder is not held open."""
        return nullcontext()

    def label(self, name: str) -> str:
        """Return the name as messages show it."""
        return f"{self.root}/{name}"  # not joined: an absolute name would replace the folder's

    def path(self, name: str, *, max_bytes: int | None = MAX_FILE_BYTES) -> Path:
        """Return the regular file of this name with symbolic links resolved.

        Raises:
            FrameError: There is no such file, it is outside the folder, not a regular file, or over `max_bytes`.
        """
        label = self.label(name[:300].replace("\0", "\\0"))
        if not name or "\0" in name or _ABSOLUTE.match(name):
            raise FrameError(f"{label}: not a path inside the folder; paths must be relative to it")
        try:
            path = self._resolved / self.actual(name)
            full = path.resolve()
            is_followed = self._follows and ".." not in path.parts and full.is_relative_to(path.parent.resolve())
            if not is_followed and not full.is_relative_to(self._resolved):
                raise FrameError(f"{label}: leads out of the folder (to {full}); copy what it points to into it")
            status = full.stat()
        except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: a loop of links before Python 3.13
            reason = getattr(error, "strerror", None) or error
            raise FrameError(f"{label}: cannot be read ({reason})") from error
        if not stat.S_ISREG(status.st_mode):
            raise FrameError(f"{label}: is not a regular file")
        if max_bytes is not None and status.st_size > max_bytes:
            raise FrameError(f"{label}: holds {status.st_size} bytes; up to {max_bytes} are read")
        return full

    def within(self, name: str) -> str:
        """Return an absolute path (or `file://` URL) as a name in the folder, if it is inside or an end of it is there.

        The longest end counts. Relative names, and those of which no end is there, come back unchanged.
        """
        name = name.removeprefix("file://")
        if not _ABSOLUTE.match(name):
            return name
        path = PurePosixPath(name.replace("\\", "/"))
        for root in (self.root.absolute(), self._resolved):
            if path.is_relative_to(root.as_posix()) and ".." not in path.parts:
                return str(path.relative_to(root.as_posix()))
        ends = ("/".join(path.parts[at:]) for at in range(1, len(path.parts)))
        return next((end for end in ends if ".." not in path.parts and self.has(end)), name)

    def has(self, name: str) -> bool:
        """Whether the folder has an entry of this name. A broken link counts, so that reading it reports an error."""
        try:
            path = self.root / self.actual(name)
            return path.exists() or path.is_symlink()
        except FrameError:  # several files fit; reading it names them
            return True
        except (OSError, ValueError):
            return False

    def with_suffix(self, name: str, suffixes: tuple[str, ...]) -> str:
        """Add the existing file's suffix to a name without one (`images/0`: NeRFCapture, nerf-synthetic).

        Raises:
            FrameError: Several files fit.
        """
        try:
            if (self.root / self.actual(name)).is_file() or PurePosixPath(name).suffix.lower() in suffixes:
                return name
        except (OSError, ValueError):  # a name too long, a NUL byte; reading it says so
            return name
        fitting = [name + suffix for suffix in suffixes if self.has(name + suffix)]
        if len(fitting) > 1:
            listed = " and ".join(PurePosixPath(entry).name for entry in fitting)
            raise FrameError(f"{self.label(name)}: is there as {listed}; name one of them, or remove the others")
        return fitting[0] if fitting else name

    def actual(self, name: str) -> str:
        """Return the name as the folder spells it; `name` with forward slashes if there is nothing like it.

        Raises:
            FrameError: It is spelled otherwise, and several files fit.
        """
        name = name.replace("\\", "/")
        for spelled in dict.fromkeys((name, urllib.parse.unquote(name))):
            try:
                path = self.root / spelled
                if path.exists() or path.is_symlink():
                    return spelled
            except (OSError, ValueError):
                return name
        for spelled in dict.fromkeys((name, urllib.parse.unquote(name))):
            respelled = self._respelled(spelled)
            if respelled is not None:
                return respelled
        return name

    def _respelled(self, name: str) -> str | None:
        """Walk down the folder, each part in any case and normal form."""
        parts: list[str] = []
        for part in PurePosixPath(name).parts:
            folder = self.root.joinpath(*parts)
            if part == ".." or (folder / part).exists():
                parts.append(part)
                continue
            matches = self._listing(folder).get(_folded(part), [])
            if len(matches) > 1:
                raise FrameError(f"{self.label(name)}: is there only as {' and '.join(sorted(matches))}; rename one")
            if not matches:
                return None
            parts.append(matches[0])
        return "/".join(parts)

    def _listing(self, folder: Path) -> dict[str, list[str]]:
        """Return the folder's names by their folded form, listed anew when the folder has changed."""
        try:
            changed = folder.stat().st_mtime_ns
            if self._listings.get(folder, (None,))[0] != changed:
                names: dict[str, list[str]] = {}
                for entry in folder.iterdir():
                    names.setdefault(_folded(entry.name), []).append(entry.name)
                self._listings[folder] = changed, names
            return self._listings[folder][1]
        except OSError:
            return {}

    def names(self, folder: str = "") -> Iterator[str]:
        """Yield the names of a folder's entries, as `folder/entry`; none if the folder does not exist."""
        try:
            folder = self.actual(folder) if folder else folder
            entries = sorted(entry.name for entry in (self.root / folder).iterdir())
        except (OSError, FrameError):
            return
        for entry in entries:
            yield f"{folder}/{entry}" if folder else entry

    def holds_files(self, folder: str) -> bool:
        """Whether a folder or one below it has a file that is not hidden (`.DS_Store`).

        A folder that cannot be read counts, so that reading a file of it reports an error.
        """
        try:
            path = self.root / self.actual(folder)
        except FrameError:  # several folders fit
            return True
        walk = os.walk(path, followlinks=self._follows)
        is_filled = any(name[0] != "." for _, _, names in walk for name in names)
        return is_filled or (self.has(folder) and not os.access(path, os.R_OK))

    def read(self, name: str, *, max_bytes: int = MAX_FILE_BYTES) -> bytes:
        """Read a file. Raises FrameError if it is missing, empty, too large or outside the folder."""
        path = self.path(name, max_bytes=max_bytes)
        try:
            data = path.read_bytes()
        except OSError as error:
            raise FrameError(f"{self.label(name)}: cannot be read ({error.strerror or error})") from error
        if not data:
            raise FrameError(f"{self.label(name)}: the file is empty")
        return data


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()
