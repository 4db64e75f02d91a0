"""What Ray Serve's HTTP proxies add to a request and to an answer; `middlewares` is imported by them.

The proxy chooses the replica by the header `X-Session-Id`. Browsers cannot set it for a WebSocket, so it is made from
the path. What has no session, such as pairing, goes to one replica. An error of Ray itself (the replica was killed, or
the proxy does not know of the application yet and answers 404) becomes a 503 that clients know.
"""

from typing import Any, Final

from starlette.middleware import Middleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from roomlight_server.base.problems import MEDIA_TYPE, ProblemError, problem_response
from roomlight_server.base.request_context import REQUEST_ID_HEADER
from roomlight_server.state.lease import MOVED
from roomlight_server.transport.auth import SESSION_PATH

SESSION_HEADER: Final = b"x-session-id"
_RAY_HEADERS: Final = (b"x-request-timeout-seconds", b"x-request-disconnect-disabled")
"""Headers by which any client could change how Ray handles its request."""


def middlewares() -> list[Middleware]:
    """Return the middleware of the proxies, for `RAY_SERVE_HTTP_PROXY_CALLBACK_IMPORT_PATH`."""
    return [Middleware(SessionRouting)]


class SessionRouting:
    """Sets `X-Session-Id` to the session of the path, and converts errors of Ray to problems."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle an ASGI connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        answer = _Answer(send)
        await self._app({**scope, "headers": routed_headers(scope["path"], scope["headers"])}, receive, answer.send)
        if scope["type"] == "http":
            await answer.finish()


def routed_headers(path: str, headers: list[tuple[bytes, bytes]]) -> list[tuple[bytes, bytes]]:
    """Return headers with the session id of the path, if it has one, in place of the client's; or else a constant."""
    kept = [(name, value) for name, value in headers if name.replace(b"_", b"-") not in _RAY_HEADERS]
    session = SESSION_PATH.match(path)
    own = [(name, value) for name, value in kept if name.replace(b"_", b"-") != SESSION_HEADER]
    if session is not None:
        return [*own, (SESSION_HEADER, session[1].encode())]
    return [*own, (SESSION_HEADER, b"none")] if len(own) == len(kept) and path.startswith("/v1/") else kept


class _Answer:
    """Passes an answer on; an error of Ray itself, which is not of `MEDIA_TYPE`, is replaced by a problem."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self._started = self._replaced = False

    async def finish(self) -> None:
        """Answer if Ray has not: it says nothing when a replica dies, and uvicorn would answer 500."""
        if not self._started:
            await self._replace([])

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self._started = True
            headers = _once(message.get("headers", []), REQUEST_ID_HEADER.lower().encode())
            if (message["status"] >= 500 or message["status"] == 404) and not _has_type(headers, MEDIA_TYPE):
                await self._replace(headers)
                return
            message = {**message, "headers": headers}
        if not self._replaced:
            await self._send(message)

    async def _replace(self, headers: list[tuple[bytes, bytes]]) -> None:
        self._started = self._replaced = True
        detail = "the server of the session is away; ask for its state, send lost frames again and go on"
        answer = problem_response(ProblemError(MOVED, detail, retry_after_s=1))
        ids = [(name, value) for name, value in headers if name.lower() == REQUEST_ID_HEADER.lower().encode()]
        start = {"type": "http.response.start", "status": answer.status_code, "headers": [*ids, *answer.raw_headers]}
        await self._send(start)
        await self._send({"type": "http.response.body", "body": answer.body})


def _once(headers: Any, name: bytes) -> list[tuple[bytes, bytes]]:
    """Return headers with the first of those of one name: the replica and the proxy both add the request's id."""
    kept: list[tuple[bytes, bytes]] = []
    for key, value in headers:
        if key.lower() != name or all(kept_key.lower() != name for kept_key, _ in kept):
            kept.append((bytes(key), bytes(value)))
    return kept


def _has_type(headers: list[tuple[bytes, bytes]], media_type: str) -> bool:
    return any(name.lower() == b"content-type" and value.startswith(media_type.encode()) for name, value in headers)
