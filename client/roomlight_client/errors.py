"""Errors of the client.

RemoteError                  a RoomLightError
├── UnreachableError         no response after all attempts (the message names the address)
├── BadReplyError            the response does not come from a RoomLight server
└── RefusedError             the server refused the request: `problem` (RFC 9457: kind, field, value, rule)
    ├── UnauthorizedError    401, 403: the token, or the web origin
    ├── GoneError            404, 410: no such session or probe; it may have expired
    ├── ConflictError        409: a used index or id, other session options, a failed session
    ├── InvalidError         400, 413, 415, 422: the request is malformed or too large
    ├── BusyError            408, 429, 502, 503, 504: try again after `retry_after_s`
    └── ServerFailedError    500 and above: an error of the server

A request that the client can see to be invalid (a position that is not finite, an image whose size differs from its
intrinsics) raises `roomlight.errors.WireError`, and an invalid address, token or id `roomlight.errors.OptionError`;
neither is sent.
"""

import json
from collections.abc import Mapping
from typing import Final

from pydantic import ValidationError

from roomlight.errors import RoomLightError
from roomlight.wire.messages import Problem


class RemoteError(RoomLightError):
    """A call to a server failed."""


class UnreachableError(RemoteError):
    """The server did not respond. It may or may not have received the request."""


class BadReplyError(RemoteError):
    """The response is malformed: the address belongs to another service, or to another version of the server."""


class RefusedError(RemoteError):
    """The server refused the request and changed nothing.

    Attributes:
        problem: The server's problem details.
        status: HTTP status.
        kind: The last part of the problem's type, e.g. `frame-conflict`.
        field: The field that is wrong; "" where the problem names none, as for `value` and `rule`.
        value: What the field contained.
        rule: What the server accepts there.
        retry_after_s: The server's Retry-After in seconds; None without one.
    """

    def __init__(self, problem: Problem, *, retry_after_s: float | None = None) -> None:
        self.problem, self.retry_after_s = problem, retry_after_s
        self.status = problem.status
        self.kind = problem.type.rpartition(":")[2]
        self.field, self.value, self.rule = problem.field or "", problem.value or "", problem.rule or ""
        parts = [problem.detail or problem.title]
        parts += [f"{self.field}: {self.rule}"] if self.rule and self.rule not in parts[0] else []
        parts += [f"got {self.value}"] if self.value and self.value not in parts[0] else []
        super().__init__(f"the server refused ({problem.status} {self.kind}): {'; '.join(parts)}")


class UnauthorizedError(RefusedError):
    """The token is missing or wrong, or the server does not allow the web origin."""


class GoneError(RefusedError):
    """The session or probe does not exist. The server deletes sessions that are idle for too long."""


class ConflictError(RefusedError):
    """The request contradicts the session's state."""


class InvalidError(RefusedError):
    """The request is malformed or too large; `field`, `value` and `rule` say where and why."""


class BusyError(RefusedError):
    """The session's queue or the server is full, and no attempt is left."""


class ServerFailedError(RefusedError):
    """The server failed. The session may have failed with it."""


RETRIED: Final = frozenset({408, 429, 502, 503, 504})
"""Statuses after which another attempt may succeed. The server changed nothing, but perhaps with 504."""

TIMED_OUT: Final = frozenset({408, 504})
"""Those of a body that arrived too slowly, and of a proxy that no longer waits for a server that works."""

_BY_STATUS: Final[Mapping[int, type[RefusedError]]] = {
    **{401: UnauthorizedError, 403: UnauthorizedError, 404: GoneError, 410: GoneError, 409: ConflictError},
    **dict.fromkeys((400, 413, 415, 422), InvalidError),
    **dict.fromkeys(RETRIED, BusyError),
}


def refusal(status: int, body: bytes, *, retry_after_s: float | None = None) -> RemoteError:
    """Return the error for an unsuccessful response.

    A body without problem details (a proxy's page) is quoted in the error by its first 200 bytes.
    """
    problem = _parse_problem(status, body)
    if problem is None:
        if not 400 <= status < 600:
            return BadReplyError(f"the server answered {status}, which a RoomLight server does not")
        excerpt = " ".join(body[:200].decode(errors="replace").split())
        detail = excerpt or "no explanation"
        problem = Problem(type="about:blank", title=f"status {status}", status=status, detail=detail)
    fallback = ServerFailedError if status >= 500 else InvalidError
    return _BY_STATUS.get(status, fallback)(problem, retry_after_s=retry_after_s)


def _parse_problem(status: int, body: bytes) -> Problem | None:
    """Parse problem details. RFC 9457 allows extra members and makes every member optional."""
    try:
        members = json.loads(body)
        known = {name: members[name] for name in Problem.model_fields if members.get(name) is not None}
        return Problem.model_validate({"type": "about:blank", "title": "", "detail": ""} | known | {"status": status})
    except (ValueError, AttributeError, ValidationError):
        return None
