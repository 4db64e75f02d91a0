"""Phones that stream to a server at a steady rate, one session each: which rate is held, and the response times.

A phone drops a frame that is due while `IN_FLIGHT` of its frames are unanswered, as `roomlight stream` does. After each
processed frame it requests the light of the probe that it tracks. Times are milliseconds, measured at the phone.
"""

import asyncio
import time
from collections.abc import Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from ssl import SSLContext
from typing import Final

import httpx

from roomlight.conventions import Position
from roomlight.wire.messages import FrameResult, ModelName
from roomlight_client import AsyncClient, AsyncSession, BusyError, ConflictError
from roomlight_client.calls import FRAME_MEDIA_TYPE, Call
from roomlight_client.retry import NO_RETRY, Timeouts

IN_FLIGHT: Final = 2
"""As in `roomlight stream`: one frame is uploaded while the other is processed."""
PROBE: Final = "table"
FORMS: Final = ("sh", "main_light")
"""The light that an application shades with; 1 kB."""
LOST: Final = frozenset({"frame-conflict", "session-full"})
"""Problems that count as a lost frame: a newer one overtook it on another connection, or the session queue is full."""
TIMEOUTS: Final = Timeouts(read_s=300.0)
"""With 64 sessions on two cores a frame may wait ten seconds: the benchmark measures that, it is not an error."""


@dataclass
class Outcome:
    """Result of a load.

    Attributes:
        in_time: Frames processed before the load's end.
        dropped: Frames not sent, because `IN_FLIGHT` others were unanswered.
        superseded: Frames sent that the server skipped for a newer one.
        frame_ms: Response times of all processed frames.
        light_ms: Response times of the requests for light.
    """

    sent: int = 0
    in_time: int = 0
    dropped: int = 0
    superseded: int = 0
    frame_ms: list[float] = field(default_factory=list[float])
    light_ms: list[float] = field(default_factory=list[float])


@dataclass(frozen=True)
class Load:
    """What the phones do, one session each.

    Attributes:
        fps: Frames per second that each phone sends.
        bodies: Frame messages, sent one after the other and again from the start after the last.
        probe: Position of the tracked probe, world metres.
        tls: Trusts the certificate of a server with HTTPS.
    """

    sessions: int
    seconds: float
    fps: float
    bodies: Sequence[bytes]
    probe: Position
    model: ModelName
    height: int
    token: str | None = None
    tls: SSLContext | None = None


def frame_call(session_id: str, index: int, body: bytes) -> Call[FrameResult]:
    """Make the request for a packed frame: packing is the phone's work, which does not load this machine."""

    def read(reply: httpx.Response) -> FrameResult:
        return FrameResult.model_validate_json(reply.content)

    path = f"/v1/sessions/{session_id}/frames/{index}"
    return Call("PUT", path, read, {"Content-Type": FRAME_MEDIA_TYPE}, body)


class Phones:
    """The phones of a load; the `with` statement opens their sessions and sends each its first frame."""

    def __init__(self, url: str, load: Load) -> None:
        """Prepare the load; nothing is sent yet."""
        self._url, self._load = url, load
        self._stack = AsyncExitStack()
        self.sessions: list[AsyncSession] = []
        self._phones: list[_Phone] = []

    async def __aenter__(self) -> "Phones":
        """Connect the phones one after the other, each on a connection of its own."""
        load = self._load
        for number in range(load.sessions):
            transport = None if load.tls is None else httpx.AsyncHTTPTransport(verify=load.tls)
            made = AsyncClient(self._url, token=load.token, timeouts=TIMEOUTS, transport=transport)
            client = await self._stack.enter_async_context(made)
            session = await client.open(model=load.model, height=load.height, reference_exposure=1.0)
            await session.track(PROBE, load.probe)
            phone = _Phone(client, session, load, number)
            await phone.begin()
            self.sessions.append(session)
            self._phones.append(phone)
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close the connections; the sessions end with their server."""
        await self._stack.aclose()

    async def stream(self) -> Outcome:
        """Stream from all phones at the same time and return when all responses have arrived.

        The phones' frames are staggered evenly over the interval between two frames.
        """
        outcome = Outcome()
        start_s = time.perf_counter()
        try:
            await asyncio.gather(*(phone.stream(start_s, outcome) for phone in self._phones))
        except ExceptionGroup as group:  # of a phone's tasks: the first failure cancelled the others
            raise group.exceptions[0] from None
        return outcome


class _Phone:
    def __init__(self, client: AsyncClient, session: AsyncSession, load: Load, number: int) -> None:
        self._client, self._session, self._load, self._number = client, session, load, number
        self._index = self._in_flight = 0
        self._requesting_light = False

    async def begin(self) -> None:
        """Send the first frame, which makes the volume and takes longer than others."""
        await self._client.run(self._call())

    async def stream(self, load_start_s: float, outcome: Outcome) -> None:
        load = self._load
        start_s = load_start_s + self._number / load.sessions / load.fps
        end_s = load_start_s + load.seconds
        async with asyncio.TaskGroup() as tasks:
            for due in range(max(1, round(load.seconds * load.fps))):
                await asyncio.sleep(max(0.0, start_s + due / load.fps - time.perf_counter()))
                if self._in_flight >= IN_FLIGHT:
                    outcome.dropped += 1
                else:
                    self._in_flight += 1
                    outcome.sent += 1
                    tasks.create_task(self._send(self._call(), end_s, outcome, tasks))

    def _call(self) -> Call[FrameResult]:
        bodies, index = self._load.bodies, self._index
        self._index += 1
        return frame_call(self._session.id, index, bodies[index % len(bodies)])

    async def _send(self, call: Call[FrameResult], end_s: float, outcome: Outcome, tasks: asyncio.TaskGroup) -> None:
        start_s = time.perf_counter()
        try:
            result = await self._client.run(call, retry=NO_RETRY)
        except (BusyError, ConflictError) as error:
            if error.kind not in LOST:
                raise
            self._in_flight -= 1
            outcome.superseded += 1
            return
        now_s = time.perf_counter()
        self._in_flight -= 1
        if result.status != "processed":
            outcome.superseded += 1
            return
        outcome.frame_ms.append(1e3 * (now_s - start_s))
        outcome.in_time += now_s <= end_s
        if not self._requesting_light:
            self._requesting_light = True
            tasks.create_task(self._request_light(outcome))

    async def _request_light(self, outcome: Outcome) -> None:
        start_s = time.perf_counter()
        await self._session.light_at(PROBE, FORMS)
        outcome.light_ms.append(1e3 * (time.perf_counter() - start_s))
        self._requesting_light = False
