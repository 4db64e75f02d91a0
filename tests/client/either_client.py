"""One test for both clients: `Client` behind `await`, so that it reads as `AsyncClient` does."""

import asyncio
import inspect

import httpx

from roomlight_client import AsyncClient, Client, Session


class _Awaited:
    """An object whose methods are awaited; they run in a thread, off the loop."""

    def __init__(self, target):
        self._target = target

    def __getattr__(self, name):
        found = getattr(self._target, name)
        if not inspect.ismethod(found):
            return found

        async def call(*args, **kwargs):
            result = await asyncio.to_thread(found, *args, **kwargs)
            return _Awaited(result) if isinstance(result, Session) else result

        return call

    async def __aenter__(self):
        await asyncio.to_thread(self._target.__enter__)
        return self

    async def __aexit__(self, *error):
        await asyncio.to_thread(self._target.__exit__, *error)


def client_of(kind, url, **options):
    """`Client` (kind "sync") or `AsyncClient` (kind "async"), to be used with `await` in either case."""
    return _Awaited(Client(url, **options)) if kind == "sync" else AsyncClient(url, **options)


class Script:
    """A server of prepared answers, without a socket: what came in is in `requests`, the waits are in `waits_s`.

    An answer is an httpx.Response or an exception; the last one is given again and again.
    """

    def __init__(self, *answers):
        self._answers = list(answers)
        self.requests, self.waits_s = [], []

    def _answer(self, request):
        self.requests.append(request)
        answer = self._answers.pop(0) if len(self._answers) > 1 else self._answers[0]
        if isinstance(answer, Exception):
            raise answer
        return httpx.Response(answer.status_code, headers=answer.headers, content=answer.content)

    def client(self, kind, **options):
        """A client of either kind that talks to this."""

        async def wait(seconds):
            self.waits_s.append(seconds)

        sleep = self.waits_s.append if kind == "sync" else wait
        return client_of(kind, "http://room.test", transport=httpx.MockTransport(self._answer), sleep=sleep, **options)
