"""A session over its WebSocket: frames in, their results and the light of the tracked points out.

A lost connection is opened again after a delay: the server says which frames it has, and gets the others, one after
the other. Nothing is sent twice that the server has.
"""

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final, cast

from pydantic import ValidationError
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed

from roomlight.conventions import Position
from roomlight.errors import WireError
from roomlight.frame import Frame
from roomlight.wire.frame_encoding import CameraFrame, FrameEncoding
from roomlight.wire.messages import (
    FrameEvent,
    FrameResult,
    LightAnswer,
    LightCall,
    LightingUpdate,
    ProbesEvent,
    ProblemEvent,
    SessionState,
    Subscribe,
    Track,
    Untrack,
    WireModel,
)
from roomlight_client import _waiting
from roomlight_client.calls import (
    DEFAULT_FORMS,
    Forms,
    PositionOrName,
    as_forms,
    light_request,
)
from roomlight_client.errors import BadReplyError, RefusedError, RemoteError, UnreachableError, refusal
from roomlight_client.light import Light
from roomlight_client.memory import KeptFrame
from roomlight_client.recovery import Resumed, is_server_lost, is_session_gone
from roomlight_client.stream_link import (
    StreamHandlers,
    StreamLink,
    StreamStatus,
    decode_message,
    is_temporary,
    open_socket,
)

_log = logging.getLogger("roomlight.client")
_MAX_SENDS: Final = 3
"""A frame that ends so many connections is the reason for it."""
_CHECKS: Final = 10
"""How often within its time limit a call is checked for progress."""
_MAX_CHECKS: Final = 40
"""Messages that are not its answer keep a call alive for so many checks after its bytes have left."""
_TOO_BIG: Final = 1009
"""Close code of RFC 6455: a message is too big."""


class AsyncStream:
    """The WebSocket of a session, made by `AsyncSession.stream`. An `async with` statement closes it.

    It connects again by itself: `on_status` reports when, and `status` that it gave up (`closed`).
    """

    def __init__(self, link: StreamLink, handlers: StreamHandlers) -> None:
        self._link, self._handlers = link, handlers
        self._memory = link.recovery.memory
        self._status = StreamStatus("connecting")
        self._pending: dict[str, asyncio.Future[Any]] = {}
        self._light_calls: dict[str, LightCall] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._outbox: deque[WireModel] = deque()
        self._wake = asyncio.Event()
        self._pack_lock = asyncio.Lock()  # frames enter the buffer in the order of the calls
        self._socket: ClientConnection | None = None
        self._backlog_top = -1  # frames up to this index are sent one by one: a newer one would supersede a waiting one
        self._requests = self._failures = 0
        self._received = 0  # messages of all connections
        self._dropped: RemoteError | None = None
        self._runner: asyncio.Task[None] | None = None

    @classmethod
    async def open(cls, link: StreamLink, handlers: StreamHandlers) -> "AsyncStream":
        """Connect.

        Raises:
            GoneError: If the session is missing.
            RemoteError: If the server refuses or does not respond.
        """
        stream = cls(link, handlers)
        stream._show(stream._status)
        try:
            socket, resumed = await stream._connect(again=False)
        except RemoteError as error:
            stream._finish(error)
            raise
        stream._runner = asyncio.create_task(stream._run(socket, resumed))
        return stream

    async def __aenter__(self) -> "AsyncStream":
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    @property
    def status(self) -> StreamStatus:
        """The state of the connection."""
        return self._status

    async def push(
        self, frame: Frame | CameraFrame, index: int | None = None, *, colour: FrameEncoding = "exact"
    ) -> FrameResult:
        """Send a frame and return its result; without a connection it waits for the next one.

        Frames are sent in the order of the calls. The status is `queued` if the server has the frame but its result
        was lost with the connection. The arguments are those of `Session.push`.

        Raises:
            WireError: If the frame is invalid.
            RemoteError: If the server refuses the frame, or the stream ends.
        """
        index = self._link.calls.reserve(frame, index)
        async with self._pack_lock:
            call = await asyncio.to_thread(self._link.calls.push, frame, index, colour=colour, wait=True)
            answer = self._enqueue(index, call.content or b"")
        return cast("FrameResult", await answer)

    async def light_at(self, probe: PositionOrName, forms: Forms = DEFAULT_FORMS) -> Light:
        """Return the light at a point or a tracked probe; see `Session.light_at`."""
        return (await self.lights_at([probe], forms))[0]

    async def lights_at(self, probes: Sequence[PositionOrName], forms: Forms = DEFAULT_FORMS) -> list[Light]:
        """Return the light at up to 64 probes after one and the same frame; see `Session.lights_at`."""
        self._requests += 1
        name = f"r{self._requests}"
        request = light_request(probes, forms)
        message = LightCall(type="light", request=name, probes=request.probes, forms=request.forms)
        answer = self._expect(f"light {name}")
        self._light_calls[f"light {name}"] = message
        self._send(message)
        return cast("list[Light]", await answer)

    async def subscribe(self, forms: Forms) -> None:
        """Receive the light of the tracked points in `on_lighting`, now and after each frame; no forms: unsubscribe."""
        self._memory.forms = tuple(as_forms(forms))
        self._send(Subscribe(type="subscribe", forms=list(self._memory.forms)))

    async def track(self, name: str, position: Position) -> None:
        """Track a point under a name; an existing name moves to the position."""
        self._link.calls.track(name, position)  # checks both
        self._memory.track(name, position)
        self._memory.changed.add(name)
        self._send(Track(type="track", name=name, position=[float(value) for value in position]))

    async def untrack(self, name: str) -> None:
        """Stop tracking a point."""
        self._memory.untrack(name)
        self._memory.changed.add(name)
        self._send(Untrack(type="untrack", name=name))

    async def close(self) -> None:
        """Close the connection; calls that wait for an answer fail. The session continues to exist."""
        runner, self._runner = self._runner, None
        if runner is not None:
            runner.cancel()
            await asyncio.wait([runner])
        self._finish(UnreachableError("the stream was closed"))

    # --- calls ------------------------------------------------------------------------------------------------

    def _enqueue(self, index: int, message: bytes) -> "asyncio.Future[Any]":
        answer = self._expect(f"frame {index}")
        for dropped in self._memory.frames.add(index, message, state="waiting"):
            if dropped.state == "waiting":
                reason = f"frame {dropped.index} was dropped: the buffer of frames without a connection is full"
                self._fail(f"frame {dropped.index}", UnreachableError(reason))
        self._wake.set()
        return answer

    def _expect(self, name: str) -> "asyncio.Future[Any]":
        self._check_open()
        self._fail(name, UnreachableError(f"{name} was sent again"))
        answer = self._pending[name] = asyncio.get_running_loop().create_future()
        return answer

    def _check_open(self) -> None:
        if self._status.state == "closed":
            raise self._status.error or UnreachableError("the stream was closed")

    def _send(self, message: WireModel) -> None:
        """Send a message over an open connection; a later connection restores what it would have changed."""
        self._check_open()
        if self._socket is not None:
            self._outbox.append(message)
            self._wake.set()

    def _take(self, name: str) -> "asyncio.Future[Any] | None":
        timer = self._timers.pop(name, None)
        if timer is not None:
            timer.cancel()
        self._light_calls.pop(name, None)
        answer = self._pending.pop(name, None)
        return None if answer is None or answer.done() else answer

    def _fail(self, name: str, error: RemoteError) -> None:
        answer = self._take(name)
        if answer is not None:
            answer.set_exception(error)
            answer.exception()  # the caller may have been cancelled

    def _resolve(self, name: str, value: object) -> None:
        answer = self._take(name)
        if answer is not None:
            answer.set_result(value)

    def _start_timer(self, name: str, unsent: int | None = None, *, idle: int = 0, checks: int = 0) -> None:
        """Start the time limit of a call whose bytes are sent now; progress on a slow network starts it again.

        Args:
            name: The call.
            unsent: The fewest unsent bytes since it was sent, of all calls.
            idle: Checks since a byte left or a message arrived.
            checks: Checks since a byte left.
        """
        if name not in self._pending:
            return
        limit_s = self._link.options.timeouts.read_s
        received, least = self._received, self._unsent if unsent is None else unsent

        def check() -> None:
            if self._unsent < least:
                return self._start_timer(name, self._unsent)
            idle_now = 0 if self._received > received else idle + 1
            if idle_now < _CHECKS and checks + 1 < _MAX_CHECKS:
                return self._start_timer(name, least, idle=idle_now, checks=checks + 1)
            error = UnreachableError(f"{name}: no answer in {limit_s:g} s")
            if name in self._light_calls:
                self._fail(name, error)
            # without its network it says nothing either; the next one tells whether a frame arrived
            return self._drop(error)

        old = self._timers.pop(name, None)
        if old is not None:
            old.cancel()
        self._timers[name] = asyncio.get_running_loop().call_later(limit_s / _CHECKS, check)

    @property
    def _unsent(self) -> int:
        return 0 if self._socket is None else self._socket.transport.get_write_buffer_size()

    # --- connection -------------------------------------------------------------------------------------------

    async def _connect(self, *, again: bool) -> tuple[ClientConnection, Resumed]:
        resumed = await self._link.resume(again and self._memory.can_reopen)
        if resumed.state.status == "failed":
            raise BadReplyError("the session has failed on the server: delete it and open a new one")
        return await open_socket(self._link), resumed

    async def _run(self, socket: ClientConnection, resumed: Resumed) -> None:
        """Keep the connection until the stream ends."""
        try:
            while True:
                error = await self._converse(socket, resumed)
                if error is None:
                    return
                socket, resumed = await self._reconnect(error)
        except RemoteError as error:
            self._finish(error)
        except Exception as error:  # no call may wait for an answer that cannot come
            _log.exception("a stream failed")
            self._finish(BadReplyError(f"the stream failed: {error!r}"))

    async def _reconnect(self, error: RemoteError) -> tuple[ClientConnection, Resumed]:
        options = self._link.options
        while True:
            self._failures += 1
            if self._failures > options.reconnect.attempts:
                raise error
            # a policy's first attempt is the first connection
            bounded = min(self._failures, options.reconnect.attempts - 1)
            delay_s = options.reconnect.delay_s(bounded, jitter=_waiting.jitter())
            if delay_s is None:
                raise error
            self._show(StreamStatus("reconnecting", attempt=self._failures, delay_s=delay_s, error=error))
            await _waiting.wait_async(delay_s)
            try:
                return await self._connect(again=True)
            except RemoteError as failed:
                if not is_temporary(failed):
                    raise
                error = failed

    async def _converse(self, socket: ClientConnection, resumed: Resumed) -> RemoteError | None:
        self._socket, self._dropped = socket, None
        self._outbox.clear()
        last = resumed.state.frames.last_index
        incomplete = self._memory.frames.lacks(last)
        self._show(StreamStatus("open", reopened=resumed.reopened, incomplete=incomplete))
        self._restore(resumed.state)
        sender = asyncio.create_task(self._send_all(socket))
        try:
            async for data in socket:
                self._receive(data)
        except ConnectionClosed:
            pass
        finally:
            self._socket = None
            sender.cancel()
            await asyncio.wait([sender])
            for timer in self._timers.values():
                timer.cancel()
            self._timers.clear()
            await socket.close()
        code, reason = socket.close_code or 1006, socket.close_reason or ""
        error = self._dropped or UnreachableError(f"{self._link.options.url}: closed ({code}: {reason})")
        if code == _TOO_BIG:
            self._give_up_sent(error)
        if reason == "session-failed" or code == 4422:
            raise error
        return error

    def _restore(self, state: SessionState) -> None:
        """Bring the session up to date: frames above its last index, points, subscription, waiting requests."""
        last = -1 if state.frames.last_index is None else state.frames.last_index
        for frame in self._memory.frames:
            if frame.index > last:
                frame.state = "waiting"
                self._backlog_top = max(self._backlog_top, frame.index)
            elif frame.state == "sent":
                frame.state = "done"
                self._resolve(f"frame {frame.index}", _outcome_lost(frame.index))
        missing, unwanted = self._memory.probe_changes(state)
        self._outbox.extend(Untrack(type="untrack", name=name) for name in unwanted)
        self._outbox.extend(
            Track(type="track", name=name, position=[float(value) for value in position])
            for name, position in missing.items()
        )
        if self._memory.forms:
            self._outbox.append(Subscribe(type="subscribe", forms=list(self._memory.forms)))
        self._outbox.extend(self._light_calls.values())
        for name in list(self._pending):
            kind, _, number = name.partition(" ")
            if kind == "frame" and self._memory.frames.find(int(number)) is None:
                self._fail(name, UnreachableError(f"{name}: lost with its connection, and no longer in the buffer"))
        self._wake.set()

    async def _send_all(self, socket: ClientConnection) -> None:
        try:
            while True:
                await self._wake.wait()
                self._wake.clear()
                while self._outbox:
                    message = self._outbox.popleft()
                    if isinstance(message, LightCall):
                        self._start_timer(f"light {message.request}")
                    await socket.send(message.model_dump_json(exclude_none=True))
                while (frame := self._next_frame()) is not None:
                    await self._send_frame(socket, frame)
        except ConnectionClosed:
            pass  # the reader sees it as well

    def _next_frame(self) -> KeptFrame | None:
        underway = False
        for frame in self._memory.frames:
            if frame.index <= self._backlog_top and underway:
                return None
            if frame.state == "waiting":
                return frame
            underway |= frame.state == "sent"
            if underway and frame.index <= self._backlog_top:
                return None
        return None

    async def _send_frame(self, socket: ClientConnection, frame: KeptFrame) -> None:
        name = f"frame {frame.index}"
        if frame.sends >= _MAX_SENDS:
            self._memory.frames.remove(frame.index)
            self._fail(name, UnreachableError(f"{name}: the connection ended {frame.sends} times after it"))
            return
        frame.state = "sent"
        frame.sends += 1
        self._start_timer(name, self._unsent + len(frame.message))
        await socket.send(frame.message)

    def _give_up_sent(self, error: RemoteError) -> None:
        for frame in self._memory.frames:
            if frame.state == "sent":
                self._memory.frames.remove(frame.index)
                self._fail(f"frame {frame.index}", error)

    def _drop(self, error: RemoteError) -> None:
        """Leave a connection that is of no use any more."""
        socket, self._socket = self._socket, None
        if socket is not None:
            self._dropped = error
            socket.transport.abort()

    # --- messages ---------------------------------------------------------------------------------------------

    def _receive(self, data: str | bytes) -> None:
        if self._socket is None:
            return None  # the connection was given up
        self._received += 1
        try:
            message, lights = decode_message(data)
        except (ValidationError, WireError, BadReplyError, ValueError) as error:
            return self._call(self._handlers.on_problem, BadReplyError(f"malformed message from the server: {error}"))
        if not isinstance(message, ProblemEvent):
            self._failures = 0  # only now: a proxy may accept connections without a server behind it
        if isinstance(message, FrameEvent):
            result = FrameResult.model_validate(message.model_dump(exclude={"type"}))
            self._memory.frames.settle(result)
            self._resolve(f"frame {message.index}", result)
            self._wake.set()
        elif isinstance(message, LightAnswer):
            self._resolve(f"light {message.request}", lights)
        elif isinstance(message, LightingUpdate):
            self._call(self._handlers.on_lighting, lights)
        elif isinstance(message, ProbesEvent):
            self._memory.confirm(message.probes)
        else:
            self._refused(message)
        return None

    def _refused(self, message: ProblemEvent) -> None:
        error = refusal(message.problem.status, message.problem.model_dump_json().encode())
        index, frames = message.index, self._memory.frames
        frame = None if index is None else frames.find(index)
        stopping = is_server_lost(error)
        if stopping or is_session_gone(error):
            if stopping and frame is not None:
                frame.sends -= 1  # not the reason for the end of the connection
            return self._drop(error)  # what was sent is sent again, to the session's next server, or as it is restored
        conflict = isinstance(error, RefusedError) and error.kind == "frame-conflict"
        if index is not None and frame is not None and frame.sends > 1 and conflict:
            frame.state = "done"  # it had arrived over the previous connection
            self._resolve(f"frame {index}", _outcome_lost(index))
        else:
            if index is not None:
                frames.remove(index)
            self._fail(f"light {message.request}" if index is None else f"frame {index}", error)
            self._call(self._handlers.on_problem, error)
        self._wake.set()
        return None

    def _show(self, status: StreamStatus) -> None:
        self._status = status
        self._call(self._handlers.on_status, status)

    def _call(self, handler: Callable[[Any], object] | None, value: object) -> None:
        if handler is not None:
            try:
                handler(value)
            except Exception:  # an error of the app must not end the connection
                _log.exception("a handler of a stream failed")

    def _finish(self, error: RemoteError) -> None:
        if self._status.state == "closed":
            return
        self._show(StreamStatus("closed", error=error))
        for name in list(self._pending):
            self._fail(name, error)


def _outcome_lost(index: int) -> FrameResult:
    """Return the result of a frame that arrived, but whose own result was lost with the connection."""
    return FrameResult(index=index, status="queued", replay=True)
