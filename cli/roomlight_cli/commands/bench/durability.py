"""`roomlight bench durability`: what is lost when a server is killed while a client streams."""

from typing import Annotated

import typer

from roomlight.files import write_json
from roomlight_bench.server.durability import DurabilityOptions, run_durability
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app

app = single_command_app()


@app.command("durability")
def bench_durability(
    kills: Annotated[int, typer.Option(min=1, max=100_000, help="Times that the server is killed.")] = 200,
    interval_s: Annotated[float, typer.Option(min=0.1, max=60, help="The server's --state-interval-s.")] = 2.0,
    longest_s: Annotated[
        float, typer.Option(min=0.1, max=600, help="Kill after up to this many seconds of new frames.")
    ] = 4.0,
    height: Annotated[int, typer.Option(min=16, max=512, help="Rows of the panoramas.")] = 48,
    model: arguments.Model = "classical",
    seed: Annotated[int, typer.Option(help="Seed of the random times.")] = 1,
    json_out: arguments.FiguresJson = None,
) -> None:
    """Kill a server on this machine while a client streams: frames that are lost, light, time to restore."""
    options = DurabilityOptions(
        model=model, kills=kills, interval_s=interval_s, longest_s=longest_s, height=height, seed=seed
    )
    with console.err.status("measuring") as status:
        report = run_durability(options, progress=status.update)
    console.print_table(console.out, report.table())
    if json_out:
        write_json(json_out, report.to_json())
    if not report.holds:
        raise typer.Exit(1)
