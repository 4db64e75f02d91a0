"""Polycam's raw data: `keyframes/{images,cameras,depth,confidence}/TIME.*`.

Polycam writes `corrected_images` and `corrected_cameras` beside them once it has closed loops; these are read where
they exist; what their undistortion left black at the edges is not seen. New versions write `corrected_cameras` alone:
their poses are those of `images`, whose intrinsics are those of `cameras`; a size that they lack stands there too.
Exports of other versions have the four folders without `keyframes`.

Conventions: `t_00` to `t_23` are the rows of the camera-to-world pose, ARKit's (OpenGL camera, world y-up). Intrinsics
`fx fy cx cy` are for `width` x `height` and used unchanged. Depth is uint16 millimetres of any size, confidence 0, 54
(or 127) and 255. The files' names are times in microseconds.
"""

from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from roomlight.captures import fields
from roomlight.captures.capture import RawFrame
from roomlight.captures.decoding import read_rgbd, with_mask
from roomlight.captures.formats.listed import ListedReader, files_of, first_folder
from roomlight.captures.options import CaptureOptions
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource
from roomlight.images import ColourImage
from roomlight.notes import Note

_BORDER: Final = 0.05
"""Widest border that undistortion leaves, as a share of a side."""
_BLACK: Final = 0.004
"""Linear; what JPEG makes of black beside a picture."""
_SUFFIXES: Final = (".jpg", ".jpeg", ".png")
_IMAGES = ("keyframes/corrected_images", "keyframes/images", "corrected_images", "images")


def is_polycam(source: FolderSource) -> bool:
    """Whether the folder has Polycam's cameras; without `keyframes` their first file tells."""
    if any(source.has(name) for name in ("keyframes/cameras", "keyframes/corrected_cameras", "corrected_cameras")):
        return True
    first = next(iter(files_of(source, "cameras", (".json",))), None)
    try:
        return first is not None and b'"t_00"' in source.read(first, max_bytes=1 << 20)
    except FrameError:  # empty, or larger than a camera
        return False


class PolycamReader(ListedReader):
    """Reads a folder of Polycam's raw export."""

    format = "polycam"

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        source = FolderSource(folder)
        filled = (folder for folder in _IMAGES if files_of(source, folder, _SUFFIXES))
        images = next(filled, first_folder(source, *_IMAGES))
        self._cameras = images.replace("images", "cameras")
        self._root = images.rpartition("/")[0] + "/" if "/" in images else ""
        colour, taken = (files_of(source, at, _SUFFIXES) for at in (images, images.replace("corrected_", "")))
        if not files_of(source, self._cameras, (".json",)):
            text = f"{source.label(self._cameras)}: has no camera of the pictures in {images}"
            raise CaptureError(f"{text}; export Polycam's raw data again")
        super().__init__(folder, options, colour, expected="keyframes/images/TIME.jpg", depth=f"{self._root}depth")
        self._border_noted = False
        corrected = f"{self._root}corrected_cameras"
        self._poses = corrected if files_of(source, corrected, (".json",)) else self._cameras
        self._segments = set[int]()
        if len(taken) > len(colour):
            what = f"{source.label(images)}: holds {len(colour)} of the {len(taken)} pictures that were taken"
            self.notes.append(Note(what, "the others are not read", "nothing to do, if the app left them out"))

    def timestamps(self) -> list[float | None]:
        """Return the numbers that name the files, in microseconds."""
        stems = [Path(name).stem for name in self._colour]
        return [float(stem) * 1e-6 if stem.isdigit() and len(stem) < 19 else None for stem in stems]

    def _read(self, index: int) -> RawFrame:
        colour_name = self._colour[index]
        stem = Path(colour_name).stem
        camera_name, pose_name = (f"{folder}/{stem}.json" for folder in (self._cameras, self._poses))
        depth_name = f"{self._root}depth/{stem}.png" if self._reads_depth else None
        camera = self._json(camera_name)
        placed = camera if pose_name == camera_name else self._json(pose_name)
        self._note_segments(pose_name, placed)
        with fields.naming(self._source.label(pose_name), FrameError):
            rows = [[placed.get(f"t_{row}{column}") for column in range(4)] for row in range(3)]
            pose = fields.matrix4(rows, "t_00 to t_23")
        picture, depth_m = read_rgbd(self._source, colour_name, depth_name, unit_m=self._unit_m)
        with fields.naming(self._source.label(camera_name), FrameError):
            intrinsics = fields.camera(camera | self._size(stem, camera, picture))
        confidence = self._confidence(f"{self._root}confidence/{stem}.png")
        if "corrected" in self._cameras:
            picture = self._without_border(picture, self.name_of(index))
        return self._raw_frame(index, picture, depth_m, depth_name, intrinsics, pose, confidence)

    def _note_segments(self, pose_name: str, placed: dict[str, Any]) -> None:
        """Note, once, raw poses that come from several runs of the tracker."""
        segment = placed.get("tracking_segment")
        if "corrected" in self._poses or not isinstance(segment, int) or len(self._segments) > 1:
            return
        self._segments.add(segment)
        if len(self._segments) > 1:
            text = f"{self._source.label(pose_name)}: another tracking_segment than the frames before"
            effect = "poses of before and after may not be of one world"
            self.notes.append(Note(text, effect, "process the capture in Polycam, and export raw data again"))

    def _size(self, stem: str, camera: dict[str, Any], picture: ColourImage) -> dict[str, Any]:
        """Return the width and height that a camera is for: as stated, else as the raw camera's, else the picture's."""
        raw_name = f"{self._root}cameras/{stem}.json"
        stated = camera if "width" in camera or not self._source.has(raw_name) else self._json(raw_name)
        height, width = picture.image.shape[:2]
        return {"width": stated.get("width", width), "height": stated.get("height", height)}

    def _without_border(self, picture: ColourImage, label: str) -> ColourImage:
        """Return the picture without black pixels near its edges, and what blends with them."""
        height, width = picture.image.shape[:2]
        rows, columns = max(1, round(height * _BORDER)), max(1, round(width * _BORDER))
        black = np.asarray(picture.image).max(axis=-1) < _BLACK
        black[rows:-rows, columns:-columns] = False
        if not black.any():
            return picture
        if not self._border_noted:
            self._border_noted = True
            effect = "they are taken for what undistortion leaves, and not seen"
            self.notes.append(Note(f"{label}: black pixels at the edges", effect, "nothing to do"))
        return with_mask(picture, cv2.dilate(black.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0)
