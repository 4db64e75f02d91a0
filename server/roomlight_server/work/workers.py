"""Thread pools of a server: for the engine, composites, decoding, objects, encoding. The event loop awaits them.

The threads of each pool are shared by time between owners and sessions (`fair_share`). A session waits for an engine
thread before it chooses its frame, so that it chooses the newest one as late as possible.
"""

import asyncio
import threading
import time
from collections.abc import AsyncGenerator, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from contextvars import ContextVar, copy_context
from dataclasses import replace
from functools import partial
from typing import Final, ParamSpec, TypeVar

from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.engine.memory import release_free_memory
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.networks.graphs import LightingGraphs, part_folder
from roomlight.engine.options import ModelName
from roomlight.engine.session import SessionOptions, warm_up
from roomlight.monocular.stream import DepthStream, open_depth_stream
from roomlight.threads import pausing
from roomlight_server.base.metrics import Metrics
from roomlight_server.base.settings import ServerSettings
from roomlight_server.work.composite_processes import Composited, CompositeJob, CompositeProcesses
from roomlight_server.work.decode_processes import DecodeProcesses
from roomlight_server.work.fair_share import MAX_PAUSED, FairShare, Turn
from roomlight_server.work.processes import Cancellation

_P = ParamSpec("_P")
_R = TypeVar("_R")
_turn: ContextVar[Turn] = ContextVar("turn")
"""The job in a slot of the engine or of previews; a task holds one of them at a time."""
KEEP_S: Final = 8.0
"""Time for which the process of composites is kept when it is not used: it takes 3 s to start, and 0.4 GB."""
STOP_S: Final = 1.0
"""Time for running work to end when the server stops."""


class Workers:
    """The thread pools, and the network graphs that sessions share."""

    def __init__(self, settings: ServerSettings, metrics: Metrics) -> None:
        """Create the pools; threads start when they are first used."""
        self._threads: list[threading.Thread] = []
        self._stopped = False

        def pool(name: str, threads: int) -> ThreadPoolExecutor:
            note = self._threads.append
            return ThreadPoolExecutor(
                threads, thread_name_prefix=name, initializer=lambda: note(threading.current_thread())
            )

        self._engine = pool("engine", settings.engine_threads + MAX_PAUSED)  # a paused job keeps its thread
        self._decode = pool("decode", settings.decode_threads)
        self._object = pool("object", settings.decode_threads)
        self._encode = pool("encode", settings.encode_threads)
        self._composite = pool("composite", 2 * settings.composite_threads)

        def share(pool: str, slots: int, slots_per_owner: int | None = None) -> FairShare:
            waited = metrics.queue_seconds.labels(pool).observe
            made = FairShare(slots, slots_per_owner=slots_per_owner, waited=waited)
            metrics.queued.labels(pool).set_function(lambda: made.waiting)
            return made

        # one thread is left for other owners: a job of these pools is not paused, and may take seconds
        several = settings.several_owners
        self._engine_share = share("engine", settings.engine_threads)
        self._decode_share = share("decode", settings.decode_threads, _all_but_last(settings.decode_threads, several))
        self._object_share = share("object", settings.decode_threads, max(1, settings.decode_threads - 1))
        self._encode_share = share("encode", settings.encode_threads, _all_but_last(settings.encode_threads, several))
        self._preview_share = share("preview", settings.composite_threads)
        self._composite_share = share("composite", settings.composite_threads)
        self.composite_processes = CompositeProcesses()
        self.decode_processes = DecodeProcesses(settings)
        self._decode_threads, self._composite_timeout_s = settings.decode_threads, settings.composite_timeout_s
        self._base = settings.session_options
        self._depth_model = settings.depth_model
        self._graphs: dict[ModelName, LightingGraphs | None] = {}
        self._loading_lock = asyncio.Lock()

    def load(self, graphs: "Future[LightingGraphs | None] | None" = None) -> None:
        """Load the graphs of the default model and a depth model of one's own, blocking; start the decoding processes.

        Args:
            graphs: Those of the settings, if another thread loads them already.

        Raises:
            ModelError: The weights, the parts or the depth model cannot be loaded.
        """
        part_folder(self._base.parts, "clipping")
        if self._depth_model is not None:
            self.new_depth_stream()
        self._graphs[self._base.model] = choose_graphs(self._base) if graphs is None else graphs.result()
        self.decode_processes.start(self._decode_threads)

    def new_depth_stream(self) -> DepthStream:
        """Return estimated depth for the frames of a session. Raises ModelError."""
        return open_depth_stream(self._depth_model)

    async def start(self) -> None:
        """Load the graphs of the default model if necessary and run them once, which compiles the kernels.

        Raises:
            ModelError: The weights cannot be loaded.
        """
        graphs = await self.graphs_of(self._base.model)
        await asyncio.get_running_loop().run_in_executor(self._engine, warm_up, graphs)

    def stop(self) -> None:
        """Drop work that has not started, and wait up to `STOP_S` for the rest; images being decoded are dropped."""
        self._stopped = True
        self.decode_processes.stop()
        self.composite_processes.stop()
        deadline_s = time.monotonic() + STOP_S
        for pool in (self._engine, self._composite, self._decode, self._object, self._encode):
            pool.shutdown(wait=False, cancel_futures=True)
        for thread in self._threads:
            thread.join(max(0.0, deadline_s - time.monotonic()))

    def release_paused(self) -> None:
        """Let paused work of the engine continue, so that it ends before the server stops."""
        self._engine_share.close()

    @property
    def base_options(self) -> SessionOptions:
        """Options of the server on which the options of each session are based."""
        return self._base

    async def graphs_of(self, model: ModelName) -> LightingGraphs | None:
        """Return the graphs of a model, loaded once; None for the classical model.

        Raises:
            ModelError: The weights cannot be loaded.
        """
        model = self._base.model if model == "auto" else model
        async with self._loading_lock:
            if model not in self._graphs:
                options = replace(self._base, model=model)
                loop = asyncio.get_running_loop()
                self._graphs[model] = await loop.run_in_executor(self._decode, choose_graphs, options)
        return self._graphs[model]

    def release_memory(self) -> None:
        """Return the memory of an ended session to the system, on an engine thread after its running work."""
        with suppress(RuntimeError):  # the pools are shut down
            self._engine.submit(release_free_memory)

    def engine_slot(
        self, order: int = 0, on_next: Callable[[], object] = lambda: None
    ) -> AbstractAsyncContextManager[None]:
        """Wait for a free engine thread; inside the context, `run_in_engine_pool` starts immediately.

        Args:
            order: Lower ones come first, and interrupt others.
            on_next: As in `FairShare.slot`.
        """
        return _held(self._engine_share.slot(order, on_next))

    async def run_in_engine_pool(self, work: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Run on an engine thread; requires an `engine_slot`. Long work is paused for other sessions."""
        return await self._run_to_end(self._engine, partial(_run_paused, _turn.get().pause, work, *args, **kwargs))

    async def read_in_engine_pool(self, work: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Run work that changes nothing, as `run_in_engine_pool`; a cancelled caller ends it at its next pause."""
        turn = _turn.get()
        run = partial(_run_paused, turn.pause, work, *args, **kwargs)
        return await self._run_to_end(self._engine, run, cancelled=turn.abandon)

    def preview_slot(self) -> AbstractAsyncContextManager[None]:
        """Wait for a free thread for previews; inside the context, `run_preview` starts immediately."""
        return _held(self._preview_share.slot())

    async def run_preview(self, work: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Run on a compositing thread; requires a `preview_slot`. If the caller is cancelled, it ends soon."""
        turn = _turn.get()
        run = partial(_run_paused, turn.check, work, *args, **kwargs)
        return await self._run_to_end(self._composite, run, cancelled=turn.abandon)

    def composite_slot(self) -> AbstractAsyncContextManager[Turn]:
        """Wait until a process may make a composite, with `run_composite`."""
        return self._composite_share.slot()

    async def run_composite(self, job: CompositeJob) -> Composited:
        """Make a composite in a process; requires a `composite_slot`. If the caller is cancelled, it is killed.

        Raises: as `CompositeProcesses.composite`.
        """
        processes, cancel = self.composite_processes, Cancellation()
        run = partial(processes.composite, job, self._composite_timeout_s, cancel)
        try:
            return await self._run_to_end(self._composite, run, cancelled=cancel)
        finally:
            asyncio.get_running_loop().call_later(KEEP_S, processes.close_unused, 0.9 * KEEP_S)

    async def run_in_decode_pool(self, work: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Wait for a decoding thread and run on it."""
        async with self._decode_share.slot():
            return await self._run_to_end(self._decode, lambda: work(*args, **kwargs))

    async def decode_object(self, body: bytes, kind: str | None) -> VirtualObject:
        """Wait for a process and decode the file of an object. If the caller is cancelled, the process is killed.

        Raises: as `DecodeProcesses.decode_object`.
        """
        cancel = Cancellation()
        run = partial(self.decode_processes.decode_object, body, kind, cancel)
        async with self._object_share.slot():
            return await self._run_to_end(self._object, run, cancelled=cancel)

    async def run_in_encode_pool(self, work: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Wait for an encoding thread and run on it."""
        async with self._encode_share.slot():
            return await self._run_to_end(self._encode, lambda: work(*args, **kwargs))

    async def _run_to_end(
        self, pool: ThreadPoolExecutor, work: Callable[[], _R], cancelled: Callable[[], object] | None = None
    ) -> _R:
        """Return the result. A cancelled caller still waits for the thread, because the work uses its session.

        `cancelled` is called when the caller is cancelled. When the server has stopped, nobody waits.
        """
        future = asyncio.get_running_loop().run_in_executor(pool, copy_context().run, work)
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            if cancelled is not None:
                cancelled()
            while not future.done() and not self._stopped:
                with suppress(asyncio.CancelledError):  # cancelled again
                    await asyncio.wait([future])
            if future.done():
                with suppress(asyncio.CancelledError):
                    future.exception()  # marks it as retrieved
            raise


@asynccontextmanager
async def _held(slot: AbstractAsyncContextManager[Turn]) -> AsyncGenerator[None]:
    async with slot as turn:
        token = _turn.set(turn)
        try:
            yield
        finally:
            _turn.reset(token)


def _run_paused(pause: Callable[[], object], work: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
    with pausing(pause):
        return work(*args, **kwargs)


def _all_but_last(threads: int, several_owners: bool) -> int | None:
    return max(1, threads - 1) if several_owners else None
