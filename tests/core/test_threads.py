"""`parallel_for` covers the range once, raises errors, and takes the number of threads from the environment."""

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomlight.threads import parallel_for, thread_count


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
        assert failed.wait(60)
        sum(range(200_000))  # ends after the failed piece
        ended.append(start)

    with pytest.raises(ZeroDivisionError):
        parallel_for(work, 100)
    assert sorted(ended) == sorted(begun)[1:]


@pytest.mark.parametrize(("variable", "threads"), [("3", 3), ("1", 1), ("64", 64)])
def test_the_environment_sets_the_thread_count(monkeypatch, variable, threads):
    monkeypatch.setenv("ROOMLIGHT_THREADS", variable)
    assert thread_count() == threads


@pytest.mark.parametrize("variable", ["", "0", "-2", "many", "²"])
def test_an_invalid_thread_count_is_ignored(monkeypatch, variable):
    monkeypatch.delenv("ROOMLIGHT_THREADS", raising=False)
    default = thread_count()
    monkeypatch.setenv("ROOMLIGHT_THREADS", variable)
    assert thread_count() == default
    assert 1 <= default <= 8
