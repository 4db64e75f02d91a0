"""Phones that stream to a server at a steady rate, each a session: what rate is held, and how long answers take.

A frame that is due while `IN_FLIGHT` of its phone's are on their way is dropped, as `roomlight stream` does it. After
each processed frame a phone asks for the light of the probe it tracks. Milliseconds, from the phone's side.
"""

import asyncio
import time
from collections.abc import Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from typing import Final

from roomlight.conventions import Position
from roomlight.wire.messages import FrameResult, ModelName
from roomlight_client import AsyncClient, AsyncSession, BusyError, ConflictError
from roomlight_client.calls import FRAME_MEDIA_TYPE, Call, Reply
from roomlight_client.retry import NO_RETRY, Timeouts

IN_FLIGHT: Final = 2
"""As `roomlight stream`: one frame is uploaded while the other is worked on."""
PROBE: Final = "table"
FORMS: Final = ("sh", "main_light")
"""What an app shades with; 1 kB."""
LOST: Final = frozenset({"frame-conflict", "session-full"})
"""A frame that one sent after it overtook on another connection, or that found the session's hands full."""
TIMEOUTS: Final = Timeouts(read_s=300.0)
"""64 sessions on two cores: a frame may well wait for ten seconds, which is to be measured, not to be an error."""


@dataclass
class Outcome:
    """What came of a load. `held` counts the frames processed within the time, latencies are of all processed ones.

    dropped: not sent, because `IN_FLIGHT` others were on their way. superseded: sent, but a newer one went before.
    """

    sent: int = 0
    held: int = 0
    dropped: int = 0
    superseded: int = 0
    frame_ms: list[float] = field(default_factory=list[float])
    light_ms: list[float] = field(default_factory=list[float])


@dataclass(frozen=True)
class Load:
    """`bodies`: frame messages without an index, sent in turn, again from the start when they are through."""

    sessions: int
    seconds: float
    fps: float
    bodies: Sequence[bytes]
    probe: Position
    mode: ModelName
    height: int


def frame_call(session_id: str, index: int, body: bytes) -> Call[FrameResult]:
    """A frame that is packed already: packing is the phone's work, and phones have processors of their own."""

    def read(reply: Reply) -> FrameResult:
        return FrameResult.model_validate_json(reply.body)

    path = f"/v1/sessions/{session_id}/frames/{index}"
    return Call("PUT", path, read, {"Content-Type": FRAME_MEDIA_TYPE}, body)


class Phones:
    """The sessions of a load. In a `with` statement they are opened, and each has had its first frame."""

    def __init__(self, url: str, load: Load) -> None:
        """Nothing is sent yet."""
        self._url, self._load = url, load
        self._stack = AsyncExitStack()
        self.sessions: list[AsyncSession] = []
        self._phones: list[_Phone] = []

    async def __aenter__(self) -> "Phones":
        """A connection of its own each, as phones have; one after the other."""
        load = self._load
        for number in range(load.sessions):
            client = await self._stack.enter_async_context(AsyncClient(self._url, timeouts=TIMEOUTS))
            session = await client.open(model=load.mode, height=load.height, reference_exposure=1.0)
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
        """All at once, their frames spread evenly over the time between two; returns when all answers are there."""
        outcome = Outcome()
        began_s = time.perf_counter()
        try:
            await asyncio.gather(*(phone.stream(began_s, outcome) for phone in self._phones))
        except ExceptionGroup as group:  # of a phone's tasks: the first that went wrong took the others with it
            raise group.exceptions[0] from None
        return outcome


class _Phone:
    def __init__(self, client: AsyncClient, session: AsyncSession, load: Load, number: int) -> None:
        self._client, self._session, self._load, self._number = client, session, load, number
        self._index = self._flying = 0
        self._asking = False

    async def begin(self) -> None:
        """The first frame makes the volume and takes longer."""
        await self._client.run(self._call())

    async def stream(self, began_s: float, outcome: Outcome) -> None:
        load = self._load
        start_s = began_s + self._number / load.sessions / load.fps
        end_s = began_s + load.seconds
        async with asyncio.TaskGroup() as tasks:
            for due in range(max(1, round(load.seconds * load.fps))):
                await asyncio.sleep(max(0.0, start_s + due / load.fps - time.perf_counter()))
                if self._flying >= IN_FLIGHT:
                    outcome.dropped += 1
                else:
                    self._flying += 1
                    outcome.sent += 1
                    tasks.create_task(self._send(self._call(), end_s, outcome, tasks))

    def _call(self) -> Call[FrameResult]:
        bodies, index = self._load.bodies, self._index
        self._index += 1
        return frame_call(self._session.id, index, bodies[index % len(bodies)])

    async def _send(self, call: Call[FrameResult], end_s: float, outcome: Outcome, tasks: asyncio.TaskGroup) -> None:
        began_s = time.perf_counter()
        try:
            result = await self._client.run(call, retry=NO_RETRY)
        except (BusyError, ConflictError) as error:
            if error.kind not in LOST:
                raise
            self._flying -= 1
            outcome.superseded += 1
            return
        now_s = time.perf_counter()
        self._flying -= 1
        if result.status != "processed":
            outcome.superseded += 1
            return
        outcome.frame_ms.append(1e3 * (now_s - began_s))
        outcome.held += now_s <= end_s
        if not self._asking:
            self._asking = True
            tasks.create_task(self._ask(outcome))

    async def _ask(self, outcome: Outcome) -> None:
        began_s = time.perf_counter()
        await self._session.light_at(PROBE, FORMS)
        outcome.light_ms.append(1e3 * (time.perf_counter() - began_s))
        self._asking = False
