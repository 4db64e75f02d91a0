"""Captures on disk, written from frames: for the tests that replay, score and stream them."""

import json
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from roomlight.captures import CaptureWriter
from roomlight.conventions import Position, linear_to_srgb8
from roomlight.frame import Frame


def write_capture(folder: Path, frames: Iterable[Frame], *, probes: Iterable[tuple[Position, np.ndarray]] = ()) -> Path:
    """Write frames, radiance above 1 as white; `probes` are positions and their true panoramas."""
    with CaptureWriter(folder) as writer:
        for frame in frames:
            writer.add(
                srgb8=linear_to_srgb8(np.clip(frame.image, 0, 1)),
                depth_m=frame.depth_m,
                intrinsics=frame.intrinsics,
                camera_to_world=frame.camera_to_world,
                timestamp_s=frame.timestamp_s,
            )
        for position, panorama in probes:
            writer.add_probe(position, panorama)
    return folder


def edited_copy(capture: Path, folder: Path, edit: Callable[[dict[str, Any]], object]) -> Path:
    """Copy a capture of RoomLight's own format; `edit` changes the values of its capture.json."""
    shutil.copytree(capture, folder)
    index = json.loads((folder / "capture.json").read_text())
    edit(index)
    (folder / "capture.json").write_text(json.dumps(index))
    return folder
