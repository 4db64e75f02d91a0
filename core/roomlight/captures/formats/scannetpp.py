"""The iPhone recordings of ScanNet++: `pose_intrinsic_imu.json` beside colour and depth, as downloaded or unpacked.

| what   | downloaded                                              | unpacked by the data set's tools |
|--------|---------------------------------------------------------|----------------------------------|
| colour | `rgb.mkv` or `rgb.mp4`                                  | `rgb/frame_000000.jpg`           |
| masks  | `rgb_mask.mkv` (not read)                               | `rgb_masks/frame_000000.png`     |
| depth  | `depth.bin`: packed maps of 256 x 192                   | `depth/frame_000000.png`         |

Conventions: `aligned_pose` (in the world of the scan, z-up; `pose`, ARKit's own, is not read) is camera-to-world with
OpenCV axes, `intrinsic` is K for the colour image. Pixels that are 0 in a mask are not seen.
"""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame, ReadRecord
from roomlight.captures.decoding import decode_depth_map, intrinsics_without_size, read_mask, read_picture, with_mask
from roomlight.captures.formats.listed import ListedReader
from roomlight.captures.formats.packed_depth import SHAPE, DepthMaps
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import read_index
from roomlight.captures.video import VideoFrames
from roomlight.depth import clean_depth
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource
from roomlight.images import ColourImage
from roomlight.notes import Note

INDEX: Final = "pose_intrinsic_imu.json"
_VIDEOS: Final = ("rgb.mkv", "rgb.mp4")
_MAX_PACKED: Final = 1 << 36


class ScanNetPPReader(ListedReader):
    """Reads the `iphone` folder of a scene."""

    format = "scannetpp"
    conventions = PoseConventions("opencv", "camera-to-world", (0.0, 0.0, 1.0))

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        source = FolderSource(folder)
        label = source.label(INDEX)
        index = fields.parse_json(read_index(source, INDEX), label)
        self._entries: dict[str, Any] = {key: index[key] for key in sorted(index, key=fields.natural_key)}
        self._video = None if source.has("rgb") else next((name for name in _VIDEOS if source.has(name)), "")
        if self._video == "":
            raise CaptureError(f"{folder}: has neither rgb/ nor rgb.mkv; download the scene's iPhone video")
        stems = [key for key in self._entries if self._video or source.has(f"rgb/{key}.jpg")]
        super().__init__(folder, options, [f"rgb/{stem}.jpg" for stem in stems], expected=f"rgb image of {INDEX}")
        self._stems = stems
        self._has_maps = source.holds_files("depth")
        if source.has("rgb_mask.mkv") and not source.has("rgb_masks"):
            advice = "unpack it to rgb_masks/frame_000000.png"
            self.notes.append(Note(f"{folder}: rgb_mask.mkv", "blurred people and screens count as seen", advice))
        if source.has("exif.json"):
            effect = "exposure is estimated from surfaces that frames share"
            self.notes.append(Note(f"{folder}: exposure in exif.json", effect, "nothing to do in even light"))
        self._depth: DepthMaps | None = None

    def name_of(self, index: int) -> str:
        """Return the colour file, or the video with the frame's name."""
        name = self._colour[index] if self._video is None else f"{self._video} ({self._stems[index]})"
        return self._source.label(name)

    def timestamps(self) -> list[float | None]:
        """Return the times of the index, in seconds."""
        times: list[float | None] = []
        for stem in self._stems:
            try:
                times.append(fields.time(self._entry(stem).get("timestamp")))
            except (FrameError, ValueError):
                times.append(None)
        return times

    @contextmanager
    def records(self) -> Generator[ReadRecord]:
        """Hold the video open for one pass."""
        if self._video is None:
            yield lambda index: self._record(index, read_picture(self._source, self._colour[index]))
            return
        try:
            path = self._source.path(self._video, max_bytes=_MAX_PACKED)
        except FrameError as error:
            raise CaptureError(str(error)) from error
        with VideoFrames(path, self._source.label(self._video)) as video:
            yield lambda index: self._record(index, video.frame(self._number(index)))

    def _entry(self, stem: str) -> dict[str, Any]:
        entry = self._entries[stem]
        if not isinstance(entry, dict):
            raise FrameError(f"{self._source.label(INDEX)}: {stem[:60]} is no object with keys")
        return entry

    def _number(self, index: int) -> int:
        digits = self._stems[index].rpartition("_")[2]
        if not (digits.isascii() and digits.isdigit() and len(digits) < 9):
            raise FrameError(f"{self._source.label(INDEX)}: {self._stems[index][:60]!r} is not named frame_000000")
        return int(digits)

    def _record(self, index: int, picture: ColourImage) -> RawFrame:
        stem, label = self._stems[index], self.name_of(index)
        entry = self._entry(stem)
        height, width = picture.image.shape[:2]
        with fields.naming(f"{self._source.label(INDEX)}: {stem}", FrameError):
            pose = fields.matrix4(entry.get("aligned_pose"), "aligned_pose")
            k = fields.matrix3(entry.get("intrinsic"), "intrinsic")
            intrinsics = intrinsics_without_size(k, width=width, height=height)
        mask_name = f"rgb_masks/{stem}.png"
        if self._source.has(mask_name):
            picture = with_mask(picture, read_mask(self._source, mask_name))
        depth_name, depth_label = f"depth/{stem}.png", None
        depth_m = np.zeros((height, width), np.float32)
        if self._reads_depth and self._has_maps:
            depth_label = self._source.label(depth_name)
            depth_m = decode_depth_map(self._source.read(depth_name), depth_label, unit_m=self._unit_m)
        elif self._reads_depth and self._source.has("depth.bin"):
            depth_label = f"{self._source.label('depth.bin')} ({stem})"
            if self._depth is None:
                self._depth = DepthMaps(self._source.path("depth.bin", max_bytes=_MAX_PACKED))
            with fields.naming(depth_label, FrameError):
                stored, unit_m = self._depth.read(self._number(index))
            depth_m = clean_depth((stored * np.float32(self._unit_m or unit_m)).reshape(SHAPE))
        return RawFrame(label, picture, depth_m, depth_label, intrinsics, pose)
