"""Scripted servers for tests of the client: prepared responses without a socket."""

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any
from unittest import mock

import httpx
from either_client import client_of

from roomlight_client import _waiting

STATE: dict[str, Any] = {
    "id": "room", "status": "open", "model": "classical",
    "options": {}, "probes": {}, "coverage": {}, "keyframes": 0, "volume": None, "idle_expiry_s": 600.0,
    "frames": {
        "accepted": 0, "processed": 0, "superseded": 0, "skipped": 0, "queued": 0, "gaps": 0, "replayed": 0,
        "refused": 0, "last_index": None,
    },
    "memory": {"bytes": 0, "bound_bytes": 1},
}  # fmt: skip
"""The JSON of a new session's state."""
OPENED = httpx.Response(201, json=STATE)


def problem(status: int, kind: str, *, retry_after: str | None = None, **members: str) -> httpx.Response:
    """Return a refusal with problem details; `members` are its field, value and rule."""
    body = {"type": f"urn:roomlight:problem:{kind}", "title": "No", "status": status, "detail": "because"} | members
    headers = {} if retry_after is None else {"Retry-After": retry_after}
    return httpx.Response(status, json=body, headers={"Content-Type": "application/problem+json"} | headers)


class Script:
    """A server of prepared answers: the requests are in `requests`, the client's waits in `waits_s`.

    An answer is an httpx.Response or an exception; the last one repeats.
    """

    def __init__(self, *answers: httpx.Response | Exception) -> None:
        self._answers = list(answers)
        self.requests: list[httpx.Request] = []
        self.waits_s: list[float] = []

    def _answer(self, request: httpx.Request) -> httpx.Response:
        self.requests.append(request)
        answer = self._answers.pop(0) if len(self._answers) > 1 else self._answers[0]
        if isinstance(answer, Exception):
            raise answer
        return httpx.Response(answer.status_code, headers=answer.headers, content=answer.content)

    @asynccontextmanager
    async def client(self, kind: str, **options: Any) -> AsyncGenerator[Any, None]:
        """Connect a client of either kind to this script; its waits are noted and take no time."""

        async def wait_async(seconds: float) -> None:
            self.waits_s.append(seconds)

        transport = httpx.MockTransport(self._answer)
        with mock.patch.multiple(_waiting, wait=self.waits_s.append, wait_async=wait_async):
            async with client_of(kind, "http://room.test", transport=transport, **options) as client:
                yield client
