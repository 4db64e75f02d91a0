"""One session of the server: the engine's `Session` behind turns, its frames in order, its named probes, its light.

Everything here runs on the event loop; the engine is called on its threads. `_turn` puts what needs the engine in
order, and is held while a session waits for an engine thread behind the others; `_changing` is held only while its
state changes. The light of named probes is read between changes, so it waits for no other session. They are taken in
this order: `_turn`, a thread, `_changing`.

What is refused leaves the session as it was. An engine that fails in the middle of a frame may not be: the session is
then failed, says so from then on, and its memory is given back.
"""

import asyncio
import hashlib
import logging
from collections import OrderedDict
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal, TypeVar, cast

import numpy as np
from jaxtyping import Float

from roomlight.conventions import NO_FRAME, Position
from roomlight.engine.memory import Footprint
from roomlight.engine.session import FrameReport, Session
from roomlight.errors import FrameError, ProbeError, WireError
from roomlight.frame import Frame
from roomlight.light.light import Light
from roomlight.light.prior import prior_panorama
from roomlight.wire.frame_message import FrameLimits, FrameMessage
from roomlight.wire.messages import FrameResult, Memory, ProbeQuery, SessionRequest, SessionState, Volume
from roomlight_server.frame_queue import Entry, FrameQueue, replayed
from roomlight_server.intake import decode_to_size, index_of, parse_frame
from roomlight_server.metrics import Metrics
from roomlight_server.problems import ProblemError
from roomlight_server.workers import Workers

_log = logging.getLogger("roomlight.server")
_R = TypeVar("_R")
KEPT_LIGHTS: Final = 8
"""Lights of late probes kept for further forms and for `If-None-Match`: 0.6 MB each at a height of 120."""


@dataclass(frozen=True)
class PointLight:
    """Light at a point, the digest that is its identity, and the frame it is of."""

    light: Light
    digest: str
    frame: int
    name: str | None = None


@dataclass(frozen=True)
class Limits:
    """What a session may use; see `ServerSettings`."""

    frame: FrameLimits
    frames_in_flight: int
    max_probes: int
    idle_expiry_s: float


@dataclass
class _Named:
    position: Position
    handle: int
    coverage: float = 0.0


class LiveSession:
    """See the module. `last_used_s` is its owner's business (`registry`)."""

    def __init__(
        self,
        name: str,
        request: SessionRequest,
        *,
        engine: Session,
        workers: Workers,
        footprint: Footprint,
        limits: Limits,
        metrics: Metrics,
    ) -> None:
        """Around a new engine session."""
        self.name, self.request = name, request
        self.last_used_s = 0.0
        self.users = 0
        self._engine: Session | None = engine
        self._model = engine.model
        self._keyframe_capacity = engine.options.keyframes
        self._workers, self._footprint, self._limits, self._metrics = workers, footprint, limits, metrics
        self._turn, self._changing, self._order = asyncio.Lock(), asyncio.Lock(), asyncio.Lock()
        self._in_flight = asyncio.Semaphore(limits.frames_in_flight)
        self._queue = FrameQueue()
        self._runner: asyncio.Task[None] | None = None
        self._reference = request.reference_exposure
        self._named: dict[str, _Named] = {}
        self._lights: OrderedDict[tuple[str | None, Position], PointLight] = OrderedDict()
        self._light_frame = NO_FRAME
        self._ended: ProblemError | None = None
        self._listeners: set[Callable[[], None]] = set()

    # --- frames -----------------------------------------------------------------------------------------------

    @asynccontextmanager
    async def room_for_frame(self, *, wait: bool = False) -> AsyncGenerator[None]:
        """Hold one of the places for frames on their way in. Full: ProblemError (429), or wait for one."""
        self.check_open()
        if self._in_flight.locked() and not wait:
            most = self._limits.frames_in_flight
            detail = f"{most} frames of this session are being sent, decoded or awaited; send the newest a little later"
            raise ProblemError("session-full", detail, rule=f"at most {most} at once", retry_after_s=1)
        async with self._in_flight:
            yield

    async def accept(self, body: bytes, index: int | None) -> Entry:
        """Take a frame's message: parsed, checked, decoded, in order. The entry's outcome is what became of it.

        `index` is the address's, None for the message's own. Raises ProblemError with nothing changed.
        """
        async with self._order:
            try:
                entry = await self._accept_in_order(body, index)
            except WireError as error:
                self._queue.count_refused()
                self._metrics.refused.labels("bad-frame").inc()
                raise ProblemError.from_wire(error) from error
            except ProblemError as error:
                self._queue.count_refused()
                self._metrics.refused.labels(error.kind).inc()
                raise
        if self._queue.has_waiting and self._runner is None:
            self._runner = asyncio.create_task(self._run())
        return entry

    async def _accept_in_order(self, body: bytes, index: int | None) -> Entry:
        message, digest = await self._workers.aside(parse_frame, body, self._limits.frame)
        index = index_of(message, index)
        self.check_open()
        repeated = self._queue.replay_of(index, digest)
        if repeated is not None:
            return Entry(index, digest, outcome=replayed(repeated.outcome))
        usable = {"normal"} | ({"limited"} if self.request.use_limited_tracking else set[str]())
        entry = Entry(index, digest)
        if message.header.tracking_state in usable:
            if self._queue.has_waiting:
                entry.message = message
            else:
                entry.frame = await self._decoded(message, index)
        self.check_open()
        self._queue.accept(entry)
        return entry

    async def _decoded(self, message: FrameMessage, index: int) -> Frame:
        reference = self._reference or message.header.exposure
        frame = await self._workers.aside(decode_to_size, message, index, reference, self.request.min_confidence)
        self._reference = reference
        return frame

    async def _run(self) -> None:
        """Push what waits until nothing does; the newest is taken when an engine thread is free."""
        try:
            while self._queue.has_waiting:
                async with self._turn, self._workers.engine_turn(), self._changing:
                    entry = self._queue.take()
                    if entry is not None:
                        await self._push(entry)
                for listener in tuple(self._listeners):
                    listener()
        finally:
            self._runner = None

    async def _push(self, entry: Entry) -> None:
        engine, frame = self._engine, entry.frame
        if engine is None:
            return  # ended: the entry has been told
        try:
            if frame is None and entry.message is not None:
                frame = await self._decoded(entry.message, entry.index)
            assert frame is not None
            report = await self._workers.on_engine(engine.push, frame)
        except WireError as error:
            self._refuse(entry, ProblemError.from_wire(error))
        except FrameError as error:
            self._refuse(
                entry, ProblemError("bad-frame", str(error), field="frame", value=entry.index, rule=str(error))
            )
        except Exception as error:  # out of memory, ONNX Runtime: half a frame may be in the state
            _log.exception("engine failed", extra={"session": self.name, "frame": entry.index})
            self._metrics.frames.labels("failed").inc()
            entry.fail(ProblemError("engine-failed", f"frame {entry.index}: {type(error).__name__}; open it anew"))
            self._end(ProblemError("session-failed", f"its engine failed on frame {entry.index}; DELETE it, open anew"))
        else:
            self._light_frame = entry.index
            self._metrics.observe_frame(report)
            self._queue.processed(entry, self._result(engine, entry.index, report))

    def _refuse(self, entry: Entry, refusal: ProblemError) -> None:
        self._metrics.refused.labels("bad-frame").inc()
        self._queue.refused(entry, refusal)

    def _result(self, engine: Session, index: int, report: FrameReport) -> FrameResult:
        coverage = dict(zip(engine.handles, report.coverage, strict=True))
        for named in self._named.values():
            named.coverage = coverage.get(named.handle, named.coverage)
        return FrameResult(
            index=index,
            status="processed",
            keyframe=report.keyframe,
            stage_ms={stage: round(ms, 2) for stage, ms in report.stage_ms.items()},
            coverage=self._coverage(),
        )

    # --- probes and light -------------------------------------------------------------------------------------

    async def track(self, name: str, position: Position) -> bool:
        """Follow a point under a name; True if the name is new. The same again changes nothing.

        Raises ProblemError: too many probes, no such position.
        """
        async with self._turn:
            engine, old = self._live_engine(), self._named.get(name)
            if old is not None and old.position == position:
                return False
            if old is None and len(self._named) >= self._limits.max_probes:
                most = self._limits.max_probes
                raise ProblemError(
                    "too-many-probes", f"{most} named probes are tracked; delete one", rule=f"at most {most}"
                )
            async with self._workers.engine_turn():
                handle = await _probing(self._workers.on_engine(engine.track, position))
            new = _Named(position, handle)
            if self.has_light:
                new.coverage = (await self._workers.aside(engine.light, handle)).coverage
            async with self._changing:
                if old is not None:
                    self._forget(engine, name)
                self._named[name] = new
            return old is None

    async def untrack(self, name: str) -> None:
        """No longer follow it. Raises ProblemError (404)."""
        async with self._turn, self._changing:
            engine = self._live_engine()
            self._named_probe(name)
            self._forget(engine, name)

    def _forget(self, engine: Session, name: str) -> None:
        named = self._named.pop(name)
        engine.untrack(named.handle)
        self._lights.pop((name, named.position), None)

    async def lights(self, queries: Sequence[ProbeQuery]) -> list[PointLight]:
        """Light at each point, all after the same frame; the prior, of frame `NO_FRAME`, before the first.

        Raises ProblemError.
        """
        named = all(query.name is not None for query in queries)
        async with self._changing if named else self._turn:
            engine = self._live_engine()
            if not self.has_light:
                return [self._prior(query) for query in queries]
            return [await self._light(engine, query) for query in queries]

    async def _light(self, engine: Session, query: ProbeQuery) -> PointLight:
        name = query.name
        position = self._named_probe(name).position if name is not None else _position(query)
        kept = self._lights.get((name, position))
        if kept is not None and kept.frame == self._light_frame:
            self._lights.move_to_end((name, position))
            return kept
        if name is not None:
            light = await self._workers.aside(engine.light, self._named[name].handle)
        else:
            async with self._workers.engine_turn():
                light = await _probing(self._workers.on_engine(engine.light_at, position))
        found = PointLight(light, await self._workers.aside(_digest, light), self._light_frame, name)
        self._lights[name, position] = found
        while len(self._lights) > KEPT_LIGHTS:
            self._lights.popitem(last=False)
        return found

    def _prior(self, query: ProbeQuery) -> PointLight:
        name = query.name
        position = self._named_probe(name).position if name is not None else _position(query)
        panorama, observed, digest = _prior(self.request.height)
        return PointLight(Light(position, panorama, observed, 0.0), digest, NO_FRAME, name)

    def _named_probe(self, name: str) -> _Named:
        named = self._named.get(name)
        if named is None:
            raise ProblemError("probe-not-found", f"this session tracks no probe {name!r}", field="name", value=name)
        return named

    @property
    def probes(self) -> dict[str, Position]:
        """The named probes."""
        return {name: named.position for name, named in self._named.items()}

    @property
    def has_light(self) -> bool:
        """Whether a frame was processed."""
        return self._light_frame != NO_FRAME

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call `listener` after each frame (on the loop); returns how to stop it."""
        self._listeners.add(listener)
        return lambda: self._listeners.discard(listener)

    # --- its life ---------------------------------------------------------------------------------------------

    def check_open(self) -> None:
        """Raise ProblemError if the session has failed or was deleted."""
        if self._ended is not None:
            raise self._ended

    @property
    def ended(self) -> ProblemError | None:
        """Why the session is over, or None."""
        return self._ended

    def close(self) -> None:
        """Deleted or expired: nobody is left waiting, and the engine's memory goes with its last frame."""
        self._end(ProblemError("session-closed", "the session was deleted or has expired"))

    def _end(self, why: ProblemError) -> None:
        self._ended = why
        self._engine = None
        self._lights.clear()
        self._queue.abandon(why)
        self._workers.tidy_up()
        for listener in tuple(self._listeners):
            listener()

    def _live_engine(self) -> Session:
        self.check_open()
        assert self._engine is not None
        return self._engine

    def _coverage(self) -> dict[str, float]:
        return {name: round(named.coverage, 4) for name, named in self._named.items()}

    @property
    def bound_bytes(self) -> int:
        """The most memory that the session can come to hold."""
        part, keyframes = self._footprint, self._keyframe_capacity
        full = part.held(keyframes=keyframes, probes=self._limits.max_probes, started=True)
        return full + KEPT_LIGHTS * self._light_bytes

    @property
    def _light_bytes(self) -> int:
        return 16 * 2 * self.request.height**2  # radiance and what was seen

    def state(self) -> SessionState:
        """As it is now."""
        engine = self._engine
        grid = None if engine is None else engine.grid
        keyframes = 0 if engine is None else engine.keyframes
        held = self._footprint.held(keyframes=keyframes, probes=len(self._named), started=grid is not None)
        kept = held + len(self._lights) * self._light_bytes
        volume = None
        if grid is not None:
            volume = Volume(shape=list(grid.shape), voxel_m=grid.edge_m, depth_max_m=grid.depth_max_m)
        return SessionState(
            id=self.name,
            status="open" if self._ended is None else "failed",
            model=cast("Literal['classical', 'single', 'video']", self._model),
            options=self.request,
            frames=self._queue.counts(),
            probes={name: list(named.position) for name, named in self._named.items()},
            coverage=self._coverage(),
            keyframes=keyframes,
            memory=Memory(bytes=0 if engine is None else kept, bound_bytes=self.bound_bytes),
            volume=volume,
            idle_expiry_s=self._limits.idle_expiry_s,
        )


async def _probing(work: Awaitable[_R]) -> _R:
    """A question to the engine: a position that is none is the client's, memory that is not there the server's."""
    try:
        return await work
    except ProbeError as error:
        raise ProblemError("invalid", str(error), field="position", rule=str(error)) from error
    except Exception as error:  # nothing was changed: probes are made whole before they enter the session
        _log.exception("probe failed")
        raise ProblemError("engine-failed", f"the light could not be computed: {type(error).__name__}") from error


def _position(query: ProbeQuery) -> Position:
    assert query.position is not None
    x, y, z = query.position
    return x, y, z


@lru_cache(maxsize=4)
def _prior(height: int) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"], str]:
    """Panorama, what was observed of it (nothing), and its digest."""
    panorama = prior_panorama(height)
    observed = np.zeros(panorama.shape[:2], np.float32)
    return panorama, observed, _digest(Light((0.0, 0.0, 0.0), panorama, observed, 0.0))


def _digest(light: Light) -> str:
    """The light's identity: the same numbers, the same digest. 0.3 ms at a height of 120."""
    return hashlib.sha256(light.panorama.tobytes() + light.observed.tobytes()).hexdigest()[:24]
