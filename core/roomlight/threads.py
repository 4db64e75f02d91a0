"""Parallel loops of kernels on a thread pool.

Kernels release the GIL and run serially; rows are split here. numba's own threading layer aborts the process when two
threads enter a parallel region at once, as in a server.
"""

import os
import threading
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from itertools import pairwise

_pauses = threading.local()


def thread_count() -> int:
    """Return the threads used for one request: `ROOMLIGHT_THREADS`, or the cores of this process, at most 8."""
    setting = os.environ.get("ROOMLIGHT_THREADS", "")
    if setting.isdecimal() and int(setting) > 0:
        return int(setting)
    return min(8, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_count(), thread_name_prefix="roomlight")


@contextmanager
def pausing(pause: Callable[[], object]) -> Generator[None]:
    """Call `pause` on this thread before each parallel loop inside the context, so that long work can give way.

    An exception of `pause` ends the work.
    """
    before = getattr(_pauses, "pause", None)
    _pauses.pause = pause
    try:
        yield
    finally:
        _pauses.pause = before


def parallel_for(work: Callable[[int, int], object], count: int, *, pieces_per_thread: int = 4) -> None:
    """Call `work(start, stop)` for pieces of range(count) on the pool; return when all have ended.

    More pieces than threads balance rays of unequal length. An exception in a piece is raised here after the other
    pieces have ended, so that none still writes to the caller's buffers.
    """
    pause = getattr(_pauses, "pause", None)
    if pause is not None:
        pause()
    threads = thread_count()
    if threads == 1 or count < 2 * threads:
        work(0, count)
        return
    pieces = min(count, threads * pieces_per_thread)
    bounds = [count * piece // pieces for piece in range(pieces + 1)]
    futures = [_pool().submit(work, start, stop) for start, stop in pairwise(bounds)]
    wait(futures)
    for future in futures:
        future.result()
