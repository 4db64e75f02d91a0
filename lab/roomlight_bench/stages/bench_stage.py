"""A stage before it is timed: its implementations, and how far their results agree."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from roomlight_bench.timing import Implementation


@dataclass(frozen=True)
class BenchStage:
    """One row of the table of `roomlight bench stages`.

    Attributes:
        ours: The implementation that the engine uses.
        paper_ms: The paper's time for the same stage, on its GPU.
        flops: Floating-point operations of a network, as PyTorch counts them; None for other stages.
        note: What is timed, e.g. the number of rays.
        differences: Largest absolute difference of our result from that of each other implementation, by its name.
    """

    name: str
    ours: Implementation
    reference: Implementation | None = None
    torch: Implementation | None = None
    paper_ms: float | None = None
    flops: float | None = None
    note: str = ""
    differences: dict[str, float] = field(default_factory=dict[str, float])


def largest_difference(first: object, second: object) -> float:
    """Return the largest absolute difference of two arrays."""
    return float(np.abs(np.asarray(first, np.float64) - np.asarray(second, np.float64)).max())


def differences(ours: Callable[[], object], others: dict[str, Callable[[], object] | None]) -> dict[str, float]:
    """Run each implementation once, which also warms it up, and compare the results; None entries are left out."""
    result = ours()
    return {name: largest_difference(result, run()) for name, run in others.items() if run is not None}
