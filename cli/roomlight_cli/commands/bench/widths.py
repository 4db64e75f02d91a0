"""`roomlight bench widths`: the networks at several widths."""

from typing import Annotated

import typer

from roomlight_cli.console import err, say
from roomlight_cli.lazy import single_command_app
from roomlight_export.widths import format_widths, measure_widths

app = single_command_app()


@app.command("widths")
def bench_widths(
    rounds: Annotated[int, typer.Option(min=1, help="Interleaved rounds over all widths.")] = 15,
) -> None:
    """Measure what each width of the networks costs (needs the `train` extra; minutes).

    Columns: parameters, GMAC (10^9 multiply-accumulates) and milliseconds.
    """
    with err.status("measuring") as status:
        rows = measure_widths(rounds=rounds, progress=status.update)
    say(format_widths(rows))
