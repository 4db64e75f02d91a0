"""Choose the reader of a capture: by the files in its folder, or by `CaptureOptions.format`."""

import shutil
import tempfile
import weakref
import zipfile
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Final

from roomlight.captures.bare_video import BareVideoReader
from roomlight.captures.capture import Capture, Preparing, RawFrame, Reader, ReadRecord
from roomlight.captures.formats import native, nerfstudio
from roomlight.captures.formats.arkit_scenes import ArkitScenesReader
from roomlight.captures.formats.colmap import ColmapReader
from roomlight.captures.formats.native import NativeReader
from roomlight.captures.formats.nerfstudio import NerfstudioReader
from roomlight.captures.formats.polycam import PolycamReader
from roomlight.captures.formats.record3d import Record3DReader
from roomlight.captures.formats.ros.bag import RosBagReader
from roomlight.captures.formats.rtabmap import RtabmapReader
from roomlight.captures.formats.scanner_app import ScannerAppReader
from roomlight.captures.formats.scannet import ScanNetFramesReader, ScanNetReader
from roomlight.captures.formats.scannetpp import ScanNetPPReader
from roomlight.captures.formats.seven_scenes import SevenScenesReader
from roomlight.captures.formats.stray_scanner import StrayScannerReader
from roomlight.captures.formats.tum import TumReader
from roomlight.captures.options import CaptureOptions
from roomlight.captures.recognition import format_of, is_record3d_archive, recognised
from roomlight.captures.source import member_name
from roomlight.captures.video import DEMUXERS
from roomlight.errors import CaptureError, OptionError, RoomLightError, UnknownFormatError
from roomlight.notes import Note
from roomlight.rules import check_type

_READERS: Final[dict[str, Callable[[Path, CaptureOptions], Reader]]] = {
    "roomlight": NativeReader,
    "nerfstudio": NerfstudioReader,
    "stray-scanner": StrayScannerReader,
    "record3d": Record3DReader,
    "tum": TumReader,
    "seven-scenes": SevenScenesReader,
    "polycam": PolycamReader,
    "3d-scanner-app": ScannerAppReader,
    "arkitscenes": ArkitScenesReader,
    "scannet": lambda path, options: (ScanNetFramesReader if path.is_dir() else ScanNetReader)(path, options),
    "scannetpp": ScanNetPPReader,
    "rtabmap": RtabmapReader,
    "ros-bag": RosBagReader,
    "colmap": ColmapReader,
    "video": BareVideoReader,
}
_RECORDED: Final = (".r3d", ".sens", ".bag", ".mcap", ".db3")
_SIDECARS: Final = (".aae", ".thm", ".lrv", ".srt")
"""What phones and action cameras write beside a video: edits, a thumbnail, a small copy, captions."""
_FILES: Final = ("record3d", "scannet", "ros-bag", "video")
"""Formats that are one file."""
_INDICES: Final = {native.INDEX: "roomlight", nerfstudio.INDEX: "nerfstudio"}
"""Files that stand for the folder they are in."""
_VIDEOS: Final = ("rgb.mp4", "rgb.mkv")
"""Videos beside which formats have poses and depth; they stand for the folder too."""
_MEASURED: Final = ("record3d", "polycam")
"""Formats that are read in place of a `transforms.json` without depth."""


FORMATS: Final = tuple(_READERS)
"""The names that `CaptureOptions.format` takes."""

_NESTED: Final = 3
"""Folders above a capture's own that are opened."""
_LISTED: Final = 1000
"""Most entries of a folder that are looked at."""


def open_capture(path: str | Path, options: CaptureOptions | None = None) -> Capture:
    """Open a capture for reading: its index is read and checked, no image is decoded.

    `path` is the capture's folder, a folder that holds nothing but it, its file (`.r3d`, `.sens`, `.bag`, a video), its
    index or video (`transforms.json`, `transforms_train.json`, `capture.json`, `rgb.mp4`), or a `.zip` of the folder,
    which is unpacked for as long as the capture is open.

    Raises:
        OptionError: `path` or `options` is of another type, or `options.format` is not one of `FORMATS`.
        UnknownFormatError: No reader recognises the files.
        CaptureError: The index is missing or damaged, so that no frame can be read.

    Examples:
        >>> import roomlight as rl
        >>> next(iter(rl.open_capture(rl.sample_capture()))).image.shape
        (240, 320, 3)
    """
    chosen = CaptureOptions() if options is None else options
    check_type(chosen, CaptureOptions, "options")
    try:
        path = Path(path)
    except TypeError:
        raise OptionError(f"path is {path!r}; it must be text or a pathlib.Path") from None
    if chosen.format is not None and chosen.format not in _READERS:
        raise OptionError(f"format is {chosen.format!r}; it must be one of {', '.join(FORMATS)}")
    if path.suffix.lower() != ".zip" or not path.is_file() or is_record3d_archive(path):
        return Capture(*_opened(path, chosen), chosen)
    unpacked = _unpacked(path)
    try:
        with _renaming(str(unpacked), str(path)):
            _, reader = _opened(_innermost(unpacked), chosen)
        capture = Capture(path, _UnpackedReader(reader, unpacked, path), chosen)
    except BaseException:
        shutil.rmtree(unpacked.parent, ignore_errors=True)
        raise
    weakref.finalize(capture, shutil.rmtree, unpacked.parent, ignore_errors=True)
    return capture


def _opened(path: Path, chosen: CaptureOptions) -> tuple[Path, Reader]:
    try:
        if not path.exists():
            raise CaptureError(f"{path}: there is no such file or folder")
        stated, part = chosen.format, None
        if path.is_file() and path.name in _INDICES:
            path, stated = path.parent, stated or _INDICES[path.name]
        elif stated in (None, "nerfstudio") and path.is_file() and path.match(nerfstudio.INDICES):
            path, stated, part = path.parent, "nerfstudio", path
        elif stated is None and path.name in _VIDEOS and format_of(path.parent) in ("stray-scanner", "scannetpp"):
            path = path.parent
        if stated is None:
            path = _innermost(path)
        name = stated or recognised(path)
        if path.is_file() and name not in _FILES:
            raise CaptureError(f"{path}: is a file; the {name} format is a folder")
    except (OSError, ValueError) as error:  # a name too long, no permission, a NUL byte
        raise CaptureError(f"{path}: cannot be opened ({error})") from error
    if chosen.fov_deg is not None and name != "video":
        raise OptionError(f"fov_deg is for videos without poses; a recording of the {name} format states its lens")
    reader = _READERS[name](part or path, chosen)
    if stated is None and name in _MEASURED and (path / nerfstudio.INDEX).is_file():
        text = f"{path / nerfstudio.INDEX}: it leads to no depth"
        reader.notes.append(Note(text, f"the {name} recording beside it is read", "open the file itself to read it"))
    return path, reader


def _unpacked(archive: Path) -> Path:
    """Unpack an archive into a temporary folder of its name, which is left when this process or the capture ends.

    Raises:
        CaptureError: It is damaged, encrypted, or larger than the disk's free space.
    """
    root = Path(tempfile.mkdtemp(prefix="roomlight-"))
    try:
        with zipfile.ZipFile(archive) as members:
            size, free = sum(member.file_size for member in members.infolist()), shutil.disk_usage(root).free
            if size > free:
                raise ValueError(f"it holds {size} bytes, and {root.parent} has {free} free")
            for member in members.infolist():
                member.filename = member_name(member)
                members.extract(member, root / archive.name)
    except BaseException as error:
        shutil.rmtree(root, ignore_errors=True)
        if not isinstance(error, Exception):
            raise
        raise CaptureError(f"{archive}: does not unpack ({error}); unpack it by hand, or export it again") from error
    return root / archive.name


def _innermost(path: Path) -> Path:
    """Return the capture: `path`, or the only folder or file of a capture below it, as archives unpack to.

    Raises:
        UnknownFormatError: Several below it are captures.
    """
    outer = path
    for _ in range(_NESTED):
        if not path.is_dir() or format_of(path):
            return path
        entries = list(islice(sorted(path.iterdir()), _LISTED))
        inner = [entry for entry in entries if entry.is_dir() and entry.name[0] not in "._"]
        captures = [folder for folder in inner if format_of(folder)] or _recorded_files(entries)
        if [folder.name for folder in captures] == ["colmap", "nerfstudio"]:  # ScanNet++ writes its poses twice
            captures = captures[1:]
        if len(captures) > 1:
            listed = ", ".join(folder.name for folder in captures[:6])
            raise UnknownFormatError(f"{path}: holds {len(captures)} captures ({listed}); open one of them")
        if not captures and len(inner) != 1:
            return outer
        path = captures[0] if captures else inner[0]
    return path if format_of(path) else outer


def _recorded_files(entries: list[Path]) -> list[Path]:
    """Return the files among a folder's entries that are recordings; of videos only where nothing else is there."""
    shown = [entry for entry in entries if entry.name[0] not in "._" and entry.suffix.lower() not in _SIDECARS]
    files = [entry for entry in shown if entry.suffix.lower() in _RECORDED]
    videos = all(entry.suffix.lower() in DEMUXERS for entry in shown)
    return [entry for entry in files or (shown if videos else []) if entry.is_file()]


class _UnpackedReader:
    """Reads by the format's reader of the unpacked files; its notes, names and errors name the archive."""

    def __init__(self, reader: Reader, unpacked: Path, archive: Path) -> None:
        self._reader, self._paths = reader, (str(unpacked), str(archive))
        self.format, self.conventions = reader.format, reader.conventions
        self.count, self.probes = reader.count, reader.probes

    @property
    def notes(self) -> list[Note]:
        """The notes so far."""
        return list(map(self._renamed, self._reader.notes))

    def name_of(self, index: int) -> str:
        """Return the file in the archive."""
        return self._shown(self._reader.name_of(index))

    def timestamps(self) -> list[float | None]:
        """Return the stored times."""
        return self._reader.timestamps()

    def prepare(self, watch: Callable[[int, int], object]) -> None:
        """Look at the recording, if its reader does so."""
        if isinstance(self._reader, Preparing):
            with _renaming(*self._paths):
                self._reader.prepare(watch)

    @contextmanager
    def records(self) -> Generator[ReadRecord]:
        """Open the files of one pass."""
        with _renaming(*self._paths), self._reader.records() as read:
            yield lambda index: self._record(read, index)

    def _record(self, read: ReadRecord, index: int) -> RawFrame:
        with _renaming(*self._paths):
            raw = read(index)
        picture = replace(raw.picture, notes=tuple(map(self._renamed, raw.picture.notes)))
        depth_name = None if raw.depth_name is None else self._shown(raw.depth_name)
        return replace(raw, name=self._shown(raw.name), depth_name=depth_name, picture=picture)

    def _shown(self, text: str) -> str:
        return text.replace(*self._paths)

    def _renamed(self, note: Note) -> Note:
        return Note(*map(self._shown, (note.left_out, note.effect, note.advice)))


@contextmanager
def _renaming(unpacked: str, archive: str) -> Generator[None]:
    """Raise errors of the block with the archive's path in place of the unpacked one's."""
    try:
        yield
    except RoomLightError as error:
        shown = str(error).replace(unpacked, archive)
        if shown == str(error):
            raise
        raise type(error)(shown) from error
