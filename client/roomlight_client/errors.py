"""How a call to a server can end badly, as exceptions a caller can tell apart.

RemoteError                  a RoomLightError
├── UnreachableError         no answer came, after all attempts (names the address)
├── BadReplyError            an answer came that is no RoomLight server's
└── RefusedError             the server said no, and why: `problem` (RFC 9457: kind, field, value, rule)
    ├── UnauthorizedError    401, 403: the token, or the web origin
    ├── GoneError            404, 410: no such session or probe; it may have expired
    ├── ConflictError        409: an index or an id that is used up, a session that failed
    ├── InvalidError         400, 413, 415, 422: what was sent is malformed or too large
    ├── BusyError            408, 429, 502, 503, 504: try again after `retry_after_s`
    └── ServerFailedError    500 and above: the server's own fault

What cannot even be sent (a position that is none, an image of another size than its intrinsics) is a `WireError`.
"""

import json
from collections.abc import Mapping
from typing import Final

from pydantic import ValidationError

from roomlight.errors import RoomLightError
from roomlight.wire.messages import Problem


class RemoteError(RoomLightError):
    """A call to a server did not come to an answer that can be used."""


class UnreachableError(RemoteError):
    """The server did not answer. What was sent may or may not have arrived."""


class BadReplyError(RemoteError):
    """The answer is not what a RoomLight server gives: another service, or another version."""


class RefusedError(RemoteError):
    """The server refused; nothing was done.

    problem:        what it said. `kind` is the last word of its type, e.g. `frame-conflict`.
    field, value, rule: where it was wrong, what stood there, what would be right; "" where the problem says nothing.
    retry_after_s:  when the server wants to be asked again; None where it does not say.
    """

    def __init__(self, problem: Problem, *, retry_after_s: float | None = None) -> None:
        """The message is the problem's detail, with field and rule."""
        self.problem, self.retry_after_s = problem, retry_after_s
        self.status = problem.status
        self.kind = problem.type.rpartition(":")[2]
        self.field, self.value, self.rule = problem.field or "", problem.value or "", problem.rule or ""
        said = [problem.detail or problem.title]
        said += [f"{self.field}: {self.rule}"] if self.rule and self.rule not in said[0] else []
        said += [f"got {self.value}"] if self.value and self.value not in said[0] else []
        super().__init__(f"the server refused ({problem.status} {self.kind}): {'; '.join(said)}")


class UnauthorizedError(RefusedError):
    """The token is missing, is wrong, or this is not its session."""


class GoneError(RefusedError):
    """There is no such session or probe, or no more: sessions expire when they are idle."""


class ConflictError(RefusedError):
    """What was asked for does not fit what the session is by now."""


class InvalidError(RefusedError):
    """What was sent is malformed or larger than the server takes; `field`, `value` and `rule` say what."""


class BusyError(RefusedError):
    """The session or the server has its hands full, and all attempts were spent."""


class ServerFailedError(RefusedError):
    """An error of the server. A session may have failed with it."""


RETRIED: Final = frozenset({408, 429, 502, 503, 504})
"""Statuses that another attempt may change; with all of them nothing was done."""

_BY_STATUS: Final[Mapping[int, type[RefusedError]]] = {
    **{401: UnauthorizedError, 403: UnauthorizedError, 404: GoneError, 410: GoneError, 409: ConflictError},
    **dict.fromkeys((400, 413, 415, 422), InvalidError),
    **dict.fromkeys(RETRIED, BusyError),
}


def refusal(status: int, body: bytes, *, retry_after_s: float | None = None) -> RemoteError:
    """The error for an answer of this status. A body without a problem (a proxy's page) is told by its first words."""
    problem = _problem(status, body)
    if problem is None:
        if not 400 <= status < 600:
            return BadReplyError(f"the server answered {status}, which a RoomLight server does not")
        words = " ".join(body[:200].decode(errors="replace").split())
        problem = Problem(type="about:blank", title=f"status {status}", status=status, detail=words or "no explanation")
    fallback = ServerFailedError if status >= 500 else InvalidError
    return _BY_STATUS.get(status, fallback)(problem, retry_after_s=retry_after_s)


def _problem(status: int, body: bytes) -> Problem | None:
    """RFC 9457 lets a problem have more members than ours, and leave some out."""
    try:
        said = json.loads(body)
        known = {name: said[name] for name in Problem.model_fields if said.get(name) is not None}
        return Problem.model_validate({"type": "about:blank", "title": "", "detail": ""} | known | {"status": status})
    except (ValueError, AttributeError, ValidationError):
        return None
