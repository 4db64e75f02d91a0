"""`roomlight bench composite`: virtual objects in frames, part by part."""

from typing import Annotated

import typer

from roomlight.files import write_json
from roomlight_bench.composite import run_composite
from roomlight_bench.reporting import criteria_table
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app

app = single_command_app()


@app.command("composite")
def bench_composite(
    frames: Annotated[
        int, typer.Option(min=1, max=1000, help="Measured frames of a preview; good takes a quarter, final a tenth.")
    ] = 30,
    final: Annotated[bool, typer.Option("--final", help="Also measure the quality final (minutes).")] = False,
    json_out: arguments.FiguresJson = None,
) -> None:
    """Measure what virtual objects in a frame cost by part, and how much they shimmer."""
    with console.err.status("measuring") as status:
        report = run_composite(frames=frames, final=final, progress=status.update)
    console.print_table(console.out, report.table())
    console.print_table(console.out, report.shimmer_table())
    console.print_table(console.out, criteria_table(report.criteria()))
    if json_out:
        write_json(json_out, report.to_json())
