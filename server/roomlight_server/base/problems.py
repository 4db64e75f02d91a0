"""Error responses as problem details (RFC 9457): `application/problem+json` with field, value and rule."""

import asyncio
import logging
import re
from collections.abc import Awaitable, Mapping
from http import HTTPStatus
from typing import Any, Final, TypeVar

from fastapi import Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection

from roomlight.errors import ProbeError, WireError
from roomlight.wire.frame_message import rule_text
from roomlight.wire.messages import Problem
from roomlight_server.base.request_context import REQUEST_ID_HEADER, request_id

_log = logging.getLogger("roomlight.server")
_R = TypeVar("_R")
MEDIA_TYPE: Final = "application/problem+json"
INTERNAL_DETAIL: Final = "unexpected error; the log of the server has the traceback"
CLIENT_CLOSED: Final = 499
"""Status in metrics and logs of a request whose client disconnected, as nginx counts it."""
TYPE_PREFIX: Final = "urn:roomlight:problem:"

TITLES: Final[Mapping[str, tuple[int, str]]] = {
    "unauthorized": (401, "A valid bearer token is required"),
    "forbidden-origin": (403, "Web origin is not allowed"),
    "operator-only": (403, "Needs a token of the server, not of a phone"),
    "not-found": (404, "Path not found"),
    "session-not-found": (404, "Session not found"),
    "probe-not-found": (404, "Probe not found"),
    "object-not-found": (404, "Object not found"),
    "history-not-found": (404, "Frame is not in the history"),
    "recording-not-found": (404, "Recording not found"),
    "film-not-found": (404, "Recording has no film"),
    "phone-not-found": (404, "Phone not found"),
    "page-not-built": (404, "Page is not installed"),
    "method-not-allowed": (405, "Method not allowed"),
    "body-timeout": (408, "Request body timed out"),
    "header-timeout": (408, "Request headers timed out"),
    "frame-conflict": (409, "Frame index was already used"),
    "session-conflict": (409, "Session conflicts with the request"),
    "state-refused": (409, "Saved session cannot be used"),
    "session-failed": (409, "Session has failed"),
    "model-not-here": (409, "Model is not available"),
    "too-many-probes": (409, "Probe limit reached"),
    "too-many-objects": (409, "Object limit of the token reached"),
    "upload-offset": (409, "Piece does not continue the file"),
    "recording-not-ready": (409, "Recording is not complete"),
    "recording-playing": (409, "Recording is being played"),
    "too-many-recordings": (409, "Recording limit of the token reached"),
    "no-frame": (409, "Session has no frame yet"),
    "session-closed": (410, "Session was closed"),
    "scene-changed": (412, "Scene was changed meanwhile"),
    "too-large": (413, "Message is too large"),
    "unsupported-media-type": (415, "Content type or encoding is not supported"),
    "bad-request": (400, "Request cannot be parsed"),
    "bad-frame": (422, "Frame is invalid"),
    "bad-object": (422, "Object is invalid"),
    "bad-recording": (422, "Recording cannot be read"),
    "bad-place": (422, "Object cannot be placed"),
    "invalid": (422, "Request is invalid"),
    "upgrade-required": (426, "Path is that of a WebSocket"),
    "session-full": (429, "Session queue is full"),
    "owner-quota": (429, "Limit of the token reached"),
    "owner-busy": (429, "Memory limit of the token's requests and answers reached"),
    "composite-running": (429, "Session is making a composite"),
    "film-running": (429, "Server is making a film"),
    "headers-too-large": (431, "Request headers are too large"),
    "engine-failed": (500, "Engine failed"),
    "internal": (500, "Internal server error"),
    "server-full": (503, "Session limit reached"),
    "server-busy": (503, "Memory limit of requests and answers reached"),
    "object-memory": (503, "Object limit of the server reached"),
    "recording-memory": (503, "Recording limit of the server reached"),
    "too-many-connections": (503, "Connection limit reached"),
    "session-moved": (503, "Another server owns the session"),
    "state-unavailable": (503, "Saved session cannot be read or removed now"),
    "composite-late": (503, "Composite was not made in time"),
    "stopping": (503, "Server is stopping"),
}
"""Status and title of each kind of problem; the kind is the end of the problem's `type`."""
BODY_PROBLEMS: Final = ("bad-request", "body-timeout", "too-large", "unsupported-media-type")
"""Kinds of problem of any request with a body."""
RESTORE_PROBLEMS: Final = (
    *("unauthorized", "session-conflict", "state-refused", "model-not-here", "invalid", "owner-quota"),
    *("server-full", "session-moved", "state-unavailable", "stopping"),
)
"""Kinds of problem of any request that opens or restores a session."""
SESSION_PROBLEMS: Final = (*RESTORE_PROBLEMS, "session-not-found", "session-failed", "session-closed")
"""Kinds of problem of any request to an open session."""
_KINDS: Final[Mapping[int, str]] = {
    404: "not-found",
    405: "method-not-allowed",
    408: "body-timeout",
    413: "too-large",
    415: "unsupported-media-type",
}
"""Kinds of problem of what the framework and the middleware raise, by status; others are a bad request."""
_TOKEN_LIMITS: Final = ("owner-quota", "owner-busy")


class ProblemError(Exception):
    """An error that is answered with a problem. `retry_after_s` becomes the header `Retry-After`."""

    def __init__(
        self,
        kind: str,
        detail: str,
        *,
        field: str | None = None,
        value: object = None,
        rule: str | None = None,
        retry_after_s: int | None = None,
    ) -> None:
        """Create an error of a kind in `TITLES`; `value` is shortened to 120 characters."""
        super().__init__(detail)
        self.kind, self.retry_after_s = kind, retry_after_s
        status, title = TITLES[kind]
        text = None if value is None else str(value)[:120]
        self.problem = Problem(
            type=TYPE_PREFIX + kind, title=title, status=status, detail=detail, field=field, value=text, rule=rule
        )

    @classmethod
    def from_wire(cls, error: WireError) -> "ProblemError":
        """Convert the error of a message that does not parse or decode."""
        kind = error.kind if error.kind in TITLES else "invalid"
        return cls(kind, str(error), field=error.field or None, value=error.value, rule=error.rule)


def problem_response(error: ProblemError) -> JSONResponse:
    """Return the response for an error."""
    headers: dict[str, str] = {}
    if error.retry_after_s is not None:
        headers["Retry-After"] = str(error.retry_after_s)
    if error.problem.status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    if error.problem.status == 426:
        headers |= {"Connection": "Upgrade", "Upgrade": "websocket"}
    content = error.problem.model_dump(exclude_none=True)
    return JSONResponse(content, error.problem.status, headers=headers, media_type=MEDIA_TYPE)


def _answered(request: Request, error: ProblemError) -> JSONResponse:
    request.app.state.context.metrics.problems.labels(error.kind).inc()
    return problem_response(error)


async def on_problem(request: Request, error: Exception) -> JSONResponse:
    """Handle `ProblemError` for FastAPI."""
    assert isinstance(error, ProblemError)
    await hold_back(error, request.app.state.context.settings.owner_refusal_delay_s)
    return _answered(request, error)


async def hold_back(error: ProblemError, delay_s: float) -> None:
    """Wait before the answer, if the request is beyond a limit of its token.

    Forty connections that repeat such a request at once keep the event loop busy: a frame of another token took several
    times as long, because each of its steps waited for theirs.
    """
    if error.kind in _TOKEN_LIMITS:
        await asyncio.sleep(delay_s)


async def on_invalid(request: Request, error: Exception) -> JSONResponse:
    """Handle parameters and bodies that fail validation for FastAPI."""
    assert isinstance(error, RequestValidationError)
    first: dict[str, Any] = error.errors()[0]
    location = [str(part) for part in first["loc"]]
    if location == ["body"] and isinstance(first.get("input"), bytes):  # FastAPI parses JSON by its type alone
        content_type, rule = request.headers.get("content-type"), "send JSON as application/json"
        detail = f"Content-Type: {rule}"
        return _answered(
            request,
            ProblemError("unsupported-media-type", detail, field="Content-Type", value=content_type, rule=rule),
        )
    field = ".".join(location[1:]) if len(location) > 1 else location[0]
    rule = rule_text(str(first["msg"]))
    value = "nothing" if first["type"] == "missing" else ascii(first.get("input"))
    if first["type"] == "json_invalid":  # the location is a position in the text
        at = first["loc"][1]
        field, rule = "body", f"must be JSON ({rule_text(first['ctx']['error'])} at character {at})"
        value = ascii(error.body[at : at + 40])
    return _answered(request, ProblemError("invalid", f"{field}: {rule}", field=field, value=value, rule=rule))


async def on_http_exception(request: Request, error: Exception) -> JSONResponse:
    """Handle errors raised by the framework and the middleware."""
    assert isinstance(error, HTTPException)
    kind = _KINDS.get(error.status_code, "bad-request")
    detail = str(error.detail) or HTTPStatus(error.status_code).phrase
    if error.status_code in (404, 405):
        detail = f"{request.method} {request.url.path[:200]}: {detail}"
    response = _answered(request, ProblemError(kind, detail))
    response.headers.update(error.headers or {})
    if error.status_code == 405:  # Starlette lists the methods of the first matching route only
        response.headers["Allow"] = ", ".join(sorted(_methods_at(request)))
    return response


def _methods_at(request: Request) -> set[str]:
    methods: set[str] = set()
    for path, operations in request.app.openapi()["paths"].items():
        whole = re.escape(path).replace(r"\{path\}", ".+")  # the path of a file has slashes
        pattern = re.sub(r"\\\{[^}]+\\\}", "[^/]+", whole)
        if re.fullmatch(pattern, request.url.path):
            methods |= {method.upper() for method in operations}
    return methods | {"HEAD"} if "GET" in methods else methods


async def refuse_unknown_parameters(connection: HTTPConnection) -> None:
    """Refuse a request below `/v1` with a query parameter that its route does not have.

    Raises:
        ProblemError: There is one (422).
    """
    scope, given = connection.scope, connection.query_params
    if not given or scope["type"] != "http" or not scope["path"].startswith("/v1/"):
        return
    operation = connection.app.openapi()["paths"][scope["route"].path_format][scope["method"].lower()]
    known = [entry["name"] for entry in operation.get("parameters", ()) if entry["in"] == "query"]
    for name in given:
        if name not in known:
            rule = f"must be one of {', '.join(known)}" if known else "this path takes no query parameters"
            detail = f"unknown query parameter: {rule}"
            raise ProblemError("invalid", detail, field=name[:100], value=given[name], rule=rule)


async def on_disconnect(request: Request, error: Exception) -> Response:
    """Handle a client that disconnects while it sends its body; metrics count the answer that it does not get."""
    del error
    _log.info("client disconnected during its request", extra={"path": request.url.path[:200]})
    return Response(status_code=CLIENT_CLOSED)


async def on_error(request: Request, error: Exception) -> JSONResponse:
    """Handle any other exception: its details go to the log, not to the client."""
    del error
    response = _answered(request, ProblemError("internal", INTERNAL_DETAIL))
    response.headers[REQUEST_ID_HEADER] = request_id.get()  # Starlette answers outside of all middleware
    return response


def documented(*kinds: str) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI responses for these kinds of problem."""
    responses: dict[int | str, dict[str, Any]] = {}
    for kind in kinds:
        status, title = TITLES[kind]
        described = responses.get(status, {}).get("description")
        text = f"`{kind}`: {title}"
        responses[status] = {
            "description": f"{described}; {text}" if described else text,
            "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
        }
    return responses


async def convert_probe_errors(work: Awaitable[_R]) -> _R:
    """Await an engine call for a probe; an unusable position is a client error (422), any other failure a 500."""
    try:
        return await work
    except ProbeError as error:
        raise ProblemError("invalid", str(error), field="position", rule=str(error)) from error
    except Exception as error:  # the session is unchanged: it adds a probe only when the probe is complete
        _log.exception("probe failed")
        raise ProblemError("engine-failed", f"the light could not be computed: {type(error).__name__}") from error
