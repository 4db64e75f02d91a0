"""Tables of figures, a row for each method: for a terminal, and the same as Markdown."""

import math
from collections.abc import Iterable, Sequence

from rich import box
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from roomlight_evaluation.confidence import MeanWithInterval


def figure_table(
    title: str, headings: Sequence[str], rows: Iterable[Sequence[str]] = (), *, caption: str = "", gap: int = 1
) -> Table:
    """Return a table with names in the first column and figures in the others, which keep their width.

    Args:
        title: Of the table.
        headings: Of the columns of figures.
        rows: Cells, the name first.
        caption: Below the table.
        gap: Blanks between columns.
    """
    table = Table(
        title=escape(title),
        title_justify="left",
        caption=caption,
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, gap, 0, 0),
    )
    table.add_column("", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def markdown(tables: Iterable[Table]) -> str:
    """Return tables in Markdown: the title, the rows, the caption. Bold cells stay bold."""
    lines: list[str] = []
    for table in tables:
        headings = (str(column.header).replace("\n", ", ") for column in table.columns)
        lines += [_plain(table.title), "", _row(headings), "| --- |" + " ---: |" * (len(table.columns) - 1)]
        lines += [_row(map(_cell, cells)) for cells in zip(*(column.cells for column in table.columns), strict=True)]
        lines += ["", f"{_plain(table.caption)}.", ""] if table.caption else [""]
    return "\n".join(lines)


def mean_cell(value: MeanWithInterval, digits: int = 3) -> str:
    """Return a mean with its interval; a dash where it is not known."""
    if not math.isfinite(value.mean):
        return "-"
    return f"{value.mean:.{digits}f} ({value.low:.{digits}f} to {value.high:.{digits}f})"


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _plain(text: object) -> str:
    return Text.from_markup(str(text)).plain


def _cell(cell: object) -> str:
    text = Text.from_markup(str(cell))
    return f"**{text.plain}**" if any(span.style == "bold" for span in text.spans) else text.plain
