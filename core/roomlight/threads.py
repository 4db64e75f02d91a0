"""Parallel loops of kernels, on the calling thread and a thread pool.

Kernels release the GIL and run serially; rows are split here. numba's own threading layer aborts the process when two
threads enter a parallel region at once, as in a server.
"""

import math
import os
import platform
import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Final, TypeVar, cast

from roomlight.errors import OptionError

_Item = TypeVar("_Item")
_pauses = threading.local()
_CPU_LIMIT: Final = Path("/sys/fs/cgroup/cpu.max")
"""Microseconds of all cores that a container may use in each period (Linux, control groups 2), or \"max\"."""


def thread_count() -> int:
    """Return the threads used for one request: `ROOMLIGHT_THREADS`, or the cores of this process, at most 8.

    Raises:
        OptionError: The variable is no whole number above 0.
    """
    setting = os.environ.get("ROOMLIGHT_THREADS", "").strip()
    if setting.isdecimal() and int(setting) > 0:
        return int(setting)
    if setting:
        rule = "must be a whole number from 1 on; without it, the cores of this process count"
        raise OptionError(f"ROOMLIGHT_THREADS: {ascii(setting)[:100]}: {rule}")
    return min(8, core_count())


@cache
def core_count() -> int:
    """Return the cores that this process may use, whose time a container may limit."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        quota, period = _CPU_LIMIT.read_text(encoding="ascii").split()
        return min(cores, math.ceil(int(quota) / int(period)))
    except (OSError, ValueError):  # no control group, or "max"
        return cores


@cache
def processor_name() -> str:
    """Return the processor's model."""
    cpu_info = Path("/proc/cpuinfo")  # Python's own `platform.processor` is empty on Linux
    lines = cpu_info.read_text(encoding="utf-8").splitlines() if cpu_info.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


@cache
def _helpers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, thread_count() - 1), thread_name_prefix="roomlight")


def in_forks(change: Callable[[], object]) -> None:
    """Call `change` in each process that is forked from this one; Windows has none."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=change)


in_forks(_helpers.cache_clear)  # its threads are the parent's


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


def parallel_for(
    work: Callable[[int, int], object], count: int, *, pieces_per_thread: int = 4, most: int | None = None
) -> None:
    """Call `work(start, stop)` for pieces of range(count), on this thread and on helpers; return when all have ended.

    More pieces than threads balance rays of unequal length. Loops of several threads share the helpers piece by piece,
    and none waits for a helper: a short loop beside a long one takes the time that it needs on its own thread at most.

    An exception in a piece is raised here after the pieces that had begun have ended, so that none still writes to the
    caller's buffers; the others do not begin.

    Args:
        work: Does the items start .. stop.
        count: Number of items.
        pieces_per_thread: How finely the items are divided, at least.
        most: Most items of a piece, such as the rays that a buffer holds; None: no limit.
    """
    pause = getattr(_pauses, "pause", None)
    if pause is not None:
        pause()
    threads = thread_count()
    alone = threads == 1 or count < 2 * threads
    pieces = 1 if alone else min(count, threads * pieces_per_thread)
    if most is not None:
        pieces = max(pieces, -(-count // most))
    if pieces == 1:
        work(0, count)
        return
    loop = _Loop(work, [count * piece // pieces for piece in range(pieces + 1)])
    for _ in range(0 if alone else min(threads, pieces) - 1):
        _helpers().submit(loop.help)
    while loop.run_piece():
        pass
    loop.finish()


def read_ahead(items: Iterator[_Item]) -> Generator[_Item]:
    """Yield items while a thread makes the next; closing it waits for that thread."""
    end = object()
    with ThreadPoolExecutor(1, thread_name_prefix="roomlight-ahead") as worker:
        coming = worker.submit(next, items, end)
        while (item := coming.result()) is not end:
            coming = worker.submit(next, items, end)
            yield cast(_Item, item)


class _Loop:
    """The pieces of one parallel loop, which its caller and helpers take one after the other."""

    def __init__(self, work: Callable[[int, int], object], bounds: list[int]) -> None:
        self._work, self._pieces = work, list(pairwise(bounds))[::-1]
        self._running = 0
        self._changed = threading.Condition()
        self._error: BaseException | None = None

    def run_piece(self) -> bool:
        """Run the next piece; return False if there was none."""
        with self._changed:
            if not self._pieces:
                return False
            start, stop = self._pieces.pop()
            self._running += 1
        error = None
        try:
            self._work(start, stop)
        except BaseException as raised:  # of the kernel, or KeyboardInterrupt: raised in the caller
            error = raised
        with self._changed:
            self._running -= 1
            if error is not None:
                self._error = self._error or error
                self._pieces.clear()
            self._changed.notify_all()
        return True

    def help(self) -> None:
        """Run one piece on a helper, then give way to the other loops."""
        if self.run_piece():
            _helpers().submit(self.help)

    def finish(self) -> None:
        """Wait for the pieces that helpers run, and raise the first error of a piece."""
        with self._changed:
            self._changed.wait_for(lambda: not self._running)
        if self._error is not None:
            raise self._error
