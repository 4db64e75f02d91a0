"""Fair times on a busy machine: everything is warmed first, then run in turn, A B A B, so that noise hits all alike."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median


@dataclass(frozen=True)
class Timing:
    """Milliseconds of one way of doing a stage, over `runs` runs."""

    least_ms: float
    median_ms: float
    runs: int


@dataclass(frozen=True)
class Way:
    """One way of doing a stage.

    `times`: the run is a share of the work, and its time is multiplied by this. `most_runs` spares the slow ones,
    whose own length already averages the noise out.
    """

    run: Callable[[], object]
    times: float = 1.0
    most_runs: int = 1_000_000


def time_in_turn(ways: Sequence[Way], repeats: int, *, progress: Callable[[str], None]) -> list[Timing]:
    """Time every way `repeats` times (or as often as it allows), one run of each after the other.

    Each must have run once before: compilation and allocation are not what is measured.
    """
    samples: list[list[float]] = [[] for _ in ways]
    for turn in range(repeats):
        progress(f"timing, round {turn + 1} of {repeats}")
        for way, taken in zip(ways, samples, strict=True):
            if turn < way.most_runs:
                began = time.perf_counter()
                way.run()
                taken.append((time.perf_counter() - began) * 1e3 * way.times)
    return [Timing(min(taken), median(taken), len(taken)) for taken in samples]
