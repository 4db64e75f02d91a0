"""RoomLight's own capture format, reader and writer.

    capture.json             the index, written last
    colour/000000.jpg        sRGB 8 bit (or linear EXR)
    depth/000000.png         optional: uint16 millimetres, 0 = unknown; the same view as the colour, any size
    confidence/000000.png    optional, uint8: 0 low, 1 medium, 2 high
    probes/00.exr            optional ground-truth panoramas, H x 2H linear RGB

`capture.json`:

    {"format": "roomlight-capture", "version": 1, "name": "...",
     "frames": [{"colour": "colour/000000.jpg", "depth": "depth/000000.png",
                 "confidence": "confidence/000000.png",
                 "intrinsics": {"fx": .., "fy": .., "cx": .., "cy": .., "width": .., "height": ..},
                 "camera_to_world": [[4 numbers] x 4], "timestamp_s": 0.0, "exposure": 1.0}],
     "probes": [{"position": [x, y, z], "panorama": "probes/00.exr"}]}

All values are in RoomLight's conventions (`roomlight.conventions`): world y up, camera x right, y up, z backward,
camera-to-world, pixel centres at half integers. `depth` (of all frames), `confidence`, `timestamp_s` and `exposure`
are optional; `exposure` is relative to the reference exposure, and the linear radiance is divided by it.
"""

import json
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from roomlight.camera import Intrinsics, check_rigid
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame, ReadRecord
from roomlight.captures.decoding import decode_confidence, read_rgbd
from roomlight.captures.formats.listed import probes_of
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import MAX_FRAMES, read_index
from roomlight.errors import CaptureError, FrameError, OutputError
from roomlight.files import FolderSource, move_folder, temporary_beside, write_atomic
from roomlight.images import write_exr
from roomlight.notes import Note, unread_keys

INDEX: Final = "capture.json"
FORMAT: Final = "roomlight-capture"
VERSION: Final = 1
_INTRINSICS: Final = ("fx", "fy", "cx", "cy")
_SIZE: Final = ("width", "height")
_KEYS: Final = {"format", "version", "name", "frames", "probes"}
_FRAME_KEYS: Final = {"colour", "depth", "confidence", "intrinsics", "camera_to_world", "timestamp_s", "exposure"}
_HARMLESS: Final = {"surface", "clipped"}
"""Images beside generated frames, for training alone."""


class NativeReader:
    """Reads a folder with a `capture.json`."""

    format = "roomlight"
    conventions = PoseConventions("opengl", "camera-to-world", (0.0, 1.0, 0.0))

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        self._source = FolderSource(folder)
        self.notes: list[Note] = []
        self._unit_m = options.depth_unit_m
        self._label = self._source.label(INDEX)
        index = fields.parse_json(read_index(self._source, INDEX), self._label)
        if index.get("format") != FORMAT:
            stated = f"its format is {str(index['format'])[:40]!r}" if "format" in index else "it states no format"
            raise CaptureError(
                f"{self._label}: {stated}, not {FORMAT!r}: it is another program's; write its frames into a "
                "transforms.json, or set `format` if the folder is of another one"
            )
        if index.get("version") != VERSION:
            raise CaptureError(f"{self._label}: is version {str(index.get('version'))[:20]}; version {VERSION} is read")
        with fields.naming(self._label, CaptureError):
            self._frames = fields.objects(index.get("frames"), "frames")
            self.probes = probes_of(index, "panorama", self._source, self._label)
        self.count = len(self._frames)
        self.notes.extend(unread_keys(self._label, self._unread(index)))
        self._reads_depth = options.depth != "network"
        self._has_depth = self._reads_depth and any(entry.get("depth") is not None for entry in self._frames)
        if self.count > MAX_FRAMES:
            raise CaptureError(f"{self._label}: lists {self.count} frames; up to {MAX_FRAMES} are read")

    def _unread(self, index: dict[str, Any]) -> set[str]:
        lenses = [lens for frame in self._frames if isinstance(lens := frame.get("intrinsics"), dict)]
        keys = {key for frame in self._frames for key in frame} - _FRAME_KEYS - _HARMLESS
        return keys | (index.keys() - _KEYS) | ({key for lens in lenses for key in lens} - {*_INTRINSICS, *_SIZE})

    def name_of(self, index: int) -> str:
        """Return the colour file as the index names it."""
        name = self._frames[index].get("colour")
        return self._source.label(name[:300]) if isinstance(name, str) else f"{self._label}: frame {index}"

    def timestamps(self) -> list[float | None]:
        """Return the frames' times."""
        return [fields.time(frame.get("timestamp_s")) for frame in self._frames]

    @contextmanager
    def records(self) -> Generator[ReadRecord]:
        """Return the function that reads a record; no file is held open."""
        yield self._read

    def _read(self, index: int) -> RawFrame:
        entry = self._frames[index]
        where = f"{self._label}: frame {index}"
        with fields.naming(where, FrameError):
            colour_name = fields.text(entry.get("colour"), "colour")
            depth_name = fields.text(entry.get("depth"), "depth") if self._has_depth else None
            pose = fields.matrix4(entry.get("camera_to_world"), "camera_to_world")
            exposure = fields.positive(entry.get("exposure", 1.0), "exposure")
            if not 1e-6 <= exposure <= 1e6:
                raise ValueError(f"exposure {exposure:g} is out of range; relative to the reference it is 1e-6 to 1e6")
            lens: Any = entry.get("intrinsics")
            if not isinstance(lens, dict):
                raise ValueError("has no intrinsics")
            intrinsics = fields.camera(lens)
        label = self._source.label(colour_name)
        picture, depth_m = read_rgbd(self._source, colour_name, depth_name, unit_m=self._unit_m)
        if exposure != 1.0:
            picture = replace(picture, image=picture.image / np.float32(exposure))
        confidence = None
        if self._reads_depth and entry.get("confidence") is not None:
            with fields.naming(where, FrameError):
                confidence_name = fields.text(entry["confidence"], "confidence")
            confidence = decode_confidence(self._source.read(confidence_name), self._source.label(confidence_name))
        return RawFrame(
            name=label,
            picture=picture,
            depth_m=depth_m,
            depth_name=None if depth_name is None else self._source.label(depth_name),
            intrinsics=intrinsics,
            pose=pose,
            confidence=confidence,
            auto_exposed=entry.get("exposure") is None,
            exposure=exposure,
        )


class CaptureWriter:
    """Writes a capture in RoomLight's own format, frame by frame; use it in a `with` statement.

    Files are written to a folder `.NAME.part` beside the target; `close` writes the index and renames the folder.
    An exception removes the partial folder, so that the capture is either complete or absent.
    """

    def __init__(self, path: str | Path, *, name: str = "") -> None:
        """Create the partial folder.

        Raises:
            OutputError: `path` exists and is not an empty folder, or the folder cannot be created.
        """
        self.path = path = Path(path)
        self._target = target = path.absolute()  # `.` has no name
        self._name = name or target.name
        self._partial = temporary_beside(target)
        self._frames: list[dict[str, Any]] = []
        self._probes: list[dict[str, Any]] = []
        self._closed = False
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise OutputError(f"{path}: exists already; choose another folder or delete it")
        try:
            shutil.rmtree(self._partial, ignore_errors=True)
            self._partial.mkdir(parents=True)
        except OSError as error:
            raise OutputError(f"{self._partial}: cannot be created ({error.strerror or error})") from error

    def __enter__(self) -> "CaptureWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            shutil.rmtree(self._partial, ignore_errors=True)

    def add(
        self,
        *,
        srgb8: UInt8[np.ndarray, "h w 3"],
        depth_m: Float[np.ndarray, "dh dw"],
        intrinsics: Intrinsics,
        camera_to_world: Float[np.ndarray, "4 4"],
        timestamp_s: float | None = None,
        confidence: UInt8[np.ndarray, "dh dw"] | None = None,
        exposure: float | None = None,
        jpeg_quality: int = 92,
    ) -> None:
        """Add a frame: sRGB 8-bit colour and z-depth in metres (0, non-finite, or 65.535 and more = unknown).

        JPEG quality 92 keeps the linear radiance error at about 1 % in 30 kB for 320 x 240.

        Raises:
            OutputError: Image and intrinsics differ in size, the pose is not rigid, or a file cannot be written.
        """
        index = len(self._frames)
        stem, name = f"{index:06d}", f"{self.path}: frame {index}"
        if srgb8.shape[:2] != (intrinsics.height, intrinsics.width):
            raise OutputError(
                f"{name}: the image is {srgb8.shape[1]} x {srgb8.shape[0]} but its intrinsics are for "
                f"{intrinsics.width} x {intrinsics.height}"
            )
        try:
            pose = check_rigid(camera_to_world)
        except ValueError as error:
            raise OutputError(f"{name}: {error}") from error
        entry: dict[str, Any] = {
            "colour": f"colour/{stem}.jpg",
            "depth": f"depth/{stem}.png",
            "intrinsics": {key: float(getattr(intrinsics, key)) for key in _INTRINSICS}
            | {"width": intrinsics.width, "height": intrinsics.height},
            "camera_to_world": pose.tolist(),
        }
        jpeg = encoded(".jpg", np.ascontiguousarray(srgb8[..., ::-1]), name=name, quality=jpeg_quality)
        write_atomic(self._partial / entry["colour"], jpeg)
        known = np.isfinite(depth_m) & (depth_m > 0) & (depth_m < 65.5345)
        millimetres = np.rint(np.where(known, depth_m, 0) * 1000).astype(np.uint16)
        write_atomic(self._partial / entry["depth"], encoded(".png", millimetres, name=name))
        if confidence is not None:
            entry["confidence"] = f"confidence/{stem}.png"
            write_atomic(self._partial / entry["confidence"], encoded(".png", confidence, name=name))
        if timestamp_s is not None:
            entry["timestamp_s"] = float(timestamp_s)
        if exposure is not None:
            entry["exposure"] = float(exposure)
        self._frames.append(entry)

    def add_probe(self, position: tuple[float, float, float], panorama: Float[np.ndarray, "h w 3"]) -> None:
        """Add a ground-truth panorama (linear RGB, W = 2H, world-aligned) taken at a position in metres.

        Raises:
            OutputError: The panorama is not twice as wide as high, or cannot be written.
        """
        if panorama.shape[1] != 2 * panorama.shape[0]:
            raise OutputError(f"{self.path}: a panorama is twice as wide as high, this is {panorama.shape}")
        name = f"probes/{len(self._probes):02d}.exr"
        write_exr(self._partial / name, panorama)
        self._probes.append({"position": [float(value) for value in position], "panorama": name})

    def close(self) -> None:
        """Write the index and rename the partial folder. Closing twice has no effect.

        Raises:
            OutputError: No frame was added, or the folder cannot be written.
        """
        if self._closed:
            return
        if not self._frames:
            shutil.rmtree(self._partial, ignore_errors=True)
            raise OutputError(f"{self.path}: a capture needs at least one frame")
        index = {
            "format": FORMAT,
            "version": VERSION,
            "name": self._name,
            "frames": self._frames,
            "probes": self._probes,
        }
        write_atomic(self._partial / INDEX, json.dumps(index).encode())
        try:
            move_folder(self._partial, self._target, last=INDEX)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written ({error.strerror or error})") from error
        self._closed = True


def encoded(suffix: str, pixels: np.ndarray, *, name: str, quality: int | None = None) -> bytes:
    """Encode pixels (BGR or grey) as a PNG or JPEG. Raises OutputError."""
    parameters = [] if quality is None else [cv2.IMWRITE_JPEG_QUALITY, quality]
    ok, data = cv2.imencode(suffix, pixels, parameters)
    if not ok:
        raise OutputError(f"{name}: encoding {pixels.shape} {pixels.dtype} as {suffix} failed")
    return data.tobytes()
