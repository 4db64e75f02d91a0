"""`parallel_for` covers the range once, raises errors, and takes the number of threads from the environment."""

import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomlight import threads
from roomlight.errors import OptionError
from roomlight.threads import parallel_for, read_ahead, thread_count


@given(st.integers(0, 500), st.integers(1, 9))
def test_every_index_is_processed_once(count, pieces):
    touched = np.zeros(count, int)

    def work(start, stop):
        touched[start:stop] += 1

    parallel_for(work, count, pieces_per_thread=pieces)
    assert (touched == 1).all()


@pytest.mark.parametrize("threads", ["1", "2"])
def test_an_error_in_a_piece_is_raised_to_the_caller(monkeypatch, threads):
    monkeypatch.setenv("ROOMLIGHT_THREADS", threads)

    def work(start, stop):
        if start <= 37 < stop:
            raise ZeroDivisionError("piece of 37")

    with pytest.raises(ZeroDivisionError, match="piece of 37"):
        parallel_for(work, 100)


def test_no_piece_writes_after_an_error(monkeypatch):
    monkeypatch.setenv("ROOMLIGHT_THREADS", "2")
    begun, ended, failed = [], [], threading.Event()

    def work(start, _):
        begun.append(start)
        if start == 0:
            failed.set()
            raise ZeroDivisionError
        assert failed.wait(600)
        sum(range(200_000))  # ends after the failed piece
        ended.append(start)

    with pytest.raises(ZeroDivisionError):
        parallel_for(work, 100)
    assert sorted(ended) == sorted(begun)[1:]


@pytest.fixture
def one_helper(monkeypatch):
    """Two threads for a loop: its own and one helper, whatever the machine."""
    monkeypatch.setenv("ROOMLIGHT_THREADS", "2")
    with ThreadPoolExecutor(1, thread_name_prefix="helper") as pool:
        monkeypatch.setattr(threads, "_helpers", lambda: pool)
        yield


class HeldLoop:
    """A loop of eight pieces that wait, as those of a large map take a tenth of a second each."""

    def __init__(self):
        self.entered = {True: threading.Semaphore(0), False: threading.Semaphore(0)}
        self.gate = {True: threading.Semaphore(0), False: threading.Semaphore(0)}
        self._loop = in_thread(partial(parallel_for, self._piece, 100))
        for on_helper in (True, False):
            self.entered[on_helper].acquire()

    def _piece(self, *_):
        self.entered[on_helper()].release()
        assert self.gate[on_helper()].acquire(timeout=600)

    def end(self):
        for gate in self.gate.values():
            gate.release(8)
        self._loop.join()


def in_thread(work):
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


def on_helper():
    return threading.current_thread().name.startswith("helper")


@pytest.mark.usefixtures("one_helper")
def test_a_loop_ends_although_another_holds_the_helper():
    """Each loop of a frame waited for all pieces of another client's map."""
    held, touched = HeldLoop(), np.zeros(100, int)

    def work(start, stop):
        touched[start:stop] += 1

    in_thread(partial(parallel_for, work, 100)).join()
    assert (touched == 1).all()
    held.end()


@pytest.mark.usefixtures("one_helper")
def test_loops_share_a_helper_piece_by_piece():
    held, begun, helped = HeldLoop(), threading.Event(), threading.Event()

    def work(*_):
        if on_helper():
            helped.set()
        else:
            begun.set()
            assert helped.wait(600)

    short = in_thread(partial(parallel_for, work, 100))
    begun.wait()
    held.gate[True].release()  # one of the six pieces that the helper could take one after the other
    helped.wait()
    short.join()
    held.end()


def test_the_environment_sets_the_thread_count(monkeypatch):
    monkeypatch.delenv("ROOMLIGHT_THREADS", raising=False)
    default = thread_count()
    assert 1 <= default <= 8
    for variable, count in {"3": 3, "1": 1, " 64 ": 64, "": default}.items():
        monkeypatch.setenv("ROOMLIGHT_THREADS", variable)
        assert thread_count() == count


@pytest.mark.parametrize("threads", ["0", "-2", "1.5", "many", "²"])
def test_a_thread_count_that_is_none_is_refused(monkeypatch, threads):
    """It was ignored."""
    monkeypatch.setenv("ROOMLIGHT_THREADS", threads)
    with pytest.raises(OptionError, match=r"ROOMLIGHT_THREADS: '.*': must be a whole number from 1 on; without it"):
        thread_count()


@pytest.mark.parametrize("threads", ["1", "2"])
def test_pieces_hold_at_most_as_many_items_as_asked(monkeypatch, threads):
    monkeypatch.setenv("ROOMLIGHT_THREADS", threads)
    pieces = []
    parallel_for(lambda start, stop: pieces.append((start, stop)), 1003, most=50)
    assert max(stop - start for start, stop in pieces) <= 50
    assert sorted(item for start, stop in pieces for item in range(start, stop)) == list(range(1003))
    pieces.clear()
    parallel_for(lambda start, stop: pieces.append((start, stop)), 3, most=2)
    assert sorted(item for start, stop in pieces for item in range(start, stop)) == [0, 1, 2]


def test_items_are_made_ahead_in_order_and_on_another_thread() -> None:
    made: list[int] = []

    def items() -> Iterator[tuple[int, str]]:
        for number in range(4):
            made.append(number)
            yield number, threading.current_thread().name

    ahead = read_ahead(items())
    first = next(ahead)
    second = next(ahead)
    assert (first[0], second[0]) == (0, 1)
    assert "ahead" in first[1]
    assert [number for number, _ in ahead] == [2, 3]
    assert made == [0, 1, 2, 3]


def test_an_error_of_the_next_item_comes_after_the_items_before() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise ValueError("of the second")

    ahead = read_ahead(items())
    assert next(ahead) == 1
    with pytest.raises(ValueError, match="of the second"):
        next(ahead)


def test_closing_waits_for_the_item_that_is_made() -> None:
    go_on, ended = threading.Event(), threading.Event()

    def items() -> Iterator[int]:
        yield 0
        go_on.wait(600)
        ended.set()
        yield 1

    ahead = read_ahead(items())
    assert next(ahead) == 0
    threading.Timer(0.05, go_on.set).start()
    ahead.close()
    assert ended.is_set()


@pytest.mark.parametrize(("limit", "cores"), [("200000 100000", 2), ("150000 100000", 2), ("max 100000", 4), ("", 4)])
def test_a_containers_limit_of_cpu_time_counts(monkeypatch, tmp_path, limit, cores):
    """Eight threads that share the time of two cores stand still for most of each tenth of a second."""
    (tmp_path / "cpu.max").write_text(limit)
    monkeypatch.setattr(threads, "_CPU_LIMIT", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(4))
    assert threads.core_count.__wrapped__() == cores
