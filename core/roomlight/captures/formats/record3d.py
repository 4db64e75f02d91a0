"""Record3D: the `.r3d` archive (or its unpacked folder) and the EXR+JPG export.

| what       | .r3d                                          | EXR+JPG export       |
|------------|-----------------------------------------------|----------------------|
| index      | `metadata`                                    | `metadata.json`      |
| colour     | `rgbd/N.jpg`                                  | `rgb/N.jpg`          |
| depth      | `rgbd/N.depth`: LZFSE, float32 metres, dh x dw  | `depth/N.exr`: metres |
| confidence | `rgbd/N.conf`: LZFSE, uint8 0, 1, 2 (optional)    | none                 |

N is also the row of `poses` ([qx qy qz qw px py pz]) and of `frameTimestamps`: an export may hold any subset
of the files.

Conventions: camera-to-world, OpenGL camera, world y-up (ARKit's). `K` is column-major at the
size `w` x `h` (portrait or landscape as recorded); a depth map has `dw` x `dh` values, or as many as its bytes.
`perFrameIntrinsicCoeffs` ([fx, fy, cx, cy] a frame)
overrides it. cx and cy are ARKit's and used unchanged: pixel centres at half integers.
"""

import re
import struct
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import lzfse
import numpy as np
from jaxtyping import Float, UInt8

from roomlight.camera import Intrinsics, pose_from_quaternion
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame, RawProbe, ReadRecord
from roomlight.captures.decoding import decode_depth_map, read_picture
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import MAX_FRAMES, MAX_INDEX_BYTES, Source, ZipSource, read_index
from roomlight.depth import clean_depth
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource
from roomlight.images import MAX_PIXELS
from roomlight.notes import Note, keys_of_use, unread_keys

LAYOUTS: Final = (("metadata", "rgbd"), ("metadata.json", "rgb"))
"""Index and folder of colour images, of a `.r3d` and of an export."""

LENS_KEYS: Final = (b'"K"', b'"perFrameIntrinsicCoeffs"')
"""Keys of which an index of Record3D has one; other programs name their files alike."""

_COLOUR: Final = re.compile(r"(?:rgbd|rgb)/(\d{1,9})\.(?:jpg|jpeg|png)", re.IGNORECASE)


def layout_of(source: Source) -> tuple[str, str] | None:
    """Return the index, a file, and the folder of images that are there; None without both."""

    def filled(name: str) -> bool:
        return next(iter(source.names(name)), None) is not None

    for index, images in LAYOUTS:
        if source.has(index) and not filled(index) and filled(images):
            return index, images
    return None


def is_record3d(source: Source, *keys: bytes) -> bool:
    """Whether the files are Record3D's: images and an index with one of these keys, by default with poses."""
    layout = layout_of(source)
    try:
        index = b"" if layout is None else source.read(layout[0], max_bytes=MAX_INDEX_BYTES)
    except FrameError:
        return False
    return any(key in index for key in keys or (b'"poses"',))


class Record3DReader:
    """Reads a `.r3d` archive, its unpacked folder, or an EXR+JPG export."""

    format = "record3d"
    conventions = PoseConventions("opengl", "camera-to-world", (0.0, 1.0, 0.0))

    def __init__(self, path: Path, options: CaptureOptions) -> None:
        self._source: Source = FolderSource(path) if path.is_dir() else ZipSource(path)
        self._unit_m = options.depth_unit_m
        self.probes: list[RawProbe] = []
        self.notes: list[Note] = []
        index_name, folder = layout_of(self._source) or LAYOUTS[0 if self._source.has("metadata") else 1]
        self._packed = folder == "rgbd"
        self._label = self._source.label(index_name)
        self._metadata = fields.parse_json(read_index(self._source, index_name), self._label)
        self.notes += unread_keys(self._label, keys_of_use(self._metadata))
        if (first := self._metadata.get("initPose")) not in (None, [0, 0, 0, 1, 0, 0, 0]):
            text = f"{self._label}: initPose {str(first)[:90]}"
            self.notes.append(Note(text, "poses are read as they stand, without it", "nothing to do if up is right"))
        depth = ("rgbd", ".depth") if self._packed else ("depth", ".exr")
        there = any(name.lower().endswith(depth[1]) for name in self._source.names(depth[0]))
        self._reads_depth = options.depth != "network"
        self._has_depth = self._reads_depth and there
        colour = {int(match[1]): match[0] for match in map(_COLOUR.fullmatch, self._source.names(folder)) if match}
        self._numbers = sorted(colour)
        self._colour = [colour[number] for number in self._numbers]
        self.count = len(self._numbers)
        if self.count == 0:
            raise CaptureError(f"{path}: has no {folder}/N.jpg")
        if self.count > MAX_FRAMES:
            raise CaptureError(f"{path}: has {self.count} frames; up to {MAX_FRAMES} are read")
        with fields.naming(self._label, CaptureError):
            self._poses = _list(self._metadata, "poses")
            self._times = _list(self._metadata, "frameTimestamps", needed=False)
            self._lenses = _list(self._metadata, "perFrameIntrinsicCoeffs", needed=False)
            self._width = fields.pixels(self._metadata.get("w"), "w")
            self._height = fields.pixels(self._metadata.get("h"), "h")
            column_major = fields.vector(self._metadata.get("K"), 9, "K")
            fields.positive(float(column_major[0]), "K's fx")
            fields.positive(float(column_major[4]), "K's fy")
            self._lens = [float(column_major[at]) for at in (0, 4, 6, 7)]
            self._camera(self._lens)
            height, width = self._metadata.get("dh"), self._metadata.get("dw")
            self._depth_size: tuple[int, int] | None = None  # rows, columns
            if height is not None and width is not None:
                self._depth_size = fields.pixels(height, "dh"), fields.pixels(width, "dw")

    def name_of(self, index: int) -> str:
        """Return the colour file."""
        return self._source.label(self._colour[index])

    def timestamps(self) -> list[float | None]:
        """Return the times of the records: as stated, else their numbers by the rate, which some state alone."""
        if not self._times:
            with suppress(ValueError):
                rate = fields.positive(self._metadata.get("fps"), "fps")
                return [fields.time(number / rate) for number in self._numbers]
        return [fields.time(self._times[number]) if number < len(self._times) else None for number in self._numbers]

    @contextmanager
    def records(self) -> Generator[ReadRecord]:
        """Hold the archive open for one pass."""
        with self._source.opened():
            yield self._read

    def _read(self, index: int) -> RawFrame:
        number = self._numbers[index]
        where = f"{self._label}: frame {number} ({self.name_of(index)})"
        with fields.naming(where, FrameError):
            if number >= len(self._poses):
                raise ValueError(f"has no pose; the metadata has {len(self._poses)} poses")
            values = fields.vector(self._poses[number], 7, "the pose")
            if not np.isfinite(values).all():
                raise ValueError("the pose holds NaN or infinity (lost tracking)")
            pose = pose_from_quaternion(values[:4], values[4:])
            lens = self._lens
            if number < len(self._lenses):
                lens = fields.vector(self._lenses[number], 4, "perFrameIntrinsicCoeffs").tolist()
            intrinsics = self._camera(lens)
        picture = read_picture(self._source, self._colour[index])
        depth_name = f"rgbd/{number}.depth" if self._packed else f"depth/{number}.exr"
        return RawFrame(
            name=self.name_of(index),
            picture=picture,
            depth_m=self._depth(depth_name) if self._has_depth else np.zeros(picture.image.shape[:2], np.float32),
            depth_name=self._source.label(depth_name) if self._has_depth else None,
            intrinsics=intrinsics,
            pose=pose,
            confidence=self._confidence(f"rgbd/{number}.conf"),
        )

    def _depth(self, name: str) -> Float[np.ndarray, "dh dw"]:
        data, label = self._source.read(name), self._source.label(name)
        if not self._packed:
            return decode_depth_map(data, label, unit_m=self._unit_m)
        height, width = self._size_of(data, 4)
        values = np.frombuffer(_unpacked(data, label, height * width * 4), "<f4").reshape(height, width)
        with np.errstate(over="ignore", invalid="ignore"):
            return clean_depth(values.astype(np.float32) * np.float32(self._unit_m or 1.0))

    def _confidence(self, name: str) -> UInt8[np.ndarray, "dh dw"] | None:
        if not (self._packed and self._reads_depth and self._source.has(name)):
            return None
        data = self._source.read(name)
        height, width = self._size_of(data, 1)
        unpacked = _unpacked(data, self._source.label(name), height * width)
        return np.frombuffer(unpacked, np.uint8).reshape(height, width)

    def _camera(self, lens: list[float]) -> Intrinsics:
        return Intrinsics(lens[0], lens[1], lens[2], lens[3], self._width, self._height)

    def _size_of(self, data: bytes, item: int) -> tuple[int, int]:
        """Return (rows, columns) of a packed plane: as stated, else by its bytes and the image's aspect.

        LiDAR gives 256 x 192 values, the FaceID camera 640 x 480.
        """
        if self._depth_size is not None:
            return self._depth_size
        count = _declared_size(data) // item
        width = round((count * self._width / self._height) ** 0.5)
        if width > 0 and count % width == 0 and 0 < count <= MAX_PIXELS:
            return count // width, width
        return (256, 192) if self._height > self._width else (192, 256)


def _list(metadata: dict[str, Any], key: str, *, needed: bool = True) -> list[Any]:
    value = metadata.get(key)
    if value is None and not needed:
        return []
    if not isinstance(value, list):
        instead = "; record with LiDAR, which tracks, or `roomlight light` one of its pictures" if needed else ""
        raise ValueError(f"{key} is missing or not a list{instead}")
    return value


def _unpacked(data: bytes, label: str, size: int) -> bytes:
    """Decompress LZFSE data to exactly `size` bytes; the declared size is checked first. Raises FrameError."""
    declared = _declared_size(data)
    if declared != size:
        raise FrameError(f"{label}: unpacks to {declared} bytes where the metadata's size needs {size}")
    try:
        unpacked = lzfse.decompress(data)
    except (lzfse.error, MemoryError) as error:  # damaged data makes it ask for ever larger buffers
        raise FrameError(f"{label}: the LZFSE data is damaged ({error})") from error
    if len(unpacked) != size:
        raise FrameError(f"{label}: unpacks to {len(unpacked)} bytes where the metadata's size needs {size}")
    return unpacked


def _declared_size(data: bytes) -> int:
    """Return the decompressed size that an LZFSE stream declares; 0 when a block is damaged or truncated.

    The library declares no sizes, so that the block headers are read here.
    """
    offset = total = 0
    try:
        while (magic := data[offset : offset + 4]) != b"bvx$":
            (raw,) = struct.unpack_from("<I", data, offset + 4)
            if magic == b"bvx-":
                offset += 8 + raw
            elif magic == b"bvxn":
                offset += 12 + struct.unpack_from("<I", data, offset + 8)[0]
            elif magic == b"bvx2":
                fields0, fields1, fields2 = struct.unpack_from("<QQQ", data, offset + 8)
                header, literals, matches = (
                    fields2 & 0xFFFFFFFF,
                    (fields0 >> 20) & 0xFFFFF,
                    (fields1 >> 40) & 0xFFFFF,
                )
                if header < 32:
                    return 0
                offset += header + literals + matches
            else:
                return 0
            total += raw
    except struct.error:
        return 0
    return total
