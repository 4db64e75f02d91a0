"""Which reader takes a path: by its files, in an order that no two formats share, or as the user says."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from roomlight.captures import native, nerfstudio, stray_scanner
from roomlight.captures.capture import Capture, Reader
from roomlight.captures.native import NativeReader
from roomlight.captures.nerfstudio import NerfstudioReader
from roomlight.captures.options import CaptureOptions
from roomlight.captures.record3d import Record3DReader
from roomlight.captures.seven_scenes import SevenScenesReader
from roomlight.captures.stray_scanner import StrayScannerReader
from roomlight.captures.tum import TumReader
from roomlight.errors import CaptureError, UnknownFormatError

_READERS: Final[dict[str, Callable[[Path, CaptureOptions], Reader]]] = {
    "roomlight": NativeReader,
    "nerfstudio": NerfstudioReader,
    "stray-scanner": StrayScannerReader,
    "record3d": Record3DReader,
    "tum": TumReader,
    "seven-scenes": SevenScenesReader,
}

FORMATS: Final = tuple(_READERS)
"""The names that `CaptureOptions.format` takes."""

_SIGNS: Final = (
    f"{native.INDEX} (roomlight), {nerfstudio.INDEX} (nerfstudio), {stray_scanner.ODOMETRY} with "
    f"{stray_scanner.VIDEO} (stray-scanner), metadata with rgbd/ or metadata.json with rgb/ and depth/, or a .r3d "
    "file (record3d), rgb.txt with groundtruth.txt (tum), frame-XXXXXX.color.png (seven-scenes)"
)


def open_capture(path: Path, options: CaptureOptions | None = None) -> Capture:
    """Open a capture for reading: its index is read and checked, no image is decoded.

    `path` is the capture's folder, its `.r3d` file, or its index (`transforms.json`, `capture.json`).
    CaptureError when the capture is refused whole, UnknownFormatError when no reader knows it.
    """
    chosen = CaptureOptions() if options is None else options
    path = Path(path)
    if chosen.format is not None and chosen.format not in _READERS:
        raise UnknownFormatError(f"capture format {chosen.format!r} is none of {', '.join(FORMATS)}")
    try:
        if not path.exists():
            raise CaptureError(f"{path}: there is no such file or folder")
        if path.is_file() and path.name in (native.INDEX, nerfstudio.INDEX):
            path = path.parent
        name = chosen.format or _detect(path)
        if path.is_file() and name != "record3d":
            raise CaptureError(f"{path}: is a file; the {name} format is a folder")
    except (OSError, ValueError) as error:  # a name too long, no permission, a NUL byte
        raise CaptureError(f"{path}: cannot be opened ({error})") from error
    return Capture(path, _READERS[name](path, chosen), chosen)


def _detect(path: Path) -> str:
    """The format's name by the files that are there; UnknownFormatError says what is looked for."""

    def has(*names: str) -> bool:
        return any((path / name).exists() or (path / name).is_symlink() for name in names)

    if path.is_file():
        if path.suffix.lower() in (".r3d", ".zip"):
            return "record3d"
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
    raise UnknownFormatError(f"{path}: no reader knows it; looked for {_SIGNS}. Force one with format (--format)")
