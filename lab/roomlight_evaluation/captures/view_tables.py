"""Errors of predicted views as a table for a terminal: a row per method."""

import math

from rich.table import Table

from roomlight_evaluation.captures.views import REFERENCE, REGIONS, ViewScores
from roomlight_evaluation.confidence import MeanWithInterval
from roomlight_evaluation.tables import figure_table

SHOWN_TIMES = 100
"""Errors are shown times this."""


def view_table(scores: ViewScores) -> Table:
    """Return the table: the error in seen and in unseen directions, and its ratio to the classical model's."""
    views = len({(score.capture, score.frame) for score in scores.scores})
    headings = [(f"{region},\n{100 * scores.share(region):.0f} %", "\nratio") for region in REGIONS]
    table = figure_table(
        f"Views predicted from the frames up to {scores.ahead} before them: {views}",
        [heading for pair in headings for heading in pair],
        caption=(
            f"log-L2 x {SHOWN_TIMES}, less is better; {REFERENCE} = 1 in the ratios; 95 % intervals resample views, "
            "which overlap in one capture"
        ),
    )
    for method in scores.methods:
        cells: list[str] = []
        for region in REGIONS:
            cells += [_short(scores.mean(method, region)), _with_interval(scores.ratio(method, region))]
        table.add_row(method, *cells)
    return table


def _short(cell: MeanWithInterval) -> str:
    return f"{SHOWN_TIMES * cell.mean:.3g}" if math.isfinite(cell.mean) else "-"


def _with_interval(cell: MeanWithInterval) -> str:
    return f"{cell.mean:.2f} ({cell.low:.2f}-{cell.high:.2f})" if math.isfinite(cell.mean) else "-"
