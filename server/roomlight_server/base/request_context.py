"""What the code below a request knows about it: its id, and the owner and session that its work is counted for.

Both are context variables, so tasks and threads that a request starts inherit them.
"""

import asyncio
import re
import uuid
from contextvars import ContextVar
from typing import Final, NamedTuple

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

REQUEST_ID_HEADER: Final = "X-Request-Id"
_USABLE_ID: Final = re.compile(r"[A-Za-z0-9._-]{1,64}")


class Flow(NamedTuple):
    """The owner of a token, and one of its sessions; both empty for the server's own work."""

    owner: str = ""
    session: str = ""


current_flow: ContextVar[Flow] = ContextVar("current_flow", default=Flow())  # noqa: B039 - a tuple is immutable
request_id: ContextVar[str] = ContextVar("request_id", default="")


class RequestIdMiddleware:
    """Gives each request and WebSocket an id: the client's `X-Request-Id`, or a new one. Answers return it."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle an ASGI connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        given = Headers(scope=scope).get(REQUEST_ID_HEADER, "")
        name = given if _USABLE_ID.fullmatch(given) else uuid.uuid4().hex
        request_id.set(name)
        task, client = asyncio.current_task(), scope.get("client")
        if task is not None:  # for `transport.watchdog`
            task.set_name(f"{client[0]}:{client[1]} {scope['path'][:100]}" if client else scope["path"][:100])

        async def send_with_id(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.accept", "websocket.http.response.start"):
                message.setdefault("headers", [])
                MutableHeaders(scope=message)[REQUEST_ID_HEADER] = name
            await send(message)

        await self._app(scope, receive, send_with_id)


def may_see(owner: str, whose: str) -> bool:
    """Return whether what belongs to `whose` is an owner's, or that of a phone that the owner has paired."""
    return whose == owner or whose.startswith(f"{owner}.")
