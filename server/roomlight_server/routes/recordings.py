"""Routes of recordings, `/v1/recordings`: upload in pieces, list, replay into a session, films with objects."""

import asyncio
from typing import Annotated, Any, Final

from fastapi import APIRouter, Body, Header, Path, Request
from fastapi.responses import FileResponse, JSONResponse

from roomlight.wire.compositing import CompositeRequest
from roomlight.wire.recordings import FilmRequest, Recording, RecordingList, RecordingRequest, ReplayRequest
from roomlight_server.answers.composites import scene_of
from roomlight_server.base.problems import BODY_PROBLEMS, RESTORE_PROBLEMS, ProblemError, documented, problem_response
from roomlight_server.recordings.files import MAX_PIECE_BYTES, append
from roomlight_server.recordings.jobs import FilmJob
from roomlight_server.routes.bodies import read_body
from roomlight_server.routes.context import ContextDep, OwnerDep, ReservationDep

RECORDINGS_PATH: Final = "/v1/recordings"
OFFSET_HEADER: Final = "Upload-Offset"
router = APIRouter(prefix=RECORDINGS_PATH, tags=["recordings"])
sample_router = APIRouter(tags=["recordings"])
RecordingPath = Annotated[str, Path(pattern=r"^r-[0-9a-f]{16}$", description="Id of the recording.")]
_PROBLEMS: Final = ("unauthorized", "recording-not-found", "invalid")
_PIECE: Final[dict[str, Any]] = {
    "requestBody": {
        "required": True,
        "description": f"The next piece of the file, at most {MAX_PIECE_BYTES} bytes.",
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}
_EXAMPLE: Final[dict[str, Any]] = {
    "archive": {"summary": "One .r3d file", "value": {"name": "kitchen.r3d", "bytes": 48210233, "files": 1}}
}
_REPLAY: Final[dict[str, Any]] = {"defaults": {"summary": "As recorded", "value": {"session": "kitchen"}}}
_FILM: Final[dict[str, Any]] = {
    "sphere": {
        "summary": "A mirror sphere in the first ten seconds",
        "value": {
            "objects": [{"shape": "sphere", "size_m": 0.2, "material": {"kind": "mirror"}, "position": [0, 1, 0]}]
        },
    }
}


@router.post(
    "",
    summary="Announce an upload",
    status_code=201,
    responses=documented(*BODY_PROBLEMS, "unauthorized", "invalid", "too-many-recordings", "recording-memory"),
)
async def add_recording(
    context: ContextDep, owner: OwnerDep, body: Annotated[RecordingRequest, Body(openapi_examples=_EXAMPLE)]
) -> Recording:
    """Announce the size of a recording, a folder or one file; then send its files with `PUT`.

    It is deleted after an hour without a request.
    """
    return context.recordings.add(owner, body)


@sample_router.post(
    "/v1/sample-recording",
    summary="Add the sample room",
    status_code=201,
    responses=documented("unauthorized", "too-many-recordings", "recording-memory"),
)
async def add_sample(context: ContextDep, owner: OwnerDep) -> Recording:
    """Add the recording that is part of RoomLight, 2 MB: it is complete and can be played."""
    return await context.recordings.add_sample(owner)


@router.get("", summary="List the recordings", responses=documented("unauthorized"))
async def list_recordings(context: ContextDep, owner: OwnerDep) -> RecordingList:
    """Return the recordings of this token, the newest first."""
    return context.recordings.listed(owner)


@router.get("/{recording_id}", summary="A recording", responses=documented(*_PROBLEMS))
async def get_recording(context: ContextDep, owner: OwnerDep, recording_id: RecordingPath) -> Recording:
    """Return the progress of an upload or of a replay."""
    return context.recordings.describe(context.recordings.find(owner, recording_id))


@router.delete("/{recording_id}", summary="Delete a recording", status_code=204, responses=documented(*_PROBLEMS))
async def delete_recording(context: ContextDep, owner: OwnerDep, recording_id: RecordingPath) -> None:
    """Cancel the upload, stop the replay and delete the files. The session stays."""
    await context.recordings.delete(context.recordings.find(owner, recording_id))


@router.put(
    "/{recording_id}/files/{path:path}",
    summary="Send a piece of a file",
    openapi_extra=_PIECE,
    response_model=Recording,
    responses=documented(*BODY_PROBLEMS, *_PROBLEMS, "upload-offset", "recording-memory", "server-busy"),
)
async def put_piece(
    context: ContextDep,
    owner: OwnerDep,
    reserved: ReservationDep,
    request: Request,
    recording_id: RecordingPath,
    path: Annotated[str, Path(description="Relative path of the file, parts separated by `/`.")],
    upload_offset: Annotated[int, Header(ge=0, description="Bytes of the file that were sent before.")] = 0,
) -> Recording | JSONResponse:
    """Send the next piece of a file. A piece is kept whole or not at all; after an error, send it again.

    If the file has another size than `Upload-Offset`, the answer (409) has its size in this header: go on from there.
    """
    recording = context.recordings.find(owner, recording_id)
    data = await read_body(request, reserved, copies=2)  # as received, and joined

    async def write() -> None:
        with recording.files.piece(path, upload_offset, len(data)) as file:
            await asyncio.to_thread(append, file, upload_offset, data)

    try:
        await asyncio.shield(write())  # to its end: a late thread would cut the next piece
    except ProblemError as error:
        if error.kind != "upload-offset":
            raise
        refused = problem_response(error)
        refused.headers[OFFSET_HEADER] = str(recording.files.size_of(path))
        return refused
    except OSError as error:
        detail = f"the piece could not be stored: {error.strerror or type(error).__name__}; send it again later"
        raise ProblemError("recording-memory", detail, retry_after_s=60) from error
    return context.recordings.describe(recording)


@router.put(
    "/{recording_id}/replay",
    summary="Play a recording",
    status_code=202,
    responses=documented(
        *(*BODY_PROBLEMS, *RESTORE_PROBLEMS, "recording-not-found", "recording-not-ready", "recording-playing"),
        "session-failed",
    ),
)
async def start_replay(
    context: ContextDep,
    owner: OwnerDep,
    recording_id: RecordingPath,
    body: Annotated[ReplayRequest, Body(openapi_examples=_REPLAY)],
) -> Recording:
    """Play the recording into a session, which is opened if necessary, at the pace of the recording.

    A recording that cannot be read has the status `failed` soon after, with a `problem` that says why.
    """
    recording = context.recordings.find(owner, recording_id)
    await context.recordings.play(recording, body)
    return context.recordings.describe(recording)


@router.delete("/{recording_id}/replay", summary="Stop the replay", responses=documented(*_PROBLEMS))
async def stop_replay(context: ContextDep, owner: OwnerDep, recording_id: RecordingPath) -> Recording:
    """Stop the replay; the session stays as it is."""
    recording = context.recordings.find(owner, recording_id)
    await context.recordings.stop(recording)
    return context.recordings.describe(recording)


@router.put(
    "/{recording_id}/film",
    summary="Make a film of a recording",
    status_code=202,
    responses=documented(
        *(*BODY_PROBLEMS, *_PROBLEMS, "object-not-found", "recording-not-ready", "film-running"),
        *("too-many-recordings", "recording-memory"),
    ),
)
async def make_film(
    context: ContextDep,
    owner: OwnerDep,
    recording_id: RecordingPath,
    body: Annotated[FilmRequest, Body(openapi_examples=_FILM)],
) -> Recording:
    """Begin a film of the recording with objects in it, in place of an earlier film; `film` says how far it is.

    Frames are reduced as those of composites are. The film is H.264 in MP4, at most 128 MiB.
    """
    recording = context.recordings.find(owner, recording_id)
    digests = {item.object for item in body.objects if item.object is not None}
    files = {digest: context.objects.find(owner, digest) for digest in digests}
    scene = scene_of(CompositeRequest(objects=body.objects), files, 1.0)
    job = FilmJob(context.workers.base_options, scene, body.quality, body.first, body.frames)
    context.recordings.make_film(recording, job)
    return context.recordings.describe(recording)


@router.get(
    "/{recording_id}/film",
    summary="The film of a recording",
    response_class=FileResponse,
    responses={200: {"content": {"video/mp4": {}}}} | documented(*_PROBLEMS, "film-not-found"),
)
async def get_film(context: ContextDep, owner: OwnerDep, recording_id: RecordingPath) -> FileResponse:
    """Return the film once it is ready."""
    made = context.recordings.find(owner, recording_id).film
    if made is None or made.film.status != "ready":
        state = "there is none" if made is None else f"its status is {made.film.status}"
        raise ProblemError("film-not-found", f"the recording has no finished film: {state}; make one with PUT")
    return FileResponse(made.file, media_type="video/mp4", filename=f"{recording_id}.mp4")


@router.delete("/{recording_id}/film", summary="Stop and delete a film", responses=documented(*_PROBLEMS))
async def delete_film(context: ContextDep, owner: OwnerDep, recording_id: RecordingPath) -> Recording:
    """Stop the film if it is being made, and delete it; the recording stays."""
    recording = context.recordings.find(owner, recording_id)
    await context.recordings.stop_film(recording)
    return context.recordings.describe(recording)
