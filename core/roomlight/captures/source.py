"""Untrusted sources of a capture's files: a folder or a zip archive.

A path out of the folder, a directory or a pipe in place of a file, or a size over the limit is refused before any byte
is read, with an error that names the file.

Names come from other systems: a name that is not there as written is looked for with backslashes as slashes, in another
case, in another normal form of Unicode, and with percent signs decoded. Two files that fit are an error.
"""

import re
import stat
import unicodedata
import urllib.parse
import zipfile
import zlib
from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path, PurePosixPath
from typing import Final

from roomlight.errors import CaptureError, FrameError

MAX_FILE_BYTES: Final = 512 * 1024 * 1024
"""Largest image, depth map or archive member: a 48-megapixel float EXR is 576 MB raw, half of that compressed."""

MAX_INDEX_BYTES: Final = 64 * 1024 * 1024
"""Largest JSON, CSV or text index: about 100,000 frames of a transforms.json."""

MAX_FRAMES: Final = 200_000
"""Longest capture: an hour at 55 frames a second; a longer index is damaged or hostile."""


class FolderSource:
    """A folder. Names are relative to it, with forward slashes, and may not lead out of it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._resolved = root.resolve()
        self._listings: dict[Path, tuple[int, dict[str, list[str]]]] = {}

    def opened(self) -> AbstractContextManager[object]:
        """Return an empty context: a folder is not held open."""
        return nullcontext()

    def label(self, name: str) -> str:
        """Return the name as messages show it."""
        return f"{self.root}/{name}"  # not joined: an absolute name would replace the capture's

    def path(self, name: str, *, max_bytes: int | None = MAX_FILE_BYTES) -> Path:
        """Return the regular file of this name with symbolic links resolved.

        Raises:
            FrameError: There is no such file, it is outside the folder, not a regular file, or over `max_bytes`.
        """
        label = self.label(name[:300].replace("\0", "\\0"))
        if not name or "\0" in name or re.match(r"[/\\]|[A-Za-z]:[/\\]", name):
            raise FrameError(f"{label}: not a path inside the capture folder; paths must be relative to it")
        try:
            full = (self._resolved / self.actual(name)).resolve()
            if not full.is_relative_to(self._resolved):
                raise FrameError(
                    f"{label}: leads out of the capture folder (to {full}); "
                    "copy what it points to into the capture, or open the folder that holds both"
                )
            status = full.stat()
        except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: a loop of links before Python 3.13
            reason = getattr(error, "strerror", None) or error
            raise FrameError(f"{label}: cannot be read ({reason})") from error
        if not stat.S_ISREG(status.st_mode):
            raise FrameError(f"{label}: is not a regular file")
        if max_bytes is not None and status.st_size > max_bytes:
            raise FrameError(f"{label}: holds {status.st_size} bytes; up to {max_bytes} are read")
        return full

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
        """Add the existing file's suffix to a name without one (`images/0`: NeRFCapture, nerf-synthetic)."""
        try:
            if (self.root / self.actual(name)).is_file() or PurePosixPath(name).suffix.lower() in suffixes:
                return name
        except (OSError, ValueError):  # a name too long, a NUL byte; reading it says so
            return name
        return next((name + suffix for suffix in suffixes if self.has(name + suffix)), name)

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


class ZipSource:
    """A zip archive read in place: nothing is extracted, so that member names cannot write anywhere.

    Names are relative to `prefix`, the folder that holds all members: programs that pack a folder again put it there.
    """

    def __init__(self, path: Path) -> None:
        """Read the list of members. Raises CaptureError if the file is not a zip archive."""
        self.root = path
        self._archive: zipfile.ZipFile | None = None
        with self.opened() as archive:
            listed = [info for info in archive.infolist() if not info.is_dir() and not _is_litter(info.filename)]
        self.prefix = _common_folder([info.filename for info in listed])
        self._members = {info.filename[len(self.prefix) :].replace("\\", "/"): info for info in listed}

    @contextmanager
    def opened(self) -> Generator[zipfile.ZipFile]:
        """Hold the archive open for a pass: reading a list of 10,000 members takes longer than reading one."""
        try:
            archive = zipfile.ZipFile(self.root)
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError, EOFError) as error:
            raise CaptureError(f"{self.root}: is not a readable zip archive ({error}); export it again") from error
        with archive:
            self._archive = archive
            try:
                yield archive
            finally:
                self._archive = None

    def label(self, name: str) -> str:
        """Return the name as messages show it."""
        return f"{self.root}:{self.prefix}{name}"

    def has(self, name: str) -> bool:
        """Whether the archive has this member."""
        return name in self._members

    def names(self, folder: str = "") -> Iterator[str]:
        """Yield the names of a folder's members, or of all members."""
        prefix = f"{folder}/" if folder else ""
        yield from sorted(name for name in self._members if name.startswith(prefix))

    def read(self, name: str, *, max_bytes: int = MAX_FILE_BYTES) -> bytes:
        """Read a member. Raises FrameError if it is missing, empty, over `max_bytes`, or not of its declared size."""
        info = self._members.get(name)
        if info is None:
            raise FrameError(f"{self.label(name)}: is not in the archive")
        if info.file_size > max_bytes:
            raise FrameError(f"{self.label(name)}: declares {info.file_size} bytes; up to {max_bytes} are read")
        try:
            if self._archive is not None:
                with self._archive.open(info) as member:
                    data = member.read(info.file_size + 1)
            else:
                with zipfile.ZipFile(self.root) as archive, archive.open(info) as member:
                    data = member.read(info.file_size + 1)
        except (zipfile.BadZipFile, zlib.error, OSError, EOFError, ValueError, RuntimeError, KeyError) as error:
            raise FrameError(f"{self.label(name)}: does not unpack ({error})") from error
        if len(data) != info.file_size:
            raise FrameError(f"{self.label(name)}: unpacks to another size than the {info.file_size} bytes it declares")
        if not data:
            raise FrameError(f"{self.label(name)}: the member is empty")
        return data


Source = FolderSource | ZipSource


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def _is_litter(name: str) -> bool:
    """Whether a member is what macOS and Windows add to archives."""
    parts = name.split("/")
    return "__MACOSX" in parts or parts[-1] in (".DS_Store", "Thumbs.db", "desktop.ini") or parts[-1].startswith("._")


def _common_folder(names: list[str]) -> str:
    """Return the folder that holds all members, such as `2024-05-01/`; empty if they lie at the top.

    A folder that formats know by name is not taken away.
    """
    folders = {name.split("/")[0] if "/" in name else "" for name in names}
    if len(folders) != 1 or "" in folders or folders & {"rgbd", "rgb", "depth", ".."}:
        return ""
    (folder,) = folders
    return f"{folder}/"


def read_index(source: Source, name: str) -> bytes:
    """Read a file that the whole capture depends on. Raises CaptureError instead of FrameError."""
    try:
        return source.read(name, max_bytes=MAX_INDEX_BYTES)
    except FrameError as error:
        raise CaptureError(str(error)) from error
