"""Scores on a dataset as tables: for a terminal, and as Markdown."""

import math

from rich import box
from rich.markup import escape
from rich.table import Table

from roomlight_evaluation.confidence import MeanWithInterval
from roomlight_evaluation.datasets.scores import KEYS, TITLES, DatasetScores, MetricKey, Ratio

_DEPTHS = {"exact": "exact depth", "arkit": "ARKit-like"}


def dataset_tables(scores: DatasetScores) -> list[Table]:
    """Return a table with a row per method and a column per metric and kind of depth, then the ratios, if any."""
    table = Table(
        title=escape(_heading(scores)),
        title_justify="left",
        caption="mean and 95 % interval over rooms; less is better, the best of each column is bold",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        show_edge=False,
    )
    table.add_column("", min_width=max(map(len, scores.methods)))
    for metric, depth in _columns(scores):
        widths = [len(_scaled(scores.mean(method, depth, metric), metric)) for method in scores.methods]
        title = TITLES[metric][0]
        table.add_column(f"{title}\n{_DEPTHS[depth]}", justify="right", min_width=max(len(title), *widths))
    best = _best(scores)
    for method in scores.methods:
        cells = [
            (_bold if method in best[metric, depth] else str)(_scaled(scores.mean(method, depth, metric), metric))
            for metric, depth in _columns(scores)
        ]
        table.add_row(escape(method), *cells)
    ratios = scores.ratios()
    return [table, _ratio_table(ratios)] if ratios else [table]


def dataset_markdown(scores: DatasetScores) -> str:
    """Return the content of `dataset_tables` as Markdown."""
    columns = _columns(scores)
    lines = [
        "| " + " | ".join(["", *(f"{TITLES[metric][0]}, {_DEPTHS[depth]}" for metric, depth in columns)]) + " |",
        "| --- |" + " ---: |" * len(columns),
    ]
    best = _best(scores)
    for method in scores.methods:
        cells = [_scaled(scores.mean(method, depth, metric), metric) for metric, depth in columns]
        marked = [
            f"**{cell}**" if method in best[column] else cell for cell, column in zip(cells, columns, strict=True)
        ]
        lines.append("| " + " | ".join([method, *marked]) + " |")
    lines += ["", f"{_heading(scores)}; in brackets 95 % intervals over rooms."]
    if ratios := scores.ratios():
        lines += ["", "| ratio | measured | target | |", "| --- | ---: | ---: | --- |"]
        lines += [
            f"| {ratio.title} | {_interval(ratio.value)} | {_limit(ratio)} | {_verdict(ratio)} |" for ratio in ratios
        ]
    return "\n".join(lines) + "\n"


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
    table = Table(title="Ratios on the same rooms", title_justify="left", box=box.SIMPLE_HEAD, show_edge=False)
    table.add_column("", min_width=max(len(ratio.title) for ratio in ratios))
    table.add_column("measured", justify="right", min_width=max(len(_interval(ratio.value)) for ratio in ratios))
    table.add_column("target", justify="right", min_width=len("<= 0.65"))
    table.add_column("", min_width=len("does not hold"))
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
