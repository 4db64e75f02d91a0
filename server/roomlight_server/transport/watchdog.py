"""How late the event loop is: a gauge, and a line in the log that names what makes it late."""

import asyncio
import gc
import logging
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import Any, Final

from roomlight_server.base.metrics import Metrics
from roomlight_server.transport.guard import ConnectionGuard

_log = logging.getLogger("roomlight.server")
BEAT_S: Final = 0.1
WINDOW_S: Final = 10.0
"""The gauge is the largest lateness of this time."""
LATE_S: Final = 0.5
"""Lateness that is logged."""


class Watchdog:
    """Measures the event loop on the loop itself, and observes it from a thread while it is stuck."""

    def __init__(self, metrics: Metrics, guard: ConnectionGuard, is_ready: Callable[[], bool]) -> None:
        """Create a watchdog; `run` starts it. Until the server is ready, all lateness is that of its startup."""
        self._gauge, self._guard, self._is_ready = metrics.loop_lag, guard, is_ready
        self._beat_s = time.monotonic()
        self._ended = threading.Event()

    async def run(self) -> None:
        """Measure until cancelled."""
        self._beat_s = time.monotonic()
        loop, thread_id = asyncio.get_running_loop(), threading.get_ident()
        threading.Thread(target=self._watch, args=(loop, thread_id), name="watchdog", daemon=True).start()
        recent: list[tuple[float, float]] = []  # time, lateness
        try:
            while True:
                await asyncio.sleep(BEAT_S)
                now_s = time.monotonic()
                recent = [(at_s, lag_s) for at_s, lag_s in recent if at_s > now_s - WINDOW_S]
                recent.append((now_s, max(0.0, now_s - self._beat_s - BEAT_S)))
                self._gauge.set(max(lag_s for _, lag_s in recent))
                self._beat_s = now_s
        finally:
            self._ended.set()

    def _watch(self, loop: asyncio.AbstractEventLoop, thread_id: int) -> None:
        """Log once for each time that the loop is stuck."""
        logged_s = 0.0
        while not self._ended.wait(BEAT_S):
            beat_s = self._beat_s
            late_s = time.monotonic() - beat_s - BEAT_S
            if late_s > LATE_S and beat_s != logged_s:
                logged_s = beat_s
                fields = self._cause(loop, thread_id) if self._is_ready() else {"place": "startup"}
                _log.warning("the event loop is late", extra={"late_s": round(late_s, 2), **fields})

    def _cause(self, loop: asyncio.AbstractEventLoop, thread_id: int) -> dict[str, str]:
        """Return where the loop is, and for which client if it works for one."""
        task: asyncio.Task[Any] | None = asyncio.current_task(loop)
        connection = self._guard.parsing or (task.get_name() if task else "")
        place = _place(frame_of(thread_id))
        is_client = bool(connection) and not connection.startswith("Task-")
        return {"place": place} | ({"connection": connection} if is_client else {})


def frame_of(thread_id: int) -> FrameType | None:
    """Return the innermost frame of a thread; None if it has ended.

    Until Python 3.12, garbage collection in the call, which holds the lock of the list of threads, can run code that
    waits for that lock or lets another thread run that does: all threads would wait forever (python/cpython#106883).
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        # faulthandler prints stacks but does not return them
        return sys._current_frames().get(thread_id)  # pyright: ignore[reportPrivateUsage]
    finally:
        if was_enabled:
            gc.enable()


def _place(frame: FrameType | None) -> str:
    """Return the innermost function of the project in a stack."""
    while frame is not None:
        module = str(frame.f_globals.get("__name__", ""))
        if module.startswith("roomlight"):
            return f"{module}.{frame.f_code.co_qualname}:{frame.f_lineno}"
        frame = frame.f_back
    return "outside the project"
