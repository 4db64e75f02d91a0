"""`/v1/sessions/{id}`: open, look at, delete; and its frames."""

import asyncio
from typing import Annotated, Any, Final

from fastapi import APIRouter, Body, Header, Path, Request, Response

from roomlight.wire.frame_header import MAX_INDEX
from roomlight.wire.messages import FrameResult, SessionRequest, SessionState
from roomlight_server.bodies import read_frame
from roomlight_server.context import In, Live, Owner, SessionId
from roomlight_server.problems import BODY_REFUSALS, documented

FRAME_MEDIA_TYPE: Final = "application/vnd.roomlight.frame"
router = APIRouter(prefix="/v1/sessions/{session_id}")

_FRAME_BODY: Final[dict[str, Any]] = {
    "requestBody": {
        "required": True,
        "description": "A frame message (server/WIRE.md): `RLF1`, header length, JSON header, then colour, depth, "
        "confidence. As multipart: the parts `header` (the JSON, without lengths), `colour`, `depth`, `confidence`.",
        "content": {
            FRAME_MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}},
            "application/octet-stream": {"schema": {"type": "string", "format": "binary"}},
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["header", "colour", "depth"],
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
    "defaults": {"summary": "The best model there is, the first frame's exposure", "value": {}},
    "replay": {
        "summary": "As `roomlight replay` does it",
        "value": {"mode": "classical", "height": 120, "reference_exposure": 1.0},
    },
}
_PROCESSED: Final[dict[str, Any]] = {
    "index": 7,
    "status": "processed",
    "replay": False,
    "keyframe": True,
    "stage_ms": {"prepare": 2.1, "volume": 9.3, "sglv": 6.0, "mesh": 18.2, "render": 4.4, "partial": 6.1, "blend": 2.0},
    "coverage": {"table": 0.42},
}


@router.put(
    "",
    tags=["sessions"],
    summary="Open a session",
    response_model=SessionState,
    responses={201: {"model": SessionState, "description": "Opened"}}
    | documented(
        *BODY_REFUSALS, "unauthorized", "session-conflict", "model-not-here", "invalid", "server-full", "stopping"
    ),
)
async def open_session(
    session_id: SessionId,
    context: In,
    owner: Owner,
    response: Response,
    request: Annotated[SessionRequest | None, Body(openapi_examples=_OPTIONS)] = None,
) -> SessionState:
    """Open a session under an id of the client's making. Again with the same options: 200, nothing changes."""
    live, new = await context.registry.open(owner, session_id, request or SessionRequest())
    response.status_code = 201 if new else 200
    return live.state()


@router.get(
    "",
    tags=["sessions"],
    summary="A session's state",
    responses=documented("unauthorized", "session-not-found", "invalid"),
)
async def session_state(live: Live) -> SessionState:
    """Frames accepted, dropped and missing, memory, model, probes with their coverage, the volume."""
    return live.state()


@router.delete(
    "",
    tags=["sessions"],
    summary="End a session",
    status_code=204,
    responses=documented("unauthorized", "session-not-found", "invalid"),
)
async def delete_session(session_id: SessionId, context: In, owner: Owner) -> None:
    """End it; frames on their way get 410."""
    context.registry.delete(owner, session_id)


@router.put(
    "/frames/{index}",
    tags=["frames"],
    summary="Send a frame",
    openapi_extra=_FRAME_BODY,
    response_model=FrameResult,
    responses={
        200: {
            "description": "processed, superseded by a newer frame, or skipped for its tracking state",
            "content": {"application/json": {"example": _PROCESSED}},
        },
        202: {"model": FrameResult, "description": "queued (`Prefer: respond-async`)"},
    }
    | documented(
        *(*BODY_REFUSALS, "unauthorized", "session-not-found", "frame-conflict", "session-failed", "session-closed"),
        *("bad-frame", "invalid", "session-full", "engine-failed"),
    ),
)
async def put_frame(
    live: Live,
    index: Annotated[int, Path(ge=0, le=MAX_INDEX)],
    request: Request,
    response: Response,
    prefer: Annotated[str, Header(description="`respond-async`: 202 as soon as the frame is accepted.")] = "",
) -> FrameResult:
    """Send the next frame; the answer comes when it was processed, or a newer one took its place.

    The same index and bytes again are a replay (200); an older index, or other bytes, a conflict (409). Gaps are
    counted.
    """
    async with live.room_for_frame():
        entry = await live.accept(await read_frame(request), index)
        if "respond-async" in prefer.lower() and not entry.outcome.done():
            response.status_code = 202
            return FrameResult(index=index, status="queued")
        return await asyncio.shield(entry.outcome)
