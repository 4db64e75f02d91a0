"""One session of the server: an engine session with its frame queue, named probes and light.

All methods run on the event loop; the engine runs on its own threads. A rejected request leaves the session unchanged.
If the engine fails while it processes a frame, its state may be inconsistent: the session then has failed, every later
request is answered with this error, and its memory is released.
"""

import asyncio
import logging
from collections.abc import AsyncGenerator, Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager, nullcontext
from dataclasses import asdict
from typing import Literal, TypeVar, cast

from roomlight.conventions import NO_FRAME, Position
from roomlight.engine.memory import Footprint
from roomlight.engine.session import FrameReport, Session
from roomlight.errors import FrameError, WireError
from roomlight.frame import Frame
from roomlight.light.light import Light
from roomlight.wire.frame_message import FrameMessage
from roomlight.wire.messages import FrameResult, Memory, ProbeQuery, SessionRequest, SessionState
from roomlight_server.frame_queue import Entry, FrameQueue, replayed
from roomlight_server.history import History
from roomlight_server.intake import LatestFrame, decode_to_size, index_of, parse_frame
from roomlight_server.light_forms import default_panorama, digest_of_light
from roomlight_server.metrics import Metrics
from roomlight_server.problems import INTERNAL_DETAIL, ProblemError, convert_probe_errors
from roomlight_server.request_context import request_id
from roomlight_server.session_parts import (
    MAX_CACHED_LIGHTS,
    CompositeTurn,
    FrameSlots,
    LightCache,
    Limits,
    NamedProbe,
    finished_light,
    volume_of,
)
from roomlight_server.state.journal import Journal
from roomlight_server.state.live_state import LiveState, SavedProbe
from roomlight_server.workers import Workers

_log = logging.getLogger("roomlight.server")
_R = TypeVar("_R")


class LiveSession:
    """One session of the server. The registry maintains `last_used_s` and `users`."""

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
        """Wrap a new engine session."""
        self.name, self.request = name, request
        self.last_used_s = 0.0
        self.users = 0
        self._engine: Session | None = engine
        self._model = engine.model
        self._keyframe_capacity = engine.options.keyframes
        self._workers, self._footprint, self._limits, self._metrics = workers, footprint, limits, metrics
        # Locks are taken in this order: _engine_lock, an engine slot of `workers`, _state_lock. _ingest_lock is never
        # held together with another one.
        # _engine_lock: one engine call at a time (push, track, untrack, light at a position), in the order of arrival;
        # held while this session waits behind others for a slot.
        self._engine_lock = asyncio.Lock()
        # _state_lock: the engine's state, _named and _light_frame; held only while they change. Reading the light of
        # named probes takes this lock alone, so it never waits for a slot.
        self._state_lock = asyncio.Lock()
        # _ingest_lock: frames enter the queue in the order of arrival, although parsing and decoding run on threads.
        self._ingest_lock = asyncio.Lock()
        self._slots = FrameSlots(limits.frames_in_flight)
        self.journal: Journal | None = None
        self._queue = FrameQueue(lambda status: metrics.frames.labels(status).inc(), lambda: self.durable_index)
        self._runner: asyncio.Task[None] | None = None
        self._reference = request.reference_exposure
        self._named: dict[str, NamedProbe] = {}
        self._lights = LightCache()
        self._light_frame = NO_FRAME
        self._latest: LatestFrame | None = None
        self.history = History(limits.history_bytes, workers)
        self._composite_turn = CompositeTurn()
        self._ended: ProblemError | None = None
        self._listeners: set[Callable[[], None]] = set()

    # --- frames -----------------------------------------------------------------------------------------------

    @asynccontextmanager
    async def frame_slot(self) -> AsyncGenerator[None]:
        """Hold a slot for a frame in flight (being received, decoded or processed).

        Raises:
            ProblemError: All slots are taken (429), or the session has ended.
        """
        self.check_open()
        async with self._slots.held():
            yield

    async def acquire_frame_slot(self) -> None:
        """Wait for a slot for a frame in flight; `release_frame_slot` frees it.

        Raises:
            ProblemError: The session has ended.
        """
        self.check_open()
        await self._slots.acquire()

    def release_frame_slot(self) -> None:
        """Free the slot of a frame."""
        self._slots.release()

    async def accept(self, body: bytes, index: int | None) -> Entry:
        """Parse, check and decode a frame message and add it to the queue.

        `index` is the index of the path, or None to use the message's own.

        Returns:
            The queue entry; its `outcome` becomes the frame's result.

        Raises:
            ProblemError: The frame is rejected; the session is unchanged.
        """
        async with self._ingest_lock:
            try:
                entry = await self._accept_in_order(body, index)
            except WireError as error:
                self._queue.count_rejected()
                self._metrics.refused.labels("bad-frame").inc()
                raise ProblemError.from_wire(error) from error
            except ProblemError as error:
                self._queue.count_rejected()
                self._metrics.refused.labels(error.kind).inc()
                raise
        if self._queue.has_waiting and self._runner is None:
            self._runner = asyncio.create_task(self._run())
        return entry

    async def _accept_in_order(self, body: bytes, index: int | None) -> Entry:
        message, digest = await self._workers.run_in_decode_pool(parse_frame, body, self._limits.frame)
        index = index_of(message, index)
        self.check_open()
        repeated = self._queue.replay_of(index, digest)
        if repeated is not None:
            return Entry(index, digest, outcome=replayed(repeated.outcome))
        usable = {"normal"} | ({"limited"} if self.request.use_limited_tracking else set[str]())
        entry = Entry(index, digest)
        if message.header.tracking_state in usable:
            entry.message = message
            if not self._queue.has_waiting:
                entry.frame = await self._decoded(message, index)
        self.check_open()
        self._queue.accept(entry)
        self._changed()
        return entry

    async def _decoded(self, message: FrameMessage, index: int) -> Frame:
        reference = self._reference or message.header.exposure
        least = self.request.min_confidence
        processes = self._workers.decode_processes

        def decode() -> Frame:
            with self._metrics.decode_seconds.time():
                return decode_to_size(message, index, reference, least, processes)

        frame = await self._workers.run_in_decode_pool(decode)
        self._reference = reference
        return frame

    async def _run(self) -> None:
        """Process waiting frames until the queue is empty; each is taken when an engine thread is free."""
        try:
            while self._queue.has_waiting:
                async with self._engine_lock, self._workers.engine_slot(), self._state_lock:
                    entry = self._queue.take()
                    if entry is not None:
                        await self._push(entry)
                for listener in tuple(self._listeners):
                    listener()
        finally:
            self._runner = None
            if self._ended is not None:
                self._workers.release_memory()  # of the frame that was being processed

    async def _push(self, entry: Entry) -> None:
        request_id.set(entry.request_id)  # the task was started by an earlier frame
        engine, frame = self._engine, entry.frame
        if engine is None:
            return  # the session has ended, and the entry has its outcome
        try:
            if frame is None:
                frame = await self._decoded_late(entry)
            report = await self._workers.run_in_engine_pool(engine.push, frame)
            result = self._result(engine, entry.index, report)
        except ProblemError as error:
            self._reject(entry, error)
        except FrameError as error:
            rule = str(error)
            self._reject(entry, ProblemError("bad-frame", rule, field="frame", value=entry.index, rule=rule))
        except Exception as error:  # out of memory, ONNX Runtime: the state may contain half of the frame
            _log.exception("engine failed", extra={"session": self.name, "frame": entry.index})
            self._metrics.frames.labels("failed").inc()
            advice = "delete the session and open a new one"
            entry.fail(ProblemError("engine-failed", f"frame {entry.index}: {type(error).__name__}; {advice}"))
            self._end(ProblemError("session-failed", f"the engine failed on frame {entry.index}; {advice}"))
        else:
            self._light_frame = entry.index
            assert entry.message is not None
            self._latest = LatestFrame(entry.index, entry.message)
            if self.journal is not None:
                self.journal.processed(entry.index, entry.message, keyframe=report.keyframe)
            self._metrics.observe_frame(report)
            handles = {name: named.handle for name, named in self._named.items()}
            await self.history.add(engine, frame, report, self._queue.counts(), handles)
            self._queue.processed(entry, result)

    async def _decoded_late(self, entry: Entry) -> Frame:
        """Decode a frame that replaced a waiting one. ProblemError if that fails: the engine is unchanged then."""
        assert entry.message is not None
        try:
            return await self._decoded(entry.message, entry.index)
        except WireError as error:
            raise ProblemError.from_wire(error) from error
        except Exception as error:
            _log.exception("unexpected error of a decoder", extra={"session": self.name, "frame": entry.index})
            raise ProblemError("internal", INTERNAL_DETAIL) from error

    def _reject(self, entry: Entry, problem: ProblemError) -> None:
        self._metrics.refused.labels(problem.kind).inc()
        self._queue.reject(entry, problem)

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
            durable_index=self.durable_index,
        )

    # --- probes and light -------------------------------------------------------------------------------------

    async def track(self, name: str, position: Position) -> bool:
        """Track a named probe; an existing name moves to the new position. Return whether the name is new.

        Raises:
            ProblemError: There are too many probes, the position is unusable, or the session has ended.
        """
        async with self._engine_lock:
            engine, old = self._live_engine(), self._named.get(name)
            if old is not None and old.position == position:
                return False
            if old is None and len(self._named) >= self._limits.max_probes:
                limit = self._limits.max_probes
                detail = f"the session already tracks {limit} named probes; delete one first"
                raise ProblemError("too-many-probes", detail, rule=f"at most {limit} probes")
            with self._limits.quotas.adding_probe(self.rows) if old is None else nullcontext():
                await self._replace_probe(engine, name, position)
            return old is None

    async def _replace_probe(self, engine: Session, name: str, position: Position) -> None:
        async with self._workers.engine_slot():
            handle = await convert_probe_errors(self._workers.run_in_engine_pool(engine.track, position))
        new = NamedProbe(position, handle)
        if self.has_light:
            new.coverage = (await self._workers.run_in_decode_pool(engine.light, handle)).coverage
        async with self._state_lock:
            if name in self._named:
                self._remove(engine, name)
            self._named[name] = new
            self._changed(urgent=True)

    async def untrack(self, name: str) -> None:
        """Stop tracking a named probe.

        Raises:
            ProblemError: There is no probe of this name (404), or the session has ended.
        """
        async with self._engine_lock, self._state_lock:
            engine = self._live_engine()
            self._named_probe(name)
            self._remove(engine, name)
            self._changed(urgent=True)

    def _remove(self, engine: Session, name: str) -> None:
        named = self._named.pop(name)
        engine.untrack(named.handle)
        self._lights.drop(name, named.position)

    async def lights(self, queries: Sequence[ProbeQuery]) -> list[Light]:
        """Return the light at each point after the same frame, with its etag; before the first frame the default light.

        Raises:
            ProblemError: A probe name is unknown, a position is unusable, or the session has ended.
        """
        late = sum(query.name is None for query in queries)
        with self._limits.quotas.late_probes(late):
            return await self._lights_after_same_frame(queries, self._engine_lock if late else self._state_lock)

    async def _lights_after_same_frame(self, queries: Sequence[ProbeQuery], lock: asyncio.Lock) -> list[Light]:
        async with lock:
            engine = self._live_engine()
            if not self.has_light:
                return [self._default_light(query) for query in queries]
            return [await self._light(engine, query) for query in queries]

    async def _light(self, engine: Session, query: ProbeQuery) -> Light:
        name, position = query.name, self._position(query)
        cached = self._lights.get(name, position, self._light_frame)
        if cached is not None:
            return cached
        if name is not None:
            found = await self._workers.run_in_decode_pool(engine.light, self._named[name].handle)
        else:
            async with self._workers.engine_slot():
                found = await convert_probe_errors(self._workers.read_in_engine_pool(engine.light_at, position))
        tracked = found.tracked_lights
        etag = await self._workers.run_in_decode_pool(digest_of_light, found.panorama, found.observed, tracked)
        light = finished_light(found, name=name, frame=self._light_frame, etag=etag)
        self._lights.put(light)
        return light

    def _default_light(self, query: ProbeQuery) -> Light:
        panorama, observed, etag = default_panorama(self.request.height)
        return Light(self._position(query), panorama, observed, 0.0, frame=NO_FRAME, name=query.name, etag=etag)

    def _position(self, query: ProbeQuery) -> Position:
        if query.name is not None:
            return self._named_probe(query.name).position
        assert query.position is not None
        x, y, z = query.position
        return x, y, z

    def _named_probe(self, name: str) -> NamedProbe:
        named = self._named.get(name)
        if named is None:
            raise ProblemError("probe-not-found", f"the session has no probe {name!r}", field="name", value=name)
        return named

    @property
    def probes(self) -> dict[str, Position]:
        """Positions of the named probes."""
        return {name: named.position for name, named in self._named.items()}

    @property
    def has_light(self) -> bool:
        """Whether a frame has been processed."""
        return self._light_frame != NO_FRAME

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call `listener` on the event loop after each frame and at the end; return a function that removes it."""
        self._listeners.add(listener)
        return lambda: self._listeners.discard(listener)

    # --- composites -------------------------------------------------------------------------------------------

    @contextmanager
    def composite_turn(self) -> Generator[LatestFrame]:
        """Yield the last processed frame; only one composite is made at a time.

        Raises:
            ProblemError: A composite is being made (429), there is no frame yet (409), or the session has ended.
        """
        self.check_open()
        with self._composite_turn.held():
            if self._latest is None:
                raise ProblemError("no-frame", "the session has no processed frame yet: push a frame first")
            yield self._latest

    async def decode_latest(self, latest: LatestFrame, box: tuple[int, int]) -> Frame:
        """Decode the frame to fit into a box of (width, height) pixels. Raises ProblemError if that fails."""
        reference = self._reference or latest.message.header.exposure
        least, processes = self.request.min_confidence, self._workers.decode_processes
        try:
            return await self._workers.run_in_decode_pool(
                decode_to_size, latest.message, latest.index, reference, least, processes, box=box
            )
        except WireError as error:
            raise ProblemError.from_wire(error) from error

    async def composite(self, work: Callable[[Session], _R]) -> _R:
        """Run work on the engine on a compositing thread; frames of this session wait, those of others do not.

        Raises:
            ProblemError: The session has ended.
        """
        async with self._workers.composite_slot(), self._engine_lock:
            return await self._workers.run_in_composite_pool(work, self._live_engine())

    # --- what the session has seen ----------------------------------------------------------------------------

    @property
    def latest(self) -> LatestFrame | None:
        """The last processed frame, as it was received."""
        return self._latest

    async def read(self, work: Callable[[Session], _R]) -> _R:
        """Run work that reads the engine on a decoding thread. Raises ProblemError if the session has ended."""
        async with self._state_lock:
            return await self._workers.run_in_decode_pool(work, self._live_engine())

    # --- on disk ----------------------------------------------------------------------------------------------

    @property
    def durable_index(self) -> int | None:
        """Index up to which frames are on disk; None: none are."""
        return None if self.journal is None else self.journal.durable_index

    def _changed(self, *, urgent: bool = False) -> None:
        if self.journal is not None:
            self.journal.changed(urgent=urgent)

    async def copy_state(self, pool: ThreadPoolExecutor) -> LiveState | None:
        """Return the state between two frames, copied on a thread of the pool; None if the session has ended."""
        async with self._engine_lock:
            if self._engine is None:
                return None
            snapshot = await asyncio.get_running_loop().run_in_executor(pool, self._engine.snapshot)
            probes = {name: SavedProbe(**asdict(named)) for name, named in self._named.items()}
            return LiveState(snapshot, self._reference, probes, self._queue.saved(), self._light_frame, self._latest)

    def resume(self, state: LiveState) -> None:
        """Continue from a saved state, with the engine that was made from its snapshot."""
        self._reference, self._light_frame, self._latest = state.reference, state.light_frame, state.latest
        self._named = {name: NamedProbe(**one.model_dump()) for name, one in state.probes.items()}
        self._queue.restore(state.queue)

    # --- state and end ----------------------------------------------------------------------------------------

    def check_open(self) -> None:
        """Check that the session is usable.

        Raises:
            ProblemError: The session has failed or was closed.
        """
        if self._ended is not None:
            raise self._ended

    @property
    def ended(self) -> ProblemError | None:
        """The reason why the session has ended, or None."""
        return self._ended

    def close(self) -> None:
        """End the session: answer all waiting requests and release the engine after its running frame."""
        self._end(ProblemError("session-closed", "the session was deleted or has expired"))

    def _end(self, reason: ProblemError) -> None:
        self._ended = reason
        self._engine = self._latest = None
        self._lights.clear()
        self.history.clear()
        self._queue.end_all(reason)
        self._workers.release_memory()
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
        """Upper bound of the session's memory."""
        keyframes, probes = self._keyframe_capacity, self._limits.max_probes
        return self._footprint.total(keyframes=keyframes, probes=probes, started=True) + (
            MAX_CACHED_LIGHTS * self.light_bytes + self._limits.frame.max_body_bytes + self._limits.history_bytes
        )

    @property
    def frames_in_flight(self) -> int:
        """Frames that are being received, decoded or processed, or whose outcome is being sent."""
        return self._slots.taken + self._queue.counts().queued

    @property
    def probe_count(self) -> int:
        """Number of named probes."""
        return len(self._named)

    @property
    def rows(self) -> int:
        """Rows of the session's panoramas."""
        return self.request.height

    @property
    def light_bytes(self) -> int:
        """Memory of one light."""
        return 16 * 2 * self.request.height**2  # float32 radiance and observed

    def state(self) -> SessionState:
        """Return the current state."""
        engine = self._engine
        volume = volume_of(engine)
        keyframes = 0 if engine is None else engine.keyframes
        held = self._footprint.total(keyframes=keyframes, probes=len(self._named), started=volume is not None)
        kept = held + len(self._lights) * self.light_bytes + (0 if self._latest is None else self._latest.size)
        kept += self.history.size
        return SessionState(
            id=self.name,
            status="open" if self._ended is None else "failed",
            model=cast("Literal['classical', 'completion', 'single', 'video']", self._model),
            options=self.request,
            frames=self._queue.counts(),
            probes={name: list(named.position) for name, named in self._named.items()},
            coverage=self._coverage(),
            keyframes=keyframes,
            memory=Memory(bytes=0 if engine is None else kept, bound_bytes=self.bound_bytes),
            volume=volume,
            idle_expiry_s=self._limits.idle_expiry_s,
        )
