"""Stray Scanner: `rgb.mp4`, `depth/%06d.png`, `confidence/%06d.png`, `camera_matrix.csv`, `odometry.csv`.

A record is a row of the odometry: `timestamp, frame, x, y, z, qx, qy, qz, qw` (newer versions add `fx, fy,
cx, cy`), columns found by the header. `frame` numbers the video's frames and the depth files; rows, video
frames and files may differ in number; a row without its video frame or files is a bad frame. The app writes the
first frame at a time below 0, so that the video's edit list cuts it off; it is read all the same.

Conventions: camera-to-world, OpenCV camera, world y-up (ARKit's). Depth is uint16 millimetres (.npy in old
exports), confidence 0, 1, 2. K is for 1920 x 1440 and is scaled to the video's size; if its principal
point is nearer to the centre of the video's own size, K is assumed to be for that size. cx and cy are ARKit's
and used unchanged: pixel centres at half integers.
"""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np

from roomlight.camera import Intrinsics, pose_from_quaternion
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame, RawProbe, ReadRecord
from roomlight.captures.decoding import decode_confidence, decode_depth_map
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import MAX_FRAMES, read_index
from roomlight.captures.video import VideoFrames
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource
from roomlight.notes import Note

VIDEO: Final = "rgb.mp4"
MATRIX: Final = "camera_matrix.csv"
ODOMETRY: Final = "odometry.csv"
COLUMNS: Final = ("timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw")
MATRIX_SIZE: Final = (1920, 1440)
"""The image size (width, height) that `camera_matrix.csv` is for, whatever size the video was written at."""

MAX_VIDEO_BYTES: Final = 1 << 36
"""64 GiB: a video is streamed, never held in memory, so that the limit only catches damaged sizes."""


class StrayScannerReader:
    """Reads a folder that Stray Scanner exported."""

    format = "stray-scanner"
    conventions = PoseConventions("opencv", "camera-to-world", (0.0, 1.0, 0.0))

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        self._source = FolderSource(folder)
        self._unit_m = options.depth_unit_m
        self._reads_depth = options.depth != "network" and self._source.holds_files("depth")
        self.probes: list[RawProbe] = []
        self.notes: list[Note] = []
        self._label = self._source.label(ODOMETRY)
        try:
            self._video = self._source.path(VIDEO, max_bytes=MAX_VIDEO_BYTES)
        except FrameError as error:
            raise CaptureError(str(error)) from error
        matrix_label = self._source.label(MATRIX)
        matrix_data = read_index(self._source, MATRIX)
        with fields.naming(matrix_label, CaptureError):
            matrix = fields.matrix_of_text(matrix_data, 3, matrix_label)
            fields.positive(float(matrix[0, 0]), "fx")
            fields.positive(float(matrix[1, 1]), "fy")
            self._lens = [float(matrix[row, column]) for row, column in ((0, 0), (1, 1), (0, 2), (1, 2))]
            _intrinsics(self._lens, MATRIX_SIZE)
        rows = fields.parse_table(read_index(self._source, ODOMETRY), self._label)
        header = [column.lower() for column in rows[0]] if rows else []
        missing = [column for column in COLUMNS if column not in header]
        if missing:
            raise CaptureError(
                f"{self._label}: its first line lacks the columns {', '.join(missing)}; "
                f"it has {', '.join(header)[:200]}"
            )
        self._at = {column: header.index(column) for column in header}
        self._rows = rows[1:]
        self.count = len(self._rows)
        if self.count > MAX_FRAMES:
            raise CaptureError(f"{self._label}: has {self.count} rows; up to {MAX_FRAMES} are read")
        self._count_noted = False

    def name_of(self, index: int) -> str:
        """Return the odometry file and the line (the header is line 1)."""
        return f"{self._label}: line {index + 2}"

    def timestamps(self) -> list[float | None]:
        """Return the times of the odometry's rows."""
        at = self._at["timestamp"]
        return [fields.time(row[at]) if at < len(row) else None for row in self._rows]

    @contextmanager
    def records(self) -> Generator[ReadRecord]:
        """Hold the video open for one pass; reading records in order decodes it once."""
        with VideoFrames(self._video, self._source.label(VIDEO), whole=True) as video:
            self._note_count(len(video.times_s))
            yield lambda index: self._read(index, video)

    def _note_count(self, pictures: int) -> None:
        """Note, once, a video that has not one picture for each row."""
        if pictures == self.count or self._count_noted:
            return
        self._count_noted = True
        text = f"{self._source.label(VIDEO)}: {pictures} pictures for {self.count} rows of {ODOMETRY}"
        lost = "; the first may be lost, as where the video was encoded again: all are then one too late"
        effect = f"each row takes the picture of its number{lost if pictures == self.count - 1 else ''}"
        self.notes.append(Note(text, effect, f"use the {VIDEO} that the app exported"))

    def _read(self, index: int, video: VideoFrames) -> RawFrame:
        row = self._rows[index]
        with fields.naming(self.name_of(index), FrameError):
            number = self._value(row, "frame")
            if number != int(number) or not 0 <= number <= MAX_FRAMES:
                raise ValueError(f"frame {number:g} is not a frame number")
            number = int(number)
            values = fields.coordinates([self._value(row, column) for column in COLUMNS[2:]], "the pose")
            pose = pose_from_quaternion(values[3:], values[:3])
            lens = self._lens
            if all(name in self._at for name in ("fx", "fy", "cx", "cy")):
                lens = [self._value(row, name) for name in ("fx", "fy", "cx", "cy")]
        depth_name = f"depth/{number:06d}.png"
        if not self._source.has(depth_name) and self._source.has(f"depth/{number:06d}.npy"):
            depth_name = f"depth/{number:06d}.npy"
        depth_label, depth_m = None, None
        if self._reads_depth:
            depth_label = self._source.label(depth_name)
            depth_m = decode_depth_map(self._source.read(depth_name), depth_label, unit_m=self._unit_m)
        confidence, confidence_name = None, f"confidence/{number:06d}.png"
        if self._reads_depth and self._source.has(confidence_name):
            confidence = decode_confidence(self._source.read(confidence_name), self._source.label(confidence_name))
        picture = video.frame(number)
        height, width = picture.image.shape[:2]
        with fields.naming(f"{self._source.label(VIDEO)}: frame {number}", FrameError):
            intrinsics = _scaled(lens, width=width, height=height)
        return RawFrame(
            name=f"{self._source.label(VIDEO)}: frame {number}",
            picture=picture,
            depth_m=np.zeros((height, width), np.float32) if depth_m is None else depth_m,
            depth_name=depth_label,
            intrinsics=intrinsics,
            pose=pose,
            confidence=confidence,
        )

    def _value(self, row: list[str], column: str) -> float:
        at = self._at[column]
        if at >= len(row):
            raise ValueError(f"has {len(row)} values; {column} is missing")
        try:
            return fields.number(float(row[at]), column)
        except ValueError as error:
            raise ValueError(f"{column} is {row[at][:40]!r}, not a finite number") from error


def _scaled(lens: list[float], *, width: int, height: int) -> Intrinsics:
    """Scale K to the video's size. Raises ValueError when the aspect ratios differ."""

    def off_centre(size: tuple[int, int]) -> float:
        return abs(lens[2] / size[0] - 0.5) + abs(lens[3] / size[1] - 0.5)

    size = min((MATRIX_SIZE, (width, height)), key=off_centre)
    if abs(size[0] / size[1] - width / height) > 0.03 * width / height:
        raise ValueError(
            f"the video is {width} x {height} but {MATRIX} is for {size[0]} x {size[1]}: "
            "another aspect ratio, so the intrinsics do not fit"
        )
    return _intrinsics(lens, size).resized(width, height)


def _intrinsics(lens: list[float], size: tuple[int, int]) -> Intrinsics:
    return Intrinsics(lens[0], lens[1], lens[2], lens[3], size[0], size[1])
