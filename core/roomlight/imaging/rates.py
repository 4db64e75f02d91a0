"""Rates of videos and sequences as fractions."""

from fractions import Fraction
from typing import Final

DEFAULT_RATE: Final = 30.0
"""Records a second of a recording without timestamps."""
_SAME: Final = 1e-5
"""Relative difference that rounded numbers and timestamps have; 30 and 30000/1001 differ by a hundred times as much."""


def exact_rate(frames_per_second: float) -> Fraction:
    """Return a rate as a fraction: 29.97 is 30000/1001, 25.0001 is 25."""
    for factor in (Fraction(1), Fraction(1000, 1001)):
        rate = round(frames_per_second / factor) * factor
        if abs(rate - frames_per_second) <= _SAME * frames_per_second:
            return rate
    return Fraction(frames_per_second).limit_denominator(1001)
