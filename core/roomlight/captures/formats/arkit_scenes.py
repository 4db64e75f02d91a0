"""ARKitScenes: `lowres_wide/ID_TIME.png`, `lowres_depth`, `confidence`, `lowres_wide_intrinsics/ID_TIME.pincam` and
`lowres_wide.traj`. Where `lowres_wide` was not downloaded, `vga_wide` or `wide` is read with its own
intrinsics; with `wide` also `highres_depth`, which has the same times, in place of `lowres_depth`.

Each image takes the pose at its time, interpolated between those at most 0.5 s apart, and the intrinsics nearest in
time: their names differ by a millisecond.

Conventions: a line of the trajectory is `time, axis-angle, translation` of the world-to-camera transform, OpenCV axes,
world z-up. A `.pincam` holds `width height fx fy cx cy`, used unchanged. Depth is in uint16 millimetres; confidence,
of `lowres_depth`, is 0, 1 or 2.
"""

from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics, rigid_inverse
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame
from roomlight.captures.decoding import read_rgbd
from roomlight.captures.formats.listed import ListedReader, files_of, first_folder
from roomlight.captures.options import CaptureOptions
from roomlight.captures.poses import pose_at
from roomlight.captures.source import read_index
from roomlight.captures.times import nearest
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource

TRAJECTORY = "lowres_wide.traj"
_PICTURES: Final = ("lowres_wide", "vga_wide", "wide")


class ArkitScenesReader(ListedReader):
    """Reads the folder of one video of ARKitScenes."""

    format = "arkitscenes"
    conventions = PoseConventions("opencv", "world-to-camera", (0.0, 0.0, 1.0))

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        source = FolderSource(folder)
        self._pictures = first_folder(source, *_PICTURES)
        self._depth = first_folder(source, "lowres_depth", *(["highres_depth"] if self._pictures == "wide" else []))
        colour = files_of(source, self._pictures, (".png", ".jpg"))
        super().__init__(folder, options, colour, expected=f"{' or '.join(_PICTURES)}/*.png", depth=self._depth)
        label = source.label(TRAJECTORY)
        self._poses = fields.parsed_lines(read_index(source, TRAJECTORY), label, _timed_pose, self.notes)
        self._poses.sort(key=lambda pose: pose[0])
        if not self._poses:
            raise CaptureError(f"{label}: has no pose")
        self._times = [time for time, _ in self._poses]
        pincams = files_of(source, f"{self._pictures}_intrinsics", (".pincam",))
        self._pincams = sorted((time, name) for name in pincams if (time := _time_of(name)) is not None)

    def timestamps(self) -> list[float | None]:
        """Return the times in the images' names."""
        return [_time_of(name) for name in self._colour]

    def _read(self, index: int) -> RawFrame:
        colour_name, label = self._colour[index], self.name_of(index)
        file = f"{Path(colour_name).stem}.png"
        depth_name = f"{self._depth}/{file}" if self._reads_depth else None
        with fields.naming(label, FrameError):
            time_s = _time_of(colour_name)
            if time_s is None:
                raise ValueError("its name has no time (ID_TIME.png)")
            inverse = pose_at(self._times, lambda at: rigid_inverse(_transform(self._poses[at][1])), time_s, "the pose")
        intrinsics = self._intrinsics(time_s, label)
        picture, depth_m = read_rgbd(self._source, colour_name, depth_name, unit_m=self._unit_m)
        confidence = self._confidence(f"confidence/{file}") if self._depth == "lowres_depth" else None
        return self._raw_frame(index, picture, depth_m, depth_name, intrinsics, rigid_inverse(inverse), confidence)

    def _intrinsics(self, time_s: float, label: str) -> Intrinsics:
        if not self._pincams:
            raise FrameError(f"{label}: there is no {self._pictures}_intrinsics/*.pincam")
        name = self._pincams[nearest([time for time, _ in self._pincams], time_s)][1]
        pincam = self._source.label(name)
        lines = fields.parse_text(self._source.read(name, max_bytes=4096), pincam)
        with fields.naming(pincam, FrameError):
            values = [fields.number(v, "a value") for v in fields.numbers_of_line(" ".join(lines), 6, "the camera")]
            width, height = fields.pixels(values[0], "width"), fields.pixels(values[1], "height")
            return Intrinsics(values[2], values[3], values[4], values[5], width, height)


def _time_of(name: str) -> float | None:
    try:
        return fields.number(float(Path(name).name.rpartition(".")[0].rpartition("_")[2]), "the time")
    except ValueError:
        return None


def _timed_pose(line: str) -> tuple[float, list[float]]:
    values = fields.numbers_of_line(line, 7, "the pose")
    return fields.number(values[0], "the time"), values[1:]


def _transform(values: list[float]) -> Float[np.ndarray, "4 4"]:
    numbers = fields.coordinates(values, "the pose")
    if not np.isfinite(numbers).all() or np.abs(numbers[:3]).max() > 100:
        raise ValueError("the pose holds NaN, infinity or an impossible rotation (lost tracking)")
    pose = np.eye(4)
    pose[:3, :3], _ = cv2.Rodrigues(numbers[:3])
    pose[:3, 3] = numbers[3:]
    return pose
