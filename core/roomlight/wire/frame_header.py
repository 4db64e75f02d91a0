"""The JSON header of a frame message: its fields, their types and their ranges.

Units: pixels, metres, seconds. Poses are camera-to-world in ARKit's axes (camera x right, y up, z backward; world
y up). Pydantic checks each field here. `frame_message` checks fields against each other and against the bytes.
"""

from typing import Annotated, Final, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

VERSION: Final = 1
MAX_SIDE: Final = 16_384
"""Longest side of an image or a depth map in pixels. `FrameLimits` bounds the area."""
MAX_INDEX: Final = 2**53 - 1
"""The largest integer that every client language represents exactly (JavaScript numbers are doubles)."""

ColourEncoding = Literal["jpeg", "png", "heic", "rgb8", "linear_f32"]
DepthFormat = Literal["uint16_mm", "float16_m", "float32_m"]
PlaneEncoding = Literal["raw", "png", "zstd"]
TrackingState = Literal["normal", "limited", "not_available"]

DEPTH_BYTES: Final[dict[str, int]] = {"uint16_mm": 2, "float16_m": 2, "float32_m": 4}
"""Bytes per depth value, little-endian."""


def as_whole_number(value: object) -> object:
    """Convert a float without a fraction to an integer (JSON writers may send 7 as 7.0); keep any other value."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


WHOLE_NUMBER: Final = BeforeValidator(as_whole_number)
"""Annotate an integer with this after its bounds; the bounds then appear in the JSON schema."""
Pixels = Annotated[int, Field(ge=1, le=MAX_SIDE), WHOLE_NUMBER]
ByteCount = Annotated[int, Field(ge=1, le=2**31), WHOLE_NUMBER]
FiniteNumber = Annotated[float, Field(allow_inf_nan=False)]


class WireModel(BaseModel):
    """Base of all messages: strict types, immutable, unknown fields are errors."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")


class ColourPart(WireModel):
    """The first part: the colour image, in sensor orientation (no EXIF rotation), of the size of the intrinsics.

    Attributes:
        encoding: jpeg, png, heic: an 8-bit sRGB file; heic requires a server with the decoder. rgb8: 8-bit sRGB, row by
            row, 3 bytes per pixel. linear_f32: float32 linear RGB [h, w, 3], then uint8 [h, w], 1 where the sensor
            clipped, 2 or 3 where the pixel shows nothing (masked); lossless, for replays.
        bytes: length of the part.
    """

    encoding: ColourEncoding
    bytes: ByteCount


class DepthPart(WireModel):
    """The second part, optional: depth along the optical axis, row by row, little-endian, in the colour image's view.

    Attributes:
        format: uint16_mm (0 and 65535 are unknown), float16_m or float32_m (unknown where not positive or above 100
            km).
        encoding: raw, zstd (one zstd frame of the raw values) or png (16-bit grey, uint16_mm only).
        width: pixels; the aspect is that of the image within 3 %.
        height: pixels.
        bytes: length of the part.
        estimated: whether a network made it, whose surfaces may lean.
    """

    format: DepthFormat
    encoding: PlaneEncoding = "raw"
    width: Pixels
    height: Pixels
    bytes: ByteCount
    estimated: bool | None = None


class ConfidencePart(WireModel):
    """The optional third part: one byte per depth pixel (0 low, 1 medium, 2 high), of the size of the depth map.

    Attributes:
        format: uint8: 0 low, 1 medium, 2 high.
        encoding: raw, zstd or png (8-bit grey).
        width: that of the depth map.
        height: that of the depth map.
        bytes: length of the part.
    """

    format: Literal["uint8"] = "uint8"
    encoding: PlaneEncoding = "raw"
    width: Pixels
    height: Pixels
    bytes: ByteCount


class WireIntrinsics(WireModel):
    """A pinhole camera in pixels of the colour image. Pixel centres are at half integers."""

    fx: FiniteNumber
    fy: FiniteNumber
    cx: FiniteNumber
    cy: FiniteNumber
    width: Pixels
    height: Pixels


class FrameHeader(WireModel):
    """Everything about a frame except its pixels.

    Attributes:
        version: 1.
        index: integer from 0, required on a WebSocket. Over HTTP the path has it; an index given here must equal it.
        colour: the colour image, below.
        depth: the depth map, below; null or left out: the frame has none, and the server estimates it.
        confidence: confidence of the depth, below; optional.
        intrinsics: fx, fy, cx, cy, width, height in pixels of the colour image.
        camera_to_world: 16 numbers, column by column, as `simd_float4x4` and WebGL store them: x axis, y axis, z axis,
            position, with fourth components 0, 0, 0, 1.
        timestamp_s: seconds from any origin; optional.
        exposure: exposure of the image in the unit of the session's reference exposure (for example shutter seconds x
            ISO); linear radiance is divided by exposure / reference exposure. Default 1.
        auto_exposed: whether the camera changes exposure and white balance and `exposure` does not say by how much: the
            session then estimates it from surfaces that frames share. Default: true for 8-bit images of exposure 1.
        tracking_state: normal (default), limited or not_available, as in ARKit. Frames that are not normal are counted
            and skipped; sessions with `use_limited_tracking` also use limited ones.
    """

    version: Annotated[Literal[1], WHOLE_NUMBER] = VERSION
    index: Annotated[int, Field(ge=0, le=MAX_INDEX), WHOLE_NUMBER] | None = None
    colour: ColourPart
    depth: DepthPart | None = None
    confidence: ConfidencePart | None = None
    intrinsics: WireIntrinsics
    camera_to_world: Annotated[list[FiniteNumber], Field(min_length=16, max_length=16)]
    timestamp_s: FiniteNumber | None = None
    exposure: Annotated[float, Field(ge=1e-6, le=1e6, allow_inf_nan=False)] = 1.0
    auto_exposed: bool | None = None
    tracking_state: TrackingState = "normal"
