"""Route of what people keep with a session, `/v1/sessions/{id}/scene`: its title, and the objects placed in it."""

from fastapi import APIRouter, Request, Response

from roomlight.wire.compositing import SessionScene
from roomlight_server.base.problems import BODY_PROBLEMS, SESSION_PROBLEMS, documented
from roomlight_server.routes.context import SessionDep
from roomlight_server.routes.etags import UNCHANGED, json_answer

router = APIRouter(prefix="/v1/sessions/{session_id}/scene", tags=["objects"])


@router.get(
    "",
    summary="Title and placed objects",
    response_model=SessionScene,
    responses=UNCHANGED | documented(*SESSION_PROBLEMS, "state-refused", "state-unavailable"),
)
async def get_scene(live: SessionDep, request: Request) -> Response:
    """Return the title of a session and the objects that its viewers have placed, for a composite of any frame."""
    live.check_open()
    return json_answer(request, live.scene)


@router.put(
    "",
    summary="Keep title and placed objects",
    responses=documented(*BODY_PROBLEMS, *SESSION_PROBLEMS, "state-refused", "state-unavailable"),
)
async def put_scene(live: SessionDep, scene: SessionScene) -> SessionScene:
    """Replace title and objects for all who look at the session; the last one wins. They are saved with the session."""
    live.keep_scene(scene)
    return scene
