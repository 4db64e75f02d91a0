"""Write captures in Stray Scanner's format: for tests, and for tools that read that format."""

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Final

import av
import cv2
import numpy as np
from av.container import OutputContainer
from av.error import FFmpegError
from av.video.stream import VideoStream
from jaxtyping import Float, UInt8

from roomlight.camera import Intrinsics, check_rigid
from roomlight.captures.formats.stray_scanner import COLUMNS, MATRIX, MATRIX_SIZE, ODOMETRY, VIDEO
from roomlight.conventions import OPENCV_TO_OPENGL
from roomlight.errors import OutputError
from roomlight.files import write_atomic

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


def depth_to_png(depth_m: Float[np.ndarray, "h w"], *, name: str) -> bytes:
    """Encode depth as a 16-bit PNG in millimetres; unknown depth and depth of 65.535 m and more become 0."""
    known = np.isfinite(depth_m) & (depth_m > 0) & (depth_m < 65.5345)
    millimetres = np.rint(np.where(known, depth_m, 0) * 1000).astype(np.uint16)
    return encoded(".png", millimetres, name=name)


def encoded(suffix: str, pixels: np.ndarray, *, name: str, quality: int | None = None) -> bytes:
    """Encode pixels (BGR or grey) as a PNG or JPEG. Raises OutputError."""
    parameters = [] if quality is None else [cv2.IMWRITE_JPEG_QUALITY, quality]
    ok, data = cv2.imencode(suffix, pixels, parameters)
    if not ok:
        raise OutputError(f"{name}: encoding {pixels.shape} {pixels.dtype} as {suffix} failed")
    return data.tobytes()


def write_stray_scanner(path: Path, frames: Iterable[RecordedFrame], *, frames_per_second: int = 30) -> None:
    """Write a Stray Scanner folder. `odometry.csv`, which every reader needs, is written last.

    Images must be 4:3 with even sides (K is stored for 1920 x 1440) and share one camera. The video is HEVC if this
    build of FFmpeg encodes it, else H.264.

    Raises:
        OutputError: A frame does not fit the format, there is no frame, or a file cannot be written.
    """
    if (path / ODOMETRY).exists():
        raise OutputError(f"{path}: holds a capture already; choose another folder")
    (path / "depth").mkdir(parents=True, exist_ok=True)
    (path / "confidence").mkdir(exist_ok=True)
    rows = [", ".join(COLUMNS)]
    first: Intrinsics | None = None
    try:
        with av.open(str(path / VIDEO), "w", format="mp4") as container:
            stream: VideoStream | None = None
            for number, frame in enumerate(frames):
                name = f"{path}: frame {number}"
                if first is None:
                    first = frame.intrinsics
                    _check_camera(first, name)
                    stream = _add_stream(container, first, frames_per_second)
                if stream is None or frame.intrinsics != first or frame.srgb8.shape != (first.height, first.width, 3):
                    raise OutputError(f"{name}: Stray Scanner stores one camera; this frame's image or camera differs")
                picture = av.VideoFrame.from_ndarray(frame.srgb8, format="rgb24").reformat(
                    format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
                )
                picture.pts, picture.time_base = number, Fraction(1, frames_per_second)
                container.mux(stream.encode(picture))
                confidence = frame.confidence
                if confidence is None:
                    confidence = np.where(frame.depth_m > 0, 2, 0).astype(np.uint8)
                write_atomic(path / f"depth/{number:06d}.png", depth_to_png(frame.depth_m, name=name))
                write_atomic(path / f"confidence/{number:06d}.png", encoded(".png", confidence, name=name))
                rows.append(_odometry_row(number, frame, frames_per_second))
            if stream is None or first is None:
                raise OutputError(f"{path}: a capture needs at least one frame")
            container.mux(stream.encode())
    except (FFmpegError, OSError) as error:
        raise OutputError(f"{path / VIDEO}: cannot be written ({error})") from error
    k = first.resized(*MATRIX_SIZE)
    matrix = f"{k.fx}, 0.0, {k.cx}\n0.0, {k.fy}, {k.cy}\n0.0, 0.0, 1.0\n"
    write_atomic(path / MATRIX, matrix.encode())
    write_atomic(path / ODOMETRY, ("\n".join(rows) + "\n").encode())


def _check_camera(camera: Intrinsics, name: str) -> None:
    if camera.width % 2 or camera.height % 2 or abs(camera.width / camera.height - 4 / 3) > 0.01:
        raise OutputError(f"{name}: {camera.width} x {camera.height} is not 4:3 with even sides, as the format needs")


def _add_stream(container: OutputContainer, camera: Intrinsics, frames_per_second: int) -> VideoStream:
    codec = next(name for name in _CODECS if name in av.codecs_available)
    stream = container.add_stream(codec, rate=frames_per_second)
    if not isinstance(stream, VideoStream):
        raise OutputError(f"{codec} is not a video encoder in this build of FFmpeg")
    stream.width, stream.height, stream.pix_fmt = camera.width, camera.height, "yuv420p"
    stream.options = {"crf": "12", "x265-params": "log-level=none"}
    stream.codec_context.colorspace = _BT709
    stream.codec_context.color_range = _LIMITED_RANGE
    return stream


def _odometry_row(number: int, frame: RecordedFrame, frames_per_second: int) -> str:
    pose = check_rigid(frame.camera_to_world) @ OPENCV_TO_OPENGL  # its own inverse: OpenGL axes to OpenCV's
    time_s = number / frames_per_second if frame.timestamp_s is None else frame.timestamp_s
    values = [*pose[:3, 3].tolist(), *quaternion_from_rotation(pose[:3, :3])]
    return f"{time_s}, {number:06d}, " + ", ".join(f"{value:.9g}" for value in values)


def quaternion_from_rotation(rotation: Float[np.ndarray, "3 3"]) -> list[float]:
    """Return the unit quaternion (x, y, z, w), w >= 0: the inverse of `camera.pose_from_quaternion`.

    It is the eigenvector of the largest eigenvalue of a symmetric 4 x 4 matrix (Bar-Itzhack 2000), which has no
    singular case.
    """
    r = rotation
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    _, vectors = np.linalg.eigh(k)  # reads the lower triangle; eigenvalues ascend
    quaternion = vectors[:, -1]
    return (quaternion if quaternion[3] >= 0 else -quaternion).tolist()
