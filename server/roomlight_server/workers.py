"""Threads of a server: few for the engine, a few for decoding and encoding; the event loop only waits for them.

The engine's turns are given out on the loop, first come first served among sessions, and only when a thread is free: so
a session's newest frame is taken at the last moment.
"""

import asyncio
from collections.abc import AsyncGenerator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from typing import ParamSpec, TypeVar

from roomlight.engine.graphs import LightingGraphs
from roomlight.engine.memory import give_back
from roomlight.engine.session import ModelName, SessionOptions, choose_graphs, warm_up
from roomlight_server.settings import ServerSettings

_P = ParamSpec("_P")
_R = TypeVar("_R")


class Workers:
    """The thread pools, and the graphs that sessions share."""

    def __init__(self, settings: ServerSettings) -> None:
        """Threads start when they are first needed."""
        self._engine = ThreadPoolExecutor(settings.engine_threads, thread_name_prefix="engine")
        self._decode = ThreadPoolExecutor(settings.decode_threads, thread_name_prefix="decode")
        self._turns = asyncio.Semaphore(settings.engine_threads)
        self._base = SessionOptions(
            model=settings.model,
            weights=settings.weights,
            provider=settings.provider,
            allow_untrained=settings.allow_untrained,
            keyframes=settings.keyframes,
        )
        self._graphs: dict[ModelName, LightingGraphs | None] = {}
        self._loading = asyncio.Lock()

    def load(self) -> None:
        """Load what `auto` means, here and now. Raises ModelError."""
        self._graphs[self._base.model] = choose_graphs(self._base)

    async def start(self) -> None:
        """Load what `auto` means, if that is still to be done, and run it once, which compiles the kernels.

        Raises ModelError.
        """
        graphs = await self.graphs_of(self._base.model)
        await asyncio.get_running_loop().run_in_executor(self._engine, warm_up, graphs)

    def stop(self) -> None:
        """Finish what is being worked on; drop what has not begun."""
        self._engine.shutdown(wait=True, cancel_futures=True)
        self._decode.shutdown(wait=True, cancel_futures=True)

    @property
    def base_options(self) -> SessionOptions:
        """What every session's options begin with."""
        return self._base

    async def graphs_of(self, mode: ModelName) -> LightingGraphs | None:
        """The loaded graphs of a mode, None for classical; loaded once. Raises ModelError."""
        mode = self._base.model if mode == "auto" else mode
        async with self._loading:
            if mode not in self._graphs:
                options = replace(self._base, model=mode)
                loop = asyncio.get_running_loop()
                self._graphs[mode] = await loop.run_in_executor(self._decode, choose_graphs, options)
        return self._graphs[mode]

    def tidy_up(self) -> None:
        """A session has gone: give its memory back, aside, once what it was working on is done."""
        with suppress(RuntimeError):  # the pools have been shut down
            self._engine.submit(give_back)

    @asynccontextmanager
    async def engine_turn(self) -> AsyncGenerator[None]:
        """Wait for an engine thread; within, `on_engine` starts at once."""
        async with self._turns:
            yield

    async def on_engine(self, work: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Run on an engine thread, inside a turn."""
        return await _finished(self._engine, lambda: work(*args, **kwargs))

    async def aside(self, work: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Run on a decoding thread."""
        return await _finished(self._decode, lambda: work(*args, **kwargs))


async def _finished(pool: ThreadPoolExecutor, work: Callable[[], _R]) -> _R:
    """The result. A caller that is cancelled still waits for the thread: nobody else may touch its session before."""
    future = asyncio.get_running_loop().run_in_executor(pool, work)
    try:
        return await asyncio.shield(future)
    except asyncio.CancelledError:
        await asyncio.wait([future])
        raise
