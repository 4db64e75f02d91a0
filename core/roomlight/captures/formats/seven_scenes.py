"""7-Scenes, and BundleFusion's and 12-Scenes' recordings, which have `info.txt` beside or above the frames.

Files are `frame-XXXXXX.color.png|jpg`, `.depth.png`, `.pose.txt`, optionally `camera-intrinsics.txt`.

Conventions: 4 x 4 camera-to-world, OpenCV camera. The world is the first camera's or another fit's. Up is the opposite
of `gravity-direction.txt` (three numbers); without that file the world is assumed to be an upright OpenCV camera's, up
= -y, which is noted. Depth is uint16 millimetres, 0 and 65535 unknown. K is used unchanged, with pixel centres at half
integers: the data set's default of 585, 585, 320, 240 for 640 x 480 puts the principal point at the centre of the
image; it is scaled to images of that aspect, and none other. A K of a file has no size and must fit the image.
`info.txt`, in 3RScan `_info.txt`, is the header of a `.sens` as text: both cameras, their sizes and the unit of depth
are read as ScanNet's; `camera-intrinsics.txt` goes before its K.
A `.depth.pgm`, as 3RScan has it, is refused and not taken for missing depth.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame
from roomlight.captures.decoding import Rgbd, intrinsics_without_size, read_rgbd
from roomlight.captures.formats.listed import ListedReader
from roomlight.captures.formats.scannet import between, camera_of, in_colour
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import read_index
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource
from roomlight.notes import Note

INTRINSICS: Final = "camera-intrinsics.txt"
GRAVITY: Final = "gravity-direction.txt"
_RECORD: Final = re.compile(r"(frame-\d{1,9})\.(color|depth|pose)\.(png|jpg|jpeg|pgm|txt)", re.IGNORECASE)
_DEFAULT_CAMERA: Final = Intrinsics(585.0, 585.0, 320.0, 240.0, 640, 480)
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
        self._matrix = _DEFAULT_CAMERA if self._sensor is None else self._sensor.colour
        if self._sensor is not None:
            self._unit_m = options.depth_unit_m or self._sensor.depth_unit_m
        if source.has(INTRINSICS):
            self._matrix = read_matrix(source)
        elif self._sensor is None:
            self.notes.append(assumed_camera(folder, _DEFAULT_CAMERA))
        self.conventions = PoseConventions("opencv", "camera-to-world", self._up())
        if options.world_up is None and not source.has(GRAVITY):
            effect = "up is taken for the first camera's, the opposite of the y axis: wrong by as much as it was tilted"
            self.notes.append(Note(f"{folder}: no {GRAVITY}", effect, "state world_up (--world-up), or write the file"))

    def _read(self, index: int) -> RawFrame:
        stem, label = self._stems[index], self.name_of(index)
        depth_name, pose_name = self._depth.get(stem, f"{stem}.depth.png") if self._depth else None, f"{stem}.pose.txt"
        pose_label = self._source.label(pose_name)
        pose_data = self._source.read(pose_name, max_bytes=65536)
        with fields.naming(pose_label, FrameError):
            pose = fields.matrix_of_text(pose_data, 4, pose_label)
            if not np.isfinite(pose).all():
                raise ValueError("the pose holds NaN or infinity (lost tracking)")
        read = read_rgbd(self._source, self._colour[index], depth_name, unit_m=self._unit_m)
        height, width = read.picture.image.shape[:2]
        with fields.naming(label, FrameError):
            intrinsics = intrinsics_of(self._matrix, width=width, height=height)
        if depth_name is not None and (sensor := self._sensor) is not None:
            depth_m = in_colour(read.depth_m, sensor.depth_k, intrinsics, sensor.depth_to_colour)
            read = Rgbd(read.picture, depth_m)
        return self._raw_frame(index, read, depth_name, intrinsics, pose)

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


def _read_sensor(folder: Path) -> _Sensor | None:
    """Read `info.txt` or `_info.txt`, or 12-Scenes' one above the folder `data`; None without a camera in it."""
    sources = [FolderSource(folder), *([FolderSource(folder.parent)] if folder.name == "data" else [])]
    for source, name in ((source, name) for source in sources for name in ("info.txt", "_info.txt")):
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


def assumed_camera(folder: Path, camera: Intrinsics) -> Note:
    """Make the note for a data set's own K in place of one that no file states."""
    text = f"a focal length of {camera.fx:g} pixels for a width of {camera.width} is assumed, the data set's own"
    return Note(f"{folder}: no {INTRINSICS}", text, f"write {INTRINSICS}, 3 x 3, for another camera")


def read_matrix(source: FolderSource) -> Float[np.ndarray, "3 3"]:
    """Read K from `camera-intrinsics.txt`. Raises CaptureError for values that are not positive numbers."""
    label = source.label(INTRINSICS)
    data = read_index(source, INTRINSICS)
    with fields.naming(label, CaptureError):
        matrix = fields.matrix_of_text(data, 3, label)
        fields.positive(float(matrix[0, 0]), "fx")
        fields.positive(float(matrix[1, 1]), "fy")
        fields.positive(float(matrix[0, 2]), "cx")
        fields.positive(float(matrix[1, 2]), "cy")
    return matrix
