"""Messages about what a session has seen: the list of sessions, the camera, the history, and pairing with a phone.

World metres, y up; a pose is 16 numbers, column by column, as in `frame_header`; seconds of the server's clock.
"""

from typing import Annotated, Literal

from pydantic import Field

from roomlight.wire.frame_header import FiniteNumber, WireIntrinsics, WireModel
from roomlight.wire.messages import FrameCounts, Id, WirePosition

WirePose = Annotated[list[FiniteNumber], Field(min_length=16, max_length=16)]


class SessionSummary(WireModel):
    """A session in the list of a token's sessions.

    Attributes:
        title: as its viewers have named it; empty: they have not.
        status: `saved` is on disk and not in memory; its next request restores it.
        probes: names of the tracked probes.
        idle_s: seconds since its last request; 0 while a request or a WebSocket uses it.
    """

    id: Id
    title: str = ""
    status: Literal["open", "failed", "saved"]
    model: Literal["classical", "single", "video"]
    frames: FrameCounts
    probes: list[str]
    keyframes: int
    idle_s: FiniteNumber


class SessionList(WireModel):
    """The sessions of a token, last used first, and its limits."""

    sessions: list[SessionSummary]
    max_sessions: int
    idle_expiry_s: FiniteNumber


class CameraPose(WireModel):
    """The camera at a recorded frame; seconds since the first one."""

    index: int
    seconds: FiniteNumber
    camera_to_world: WirePose


class VolumeBox(WireModel):
    """The box of the lighting volume: corners (x, y, z) in metres along its own axes."""

    volume_to_world: WirePose
    lower_m: WirePosition
    upper_m: WirePosition


class CameraView(WireModel):
    """The camera of the last processed frame, its path, and the lighting volume.

    Attributes:
        frame: index of the last processed frame; -1 before the first.
        intrinsics: of the last processed frame.
        camera_to_world: of the last processed frame.
        exposure: of the last processed frame: radiance 1 / exposure is white in its picture; light has 1 as white.
        path: the frames of the history, in order.
    """

    frame: int
    intrinsics: WireIntrinsics | None
    camera_to_world: WirePose | None
    exposure: FiniteNumber | None
    path: list[CameraPose]
    volume: VolumeBox | None


class HistoryLight(WireModel):
    """A light at a probe, with the fields of the form `main_light`, as strong as in the session's own estimate."""

    direction: list[FiniteNumber]
    intensity: list[FiniteNumber]
    radius_deg: FiniteNumber
    shadow_strength: FiniteNumber
    emitted: FiniteNumber
    number: int


class HistoryProbe(WireModel):
    """A named probe after a recorded frame; `lights` has up to three, the strongest first."""

    name: Id
    position: WirePosition
    coverage: FiniteNumber
    lights: list[HistoryLight]


class HistoryEntry(WireModel):
    """A recorded frame.

    Attributes:
        seconds: when it was processed, since the first recorded frame.
        timestamp_s: the frame's own time.
        superseded: frames replaced by newer ones so far.
        gaps: indices left out by the client so far.
        skipped: frames skipped for their tracking state so far.
        refused: frames refused so far.
    """

    index: int
    seconds: FiniteNumber
    timestamp_s: FiniteNumber | None
    keyframe: bool
    stage_ms: dict[str, float]
    superseded: int
    gaps: int
    skipped: int
    refused: int
    probes: list[HistoryProbe]


class HistoryList(WireModel):
    """The recorded frames of a session.

    Attributes:
        stride: every `stride`-th processed frame is recorded. It doubles when the history is full, and then every
            second entry is removed.
        bytes: memory of the history.
        limit_bytes: its limit; 0: no history is kept.
    """

    stride: int
    bytes: int
    limit_bytes: int
    entries: list[HistoryEntry]


class Pairing(WireModel):
    """How a phone on the local network reaches the server's page.

    Attributes:
        url: address of the phone's page, where the server has tokens with a code that pairs one phone; null if the
            server cannot be reached.
        qr_svg: the address as a QR code, an SVG document.
        fingerprint: SHA-256 of the server's certificate.
        expires_in_s: time in which the code can be used; null without a code.
        advice: what to do where there is no address.
    """

    url: str | None
    qr_svg: str | None
    fingerprint: str | None
    expires_in_s: FiniteNumber | None
    advice: str | None


class PairingCode(WireModel):
    """The code of a link, which works once."""

    code: Annotated[str, Field(max_length=100)]


class PhoneToken(WireModel):
    """The token of a phone that has been paired, and its id."""

    id: str
    token: str
    expires_in_s: FiniteNumber


class PairedPhone(WireModel):
    """A paired phone, and the ids of its open sessions."""

    id: str
    age_s: FiniteNumber
    expires_in_s: FiniteNumber
    sessions: list[Id]


class PhoneList(WireModel):
    """The phones that a token has paired."""

    phones: list[PairedPhone]
