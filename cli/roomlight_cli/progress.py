"""Progress and time left of a command on standard error: a bar on a terminal, a line every ten seconds elsewhere."""

import threading
import time
from typing import Final

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from roomlight_cli import console as consoles

LINE_EVERY_S: Final = 10.0
LOADING: Final = "loading kernels (the first run compiles them)"


class Progress:
    """The state of a task, for use in a `with` statement.

        with Progress("replaying") as progress:
            replay(..., progress=progress.count)

    Args:
        text: What is being done.
        console: Where it is shown; default: standard error.
    """

    def __init__(self, text: str, console: Console | None = None) -> None:
        self.console = console or consoles.err
        self._text, self._done, self._total = text, 0, None
        self._began_s = time.monotonic()
        self._first: tuple[str, int, float] = ("", 0, 0.0)  # what was first counted of this text, and when
        self._ended = threading.Event()
        self._bars: Bars | None = None
        if self.console.is_interactive:  # not where TERM is dumb
            columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
            self._bars = Bars(*columns, TimeRemainingColumn(), console=self.console, transient=True)
            self._task = self._bars.add_task(escape(text), total=None)

    def __enter__(self) -> "Progress":
        if self._bars:
            self._bars.start()
        else:
            threading.Thread(target=self._print_lines, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._bars:
            self._bars.stop()

    def say(self, text: str) -> None:
        """Set what is being done."""
        self.count_of(text, self._done, self._total)

    def count(self, done: int, total: int) -> None:
        """Set how much is done, and of how much."""
        self.count_of(self._text, done, total)

    def count_of(self, text: str, done: int, total: int | None) -> None:
        """Set what is being done, how much of it is done, and of how much."""
        if text != self._first[0] or not self._total:
            self._first = text, done, time.monotonic()
            if self._bars and total:  # what was done before is not of the pace
                self._bars.reset(self._task, completed=done, total=total)
        self._text, self._done, self._total = text, done, total
        if self._bars:
            self._bars.update(self._task, description=escape(text), completed=done, total=total)

    def line(self) -> str:
        """Return the state as a line: what, how much, for how long, and how long it will take at this pace."""
        now_s = time.monotonic()
        count, left = f" {self._done} of {self._total}" if self._total else "", ""
        _, first, first_s = self._first
        if self._total and first < self._done < self._total:
            left = f", {duration((now_s - first_s) / (self._done - first) * (self._total - self._done))} left"
        return f"{self._text}{count}, {duration(now_s - self._began_s)}{left}"

    def _print_lines(self) -> None:
        while not self._ended.wait(LINE_EVERY_S):
            self.console.print(self.line(), soft_wrap=True, markup=False)


def duration(seconds: float) -> str:
    """Format seconds as 3:07:05 or 7:05."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
