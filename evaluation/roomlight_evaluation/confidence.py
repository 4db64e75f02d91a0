"""A mean with its 95 % bootstrap interval: the figure that every table of an evaluation shows."""

from dataclasses import dataclass
from typing import Final

BOOTSTRAP_SAMPLES: Final = 10_000
"""Resamples per interval; the ends of an interval are then stable to 2 % of its width."""


@dataclass(frozen=True)
class MeanWithInterval:
    """A mean and the ends of its 95 % bootstrap interval; NaN for values that are not known."""

    mean: float
    low: float
    high: float
