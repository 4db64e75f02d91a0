"""`roomlight bench server`: a real server under load."""

from typing import Annotated

import typer

from roomlight.files import write_json
from roomlight_bench.server.server import ServerBenchOptions, run_server_bench
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app

app = single_command_app()


@app.command("server")
def bench_server(
    sessions: Annotated[
        str, typer.Option(help="Numbers of sessions at the same time, separated by commas: a row each.")
    ] = "1,4,16,64",
    seconds: Annotated[float, typer.Option(min=0.5, max=3600, help="Seconds of streaming for each row.")] = 12.0,
    fps: Annotated[float, typer.Option(min=0.1, max=60, help="Frames per second that each phone sends.")] = 3.0,
    model: arguments.Model = "auto",
    weights: arguments.Weights = None,
    json_out: arguments.FiguresJson = None,
) -> None:
    """Load a server on this machine with streaming phones, beside direct engine calls (3 minutes)."""
    options = ServerBenchOptions(
        sessions=arguments.parse_counts(sessions),
        seconds=seconds,
        fps=fps,
        model=model,
        weights=weights,
    )
    with console.err.status("measuring") as status:
        report = run_server_bench(options, progress=status.update)
    console.print_table(console.out, report.table())
    if json_out:
        write_json(json_out, report.to_json())
