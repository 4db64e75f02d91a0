"""Sharding of kernels over a thread pool of our own.

Kernels release the GIL and run serially; rows are split here. numba's own threading layer aborts the process
when two threads enter a parallel region at once, which a server does all day.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from itertools import pairwise


def thread_count() -> int:
    """Threads used for one request: `ROOMLIGHT_THREADS`, or the cores this process may run on, at most 8."""
    asked = os.environ.get("ROOMLIGHT_THREADS", "")
    if asked.isdecimal() and int(asked) > 0:
        return int(asked)
    return min(8, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_count(), thread_name_prefix="roomlight")


def shard(work: Callable[[int, int], object], count: int, *, pieces_per_thread: int = 4) -> None:
    """Call `work(start, stop)` over all of range(count), in pieces on the pool; returns when all are done.

    More pieces than threads even out rays of unequal length. An exception in a piece is raised here, after
    the other pieces have ended: nothing writes to the caller's buffers behind its back.
    """
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
