"""Route of what people keep with a session, `/v1/sessions/{id}/scene`: its title, and the objects placed in it."""

from typing import Annotated

from fastapi import APIRouter, Header, Request, Response

from roomlight.wire.compositing import SessionScene
from roomlight_server.base.problems import BODY_PROBLEMS, SESSION_PROBLEMS, ProblemError, documented
from roomlight_server.routes.context import SessionDep
from roomlight_server.routes.etags import UNCHANGED, etag_of, json_answer, matches

router = APIRouter(prefix="/v1/sessions/{session_id}/scene", tags=["objects"])


@router.get(
    "",
    summary="Title and placed objects",
    response_model=SessionScene,
    responses=UNCHANGED | documented(*SESSION_PROBLEMS),
)
async def get_scene(live: SessionDep, request: Request) -> Response:
    """Return the title of a session and the objects that its viewers have placed, for a composite of any frame."""
    live.check_open()
    return json_answer(request, live.scene)


@router.put(
    "",
    summary="Keep title and placed objects",
    responses={200: {"headers": {"ETag": {"description": "Of the new scene", "schema": {"type": "string"}}}}}
    | documented(*BODY_PROBLEMS, *SESSION_PROBLEMS, "scene-changed"),
)
async def put_scene(
    live: SessionDep,
    scene: SessionScene,
    response: Response,
    if_match: Annotated[str | None, Header(description="ETag of the scene that is replaced; none: any.")] = None,
) -> SessionScene:
    """Replace title and objects for all who look at the session; they are saved with it.

    With `If-Match` only the scene that was read is replaced: another viewer's change is not lost (412).
    """
    if if_match is not None and not matches(if_match, _etag(live.scene)):
        rule = "must name the scene's ETag; read the scene again and repeat the change on it"
        detail = f"the scene was changed since it was read: If-Match {rule}"
        raise ProblemError("scene-changed", detail, field="If-Match", value=if_match, rule=rule)
    live.keep_scene(scene)
    response.headers["ETag"] = _etag(scene)
    return scene


def _etag(scene: SessionScene) -> str:
    return etag_of(scene.model_dump_json().encode())
