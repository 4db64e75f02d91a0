"""Captures written in Stray Scanner's format, whose reader takes video, CSV and PNG."""

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Final

import av
import numpy as np
from av.container import OutputContainer
from av.video.stream import VideoStream
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from roomlight.camera import Intrinsics, check_rigid
from roomlight.captures.formats.native import depth_to_png, encoded
from roomlight.captures.formats.stray_scanner import COLUMNS, MATRIX, MATRIX_SIZE, ODOMETRY, VIDEO
from roomlight.conventions import OPENCV_TO_OPENGL

_CODECS: Final = ("libx265", "libx264", "mpeg4")
_BT709: Final = 1
_LIMITED_RANGE: Final = 1


@dataclass(frozen=True)
class RecordedFrame:
    """One frame to write: sRGB 8-bit colour, z-depth in metres (0 unknown), pose in RoomLight's conventions."""

    srgb8: UInt8[np.ndarray, "h w 3"]
    depth_m: Float[np.ndarray, "dh dw"]
    intrinsics: Intrinsics
    camera_to_world: Float[np.ndarray, "4 4"]
    timestamp_s: float | None = None
    confidence: UInt8[np.ndarray, "dh dw"] | None = None


def write_stray_scanner(path: Path, frames: Iterable[RecordedFrame], *, frames_per_second: int = 30) -> None:
    """Write a folder of frames of one camera, 4:3 with even sides (K is stored for 1920 x 1440)."""
    (path / "depth").mkdir(parents=True, exist_ok=True)
    (path / "confidence").mkdir(exist_ok=True)
    rows = [", ".join(COLUMNS)]
    recorded = list(frames)
    camera = recorded[0].intrinsics
    with av.open(str(path / VIDEO), "w", format="mp4") as container:
        stream = _add_stream(container, camera, frames_per_second)
        for number, frame in enumerate(recorded):
            picture = av.VideoFrame.from_ndarray(frame.srgb8, format="rgb24").reformat(
                format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
            )
            picture.pts, picture.time_base = number, Fraction(1, frames_per_second)
            container.mux(stream.encode(picture))
            confidence = frame.confidence
            if confidence is None:
                confidence = np.where(frame.depth_m > 0, 2, 0).astype(np.uint8)
            depth = depth_to_png(frame.depth_m, name=f"frame {number}")
            (path / f"depth/{number:06d}.png").write_bytes(depth)
            (path / f"confidence/{number:06d}.png").write_bytes(encoded(".png", confidence, name=f"frame {number}"))
            rows.append(_odometry_row(number, frame, frames_per_second))
        container.mux(stream.encode())
    k = camera.resized(*MATRIX_SIZE)
    matrix = f"{k.fx}, 0.0, {k.cx}\n0.0, {k.fy}, {k.cy}\n0.0, 0.0, 1.0\n"
    (path / MATRIX).write_bytes(matrix.encode())
    (path / ODOMETRY).write_bytes(("\n".join(rows) + "\n").encode())


def _add_stream(container: OutputContainer, camera: Intrinsics, frames_per_second: int) -> VideoStream:
    codec = next(name for name in _CODECS if name in av.codecs_available)
    stream = container.add_stream(codec, rate=frames_per_second)
    assert isinstance(stream, VideoStream)
    stream.width, stream.height, stream.pix_fmt = camera.width, camera.height, "yuv420p"
    stream.options = {"crf": "12", "x265-params": "log-level=none"}
    stream.codec_context.colorspace = _BT709
    stream.codec_context.color_range = _LIMITED_RANGE
    return stream


def _odometry_row(number: int, frame: RecordedFrame, frames_per_second: int) -> str:
    pose = check_rigid(frame.camera_to_world) @ OPENCV_TO_OPENGL  # its own inverse: OpenGL axes to OpenCV's
    time_s = number / frames_per_second if frame.timestamp_s is None else frame.timestamp_s
    values = [*pose[:3, 3].tolist(), *Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True).tolist()]
    return f"{time_s}, {number:06d}, " + ", ".join(f"{value:.9g}" for value in values)
