"""ScanNet's `.sens`: one binary file of JPEG colour, compressed depth and poses, version 4.

Conventions: camera-to-world, OpenCV camera, world z-up; lost poses are -inf. K of the colour camera has pixel centres
at whole numbers, so that half a pixel is added. Depth is uint16 times 1 / depthShift metres, from a camera that is
taken for the colour camera at another size. Times are microseconds; a file without them has zeros.
"""

import struct
import zlib
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame, RawProbe, ReadRecord
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import MAX_FILE_BYTES, MAX_FRAMES
from roomlight.depth import clean_depth
from roomlight.errors import CaptureError, FrameError
from roomlight.images import MAX_PIXELS, decode_picture
from roomlight.notes import Note

VERSION: Final = 4
_COLOUR: Final = {1: "PNG", 2: "JPEG"}
_RAW_DEPTH, _ZLIB_DEPTH = 0, 1
_FRAME: Final = struct.Struct("<16f4Q")


@dataclass(frozen=True)
class _Entry:
    """Where a frame lies in the file."""

    pose: tuple[float, ...]
    time: float
    colour_at: int
    colour_bytes: int
    depth_bytes: int


class ScanNetReader:
    """Reads a `.sens` file."""

    format = "scannet"
    conventions = PoseConventions("opencv", "camera-to-world", (0.0, 0.0, 1.0))

    def __init__(self, path: Path, options: CaptureOptions) -> None:
        """Read the header and list the frames; a truncated file keeps those that are whole.

        Raises:
            CaptureError: The file is none, or of another version, or holds no frame.
        """
        self._path = path
        self.probes: list[RawProbe] = []
        self.notes: list[Note] = []
        try:
            size = path.stat().st_size
            with path.open("rb") as file:
                self._header(file)
                self._entries = self._listed(file, size)
        except (OSError, struct.error, ValueError, OverflowError) as error:
            raise CaptureError(f"{path}: is not a readable .sens file ({error})") from error
        self._unit_m = options.depth_unit_m or 1 / self._depth_shift
        self.count = len(self._entries)
        if self.count < self._stated:
            self.notes.append(
                Note(f"{path}: {self._stated} frames", f"{self.count} of them are whole", "copy the file again")
            )

    def name_of(self, index: int) -> str:
        """Return the file and the frame's number."""
        return f"{self._path}: frame {index}"

    def timestamps(self) -> list[float | None]:
        """Return the colour images' times; none if the file has zeros."""
        times = [entry.time for entry in self._entries]
        return [time * 1e-6 for time in times] if any(times) else []

    @contextmanager
    def records(self) -> Generator[ReadRecord]:
        """Hold the file open for one pass."""
        try:
            file = self._path.open("rb")
        except OSError as error:
            raise CaptureError(f"{self._path}: cannot be read ({error.strerror or error})") from error
        with file:
            yield lambda index: self._read(index, file)

    def _header(self, file: BinaryIO) -> None:
        version, name_bytes = struct.unpack("<IQ", file.read(12))
        if version != VERSION or name_bytes > 4096:
            raise CaptureError(f"{self._path}: is no .sens file of version {VERSION} (it states version {version})")
        file.read(name_bytes)
        matrices = np.frombuffer(file.read(256), "<f4").reshape(4, 4, 4)
        self._k = matrices[0].astype(np.float64)
        values = struct.unpack("<2i4IfQ", file.read(36))
        self._colour_kind, self._depth_kind = values[:2]
        self._colour_size, self._depth_size = values[2:4], values[4:6]
        self._depth_shift, self._stated = values[6:]
        if self._colour_kind not in _COLOUR:
            raise CaptureError(f"{self._path}: has colour of kind {self._colour_kind}; PNG and JPEG are read")
        if self._depth_kind not in (_RAW_DEPTH, _ZLIB_DEPTH):
            raise CaptureError(f"{self._path}: has depth of kind {self._depth_kind}; raw and zlib are read")
        with fields.naming(str(self._path), CaptureError):
            fields.unit(1 / fields.positive(self._depth_shift, "depthShift"), "1 / depthShift")
            for width, height in (self._colour_size, self._depth_size):
                if not 0 < width * height <= MAX_PIXELS:
                    raise ValueError(f"declares images of {width} x {height} pixels")
            self._intrinsics()

    def _intrinsics(self) -> Intrinsics:
        k = self._k
        return Intrinsics(
            float(k[0, 0]), float(k[1, 1]), float(k[0, 2]) + 0.5, float(k[1, 2]) + 0.5, *self._colour_size
        )

    def _listed(self, file: BinaryIO, size: int) -> list[_Entry]:
        entries: list[_Entry] = []
        at = file.tell()
        while len(entries) < min(self._stated, MAX_FRAMES) and at + _FRAME.size <= size:
            file.seek(at)
            values = _FRAME.unpack(file.read(_FRAME.size))
            time, _, colour_bytes, depth_bytes = values[16:]
            end = at + _FRAME.size + colour_bytes + depth_bytes
            if end > size or max(colour_bytes, depth_bytes) > MAX_FILE_BYTES:
                break
            entries.append(_Entry(values[:16], float(time), at + _FRAME.size, colour_bytes, depth_bytes))
            at = end
        return entries

    def _read(self, index: int, file: BinaryIO) -> RawFrame:
        entry, label = self._entries[index], self.name_of(index)
        try:
            file.seek(entry.colour_at)
            colour, depth = file.read(entry.colour_bytes), file.read(entry.depth_bytes)
        except OSError as error:
            raise FrameError(f"{label}: cannot be read ({error.strerror or error})") from error
        with fields.naming(label, FrameError):
            pose = fields.coordinates(entry.pose, "the pose").reshape(4, 4)
        return RawFrame(
            name=label,
            picture=decode_picture(colour, label, as_stored=True),
            depth_m=self._depth(depth, label),
            depth_name=label,
            intrinsics=self._intrinsics(),
            pose=pose,
        )

    def _depth(self, data: bytes, label: str) -> Float[np.ndarray, "h w"]:
        width, height = self._depth_size
        size = 2 * width * height
        if self._depth_kind == _ZLIB_DEPTH:
            try:
                unpacking = zlib.decompressobj()
                data = unpacking.decompress(data, size)
                if unpacking.decompress(unpacking.unconsumed_tail, 1) or not unpacking.eof:  # checks the checksum too
                    raise FrameError(f"{label}: its depth is truncated, or larger than {width} x {height}")
            except zlib.error as error:
                raise FrameError(f"{label}: its depth does not unpack ({error})") from error
        if len(data) != size:
            raise FrameError(f"{label}: its depth has {len(data)} bytes, {width} x {height} needs {size}")
        stored = np.frombuffer(data, "<u2").reshape(height, width)
        metres = stored.astype(np.float32) * np.float32(self._unit_m)
        metres[stored == 65535] = 0.0
        return clean_depth(metres)
