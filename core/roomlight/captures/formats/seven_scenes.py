"""7-Scenes, and BundleFusion's and 12-Scenes' recordings, which have `info.txt` beside or above the frames.

Files are `frame-XXXXXX.color.png|jpg`, `.depth.png|pgm`, `.pose.txt`, optionally `camera-intrinsics.txt`, also above
`seq-XX`, `rgbd-frames` (3DMatch, SUN3D) or `data`.

Conventions: 4 x 4 camera-to-world, OpenCV camera. The world is the first camera's or another fit's. Up is the opposite
of `gravity-direction.txt` (three numbers); without that file the world is assumed to be an upright OpenCV camera's, up
= -y, which is noted. Depth is uint16 millimetres, 0 and 65535 unknown. K is used unchanged, with pixel centres at half
integers; one of a file has no size and must fit the image, and depth is the colour camera's. Without a file the
cameras are the data set's Kinect, as ACE and DSAC* take it: for 640 x 480 the principal point is 320, 240, the focal
length 525 of colour and 585 of depth, and poses are the depth camera's; K is scaled to images of that aspect alone.
`info.txt`, in 3RScan `_info.txt`, is the header of a `.sens` as text: both cameras, their sizes and the unit of depth
are read as ScanNet's; `camera-intrinsics.txt` goes before its K.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics, rigid_inverse
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame
from roomlight.captures.decoding import intrinsics_without_size, read_rgbd, registered
from roomlight.captures.formats.listed import ListedReader
from roomlight.captures.formats.scannet import between, camera_of, in_colour
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import read_index
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource
from roomlight.notes import Note

INTRINSICS: Final = "camera-intrinsics.txt"
GRAVITY: Final = "gravity-direction.txt"
_BELOW: Final = re.compile(r"seq-\d+|rgbd-frames|data")
"""Folders of frames that have the files of their camera above them."""
_RECORD: Final = re.compile(r"(frame-\d{1,9})\.(color|depth|pose)\.(png|jpg|jpeg|pgm|txt)", re.IGNORECASE)
_COLOUR_CAMERA: Final = Intrinsics(525.0, 525.0, 320.0, 240.0, 640, 480)
_DEPTH_CAMERA: Final = Intrinsics(585.0, 585.0, 320.0, 240.0, 640, 480)
_DEPTH_TO_COLOUR: Final = np.array(
    [
        [0.99996518, 0.00267651, -0.00790410, -0.02555894],
        [-0.00274093, 0.99996303, -0.00815045, 0.00010110],
        [0.00788199, 0.00817183, 0.99993555, 0.00203183],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
"""Of a Kinect, measured at LIRIS."""
_COLOUR_K: Final = "m_calibrationColorIntrinsic"


@dataclass(frozen=True)
class _Sensor:
    """What `info.txt` states; NaN in the K of a depth camera that it does not."""

    colour: Intrinsics
    depth_k: Float[np.ndarray, "4 4"]
    depth_to_colour: Float[np.ndarray, "4 4"]
    depth_unit_m: float


class SevenScenesReader(ListedReader):
    """Reads a sequence folder of 7-Scenes."""

    format = "seven-scenes"

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        source = FolderSource(folder)
        matches = [match for match in map(_RECORD.fullmatch, source.names()) if match]
        self._stems = sorted({match[1] for match in matches}, key=lambda stem: int(stem[6:]))
        colour, self._depth = (
            {match[1]: match[0] for match in matches if match[2].lower() == kind} for kind in ("color", "depth")
        )
        names = [colour.get(stem, f"{stem}.color.png") for stem in self._stems]
        super().__init__(folder, options, names, expected="frame-XXXXXX.color.png, .depth.png and .pose.txt")
        self._sensor = _read_sensor(folder)
        self._matrix = _COLOUR_CAMERA if self._sensor is None else self._sensor.colour
        if self._sensor is not None:
            self._unit_m = options.depth_unit_m or self._sensor.depth_unit_m
        if place := next((place for place in _places(folder) if place.has(INTRINSICS)), None):
            self._matrix = read_matrix(place)
        elif self._sensor is None:
            beside = "; depth and poses are those of its depth camera, 26 mm beside"
            self.notes.append(assumed_camera(folder, _COLOUR_CAMERA, beside))
        self.conventions = PoseConventions("opencv", "camera-to-world", self._up())
        if options.world_up is None and not source.has(GRAVITY):
            effect = "up is taken for the first camera's, the opposite of the y axis: wrong by as much as it was tilted"
            self.notes.append(Note(f"{folder}: no {GRAVITY}", effect, "state world_up (--world-up), or write the file"))

    def _read(self, index: int) -> RawFrame:
        stem, label = self._stems[index], self.name_of(index)
        pose_name, has_depth = f"{stem}.pose.txt", self._reads_depth and len(self._depth) > 0
        depth_name = self._depth.get(stem, f"{stem}.depth.png") if has_depth else None
        pose_label = self._source.label(pose_name)
        pose_data = self._source.read(pose_name, max_bytes=65536)
        with fields.naming(pose_label, FrameError):
            pose = fields.matrix_of_text(pose_data, 4, pose_label)
            if not np.isfinite(pose).all():
                raise ValueError("the pose holds NaN or infinity (lost tracking)")
        picture, depth_m = read_rgbd(self._source, self._colour[index], depth_name, unit_m=self._unit_m)
        height, width = picture.image.shape[:2]
        with fields.naming(label, FrameError):
            intrinsics = intrinsics_of(self._matrix, width=width, height=height)
        if self._matrix is _COLOUR_CAMERA:
            pose = pose @ rigid_inverse(_DEPTH_TO_COLOUR)
            if depth_name is not None:
                with fields.naming(self._source.label(depth_name), FrameError):
                    intrinsics_of(_DEPTH_CAMERA, width=depth_m.shape[1], height=depth_m.shape[0])
                depth_m = registered(depth_m, _DEPTH_CAMERA, intrinsics, _DEPTH_TO_COLOUR)
        elif depth_name is not None and (sensor := self._sensor) is not None:
            depth_m = in_colour(depth_m, sensor.depth_k, intrinsics, sensor.depth_to_colour)
        return self._raw_frame(index, picture, depth_m, depth_name, intrinsics, pose)

    def _up(self) -> tuple[float, float, float]:
        if not self._source.has(GRAVITY):
            return 0.0, -1.0, 0.0
        label = self._source.label(GRAVITY)
        lines = fields.parse_text(read_index(self._source, GRAVITY), label)
        with fields.naming(label, CaptureError):
            values = fields.coordinates(fields.numbers_of_line(" ".join(lines), 3, "gravity"), "gravity")
            x, y, z = (-fields.number(value, "gravity") for value in values.tolist())
            if x * x + y * y + z * z < 1e-12:
                raise ValueError("gravity is zero; delete the file or set world_up")
        return x, y, z


def intrinsics_of(
    known: Float[np.ndarray, "3 3"] | Intrinsics, *, width: int, height: int, shift: float = 0.0
) -> Intrinsics:
    """Return the camera of an image of this size by the K of a file, or the data set's own at another size.

    Raises:
        ValueError: K is for another size, or the data set's pictures have another aspect.
    """
    if not isinstance(known, Intrinsics):
        return intrinsics_without_size(known, width=width, height=height, shift=shift)
    if abs(width * known.height - height * known.width) > known.width:
        raise ValueError(
            f"the image is {width} x {height}, and the data set's focal length is for {known.width} x {known.height} "
            f"and its aspect alone; write {INTRINSICS}, 3 x 3, with this camera's"
        )
    return known.resized(width, height)


def _places(folder: Path) -> list[FolderSource]:
    """Return where the files of a folder's camera may be."""
    folder = folder.absolute()  # `.` has no name
    return [FolderSource(place) for place in ([folder, folder.parent] if _BELOW.fullmatch(folder.name) else [folder])]


def _read_sensor(folder: Path) -> _Sensor | None:
    """Read `info.txt` or `_info.txt`, beside or above the frames; None without a camera in it."""
    for source, name in ((source, name) for source in _places(folder) for name in ("info.txt", "_info.txt")):
        if not source.has(name):
            continue
        label = source.label(name)
        pairs = (line.partition("=") for line in fields.parse_text(read_index(source, name), label))
        stated = {key.strip(): value for key, _, value in pairs}
        if _COLOUR_K in stated:
            with fields.naming(label, CaptureError):
                return _sensor(stated)
    return None


def _sensor(stated: dict[str, str]) -> _Sensor:
    def values(key: str, count: int, default: str = "") -> list[float]:
        return fields.numbers_of_line(stated.get(key, default), count, key)

    def matrix(name: str) -> Float[np.ndarray, "4 4"]:
        key = f"m_calibration{name}"
        return fields.coordinates(values(key, 16, "nan " * 16), key).reshape(4, 4)

    width, height = (fields.pixels(values(key, 1)[0], key) for key in ("m_colorWidth", "m_colorHeight"))
    shift = fields.positive(values("m_depthShift", 1, "1000")[0], "m_depthShift")
    return _Sensor(
        camera_of(matrix("ColorIntrinsic"), (width, height)),
        matrix("DepthIntrinsic"),
        between(matrix("ColorExtrinsic"), matrix("DepthExtrinsic")),
        fields.unit(1 / shift, "1 / m_depthShift"),
    )


def assumed_camera(folder: Path, camera: Intrinsics, more: str = "") -> Note:
    """Make the note for a data set's own K in place of one that no file states."""
    text = f"a focal length of {camera.fx:g} pixels for a width of {camera.width} is assumed, the data set's own{more}"
    return Note(f"{folder}: no {INTRINSICS}", text, f"write {INTRINSICS}, 3 x 3, for another camera")


def read_matrix(source: FolderSource) -> Float[np.ndarray, "3 3"]:
    """Read K from `camera-intrinsics.txt`. Raises CaptureError for values that are not positive numbers."""
    label = source.label(INTRINSICS)
    data = read_index(source, INTRINSICS)
    with fields.naming(label, CaptureError):
        matrix = fields.matrix_of_text(data, 3, label)
        for name, place in {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)}.items():
            fields.positive(float(matrix[place]), name)
    return matrix
