"""Captures described by a `transforms.json`: nerfstudio, instant-ngp, nerf-synthetic, NeRFCapture.

Schema: `frames: [{file_path, depth_file_path | depth_path, transform_matrix, timestamp?, intrinsics?}]`;
intrinsics `fl_x fl_y cx cy w h` per frame or once, or `camera_angle_x`. Colour names may lack their suffix.

Conventions: camera-to-world, OpenGL camera. The world is z-up (nerfstudio), unless the file has `world_up`
(x, y, z, -x, -y, -z or three numbers), or is NeRFCapture's (it alone has `depth_path` or `*integer_*scale`
keys), whose world is ARKit's, y-up. cx and cy are used unchanged: pixel centres at half integers, as
nerfstudio and ARKit have them.

Depth: uint16 PNG or .npy times the unit, or float EXR in metres. The unit is `depth_unit_scale_factor`, or
`integer_depth_scale` (metres a step, NeRFCapture's script), else 0.001. NeRFCapture's app writes a
placeholder of 1.0 as `depth_integer_scale`; a unit of 0.1 m and more is therefore ignored there.

Frames are put in order of `timestamp` if all have one, else of the numbers in their file names, as
nerfstudio does. `probes: [{position, file_path}]` are ground-truth panoramas in the same world. Lens
distortion (`k1..k4, p1, p2`; OPENCV and OPENCV_FISHEYE) is removed.
"""

import math
import re
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from roomlight.camera import Intrinsics
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame, RawProbe, ReadRecord
from roomlight.captures.decoding import read_rgbd, undistorted
from roomlight.captures.options import CaptureOptions, up_vector
from roomlight.captures.source import MAX_FRAMES, FolderSource, read_index
from roomlight.errors import CaptureError, FrameError

INDEX: Final = "transforms.json"
_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".exr")
_DISTORTION: Final = ("k1", "k2", "p1", "p2", "k3", "k4")
_NERFCAPTURE_SCALES: Final = ("integer_depth_scale", "depth_integer_scale")


class NerfstudioReader:
    """Reads a folder with a `transforms.json`."""

    format = "nerfstudio"

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        """Read and check the index.

        Raises:
            CaptureError: The index is missing or damaged, so that no frame can be read.
        """
        self._source = FolderSource(folder)
        self._label = self._source.label(INDEX)
        self._shared = fields.parse_json(read_index(self._source, INDEX), self._label)
        with fields.naming(self._label, CaptureError):
            self._frames = _in_order(fields.objects(self._shared.get("frames"), "frames"))
            self._nerfcapture = any(key in self._shared for key in _NERFCAPTURE_SCALES) or any(
                "depth_path" in frame for frame in self._frames
            )
            self.conventions = PoseConventions("opengl", "camera-to-world", self._world_up())
            self._unit_m = options.depth_unit_m or self._depth_unit()
            self.probes = [self._probe(entry) for entry in fields.objects(self._shared.get("probes", []), "probes")]
        if len(self._frames) > MAX_FRAMES:
            raise CaptureError(f"{self._label}: lists {len(self._frames)} frames; up to {MAX_FRAMES} are read")
        self.count = len(self._frames)
        self._depth_keys = self._choose_depth(options.depth_key)
        self._refuse_broken_lens()

    def name_of(self, index: int) -> str:
        """Return the colour file as the index names it."""
        name = self._frames[index].get("file_path")
        return self._source.label(name[:300]) if isinstance(name, str) else f"{self._label}: frame {index}"

    def timestamps_s(self) -> list[float]:
        """Return the frames' timestamps if all frames have one, else none."""
        times = [_time(frame) for frame in self._frames]
        return [time for time in times if time is not None] if None not in times else []

    @contextmanager
    def records(self) -> Generator[ReadRecord]:
        """Return the function that reads a record; no file is held open."""
        yield self._read

    def _read(self, index: int) -> RawFrame:
        entry = self._frames[index]
        where = f"{self._label}: frame {index}"
        with fields.naming(where, FrameError):
            pose = fields.matrix4(entry.get("transform_matrix"), "transform_matrix")
            colour_name = self._with_suffix(fields.text(entry.get("file_path"), "file_path"))
            depth_name = fields.first_of(entry, {}, *self._depth_keys)
            if depth_name is None:
                raise FrameError(f"{where}: has no depth ({' or '.join(self._depth_keys)})")
            depth_name = fields.text(depth_name, "the depth file's name")
        colour_label, depth_label = self._source.label(colour_name), self._source.label(depth_name)
        image, clipped, depth_m = read_rgbd(self._source, colour_name, depth_name, unit_m=self._unit_m)
        with fields.naming(f"{where} ({colour_label})", FrameError):
            intrinsics = self._intrinsics(entry, image.shape[1], image.shape[0])
            coefficients, fisheye = self._distortion(entry)
            if any(coefficients) and (intrinsics.width, intrinsics.height) == (
                image.shape[1],
                image.shape[0],
            ):
                views = [
                    (image, cv2.INTER_LINEAR),
                    (clipped.astype(np.uint8), cv2.INTER_NEAREST),
                    (depth_m, cv2.INTER_NEAREST),
                ]
                (image, mask, depth_m), intrinsics = undistorted(
                    views, intrinsics, coefficients=coefficients, fisheye=fisheye
                )
                clipped = mask > 0
        return RawFrame(
            name=colour_label,
            image=image,
            clipped=clipped,
            depth_m=depth_m,
            depth_name=depth_label,
            intrinsics=intrinsics,
            pose=pose,
            timestamp_s=_time(entry),
        )

    def _intrinsics(self, entry: dict[str, Any], image_width: int, image_height: int) -> Intrinsics:
        """Build intrinsics: per-frame values override global ones; a missing size is the image's."""
        stated_w, stated_h = (fields.first_of(entry, self._shared, key) for key in ("w", "h"))
        width = image_width if stated_w is None else fields.pixels(stated_w, "w")
        height = image_height if stated_h is None else fields.pixels(stated_h, "h")
        fl_x = fields.first_of(entry, self._shared, "fl_x")
        angle = fields.first_of(entry, self._shared, "camera_angle_x")
        if fl_x is not None:
            fx = fields.positive(fl_x, "fl_x")
        elif angle is not None:
            fx = 0.5 * width / math.tan(0.5 * _angle(angle))
        else:
            raise ValueError("has neither fl_x nor camera_angle_x")
        fl_y = fields.first_of(entry, self._shared, "fl_y")
        fy = fx if fl_y is None else fields.positive(fl_y, "fl_y")
        cx, cy = (fields.first_of(entry, self._shared, key) for key in ("cx", "cy"))
        return Intrinsics(
            fx,
            fy,
            0.5 * width if cx is None else fields.number(cx, "cx"),
            0.5 * height if cy is None else fields.number(cy, "cy"),
            width,
            height,
        )

    def _distortion(self, entry: dict[str, Any]) -> tuple[list[float], bool]:
        """Return the coefficients in OpenCV's order for the camera model, and whether it is the fisheye model."""
        values = {key: fields.first_of(entry, self._shared, key) for key in _DISTORTION}
        known = {key: 0.0 if value is None else fields.number(value, key) for key, value in values.items()}
        model = fields.first_of(entry, self._shared, "camera_model")
        if not any(known.values()):
            return [], False
        if max(abs(value) for value in known.values()) > 100:
            raise ValueError(f"the lens distortion {known} is out of range; coefficients are at most 100")
        if model == "OPENCV_FISHEYE":
            return [known["k1"], known["k2"], known["k3"], known["k4"]], True
        if model not in (None, "OPENCV", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_PINHOLE") or known["k4"]:
            raise ValueError(f"camera_model {model!r} with distortion is not read; undistort the images first")
        return [known["k1"], known["k2"], known["p1"], known["p2"], known["k3"]], False

    def _refuse_broken_lens(self) -> None:
        """Refuse the capture if its global intrinsics are invalid and some frame needs them."""
        with fields.naming(self._label, CaptureError):
            for key in ("fl_x", "fl_y"):
                if self._shared.get(key) is not None and not all(key in frame for frame in self._frames):
                    fields.positive(self._shared[key], key)
            for key in ("w", "h"):
                if self._shared.get(key) is not None and not all(key in frame for frame in self._frames):
                    fields.pixels(self._shared[key], key)
            if self.count and not any(
                fields.first_of(frame, self._shared, "fl_x", "camera_angle_x") is not None for frame in self._frames
            ):
                raise ValueError("has no intrinsics: neither fl_x nor camera_angle_x, globally or in any frame")

    def _world_up(self) -> tuple[float, float, float]:
        stated: Any = self._shared.get("world_up")
        if stated is None:
            return up_vector("y" if self._nerfcapture else "z")
        if isinstance(stated, list):
            components = fields.vector(stated, 3, "world_up").tolist()
            x, y, z = (fields.number(value, "world_up") for value in components)
            return up_vector((x, y, z))
        return up_vector(fields.text(stated, "world_up"))

    def _depth_unit(self) -> float:
        if self._shared.get("depth_unit_scale_factor") is not None:
            return fields.unit(self._shared["depth_unit_scale_factor"], "depth_unit_scale_factor")
        for key in _NERFCAPTURE_SCALES:
            if self._shared.get(key) is not None:
                unit_m = fields.unit(self._shared[key], key)
                if unit_m < 0.1:
                    return unit_m
        return 0.001

    def _choose_depth(self, depth_key: str | None) -> tuple[str, ...]:
        keys = (depth_key,) if depth_key is not None else ("depth_file_path", "depth_path")
        if self._frames and not any(key in frame for frame in self._frames for key in keys):
            present = sorted({key for frame in self._frames for key in frame if "depth" in key})
            names = ", ".join(present)
            hint = f"its frames have {names}; set depth_key" if present else "a capture needs depth"
            raise CaptureError(f"{self._label}: no frame has {' or '.join(keys)}; {hint}")
        return keys

    def _with_suffix(self, name: str) -> str:
        """Add the existing file's suffix to a name without one (`images/0`: NeRFCapture, nerf-synthetic)."""
        if Path(name).suffix.lower() in _SUFFIXES or self._source.has(name):
            return name
        return next((name + suffix for suffix in _SUFFIXES if self._source.has(name + suffix)), name)

    def _probe(self, entry: dict[str, Any]) -> RawProbe:
        position = fields.vector(entry.get("position"), 3, "a probe's position")
        for value in position.tolist():
            fields.number(value, "a probe's position")
        name = entry.get("file_path")
        if name is None:
            return position, None
        try:
            return position, self._source.path(fields.text(name, "a probe's file_path"))
        except FrameError as error:
            raise CaptureError(f"{self._label}: a probe's panorama: {error}") from error


def _time(frame: dict[str, Any]) -> float | None:
    try:
        return fields.number(frame.get("timestamp"), "timestamp")
    except ValueError:
        return None


def _angle(value: object) -> float:
    angle = fields.positive(value, "camera_angle_x")
    if angle >= math.pi:
        raise ValueError(f"camera_angle_x is {angle} rad; it must be below pi")
    return angle


def _in_order(frames: list[dict[str, Any]]) -> list[dict[str, Any]]:
    if all(_time(frame) is not None for frame in frames):
        return sorted(frames, key=lambda frame: frame["timestamp"])
    if all(isinstance(frame.get("file_path"), str) for frame in frames):
        return sorted(frames, key=lambda frame: natural_key(frame["file_path"]))
    return frames


def natural_key(name: str) -> list[tuple[int, str]]:
    """Return a sort key that puts `9.jpg` before `10.jpg`: digits by length, then by digit; other text as is."""
    parts = re.findall(r"\d+|\D+", name)
    digits = [part.lstrip("0") if part[0].isdigit() else None for part in parts]
    return [(-1, part) if value is None else (len(value), value) for part, value in zip(parts, digits, strict=True)]
