"""Route of composites: the last frame of a session with virtual objects in it."""

import asyncio
import json
import logging
import time
from typing import Annotated, Any, Final

from fastapi import APIRouter, Body, Request, Response

from roomlight.errors import ObjectError, ProbeError, SceneError
from roomlight.wire.compositing import CompositeRequest
from roomlight_server.answers.composites import BOXES, MEDIA_TYPES, encode, make, memory_of, scene_of
from roomlight_server.base.byte_budget import Reservation
from roomlight_server.base.problems import BODY_PROBLEMS, SESSION_PROBLEMS, ProblemError, documented
from roomlight_server.routes.context import Context, ContextDep, OwnerDep, ReservationDep, SessionDep
from roomlight_server.routes.light import FRAME_HEADER
from roomlight_server.sessions.live_session import LiveSession
from roomlight_server.transport.disconnects import until_gone
from roomlight_server.work.composite_processes import MAX_MEMORY_BYTES, Composited, CompositeJob, CompositeMemoryError
from roomlight_server.work.intake import LatestFrame

_log = logging.getLogger("roomlight.server")
router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["objects"])
POSES_HEADER: Final = "Roomlight-Poses"
VISIBLE_HEADER: Final = "Roomlight-Visible"
_OK: Final[dict[int | str, dict[str, Any]]] = {
    200: {
        "description": "The picture in the media type of the format. `layers`: a zip of image.png, frame.exr, "
        "objects.exr, alpha.png (16 bits), shadow.exr, depth.exr and object_id.exr; "
        "image = frame x shadow x (1 - alpha) + objects, linear.",
        "headers": {
            FRAME_HEADER: {"description": "Index of the frame", "schema": {"type": "integer"}},
            POSES_HEADER: {
                "description": "JSON: the pose of each object by name, 16 numbers column by column. Sent back as "
                "`pose` with the anchor `origin`, the object stays where it is.",
                "schema": {"type": "string"},
            },
            VISIBLE_HEADER: {
                "description": "JSON: the share of each object by name that nothing real hides, 0 to 1.",
                "schema": {"type": "string"},
            },
        },
        "content": {kind: {} for kind in sorted(set(MEDIA_TYPES.values()))},
    }
}
_EXAMPLES: Final[dict[str, Any]] = {
    "sphere": {
        "summary": "A mirror sphere on the surface that a pixel shows",
        "value": {
            "objects": [{"shape": "sphere", "size_m": 0.2, "material": {"kind": "mirror"}, "pixel": [320, 260]}],
            "quality": "preview",
        },
    }
}


@router.post(
    "/composite",
    summary="The last frame with objects in it",
    response_class=Response,
    responses=_OK
    | documented(
        *(*BODY_PROBLEMS, *SESSION_PROBLEMS, "object-not-found", "no-frame", "bad-place", "composite-running"),
        *("owner-busy", "engine-failed", "server-busy", "composite-late"),
    ),
)
async def composite(
    live: SessionDep,
    context: ContextDep,
    owner: OwnerDep,
    reserved: ReservationDep,
    body: Annotated[CompositeRequest, Body(openapi_examples=_EXAMPLES)],
    request: Request,
) -> Response:
    """Return the last processed frame with objects in it: lit by the room, with shadows, behind real things in front.

    Frames are reduced to fit into 1920 x 1440 pixels, 1280 x 960 for good and final. Frames of this session wait for
    a preview. Other qualities are made in a process that gives way to previews and frames.
    """
    return await until_gone(request, _composite(live, context, owner, reserved, body))


async def _composite(
    live: LiveSession, context: Context, owner: str, reserved: Reservation, body: CompositeRequest
) -> Response:
    limit_s = context.settings.composite_timeout_s
    try:
        async with asyncio.timeout(limit_s), live.composite_turn() as latest:
            return await _made(live, context, owner, reserved, body, latest)
    except TimeoutError as error:
        rule = f"must be made in {limit_s:g} s, its waiting included"
        detail = f"the composite {rule}; choose preview or good, smaller objects, or retry later"
        raise ProblemError("composite-late", detail, rule=rule, retry_after_s=10) from error


async def _made(
    live: LiveSession,
    context: Context,
    owner: str,
    reserved: Reservation,
    body: CompositeRequest,
    latest: LatestFrame,
) -> Response:
    lens = latest.message.intrinsics
    digests = [item.object for item in body.objects if item.object is not None]
    files = {digest: context.objects.find(owner, digest) for digest in digests}
    placed = [files[digest] for digest in digests]
    needed = memory_of((lens.width, lens.height), body.quality, placed, files.values())
    limit = context.settings.owner_pending_bytes
    if needed > limit:
        rule = f"at most {limit} bytes for one composite; send smaller frames, or simplify the objects"
        detail = f"the composite could need {needed} bytes: {rule}"
        raise ProblemError("invalid", detail, field="objects", value=needed, rule=rule)
    reserved.add(needed)
    frame = await live.decode_latest(latest, BOXES[body.quality])
    scene = scene_of(body, files, frame.intrinsics.width / lens.width)
    start_s = time.perf_counter()
    try:
        if body.quality == "preview":
            preview = await live.preview(lambda engine: make(engine, frame, scene, "preview"))
            data = await context.workers.run_in_encode_pool(encode, preview.picture, body.format)
            made = Composited(preview.poses, preview.visible, data)
        else:
            made = await live.composite(
                lambda snapshot, options: CompositeJob(snapshot, options, frame, scene, body.quality, body.format)
            )
    except (SceneError, ObjectError, ProbeError) as error:
        raise ProblemError("bad-place", str(error), field="objects", rule=str(error)) from error
    except CompositeMemoryError as error:
        rule = f"at most {MAX_MEMORY_BYTES} bytes for its process; send smaller frames, or simplify the objects"
        detail = f"the composite needs too much memory: {rule}"
        raise ProblemError("invalid", detail, field="objects", value=needed, rule=rule) from error
    except (ProblemError, TimeoutError):
        raise
    except Exception as error:
        _log.exception("composite failed", extra={"session": live.name, "frame": latest.index})
        detail = f"the composite could not be made: {type(error).__name__}"
        raise ProblemError("engine-failed", detail) from error
    context.metrics.composite_seconds.labels(body.quality).observe(time.perf_counter() - start_s)
    poses = {name: [round(value, 6) for value in pose] for name, pose in made.poses.items()}
    visible = {name: round(share, 3) for name, share in made.visible.items()}
    stated = {POSES_HEADER: poses, VISIBLE_HEADER: visible}
    headers = {name: json.dumps(value, separators=(",", ":")) for name, value in stated.items()}
    headers[FRAME_HEADER] = str(latest.index)
    return Response(made.data, media_type=MEDIA_TYPES[body.format], headers=headers)
