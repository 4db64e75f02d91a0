"""`roomlight bench capacity`: machines for a number of phones."""

from typing import Annotated

import typer

from roomlight.files import write_json
from roomlight_bench.server.capacity import Assumptions, run_capacity
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app

app = single_command_app()


@app.command("capacity")
def bench_capacity(
    fps: Annotated[float, typer.Option(min=0.01, max=60, help="Frames per second that a phone sends.")] = 3.0,
    cores: Annotated[int, typer.Option(min=1, max=1024, help="Cores of a machine.")] = 16,
    memory_gb: Annotated[float, typer.Option(min=0.5, max=10_000, help="Memory of a machine for sessions, GB.")] = 48.0,
    load: Annotated[float, typer.Option(min=0.05, max=1, help="Share of a machine's time that is planned for.")] = 0.6,
    ratio: Annotated[
        float, typer.Option(min=1, max=10, help="Time of a frame through the front (`roomlight bench replicas`).")
    ] = 1.0,
    state_interval_s: Annotated[
        float, typer.Option(min=0, max=3600, help="The servers' --state-interval-s; 0: sessions are not saved.")
    ] = 5.0,
    model: arguments.Model = "classical",
    seconds: Annotated[float, typer.Option(min=0.5, max=3600, help="Seconds of sending.")] = 12.0,
    json_out: arguments.FiguresJson = None,
) -> None:
    """Compute the machines for 100, 10,000 and a million phones from what a server does here (half a minute)."""
    assumed = Assumptions(
        fps=fps,
        cores=cores,
        memory_bytes=1e9 * memory_gb,
        load=load,
        proxy_ratio=ratio,
        state_interval_s=state_interval_s,
    )
    with console.err.status("measuring") as status:
        report = run_capacity((100, 10_000, 1_000_000), assumed, model=model, seconds=seconds, progress=status.update)
    console.print_table(console.out, report.table())
    if json_out:
        write_json(json_out, report.to_json())
