"""Thread pools of a server: for the engine, for composites, for decoding and encoding. The event loop awaits them.

The event loop assigns engine threads to sessions in the order of their requests, and only when a thread is free: a
session then chooses its newest frame as late as possible.
"""

import asyncio
from collections.abc import AsyncGenerator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from typing import ParamSpec, TypeVar

from roomlight.engine.graphs import LightingGraphs
from roomlight.engine.memory import release_free_memory
from roomlight.engine.session import ModelName, SessionOptions, choose_graphs, warm_up
from roomlight_server.decode_processes import DecodeProcesses
from roomlight_server.settings import ServerSettings

_P = ParamSpec("_P")
_R = TypeVar("_R")


class Workers:
    """The thread pools, and the network graphs that sessions share."""

    def __init__(self, settings: ServerSettings) -> None:
        """Create the pools; threads start when they are first used."""
        self._engine = ThreadPoolExecutor(settings.engine_threads, thread_name_prefix="engine")
        self._decode = ThreadPoolExecutor(settings.decode_threads, thread_name_prefix="decode")
        self.decode_processes = DecodeProcesses(
            settings.decode_timeout_s, settings.object_timeout_s, settings.object_limits
        )
        self._decode_threads = settings.decode_threads
        self._composite = ThreadPoolExecutor(settings.composite_threads, thread_name_prefix="composite")
        self._composite_slots = asyncio.Semaphore(settings.composite_threads)
        self._engine_slots = asyncio.Semaphore(settings.engine_threads)
        self._base = SessionOptions(
            model=settings.model,
            weights=settings.weights,
            provider=settings.provider,
            allow_untrained=settings.allow_untrained,
            keyframes=settings.keyframes,
        )
        self._graphs: dict[ModelName, LightingGraphs | None] = {}
        self._loading_lock = asyncio.Lock()

    def load(self) -> None:
        """Load the graphs of the default model, blocking, and start the decoding processes.

        Raises:
            ModelError: The weights cannot be loaded.
        """
        self._graphs[self._base.model] = choose_graphs(self._base)
        self.decode_processes.start(self._decode_threads)

    async def start(self) -> None:
        """Load the graphs of the default model if necessary and run them once, which compiles the kernels.

        Raises:
            ModelError: The weights cannot be loaded.
        """
        graphs = await self.graphs_of(self._base.model)
        await asyncio.get_running_loop().run_in_executor(self._engine, warm_up, graphs)

    def stop(self) -> None:
        """Finish running work and drop work that has not started; images that are being decoded are dropped too."""
        self.decode_processes.stop()
        self._engine.shutdown(wait=True, cancel_futures=True)
        self._composite.shutdown(wait=True, cancel_futures=True)
        self._decode.shutdown(wait=True, cancel_futures=True)

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

    @asynccontextmanager
    async def engine_slot(self) -> AsyncGenerator[None]:
        """Wait for a free engine thread; inside the context, `run_in_engine_pool` starts immediately."""
        async with self._engine_slots:
            yield

    async def run_in_engine_pool(self, work: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Run on an engine thread; requires an `engine_slot`."""
        return await _run_to_end(self._engine, lambda: work(*args, **kwargs))

    @asynccontextmanager
    async def composite_slot(self) -> AsyncGenerator[None]:
        """Wait for a free compositing thread; inside the context, `run_in_composite_pool` starts immediately."""
        async with self._composite_slots:
            yield

    async def run_in_composite_pool(self, work: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Run on a compositing thread; requires a `composite_slot`."""
        return await _run_to_end(self._composite, lambda: work(*args, **kwargs))

    async def run_in_decode_pool(self, work: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Run on a decoding thread."""
        return await _run_to_end(self._decode, lambda: work(*args, **kwargs))


async def _run_to_end(pool: ThreadPoolExecutor, work: Callable[[], _R]) -> _R:
    """Return the result. A cancelled caller still waits for the thread, because the work uses its session."""
    future = asyncio.get_running_loop().run_in_executor(pool, work)
    try:
        return await asyncio.shield(future)
    except asyncio.CancelledError:
        await asyncio.wait([future])
        raise
