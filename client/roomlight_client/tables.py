"""Evaluation results as tables for a terminal: methods below each other, the paper's intervals as columns."""

import math

from rich.table import Table

from roomlight.metrics import METRICS, Metric
from roomlight_client.scores import Cell, Evaluation


def evaluation_tables(evaluation: Evaluation, *, per_capture: bool = False) -> list[Table]:
    """One table of all metrics with 95 % intervals of the overall mean, and, if asked, one more a capture.

    The lowest (best) mean of each metric and column is bold. Values are shown times the factor in the
    heading.
    """
    captures, pairs = len(evaluation.captures), sum(capture.probes for capture in evaluation.captures)
    caption = (
        f"less is better, best is bold; [95 % bootstrap interval over the {pairs} (capture, probe) pairs]; "
        "smoothness is between consecutive frames, so its last interval ends one frame earlier"
    )
    of = "capture" if captures == 1 else "captures"
    tables = [_table(evaluation, f"{captures} {of}, {pairs} probes", caption=caption)]
    if per_capture and captures > 1:
        tables += [_table(evaluation, capture.name, capture=capture.name) for capture in evaluation.captures]
    return tables


def _table(evaluation: Evaluation, title: str, *, capture: str | None = None, caption: str = "") -> Table:
    table = Table(title=title, title_justify="left", caption=caption, caption_justify="left")
    table.add_column("metric", no_wrap=True)
    table.add_column("method", no_wrap=True)
    for column in evaluation.columns:
        table.add_column(column, justify="right")
    for metric in METRICS:
        rows = {method: evaluation.cells(method, metric.key, capture=capture) for method in evaluation.methods}
        best = [min(cell.mean for cell in column) for column in zip(*rows.values(), strict=True)]
        for number, (method, cells) in enumerate(rows.items()):
            table.add_row(
                metric.title if number == 0 else "",
                method,
                *(
                    _text(cell, metric, best=cell.mean == lowest and len(rows) > 1, spread=cell is cells[-1])
                    for cell, lowest in zip(cells, best, strict=True)
                ),
                end_section=number == len(rows) - 1,
            )
    return table


def _text(cell: Cell, metric: Metric, *, best: bool, spread: bool) -> str:
    if not math.isfinite(cell.mean):
        return "-"
    mean, low, high = (f"{value * metric.shown_times:.3g}" for value in (cell.mean, cell.low, cell.high))
    text = f"[bold]{mean}[/bold]" if best else mean
    # the bracket is escaped: rich would take it for markup
    return f"{text} \\[{low}, {high}]" if spread and math.isfinite(cell.low) else text
