"""One frame as bytes: magic, header length, JSON header, colour, optionally depth and its confidence.

    offset  bytes  content
    0       4      "RLF1"
    4       4      length n of the header, unsigned, little-endian
    8       n      the header, UTF-8 JSON (`frame_header.FrameHeader`)
    8 + n   ...    the parts in order, without gaps, up to the end of the message

`pack` and `parse` are pure functions. `parse` decodes no pixels: it checks every stated size against the bytes
received, the headers of the images and `FrameLimits`, before any memory is allocated for them.
"""

import json
import struct
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import zstandard
from jaxtyping import Float
from pydantic import ValidationError

from roomlight.camera import Intrinsics, check_rigid
from roomlight.errors import ImageError, WireError
from roomlight.frame import ASPECT_TOLERANCE, MAX_POSITION_M
from roomlight.images import peek_size
from roomlight.wire.frame_header import DEPTH_BYTES, MAX_INDEX, ConfidencePart, DepthPart, FrameHeader, as_whole_number

MAGIC: Final = b"RLF1"
_PREFIX: Final = struct.Struct("<4sI")
MAX_HEADER_BYTES: Final = 16_384
"""A typical header has about 700 bytes."""


@dataclass(frozen=True)
class FrameLimits:
    """Largest frame accepted, in bytes and in pixels.

    16 MiB is ample for a 12-megapixel JPEG (6 MB). 13 megapixels take 156 MB as float32 RGB during decoding.
    2 megapixels of depth are 40 times ARKit's.
    """

    max_body_bytes: int = 16 * 2**20
    max_colour_pixels: int = 13_000_000
    max_depth_pixels: int = 2_000_000


UNLIMITED: Final = FrameLimits(2**62, 2**62, 2**62)
"""For messages that are the sender's own, or were checked when they came."""


@dataclass(frozen=True)
class FrameMessage:
    """A parsed message: the header, and views of the parts' bytes as received (compressed or raw)."""

    header: FrameHeader
    intrinsics: Intrinsics
    camera_to_world: Float[np.ndarray, "4 4"]
    colour: memoryview
    depth: memoryview | None = None
    confidence: memoryview | None = None

    @property
    def depth_estimated(self) -> bool:
        """Whether the message has depth that a network made."""
        return bool(self.header.depth and self.header.depth.estimated)

    def without_depth(self) -> "FrameMessage":
        """Return the message without depth and confidence, its bytes too."""
        if self.depth is None:
            return self
        header = self.header.model_copy(update={"depth": None, "confidence": None})
        return parse(pack(header, bytes(self.colour)), UNLIMITED)


def pack(header: FrameHeader, colour: bytes, depth: bytes | None = None, confidence: bytes | None = None) -> bytes:
    """Build the bytes of a message.

    The header's text is canonical: sorted keys, no spaces, integral numbers without a decimal point.

    Raises:
        WireError: A part does not have the length that the header states.
    """
    parts = [("colour", header.colour.bytes, colour)]
    for name, part, given in (("depth", header.depth, depth), ("confidence", header.confidence, confidence)):
        if part is not None or given is not None:
            parts.append((name, 0 if part is None else part.bytes, given or b""))
    for name, stated, part in parts:
        if stated != len(part):
            raise bad_frame(f"{name}.bytes", stated, f"must be the length of the part, {len(part)}")
    text = json.dumps(
        _integral_as_int(header.model_dump(exclude_none=True)), sort_keys=True, separators=(",", ":")
    ).encode()
    return b"".join([_PREFIX.pack(MAGIC, len(text)), text, *(part for _, _, part in parts)])


def parse(body: bytes, limits: FrameLimits | None = None) -> FrameMessage:
    """Parse a message and check every stated size against the bytes.

    Raises:
        WireError: The message is malformed or exceeds the limits.
    """
    limits = limits or FrameLimits()
    if len(body) > limits.max_body_bytes:
        raise WireError("too-large", field="", value=f"{len(body)} bytes", rule=f"at most {limits.max_body_bytes}")
    header, start = _read_header(body)
    intrinsics = _intrinsics(header)
    pose = _pose(header)
    _check_sizes(header, limits)
    view = memoryview(body)
    stated = [part.bytes if part else 0 for part in (header.colour, header.depth, header.confidence)]
    if sum(stated) != len(body) - start:
        rule = f"colour.bytes + depth.bytes + confidence.bytes must be the {len(body) - start} bytes after the header"
        raise bad_frame("", sum(stated), rule)
    colour = view[start : start + stated[0]]
    depth = view[start + stated[0] : start + stated[0] + stated[1]] if header.depth else None
    confidence = view[start + stated[0] + stated[1] :] if header.confidence else None
    _check_colour(header, colour)
    if header.depth is not None and depth is not None:
        _check_plane(header.depth, depth, DEPTH_BYTES[header.depth.format], "depth")
    if header.confidence is not None and confidence is not None:
        _check_plane(header.confidence, confidence, 1, "confidence")
    return FrameMessage(header, intrinsics, pose, colour, depth, confidence)


def stated_index(body: bytes) -> int | None:
    """Return the index in a message's header even if the message is otherwise invalid, or None if it is unreadable.

    Error messages carry it, so that a client with several frames in flight knows which one was rejected.
    """
    if len(body) < _PREFIX.size:
        return None
    magic, length = _PREFIX.unpack_from(body)
    if magic != MAGIC or length > MAX_HEADER_BYTES:
        return None
    try:
        header = json.loads(bytes(body[_PREFIX.size : _PREFIX.size + length]))
    except (ValueError, RecursionError):
        return None
    index = as_whole_number(header.get("index")) if isinstance(header, dict) else None
    return index if type(index) is int and 0 <= index <= MAX_INDEX else None


def column_major(camera_to_world: Float[np.ndarray, "4 4"]) -> list[float]:
    """Return a pose as the header carries it: 16 numbers, column by column."""
    return [float(value) for value in camera_to_world.T.reshape(-1)]


def to_wire_error(error: ValidationError, *, kind: str) -> WireError:
    """Convert Pydantic's first error to a WireError with field, value and rule."""
    first = error.errors(include_url=False, include_context=False)[0]
    field = ".".join(str(part) for part in first["loc"] if part != "")
    given: Any = first["input"]
    value = "nothing" if first["type"] == "missing" else _value_text(given)
    return WireError(kind, field=field, value=value, rule=rule_text(first["msg"]))


def rule_text(message: str) -> str:
    """Convert Pydantic's message to the middle of a sentence: no prefix, first letter in lower case."""
    message = message.removeprefix("Value error, ")
    return message[:1].lower() + message[1:]


def _value_text(value: object) -> str:
    """Describe a rejected value in at most about 100 characters."""
    if isinstance(value, dict):
        return f"an object with {len(value)} fields"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return repr(value[:100]) if isinstance(value, str | bytes) else repr(value)[:100]


def bad_frame(field: str, value: object, rule: str) -> WireError:
    """Return the error of a frame's message that is refused."""
    return WireError("bad-frame", field=field, value=value, rule=rule)


def _read_header(body: bytes) -> tuple[FrameHeader, int]:
    if len(body) < _PREFIX.size:
        raise bad_frame("", f"{len(body)} bytes", "must begin with RLF1 and the length of the header")
    magic, length = _PREFIX.unpack_from(body)
    if magic != MAGIC:
        raise bad_frame("magic", magic.hex(), f"must be {MAGIC.hex()} (RLF1)")
    if not 2 <= length <= min(MAX_HEADER_BYTES, len(body) - _PREFIX.size):
        rule = f"must be 2 to {MAX_HEADER_BYTES}, and the header must end inside the message of {len(body)} bytes"
        raise bad_frame("header length", length, rule)
    start = _PREFIX.size + length
    try:
        return FrameHeader.model_validate_json(bytes(body[_PREFIX.size : start])), start
    except ValidationError as error:
        raise to_wire_error(error, kind="bad-frame") from error


def _intrinsics(header: FrameHeader) -> Intrinsics:
    k = header.intrinsics
    try:
        return Intrinsics(k.fx, k.fy, k.cx, k.cy, k.width, k.height)
    except ValueError as error:
        given = f"fx {k.fx:g}, fy {k.fy:g}, cx {k.cx:g}, cy {k.cy:g} for {k.width} x {k.height}"
        raise bad_frame("intrinsics", given, str(error)) from error


def _pose(header: FrameHeader) -> Float[np.ndarray, "4 4"]:
    with np.errstate(over="ignore", invalid="ignore"):
        pose = np.array(header.camera_to_world, np.float64).reshape(4, 4).T
        try:
            if np.abs(pose).max() > 1e9:  # beyond it the checks themselves overflow
                raise ValueError("the pose contains numbers above 1e9")
            pose = check_rigid(pose)
        except ValueError as error:
            rule = f"{error}; expected columns: x axis, y axis, z axis, position, with fourth components 0 0 0 1"
            raise bad_frame("camera_to_world", header.camera_to_world, rule) from error
    far_m = float(np.abs(pose[:3, 3]).max())
    if far_m > MAX_POSITION_M:
        raise bad_frame("camera_to_world", f"{far_m:g} m", f"at most {MAX_POSITION_M:g} m from the origin")
    return pose


def _check_sizes(header: FrameHeader, limits: FrameLimits) -> None:
    k, depth, confidence = header.intrinsics, header.depth, header.confidence
    sizes = [("intrinsics", k.width, k.height, limits.max_colour_pixels)]
    if depth is not None:
        sizes.append(("depth", depth.width, depth.height, limits.max_depth_pixels))
    for field, width, height, most in sizes:
        if width * height > most:
            raise WireError("too-large", field=field, value=f"{width} x {height}", rule=f"at most {most} pixels")
        if min(width, height) < 2:
            raise bad_frame(field, f"{width} x {height}", "at least 2 x 2 pixels")
    if depth is None:
        if confidence is not None:
            raise bad_frame("confidence", f"{confidence.width} x {confidence.height}", "must come with depth")
        return
    if abs(depth.width / depth.height - k.width / k.height) > ASPECT_TOLERANCE * k.width / k.height:
        rule = f"must have the aspect of the image, {k.width} x {k.height}"
        raise bad_frame("depth", f"{depth.width} x {depth.height}", rule)
    if confidence is not None and (confidence.width, confidence.height) != (depth.width, depth.height):
        rule = f"must have the depth's size, {depth.width} x {depth.height}"
        raise bad_frame("confidence", f"{confidence.width} x {confidence.height}", rule)
    if depth.encoding == "png" and depth.format != "uint16_mm":
        raise bad_frame("depth.encoding", f"png with {depth.format}", "png encodes uint16_mm only; use raw or zstd")


def _check_colour(header: FrameHeader, colour: memoryview) -> None:
    k, encoding = header.intrinsics, header.colour.encoding
    raw = {"rgb8": 3, "linear_f32": 13}.get(encoding)
    if raw is not None and len(colour) != raw * k.width * k.height:
        rule = f"{encoding} of {k.width} x {k.height} must have {raw * k.width * k.height} bytes"
        raise bad_frame("colour.bytes", len(colour), rule)
    if encoding in ("jpeg", "png"):
        _check_image(colour, encoding, (k.width, k.height), "colour")
    if encoding == "heic" and bytes(colour[4:8]) != b"ftyp":
        raise bad_frame("colour", bytes(colour[:8]).hex(), "a HEIC file must have `ftyp` at byte 4")


def _check_plane(part: DepthPart | ConfidencePart, data: memoryview, item: int, field: str) -> None:
    """Check the bytes of a depth or confidence part without decoding them."""
    raw = part.width * part.height * item
    if part.encoding == "raw" and len(data) != raw:
        raise bad_frame(f"{field}.bytes", len(data), f"{part.format} of {part.width} x {part.height} must have {raw}")
    if part.encoding == "png":
        _check_image(data, "png", (part.width, part.height), field)
    if part.encoding == "zstd":
        try:
            content = zstandard.get_frame_parameters(data).content_size
        except zstandard.ZstdError as error:
            raise bad_frame(field, bytes(data[:4]).hex(), f"must be a zstd frame ({error})") from error
        if content not in (raw, zstandard.CONTENTSIZE_UNKNOWN):
            raise bad_frame(field, f"{content} bytes decompressed", f"{part.width} x {part.height} must have {raw}")


def _check_image(data: memoryview, encoding: str, size: tuple[int, int], field: str) -> None:
    magic = {"jpeg": b"\xff\xd8\xff", "png": b"\x89PNG\r\n\x1a\n"}[encoding]
    if bytes(data[: len(magic)]) != magic:
        raise bad_frame(field, bytes(data[: len(magic)]).hex(), f"a {encoding} file must begin with {magic.hex()}")
    try:
        image_size = peek_size(bytes(data), field)
    except ImageError as error:
        raise bad_frame(field, f"{len(data)} bytes", str(error)) from error
    if image_size != size:
        rule = f"the image must have the size stated in the header, {size[0]} x {size[1]}"
        raise bad_frame(field, f"{image_size[0]} x {image_size[1]}", rule)


def _integral_as_int(value: Any) -> Any:
    """Convert integral floats to integers, as JavaScript and Swift write them; all clients then write equal bytes."""
    if isinstance(value, dict):
        return {key: _integral_as_int(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_integral_as_int(item) for item in value]
    if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
        return int(value)
    return value
