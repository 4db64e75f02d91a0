"""Tables of errors with their intervals, a row for each method: for a terminal, and as lines of Markdown."""

import math
from collections.abc import Mapping, Sequence

from rich import box
from rich.table import Table

from roomlight_evaluation.confidence import MeanWithInterval


def error_table(title: str, caption: str, columns: Sequence[str], rows: Mapping[str, Sequence[str]]) -> Table:
    """Return a table whose rows are the methods' cells."""
    table = Table(
        title=title,
        title_justify="left",
        caption=caption,
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("", no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    for method, cells in rows.items():
        table.add_row(method, *cells)
    return table


def error_markdown(title: str, columns: Sequence[str], rows: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the same as lines of Markdown."""
    lines = [f"| {title} | " + " | ".join(columns) + " |", "| --- |" + " --- |" * len(columns)]
    return lines + [f"| {method} | " + " | ".join(cells) + " |" for method, cells in rows.items()]


def cell(value: MeanWithInterval, digits: int = 3) -> str:
    """Return a mean with its interval; a dash where it is not known."""
    if not math.isfinite(value.mean):
        return "-"
    return f"{value.mean:.{digits}f} ({value.low:.{digits}f} to {value.high:.{digits}f})"
