"""Frames to bytes: the binary messages of `roomlight.wire.frame_message`.

Poses are camera-to-world (camera x right, y up, z backward; world metres, y up); depth is along the optical axis.
"""

from dataclasses import dataclass
from typing import Final, Literal, get_args

import cv2
import numpy as np
import zstandard
from jaxtyping import Float, Shaped, UInt8
from pydantic import ValidationError

from roomlight.camera import Intrinsics
from roomlight.conventions import linear_to_srgb8
from roomlight.errors import OptionError
from roomlight.frame import Frame
from roomlight.wire.frame_header import (
    ColourEncoding,
    ColourPart,
    ConfidencePart,
    DepthFormat,
    DepthPart,
    FrameHeader,
    TrackingState,
    WireIntrinsics,
)
from roomlight.wire.frame_message import UNLIMITED, bad_frame, column_major, pack, parse, to_wire_error

FrameEncoding = Literal["exact", "jpeg", "png"]
"""Encoding of a `Frame`.

exact: linear float32 at the engine's working size, 1.2 MB. The light equals the local engine's, bit for bit.
jpeg, png: 8-bit sRGB of at most 640 x 480, as a phone sends it: 60 kB, 400 kB. Frames with a mask (`Frame.seen`) are
sent as PNG with alpha, because JPEG has none.
"""

EXACT_SIZE: Final = (320, 240)
"""The engine's working size (width, height). The engine resizes a larger frame to it by the same function."""
PHONE_SIZE: Final = (640, 480)
"""Twice the working size (width, height): the average over 2 x 2 pixels removes most of JPEG's noise."""
JPEG_QUALITY: Final = 92
_LEAST_WHITE: Final = 0.955  # a little below sRGB 250 of 255, from which 8-bit images clip
_ZSTD_LEVEL: Final = 1  # compresses a depth map of 320 x 240 floats in 1 ms; level 3 is 2 % smaller


@dataclass(frozen=True)
class CameraFrame:
    """A frame as a camera delivers it: for apps that hold JPEG bytes and a depth map.

    Attributes:
        colour: The bytes of a JPEG, PNG or HEIC file, or sRGB uint8 [h, w, 3]; of the intrinsics' size.
        depth: [dh, dw], of the image's view and aspect: uint16 in millimetres, float16 or float32 in metres;
            0 = unknown. None: the camera measures none, and the server estimates it.
        intrinsics: Pinhole camera in pixels of the colour image.
        camera_to_world: [4, 4], metres, world y up.
        confidence: Optional uint8 [dh, dw]: 0 low, 1 medium, 2 high.
        timestamp_s: Seconds from any origin.
        exposure: Light taken, relative to the session's reference exposure (e.g. shutter seconds x ISO / 100).
        auto_exposed: Whether nothing states how the camera changes its exposure; None: if `exposure` is 1.
        tracking_state: The server counts and skips frames whose state is not `normal`.
        depth_estimated: Whether `depth` is a network's.
    """

    colour: bytes | UInt8[np.ndarray, "h w 3"]
    depth: Shaped[np.ndarray, "dh dw"] | None
    intrinsics: Intrinsics
    camera_to_world: Float[np.ndarray, "4 4"]
    confidence: UInt8[np.ndarray, "ch cw"] | None = None
    timestamp_s: float | None = None
    exposure: float = 1.0
    auto_exposed: bool | None = None
    tracking_state: TrackingState = "normal"
    depth_estimated: bool = False


def pack_camera_frame(frame: CameraFrame, index: int | None = None) -> bytes:
    """Encode a camera's frame as a message, which states the index if one is given; an image file is sent unchanged.

    Raises:
        WireError: If the frame is invalid: no server would accept it.
    """
    encoding, colour = _camera_colour(frame)
    return _message(frame, encoding, colour, index)


def pack_frame(frame: Frame, index: int | None = None, *, colour: FrameEncoding = "exact") -> bytes:
    """Encode a RoomLight frame of linear radiance as a message, which states the index if one is given.

    Raises:
        OptionError: If `colour` is none of these encodings.
        WireError: If the frame is invalid: no server would accept it.
    """
    if colour not in get_args(FrameEncoding):
        raise OptionError(f"colour must be one of {', '.join(get_args(FrameEncoding))}; got {colour!r}")
    if colour == "exact":
        return _pack_exact(frame, index)
    small = frame.resized(*PHONE_SIZE)
    exposure, depth_m = _exposure(frame), _known_depth(small, frame)
    srgb8 = linear_to_srgb8(small.image * np.float32(exposure))
    pixels, suffix, options = srgb8[..., ::-1], ".png", list[int]()
    if small.seen is not None:
        pixels = np.dstack([pixels, small.seen.astype(np.uint8) * 255])
    elif colour == "jpeg":
        suffix, options = ".jpg", [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    ok, data = cv2.imencode(suffix, np.ascontiguousarray(pixels), options)
    if not ok:
        raise bad_frame("colour", srgb8.shape, f"must encode as {colour}")
    return pack_camera_frame(
        CameraFrame(
            colour=data.tobytes(),
            depth=None if depth_m is None else _millimetres(depth_m),
            intrinsics=small.intrinsics,
            camera_to_world=small.camera_to_world,
            timestamp_s=small.timestamp_s,
            exposure=exposure,
            auto_exposed=None if frame.auto_exposed == (exposure == 1.0) else frame.auto_exposed,
            depth_estimated=frame.depth_estimated,
        ),
        index,
    )


def _pack_exact(frame: Frame, index: int | None) -> bytes:
    """Encode colour and depth as float32: the server decodes this frame at the working size, bit for bit."""
    small = frame.resized(*EXACT_SIZE)
    marks = small.clipped.astype(np.uint8)
    if small.seen is not None:
        marks[~small.seen] += 2
    colour = small.image.astype("<f4").tobytes() + marks.tobytes()
    camera = CameraFrame(
        b"",
        _known_depth(small, frame),
        small.intrinsics,
        small.camera_to_world,
        timestamp_s=small.timestamp_s,
        auto_exposed=frame.auto_exposed or None,
        depth_estimated=frame.depth_estimated,
    )
    return _message(camera, "linear_f32", colour, index)


def _known_depth(small: Frame, frame: Frame) -> Float[np.ndarray, "dh dw"] | None:
    """Return the depth of the reduced frame; of the frame itself if no known pixel is left."""
    return small.depth_m if small.depth_m.any() else frame.depth_m if frame.depth_m.any() else None


def _message(frame: CameraFrame, encoding: ColourEncoding, colour: bytes, index: int | None) -> bytes:
    """Join header and parts, and check them with the server's own parser before anything is sent."""
    k = frame.intrinsics
    try:
        depth_part, depth = _depth(frame)
        confidence_part, confidence = _confidence(frame)
        header = FrameHeader(
            index=index,
            colour=ColourPart(encoding=encoding, bytes=len(colour)),
            depth=depth_part,
            confidence=confidence_part,
            intrinsics=WireIntrinsics(
                fx=float(k.fx), fy=float(k.fy), cx=float(k.cx), cy=float(k.cy), width=k.width, height=k.height
            ),
            camera_to_world=column_major(frame.camera_to_world),
            timestamp_s=None if frame.timestamp_s is None else float(frame.timestamp_s),
            exposure=float(frame.exposure),
            auto_exposed=frame.auto_exposed,
            tracking_state=frame.tracking_state,
        )
    except ValidationError as error:
        raise to_wire_error(error, kind="bad-frame") from error
    body = pack(header, colour, depth, confidence)
    parse(body, UNLIMITED)
    return body


def _confidence(frame: CameraFrame) -> tuple[ConfidencePart | None, bytes | None]:
    if frame.confidence is None:
        return None, None
    if frame.confidence.dtype != np.uint8:
        raise bad_frame("confidence", frame.confidence.dtype.name, "must be uint8")
    width, height = _size(frame.confidence, "confidence")
    data = _compressed(frame.confidence)
    return ConfidencePart(encoding="zstd", width=width, height=height, bytes=len(data)), data


def _size(plane: Shaped[np.ndarray, "..."], field: str) -> tuple[int, int]:
    if plane.ndim != 2:
        raise bad_frame(field, f"shape {plane.shape}", "must be an array [h, w]")
    return plane.shape[1], plane.shape[0]


def _camera_colour(frame: CameraFrame) -> tuple[ColourEncoding, bytes]:
    if not isinstance(frame.colour, bytes):
        height, width = frame.colour.shape[:2]
        if (width, height) != (frame.intrinsics.width, frame.intrinsics.height):
            rule = f"the image must have the intrinsics' size, {frame.intrinsics.width} x {frame.intrinsics.height}"
            raise bad_frame("colour", f"{width} x {height}", rule)
        return "rgb8", np.ascontiguousarray(frame.colour).tobytes()
    if frame.colour[:3] == b"\xff\xd8\xff":
        return "jpeg", frame.colour
    if frame.colour[:8] == b"\x89PNG\r\n\x1a\n":
        return "png", frame.colour
    if frame.colour[4:8] == b"ftyp":
        return "heic", frame.colour
    rule = "must be the bytes of a JPEG, PNG or HEIC file, or a uint8 array [h, w, 3]"
    raise bad_frame("colour", f"bytes that begin with {frame.colour[:8].hex()}", rule)


def _depth(frame: CameraFrame) -> tuple[DepthPart | None, bytes | None]:
    if frame.depth is None:
        return None, None
    formats: dict[str, tuple[DepthFormat, str]] = {
        "uint16": ("uint16_mm", "<u2"),
        "float16": ("float16_m", "<f2"),
        "float32": ("float32_m", "<f4"),
        "float64": ("float32_m", "<f4"),
    }
    if frame.depth.dtype.name not in formats:
        rule = "must be uint16 (millimetres), float16 or float32 (metres)"
        raise bad_frame("depth", frame.depth.dtype.name, rule)
    depth_format, stored = formats[frame.depth.dtype.name]
    width, height = _size(frame.depth, "depth")
    data, estimated = _compressed(frame.depth.astype(stored)), frame.depth_estimated or None
    part = DepthPart(
        format=depth_format, encoding="zstd", width=width, height=height, bytes=len(data), estimated=estimated
    )
    return part, data


def _compressed(plane: Shaped[np.ndarray, "..."]) -> bytes:
    return zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress(plane.tobytes())


def _millimetres(depth_m: Float[np.ndarray, "h w"]) -> Shaped[np.ndarray, "h w"]:
    known = (depth_m > 0) & (depth_m < 65.5345)  # the limit of 16 bits; rooms are smaller
    return np.rint(np.where(known, depth_m, 0) * 1000).astype(np.uint16)


def _exposure(frame: Frame) -> float:
    """Return the frame's exposure; without, that at which what the sensor clipped is white in an 8-bit image.

    It is 1 where that is so already, and in radiance without clipped pixels (an HDR recording), whose values above 1.0
    are cut off, as a phone with the reference exposure would do.
    """
    if frame.exposure != 1.0:
        return frame.exposure
    white = float(np.median(frame.image[frame.clipped].max(axis=-1))) if frame.clipped.any() else 1.0
    return 1.0 if _LEAST_WHITE <= white <= 1 else 1 / min(max(white, 1e-6), 1e6)
