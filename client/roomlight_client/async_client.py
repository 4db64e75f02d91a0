"""The asyncio client: `AsyncClient` and `AsyncSession`, with the names of `client` and `await`."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import httpx

from roomlight.conventions import Position
from roomlight.depth import UnknownDepth
from roomlight.frame import Frame
from roomlight.wire.compositing import (
    CompositeFormat,
    CompositeObject,
    CompositeQuality,
    ObjectFormat,
    ObjectInfo,
    ObjectList,
)
from roomlight.wire.frame_encoding import CameraFrame, FrameEncoding
from roomlight.wire.messages import FrameResult, LightForm, LightFormat, ModelName, SessionRequest, SessionState
from roomlight_client import _waiting, calls
from roomlight_client.calls import DEFAULT_FORMS, Attempt, Call, Forms, PositionOrName, Result, SessionCalls, T
from roomlight_client.compositing import CompositeFile, composite_request, object_file
from roomlight_client.errors import RemoteError
from roomlight_client.light import Light, LightFile
from roomlight_client.memory import BufferLimits
from roomlight_client.recovery import ClientOptions, Pause, Recovery, RecoveryEvent, Restore, Resumed, Send, Steps
from roomlight_client.retry import NO_RETRY, RECONNECT, Retry, Timeouts
from roomlight_client.stream import AsyncStream
from roomlight_client.stream_link import StreamHandlers, StreamLink, StreamStatus


class AsyncClient:
    """`Client` for asyncio, with the same arguments and errors, for one event loop. Calls of tasks run concurrently."""

    def __init__(
        self,
        url: str,
        *,
        token: str | None = None,
        timeouts: Timeouts | None = None,
        retry: Retry | None = None,
        reconnect: Retry | None = None,
        buffer: BufferLimits | None = None,
        on_recovery: Callable[[RecoveryEvent], object] | None = None,
        transport: httpx.AsyncBaseTransport | None = None,
    ) -> None:
        arguments = calls.client_arguments(url, token=token)
        self._http = httpx.AsyncClient(transport=transport, **arguments)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._restoring: dict[Recovery, asyncio.Task[None]] = {}
        self._has_own_transport = transport is None
        self.options = ClientOptions(
            url=url,
            token=token,
            timeouts=timeouts or Timeouts(),
            retry=retry or Retry(),
            reconnect=reconnect or retry or RECONNECT,
            buffer=buffer or BufferLimits(),
            notify=on_recovery,
        )

    async def __aenter__(self) -> "AsyncClient":
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections; see `Client.close`."""
        await self._http.aclose()

    async def ready(self) -> bool:
        """Return whether the server accepts sessions; see `Client.ready`."""
        return await self.run(calls.ready())

    async def open(
        self,
        session_id: str | None = None,
        *,
        model: ModelName = "auto",
        height: int = 120,
        reference_exposure: float | None = None,
        use_limited_tracking: bool = False,
        min_confidence: int = 1,
        unknown_depth: UnknownDepth = "rim",
    ) -> "AsyncSession":
        """Open a session, or continue an existing one with the same id and options; see `Client.open`."""
        session_calls = SessionCalls(session_id)
        request = calls.session_request(
            model=model,
            height=height,
            reference_exposure=reference_exposure,
            use_limited_tracking=use_limited_tracking,
            min_confidence=min_confidence,
            unknown_depth=unknown_depth,
        )
        state = await self.run(session_calls.open(request))
        return AsyncSession(self, session_calls, state, request)

    async def join(self, session_id: str) -> "AsyncSession":
        """Continue an existing session, whatever its options; see `Client.join`."""
        session_calls = SessionCalls(session_id)
        state = await self.run(session_calls.state())
        return AsyncSession(self, session_calls, state, None)

    async def upload(
        self, source: str | Path | bytes, kind: ObjectFormat | None = None, *, session_id: str | None = None
    ) -> ObjectInfo:
        """Store an object on the server for composites; see `Client.upload`."""
        return await self.run(calls.upload(*object_file(source, kind), session_id))

    async def objects(self, *, session_id: str | None = None) -> ObjectList:
        """Return the objects of this token on the server; see `Client.objects`."""
        return await self.run(calls.list_objects(session_id))

    async def delete_object(self, object_id: str, *, session_id: str | None = None) -> None:
        """Delete an object on the server; see `Client.delete_object`."""
        await self.run(calls.delete_object(object_id, session_id))

    async def run(self, call: Call[T], *, retry: Retry | None = None) -> T:
        """Send a call and return its result; see `Client.run`."""
        attempt = Attempt(call, retry or self.options.retry, self.options.url)
        while True:
            self._check_loop()
            calls.check_open(closed=self._http.is_closed)
            try:
                response = await self._http.request(**calls.request_arguments(call, self.options.timeouts))
            except httpx.HTTPError as error:
                outcome = attempt.failed(error)
            else:
                outcome = attempt.answered(response)
            if isinstance(outcome, Result):
                return outcome.value
            await _waiting.wait_async(outcome)

    async def follow(self, steps: Steps[T]) -> T:
        """Run the steps of a call that survives a restart of the server.

        Raises:
            RemoteError: If they fail in the end.
        """
        try:
            step = next(steps)
            while True:
                try:
                    value = await self._take(step)
                except RemoteError as error:
                    step = steps.throw(error)
                else:
                    step = steps.send(value)
        except StopIteration as end:
            return end.value

    def _check_loop(self) -> None:
        """Raise RemoteError in another event loop than before: the connections belong to that one."""
        self._loop = self._loop or asyncio.get_running_loop()
        if self._has_own_transport and self._loop is not asyncio.get_running_loop():
            raise RemoteError(
                "this AsyncClient was used in another event loop: make one in each asyncio.run, or do everything in one"
            )

    async def _take(self, step: Send | Pause | Restore) -> Any:
        if isinstance(step, Restore):
            return await self._restore(step.recovery)
        if isinstance(step, Pause):
            return await _waiting.wait_async(step.seconds)
        return await self.run(step.call, retry=step.retry)

    async def _restore(self, recovery: Recovery) -> None:
        """Bring a session up to date in a task of its own: a call that is cancelled leaves it to the others."""
        if recovery not in self._restoring:
            task = self._restoring[recovery] = asyncio.create_task(self.follow(recovery.restore()))
            task.add_done_callback(lambda _: self._restoring.pop(recovery))
        await asyncio.shield(self._restoring[recovery])


class AsyncSession:
    """`Session` for asyncio, with the same attributes and errors."""

    def __init__(
        self, client: AsyncClient, session_calls: SessionCalls, state: SessionState, request: SessionRequest | None
    ) -> None:
        self._client, self._calls = client, session_calls
        self._recovery = Recovery(session_calls, request, client.options)
        self.id, self.model = state.id, state.model
        session_calls.resume(state)

    async def __aenter__(self) -> "AsyncSession":
        return self

    async def __aexit__(self, _: object, error: BaseException | None, __: object, /) -> None:
        if error is None:
            await self.close()
            return
        self._recovery.memory.deleted = True
        with suppress(RemoteError):  # the error of the block is the one to show
            await self._client.run(self._calls.close(), retry=NO_RETRY)

    @property
    def next_index(self) -> int:
        """The index of the next `CameraFrame`: one above all indices sent."""
        return self._calls.next_index

    async def push(
        self,
        frame: Frame | CameraFrame,
        index: int | None = None,
        *,
        colour: FrameEncoding = "exact",
        wait: bool = True,
        retry: bool | Literal["without answer"] = True,
    ) -> FrameResult:
        """Send a frame and return its result; see `Session.push`.

        Frames of several tasks may overtake each other; the server then refuses the older one.
        """
        index = self._calls.reserve(frame, index)
        call = await asyncio.to_thread(self._calls.push, frame, index, colour=colour, wait=wait)
        repeat = retry if isinstance(retry, str) else "always" if retry else "never"
        return await self._client.follow(self._recovery.push(call, index, repeat=repeat))

    async def light_at(self, probe: PositionOrName, forms: Forms = DEFAULT_FORMS) -> Light:
        """Return the light at a point or a tracked probe; see `Session.light_at`."""
        return (await self.lights_at([probe], forms))[0]

    async def lights_at(self, probes: Sequence[PositionOrName], forms: Forms = DEFAULT_FORMS) -> list[Light]:
        """Return the light at up to 64 probes in one call; see `Session.lights_at`."""
        return await self._client.follow(self._recovery.call(self._calls.lights(probes, forms)))

    async def file(
        self, probe: PositionOrName, form: LightFormat | LightForm = "exr", *, if_none_match: str | None = None
    ) -> LightFile | None:
        """Return one form of the light as a file; see `Session.file`."""
        call = self._calls.file(probe, calls.as_form(form), if_none_match=if_none_match)
        return await self._client.follow(self._recovery.call(call))

    async def composite(
        self,
        objects: Sequence[CompositeObject | dict[str, Any]],
        *,
        quality: CompositeQuality = "preview",
        picture_format: CompositeFormat = "png",
    ) -> CompositeFile:
        """Return the last processed frame with objects in it; see `Session.composite`."""
        request = composite_request(objects, quality=quality, picture_format=picture_format)
        return await self._client.follow(self._recovery.call(self._calls.composite(request)))

    async def track(self, name: str, position: Position) -> None:
        """Track a point; see `Session.track`."""
        await self._client.follow(self._recovery.call(self._calls.track(name, position)))
        self._recovery.memory.track(name, position)

    async def untrack(self, name: str) -> None:
        """Stop tracking a point; see `Session.untrack`."""
        await self._client.follow(self._recovery.call(self._calls.untrack(name)))
        self._recovery.memory.untrack(name)

    async def stream(
        self,
        *,
        on_lighting: Callable[[list[Light]], object] | None = None,
        on_status: Callable[[StreamStatus], object] | None = None,
        on_problem: Callable[[RemoteError], object] | None = None,
    ) -> AsyncStream:
        """Open the session's WebSocket; see `Session.stream`. The handlers are called on the event loop."""
        handlers = StreamHandlers(on_lighting, on_status, on_problem)
        client = self._client

        async def resume(reopen: bool) -> Resumed:
            return await client.follow(self._recovery.resume(reopen=reopen))

        link = StreamLink(client.options, self._calls, self._recovery, resume)
        return await AsyncStream.open(link, handlers)

    async def state(self) -> SessionState:
        """Return the session's state; see `Session.state`."""
        return await self._client.follow(self._recovery.call(self._calls.state()))

    async def recover(self) -> None:
        """Wait until the server answers, and bring the session up to date; see `Session.recover`."""
        await self._client.follow(self._recovery.recover())

    async def close(self) -> None:
        """Delete the session; see `Session.close`."""
        self._recovery.memory.deleted = True  # its streams end with it
        await self._client.run(self._calls.close())
