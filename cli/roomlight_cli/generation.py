"""Progress and cost of `roomlight dataset generate`, in words, and its end by a signal."""

import signal
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from statistics import fmean

import typer
from rich.console import Console
from rich.markup import escape

from roomlight_cli.progress import Progress, duration
from roomlight_generator.generate import GenerationProgress


def show_generation(progress: Progress) -> Callable[[GenerationProgress], None]:
    """Return a progress callback of the generator that shows the run's state, and its notes as lines."""

    def show(state: GenerationProgress) -> None:
        if state.note:
            progress.console.print(f"[yellow]note:[/] {escape(state.note)}", soft_wrap=True)
        progress.count_of(f"generating ({describe(state)})", state.finished, state.wanted)

    return show


@contextmanager
def stopped_by_signals(kept: str, console: Console) -> Generator[None]:
    """At Ctrl-C or SIGTERM say that the same command continues, and end with the signal's exit code."""
    if threading.current_thread() is not threading.main_thread():  # which alone has signals
        yield
        return
    received = int(signal.SIGINT)

    def stop(number: int, _: object) -> None:
        nonlocal received
        received = number
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    except KeyboardInterrupt:
        console.print(f"stopped; {kept}, and the same command continues", soft_wrap=True)
        raise typer.Exit(128 + received) from None
    finally:
        signal.signal(signal.SIGTERM, before)


def describe(progress: GenerationProgress) -> str:
    """Return size, rate, time left and cost, as far as they are known."""
    parts = [f"{progress.bytes / 1e6:.0f} MB"]
    if progress.per_hour is not None and progress.left_s is not None:
        parts.append(f"{progress.per_hour:.0f} per hour, {duration(progress.left_s)} left")
        parts.append(f"{progress.core_s / progress.made:.1f} core-seconds each")
    return ", ".join(parts)


def cost_text(core_s: Sequence[float]) -> str:
    """Return the mean cost of sequences, and that of each half: it shows whether costs grow."""
    half = len(core_s) // 2
    text = f"{fmean(core_s):.1f} core-seconds each"
    return text + (f" (first half {fmean(core_s[:half]):.1f}, second {fmean(core_s[half:]):.1f})" if half else "")
