"""The client for asyncio: `AsyncClient` and `AsyncSession`, the same names as `client` with `await`."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from types import TracebackType

import httpx

from roomlight.conventions import Position
from roomlight.depth import UnknownDepth
from roomlight.frame import Frame
from roomlight.wire.messages import FrameResult, LightForm, LightFormat, ModelName, SessionState
from roomlight_client import calls
from roomlight_client.calls import FORMS, Attempt, Call, Result, SessionCalls, T, Where
from roomlight_client.errors import RemoteError
from roomlight_client.frames import CameraFrame, Colour
from roomlight_client.light import Light, LightFile
from roomlight_client.retry import NEVER, Retry, Timeouts


class AsyncClient:
    """`Client` with `await`; calls of several tasks go side by side."""

    def __init__(
        self,
        url: str,
        *,
        token: str | None = None,
        timeouts: Timeouts | None = None,
        retry: Retry | None = None,
        transport: httpx.AsyncBaseTransport | None = None,
        sleep: Callable[[float], Awaitable[object]] = asyncio.sleep,
    ) -> None:
        """As `Client`."""
        arguments = calls.client_arguments(url, token=token, timeouts=timeouts or Timeouts())
        self._http = httpx.AsyncClient(transport=transport, **arguments)
        self._retry, self._sleep, self._url = retry or Retry(), sleep, url

    async def __aenter__(self) -> "AsyncClient":
        """Itself."""
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the connections; sessions stay."""
        await self.close()

    async def close(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def ready(self) -> bool:
        """As `Client.ready`."""
        return await self.run(calls.ready())

    async def open(
        self,
        session_id: str | None = None,
        *,
        mode: ModelName = "auto",
        height: int = 120,
        reference_exposure: float | None = None,
        use_limited_tracking: bool = False,
        min_confidence: int = 1,
        unknown_depth: UnknownDepth = "rim",
    ) -> "AsyncSession":
        """As `Client.open`."""
        asked = SessionCalls(session_id)
        request = calls.session_request(
            mode=mode,
            height=height,
            reference_exposure=reference_exposure,
            use_limited_tracking=use_limited_tracking,
            min_confidence=min_confidence,
            unknown_depth=unknown_depth,
        )
        return AsyncSession(self, asked, await self.run(asked.open(request)))

    async def join(self, session_id: str) -> "AsyncSession":
        """As `Client.join`."""
        asked = SessionCalls(session_id)
        return AsyncSession(self, asked, await self.run(asked.state()))

    async def run(self, call: Call[T], *, retry: Retry | None = None) -> T:
        """As `Client.run`."""
        attempt = Attempt(call, retry or self._retry, self._url)
        while True:
            try:
                response = await self._http.request(**calls.request_arguments(call))
            except httpx.HTTPError as error:
                outcome = attempt.failed(error)
            else:
                outcome = attempt.answered(response)
            if isinstance(outcome, Result):
                return outcome.value
            await self._sleep(outcome)


class AsyncSession:
    """`Session` with `await`."""

    def __init__(self, client: AsyncClient, asked: SessionCalls, state: SessionState) -> None:
        """Made by `AsyncClient.open` and `AsyncClient.join`."""
        self._client, self._calls = client, asked
        self.id, self.model = state.id, state.model
        asked.begin(state)

    async def __aenter__(self) -> "AsyncSession":
        """Itself."""
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """As `Session.__exit__`."""
        if error is None:
            await self.close()
            return
        with suppress(RemoteError):
            await self._client.run(self._calls.close(), retry=NEVER)

    @property
    def next_index(self) -> int:
        """The index that the next `CameraFrame` gets: one above all that were sent."""
        return self._calls.next_index

    async def push(
        self,
        frame: Frame | CameraFrame,
        index: int | None = None,
        *,
        colour: Colour = "exact",
        wait: bool = True,
        retry: bool = True,
    ) -> FrameResult:
        """As `Session.push`. Pushes of several tasks may overtake each other; the server then refuses the older."""
        index = self._calls.reserve(frame, index)
        call = await asyncio.to_thread(self._calls.push, frame, index, colour=colour, wait=wait)
        return await self._client.run(call, retry=None if retry else NEVER)

    async def light_at(self, place: Where, forms: Sequence[LightFormat | LightForm] = FORMS) -> Light:
        """As `Session.light_at`."""
        return (await self.lights_at([place], forms))[0]

    async def lights_at(self, places: Sequence[Where], forms: Sequence[LightFormat | LightForm] = FORMS) -> list[Light]:
        """As `Session.lights_at`."""
        return await self._client.run(self._calls.lights(places, forms))

    async def file(
        self, place: Where, form: LightFormat | LightForm = "exr", *, unless: str | None = None
    ) -> LightFile | None:
        """As `Session.file`."""
        return await self._client.run(self._calls.file(place, calls.as_form(form), unless=unless))

    async def track(self, name: str, position: Position) -> None:
        """As `Session.track`."""
        await self._client.run(self._calls.track(name, position))

    async def untrack(self, name: str) -> None:
        """As `Session.untrack`."""
        await self._client.run(self._calls.untrack(name))

    async def state(self) -> SessionState:
        """As `Session.state`."""
        return await self._client.run(self._calls.state())

    async def close(self) -> None:
        """As `Session.close`."""
        await self._client.run(self._calls.close())
