"""What readers of formats with one file of each kind a frame share: a list of names, read one by one."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from roomlight.camera import Intrinsics
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame, RawProbe, ReadRecord
from roomlight.captures.decoding import decode_confidence
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import MAX_FRAMES
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource
from roomlight.images import ColourImage
from roomlight.notes import Note, keys_of_use, unread_keys

ARKIT = PoseConventions("opengl", "camera-to-world", (0.0, 1.0, 0.0))


class ListedReader:
    """Base of readers whose records are names of colour files in a folder; a format implements `_read`.

    A folder of `depth` without a file counts as none: depth is then estimated.
    """

    format = ""
    conventions = ARKIT

    def __init__(
        self, folder: Path, options: CaptureOptions, colour: list[str], *, expected: str, depth: str | None = None
    ) -> None:
        self._source = FolderSource(folder)
        self._unit_m = options.depth_unit_m
        self._reads_depth = options.depth != "network" and (depth is None or self._source.holds_files(depth))
        self._colour = colour
        self.probes: list[RawProbe] = []
        self.notes: list[Note] = []
        self._unread = set[str]()
        self.count = len(colour)
        if self.count == 0:
            raise CaptureError(f"{folder}: has no {expected}")
        if self.count > MAX_FRAMES:
            raise CaptureError(f"{folder}: has {self.count} frames; up to {MAX_FRAMES} are read")

    def name_of(self, index: int) -> str:
        """Return the colour file."""
        return self._source.label(self._colour[index])

    def timestamps(self) -> list[float | None]:
        """Return no times; formats that store some override this."""
        return []

    @contextmanager
    def records(self) -> Generator[ReadRecord]:
        """Return the function that reads a record; no file is held open."""
        yield self._read

    def _read(self, index: int) -> RawFrame:
        raise NotImplementedError

    def _raw_frame(
        self,
        index: int,
        picture: ColourImage,
        depth_m: Float[np.ndarray, "dh dw"],
        depth_name: str | None,
        intrinsics: Intrinsics,
        pose: Float[np.ndarray, "4 4"],
        confidence: UInt8[np.ndarray, "ch cw"] | None = None,
    ) -> RawFrame:
        depth_label = depth_name and self._source.label(depth_name)
        return RawFrame(self.name_of(index), picture, depth_m, depth_label, intrinsics, pose, confidence)

    def _json(self, name: str) -> dict[str, Any]:
        """Read a JSON object of one frame; keys that bear on it are noted once. Raises FrameError and CaptureError."""
        stated = fields.parse_json(self._source.read(name, max_bytes=1 << 20), self._source.label(name))
        unread = keys_of_use(stated) - self._unread
        self._unread |= unread
        self.notes += unread_keys(self._source.label(name), unread)
        return stated

    def _confidence(self, name: str) -> UInt8[np.ndarray, "h w"] | None:
        if not self._reads_depth or not self._source.has(name):
            return None
        return decode_confidence(self._source.read(name), self._source.label(name))


def files_of(source: FolderSource, folder: str, suffixes: tuple[str, ...]) -> list[str]:
    """Return a folder's files of these endings in any case, in natural order."""
    names = [name for name in source.names(folder) if name.lower().endswith(suffixes) and "/._" not in f"/{name}"]
    return sorted(names, key=fields.natural_key)


def probes_of(index: dict[str, Any], key: str, source: FolderSource, label: str) -> list[RawProbe]:
    """Return the probes of an index, whose panoramas stand under `key`. Raises CaptureError and ValueError."""
    probes: list[RawProbe] = []
    for entry in fields.objects(index.get("probes", []), "probes"):
        position = fields.vector(entry.get("position"), 3, "a probe's position")
        for value in position.tolist():
            fields.number(value, "a probe's position")
        try:
            name = None if entry.get(key) is None else source.path(fields.text(entry[key], f"a probe's {key}"))
        except FrameError as error:
            raise CaptureError(f"{label}: a probe's panorama: {error}") from error
        probes.append((position, name))
    return probes


def first_folder(source: FolderSource, *folders: str) -> str:
    """Return the first of these folders that holds files; the first if none does."""
    return next(filter(source.holds_files, folders), folders[0])
