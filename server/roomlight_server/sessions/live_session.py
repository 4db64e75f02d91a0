"""One session of the server: an engine session with its frame queue, named probes and light.

All methods run on the event loop; the engine runs on its own threads. A rejected request leaves the session unchanged.
If the engine fails while it processes a frame, its state may be inconsistent: the session then has failed, every later
request is answered with this error, and its memory is released.
"""

import asyncio
import logging
from collections.abc import AsyncGenerator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from contextvars import copy_context
from dataclasses import replace
from functools import partial
from typing import Literal, TypeVar, cast

from roomlight.engine.memory import Footprint
from roomlight.engine.room import MOST_LEFT
from roomlight.engine.session import FrameReport, Session, SessionOptions
from roomlight.engine.state.snapshot import SessionSnapshot
from roomlight.errors import FrameError, ModelError, WireError
from roomlight.frame import Frame
from roomlight.monocular.stream import DEPTH_STREAM_BYTES, DepthStream
from roomlight.wire.compositing import SessionScene
from roomlight.wire.frame_message import FrameMessage
from roomlight.wire.messages import FrameResult, Memory, SessionRequest, SessionState, Volume
from roomlight_server.base.metrics import Metrics
from roomlight_server.base.problems import INTERNAL_DETAIL, ProblemError
from roomlight_server.base.request_context import request_id
from roomlight_server.base.settings import ServerSettings
from roomlight_server.sessions.engine_access import EngineAccess
from roomlight_server.sessions.frame_queue import Entry, FrameQueue, replayed
from roomlight_server.sessions.history import History, NamedLights, lights_for_history
from roomlight_server.sessions.quotas import Quotas
from roomlight_server.sessions.session_lighting import SessionLighting
from roomlight_server.sessions.session_parts import SCENE_BYTES, FrameSlots, cached_lights
from roomlight_server.state.lease import MOVED, SessionLease
from roomlight_server.state.live_state import DepthScale, LiveState, SavedValues
from roomlight_server.work.composite_processes import Composited, CompositeJob
from roomlight_server.work.intake import LatestFrame, decode_to_size, index_of, parse_frame
from roomlight_server.work.workers import Workers

_log = logging.getLogger("roomlight.server")
_R = TypeVar("_R")


class LiveSession(EngineAccess):
    """One session of the server. The registry maintains `last_used_s` and `users`.

    Only this class and its `SessionLighting` take the locks of `EngineAccess`.
    """

    def __init__(
        self,
        name: str,
        request: SessionRequest,
        *,
        engine: Session,
        workers: Workers,
        footprint: Footprint,
        settings: ServerSettings,
        quotas: Quotas,
        metrics: Metrics,
    ) -> None:
        super().__init__(engine)
        self.name, self.request = name, request
        self.last_used_s = 0.0
        self.users = 0
        self._model = engine.model
        self._keyframe_capacity = engine.options.keyframes
        self._workers, self._footprint, self._settings, self._metrics = workers, footprint, settings, metrics
        probes = settings.max_probes
        self.lighting = SessionLighting(self, workers, quotas, max_probes=probes, height=request.height)
        # Frames enter the queue in the order of arrival, although parsing and decoding run on threads. This lock is
        # never held together with those of `EngineAccess`.
        self._ingest_lock = asyncio.Lock()
        self.slots = FrameSlots(settings.frames_in_flight, self.check_open)
        self.lease: SessionLease | None = None
        self._queue = FrameQueue(lambda status: metrics.frames.labels(status).inc(), lambda: self.durable_index)
        self._runner: asyncio.Task[None] | None = None
        self._reference = request.reference_exposure
        self.latest: LatestFrame | None = None  # the last processed frame, without an unusable depth
        self._depth: DepthStream | None = None
        self._depth_scale: DepthScale | None = None  # of the stream before a restart
        self.history = History(settings.history_bytes, workers)
        self._composite_lock = asyncio.Lock()
        self._composites_due = 0
        self.scene = SessionScene()
        self._listeners: set[Callable[[], None]] = set()

    # --- frames -----------------------------------------------------------------------------------------------

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
        if self._queue.waiting is not None and self._runner is None:
            self._runner = asyncio.create_task(self._run())
        return entry

    async def _accept_in_order(self, body: bytes, index: int | None) -> Entry:
        last, alone = self._queue.last_index, self._queue.waiting is None
        usable = {"normal"} | ({"limited"} if self.request.use_limited_tracking else set[str]())

        def receive() -> tuple[FrameMessage, bytes, int, Frame | None]:  # one job: each costs two hand-overs
            message, digest = parse_frame(body, self._settings.frame_limits)
            stated = index_of(message, index)
            wanted = alone and message.header.tracking_state in usable and (last is None or stated > last)
            return message, digest, stated, self._decode(message, stated) if wanted else None

        message, digest, index, frame = await self._workers.run_in_decode_pool(receive)
        self.check_open()
        if self.lease is not None:
            await self.lease.check_frame(index, self._queue.last_index)
        repeated = self._queue.replay_of(index, digest)
        if repeated is not None:
            return Entry(index, digest, outcome=replayed(repeated.outcome))
        entry = Entry(index, digest)
        if message.header.tracking_state in usable:
            entry.message, entry.frame = message, frame
            if frame is not None:
                self._take_reference(message)
            elif self._queue.waiting is None:  # the engine has taken the frame that waited
                entry.frame = await self._decoded(message, index)
        self.check_open()
        self._queue.accept(entry)
        self.changed()
        return entry

    async def _decoded(self, message: FrameMessage, index: int) -> Frame:
        frame = await self._workers.run_in_decode_pool(self._decode, message, index)
        self._take_reference(message)
        return frame

    def _decode(self, message: FrameMessage, index: int) -> Frame:
        least, processes = self.request.min_confidence, self._workers.decode_processes
        with self._metrics.decode_seconds.time():
            return decode_to_size(message, index, self._reference_for(message), least, processes)

    def _reference_for(self, message: FrameMessage) -> float:
        return self._reference or message.header.exposure

    def _take_reference(self, message: FrameMessage) -> None:
        """Keep the exposure of the first frame that was decoded as the session's, unless it was given."""
        self._reference = self._reference_for(message)

    async def _run(self) -> None:
        """Process waiting frames until the queue is empty; each is taken when an engine thread is free."""
        try:
            while self._queue.waiting is not None:
                decode_ahead = partial(copy_context().run, self._decode_ahead)  # on account of this session's owner
                slot = self._workers.engine_slot(on_next=decode_ahead)
                async with self.engine_lock, slot, self.state_lock:
                    entry = self._queue.take()
                    if entry is not None:
                        await self._push(entry)
                for listener in tuple(self._listeners):
                    listener()
        finally:
            self._runner = None
            if self.ended is not None:
                self._workers.release_memory()  # of the frame that was being processed

    def _decode_ahead(self) -> None:
        """Decode the waiting frame while the engine works for another session, which is before this one."""
        entry = self._queue.waiting
        if entry is not None and entry.message is not None and entry.frame is None and entry.decoding is None:
            entry.decode(self._decoded(entry.message, entry.index))

    async def _push(self, entry: Entry) -> None:
        request_id.set(entry.request_id)  # the task was started by an earlier frame
        engine, frame = self.engine, entry.frame
        if engine is None:
            return  # the session has ended, and the entry has its outcome
        try:
            if frame is None:
                frame = await self._decoded_late(entry)
            estimated = not frame.depth_m.any()
            if estimated:
                self._check_estimable(entry)
                frame = await self._workers.run_in_engine_pool(self._with_depth, frame)
            shown = self.history.next_handles(self.lighting.handles)
            report, lights = await self._workers.run_in_engine_pool(_pushed, engine, frame, shown)
            result = self._result(engine, entry.index, report, depth_estimated=estimated)
            if self.lease is not None:
                await self.lease.check()  # only the owner answers
        except ProblemError as error:
            self._reject(entry, error)
            if error.kind == MOVED:
                self.end(error)
        except (FrameError, ModelError) as error:
            rule = str(error)
            self._reject(entry, ProblemError("bad-frame", rule, field="frame", value=entry.index, rule=rule))
        except Exception as error:  # out of memory, ONNX Runtime: the state may contain half of the frame
            _log.exception("engine failed", extra={"session": self.name, "frame": entry.index})
            self._metrics.frames.labels("failed").inc()
            advice = "delete the session and open a new one"
            entry.fail(ProblemError("engine-failed", f"frame {entry.index}: {type(error).__name__}; {advice}"))
            self.end(ProblemError("session-failed", f"the engine failed on frame {entry.index}; {advice}"))
        else:
            if entry.message is None:  # the session has ended meanwhile, and with it the frame
                return
            message = entry.message.without_depth() if estimated else entry.message
            self.lighting.frame = entry.index
            self.latest = LatestFrame(entry.index, message, frame.depth_m if estimated else None)
            if self.journal is not None:
                kept = self._keyframe_capacity
                self.journal.processed(entry.index, message, keyframe=report.keyframe, most=kept)
            self._metrics.observe_frame(report)
            self.history.add(frame, report, self._queue.counts(), lights)
            self._queue.processed(entry, result)

    def _check_estimable(self, entry: Entry) -> None:
        """Refuse a frame whose depth map is unusable after a measured one: its estimate would have another scale."""
        measured = self.latest is not None and self.latest.depth_m is None
        if measured and entry.message is not None and entry.message.header.depth is not None:
            rule = "no pixel of its depth is usable, and estimated depth would not fit the depth of the frames before"
            raise FrameError(f"frame {entry.index}: {rule}")

    def _with_depth(self, frame: Frame) -> Frame:
        """Estimate the depth of the session's next frame. Raises FrameError and ModelError."""
        if self._depth is None:
            self._depth = self._workers.new_depth_stream()
            if self._depth_scale is not None:
                self._depth_scale.give(self._depth)
        return self._depth.complete(frame)

    async def _decoded_late(self, entry: Entry) -> Frame:
        """Decode a frame that replaced a waiting one. ProblemError if that fails: the engine is unchanged then."""
        assert entry.message is not None
        try:
            return await (entry.decoding or self._decoded(entry.message, entry.index))
        except WireError as error:
            raise ProblemError.from_wire(error) from error
        except Exception as error:
            _log.exception("unexpected error of a decoder", extra={"session": self.name, "frame": entry.index})
            raise ProblemError("internal", INTERNAL_DETAIL) from error

    def _reject(self, entry: Entry, problem: ProblemError) -> None:
        self._metrics.refused.labels(problem.kind).inc()
        self._queue.reject(entry, problem)

    def _result(self, engine: Session, index: int, report: FrameReport, *, depth_estimated: bool) -> FrameResult:
        self.lighting.take_coverage(engine, report)
        return FrameResult(
            index=index,
            status="processed",
            keyframe=report.keyframe,
            depth_estimated=depth_estimated,
            stage_ms={stage: round(ms, 2) for stage, ms in report.stage_ms.items()},
            coverage=self.lighting.coverage,
            gain=list(report.gain),
            durable_index=self.durable_index,
            epoch=None if self.lease is None else self.lease.epoch,
        )

    # --- composites, reading ----------------------------------------------------------------------------------

    def keep_scene(self, scene: SessionScene) -> None:
        """Replace the title and the placed objects. Raises ProblemError if the session has ended."""
        self.check_open()
        self.scene = scene
        self.changed(urgent=True)

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call `listener` on the event loop after each frame and at the end; return a function that removes it."""
        self._listeners.add(listener)
        return lambda: self._listeners.discard(listener)

    @asynccontextmanager
    async def composite_turn(self) -> AsyncGenerator[LatestFrame]:
        """Yield the last processed frame; only one composite is made at a time, and one more waits for its turn.

        Raises:
            ProblemError: Another one waits (429), there is no frame yet (409), or the session has ended.
        """
        self.check_open()
        if self._composites_due > 1:
            rule = "one composite a session at a time, and one that waits"
            raise ProblemError("composite-running", f"{rule}; retry later", rule=rule, retry_after_s=1)
        self._composites_due += 1
        try:
            async with self._composite_lock:
                self.check_open()
                if self.latest is None:
                    raise ProblemError("no-frame", "the session has no processed frame yet: push a frame first")
                yield self.latest
        finally:
            self._composites_due -= 1

    async def decode_latest(self, latest: LatestFrame, box: tuple[int, int]) -> Frame:
        """Decode the frame to fit into a box of (width, height) pixels. Raises ProblemError if that fails."""
        reference = self._reference_for(latest.message)
        least, processes = self.request.min_confidence, self._workers.decode_processes
        try:
            frame = await self._workers.run_in_decode_pool(
                decode_to_size, latest.message, latest.index, reference, least, processes, box=box
            )
        except WireError as error:
            raise ProblemError.from_wire(error) from error
        return frame if latest.depth_m is None else replace(frame, depth_m=latest.depth_m, depth_estimated=True)

    async def preview(self, work: Callable[[Session], _R]) -> _R:
        """Run work on the engine on a compositing thread; frames of this session wait for it.

        Raises:
            ProblemError: The session has ended.
        """
        workers = self._workers
        async with workers.preview_slot(), self.engine_lock:
            return await workers.run_preview(work, self.live())

    async def composite(self, job_of: Callable[[SessionSnapshot, SessionOptions], CompositeJob]) -> Composited:
        """Make a composite in a process, from a copy of the engine: no frame waits for it.

        Raises:
            ProblemError: The session has ended.
            Exception: As `CompositeProcesses.composite`.
        """
        async with self._workers.composite_slot():
            async with self.engine_lock:
                engine = self.live()
                snapshot = await self._workers.run_in_decode_pool(engine.snapshot)
            return await self._workers.run_composite(job_of(snapshot, engine.options))

    def exposure_of(self, frame: LatestFrame) -> float:
        """Return the exposure of a frame, of which 1 is the reference exposure of the session."""
        return frame.message.header.exposure / self._reference_for(frame.message)

    async def read(self, work: Callable[[Session], _R]) -> _R:
        """Run work that reads the engine on a decoding thread. Raises ProblemError if the session has ended."""
        async with self.state_lock:
            return await self._workers.run_in_decode_pool(work, self.live())

    # --- on disk ----------------------------------------------------------------------------------------------

    @property
    def durable_index(self) -> int | None:
        """Index up to which frames are on disk; None: none are."""
        return None if self.journal is None else self.journal.durable_index

    async def copy_state(self, pool: ThreadPoolExecutor, owner: str) -> LiveState | None:
        """Return the state between two frames, copied on a thread of the pool; None if the session has ended.

        Args:
            owner: As in `SavedValues`.
        """
        async with self.engine_lock:
            if self.engine is None:
                return None
            snapshot = await asyncio.get_running_loop().run_in_executor(pool, self.engine.snapshot)
            if self._depth is not None:
                self._depth_scale = DepthScale.of(self._depth)
            values = SavedValues(
                owner=owner,
                name=self.name,
                request=self.request,
                reference=self._reference,
                probes=self.lighting.saved(),
                queue=self._queue.saved(),
                light_frame=self.lighting.frame,
                bases={},
                latest=None,
                scene=self.scene,
                depth_scale=self._depth_scale,
            )
            return LiveState(snapshot, values, self.latest)

    def resume(self, state: LiveState) -> None:
        """Continue from a saved state, with the engine that was made from its snapshot."""
        values = state.values
        self._reference, self.latest, self.scene = values.reference, state.latest, values.scene
        self._depth_scale = values.depth_scale
        self.lighting.restore(values.probes, values.light_frame)
        self._queue.restore(values.queue)

    # --- state and end ----------------------------------------------------------------------------------------

    def close(self, reason: ProblemError | None = None) -> None:
        """End the session: answer all waiting requests and release the engine after its running frame."""
        self.end(reason or ProblemError("session-closed", "the session was deleted, or the server stops"))

    def end(self, reason: ProblemError) -> None:
        """Answer all waiting requests with this reason, and release the engine after its running frame."""
        super().end(reason)
        self.latest = None
        self.lighting.clear()
        self.history.clear()
        self._queue.end_all(reason)
        self._workers.release_memory()
        for listener in tuple(self._listeners):
            listener()

    @property
    def bound_bytes(self) -> int:
        """Upper bound of the session's memory."""
        settings = self._settings
        engine = self._footprint.total(
            keyframes=self._keyframe_capacity, probes=settings.max_probes, started=True, left=MOST_LEFT
        )
        size = self.lighting.light_bytes
        lights = cached_lights(size) * size
        kept = SCENE_BYTES + DEPTH_STREAM_BYTES
        return engine + lights + settings.max_body_bytes + settings.history_bytes + kept

    @property
    def frames_in_flight(self) -> int:
        """Frames that are being received, decoded or processed, or whose outcome is being sent."""
        return self.slots.taken + self._queue.counts().queued

    @property
    def probe_count(self) -> int:
        """Number of named probes."""
        return len(self.lighting.positions)

    def state(self) -> SessionState:
        """Return the current state."""
        engine, volume = self.engine, None
        grid = None if engine is None else engine.grid
        if grid is not None:
            volume = Volume(shape=list(grid.shape), voxel_m=grid.edge_m, depth_max_m=grid.depth_max_m)
        keyframes = 0 if engine is None else engine.keyframes
        left = 0 if engine is None else engine.rooms_left
        engine_bytes = self._footprint.total(
            keyframes=keyframes, probes=self.probe_count, started=grid is not None, left=left
        )
        kept = engine_bytes + self.lighting.cached_bytes + (0 if self.latest is None else self.latest.size)
        kept += self.history.size
        return SessionState(
            id=self.name,
            status="open" if self.ended is None else "failed",
            model=cast("Literal['classical', 'single', 'video']", self._model),
            options=self.request,
            frames=self._queue.counts(),
            probes={name: list(position) for name, position in self.lighting.positions.items()},
            coverage=self.lighting.coverage,
            keyframes=keyframes,
            memory=Memory(bytes=0 if engine is None else kept, bound_bytes=self.bound_bytes),
            volume=volume,
            idle_expiry_s=self._settings.session_expiry_s,
        )


def _pushed(engine: Session, frame: Frame, handles: dict[str, int] | None) -> tuple[FrameReport, NamedLights]:
    """Push a frame; return the report, and lights for the history (None: it records no such frame)."""
    return engine.push(frame), lights_for_history(engine, handles)
