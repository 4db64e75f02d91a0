"""Scores of the main light as a table for a terminal: a row per method."""

import math

from rich.table import Table

from roomlight.imaging.tables import figure_table
from roomlight_evaluation.captures.main_light import JUMP_DEG, METHODS, SETTLED_FRAME, MainLightScores
from roomlight_evaluation.confidence import MeanWithInterval


def main_light_table(scores: MainLightScores) -> Table:
    """Return the table: jumps after the fifth frame, share from below, mean errors with 95 % intervals over probes."""
    sequences = len({(track.capture, track.probe) for track in scores.tracks})
    known = len({(track.capture, track.probe) for track in scores.tracks if track.truth is not None})
    table = figure_table(
        f"Main light, probes: {sequences}",
        ("largest\njump", f"over {JUMP_DEG:g}", "below", "error", "last\nframe"),
        caption=(
            f"degrees; jumps: angle between frames after frame {SETTLED_FRAME}; below: share of the frames; errors and "
            f"95 % intervals over probes with ground truth ({known})"
        ),
    )
    for method in METHODS:
        row = scores.summary(method)
        table.add_row(
            method,
            f"{row.largest_jump_deg:.0f}",
            f"{row.jumps} of {row.steps}",
            f"{100 * row.below:.1f} %",
            *(_with_interval(cell) for cell in (row.error_deg, row.last_error_deg)),
        )
    return table


def _with_interval(cell: MeanWithInterval) -> str:
    return f"{cell.mean:.0f} ({cell.low:.0f}-{cell.high:.0f})" if math.isfinite(cell.mean) else "-"
