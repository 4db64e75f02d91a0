"""`roomlight bench composite`: virtual objects in frames, part by part."""

from pathlib import Path
from typing import Annotated

import typer

from roomlight.errors import OptionError
from roomlight.files import write_json
from roomlight_bench.compositing.composite import run_composite
from roomlight_bench.compositing.rivals import RivalReport, run_rivals, run_sizes
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
    sizes: Annotated[bool, typer.Option("--sizes", help="Instead: a sphere by triangles and pixels.")] = False,
    mitsuba: Annotated[
        bool, typer.Option("--mitsuba", help="Instead: the same spheres in Mitsuba 3, if it is installed.")
    ] = False,
    json_out: arguments.FiguresJson = None,
) -> None:
    """Measure what virtual objects in a frame cost by part, and how much they shimmer."""
    if sizes or mitsuba:
        _rivals(sizes, mitsuba, json_out)
        return
    with console.err.status("measuring") as status:
        report = run_composite(frames=frames, final=final, progress=status.update)
    console.print_table(console.out, report.table())
    console.print_table(console.out, report.shimmer_table())
    console.print_table(console.out, criteria_table(report.criteria()))
    if json_out:
        write_json(json_out, report.to_json())


def _rivals(sizes: bool, mitsuba: bool, json_out: Path | None) -> None:
    with console.err.status("measuring") as status:
        try:
            report = RivalReport(
                run_sizes(progress=status.update) if sizes else (),
                run_rivals(progress=status.update) if mitsuba else (),
            )
        except ImportError as error:
            raise OptionError(f"--mitsuba needs Mitsuba 3, `pip install mitsuba`: {error}") from error
    if sizes:
        console.print_table(console.out, report.size_table())
    if mitsuba:
        console.print_table(console.out, report.rival_table())
        console.print_table(console.out, criteria_table(report.criteria()))
    if json_out:
        write_json(json_out, report.to_json())
