"""`roomlight bench replicas`: replicas under Ray Serve beside a plain server."""

from typing import Annotated

import typer

from roomlight.files import write_json
from roomlight_bench.server.replicas import ReplicaBenchOptions, run_replica_bench
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app

app = single_command_app()


@app.command("replicas")
def bench_replicas(
    replicas: Annotated[str, typer.Option(help="Numbers of replicas, separated by commas: a row each.")] = "1,2,3",
    phones: Annotated[int, typer.Option(min=1, max=1000, help="Phones that send at the same time.")] = 6,
    seconds: Annotated[float, typer.Option(min=0.5, max=3600, help="Seconds of sending, twice for each row.")] = 12.0,
    model: arguments.Model = "classical",
    json_out: arguments.FiguresJson = None,
) -> None:
    """Compare replicas under Ray Serve with a plain server on this machine (3 minutes; extra `ray`)."""
    options = ReplicaBenchOptions(
        replicas=arguments.parse_counts(replicas), phones=phones, seconds=seconds, model=model
    )
    with console.err.status("measuring") as status:
        report = run_replica_bench(options, progress=status.update)
    console.print_table(console.out, report.table())
    if json_out:
        write_json(json_out, report.to_json())
