"""Routes of objects, `/v1/objects`: upload, list, look at, delete."""

import hashlib
from typing import Annotated, Any, Final

from fastapi import APIRouter, Path, Query, Request, Response

from roomlight.errors import WireError
from roomlight.wire.compositing import OBJECT_ID_PATTERN, ObjectFormat, ObjectInfo, ObjectList
from roomlight_server.base.problems import BODY_PROBLEMS, ProblemError, documented
from roomlight_server.routes.bodies import OBJECTS_PATH, read_body
from roomlight_server.routes.context import ContextDep, OwnerDep, ReservationDep
from roomlight_server.transport.disconnects import until_gone

router = APIRouter(prefix=OBJECTS_PATH, tags=["objects"])
ObjectPath = Annotated[str, Path(pattern=OBJECT_ID_PATTERN, description="SHA-256 of the file, hexadecimal.")]
_BINARY: Final = {"schema": {"type": "string", "format": "binary"}}
_BODY: Final[dict[str, Any]] = {
    "requestBody": {
        "required": True,
        "description": "A GLB, glTF, OBJ or PLY file with everything inside it.",
        "content": dict.fromkeys(
            ("model/gltf-binary", "model/gltf+json", "model/obj", "application/octet-stream"), _BINARY
        ),
    },
    "parameters": [
        {
            "name": "X-Session-Id",
            "in": "header",
            "description": "The session that will use the object: a proxy before several servers routes by it.",
            "schema": {"type": "string"},
        }
    ],
}


@router.post(
    "",
    summary="Upload an object",
    openapi_extra=_BODY,
    response_model=ObjectInfo,
    responses={201: {"model": ObjectInfo, "description": "The object is stored"}}
    | documented(
        *(*BODY_PROBLEMS, "unauthorized", "bad-object", "invalid", "too-many-objects", "object-memory"),
        *("owner-busy", "server-busy"),
    ),
)
async def upload_object(
    context: ContextDep,
    owner: OwnerDep,
    reserved: ReservationDep,
    request: Request,
    response: Response,
    kind: Annotated[
        ObjectFormat | None, Query(description="The format; needed for OBJ without the media type model/obj.")
    ] = None,
) -> ObjectInfo:
    """Upload an object once and use it in any session. Its id is the SHA-256 of the file; a repetition is answered 200.

    An object that is not used for an hour is deleted.
    """
    body = await read_body(request, reserved, copies=2)  # as received, and joined
    digest = hashlib.sha256(body).hexdigest()
    try:
        return context.objects.info(owner, digest)
    except ProblemError:
        pass  # a new one
    if kind is None and request.headers.get("content-type", "").partition(";")[0].strip() == "model/obj":
        kind = "obj"
    try:
        decoded = await until_gone(request, context.workers.decode_object(body, kind))
    except WireError as error:
        context.metrics.objects_refused.inc()
        raise ProblemError.from_wire(error) from error
    response.status_code = 201
    return context.objects.add(owner, digest, decoded)


@router.get("", summary="List the objects", responses=documented("unauthorized"))
async def list_objects(context: ContextDep, owner: OwnerDep) -> ObjectList:
    """Return the objects of this token, with the memory that they take and its limit."""
    return context.objects.listed(owner)


@router.get("/{object_id}", summary="An object", responses=documented("unauthorized", "object-not-found", "invalid"))
async def get_object(context: ContextDep, owner: OwnerDep, object_id: ObjectPath) -> ObjectInfo:
    """Return what an object is: a client that knows the file's digest need not upload it again."""
    return context.objects.info(owner, object_id)


@router.delete(
    "/{object_id}",
    summary="Delete an object",
    status_code=204,
    responses=documented("unauthorized", "object-not-found", "invalid"),
)
async def delete_object(context: ContextDep, owner: OwnerDep, object_id: ObjectPath) -> None:
    """Delete an object; composites that are being made are finished with it."""
    context.objects.delete(owner, object_id)
