"""Routes of what a session has seen: list of sessions, picture, camera, room mesh, history."""

from typing import Annotated, Any, Final, Literal, cast

import cv2
import numpy as np
from fastapi import APIRouter, Path, Query, Request, Response
from jaxtyping import Float

from roomlight.conventions import NO_FRAME, linear_to_srgb8
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.imaging.tags import read_tags
from roomlight.wire.frame_header import MAX_INDEX
from roomlight.wire.frame_message import column_major
from roomlight.wire.messages import FrameCounts
from roomlight.wire.room import CameraView, HistoryList, SessionList, SessionSummary, VolumeBox
from roomlight_server.answers.room_mesh import MAX_TRIANGLES, room_mesh, to_glb
from roomlight_server.base.problems import SESSION_PROBLEMS, ProblemError, documented
from roomlight_server.routes.context import ContextDep, OwnerDep, ProbeName, ReservationDep, SessionDep
from roomlight_server.routes.etags import UNCHANGED, data_answer, etag_of, json_answer, unchanged
from roomlight_server.routes.light import FRAME_HEADER
from roomlight_server.sessions.live_session import LiveSession
from roomlight_server.state.listing import SavedHead

router = APIRouter(tags=["room"])
KEYFRAMES_HEADER: Final = "Roomlight-Keyframes"
GLB: Final = "model/gltf-binary"
_PICTURE_BOX: Final = (1920, 1440)
"""Pictures that browsers do not show (HEIC, raw) or turn (EXIF) are re-encoded at most this large."""
_MESH_BYTES: Final = 24 * 2**20
"""Memory of 25 keyframe meshes while they are merged."""
_MESHES_KEPT: Final = 4
"""Meshes kept for several clients, of up to 3 MB; making one of 16 keyframes takes 0.7 s of one core."""
_Index = Annotated[int, Path(ge=0, le=MAX_INDEX)]


def _binary(*kinds: str) -> dict[int | str, dict[str, Any]]:
    return {200: {"description": "The bytes", "content": {kind: {} for kind in kinds}}, **UNCHANGED}


@router.get("/v1/sessions", summary="List the sessions", responses=documented("unauthorized"))
async def list_sessions(context: ContextDep, owner: OwnerDep) -> SessionList:
    """Return the sessions of this token, in memory or on disk alone (`saved`), last used first."""
    listed = [_summary(live, idle_s) for live, idle_s in context.registry.listed(owner)]
    listed += [_saved_summary(head) for head in await context.registry.saved(owner)]
    listed.sort(key=lambda summary: summary.idle_s)
    settings = context.settings
    most = min(settings.max_sessions, settings.owner_sessions)
    return SessionList(sessions=listed, max_sessions=most, idle_expiry_s=settings.idle_expiry_s)


def _summary(live: LiveSession, idle_s: float) -> SessionSummary:
    state = live.state()
    return SessionSummary(
        id=state.id,
        title=live.scene.title,
        status=state.status,
        model=state.model,
        frames=state.frames,
        probes=list(state.probes),
        keyframes=state.keyframes,
        idle_s=round(idle_s, 1),
    )


def _saved_summary(head: SavedHead) -> SessionSummary:
    values = head.values
    used = sum(values.queue.counts[name] for name in ("processed", "superseded", "skipped"))
    last = values.queue.last_index
    counts = FrameCounts(accepted=used, queued=0, last_index=last, durable_index=last, **values.queue.counts)
    return SessionSummary(
        id=values.name,
        title=values.scene.title,
        status="saved",
        model=cast("Literal['classical', 'single', 'video']", head.model),
        frames=counts,
        probes=list(values.probes),
        keyframes=len(values.bases),
        idle_s=round(head.idle_s, 1),
    )


@router.get(
    "/v1/sessions/{session_id}/colour",
    summary="Picture of the last frame",
    response_class=Response,
    responses=_binary("image/jpeg", "image/png") | documented(*SESSION_PROBLEMS, "no-frame", "server-busy"),
)
async def colour(live: SessionDep, context: ContextDep, reserved: ReservationDep, request: Request) -> Response:
    """Return the picture of the last processed frame: JPEG or PNG as it was sent, anything else as JPEG.

    One whose EXIF turns it is encoded again, without EXIF: browsers would turn it away from the camera's intrinsics.
    """
    live.check_open()
    latest = live.latest
    if latest is None:
        raise ProblemError("no-frame", "the session has no processed frame yet: push a frame first")
    encoding = latest.message.header.colour.encoding
    headers = {"ETag": etag_of(f"{live.history.key} {latest.index}".encode()), FRAME_HEADER: str(latest.index)}
    if same := unchanged(request, headers):
        return same
    if encoding in ("jpeg", "png"):
        reserved.add(len(latest.message.colour))
        sent = bytes(latest.message.colour)
        tags = await context.workers.run_in_encode_pool(read_tags, sent, "the picture")
        if tags.exif.orientation == 1:
            return Response(sent, media_type=f"image/{encoding}", headers=headers)
    reserved.add(16 * _PICTURE_BOX[0] * _PICTURE_BOX[1])
    frame = await live.decode_latest(latest, _PICTURE_BOX)
    data = await context.workers.run_in_encode_pool(_jpeg, frame.image)
    return Response(data, media_type="image/jpeg", headers=headers)


def _jpeg(image: Float[np.ndarray, "h w 3"]) -> bytes:
    return cv2.imencode(".jpg", np.ascontiguousarray(linear_to_srgb8(image)[..., ::-1]))[1].tobytes()


@router.get(
    "/v1/sessions/{session_id}/camera",
    summary="Camera, its path and the volume",
    response_model=CameraView,
    responses=UNCHANGED | documented(*SESSION_PROBLEMS),
)
async def camera(live: SessionDep, request: Request) -> Response:
    """Return the camera of the last processed frame, the cameras of the recorded frames, and the volume's box."""
    grid = await live.read(lambda engine: engine.grid)
    latest = live.latest
    view = CameraView(
        frame=NO_FRAME if latest is None else latest.index,
        intrinsics=None if latest is None else latest.message.header.intrinsics,
        camera_to_world=None if latest is None else list(latest.message.header.camera_to_world),
        exposure=None if latest is None else live.exposure_of(latest),
        path=live.history.path(),
        volume=None if grid is None else _box(grid),
    )
    return json_answer(request, view)


def _box(grid: VolumeGrid) -> VolumeBox:
    return VolumeBox(
        volume_to_world=column_major(grid.volume_to_world),
        lower_m=grid.lower_m.tolist(),
        upper_m=grid.upper_m.tolist(),
    )


@router.get(
    "/v1/sessions/{session_id}/mesh",
    summary="The room as a mesh",
    response_class=Response,
    responses=_binary(GLB) | documented(*SESSION_PROBLEMS, "no-frame", "server-busy"),
)
async def mesh(
    live: SessionDep,
    context: ContextDep,
    reserved: ReservationDep,
    request: Request,
    triangles: Annotated[int, Query(ge=1000, le=MAX_TRIANGLES, description="Most triangles.")] = MAX_TRIANGLES,
) -> Response:
    """Return the surfaces that the keyframes show as binary glTF: world metres, unlit, with a colour per vertex.

    The ETag changes with the keyframes and what is known of their clipped pixels.
    """
    meshes = await live.read(lambda engine: engine.meshes[: engine.keyframes])
    if not any(len(mesh.faces) for _, mesh in meshes):
        raise ProblemError("no-frame", "the session has no keyframe with a surface yet: push a frame with depth")
    shown = await context.workers.run_in_encode_pool(lambda: [(at, mesh.texture.checksum) for at, mesh in meshes])
    etag = etag_of(f"{live.history.key} {triangles} {shown}".encode())
    headers = {"ETag": etag, KEYFRAMES_HEADER: str(len(meshes))}
    if same := unchanged(request, headers):
        return same
    made = context.meshes.get(etag)
    if made is None:
        reserved.add(_MESH_BYTES)
        parts = [mesh for _, mesh in meshes]
        made = await context.workers.run_in_encode_pool(lambda: to_glb(room_mesh(parts, max_triangles=triangles)))
        context.meshes[etag] = made
        while len(context.meshes) > _MESHES_KEPT:
            context.meshes.popitem(last=False)
    return Response(made, media_type=GLB, headers=headers)


@router.get(
    "/v1/sessions/{session_id}/history",
    summary="Recorded frames",
    response_model=HistoryList,
    responses=UNCHANGED | documented(*SESSION_PROBLEMS),
)
async def history(
    live: SessionDep,
    request: Request,
    after: Annotated[int, Query(ge=NO_FRAME, le=MAX_INDEX, description="Only frames after this index.")] = NO_FRAME,
) -> Response:
    """Return the recorded frames: stage times, dropped frames, and the lights of each probe.

    When the history is full, every second entry is removed and `stride` doubles: read all entries again then.
    """
    live.check_open()
    return json_answer(request, live.history.listed(after))


@router.get(
    "/v1/sessions/{session_id}/history/{index}/colour",
    summary="Small picture of a recorded frame",
    response_class=Response,
    responses=_binary("image/jpeg") | documented(*SESSION_PROBLEMS, "history-not-found"),
)
async def history_colour(live: SessionDep, request: Request, index: _Index) -> Response:
    """Return a JPEG of 160 pixels on its long side."""
    live.check_open()
    return data_answer(request, await live.history.picture(index), "image/jpeg")


@router.get(
    "/v1/sessions/{session_id}/history/{index}/probes/{name}",
    summary="Light at a recorded frame",
    response_class=Response,
    responses=_binary("image/vnd.radiance") | documented(*SESSION_PROBLEMS, "history-not-found"),
)
async def history_panorama(live: SessionDep, request: Request, index: _Index, name: ProbeName) -> Response:
    """Return the panorama of a named probe after a recorded frame: Radiance HDR, 64 x 32 pixels."""
    live.check_open()
    return data_answer(request, await live.history.picture(index, name), "image/vnd.radiance")
