"""Untrusted sources of a capture's files: a folder or a zip archive.

A path out of the folder, a directory or a pipe in place of a file, or a size over the limit is refused before any byte
is read, with an error that names the file.
"""

import stat
import zipfile
import zlib
from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
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
        shown = self.label(name[:300].replace("\0", "\\0"))
        relative = Path(name.replace("\\", "/"))
        if not name or "\0" in name or relative.is_absolute():
            raise FrameError(f"{shown}: not a path inside the capture folder; paths must be relative to it")
        try:
            full = (self._resolved / relative).resolve()
            if not full.is_relative_to(self._resolved):
                raise FrameError(
                    f"{shown}: leads out of the capture folder (to {full}); "
                    "copy what it points to into the capture, or open the folder that holds both"
                )
            status = full.stat()
        except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: a loop of links before Python 3.13
            reason = getattr(error, "strerror", None) or error
            raise FrameError(f"{shown}: cannot be read ({reason})") from error
        if not stat.S_ISREG(status.st_mode):
            raise FrameError(f"{shown}: is not a regular file")
        if max_bytes is not None and status.st_size > max_bytes:
            raise FrameError(f"{shown}: holds {status.st_size} bytes; up to {max_bytes} are read")
        return full

    def has(self, name: str) -> bool:
        """Whether the folder has an entry of this name. A broken link counts, so that reading it reports an error."""
        try:
            path = self.root / name
            return path.exists() or path.is_symlink()
        except OSError:
            return False

    def names(self, folder: str = "") -> Iterator[str]:
        """Yield the names of a folder's entries, as `folder/entry`; none if the folder does not exist."""
        try:
            entries = sorted(entry.name for entry in (self.root / folder).iterdir())
        except OSError:
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
    """A zip archive read in place: nothing is extracted, so that member names cannot write anywhere."""

    def __init__(self, path: Path) -> None:
        """Read the list of members. Raises CaptureError if the file is not a zip archive."""
        self.root = path
        self._archive: zipfile.ZipFile | None = None
        with self.opened() as archive:
            self._members = {info.filename: info for info in archive.infolist() if not info.is_dir()}

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
        return f"{self.root}:{name}"

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


def read_index(source: Source, name: str) -> bytes:
    """Read a file that the whole capture depends on. Raises CaptureError instead of FrameError."""
    try:
        return source.read(name, max_bytes=MAX_INDEX_BYTES)
    except FrameError as error:
        raise CaptureError(str(error)) from error
