"""Cells of tables of scores."""

import math

from roomlight_evaluation.confidence import MeanWithInterval


def mean_cell(value: MeanWithInterval, digits: int = 3) -> str:
    """Return a mean with its interval; a dash where it is not known."""
    if not math.isfinite(value.mean):
        return "-"
    return f"{value.mean:.{digits}f} ({value.low:.{digits}f} to {value.high:.{digits}f})"
