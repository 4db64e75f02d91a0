"""Fair times on a busy machine.

Implementations run interleaved (A B A B), so that other work on the machine slows all of them alike.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

ProgressCallback = Callable[[str], object]
"""Called with one line that says what is being measured."""


@dataclass(frozen=True)
class Timing:
    """Milliseconds of one implementation over `runs` runs."""

    least_ms: float
    median_ms: float
    runs: int


@dataclass(frozen=True)
class Implementation:
    """One implementation of a stage.

    Attributes:
        scale: Factor on the measured time, for a run that does only a share of the stage's work.
        max_runs: Limit on the number of runs, for slow implementations: a long run averages noise out by itself.
    """

    run: Callable[[], object]
    scale: float = 1.0
    max_runs: int = 1_000_000


def time_interleaved(
    implementations: Sequence[Implementation], repeats: int, *, progress: ProgressCallback
) -> list[Timing]:
    """Time every implementation `repeats` times, or `max_runs` times if that is less, one run of each per round.

    Each must have run once before, so that compilation and allocation are not measured.
    """
    samples_ms: list[list[float]] = [[] for _ in implementations]
    for number in range(repeats):
        progress(f"timing, round {number + 1} of {repeats}")
        for implementation, times_ms in zip(implementations, samples_ms, strict=True):
            if number < implementation.max_runs:
                start_s = time.perf_counter()
                implementation.run()
                times_ms.append((time.perf_counter() - start_s) * 1e3 * implementation.scale)
    return [Timing(min(times_ms), median(times_ms), len(times_ms)) for times_ms in samples_ms]
