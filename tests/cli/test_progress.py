"""Progress without a terminal is lines; on one it is a bar."""

import io
from unittest import mock

import pytest
from rich.console import Console

from roomlight_cli import progress as progress_module
from roomlight_cli import shared_options
from roomlight_cli.commands import stream as stream_command
from roomlight_cli.progress import Progress, duration
from roomlight_cli.stream import Tally


def test_a_line_says_what_how_much_and_for_how_long() -> None:
    with Progress("replaying", Console(file=io.StringIO(), width=100)) as shown:
        assert shown.line() == "replaying, 0:00"
        shown.count(4, 31)
        assert shown.line() == "replaying 4 of 31, 0:00"
        shown.say("drawing")
        shown.count_of("scoring [room]", 1, 2)
        assert shown.line() == "scoring [room] 1 of 2, 0:00"


def test_a_line_says_the_time_left_at_the_pace_since_the_first_count(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 100.0
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now_s)
    shown = Progress("compiling", Console(file=io.StringIO(), width=100))
    shown.say("replaying")
    now_s += 30  # until the first frame: not of the pace
    shown.count(2, 10)
    assert shown.line() == "replaying 2 of 10, 0:30"
    now_s += 20
    shown.count(4, 10)
    assert shown.line() == "replaying 4 of 10, 0:50, 1:00 left"
    shown.count(10, 10)
    assert shown.line() == "replaying 10 of 10, 0:50"
    shown.count_of("next", 1, 10)
    assert shown.line() == "next 1 of 10, 0:50"


def test_lines_are_printed_while_the_work_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress_module, "LINE_EVERY_S", 0.001)
    stream = io.StringIO()
    with Progress("solving [x]", Console(file=stream, width=100)):
        while stream.getvalue().count("\n") < 2:
            pass
    assert stream.getvalue().splitlines()[0] == "solving [x], 0:00"


def test_a_terminal_has_a_bar() -> None:
    stream = io.StringIO()
    with Progress("replaying", Console(file=stream, force_terminal=True, width=100, _environ={})) as shown:
        shown.count(2, 4)
    assert "2/4" in stream.getvalue()


def test_a_dumb_terminal_has_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    console = Console(file=io.StringIO(), force_terminal=True, _environ={"TERM": "dumb"})
    thread = mock.Mock()
    monkeypatch.setattr(progress_module.threading, "Thread", thread)
    monkeypatch.setattr(progress_module.consoles, "err", console)
    monkeypatch.setattr(stream_command, "err", console)
    with Progress("replaying"), stream_command._live_tally(Tally()):
        assert thread.call_count == 2  # that print lines


def test_durations() -> None:
    assert [duration(s) for s in (0.0, 65.0, 3599.6, 7265.0)] == ["0:00", "1:05", "1:00:00", "2:01:05"]


def test_an_evaluation_scores_once_its_kernels_are_loaded(monkeypatch):
    monkeypatch.setattr(shared_options, "warm_up", lambda: None)
    with shared_options.scoring_progress() as progress:
        assert progress.line().startswith("scoring")
