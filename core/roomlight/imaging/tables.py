"""Tables of figures for a terminal: a row for each thing measured."""

from collections.abc import Iterable, Sequence

from rich import box
from rich.markup import escape
from rich.table import Table


def figure_table(
    title: str, headings: Sequence[str], rows: Iterable[Sequence[str]] = (), *, caption: str = "", gap: int = 1
) -> Table:
    """Return a table with names in the first column and figures in the others, which keep their width.

    Title, caption and rows are text: what they hold in [brackets] is no markup. `Table.add_row` takes markup.

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
        caption=escape(caption),
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, gap, 0, 0),
    )
    table.add_column("", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*map(escape, row))
    return table
