"""ScanNet: its `.sens`, one binary file of JPEG colour, compressed depth and poses, version 4; or the frames of it.

Frames are `color/0.jpg`, `depth/0.png`, `pose/0.txt` (4 x 4) and `intrinsic/intrinsic_color.txt` or
`intrinsics_color.txt`, as the data set's tools unpack them.

Conventions: camera-to-world, OpenCV camera, world z-up; lost poses are -inf. K of the colour camera has pixel centres
at whole numbers, so that half a pixel is added. Depth is uint16 times 1 / depthShift metres (frames: millimetres);
where the depth camera, by its K and the extrinsics, is not the colour camera at another size, depth is projected into
the colour image. Times are microseconds; a file without them has zeros.
"""

import re
import struct
import zlib
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics, check_rigid
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame, RawProbe, ReadRecord
from roomlight.captures.decoding import intrinsics_without_size, read_rgbd, registered
from roomlight.captures.formats.listed import ListedReader, files_of
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import MAX_FRAMES, read_index
from roomlight.depth import clean_depth
from roomlight.errors import CaptureError, FrameError
from roomlight.files import MAX_FILE_BYTES, FolderSource
from roomlight.images import MAX_PIXELS, decode_picture
from roomlight.notes import Note

VERSION: Final = 4
_COLOUR: Final = {1: "PNG", 2: "JPEG"}
_RAW_DEPTH, _ZLIB_DEPTH = 0, 1
_FRAME: Final = struct.Struct("<16f4Q")
_MATRICES: Final = ("intrinsic/intrinsic_color.txt", "intrinsics_color.txt", "intrinsic_color.txt")


@dataclass(frozen=True)
class _Entry:
    """Where a frame lies in the file."""

    pose: tuple[float, ...]
    time: float
    colour_at: int
    colour_bytes: int
    depth_bytes: int


class ScanNetReader:
    """Reads a `.sens` file; of a truncated one the frames that are whole."""

    format = "scannet"
    conventions = PoseConventions("opencv", "camera-to-world", (0.0, 0.0, 1.0))

    def __init__(self, path: Path, options: CaptureOptions) -> None:
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
        self._reads_depth = options.depth != "network"
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
        matrices = np.frombuffer(file.read(256), "<f4").reshape(4, 4, 4).astype(np.float64)
        self._k, self._depth_k = matrices[0], matrices[2]
        self._depth_to_colour = between(matrices[1], matrices[3])
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
            self._intrinsics = camera_of(self._k, self._colour_size)

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
        depth_m = np.zeros(self._depth_size[::-1], np.float32)
        if self._reads_depth:
            depth_m = in_colour(self._depth(depth, label), self._depth_k, self._intrinsics, self._depth_to_colour)
        return RawFrame(
            name=label,
            picture=decode_picture(colour, label, as_stored=True),
            depth_m=depth_m,
            depth_name=label if self._reads_depth else None,
            intrinsics=self._intrinsics,
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


def camera_of(k: Float[np.ndarray, "n n"], size: tuple[int, int]) -> Intrinsics:
    """Return the camera of a K with pixel centres at whole numbers."""
    return Intrinsics(float(k[0, 0]), float(k[1, 1]), float(k[0, 2]) + 0.5, float(k[1, 2]) + 0.5, *size)


def between(colour: Float[np.ndarray, "4 4"], depth: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return what takes points of the depth camera to the colour camera; the identity where a pose is none."""
    known = all(np.isfinite(pose).all() and abs(np.linalg.det(pose)) > 0.5 for pose in (colour, depth))
    return np.linalg.inv(colour) @ depth if known else np.eye(4)


def in_colour(
    depth_m: Float[np.ndarray, "h w"],
    depth_k: Float[np.ndarray, "n n"],
    colour: Intrinsics,
    depth_to_colour: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "dh dw"]:
    """Project depth into the colour image unless its camera is the colour camera, to 1 % of a focal length."""
    if not np.isfinite(depth_k).all() or depth_k[0, 0] <= 0:
        return depth_m
    size = depth_m.shape[1], depth_m.shape[0]
    near, same = camera_of(depth_k, size), colour.resized(*size)
    off = max(abs(getattr(near, key) - getattr(same, key)) for key in ("fx", "fy", "cx", "cy"))
    if off < 0.01 * same.fx and np.abs(depth_to_colour - np.eye(4)).max() < 0.005:
        return depth_m
    return registered(depth_m, near, colour, check_rigid(depth_to_colour))


def intrinsics_file(source: FolderSource) -> str | None:
    """Return the file of the colour camera's K in a folder of frames; None without one."""
    return next((name for name in _MATRICES if source.has(name) and source.has("pose")), None)


class ScanNetFramesReader(ListedReader):
    """Reads the frames of a `.sens` in a folder."""

    format = "scannet"
    conventions = ScanNetReader.conventions

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        source = FolderSource(folder)
        name = intrinsics_file(source)
        if name is None:
            raise CaptureError(f"{folder}: has neither a .sens file nor pose/ and {_MATRICES[0]}")
        label = source.label(name)
        with fields.naming(label, CaptureError):
            self._matrix = fields.matrix_of_text(read_index(source, name), 3, label)
        depth_name, extrinsic = name.replace("color", "depth"), re.sub("intrinsics?_", "extrinsic_", name)
        self._depth_k = self._stated(source, depth_name, 3)
        poses = [self._stated(source, file, 4) for file in (extrinsic, extrinsic.replace("color", "depth"))]
        self._depth_to_colour = between(*(np.eye(4) if pose is None else pose for pose in poses))
        colour = files_of(source, "color", (".jpg", ".jpeg", ".png"))
        super().__init__(folder, options, colour, expected="color/0.jpg", depth="depth")

    @staticmethod
    def _stated(source: FolderSource, name: str, size: int) -> Float[np.ndarray, "{size} {size}"] | None:
        if not source.has(name):
            return None
        with fields.naming(source.label(name), CaptureError):
            return fields.matrix_of_text(read_index(source, name), size, source.label(name))

    def _read(self, index: int) -> RawFrame:
        stem, label = Path(self._colour[index]).stem, self.name_of(index)
        pose_name, depth_name = f"pose/{stem}.txt", f"depth/{stem}.png" if self._reads_depth else None
        pose_label = self._source.label(pose_name)
        with fields.naming(pose_label, FrameError):
            pose = fields.matrix_of_text(self._source.read(pose_name, max_bytes=65536), 4, pose_label)
        picture, depth_m = read_rgbd(self._source, self._colour[index], depth_name, unit_m=self._unit_m)
        height, width = picture.image.shape[:2]
        with fields.naming(label, FrameError):
            intrinsics = intrinsics_without_size(self._matrix, width=width, height=height, shift=0.5)
        if depth_name is not None and self._depth_k is not None:
            depth_m = in_colour(depth_m, self._depth_k, intrinsics, self._depth_to_colour)
        return self._raw_frame(index, picture, depth_m, depth_name, intrinsics, pose)
