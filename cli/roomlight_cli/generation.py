"""Progress and cost of `roomlight dataset generate`, in words."""

from collections.abc import Callable, Sequence
from statistics import fmean

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
