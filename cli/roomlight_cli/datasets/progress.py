"""Progress of `roomlight dataset generate`: a bar on a terminal, a line every 30 seconds elsewhere."""

import time
from collections.abc import Sequence
from statistics import fmean
from types import TracebackType
from typing import Final

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
from rich.progress import Progress as Bars

from roomlight_generator.generate import GenerationProgress

LINE_EVERY_S: Final = 30.0
"""Seconds between plain lines: the log of a night has 1,000 of them."""


class ProgressDisplay:
    """A progress callback of the generator, for use in a `with` statement."""

    def __init__(self, console: Console, *, line_every_s: float = LINE_EVERY_S) -> None:
        self._console = console
        self._line_every_s = line_every_s
        self._last_line_s = -float("inf")
        columns = (
            TextColumn("sequences"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("{task.fields[more]}"),
        )
        self._bars = Bars(*columns, console=console, transient=True) if console.is_terminal else None
        self._task = self._bars.add_task("", total=None, more="") if self._bars else None

    def __enter__(self) -> "ProgressDisplay":
        if self._bars:
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bars:
            self._bars.stop()

    def __call__(self, progress: GenerationProgress) -> None:
        """Show the run's state."""
        if progress.note:
            self._console.print(f"[yellow]note:[/] {escape(progress.note)}", soft_wrap=True)
        if self._bars and self._task is not None:
            self._bars.update(self._task, total=progress.wanted, completed=progress.finished, more=describe(progress))
            return
        now = time.monotonic()
        if now - self._last_line_s >= self._line_every_s or progress.finished == progress.wanted:
            self._last_line_s = now
            line = f"{progress.finished} of {progress.wanted} sequences, {describe(progress)}"
            self._console.print(line, soft_wrap=True, markup=False)


def describe(progress: GenerationProgress) -> str:
    """Return size, rate, time left and cost, as far as they are known."""
    parts = [f"{progress.bytes / 1e6:.0f} MB"]
    if progress.per_hour is not None and progress.left_s is not None:
        parts.append(f"{progress.per_hour:.0f} per hour, {duration(progress.left_s)} left")
        parts.append(f"{progress.core_s / progress.made:.1f} core-seconds each")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """Format seconds as 3:07:05 or 7:05."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def cost_text(core_s: Sequence[float]) -> str:
    """Return the mean cost of sequences, and that of each half: it shows whether costs grow."""
    half = len(core_s) // 2
    text = f"{fmean(core_s):.1f} core-seconds each"
    return text + (f" (first half {fmean(core_s[:half]):.1f}, second {fmean(core_s[half:]):.1f})" if half else "")
