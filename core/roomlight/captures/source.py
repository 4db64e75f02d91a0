"""Untrusted sources of a capture's files: a folder (`roomlight.files`) or a zip archive."""

import zipfile
import zlib
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from roomlight.errors import CaptureError, FrameError
from roomlight.files import MAX_FILE_BYTES, FolderSource

MAX_INDEX_BYTES: Final = 64 * 1024 * 1024
"""Largest JSON, CSV or text index: about 100,000 frames of a transforms.json."""

MAX_FRAMES: Final = 200_000
"""Longest capture: an hour at 55 frames a second; a longer index is damaged or hostile."""

_UTF8_NAMES: Final = 0x800


class ZipSource:
    """A zip archive read in place: nothing is extracted, so that member names cannot write anywhere.

    Names are relative to `prefix`, the folder that holds all members: programs that pack a folder again put it there.
    A name that is not there as written is looked for in another case; two members that fit are an error.
    """

    def __init__(self, path: Path) -> None:
        """Read the list of members. Raises CaptureError if the file is not a zip archive."""
        self.root = path
        self._archive: zipfile.ZipFile | None = None
        with self.opened() as archive:
            named = [(member_name(info), info) for info in archive.infolist() if not info.is_dir()]
        listed = {name: info for name, info in named if not _is_litter(name)}
        self.prefix = _common_folder(list(listed))
        self._members = {name[len(self.prefix) :]: info for name, info in listed.items()}
        self._folded: dict[str, list[str]] = {}
        for name in self._members:
            self._folded.setdefault(name.casefold(), []).append(name)

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
        """Whether the archive has this member. Several that fit count: reading it names them."""
        return bool(self._fitting(name))

    def names(self, folder: str = "") -> Iterator[str]:
        """Yield the names of a folder's members, or of all members."""
        prefix = f"{folder}/".casefold() if folder else ""
        yield from sorted(name for name in self._members if name.casefold().startswith(prefix))

    def _fitting(self, name: str) -> list[str]:
        return [name] if name in self._members else self._folded.get(name.casefold(), [])

    def read(self, name: str, *, max_bytes: int = MAX_FILE_BYTES) -> bytes:
        """Read a member. Raises FrameError if it is missing, empty, over `max_bytes`, or not of its declared size."""
        fitting = self._fitting(name)
        if not fitting:
            raise FrameError(f"{self.label(name)}: is not in the archive")
        if len(fitting) > 1:
            raise FrameError(f"{self.label(name)}: is there only as {' and '.join(fitting)}; rename one")
        info = self._members[fitting[0]]
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


def member_name(member: zipfile.ZipInfo) -> str:
    """Return a member's name with slashes; macOS writes names in UTF-8 without the flag that says so."""
    name = member.filename.replace("\\", "/")  # as old programs of Windows write them
    if member.flag_bits & _UTF8_NAMES:
        return name
    with suppress(UnicodeError):
        return name.encode("cp437").decode("utf-8")
    return name


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
