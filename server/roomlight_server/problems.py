"""Refusals as RFC 9457 problems: `application/problem+json` with the field, the value and the rule."""

import re
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any, Final

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from roomlight.errors import WireError
from roomlight.wire.frame_message import rule_of
from roomlight.wire.messages import Problem

MEDIA_TYPE: Final = "application/problem+json"
TYPE_PREFIX: Final = "urn:roomlight:problem:"

TITLES: Final[Mapping[str, tuple[int, str]]] = {
    "unauthorized": (401, "A valid bearer token is needed"),
    "forbidden-origin": (403, "This web origin is not allowed"),
    "not-found": (404, "There is no such thing here"),
    "session-not-found": (404, "There is no such session"),
    "probe-not-found": (404, "There is no such probe"),
    "method-not-allowed": (405, "This address does not take the method"),
    "body-timeout": (408, "The body did not arrive in time"),
    "frame-conflict": (409, "The index was used already"),
    "session-conflict": (409, "The session exists with other options"),
    "session-failed": (409, "The session failed and must be opened anew"),
    "model-not-here": (409, "This server has no weights of the model"),
    "too-many-probes": (409, "The session tracks as many probes as it may"),
    "session-closed": (410, "The session was deleted meanwhile"),
    "too-large": (413, "The message is larger than this server takes"),
    "bad-request": (400, "The request cannot be read"),
    "bad-frame": (422, "The frame is not valid"),
    "invalid": (422, "The request is not valid"),
    "session-full": (429, "The session has its hands full"),
    "engine-failed": (500, "The engine failed on this frame"),
    "internal": (500, "An error of the server"),
    "server-full": (503, "The server holds as many sessions as it may"),
    "stopping": (503, "The server is stopping"),
}
"""Status and title of every type of problem."""
BODY_REFUSALS: Final = ("bad-request", "body-timeout", "too-large")
"""What may be wrong with any request that has a body."""


class ProblemError(Exception):
    """A refusal on its way out. `retry_after_s` becomes the header of that name."""

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
        """Of a kind in `TITLES`."""
        super().__init__(detail)
        self.kind, self.retry_after_s = kind, retry_after_s
        status, title = TITLES[kind]
        shown = None if value is None else str(value)[:120]
        self.problem = Problem(
            type=TYPE_PREFIX + kind, title=title, status=status, detail=detail, field=field, value=shown, rule=rule
        )

    @classmethod
    def from_wire(cls, error: WireError) -> "ProblemError":
        """The refusal of a message that does not parse or decode."""
        kind = error.kind if error.kind in TITLES else "invalid"
        return cls(kind, str(error), field=error.field or None, value=error.value, rule=error.rule)


def problem_response(error: ProblemError) -> JSONResponse:
    """The response for a refusal."""
    headers: dict[str, str] = {}
    if error.retry_after_s is not None:
        headers["Retry-After"] = str(error.retry_after_s)
    if error.problem.status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    content = error.problem.model_dump(exclude_none=True)
    return JSONResponse(content, error.problem.status, headers=headers, media_type=MEDIA_TYPE)


async def on_problem(_: Request, error: Exception) -> JSONResponse:
    """FastAPI's handler for `ProblemError`."""
    assert isinstance(error, ProblemError)
    return problem_response(error)


async def on_invalid(_: Request, error: Exception) -> JSONResponse:
    """FastAPI's handler for parameters and bodies that do not fit their model."""
    assert isinstance(error, RequestValidationError)
    first: dict[str, Any] = error.errors()[0]
    where = [str(part) for part in first["loc"]]
    field = ".".join(where[1:]) if len(where) > 1 else where[0]
    rule = rule_of(str(first["msg"]))
    given = "nothing" if first["type"] == "missing" else ascii(first.get("input"))
    return problem_response(ProblemError("invalid", f"{field}: {rule}", field=field, value=given, rule=rule))


async def on_http_exception(request: Request, error: Exception) -> JSONResponse:
    """FastAPI's handler for what the framework itself refuses."""
    assert isinstance(error, HTTPException)
    kind = {404: "not-found", 405: "method-not-allowed", 408: "body-timeout", 413: "too-large"}.get(
        error.status_code, "bad-request"
    )
    detail = str(error.detail) or HTTPStatus(error.status_code).phrase
    response = problem_response(ProblemError(kind, detail))
    response.headers.update(error.headers or {})
    if error.status_code == 405:  # Starlette names the methods of the first route alone
        response.headers["Allow"] = ", ".join(sorted(_methods_at(request)))
    return response


def _methods_at(request: Request) -> set[str]:
    """What the address does take."""
    methods: set[str] = set()
    for path, operations in request.app.openapi()["paths"].items():
        pattern = "[^/]+".join(re.escape(part) for part in re.split(r"\{[^}]+\}", path))
        if re.fullmatch(pattern, request.url.path):
            methods |= {method.upper() for method in operations}
    return methods


async def on_error(_: Request, error: Exception) -> JSONResponse:
    """The last handler: what happened goes to the log, not to the client."""
    del error
    return problem_response(ProblemError("internal", "the server's log says more"))


def documented(*kinds: str) -> dict[int | str, dict[str, Any]]:
    """OpenAPI's responses for these kinds of problem."""
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
