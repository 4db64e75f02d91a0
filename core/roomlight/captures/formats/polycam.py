"""Polycam's raw data: `keyframes/{images,cameras,depth,confidence}/TIME.*`.

Polycam writes `corrected_images` and `corrected_cameras` beside them once it has closed loops; these are read where
they exist. Exports of other versions have the four folders without `keyframes`.

Conventions: `t_00` to `t_23` are the rows of the camera-to-world pose, ARKit's (OpenGL camera, world y-up). Intrinsics
`fx fy cx cy` are for `width` x `height` and used unchanged. Depth is uint16 millimetres of any size, confidence 0, 127
and 255. The files' names are times in microseconds.
"""

from pathlib import Path

from roomlight.captures import fields
from roomlight.captures.capture import RawFrame
from roomlight.captures.decoding import read_rgbd
from roomlight.captures.formats.listed import ListedReader, files_of, first_folder
from roomlight.captures.options import CaptureOptions
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource

_IMAGES = ("keyframes/corrected_images", "keyframes/images", "corrected_images", "images")


def is_polycam(source: FolderSource) -> bool:
    """Whether the folder has Polycam's cameras; without `keyframes` their first file tells."""
    if any(source.has(name) for name in ("keyframes/cameras", "keyframes/corrected_cameras", "corrected_cameras")):
        return True
    first = next(iter(files_of(source, "cameras", (".json",))), None)
    return first is not None and b'"t_00"' in source.read(first, max_bytes=1 << 20)


class PolycamReader(ListedReader):
    """Reads a folder of Polycam's raw export."""

    format = "polycam"

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        source = FolderSource(folder)
        images = first_folder(source, *_IMAGES)
        self._cameras = images.replace("images", "cameras")
        self._root = images.rpartition("/")[0] + "/" if "/" in images else ""
        colour = files_of(source, images, (".jpg", ".jpeg", ".png"))
        if not files_of(source, self._cameras, (".json",)):
            raise CaptureError(f"{source.label(self._cameras)}: has no camera; export Polycam's raw data")
        super().__init__(folder, options, colour, expected="keyframes/images/TIME.jpg")

    def timestamps(self) -> list[float | None]:
        """Return the numbers that name the files, in microseconds."""
        stems = [Path(name).stem for name in self._colour]
        return [float(stem) * 1e-6 if stem.isdigit() and len(stem) < 19 else None for stem in stems]

    def _read(self, index: int) -> RawFrame:
        colour_name = self._colour[index]
        stem = Path(colour_name).stem
        camera_name = f"{self._cameras}/{stem}.json"
        depth_name = f"{self._root}depth/{stem}.png" if self._source.has(f"{self._root}depth") else None
        camera = self._json(camera_name)
        with fields.naming(self._source.label(camera_name), FrameError):
            rows = [[camera.get(f"t_{row}{column}") for column in range(4)] for row in range(3)]
            pose = fields.matrix4(rows, "t_00 to t_23")
            intrinsics = fields.camera(camera)
        read = read_rgbd(self._source, colour_name, depth_name, unit_m=self._unit_m)
        confidence = self._confidence(f"{self._root}confidence/{stem}.png")
        return self._raw_frame(index, read, depth_name, intrinsics, pose, confidence)
