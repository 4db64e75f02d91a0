"""Frames as the bytes of a message (`roomlight.wire.frame_message`).

Poses are camera-to-world (camera x right, y up, z backward; world metres, y up); depth is along the optical axis.
"""

from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np
import zstandard
from jaxtyping import Float, Shaped, UInt8
from pydantic import ValidationError

from roomlight.camera import Intrinsics
from roomlight.conventions import linear_to_srgb8
from roomlight.errors import WireError
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
from roomlight.wire.frame_message import FrameLimits, column_major, explain, pack, parse

Colour = Literal["exact", "jpeg", "png"]
"""How a `Frame` travels. exact: as linear floats at the engine's own working size, so that the light is bit for bit
the engine's; 1.2 MB. jpeg, png: as 8-bit sRGB in at most 640 x 480, what a phone sends; 60 kB, 400 kB."""

EXACT_SIZE: Final = (320, 240)
"""The engine's working size: it would bring a larger frame to this itself, by the same function."""
PHONE_SIZE: Final = (640, 480)
"""Twice the working size: averaging over 2 x 2 pixels takes JPEG's noise down with it."""
JPEG_QUALITY: Final = 92
_FAST: Final = 1  # zstd's level: a depth map of 320 x 240 floats in 1 ms; level 3 saves 2 % more

_ANY_SIZE: Final = FrameLimits(2**40, 2**40, 2**40)  # how much is too much is the server's to say


@dataclass(frozen=True)
class CameraFrame:
    """What a camera gave, as it gave it: for apps that hold JPEG bytes and a depth map.

    colour:           the bytes of a JPEG, PNG or HEIC file, or sRGB uint8 [h, w, 3]; the intrinsics' size.
    depth:            [dh, dw], of the image's view and aspect: uint16 = millimetres, float16 or float32 = metres;
                      0 = unknown.
    confidence:       optional uint8 [dh, dw]: 0 low, 1 medium, 2 high.
    exposure:         light taken, relative to the session's reference exposure (e.g. shutter seconds x ISO / 100).
    tracking_state:   normal, limited or not_available; frames that are not normal are counted and skipped.
    """

    colour: bytes | UInt8[np.ndarray, "h w 3"]
    depth: Shaped[np.ndarray, "dh dw"]
    intrinsics: Intrinsics
    camera_to_world: Float[np.ndarray, "4 4"]
    confidence: UInt8[np.ndarray, "ch cw"] | None = None
    timestamp_s: float | None = None
    exposure: float = 1.0
    tracking_state: TrackingState = "normal"


def pack_camera_frame(frame: CameraFrame) -> bytes:
    """The message of a camera's frame; the image goes as it is. Raises WireError for what no server would take."""
    encoding, colour = _camera_colour(frame)
    return _message(frame, encoding, colour)


def pack_frame(frame: Frame, *, colour: Colour = "exact") -> bytes:
    """The message of a RoomLight frame, whose linear radiance becomes what `colour` says. Raises WireError."""
    if colour == "exact":
        return _pack_exact(frame)
    small = frame.resized(*PHONE_SIZE)
    exposure = _exposure(small)
    srgb8 = linear_to_srgb8(small.image * np.float32(exposure))
    suffix, options = (".jpg", [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]) if colour == "jpeg" else (".png", list[int]())
    ok, data = cv2.imencode(suffix, np.ascontiguousarray(srgb8[..., ::-1]), options)
    if not ok:
        raise WireError("bad-frame", field="colour", value=srgb8.shape, rule=f"must encode as {colour}")
    return pack_camera_frame(
        CameraFrame(
            colour=data.tobytes(),
            depth=_millimetres(small.depth_m),
            intrinsics=small.intrinsics,
            camera_to_world=small.camera_to_world,
            timestamp_s=small.timestamp_s,
            exposure=exposure,
        )
    )


def _pack_exact(frame: Frame) -> bytes:
    """float32 colour and depth: what the server makes of it is this frame at the working size, to the bit."""
    small = frame.resized(*EXACT_SIZE)
    colour = small.image.astype("<f4").tobytes() + small.clipped.astype(np.uint8).tobytes()
    # Servers refuse depth of which nothing is known. Where the working size left the known pixels out, all are sent.
    depth_m = small.depth_m if small.depth_m.any() else frame.depth_m
    camera = CameraFrame(b"", depth_m, small.intrinsics, small.camera_to_world, timestamp_s=small.timestamp_s)
    return _message(camera, "linear_f32", colour)


def _message(frame: CameraFrame, encoding: ColourEncoding, colour: bytes) -> bytes:
    """Header and parts, held to each other by the parser that servers use: nothing malformed is sent."""
    depth_format, depth = _depth(frame.depth)
    width, height = _size(frame.depth, "depth")
    confidence = None if frame.confidence is None else _compressed(frame.confidence)
    k = frame.intrinsics
    try:
        header = FrameHeader(
            colour=ColourPart(encoding=encoding, bytes=len(colour)),
            depth=DepthPart(format=depth_format, encoding="zstd", bytes=len(depth), width=width, height=height),
            confidence=_confidence_part(frame, confidence),
            intrinsics=WireIntrinsics(
                fx=float(k.fx), fy=float(k.fy), cx=float(k.cx), cy=float(k.cy), width=k.width, height=k.height
            ),
            camera_to_world=column_major(frame.camera_to_world),
            timestamp_s=None if frame.timestamp_s is None else float(frame.timestamp_s),
            exposure=float(frame.exposure),
            tracking_state=frame.tracking_state,
        )
    except ValidationError as error:
        raise explain(error, kind="bad-frame") from error
    body = pack(header, colour, depth, confidence)
    parse(body, _ANY_SIZE)
    return body


def _confidence_part(frame: CameraFrame, data: bytes | None) -> ConfidencePart | None:
    if frame.confidence is None or data is None:
        return None
    if frame.confidence.dtype != np.uint8:
        raise WireError("bad-frame", field="confidence", value=frame.confidence.dtype.name, rule="must be uint8")
    width, height = _size(frame.confidence, "confidence")
    return ConfidencePart(encoding="zstd", width=width, height=height, bytes=len(data))


def _size(plane: Shaped[np.ndarray, "..."], field: str) -> tuple[int, int]:
    if plane.ndim != 2:
        raise WireError("bad-frame", field=field, value=f"shape {plane.shape}", rule="must be an array [h, w]")
    return plane.shape[1], plane.shape[0]


def _camera_colour(frame: CameraFrame) -> tuple[ColourEncoding, bytes]:
    if not isinstance(frame.colour, bytes):
        height, width = frame.colour.shape[:2]
        if (width, height) != (frame.intrinsics.width, frame.intrinsics.height):
            rule = f"the image must have the intrinsics' size, {frame.intrinsics.width} x {frame.intrinsics.height}"
            raise WireError("bad-frame", field="colour", value=f"{width} x {height}", rule=rule)
        return "rgb8", np.ascontiguousarray(frame.colour).tobytes()
    if frame.colour[:3] == b"\xff\xd8\xff":
        return "jpeg", frame.colour
    if frame.colour[:8] == b"\x89PNG\r\n\x1a\n":
        return "png", frame.colour
    if frame.colour[4:8] == b"ftyp":
        return "heic", frame.colour
    rule = "must be the bytes of a JPEG, PNG or HEIC file, or a uint8 array [h, w, 3]"
    raise WireError("bad-frame", field="colour", value=f"bytes that begin with {frame.colour[:8].hex()}", rule=rule)


def _depth(depth: Shaped[np.ndarray, "..."]) -> tuple[DepthFormat, bytes]:
    formats: dict[str, tuple[DepthFormat, str]] = {
        "uint16": ("uint16_mm", "<u2"),
        "float16": ("float16_m", "<f2"),
        "float32": ("float32_m", "<f4"),
        "float64": ("float32_m", "<f4"),
    }
    if depth.dtype.name not in formats:
        rule = "must be uint16 (millimetres), float16 or float32 (metres)"
        raise WireError("bad-frame", field="depth", value=depth.dtype.name, rule=rule)
    depth_format, stored = formats[depth.dtype.name]
    return depth_format, _compressed(depth.astype(stored))


def _compressed(plane: Shaped[np.ndarray, "..."]) -> bytes:
    return zstandard.ZstdCompressor(level=_FAST).compress(plane.tobytes())


def _millimetres(depth_m: Float[np.ndarray, "h w"]) -> Shaped[np.ndarray, "h w"]:
    known = (depth_m > 0) & (depth_m < 65.5345)  # beyond it 16 bits end, and so do rooms
    return np.rint(np.where(known, depth_m, 0) * 1000).astype(np.uint16)


def _exposure(frame: Frame) -> float:
    """The exposure that an 8-bit image of this radiance is written with: 1, or less where a sensor clipped above 1.

    A frame that was exposed less than the reference clips above 1.0; 8 bits must then reach as far. Radiance that
    nothing clipped (an HDR recording) clips at 1.0, as it would for a phone with the reference exposure.
    """
    if not frame.clipped.any() or float(frame.image.max()) <= 1.0:
        return 1.0
    return 1.0 / max(1.0, float(frame.image[frame.clipped].max(axis=-1).min()))
