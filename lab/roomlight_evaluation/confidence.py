"""A mean with its 95 % bootstrap interval: the figure that every table of an evaluation shows; what it is taken of."""

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Int

BOOTSTRAP_SAMPLES: Final = 10_000
"""Resamples per interval; the ends of an interval are then stable to 2 % of its width."""


@dataclass(frozen=True)
class MeanWithInterval:
    """A mean and the ends of its 95 % bootstrap interval; NaN for values that are not known."""

    mean: float
    low: float
    high: float


def mean_cell(value: MeanWithInterval, digits: int = 3) -> str:
    """Return a mean with its interval as a table shows it; a dash where it is not known, no interval for one value."""
    if not np.isfinite(value.mean):
        return "-"
    if not np.isfinite(value.low):
        return f"{value.mean:.{digits}f}"
    return f"{value.mean:.{digits}f} ({value.low:.{digits}f} to {value.high:.{digits}f})"


def mean_with_interval(values: Iterable[float], groups: Iterable[Hashable] | None = None) -> MeanWithInterval:
    """Return the mean of the values that are not NaN; its interval resamples them, or groups as in `ratio_of_means`."""
    known = np.array(list(values), np.float64)
    return ratio_of_means(known, np.ones_like(known), groups)


def ratio_of_means(
    above: Iterable[float], below: Iterable[float], groups: Iterable[Hashable] | None = None
) -> MeanWithInterval:
    """Return the mean of one column over that of another, with an interval that resamples their rows together.

    Rows of one group are alike, as walks through one room are: whole groups are resampled. Rows with NaN do not count.
    A single row or group has no interval; no rows, or zeros alone below, have no ratio.
    """
    table = np.array([list(above), list(below)], np.float64)
    known = ~np.isnan(table).any(axis=0)
    table = table[:, known]
    if groups is not None:
        numbers: dict[Hashable, int] = {}
        of_row = np.array([numbers.setdefault(group, len(numbers)) for group in groups], np.int64)[known]
        sums = np.array([np.bincount(of_row, row, len(numbers)) for row in table])
        table = sums[:, np.bincount(of_row, minlength=len(numbers)) > 0]
    count = table.shape[1]
    if not table[1].any():
        return MeanWithInterval(np.nan, np.nan, np.nan)
    middle = table.mean(axis=1)
    ratio = float(middle[0] / middle[1])
    if count == 1 or not np.isfinite(table).all():
        return MeanWithInterval(ratio, np.nan, np.nan)
    means = table[:, _resampled_rows(count)].mean(axis=2)
    low, high = np.percentile(means[0] / means[1], [2.5, 97.5])
    return MeanWithInterval(ratio, float(low), float(high))


def resampled(rooms: Mapping[str, str]) -> str:
    """Return what intervals are over, by each capture's room: "probes" of a single capture, "captures", or "rooms"."""
    if len(rooms) == 1:
        return "probes"
    return "rooms" if len(set(rooms.values())) < len(rooms) else "captures"


@lru_cache(maxsize=8)
def _resampled_rows(count: int) -> Int[np.ndarray, "b n"]:
    """Draw rows with replacement; seeded, so that a table comes out the same twice and methods draw equal pairs."""
    return np.random.default_rng(0).integers(0, count, (BOOTSTRAP_SAMPLES, count))


def evenly_spread(count: int, wanted: int | None) -> list[int]:
    """Return `wanted` of the numbers below `count`, evenly spread, or all."""
    if wanted is None or wanted >= count:
        return list(range(count))
    return [at * count // wanted for at in range(wanted)]
