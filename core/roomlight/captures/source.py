"""Where a capture's bytes come from: a folder or a zip archive, neither of which is trusted.

A name that leads out of the folder, a file that is none (a directory, a pipe), a size that is absurd: each
is an error that names the file, raised before its bytes are read.
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
"""Largest image, depth map or archive member read: a 48-megapixel float EXR is 576 MB raw, half that packed.
"""

MAX_INDEX_BYTES: Final = 64 * 1024 * 1024
"""Largest JSON, CSV or text index read: about 100,000 frames of a transforms.json."""

MAX_FRAMES: Final = 200_000
"""Longest capture: an hour at 55 frames a second; beyond it an index is damaged or hostile."""


class FolderSource:
    """A folder; names are relative to it, with forward slashes, and may not lead out of it."""

    def __init__(self, root: Path) -> None:
        """Nothing is read yet."""
        self.root = root
        self._resolved = root.resolve()

    def opened(self) -> AbstractContextManager[object]:
        """A folder needs no holding open."""
        return nullcontext()

    def label(self, name: str) -> str:
        """The name as messages show it."""
        return f"{self.root}/{name}"  # not joined: an absolute name would replace the capture's

    def path(self, name: str, *, max_bytes: int | None = MAX_FILE_BYTES) -> Path:
        """The regular file of this name inside the folder, symbolic links resolved; else a FrameError."""
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
        except (
            OSError,
            RuntimeError,
            ValueError,
        ) as error:  # RuntimeError: a loop of links before Python 3.13
            reason = getattr(error, "strerror", None) or error
            raise FrameError(f"{shown}: cannot be read ({reason})") from error
        if not stat.S_ISREG(status.st_mode):
            raise FrameError(f"{shown}: is not a regular file")
        if max_bytes is not None and status.st_size > max_bytes:
            raise FrameError(f"{shown}: holds {status.st_size} bytes; up to {max_bytes} are read")
        return full

    def has(self, name: str) -> bool:
        """Whether there is anything of this name (a broken link counts: it should be complained about, not
        missed).
        """
        try:
            path = self.root / name
            return path.exists() or path.is_symlink()
        except OSError:
            return False

    def names(self, folder: str = "") -> Iterator[str]:
        """Names of the entries of a folder, as `folder/entry`; nothing where there is no such folder."""
        try:
            entries = sorted(entry.name for entry in (self.root / folder).iterdir())
        except OSError:
            return
        for entry in entries:
            yield f"{folder}/{entry}" if folder else entry

    def read(self, name: str, *, max_bytes: int = MAX_FILE_BYTES) -> bytes:
        """The file's bytes; missing, empty, too large or outside the folder is a FrameError with its name."""
        path = self.path(name, max_bytes=max_bytes)
        try:
            data = path.read_bytes()
        except OSError as error:
            raise FrameError(f"{self.label(name)}: cannot be read ({error.strerror or error})") from error
        if not data:
            raise FrameError(f"{self.label(name)}: the file is empty")
        return data


class ZipSource:
    """A zip archive read in place: nothing is extracted, so that member names cannot lead anywhere."""

    def __init__(self, path: Path) -> None:
        """Read the directory of members; CaptureError if this is no zip archive."""
        self.root = path
        self._archive: zipfile.ZipFile | None = None
        with self.opened() as archive:
            self._members = {info.filename: info for info in archive.infolist() if not info.is_dir()}

    @contextmanager
    def opened(self) -> Generator[zipfile.ZipFile]:
        """Hold the archive open for a pass: its directory of 10,000 members takes longer to read than a member."""
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
        """The name as messages show it."""
        return f"{self.root}:{name}"

    def has(self, name: str) -> bool:
        """Whether the archive has this member."""
        return name in self._members

    def names(self, folder: str = "") -> Iterator[str]:
        """Names of the members of a folder."""
        prefix = f"{folder}/" if folder else ""
        yield from sorted(name for name in self._members if name.startswith(prefix))

    def read(self, name: str, *, max_bytes: int = MAX_FILE_BYTES) -> bytes:
        """The member's bytes; the declared size is checked first and the true size is held to it."""
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
        except (
            zipfile.BadZipFile,
            zlib.error,
            OSError,
            EOFError,
            ValueError,
            RuntimeError,
            KeyError,
        ) as error:
            raise FrameError(f"{self.label(name)}: does not unpack ({error})") from error
        if len(data) != info.file_size:
            raise FrameError(f"{self.label(name)}: unpacks to another size than the {info.file_size} bytes it declares")
        if not data:
            raise FrameError(f"{self.label(name)}: the member is empty")
        return data


Source = FolderSource | ZipSource


def read_index(source: Source, name: str) -> bytes:
    """`source.read` of a file without which there is no capture: a failure refuses the capture whole."""
    try:
        return source.read(name, max_bytes=MAX_INDEX_BYTES)
    except FrameError as error:
        raise CaptureError(str(error)) from error
