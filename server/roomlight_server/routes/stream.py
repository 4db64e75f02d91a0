"""`/v1/sessions/{id}/stream`: frames in, their outcomes and light out, on one WebSocket (format: docs/wire.md).

Back pressure: for a client that reads slowly, outcomes of frames wait, then its frames (the server stops reading), and
only the newest lighting update is kept. A message that is rejected or fails is answered with a problem and the
connection stays open. Only a message that is neither binary nor text closes the connection.
"""

import asyncio
import json
import logging
from collections.abc import AsyncGenerator, Callable, Generator, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from functools import partial
from typing import Final, NoReturn

from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from pydantic import TypeAdapter, ValidationError
from starlette.types import Message

from roomlight.wire.frame_message import stated_index, to_wire_error
from roomlight.wire.light_message import pack_light
from roomlight.wire.messages import (
    ClientMessage,
    FrameEvent,
    LightAnswer,
    LightCall,
    LightForm,
    LightingUpdate,
    ProbeQuery,
    ProbesEvent,
    ProblemEvent,
    Subscribe,
    Track,
    is_id,
)
from roomlight_server.base.problems import INTERNAL_DETAIL, ProblemError, hold_back, problem_response
from roomlight_server.routes.bodies import MANY_NAMES, MAX_JSON_BYTES, MAX_JSON_NAMES
from roomlight_server.routes.context import Context
from roomlight_server.routes.light import answer_bytes, check_size, encode_lights, memory_of
from roomlight_server.sessions.live_session import LiveSession
from roomlight_server.state.lease import MOVED
from roomlight_server.transport.auth import SUBPROTOCOL

_log = logging.getLogger("roomlight.server")
router = APIRouter()
_MESSAGES: Final[TypeAdapter[ClientMessage]] = TypeAdapter(ClientMessage)
_Answer = FrameEvent | LightAnswer | LightingUpdate | ProbesEvent | ProblemEvent
_SESSION_ENDED: Final = 4410
"""Close codes are 4000 + the HTTP status of the problem."""


class _ConnectionEndedError(Exception):
    """The connection is closed: raised in one of its tasks, it cancels the others."""


@router.websocket("/v1/sessions/{session_id}/stream")
async def stream(websocket: WebSocket, session_id: str) -> None:
    """Serve one connection until it or its session ends."""
    context: Context = websocket.app.state.context
    owner: str = websocket.scope["state"]["owner"]
    try:
        context.registry.check_not_stopping()
    except ProblemError as error:
        await websocket.send_denial_response(problem_response(error))  # the client waits for the next server
        return
    offered = websocket.scope.get("subprotocols", [])
    await websocket.accept(subprotocol=SUBPROTOCOL if SUBPROTOCOL in offered else None)
    try:
        if not is_id(session_id):
            rule = "must be 1 to 64 of A-Z a-z 0-9 _ -"
            raise ProblemError("invalid", f"id: {rule}", field="id", value=session_id, rule=rule)
        owner = context.registry.owner_of(owner, session_id)
        await context.registry.recall(owner, session_id)
        with context.registry.use(owner, session_id) as live:
            pass  # an open connection does not keep the session alive; its messages do
    except ProblemError as error:
        await websocket.send_text(ProblemEvent(problem=error.problem).model_dump_json(exclude_none=True))
        await websocket.close(4000 + error.problem.status, error.kind)
        return
    with context.metrics.streams.track_inprogress():
        await _Connection(websocket, context, owner, live).run()


@router.websocket("/{path:path}")
async def refuse_other_path(websocket: WebSocket) -> None:
    """Answer a WebSocket of another path over HTTP, before it is accepted."""
    detail = f"no WebSocket at {websocket.url.path[:100]}; streams are at /v1/sessions/{{id}}/stream"
    await websocket.send_denial_response(problem_response(ProblemError("not-found", detail)))


class _Connection:
    """One connection: a task that reads messages, a task that sends updates, and a task per frame in flight."""

    def __init__(self, websocket: WebSocket, context: Context, owner: str, live: LiveSession) -> None:
        self._websocket, self._context, self._owner, self._live = websocket, context, owner, live
        self._subscribed_forms: list[LightForm] = []
        self._update_due = asyncio.Event()
        self._send_lock = asyncio.Lock()  # one message at a time; never held together with a lock of the session
        self._tasks = asyncio.TaskGroup()
        self._frame_tasks: set[asyncio.Task[None]] = set()
        self._received: asyncio.Queue[Message] = asyncio.Queue(maxsize=1)

    async def run(self) -> None:
        """Run until the client disconnects or the session ends; then all tasks have ended."""
        remove_listener = self._live.listen(self._update_due.set)
        try:
            task = asyncio.current_task()
            name = task.get_name() if task else None
            async with self._tasks:
                for work in (self._receive_messages(), self._handle_messages(), self._send_updates()):
                    self._tasks.create_task(work, name=name)
        except* _ConnectionEndedError:
            pass
        finally:
            remove_listener()

    async def _receive_messages(self) -> None:
        """Read one message ahead, so that a disconnect cancels the message that is being handled."""
        while True:
            message = await self._websocket.receive()
            if message["type"] == "websocket.disconnect":
                raise _ConnectionEndedError
            await self._received.put(message)

    async def _handle_messages(self) -> None:
        while True:
            message = await self._received.get()
            data, text = message.get("bytes"), message.get("text")
            async with self._answering_errors(frame=data):
                self._context.registry.expire()
                self._live.check_open()  # says whether it was deleted, saved or moved, also if another has its id now
                with self._context.registry.use(self._owner, self._live.name):
                    if data is not None:
                        await self._start_frame(data)
                    elif text is not None:
                        await self._handle_text(text)

    @asynccontextmanager
    async def _answering_errors(
        self, *, frame: bytes | None = None, request: str | None = None
    ) -> AsyncGenerator[None]:
        """Answer an error inside the context with a problem, so that the connection goes on.

        The problem names the index of the frame or the `request` of the message. An unexpected error is logged.
        """
        try:
            yield
        except _ConnectionEndedError:
            raise
        except ProblemError as error:
            if error.kind == MOVED:  # a new connection reaches the owner
                await self._close(4000 + error.problem.status, error.kind)
            await hold_back(error, self._context.settings.owner_refusal_delay_s)
            problem = error
        except Exception:
            index = None if frame is None else stated_index(frame)
            _log.exception("unexpected error on a stream", extra={"session": self._live.name, "frame": index})
            problem = ProblemError("internal", INTERNAL_DETAIL)
        else:
            return
        self._context.metrics.problems.labels(problem.kind).inc()
        index = None if frame is None else stated_index(frame)
        await self._send(ProblemEvent(problem=problem.problem, index=index, request=request))

    async def _start_frame(self, data: bytes) -> None:
        """Start the task of a frame. Waiting here for a free slot stops the reading of further messages."""
        self._count("received", "frame")
        self._context.registry.check_not_stopping()
        limit = self._context.settings.max_body_bytes
        if len(data) > limit:
            raise ProblemError("too-large", f"the frame has {len(data)} bytes", rule=f"at most {limit} bytes")
        await self._live.slots.acquire()
        task = self._tasks.create_task(self._process_frame(data))
        self._frame_tasks.add(task)
        task.add_done_callback(self._end_frame)  # called even if the task is cancelled before it starts

    def _end_frame(self, task: asyncio.Task[None]) -> None:
        self._frame_tasks.discard(task)
        self._live.slots.release()

    async def _process_frame(self, data: bytes) -> None:
        async with self._answering_errors(frame=data):
            with self._context.budget.reservation() as reserved:
                reserved.add(len(data))
                entry = await self._live.accept(data, None)
                result = await asyncio.shield(entry.outcome)
                await self._send(FrameEvent(**result.model_dump()))

    async def _handle_text(self, text: str) -> None:
        if len(text) > MAX_JSON_BYTES:
            rule = f"at most {MAX_JSON_BYTES} characters"
            raise ProblemError("too-large", f"the message has {len(text)} characters", rule=rule)
        if text.count(":") > MAX_JSON_NAMES:
            raise ProblemError("too-large", MANY_NAMES)
        try:
            message = _MESSAGES.validate_json(text)
        except ValidationError as error:
            async with self._answering_errors(request=_stated_request(text)):
                raise ProblemError.from_wire(to_wire_error(error, kind="invalid")) from error
            return
        self._count("received", message.type)
        if self._live.lease is not None:
            await self._live.lease.check()
        if isinstance(message, LightCall):
            async with self._answering_errors(request=message.request):
                check_size(self._answer_bytes(len(message.probes), message.forms))
                await self._send_light(message.probes, message.forms, partial(LightAnswer, request=message.request))
        elif isinstance(message, Subscribe):
            self._subscribe(message.forms)
        elif isinstance(message, Track):
            await self._live.lighting.track(message.name, message.position)
            await self._send_probes()
        else:
            await self._live.lighting.untrack(message.name)
            await self._send_probes()

    def _subscribe(self, forms: list[LightForm]) -> None:
        if forms:
            check_size(self._answer_bytes(self._context.settings.max_probes, forms))
        self._subscribed_forms = forms
        self._update_due.set()

    def _answer_bytes(self, probes: int, forms: Sequence[LightForm]) -> int:
        return answer_bytes(probes, forms, self._live.request.height)

    async def _send_probes(self) -> None:
        probes = {name: list(position) for name, position in self._live.lighting.positions.items()}
        await self._send(ProbesEvent(probes=probes))

    async def _send_light(
        self, probes: Sequence[ProbeQuery], forms: list[LightForm], answer: Callable[..., LightAnswer | LightingUpdate]
    ) -> None:
        with self._context.budget.reservation() as reserved:
            reserved.add(memory_of(self._live, len(probes), self._answer_bytes(len(probes), forms)))
            lights = await self._live.lighting.at(probes)
            results, parts = await encode_lights(self._context.workers, lights, forms)
            await self._send(answer(frame=lights[0].frame, results=results), parts)

    async def _send_updates(self) -> None:
        """Send the newest light of the named probes after each frame; frames during an update count as one.

        After the last probe was removed, by whichever client, send that there are none.
        """
        had_probes = False
        while True:
            await self._update_due.wait()
            self._update_due.clear()
            ended = self._live.ended
            if ended is not None and ended.kind == MOVED:
                await self._close(4000 + ended.problem.status, ended.kind)
            if ended is not None:
                if self._frame_tasks:  # they have their outcomes now: send these first
                    await asyncio.wait(tuple(self._frame_tasks))
                await self._send(ProblemEvent(problem=ended.problem))
                await self._close(_SESSION_ENDED, ended.kind)
            named = [ProbeQuery(name=name) for name in self._live.lighting.positions]
            if self._subscribed_forms and named:
                async with self._answering_errors():
                    # a probe was deleted, the memory budget is used up, or the session has ended: the next event
                    with suppress(ProblemError):
                        await self._send_light(named, self._subscribed_forms, LightingUpdate)
            elif self._subscribed_forms and had_probes:
                await self._send_probes()
            had_probes = bool(named)

    async def _send(self, message: _Answer, parts: Sequence[bytes] = ()) -> None:
        """Send a message as text, or as binary if it has data, and wait until the client accepts it."""
        self._count("sent", message.type)
        async with self._send_lock:
            with _ending_when_closed():
                if parts and isinstance(message, LightAnswer | LightingUpdate):
                    await self._websocket.send_bytes(pack_light(message, parts))
                else:
                    await self._websocket.send_text(message.model_dump_json(exclude_none=True))

    def _count(self, direction: str, kind: str) -> None:
        self._context.metrics.messages.labels(direction, kind).inc()

    async def _close(self, code: int, reason: str) -> NoReturn:
        with _ending_when_closed():
            await self._websocket.close(code, reason)
        raise _ConnectionEndedError


def _stated_request(text: str) -> str | None:
    """Return the `request` in a message even if the message is otherwise invalid, as `stated_index` does for frames."""
    with suppress(ValueError, RecursionError):
        message = json.loads(text)
        request = message.get("request") if isinstance(message, dict) else None
        if isinstance(request, str):
            request.encode()  # half of a surrogate pair cannot be sent back
            return request
    return None


@contextmanager
def _ending_when_closed() -> Generator[None]:
    """Convert the errors of Starlette and uvicorn for sending on a closed connection."""
    try:
        yield
    except (WebSocketDisconnect, RuntimeError) as error:
        raise _ConnectionEndedError from error
