"""One test for both clients: `Client` behind `await`, so that a test reads the same for `AsyncClient`."""

import asyncio
import inspect
from typing import Any

from roomlight_client import AsyncClient, Client, Session


class _Awaited:
    """Wraps an object so that its methods are awaited; they run in a thread, outside the event loop."""

    def __init__(self, target: Client | Session) -> None:
        self._target = target

    def __getattr__(self, name: str) -> Any:
        attribute = getattr(self._target, name)
        if not inspect.ismethod(attribute):
            return attribute

        async def call(*args, **kwargs):
            result = await asyncio.to_thread(attribute, *args, **kwargs)
            return _Awaited(result) if isinstance(result, Session) else result

        return call

    async def __aenter__(self) -> Any:
        await asyncio.to_thread(self._target.__enter__)
        return self

    async def __aexit__(self, *error: Any) -> None:
        await asyncio.to_thread(self._target.__exit__, *error)


def client_of(kind: str, url: str, **options: Any) -> Any:
    """Return a `Client` (kind "sync") or an `AsyncClient` (kind "async"); both are used with `await`."""
    return _Awaited(Client(url, **options)) if kind == "sync" else AsyncClient(url, **options)
