"""Choose the reader of a capture: by the files in its folder, or by `CaptureOptions.format`."""

import zipfile
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Final

from roomlight.captures.capture import Capture, Reader
from roomlight.captures.formats import native, nerfstudio, record3d, stray_scanner
from roomlight.captures.formats.arkit_scenes import TRAJECTORY, ArkitScenesReader
from roomlight.captures.formats.colmap import ColmapReader, model_folder
from roomlight.captures.formats.native import NativeReader
from roomlight.captures.formats.nerfstudio import NerfstudioReader
from roomlight.captures.formats.polycam import PolycamReader, is_polycam
from roomlight.captures.formats.record3d import Record3DReader
from roomlight.captures.formats.scanner_app import ScannerAppReader, is_scanner_app
from roomlight.captures.formats.scannet import ScanNetReader
from roomlight.captures.formats.seven_scenes import SevenScenesReader
from roomlight.captures.formats.stray_scanner import StrayScannerReader
from roomlight.captures.formats.tum import TumReader
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import FolderSource, ZipSource
from roomlight.errors import CaptureError, OptionError, UnknownFormatError

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
    "scannet": ScanNetReader,
    "colmap": ColmapReader,
}
_FILES: Final = ("record3d", "scannet")
"""Formats that are one file."""


FORMATS: Final = tuple(_READERS)
"""The names that `CaptureOptions.format` takes."""

_SIGNS: Final = (
    f"{native.INDEX} (roomlight), {nerfstudio.INDEX} (nerfstudio), {stray_scanner.ODOMETRY} with "
    f"{stray_scanner.VIDEO} (stray-scanner), metadata with rgbd/ or metadata.json with rgb/ and depth/, or a .r3d "
    "file (record3d), rgb.txt with groundtruth.txt (tum), frame-XXXXXX.color.png (seven-scenes), "
    "keyframes/cameras (polycam), frame_00000.jpg with frame_00000.json (3d-scanner-app), lowres_wide.traj "
    "(arkitscenes), a .sens file (scannet), sparse/0/cameras.bin or .txt (colmap)"
)

_IMAGES: Final = (".jpg", ".jpeg", ".png", ".exr")
_NESTED: Final = 3
"""Folders above a capture's own that are opened."""
_LISTED: Final = 1000
"""Most files of a folder that are looked at for a message."""


def open_capture(path: str | Path, options: CaptureOptions | None = None) -> Capture:
    """Open a capture for reading: its index is read and checked, no image is decoded.

    `path` is the capture's folder, a folder that holds nothing but it, its `.r3d` file, or its index
    (`transforms.json`, `capture.json`).

    Raises:
        OptionError: `options.format` is not one of `FORMATS`.
        UnknownFormatError: No reader recognises the files.
        CaptureError: The index is missing or damaged, so that no frame can be read.

    Examples:
        >>> import roomlight as rl
        >>> next(iter(rl.open_capture(rl.sample_capture()))).image.shape
        (240, 320, 3)
    """
    chosen = CaptureOptions() if options is None else options
    path = Path(path)
    if chosen.format is not None and chosen.format not in _READERS:
        raise OptionError(f"format is {chosen.format!r}; it must be one of {', '.join(FORMATS)}")
    try:
        if not path.exists():
            raise CaptureError(f"{path}: there is no such file or folder")
        if path.is_file() and path.name in (native.INDEX, nerfstudio.INDEX):
            path = path.parent
        if chosen.format is None:
            path = _innermost(path)
        name = chosen.format or _detect(path)
        if path.is_file() and name not in _FILES:
            raise CaptureError(f"{path}: is a file; the {name} format is a folder")
    except (OSError, ValueError) as error:  # a name too long, no permission, a NUL byte
        raise CaptureError(f"{path}: cannot be opened ({error})") from error
    return Capture(path, _READERS[name](path, chosen), chosen)


def _detect(path: Path) -> str:
    """Return the format's name by the files in the folder or the archive. Raises UnknownFormatError."""

    def has(*names: str) -> bool:
        return any(source.has(name) for name in names)

    source = FolderSource(path)

    if path.is_file():
        if path.suffix.lower() == ".r3d":
            return "record3d"
        if path.suffix.lower() == ".sens":
            return "scannet"
        if zipfile.is_zipfile(path):
            return _detect_zip(path)
    elif has(native.INDEX):
        return "roomlight"
    elif has(nerfstudio.INDEX):
        return "nerfstudio"
    elif has(stray_scanner.ODOMETRY, stray_scanner.MATRIX):
        return "stray-scanner"
    elif has("metadata", "metadata.json"):
        return "record3d"
    elif has("groundtruth.txt") or (has("rgb.txt") and has("depth.txt")):
        return "tum"
    elif any(path.glob("frame-*.*.*")):
        return "seven-scenes"
    elif is_polycam(source):
        return "polycam"
    elif has(TRAJECTORY):
        return "arkitscenes"
    elif model_folder(source) is not None:
        return "colmap"
    elif is_scanner_app(source):
        return "3d-scanner-app"
    raise UnknownFormatError(
        f"{path}: no capture format recognised; looked for {_SIGNS}. {_bare_images(path)}Set `format` to force one"
    )


def _innermost(path: Path) -> Path:
    """Return the capture's folder: `path`, or the only folder of captures below it, as archives unpack to.

    Raises:
        UnknownFormatError: Several folders below it hold captures.
    """
    for _ in range(_NESTED):
        if not path.is_dir() or _is_capture(path):
            return path
        entries = islice(sorted(path.iterdir()), _LISTED)
        inner = [entry for entry in entries if entry.is_dir() and entry.name[0] not in "._"]
        captures = [folder for folder in inner if _is_capture(folder)]
        if len(captures) > 1:
            listed = ", ".join(folder.name for folder in captures[:6])
            raise UnknownFormatError(f"{path}: holds {len(captures)} captures ({listed}); open one of them")
        if not captures and len(inner) != 1:
            return path
        path = captures[0] if captures else inner[0]
    return path


def _is_capture(path: Path) -> bool:
    try:
        _detect(path)
    except UnknownFormatError:
        return False
    return True


def _bare_images(path: Path) -> str:
    """Return what images without an index lack, as a sentence; empty if the folder holds no image."""
    if not path.is_dir():
        return ""
    names = sorted(file.name for file in islice(path.iterdir(), _LISTED) if file.suffix.lower() in _IMAGES)
    if not names:
        return ""
    listed = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return (
        f"The folder holds {listed} without focal lengths and camera poses: add them in {nerfstudio.INDEX}, also for a "
        "single frame; `roomlight light IMAGE --depth DEPTH` takes one photo without them. "
    )


def _detect_zip(path: Path) -> str:
    """Return "record3d" if the archive's listing is Record3D's. Raises UnknownFormatError with what it holds."""
    source = ZipSource(path)
    members = list(source.names())
    for index, folder in record3d.LAYOUTS:
        if index in members and any(name.startswith(f"{folder}/") for name in members):
            return "record3d"
    top = sorted({f"{name.split('/')[0]}/" if "/" in name else name for name in members})
    top = [source.prefix] if source.prefix else top
    contents = ", ".join(top[:6]) + (f" and {len(top) - 6} more" if len(top) > 6 else "")
    raise UnknownFormatError(
        f"{path}: this zip archive is not a Record3D capture (metadata with rgbd/, or metadata.json with rgb/); "
        f"it holds {contents or 'nothing'}. Unpack a capture of another format first"
    )
