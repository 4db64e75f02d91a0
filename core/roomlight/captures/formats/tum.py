"""TUM RGB-D: `rgb.txt`, `depth.txt` (lines of `time file`) and `groundtruth.txt` (`time tx ty tz qx qy qz qw`).

The three streams have clocks of their own: each colour image takes the depth and the pose nearest in time, at
most 0.02 s away (the data set's own tool does the same); without them it is a bad frame. Times in nanoseconds, as
ORB-SLAM3 writes them, are recognised by their size or steps. Without a `depth.txt` depth is estimated. Without a
`rgb.txt` both are the lines of `associations.txt`, `association.txt` or `associate.txt` (`time file time file`, colour
or depth first).

ICL-NUIM names its poses `NAME.gt.freiburg`. They are those of a world with y up and a camera with y up (a left-handed
system), while its pictures are stored from the top: the y axes are turned round here. Its K is 481.2, 480, 319.5,
239.5, and its times are numbers of frames, 30 a second.

Bonn RGB-D Dynamic (`rgbd_bonn_*`) has the files too, but poses of markers on the camera: it is refused.

Conventions: camera-to-world, OpenCV camera, world z-up (motion capture). Depth is uint16 in 1/5000 m. K is
`camera-intrinsics.txt` (3 x 3) or ETH3D's `calibration.txt` (`fx fy cx cy`, and the lens as DROID-SLAM has it: some or
all of `k1 k2 p1 p2 k3 k4 k5 k6`) if one exists, else the data set's default of 525, 525, 319.5, 239.5 for 640 x 480,
scaled to images of that aspect. K has pixel centres at whole numbers, so that half a pixel is added here.
"""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics, pose_from_quaternion
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame
from roomlight.captures.decoding import read_rgbd
from roomlight.captures.formats.listed import ListedReader
from roomlight.captures.formats.seven_scenes import INTRINSICS, assumed_camera, intrinsics_of, read_matrix
from roomlight.captures.lenses import COEFFICIENTS, Lens, lens_of, straightened
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import MAX_FRAMES, read_index
from roomlight.captures.times import in_seconds, nearest
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource
from roomlight.notes import Note

MAX_GAP_S: Final = 0.02
"""Largest time between a colour image and its depth or pose; cameras and tracker run at 30 and 100 Hz."""

PAIRS: Final = ("associations.txt", "association.txt", "associate.txt")
ETH3D_INTRINSICS: Final = "calibration.txt"
ICL_POSES: Final = ".gt.freiburg"
_DEFAULT_CAMERA: Final = Intrinsics(525.0, 525.0, 320.0, 240.0, 640, 480)
_ICL_CAMERA: Final = Intrinsics(481.2, 480.0, 320.0, 240.0, 640, 480)
_ICL_RATE: Final = 30
_BONN: Final = "rgbd_bonn_"
_Y_TURNED: Final = np.diag([1.0, -1.0, 1.0, 1.0])


def pose_file(source: FolderSource) -> str:
    """Return the file of poses; `groundtruth.txt` where there is none."""
    stated = [] if source.has("groundtruth.txt") else source.names()
    return next((name for name in stated if name.endswith(ICL_POSES)), "groundtruth.txt")


class TumReader(ListedReader):
    """Reads a sequence folder of the TUM RGB-D benchmark."""

    format = "tum"
    conventions = PoseConventions("opencv", "camera-to-world", (0.0, 0.0, 1.0))

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        if folder.absolute().name.startswith(_BONN):
            raise CaptureError(
                f"{folder}: poses of Bonn RGB-D Dynamic are those of markers; write the camera's (T_ros P T_ros T_m, "
                f"by the data set's page) into groundtruth.txt, and name the folder without {_BONN}"
            )
        source = FolderSource(folder)
        notes: list[Note] = []
        pairs = next(filter(source.has, PAIRS), None)
        if source.has("rgb.txt"):
            self._times = _stream(source, "rgb.txt", notes)
            has_depth = options.depth != "network" and source.has("depth.txt")
            self._depth = _stream(source, "depth.txt", notes) if has_depth else None
        elif pairs is not None:
            self._times, self._depth = (_stream(source, pairs, notes, half=half) for half in (0, 1))
        else:
            raise CaptureError(f"{folder}: has no list of its pictures; write it as rgb.txt (time file)")
        self._pose_file = pose_file(source)
        if not source.has(self._pose_file):
            trajectories = (name for name in source.names() if re.search(r"rajectory.*\.txt$", name))
            stated = next(trajectories, "the trajectory")
            raise CaptureError(
                f"{folder}: has no poses; save {stated} as {self._pose_file} (time tx ty tz qx qy qz qw)"
            )
        self._poses = _stream(source, self._pose_file, notes, most=50 * MAX_FRAMES)
        super().__init__(folder, options, [name for _, name in self._times], expected="rgb.txt")
        self.notes.extend(dict.fromkeys(notes))
        self._icl = self._pose_file.endswith(ICL_POSES)
        if self._icl:
            self.conventions = PoseConventions("opencv", "camera-to-world", (0.0, -1.0, 0.0))
        default = _ICL_CAMERA if self._icl else _DEFAULT_CAMERA
        self._lens = Lens()
        if source.has(INTRINSICS):
            self._matrix = read_matrix(source)
        else:
            self._matrix, self._lens = _calibration(source, default)
        if isinstance(self._matrix, Intrinsics):
            self.notes.append(assumed_camera(folder, self._matrix))

    def timestamps(self) -> list[float | None]:
        """Return the colour images' times."""
        return [time / _ICL_RATE if self._icl else time for time, _ in self._times]

    def _read(self, index: int) -> RawFrame:
        (time_s, colour_name), label = self._times[index], self.name_of(index)
        depth = self._depth if self._reads_depth else None
        depth_name = None if depth is None else _nearest(depth, time_s, f"{label}: depth (depth.txt)")
        pose_line = _nearest(self._poses, time_s, f"{label}: pose ({self._pose_file})")
        with fields.naming(f"{self._source.label(self._pose_file)}: near {time_s}", FrameError):
            values = fields.coordinates(fields.numbers_of_line(pose_line, 7, "the pose"), "the pose")
            pose = pose_from_quaternion(values[3:], values[:3])
            pose = _Y_TURNED @ pose @ _Y_TURNED if self._icl else pose
        picture, depth_m = read_rgbd(self._source, colour_name, depth_name, unit_m=self._unit_m, integer_m=1 / 5000)
        height, width = picture.image.shape[:2]
        with fields.naming(label, FrameError):
            intrinsics = intrinsics_of(self._matrix, width=width, height=height, shift=0.5)
            picture, depth_m, camera, stated = straightened(picture, depth_m, intrinsics, self._lens, label)
        return replace(self._raw_frame(index, picture, depth_m, depth_name, camera, pose), stated=stated)


def _calibration(source: FolderSource, default: Intrinsics) -> tuple[Float[np.ndarray, "3 3"] | Intrinsics, Lens]:
    """Return the K and the lens of `calibration.txt`; the default without it. Raises CaptureError."""
    if not source.has(ETH3D_INTRINSICS):
        return default, Lens()
    label = source.label(ETH3D_INTRINSICS)
    text = " ".join(fields.parse_text(read_index(source, ETH3D_INTRINSICS), label))
    with fields.naming(label, CaptureError):
        values = fields.numbers_of_line(text, 4, "fx fy cx cy", more=True)
        fx, fy, cx, cy = (fields.positive(value, "fx, fy, cx or cy") for value in values[:4])
        if len(values) > 4 + len(COEFFICIENTS):
            raise ValueError(f"holds {len(values)} numbers, more than fx fy cx cy {' '.join(COEFFICIENTS)}")
        lens = lens_of(dict(zip(COEFFICIENTS, values[4:], strict=False)), {})
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), lens


def _stream(
    source: FolderSource, name: str, notes: list[Note], *, most: int = MAX_FRAMES, half: int | None = None
) -> list[tuple[float, str]]:
    """Return (seconds, rest of the line) for each line that is not a comment, in order of time.

    Of pairs, `half` is 0 for colour, 1 for depth.
    """

    def entry(line: str) -> tuple[float, str]:
        line = re.sub(r"^(\s*\d+),(\d+[\s;])", r"\1.\2", line)  # a decimal comma
        if half is not None:
            line = _half(line, half)
        first, rest = [*re.split(r"[\s,;]+", line.strip(), maxsplit=1), ""][:2]
        time_s = fields.time(first)
        if time_s is None or math.isnan(time_s):
            raise ValueError(f"starts with {first[:40]!r}, not with a time")
        return time_s, fields.text(rest.strip(), "what follows the time")

    label = source.label(name)
    entries = fields.parsed_lines(read_index(source, name), label, entry, notes)
    if len(entries) > most:
        raise CaptureError(f"{label}: lists {len(entries)} entries; up to {most} are read")
    if not entries:
        raise CaptureError(f"{label}: lists nothing")
    entries.sort()
    times = in_seconds([time for time, _ in entries], label, notes)
    return list(zip(times, [rest for _, rest in entries], strict=True))


def _half(line: str, half: int) -> str:
    words = re.split(r"[\s,;]+", line.strip())
    if len(words) < 4:
        raise ValueError(f"is {line[:60]!r}, not a time and a file of colour and of depth")
    return " ".join(sorted((words[:2], words[2:4]), key=lambda pair: "depth" in pair[1].lower())[half])


def _nearest(entries: list[tuple[float, str]], time_s: float, what: str) -> str:
    near = entries[nearest([time for time, _ in entries], time_s)]
    gap_s = abs(near[0] - time_s)
    if gap_s > MAX_GAP_S:
        raise FrameError(f"{what}: the nearest in time is {gap_s:.3f} s away; at most {MAX_GAP_S} s is allowed")
    return near[1]
