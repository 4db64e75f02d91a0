"""`/v1/sessions/{id}/stream`: frames in, their fates and the light out, on one WebSocket (server/WIRE.md).

Where a client reads too slowly, its fates wait, then its frames (the connection is not read on), and of the lighting
updates only the newest is kept. Nothing it sends ends the connection but what is no frame and no text at all.
"""

import asyncio
from collections.abc import Sequence
from typing import Final

from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from pydantic import TypeAdapter, ValidationError

from roomlight.wire.frame_message import explain, stated_index
from roomlight.wire.light_message import pack_light
from roomlight.wire.messages import (
    ClientMessage,
    FrameEvent,
    LightAnswer,
    LightCall,
    LightForm,
    LightingUpdate,
    LightRequest,
    ProbeLight,
    ProbeQuery,
    ProbesEvent,
    ProblemEvent,
    Subscribe,
    Track,
    WireModel,
    is_id,
)
from roomlight_server.auth import SUBPROTOCOL
from roomlight_server.bodies import JSON_BYTES
from roomlight_server.context import Context
from roomlight_server.light_routes import answer, check_size
from roomlight_server.live_session import LiveSession
from roomlight_server.problems import ProblemError

router = APIRouter()
_MESSAGES: Final[TypeAdapter[ClientMessage]] = TypeAdapter(ClientMessage)
_CLOSE: Final = {"session-not-found": 4404, "invalid": 4422}
"""Close codes: 4000 + the HTTP status that the same refusal has."""


@router.websocket("/v1/sessions/{session_id}/stream")
async def stream(websocket: WebSocket, session_id: str) -> None:
    """Serve one connection until it or its session ends."""
    context: Context = websocket.app.state.context
    owner: str = websocket.scope["state"]["owner"]
    offered = websocket.scope.get("subprotocols", [])
    await websocket.accept(subprotocol=SUBPROTOCOL if SUBPROTOCOL in offered else None)
    try:
        if not is_id(session_id):
            raise ProblemError("invalid", "a session id is A-Z a-z 0-9 _ -, up to 64", field="id", value=session_id)
        with context.registry.use(owner, session_id) as live:
            pass  # a connection alone keeps no session alive; its messages do
    except ProblemError as error:
        await websocket.send_text(ProblemEvent(problem=error.problem).model_dump_json(exclude_none=True))
        await websocket.close(_CLOSE[error.kind], error.kind)
        return
    with context.metrics.streams.track_inprogress():
        await _Connection(websocket, context, owner, live).run()


class _Connection:
    def __init__(self, websocket: WebSocket, context: Context, owner: str, live: LiveSession) -> None:
        self._websocket, self._context, self._owner, self._live = websocket, context, owner, live
        self._forms: list[LightForm] = []
        self._changed = asyncio.Event()
        self._sending = asyncio.Lock()
        self._frames: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        unlisten = self._live.listen(self._changed.set)
        tasks = [asyncio.create_task(self._receive()), asyncio.create_task(self._update())]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            unlisten()
            for task in (*tasks, *self._frames):
                task.cancel()
            done = await asyncio.gather(*tasks, *self._frames, return_exceptions=True)
        for error in done:  # what is no disconnection is a mistake of ours, and is logged as one
            if isinstance(error, Exception) and not isinstance(error, WebSocketDisconnect | RuntimeError):
                raise error

    async def _receive(self) -> None:
        while True:
            message = await self._websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            data, text = message.get("bytes"), message.get("text")
            try:
                with self._context.registry.use(self._owner, self._live.name) as live:
                    live.check_open()
                    if live is not self._live:
                        raise ProblemError("session-closed", "the session was deleted; connect anew")
                    if data is not None:
                        await self._frame(data)
                    elif text is not None:
                        await self._text(text)
            except ProblemError as error:
                await self._problem(error, index=None if data is None else stated_index(data))

    async def _frame(self, data: bytes) -> None:
        """Take a frame in order, waiting for room (and so not reading on); its fate is told when it is known."""
        limit = self._context.settings.max_body_bytes
        if len(data) > limit:
            raise ProblemError("too-large", f"the frame is {len(data)} bytes", rule=f"at most {limit} bytes")
        room = self._live.room_for_frame(wait=True)
        await room.__aenter__()

        async def take() -> None:
            try:
                entry = await self._live.accept(data, None)
                result = await asyncio.shield(entry.outcome)
                await self._send(FrameEvent(**result.model_dump()))
            except ProblemError as error:
                await self._problem(error, index=stated_index(data))
            finally:
                await room.__aexit__(None, None, None)

        task = asyncio.create_task(take())
        self._frames.add(task)
        task.add_done_callback(self._frames.discard)

    async def _text(self, text: str) -> None:
        if len(text) > JSON_BYTES:
            raise ProblemError("too-large", f"the text is {len(text)} long", rule=f"at most {JSON_BYTES}")
        try:
            message = _MESSAGES.validate_json(text)
        except ValidationError as error:
            raise ProblemError.from_wire(explain(error, kind="invalid")) from error
        if isinstance(message, LightCall):
            try:
                check_size(message)
                frame, results, parts = await self._lights(message.probes, message.forms)
            except ProblemError as error:
                await self._problem(error, request=message.request)
            else:
                await self._send(LightAnswer(request=message.request, frame=frame, results=results), parts)
        elif isinstance(message, Subscribe):
            named = [ProbeQuery(name="x")] * self._context.settings.max_probes
            if message.forms:
                check_size(LightRequest(probes=named[:64], forms=message.forms))
            self._forms = message.forms
            self._changed.set()
        elif isinstance(message, Track):
            x, y, z = message.position
            await self._live.track(message.name, (x, y, z))
            await self._tell_probes()
        else:
            await self._live.untrack(message.name)
            await self._tell_probes()

    async def _tell_probes(self) -> None:
        probes = {name: list(position) for name, position in self._live.probes.items()}
        await self._send(ProbesEvent(probes=probes))

    async def _lights(
        self, probes: Sequence[ProbeQuery], forms: list[LightForm]
    ) -> tuple[int, list[ProbeLight], list[bytes]]:
        points = await self._live.lights(probes)
        results, parts = await answer(self._context.workers, points, forms)
        return points[0].frame, results, parts

    async def _update(self) -> None:
        """After each frame, the newest light of the named probes; frames that come meanwhile count as one."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            if self._live.ended is not None:
                await self._problem(self._live.ended)
                await self._websocket.close(4410, self._live.ended.kind)
                return
            named = [ProbeQuery(name=name) for name in self._live.probes]
            if not self._forms or not named:
                continue
            try:
                frame, results, parts = await self._lights(named, self._forms)
            except ProblemError:
                continue  # a probe was given up meanwhile, or the session: the next turn knows
            await self._send(LightingUpdate(frame=frame, results=results), parts)

    async def _problem(self, error: ProblemError, *, index: int | None = None, request: str | None = None) -> None:
        await self._send(ProblemEvent(problem=error.problem, index=index, request=request))

    async def _send(self, message: WireModel, parts: Sequence[bytes] = ()) -> None:
        """Text, or binary where there is data; one message at a time, each waiting for the client to take it."""
        async with self._sending:
            if parts and isinstance(message, LightAnswer | LightingUpdate):
                await self._websocket.send_bytes(pack_light(message, parts))
            else:
                await self._websocket.send_text(message.model_dump_json(exclude_none=True))
