"""Routes of sessions, `/v1/sessions/{id}`: open, state, delete, and frames."""

import asyncio
from typing import Annotated, Any, Final

from fastapi import APIRouter, Body, Header, Path, Request, Response

from roomlight.wire.frame_header import MAX_INDEX
from roomlight.wire.messages import FrameResult, SessionRequest, SessionState
from roomlight_server.base.problems import BODY_PROBLEMS, RESTORE_PROBLEMS, SESSION_PROBLEMS, documented
from roomlight_server.routes.bodies import read_frame
from roomlight_server.routes.context import ContextDep, ReservationDep, SessionDep, SessionId, SessionOwnerDep
from roomlight_server.sessions.frame_queue import Entry
from roomlight_server.transport.disconnects import until_gone

FRAME_MEDIA_TYPE: Final = "application/vnd.roomlight.frame"
router = APIRouter(prefix="/v1/sessions/{session_id}")

_FRAME_BODY: Final[dict[str, Any]] = {
    "requestBody": {
        "required": True,
        "description": "A frame message (see the wire format): `RLF1`, header length, JSON header, colour, depth, "
        "confidence. Multipart: the parts `header` (the JSON, without lengths), `colour`, `depth`, `confidence`.",
        "content": {
            FRAME_MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}},
            "application/octet-stream": {"schema": {"type": "string", "format": "binary"}},
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["header", "colour"],
                    "additionalProperties": False,
                    "properties": {
                        "header": {"type": "string", "contentMediaType": "application/json"},
                        "colour": {"type": "string", "format": "binary"},
                        "depth": {"type": "string", "format": "binary"},
                        "confidence": {"type": "string", "format": "binary"},
                    },
                },
            },
        },
    }
}
_OPTIONS: Final[dict[str, Any]] = {
    "defaults": {"summary": "The server's default model, the exposure of the first frame", "value": {}},
    "replay": {
        "summary": "The options of `roomlight replay`",
        "value": {"model": "classical", "height": 120, "reference_exposure": 1.0},
    },
}
_PROCESSED: Final[dict[str, Any]] = {
    "index": 7,
    "status": "processed",
    "replay": False,
    "keyframe": True,
    "stage_ms": {
        "prepare": 2.1,
        "volume": 9.3,
        "sglv": 6.0,
        "mesh": 18.2,
        "render": 4.4,
        "partial": 6.1,
        "blend": 2.0,
        "lights": 2.0,
    },
    "coverage": {"table": 0.42},
}


@router.put(
    "",
    tags=["sessions"],
    summary="Open a session",
    response_model=SessionState,
    responses={201: {"model": SessionState, "description": "A new session is open"}}
    | documented(*BODY_PROBLEMS, *RESTORE_PROBLEMS),
)
async def open_session(
    session_id: SessionId,
    context: ContextDep,
    owner: SessionOwnerDep,
    response: Response,
    request: Annotated[SessionRequest | None, Body(openapi_examples=_OPTIONS)] = None,
) -> SessionState:
    """Open a session under an id chosen by the client.

    If the session exists with the same options, it is unchanged and the status is 200. If it exists with other options,
    the problem (409) names the first option that differs. `GET` joins an existing session without knowing its options.
    """
    live, new = await context.registry.open(owner, session_id, request or SessionRequest())
    response.status_code = 201 if new else 200
    return live.state()


@router.get(
    "",
    tags=["sessions"],
    summary="State of a session",
    responses=documented(*RESTORE_PROBLEMS, "session-not-found"),
)
async def session_state(live: SessionDep) -> SessionState:
    """Return options, model, frame counts, named probes with their coverage, memory and volume of a session.

    A client joins an existing session with this request: it needs only the id.
    """
    return live.state()


@router.delete(
    "",
    tags=["sessions"],
    summary="End a session",
    status_code=204,
    responses=documented("unauthorized", "session-not-found", "state-refused", "invalid", "state-unavailable"),
)
async def delete_session(session_id: SessionId, context: ContextDep, owner: SessionOwnerDep) -> None:
    """End a session; frames in flight are answered with 410."""
    await context.registry.erase(owner, session_id)


@router.put(
    "/frames/{index}",
    tags=["frames"],
    summary="Send a frame",
    openapi_extra=_FRAME_BODY,
    response_model=FrameResult,
    responses={
        200: {
            "description": "processed, superseded by a newer frame, or skipped because of its tracking state",
            "content": {"application/json": {"example": _PROCESSED}},
        },
        202: {"model": FrameResult, "description": "accepted and queued (`Prefer: respond-async`)"},
    }
    | documented(
        *(*BODY_PROBLEMS, *SESSION_PROBLEMS, "frame-conflict", "bad-frame", "session-full"),
        *("owner-busy", "engine-failed", "server-busy"),
    ),
)
async def put_frame(
    live: SessionDep,
    context: ContextDep,
    reservation: ReservationDep,
    index: Annotated[int, Path(ge=0, le=MAX_INDEX)],
    request: Request,
    response: Response,
    prefer: Annotated[str, Header(description="`respond-async`: answer 202 when the frame is accepted.")] = "",
) -> FrameResult:
    """Send a frame. The answer comes when the frame is processed or superseded by a newer one.

    Repeating the last index with the same bytes is a replay (200). An older index, or the last one with other bytes, is
    a conflict (409). Indices may leave gaps.
    """
    context.registry.check_not_stopping()
    async with live.slots.slot():
        entry = await until_gone(request, live.accept(await read_frame(request, reservation), index))
        if "respond-async" in prefer.lower() and not entry.outcome.done():
            response.status_code = 202
            return FrameResult(index=index, status="queued")
        return await until_gone(request, _outcome(entry))


async def _outcome(entry: Entry) -> FrameResult:
    return await asyncio.shield(entry.outcome)  # the frame is processed, whether or not its client waits
