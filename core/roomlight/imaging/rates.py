"""Rates of videos and sequences as fractions."""

from fractions import Fraction
from typing import Final

DEFAULT_RATE: Final = 30.0
"""Records a second of a recording without timestamps."""
_SAME: Final = 1e-5
"""Relative difference that rounded numbers and timestamps have; 30 and 30000/1001 differ by a hundred times as much."""
_BROADCAST: Final = (24000 / 1001, 30000 / 1001, 60000 / 1001)


def usual_rate(frames_per_second: float, *, within: float) -> float:
    """Return the nearest whole or broadcast rate that differs by up to this share of a rate, else the rate."""
    usual = min((float(round(frames_per_second)), *_BROADCAST), key=lambda rate: abs(rate - frames_per_second))
    return usual if abs(usual - frames_per_second) <= within * frames_per_second else frames_per_second


def exact_rate(frames_per_second: float) -> Fraction:
    """Return a rate as a fraction: 29.97 is 30000/1001, 25.0001 is 25."""
    for factor in (Fraction(1), Fraction(1000, 1001)):
        rate = round(frames_per_second / factor) * factor
        if abs(rate - frames_per_second) <= _SAME * frames_per_second:
            return rate
    return Fraction(frames_per_second).limit_denominator(1001)
