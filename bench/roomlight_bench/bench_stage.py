"""What a stage is to the benchmark: its ways of being done, its cost, and how far the ways agree."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from roomlight_bench.roofline import Cost
from roomlight_bench.timing import Way


@dataclass(frozen=True)
class Stage:
    """One row of the table before it is timed.

    `paper_ms` is the paper's time on its GPU for the same stage; `note` says what is timed. `differences`: largest
    absolute difference of our result to the other ways'.
    """

    name: str
    ours: Way
    cost: Cost
    reference: Way | None = None
    torch: Way | None = None
    paper_ms: float | None = None
    note: str = ""
    differences: dict[str, float] = field(default_factory=dict[str, float])


def largest_difference(first: object, second: object) -> float:
    """Largest absolute difference of two arrays, as float."""
    return float(np.abs(np.asarray(first, np.float64) - np.asarray(second, np.float64)).max())


def differences(ours: Callable[[], object], others: dict[str, Callable[[], object] | None]) -> dict[str, float]:
    """Run each way once (which warms it) and compare; ways that are not there are left out."""
    result = ours()
    return {name: largest_difference(result, run()) for name, run in others.items() if run is not None}
