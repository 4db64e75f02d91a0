"""`roomlight bench hostile`: what a neighbour keeps while another client attacks the server."""

from pathlib import Path
from typing import Annotated

import typer

from roomlight.files import write_atomic, write_json
from roomlight_bench.server.hostile import HostileOptions, run_hostile
from roomlight_bench.server.hostile_client import ATTACKS
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app

app = single_command_app()


@app.command("hostile")
def bench_hostile(
    minutes: Annotated[float, typer.Option(min=0.05, max=600, help="Duration of the whole run.")] = 10.0,
    attack: Annotated[
        list[str] | None, typer.Option(help=f"Run this attack alone; repeatable. One of {', '.join(ATTACKS)}.")
    ] = None,
    fps: Annotated[float, typer.Option(min=0.1, max=60, help="Frames per second of the neighbour.")] = 2.0,
    model: arguments.Model = "auto",
    json_out: arguments.FiguresJson = None,
    markdown_out: Annotated[
        Path | None, typer.Option("--markdown", help="Also write the table of the documentation.")
    ] = None,
) -> None:
    """Attack a server on this machine while a neighbour streams: frames that it keeps, latency, memory."""
    unknown = [name for name in attack or () if name not in ATTACKS]
    if unknown:
        raise typer.BadParameter(f"unknown attack {unknown[0]!r}; one of {', '.join(ATTACKS)}", param_hint="--attack")
    options = HostileOptions(minutes=minutes, attacks=tuple(attack or ATTACKS), fps=fps, model=model)
    with console.err.status("measuring") as status:
        report = run_hostile(options, progress=status.update)
    console.print_table(console.out, report.table())
    if json_out:
        write_json(json_out, report.to_json())
    if markdown_out:
        write_atomic(markdown_out, report.markdown().encode())
