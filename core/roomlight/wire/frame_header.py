"""The JSON header of a frame message: its fields, and what each must be.

Units: pixels, metres, seconds. Poses are camera-to-world in ARKit's axes (camera x right, y up, z backward; world
y up). Pydantic checks types and ranges here; what needs two fields or the bytes is checked in `frame_message`.
"""

from typing import Annotated, Final, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

VERSION: Final = 1
SIDE: Final = 16_384
"""Longest side of an image or a depth map in pixels; `FrameLimits` bounds the area."""
MAX_INDEX: Final = 2**53 - 1
"""The largest whole number that every client's arithmetic holds exactly."""

ColourEncoding = Literal["jpeg", "png", "heic", "rgb8", "linear_f32"]
DepthFormat = Literal["uint16_mm", "float16_m", "float32_m"]
PlaneEncoding = Literal["raw", "png", "zstd"]
TrackingState = Literal["normal", "limited", "not_available"]

DEPTH_BYTES: Final[dict[str, int]] = {"uint16_mm": 2, "float16_m": 2, "float32_m": 4}
"""Bytes of one depth value, little-endian."""


def whole(value: object) -> object:
    """7.0 is the whole number 7, as in JSON, whose writers do not all tell them apart; anything else as it is."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


WHOLE: Final = BeforeValidator(whole)
"""After an integer's bounds, so that these stand in the schema."""
Pixels = Annotated[int, Field(ge=1, le=SIDE), WHOLE]
ByteCount = Annotated[int, Field(ge=1, le=2**31), WHOLE]
Number = Annotated[float, Field(allow_inf_nan=False)]


class WireModel(BaseModel):
    """Strict, frozen, closed: a misspelt field is an error, not a default."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")


class ColourPart(WireModel):
    """The first part. Its size in pixels is the intrinsics'; pixels stand as the sensor gave them, with no EXIF turn.

    jpeg, png, heic: 8-bit sRGB. rgb8: 8-bit sRGB, row by row, 3 bytes a pixel. linear_f32: float32 linear RGB
    [h, w, 3], then uint8 [h, w], 1 where the sensor clipped: for replays that must not lose a bit.
    """

    encoding: ColourEncoding
    bytes: ByteCount


class DepthPart(WireModel):
    """The second part: z-depth, row by row, little-endian, the same view as the colour.

    0 (or, for floats, anything that is not finite and positive) is unknown, and so is 65535 mm.
    """

    format: DepthFormat
    encoding: PlaneEncoding = "raw"
    width: Pixels
    height: Pixels
    bytes: ByteCount


class ConfidencePart(WireModel):
    """The optional third part: one byte a depth pixel, 0 low, 1 medium, 2 high, of the depth's size."""

    format: Literal["uint8"] = "uint8"
    encoding: PlaneEncoding = "raw"
    width: Pixels
    height: Pixels
    bytes: ByteCount


class WireIntrinsics(WireModel):
    """A pinhole camera in pixels of the colour image; pixel centres at half integers."""

    fx: Number
    fy: Number
    cx: Number
    cy: Number
    width: Pixels
    height: Pixels


class FrameHeader(WireModel):
    """Everything about a frame but its pixels.

    index:            needed on a WebSocket; over HTTP the address has it, and if given here it must be the same.
    camera_to_world:  16 numbers, column by column, as a `simd_float4x4` stands in memory: x axis, y axis, z axis,
                      position.
    exposure:         how much light the image took, in units of the session's reference exposure (for instance shutter
                      seconds x ISO): linear radiance is divided by exposure / reference.
    tracking_state:   ARKit's; frames that are not `normal` are not used unless the session asks for it.
    """

    version: Annotated[Literal[1], WHOLE] = VERSION
    index: Annotated[int, Field(ge=0, le=MAX_INDEX), WHOLE] | None = None
    colour: ColourPart
    depth: DepthPart
    confidence: ConfidencePart | None = None
    intrinsics: WireIntrinsics
    camera_to_world: Annotated[list[Number], Field(min_length=16, max_length=16)]
    timestamp_s: Number | None = None
    exposure: Annotated[float, Field(ge=1e-6, le=1e6, allow_inf_nan=False)] = 1.0
    tracking_state: TrackingState = "normal"
