"""Answers to requests that do not end before the server stops."""

import asyncio
import logging
from collections.abc import Callable

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from roomlight_server.base.problems import ProblemError, problem_response

_log = logging.getLogger("roomlight.server")


class StopMiddleware:
    """Answers requests that uvicorn cancels when the server stops with 503, instead of a 500 and a traceback."""

    def __init__(self, app: ASGIApp, *, stopping: Callable[[], bool]) -> None:
        """Wrap an application; `stopping` returns whether the server stops."""
        self._app, self._stopping = app, stopping

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle an ASGI connection."""
        started = False

        async def send_noting_start(message: Message) -> None:
            nonlocal started
            started = True
            await send(message)

        try:
            await self._app(scope, receive, send_noting_start)
        except asyncio.CancelledError:
            if not self._stopping() or scope["type"] not in ("http", "websocket"):
                raise
            _log.info("request ended by the stop", extra={"path": scope["path"][:200]})
            if scope["type"] == "http" and not started:
                rule = "the server is stopping; send the request again in a few seconds"
                answer = problem_response(ProblemError("stopping", rule, retry_after_s=5))
                await answer(scope, receive, send)
