"""Scores on captures as tables for a terminal: a row per metric and method, a column per interval of the paper."""

import math
from typing import Final

from rich.markup import escape
from rich.table import Table

from roomlight.imaging.tables import figure_table
from roomlight.metrics import METRICS, Metric
from roomlight_evaluation.baselines import MeanColour, WarpAndFill
from roomlight_evaluation.captures.scores import CaptureScores
from roomlight_evaluation.confidence import MeanWithInterval, mean_cell

_COMPARED: Final = {"log_l2": "log-L2", "render_l2": "glossy sphere"}
"""Metrics of the ratios, and their headings."""


def capture_tables(scores: CaptureScores, *, per_capture: bool = False) -> list[Table]:
    """Return one table of all metrics with 95 % intervals of the overall mean, then one per capture if requested.

    After those of captures come ratios of the last method's errors to those of the method before it, baselines aside:
    the model's to the classical one's, or predictions' to the model's. Without `per_capture` they are those of each
    method, baselines too, to the first that is no baseline, over all captures; a method that lacks frames has none. The
    best mean of each metric and column is bold. Values are shown times the factor in the heading.
    """
    captures, probes = len(scores.captures), sum(capture.probes for capture in scores.captures)
    noun = "capture" if captures == 1 else "captures"
    caption = (
        "less is better, best is bold; columns are frames; 95 %: bootstrap interval of the mean of all frames, over "
        f"{scores.resampled}; smoothness compares frames that follow each other here, so its last "
        "interval ends one frame earlier"
    )
    tables = [_table(scores, f"{captures} {noun}, {probes} probes", caption=caption)]
    if per_capture and captures > 1:
        tables += [_table(scores, capture.name, capture=capture.name) for capture in scores.captures]
    models = [method for method in scores.methods if method not in (MeanColour.name, WarpAndFill.name)]
    if per_capture and len(models) > 1:
        tables.append(_ratios(scores, models[-1], to=models[-2]))
    elif len(models) > 1:
        tables.append(_ratios_of_all(scores, to=models[0]))
    return tables


def _ratios_of_all(scores: CaptureScores, *, to: str) -> Table:
    ratios = {method: [scores.ratio(key, method, to) for key in _COMPARED] for method in scores.methods if method != to}
    return figure_table(
        f"ratios to {to}",
        [*_COMPARED.values()],
        (
            [method, *map(mean_cell, row)]
            for method, row in ratios.items()
            if any(math.isfinite(ratio.mean) for ratio in row)
        ),
        caption=f"of mean errors of all frames (95 % bootstrap interval over {scores.resampled})",
    )


def _ratios(scores: CaptureScores, method: str, *, to: str) -> Table:
    names: list[str | None] = [capture.name for capture in scores.captures]
    names += [None] if len(names) > 1 else []
    return figure_table(
        f"{method} to {to}",
        [*_COMPARED.values()],
        (
            [
                name or f"all {len(scores.captures)}",
                *(mean_cell(scores.ratio(key, method, to, capture=name)) for key in _COMPARED),
            ]
            for name in names
        ),
        caption=f"ratio of mean errors over captures (95 % bootstrap interval over {scores.resampled})",
    )


def _table(scores: CaptureScores, title: str, *, capture: str | None = None, caption: str = "") -> Table:
    # with a metric's name on a line of its own and no gap: the whole within 80 columns
    table = figure_table(title, [*scores.columns, "95 %"], caption=caption, gap=0)
    for metric in METRICS:
        rows = {method: scores.means(method, metric.key, capture=capture) for method in scores.methods}
        best = [
            min((cell.mean for cell in column), key=lambda mean: abs(mean - metric.best))
            for column in zip(*rows.values(), strict=True)
        ]
        table.add_row(f"[bold]{metric.title}[/bold]")
        for number, (method, cells) in enumerate(rows.items()):
            table.add_row(
                f" {escape(method)}",
                *(
                    _mean(cell, metric, best=cell.mean == lowest and len(rows) > 1)
                    for cell, lowest in zip(cells, best, strict=True)
                ),
                _interval(cells[-1], metric),
                end_section=number == len(rows) - 1,
            )
    return table


def _mean(cell: MeanWithInterval, metric: Metric, *, best: bool) -> str:
    if not math.isfinite(cell.mean):
        return "-"
    text = _short(cell.mean * metric.shown_times)
    return f"[bold]{text}[/bold]" if best else text


def _interval(cell: MeanWithInterval, metric: Metric) -> str:
    if not math.isfinite(cell.low):
        return "-"
    return f"{_short(cell.low * metric.shown_times)}-{_short(cell.high * metric.shown_times)}"


def _short(value: float) -> str:
    """Format with three digits, two below 0.1: rooms differ by more."""
    return f"{value:.3g}" if value >= 0.1 else f"{value:.2g}"
