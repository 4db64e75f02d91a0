"""Messages of uploaded recordings: `/v1/recordings`. A recording is a folder of files, or one file."""

from typing import Annotated, Final, Literal

from pydantic import Field, StringConstraints, model_validator

from roomlight.wire.compositing import MAX_COMPOSITE_OBJECTS, CompositeObject, CompositeQuality
from roomlight.wire.frame_header import WHOLE_NUMBER, FiniteNumber, WireModel
from roomlight.wire.messages import Id, ModelChoice, Problem, WirePosition

RecordingStatus = Literal["uploading", "ready", "playing", "finished", "failed"]
RecordingId = Annotated[str, StringConstraints(pattern=r"^r-[0-9a-f]{16}$")]
MAX_FILM_FRAMES: Final = 300
"""Most frames of a film."""


class RecordingRequest(WireModel):
    """Announcement of an upload.

    Attributes:
        name: shown in lists, for example the name of the folder.
        bytes: of all files together.
        files: number of files.
    """

    name: Annotated[str, StringConstraints(min_length=1, max_length=200)]
    bytes: Annotated[int, Field(ge=1), WHOLE_NUMBER]
    files: Annotated[int, Field(ge=1), WHOLE_NUMBER]


class Film(WireModel):
    """A film of a recording with objects in it.

    Attributes:
        status: reading: the room, for its light; then making, ready; failed: see `problem`.
        frame: frames that are read, or made.
        frames: frames that will be.
        bytes: of the finished file.
    """

    status: Literal["reading", "making", "ready", "failed"]
    frame: int
    frames: int
    bytes: int
    problem: Problem | None


class Recording(WireModel):
    """An uploaded recording and its replay.

    Attributes:
        bytes: announced.
        received: bytes so far.
        files: announced.
        files_received: files that have begun.
        status: uploading, then ready, playing, finished; failed: it cannot be read, see `problem`.
        session: the session that it is played into.
        frame: frames sent to the session so far.
        frames: frames of the recording that are played; null before the first replay.
        unreadable: frames that could not be read or used so far.
        notes: what its files state and was left out, guessed or changed, and what to do about it.
        film_frames: frames that a film of it can have, and film_fps: their rate; null before the first replay.
        film: the film that was asked for last; null: none.
        expires_in_s: it is deleted after this time without a request.
    """

    id: RecordingId
    name: str
    bytes: int
    received: int
    files: int
    files_received: int
    status: RecordingStatus
    session: Id | None
    frame: int
    frames: int | None
    unreadable: int
    notes: list[str]
    film_frames: int | None
    film_fps: FiniteNumber | None
    film: Film | None
    problem: Problem | None
    expires_in_s: FiniteNumber


class RecordingList(WireModel):
    """The recordings of a token, the newest first, the bytes that they take or announced, and their limit."""

    recordings: list[Recording]
    bytes: int
    limit_bytes: int


class ReplayRequest(ModelChoice):
    """Start of a replay into a new session, at the pace of the recording.

    Attributes:
        session: id of the session, which has no frame yet.
        model: the session's model.
        height: rows of the session's panoramas.
        fps: frames per second at most: every n-th frame is played. Null: 10 of a recording with timestamps, 3 of one
            without.
        probes: named probes; null: the probes of the recording, and `view` in front of the first camera.
    """

    session: Id
    height: Annotated[int, Field(ge=16, le=512), WHOLE_NUMBER] = 120
    fps: Annotated[float, Field(ge=0.01, le=60, allow_inf_nan=False)] | None = None
    probes: Annotated[dict[Id, WirePosition], Field(max_length=64)] | None = None


class FilmRequest(WireModel):
    """A film of a recording's own frames, up to 30 a second, with objects in it. The whole recording lights them.

    Attributes:
        objects: with position or pose, in the world of the recording and of the sessions that it is played into.
        quality: preview, good or final.
        first: number of the first frame, of `film_frames`.
        frames: frames at most.
    """

    objects: Annotated[list[CompositeObject], Field(min_length=1, max_length=MAX_COMPOSITE_OBJECTS)]
    quality: CompositeQuality = "preview"
    first: Annotated[int, Field(ge=0), WHOLE_NUMBER] = 0
    frames: Annotated[int, Field(ge=1, le=MAX_FILM_FRAMES), WHOLE_NUMBER] = MAX_FILM_FRAMES

    @model_validator(mode="after")
    def _check_places(self) -> "FilmRequest":
        if any(item.pixel is not None for item in self.objects):
            raise ValueError("objects of a film must have position or pose: a pixel belongs to one frame")
        return self
