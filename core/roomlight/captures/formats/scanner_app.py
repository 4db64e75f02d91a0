"""3D Scanner App's "all data" export: `frame_00000.jpg`, `frame_00000.json`, `depth_00000.png`, `conf_00000.png`.

A record is a colour image; the app writes poses more often than images, and depth for each image.

Conventions: `cameraPoseARFrame` holds the rows of the camera-to-world pose, ARKit's (OpenGL camera, world y-up);
`intrinsics` the rows of K for the image, used unchanged. Depth is uint16 millimetres, confidence 0, 1, 2.
"""

import re
from pathlib import Path

from roomlight.captures import fields
from roomlight.captures.capture import RawFrame
from roomlight.captures.decoding import intrinsics_without_size, read_rgbd
from roomlight.captures.formats.listed import ListedReader, files_of
from roomlight.captures.options import CaptureOptions
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource
from roomlight.notes import Note

_COLOUR = re.compile(r"frame_(\d{1,9})\.(?:jpg|jpeg|png)", re.IGNORECASE)


def is_scanner_app(source: FolderSource) -> bool:
    """Whether the folder has the app's images with their JSON."""
    return any(_COLOUR.fullmatch(name) and source.has(Path(name).stem + ".json") for name in source.names())


class ScannerAppReader(ListedReader):
    """Reads a folder that 3D Scanner App exported."""

    format = "3d-scanner-app"

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        source = FolderSource(folder)
        colour = [name for name in files_of(source, "", (".jpg", ".jpeg", ".png")) if _COLOUR.fullmatch(name)]
        super().__init__(folder, options, colour, expected="frame_00000.jpg")
        self._has_depth = self._reads_depth and any(name.lower().startswith("depth_") for name in source.names())

    def timestamps(self) -> list[float | None]:
        """Return the times that the frames' JSON states."""
        times: list[float | None] = []
        for name in self._colour:
            try:
                times.append(fields.time(self._json(Path(name).stem + ".json").get("time")))
            except (FrameError, CaptureError):
                times.append(None)
        return times

    def _read(self, index: int) -> RawFrame:
        colour_name = self._colour[index]
        number = Path(colour_name).stem.partition("_")[2]
        depth_name = f"depth_{number}.png" if self._has_depth else None
        json_name = f"frame_{number}.json"
        stated = self._json(json_name)
        if "exposureDuration" in stated and not self.notes:
            effect = "exposure is estimated from surfaces that frames share"
            self.notes.append(Note(f"{self._source.label(json_name)}: exposureDuration", effect, "lock the exposure"))
        picture, depth_m = read_rgbd(self._source, colour_name, depth_name, unit_m=self._unit_m)
        height, width = picture.image.shape[:2]
        with fields.naming(self._source.label(json_name), FrameError):
            pose = fields.vector(stated.get("cameraPoseARFrame"), 16, "cameraPoseARFrame").reshape(4, 4)
            k = fields.vector(stated.get("intrinsics"), 9, "intrinsics").reshape(3, 3)
            intrinsics = intrinsics_without_size(k, width=width, height=height)
        confidence = self._confidence(f"conf_{number}.png")
        return self._raw_frame(index, picture, depth_m, depth_name, intrinsics, pose, confidence)
