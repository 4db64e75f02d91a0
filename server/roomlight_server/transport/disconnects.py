"""Cancelling the work of a request whose client has disconnected."""

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

from starlette.requests import ClientDisconnect, Request

_R = TypeVar("_R")


async def until_gone(request: Request, work: Coroutine[Any, Any, _R]) -> _R:
    """Return the result of the work; cancel it if the client disconnects. The request's body must have been read.

    Raises:
        ClientDisconnect: The client disconnected; the work has ended.
    """
    task, gone = asyncio.create_task(work), asyncio.create_task(_gone(request))
    try:
        await asyncio.wait((task, gone), return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            return task.result()
        request.app.state.context.metrics.abandoned.inc()
        raise ClientDisconnect
    finally:
        task.cancel()
        gone.cancel()
        await asyncio.wait((task, gone))


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
