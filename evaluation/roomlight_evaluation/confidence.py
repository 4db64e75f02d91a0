"""A mean with its 95 % bootstrap interval: the figure that every table of an evaluation shows."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

BOOTSTRAP_SAMPLES: Final = 10_000
"""Resamples per interval; the ends of an interval are then stable to 2 % of its width."""


@dataclass(frozen=True)
class MeanWithInterval:
    """A mean and the ends of its 95 % bootstrap interval; NaN for values that are not known."""

    mean: float
    low: float
    high: float


def bootstrap(columns: Sequence[Iterable[float]], figure: Callable[[np.ndarray], Any]) -> MeanWithInterval:
    """Return a figure of the columns' means and its 95 % interval over resampled rows; rows with NaN do not count."""
    table = np.array([list(column) for column in columns], np.float64)
    table = table[:, np.isfinite(table).all(axis=0)]
    count = table.shape[1]
    if count == 0:
        return MeanWithInterval(np.nan, np.nan, np.nan)
    drawn = np.random.default_rng(0).integers(0, count, (BOOTSTRAP_SAMPLES, count))
    means = table[:, drawn].mean(axis=2)
    low, high = np.percentile(figure(means), [2.5, 97.5])
    return MeanWithInterval(float(figure(table.mean(axis=1))), float(low), float(high))
