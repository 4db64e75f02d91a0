"""The JSON messages: bodies of the HTTP interface and text messages of the WebSocket, which share these models.

Units: world metres (y up), seconds, milliseconds where a name says so. Directions point from the probe toward the
light. Light is linear RGB; 1.0 is the radiance that the session's reference exposure shows as white.

`LightFormat` is the name of an output encoding, `LightForm` a format with its parameters as a client requests it, and
`EncodedLight` the light of one probe in one form.
"""

import re
from typing import Annotated, Any, Final, Literal

from pydantic import Field, StringConstraints, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from roomlight.wire.frame_header import WHOLE_NUMBER, FiniteNumber, WireModel

ID_PATTERN: Final = r"^[A-Za-z0-9_-]{1,64}\Z"
"""Pattern of session ids and probe names: safe in a path, a log line and a metric."""
MAX_PROBES: Final = 64
MAX_FORMS: Final = 20
"""Forms per request. There are 18 without their sizes: 12 formats, and sh in 2 kinds and 3 bases."""

Id = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]{1,64}$", max_length=64)]
Metres = Annotated[float, Field(ge=-1000, le=1000, allow_inf_nan=False)]
WirePosition = Annotated[list[Metres], Field(min_length=3, max_length=3)]

ModelName = Literal["auto", "classical", "single", "video"]
LightFormat = Literal[
    "exr", "hdr", "png", "npy", "cube", "ktx2", "specular", "sh", "main_light", "confidence", "equirect", "usdz", "glb"
]  # fmt: skip
HarmonicsKind = Literal["total", "ambient"]
LightUse = Literal["lighting", "reflection"]
HarmonicsBasis = Literal["arcore", "arkit", "threejs"]
CUBE_FORMATS: Final = ("cube", "ktx2", "specular", "glb")
FACE_SIZES: Final = (16, 32, 64, 128, 256)
FrameStatus = Literal["processed", "queued", "superseded", "skipped"]


def is_id(text: str) -> bool:
    """Return whether the text is a valid session id or probe name."""
    return re.match(ID_PATTERN, text) is not None


class ModelChoice(WireModel):
    """Base of the messages that open a session with a model."""

    model: ModelName = "auto"

    @model_validator(mode="before")
    @classmethod
    def _refuse_mode(cls, values: Any) -> Any:
        if isinstance(values, dict) and "mode" in values:
            rule = PydanticCustomError("renamed", "`mode` is called `model`")
            details = InitErrorDetails(type=rule, loc=("mode",), input=values["mode"])
            raise ValidationError.from_exception_data(cls.__name__, [details])
        return values


class SessionRequest(ModelChoice):
    """Options of a session.

    Attributes:
        model: which model estimates the light: auto (default: the server's), classical, single or video.
        height: height of the panoramas in pixels, 16 to 512, default 120; the width is twice the height.
        reference_exposure: the exposure at which radiance 1.0 is white, in the unit of the frames' exposure, 1e-6 to
            1e6; null: the exposure of the first frame.
        use_limited_tracking: also use frames whose tracking state is `limited`. Off by default, because their poses can
            be wrong and errors in the room's light persist.
        min_confidence: depth pixels below this confidence (0, 1 or 2; default 1) are unknown.
        unknown_depth: pixels of unknown depth take depth interpolated from the rim of their hole (`rim`, the default),
            lie on the far boundary of the volume (`far`), or are not used (`drop`).
    """

    height: Annotated[int, Field(ge=16, le=512), WHOLE_NUMBER] = 120
    reference_exposure: Annotated[float, Field(ge=1e-6, le=1e6, allow_inf_nan=False)] | None = None
    use_limited_tracking: bool = False
    min_confidence: Annotated[int, Field(ge=0, le=2), WHOLE_NUMBER] = 1
    unknown_depth: Literal["rim", "far", "drop"] = "rim"


class ProbeBody(WireModel):
    """Position of a named probe, in world metres."""

    position: WirePosition


class LightForm(WireModel):
    """An output encoding of light: a format and its parameters.

    Attributes:
        format: name of the encoding.
        size: panorama height of exr, hdr, png, npy, equirect, usdz and confidence, 8 to 512 (default: as computed);
            face width of cube, ktx2, specular and glb, 16, 32, 64, 128 or 256 (default 32).
        kind: for sh: total, or ambient (without the main light).
        basis: for sh: arcore (27 interleaved, Condon-Shortley phase, for code with -0.325735 at C1-1), arkit (27
            planar, the same phase: Apple documents 27 non-interleaved numbers without signs, these are RoomLight's),
            threejs (27 interleaved, all signs positive; also for ARCore's SDK for Unity).
        exposure_ev: for png: radiance 2^-exposure_ev is white.
        use: lighting, what lights a thing, or reflection, what is seen in a mirror and behind things; default:
            reflection for png, lighting for all others.
    """

    format: LightFormat
    size: Annotated[int, Field(ge=8, le=512), WHOLE_NUMBER] | None = None
    kind: HarmonicsKind = "total"
    basis: HarmonicsBasis = "arcore"
    exposure_ev: Annotated[float, Field(ge=-16, le=16, allow_inf_nan=False)] = 0.0
    use: LightUse | None = None

    @model_validator(mode="after")
    def _check_face_size(self) -> "LightForm":
        if self.format in CUBE_FORMATS and self.size not in (None, *FACE_SIZES):
            values = {"format": self.format, "sizes": ", ".join(map(str, FACE_SIZES))}
            rule = PydanticCustomError("face_size", "a face of {format} must be one of {sizes} pixels wide", values)
            details = InitErrorDetails(type=rule, loc=("size",), input=self.size)  # names the field, not the model
            raise ValidationError.from_exception_data("LightForm", [details])
        return self


class ProbeQuery(WireModel):
    """A point: either a position in world metres or the name of a tracked probe."""

    position: WirePosition | None = None
    name: Id | None = None

    @model_validator(mode="after")
    def _check_position_or_name(self) -> "ProbeQuery":
        if (self.position is None) == (self.name is None):
            raise ValueError("a probe must have either a position or a name")
        return self


class LightRequest(WireModel):
    """Request for light at several points after the same frame, each in every form; 1 to 64 probes, 1 to 20 forms."""

    probes: Annotated[list[ProbeQuery], Field(min_length=1, max_length=MAX_PROBES)]
    forms: Annotated[list[LightForm], Field(min_length=1, max_length=MAX_FORMS)]


class EncodedLight(WireModel):
    """The light of one probe in one form.

    Attributes:
        values: the numbers of sh and main_light.
        data: the bytes of the other formats in base64, in plain JSON.
        bytes: the number of bytes of the other formats, in a binary light message.
        use: lighting or reflection; null: that of the format, see `LightForm`.
    """

    format: LightFormat
    media_type: str
    use: LightUse | None = None
    values: dict[str, Any] | None = None
    data: str | None = None
    bytes: int | None = None


class ProbeLight(WireModel):
    """The light at one point.

    Attributes:
        coverage: fraction of the sphere that was observed, by solid angle, 0 to 1.
        etag: identifies the light: equal etags mean equal light.
    """

    position: WirePosition
    name: Id | None = None
    coverage: FiniteNumber
    etag: str
    forms: list[EncodedLight]


class LightResponse(WireModel):
    """Light at several points, in the order of the request.

    Attributes:
        frame: index of the last processed frame; -1 before the first frame: the light is then the default light, grey,
            brighter from above, with zero coverage.
    """

    frame: int
    results: list[ProbeLight]


class FrameResult(WireModel):
    """Outcome of a frame.

    Attributes:
        index: of the frame.
        status: processed: the light includes it. superseded: a newer frame replaced it in the queue. queued: accepted
            and waiting (only with `Prefer: respond-async`). skipped: not used because of its tracking state.
        replay: the same index and bytes were sent before; the frame was not processed again.
        keyframe: whether the frame was kept for probes that are requested later.
        depth_estimated: whether the server estimated the frame's depth.
        stage_ms: processing time of each stage.
        coverage: coverage of each named probe after the last processed frame.
        gain: factors of red, green and blue by which the frame's radiance becomes that of the light.
        durable_index: frames up to this index are on the server's disk and survive its restart; null: none are.
        epoch: number of the server that answered among all servers that have owned the session, from 1; null: servers
            share no state directory. It never decreases.
    """

    index: int
    status: FrameStatus
    replay: bool = False
    keyframe: bool | None = None
    depth_estimated: bool = False
    stage_ms: dict[str, float] = Field(default_factory=dict)
    coverage: dict[str, float] = Field(default_factory=dict)
    gain: Annotated[list[FiniteNumber], Field(min_length=3, max_length=3)] | None = None
    durable_index: int | None = None
    epoch: int | None = None


class FrameCounts(WireModel):
    """Counts of a session's frames. accepted = processed + superseded + skipped + queued.

    Attributes:
        gaps: indices that are missing between the first and the last accepted frame.
        durable_index: frames up to this index are on the server's disk and survive its restart; null: none are.
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
    durable_index: int | None = None


class Memory(WireModel):
    """Memory of a session: bytes now, and the upper bound with its options."""

    bytes: int
    bound_bytes: int


class Volume(WireModel):
    """The lighting volume: a box of `shape` (z, y, x) voxels with edges of `voxel_m` metres."""

    shape: list[int]
    voxel_m: FiniteNumber
    depth_max_m: FiniteNumber


class SessionState(WireModel):
    """State of a session. After an engine error its status is `failed`: delete it and open a new one."""

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
    idle_expiry_s: FiniteNumber


class Problem(WireModel):
    """Problem details (RFC 9457) of a rejected request: the field, the value received and the rule that it breaks."""

    type: str
    title: str
    status: int
    detail: str
    field: str | None = None
    value: str | None = None
    rule: str | None = None


class LightCall(LightRequest):
    """WebSocket, to the server: request light now. The answer carries the same `request`."""

    type: Literal["light"]
    request: Annotated[str, StringConstraints(max_length=64)] = ""


class Subscribe(WireModel):
    """WebSocket, to the server: send the light of all named probes in these forms now and after each frame.

    An empty list ends the subscription.
    """

    type: Literal["subscribe"]
    forms: Annotated[list[LightForm], Field(max_length=MAX_FORMS)]


class Track(WireModel):
    """WebSocket, to the server: track a named probe; an existing name moves to the new position."""

    type: Literal["track"]
    name: Id
    position: WirePosition


class Untrack(WireModel):
    """WebSocket, to the server: stop tracking a named probe."""

    type: Literal["untrack"]
    name: Id


ClientMessage = Annotated[LightCall | Subscribe | Track | Untrack, Field(discriminator="type")]
"""Text messages of a client. Frames are binary messages (`frame_message`)."""


class FrameEvent(FrameResult):
    """WebSocket, to the client: the outcome of a frame."""

    type: Literal["frame"] = "frame"


class LightAnswer(LightResponse):
    """WebSocket, to the client: the answer to a `light` message."""

    type: Literal["light"] = "light"
    request: str


class LightingUpdate(LightResponse):
    """WebSocket, to the client: the light of the named probes after a frame, for a subscription."""

    type: Literal["lighting"] = "lighting"


class ProbesEvent(WireModel):
    """WebSocket, to the client: the named probes, after `track` or `untrack`."""

    type: Literal["probes"] = "probes"
    probes: dict[str, WirePosition]


class ProblemEvent(WireModel):
    """WebSocket, to the client: a message was rejected or failed; the connection stays open.

    Attributes:
        index: index of the frame concerned, if its header could be read.
        request: `request` of the `light` message concerned.
    """

    type: Literal["problem"] = "problem"
    problem: Problem
    index: int | None = None
    request: str | None = None


ServerMessage = FrameEvent | LightAnswer | LightingUpdate | ProbesEvent | ProblemEvent
