"""The JSON messages: bodies of the HTTP interface and texts of the WebSocket, which are the same models.

Units: world metres (y up), seconds, milliseconds where a name says so. Directions point from the probe toward the
light. Light is linear RGB; 1.0 is what the session's reference exposure shows as white.
"""

import re
from typing import Annotated, Any, Final, Literal

from pydantic import Field, StringConstraints, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from roomlight.wire.frame_header import WHOLE, Number, WireModel

ID_PATTERN: Final = r"^[A-Za-z0-9_-]{1,64}\Z"
"""Of session ids and probe names: nothing a path, a log line or a metric could stumble over."""
MAX_PROBES: Final = 64
MAX_FORMS: Final = 8
NO_FRAME: Final = -1
"""The frame of a light that no frame is in: the prior."""

Id = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]{1,64}$", max_length=64)]
Metres = Annotated[float, Field(ge=-1000, le=1000, allow_inf_nan=False)]
WirePosition = Annotated[list[Metres], Field(min_length=3, max_length=3)]

ModelName = Literal["auto", "classical", "single", "video"]
LightFormat = Literal["exr", "hdr", "png", "npy", "cube", "ktx2", "specular", "sh", "main_light", "confidence"]
HarmonicsKind = Literal["total", "ambient"]
HarmonicsBasis = Literal["arcore", "arkit", "threejs"]
CUBE_FORMATS: Final = ("cube", "ktx2", "specular")
FACE_SIZES: Final = (16, 32, 64, 128, 256)
FrameStatus = Literal["processed", "queued", "superseded", "skipped"]


def is_id(text: str) -> bool:
    """Whether this may name a session or a probe."""
    return re.match(ID_PATTERN, text) is not None


class SessionRequest(WireModel):
    """What a session is to be; sent again with the same values it changes nothing.

    height:              of the panoramas in pixels; their width is twice that.
    reference_exposure:  the exposure that shows radiance 1.0 as white, in the frames' unit; null: the first frame's.
    use_limited_tracking: take frames whose tracking is `limited` too. Their poses can be wrong, and what they
                         smear over the room stays: hence not by default.
    min_confidence:      depth pixels below this confidence (0, 1, 2) are unknown.
    """

    mode: ModelName = "auto"
    height: Annotated[int, Field(ge=16, le=512), WHOLE] = 120
    reference_exposure: Annotated[float, Field(ge=1e-6, le=1e6, allow_inf_nan=False)] | None = None
    use_limited_tracking: bool = False
    min_confidence: Annotated[int, Field(ge=0, le=2), WHOLE] = 1
    unknown_depth: Literal["rim", "far", "drop"] = "rim"


class ProbeBody(WireModel):
    """Where a named probe is, in world metres."""

    position: WirePosition


class LightForm(WireModel):
    """One form in which light is wanted.

    size:         height of exr, hdr, png, npy and confidence, 8 to 512 (default: as computed); side of a face of cube,
                  ktx2 and specular, 16, 32, 64, 128 or 256 (default 32).
    kind:         for sh: total, or ambient (without the main light).
    basis:        for sh: arcore (27 interleaved, Condon-Shortley phase; WebXR's too), arkit (27 planar, that phase),
                  threejs (27 interleaved, signs all positive).
    exposure_ev:  for png: radiance 2^-exposure_ev is white.
    """

    format: LightFormat
    size: Annotated[int, Field(ge=8, le=512), WHOLE] | None = None
    kind: HarmonicsKind = "total"
    basis: HarmonicsBasis = "arcore"
    exposure_ev: Annotated[float, Field(ge=-16, le=16, allow_inf_nan=False)] = 0.0

    @model_validator(mode="after")
    def _face_sizes(self) -> "LightForm":
        if self.format in CUBE_FORMATS and self.size not in (None, *FACE_SIZES):
            said = {"format": self.format, "sizes": ", ".join(map(str, FACE_SIZES))}
            rule = PydanticCustomError("face_size", "faces of {format} are {sizes} pixels wide", said)
            at = InitErrorDetails(type=rule, loc=("size",), input=self.size)  # the field that is wrong, not the whole
            raise ValidationError.from_exception_data("LightForm", [at])
        return self


class ProbeQuery(WireModel):
    """A point: a position in world metres, or the name of a tracked probe."""

    position: WirePosition | None = None
    name: Id | None = None

    @model_validator(mode="after")
    def _one_of_two(self) -> "ProbeQuery":
        if (self.position is None) == (self.name is None):
            raise ValueError("a probe has either a position or a name")
        return self


class LightRequest(WireModel):
    """Light at several points, each in every one of the forms, all at one moment of the session."""

    probes: Annotated[list[ProbeQuery], Field(min_length=1, max_length=MAX_PROBES)]
    forms: Annotated[list[LightForm], Field(min_length=1, max_length=MAX_FORMS)]


class EncodedLight(WireModel):
    """One form of one probe's light.

    values: for sh and main_light, the numbers themselves.
    data:   for the others in JSON, base64; in a binary light message `bytes` is their length instead.
    """

    format: LightFormat
    media_type: str
    values: dict[str, Any] | None = None
    data: str | None = None
    bytes: int | None = None


class ProbeLight(WireModel):
    """The light at one point. `coverage`: share of the sphere that was observed, by solid angle, 0 to 1.

    etag: the same as long as the light at this point is.
    """

    position: WirePosition
    name: Id | None = None
    coverage: Number
    etag: str
    forms: list[EncodedLight]


class LightResponse(WireModel):
    """Light after `frame` (the index of the last processed frame), in the order it was asked for.

    frame: -1 before the first: the light is then the prior, grey and brighter from above, with coverage 0.
    """

    frame: int
    results: list[ProbeLight]


class FrameResult(WireModel):
    """What became of a frame.

    status:   processed: the light has it. superseded: a newer frame came before this one's turn. queued: accepted, its
              turn is to come (only with `Prefer: respond-async`). skipped: its tracking state rules it out.
    replay:   the same index and bytes had been sent before: nothing was done again.
    coverage: of each named probe, after the last processed frame.
    """

    index: int
    status: FrameStatus
    replay: bool = False
    keyframe: bool | None = None
    stage_ms: dict[str, float] = Field(default_factory=dict)
    coverage: dict[str, float] = Field(default_factory=dict)


class FrameCounts(WireModel):
    """Frames of a session so far. accepted = processed + superseded + skipped + queued.

    gaps: indices between the first and the last accepted that never came.
    """

    accepted: int
    processed: int
    superseded: int
    skipped: int
    queued: int
    gaps: int
    replayed: int
    refused: int
    last_index: int | None


class Memory(WireModel):
    """Bytes that the session holds now, and the most it can come to with these options."""

    bytes: int
    bound_bytes: int


class Volume(WireModel):
    """The lighting volume, in the world: a box of `shape` (z, y, x) voxels of `voxel_m`."""

    shape: list[int]
    voxel_m: Number
    depth_max_m: Number


class SessionState(WireModel):
    """A session. `status`: open; failed, after an engine error (delete it and open it anew)."""

    id: Id
    status: Literal["open", "failed"]
    model: Literal["classical", "single", "video"]
    options: SessionRequest
    frames: FrameCounts
    probes: dict[str, WirePosition]
    coverage: dict[str, float]
    keyframes: int
    memory: Memory
    volume: Volume | None
    idle_expiry_s: Number


class Problem(WireModel):
    """RFC 9457: why a request was refused. `field`, `value`, `rule`: where, what stood there, what would be right."""

    type: str
    title: str
    status: int
    detail: str
    field: str | None = None
    value: str | None = None
    rule: str | None = None


class LightCall(LightRequest):
    """WebSocket, to the server: light now. The answer carries the same `request`."""

    type: Literal["light"]
    request: Annotated[str, StringConstraints(max_length=64)] = ""


class Subscribe(WireModel):
    """WebSocket, to the server: send every named probe's light in these forms, now and after each frame; none: stop."""

    type: Literal["subscribe"]
    forms: Annotated[list[LightForm], Field(max_length=MAX_FORMS)]


class Track(WireModel):
    """WebSocket, to the server: follow this point from now on; a name that is taken moves."""

    type: Literal["track"]
    name: Id
    position: WirePosition


class Untrack(WireModel):
    """WebSocket, to the server: no longer follow it."""

    type: Literal["untrack"]
    name: Id


ClientMessage = Annotated[LightCall | Subscribe | Track | Untrack, Field(discriminator="type")]
"""What a client sends as text; frames are binary messages (`frame_message`)."""


class FrameEvent(FrameResult):
    """WebSocket, to the client: what became of a frame."""

    type: Literal["frame"] = "frame"


class LightAnswer(LightResponse):
    """WebSocket, to the client: the answer to a `light` message."""

    type: Literal["light"] = "light"
    request: str


class LightingUpdate(LightResponse):
    """WebSocket, to the client: the named probes' light after a frame, if any is subscribed to."""

    type: Literal["lighting"] = "lighting"


class ProbesEvent(WireModel):
    """WebSocket, to the client: the named probes, after `track` or `untrack`."""

    type: Literal["probes"] = "probes"
    probes: dict[str, WirePosition]


class ProblemEvent(WireModel):
    """WebSocket, to the client: a message was refused; the connection goes on.

    index:   of the frame it was about, if its header could be read.  request: of the `light` message.
    """

    type: Literal["problem"] = "problem"
    problem: Problem
    index: int | None = None
    request: str | None = None


ServerMessage = FrameEvent | LightAnswer | LightingUpdate | ProbesEvent | ProblemEvent
