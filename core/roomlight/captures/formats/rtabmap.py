"""RTAB-Map's export: `NAME_rgb/STEM.jpg`, `NAME_depth/STEM.png`, `NAME_confidence/STEM.png`, `NAME_calib/STEM.yaml`,
`NAME_camera_poses.txt`.

`rtabmap-export --images --poses_camera` writes these; the database viewer writes the folders without `NAME_`. STEM is
the time of the node, or its number with `--images_id`.

Conventions: a line of the poses is `time x y z qx qy qz qw [number]` (formats 10 and 11): camera-to-world, OpenCV
camera, world z-up. `NAME_poses.txt` is the robot's path and takes the `local_transform` of the calibration. Images
are rectified, so that the projection matrix counts and distortion does not. Pixel centres are at whole numbers, so
that half a pixel is added. Depth is uint16 millimetres of any size. Confidence is in percent, of an
iPhone ARKit's level times 50: from 50 it is medium, at 100 high.
"""

import re
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics, pose_from_quaternion
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame
from roomlight.captures.decoding import read_rgbd
from roomlight.captures.formats.listed import ListedReader, files_of
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import read_index
from roomlight.captures.times import nearest
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource
from roomlight.notes import Note

_SAME_TIME_S: Final = 0.001
_FISHEYE: Final = re.compile(r'^distortion_model:\s*"?(equidistant|fisheye)', re.MULTILINE)
_CAMERA_POSES, _ROBOT_POSES = "camera_poses.txt", "poses.txt"


def export_name(source: FolderSource) -> str | None:
    """Return what the names of an export begin with, such as `room_`; None if the folder holds none."""
    for name in (name for name in source.names() if name[0] != "."):
        prefix = name.removesuffix("calib")
        if prefix != name and source.has(f"{prefix}rgb") and _poses_name(source, prefix) is not None:
            return prefix
    return None


class RtabmapReader(ListedReader):
    """Reads a folder that RTAB-Map exported."""

    format = "rtabmap"
    conventions = PoseConventions("opencv", "camera-to-world", (0.0, 0.0, 1.0))

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        source = FolderSource(folder)
        prefix = export_name(source)
        poses_name = None if prefix is None else _poses_name(source, prefix)
        if prefix is None or poses_name is None:
            raise CaptureError(f"{folder}: has no rgb, calib and camera_poses.txt of rtabmap-export")
        colour = files_of(source, f"{prefix}rgb", (".jpg", ".jpeg", ".png"))
        super().__init__(folder, options, colour, expected=f"{prefix}rgb/*.jpg", depth=f"{prefix}depth")
        self._prefix, self._robot = prefix, not poses_name.endswith(_CAMERA_POSES)
        self._distortion_noted = False
        self._by_number: dict[int, tuple[float, Float[np.ndarray, "4 4"] | str]] = {}
        self._by_time: list[tuple[float, Float[np.ndarray, "4 4"] | str]] = []
        label = source.label(poses_name)
        fields.parsed_lines(read_index(source, poses_name), label, self._add, self.notes)
        if not self._by_time:
            raise CaptureError(f"{label}: has no pose")
        self._by_time.sort(key=lambda entry: entry[0])
        self._times = [time_s for time_s, _ in self._by_time]

    def timestamps(self) -> list[float | None]:
        """Return the nodes' times."""
        return [None if node is None else node[0] for node in map(self._node, self._colour)]

    def _add(self, line: str) -> None:
        if len(line.split()) == 12:
            raise ValueError("the pose is a matrix without a time; export it with --poses_format 11")
        values = fields.numbers_of_line(line, 8, "the pose (export it with --poses_format 11)")
        time_s = fields.number(values[0], "the time")
        try:
            numbers = fields.coordinates(values[1:], "the pose")
            pose: Float[np.ndarray, "4 4"] | str = pose_from_quaternion(numbers[3:], numbers[:3])
        except ValueError as error:
            pose = str(error)
        self._by_time.append((time_s, pose))
        words = line.split()
        if len(words) > 8 and re.fullmatch(r"\d{1,9}", words[8]):
            self._by_number[int(words[8])] = time_s, pose

    def _node(self, colour_name: str) -> tuple[float, Float[np.ndarray, "4 4"] | str] | None:
        """Return the time and the pose of an image by the node's number or time in its name."""
        stem = Path(colour_name).stem
        if re.fullmatch(r"\d{1,9}", stem):
            return self._by_number.get(int(stem))
        try:
            time_s = fields.number(float(stem), "the time")
        except ValueError:
            return None
        near = self._by_time[nearest(self._times, time_s)]
        return near if abs(near[0] - time_s) <= _SAME_TIME_S else None

    def _read(self, index: int) -> RawFrame:
        colour_name, label = self._colour[index], self.name_of(index)
        stem = Path(colour_name).stem
        node = self._node(colour_name)
        with fields.naming(label, FrameError):
            if node is None:
                raise ValueError("the poses have none of its number or time; export them with --poses_format 11")
            if isinstance(node[1], str):
                raise ValueError(node[1])
        calib_name = f"{self._prefix}calib/{stem}.yaml"
        depth_name = f"{self._prefix}depth/{stem}.png" if self._reads_depth else None
        calib_label = self._source.label(calib_name)
        text = "\n".join(fields.parse_text(self._source.read(calib_name, max_bytes=65536), calib_label))
        with fields.naming(calib_label, FrameError):
            intrinsics = _intrinsics(text)
            pose = node[1] @ _local_transform(text) if self._robot else node[1]
        distorted = any(_matrix(text, "distortion_coefficients") or []) or _FISHEYE.search(text)
        if distorted and not self._distortion_noted:
            self._distortion_noted = True
            effect = "images are taken for rectified, as RTAB-Map stores them"
            self.notes.append(Note(f"{calib_label}: the lens distortion", effect, "undistort raw images first"))
        picture, depth_m = read_rgbd(self._source, colour_name, depth_name, unit_m=self._unit_m)
        percent = self._confidence(f"{self._prefix}confidence/{stem}.png")
        confidence = None if percent is None else percent // np.uint8(50)
        return self._raw_frame(index, picture, depth_m, depth_name, intrinsics, pose, confidence)


def _poses_name(source: FolderSource, prefix: str) -> str | None:
    names = (f"{prefix}{_CAMERA_POSES}", f"{prefix}{_ROBOT_POSES}")
    return next((name for name in names if source.has(name)), None)


def _intrinsics(text: str) -> Intrinsics:
    sizes = [re.search(rf"^image_{side}:\s*(\d+)", text, re.MULTILINE) for side in ("width", "height")]
    projection, k = _matrix(text, "projection_matrix"), _matrix(text, "camera_matrix")
    if not all(sizes) or (k is None and projection is None):
        raise ValueError("has no image_width, image_height and camera_matrix")
    width, height = (fields.pixels(int(size[1][:9]), "the size") for size in sizes if size)
    if projection is not None and len(projection) == 12 and projection[0] > 0:
        fx, fy, cx, cy = (projection[at] for at in (0, 5, 2, 6))
    elif k is not None and len(k) == 9:
        fx, fy, cx, cy = (k[at] for at in (0, 4, 2, 5))
    else:
        raise ValueError("its camera_matrix is not 3 x 3")
    return Intrinsics(fx, fy, cx + 0.5, cy + 0.5, width, height)


def _local_transform(text: str) -> Float[np.ndarray, "4 4"]:
    values = _matrix(text, "local_transform")
    if values is None or len(values) != 12:
        raise ValueError("has no local_transform of the camera on the robot; export with --poses_camera")
    return np.vstack([np.array(values).reshape(3, 4), [0, 0, 0, 1]])


def _matrix(text: str, key: str) -> list[float] | None:
    """Return the numbers of a matrix in OpenCV's YAML; None if there is none of this name."""
    match = re.search(rf"^{key}:[^\[]{{0,200}}data:\s*\[([^\]]{{1,2000}})\]", text, re.MULTILINE)
    if match is None:
        return None
    return [fields.number(value, key) for value in fields.numbers_of_line(match[1], match[1].count(",") + 1, key)]
