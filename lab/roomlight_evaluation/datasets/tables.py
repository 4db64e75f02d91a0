"""Scores on a dataset as tables."""

import math

from rich.markup import escape
from rich.table import Table

from roomlight_evaluation.confidence import MeanWithInterval
from roomlight_evaluation.datasets.scores import KEYS, TITLES, DatasetScores, MetricKey, Ratio
from roomlight_evaluation.tables import figure_table

_DEPTHS = {"exact": "exact depth", "arkit": "ARKit-like"}


def dataset_tables(scores: DatasetScores) -> list[Table]:
    """Return a table with a row per method and a column per metric and kind of depth, then the ratios, if any."""
    table = figure_table(
        _heading(scores),
        [f"{TITLES[metric][0]}\n{_DEPTHS[depth]}" for metric, depth in _columns(scores)],
        caption="mean and 95 % interval over rooms; less is better, the best of each column is bold",
    )
    best = _best(scores)
    for method in scores.methods:
        cells = [
            (_bold if method in best[metric, depth] else str)(_scaled(scores.mean(method, depth, metric), metric))
            for metric, depth in _columns(scores)
        ]
        table.add_row(escape(method), *cells)
    ratios = scores.ratios()
    return [table, _ratio_table(ratios)] if ratios else [table]


def _heading(scores: DatasetScores) -> str:
    skipped = f", {len(scores.skipped)} skipped" if scores.skipped else ""
    return f"{scores.rooms} rooms, {len(scores.sequences)} sequences, first frames{skipped}"


def _scaled(mean: MeanWithInterval, metric: MetricKey) -> str:
    """Format a mean and its interval, times the paper's factor."""
    factor = TITLES[metric][1]
    return _interval(MeanWithInterval(mean.mean * factor, mean.low * factor, mean.high * factor))


def _columns(scores: DatasetScores) -> list[tuple[MetricKey, str]]:
    return [(metric, depth) for metric in KEYS for depth in scores.depths]


def _best(scores: DatasetScores) -> dict[tuple[MetricKey, str], set[str]]:
    best: dict[tuple[MetricKey, str], set[str]] = {}
    for metric, depth in _columns(scores):
        means = {method: scores.mean(method, depth, metric).mean for method in scores.methods}
        lowest = min(means.values())
        best[metric, depth] = {method for method, mean in means.items() if mean == lowest and len(means) > 1}
    return best


def _ratio_table(ratios: tuple[Ratio, ...]) -> Table:
    table = figure_table("Ratios on the same rooms", ("measured", "target", "verdict"))
    colours = {True: "green", False: "red", None: "dim"}
    for ratio in ratios:
        verdict = f"[{colours[ratio.holds]}]{_verdict(ratio)}[/]"
        table.add_row(escape(ratio.title), _interval(ratio.value), _limit(ratio), verdict)
    return table


def _limit(ratio: Ratio) -> str:
    return "-" if ratio.limit is None else f"<= {ratio.limit:g}"


def _verdict(ratio: Ratio) -> str:
    return {True: "holds", False: "does not hold", None: ""}[ratio.holds]


def _interval(mean: MeanWithInterval) -> str:
    if not math.isfinite(mean.low):
        return f"{mean.mean:.3g}"
    return f"{mean.mean:.3g} ({mean.low:.3g}-{mean.high:.3g})"


def _bold(text: str) -> str:
    return f"[bold]{text}[/bold]"
