"""`roomlight bench server`, `hostile`, `durability`, `replicas` and `capacity`: real servers on this machine."""

from pathlib import Path
from typing import Annotated, Final

import typer
from annotated_types import Interval

from roomlight.files import write_atomic
from roomlight.wire.messages import ModelName
from roomlight_bench.server.capacity import Assumptions, run_capacity
from roomlight_bench.server.durability import DurabilityOptions, run_durability
from roomlight_bench.server.hostile import HostileOptions, run_hostile
from roomlight_bench.server.replicas import ReplicaBenchOptions, run_replica_bench
from roomlight_bench.server.server import ServerBenchOptions, run_server_bench
from roomlight_cli.console import show_report
from roomlight_cli.progress import Progress
from roomlight_cli.shared_options import FiguresJson

_PHONES: Final = (100, 10_000, 1_000_000)


def server(options: ServerBenchOptions, *, json: FiguresJson = None) -> None:
    """Load a server on this machine with streaming phones, beside direct engine calls (3 minutes).

    Args:
        options: What to measure.
    """
    with Progress("measuring") as progress:
        report = run_server_bench(options, progress=progress.say)
    show_report(report, json, report.table())


def hostile(options: HostileOptions, *, json: FiguresJson = None, markdown: Path | None = None) -> None:
    """Attack a server on this machine while a neighbour streams: frames that it keeps, latency, memory.

    Args:
        options: What to measure.
        markdown: Also write the table of the documentation.
    """
    with Progress("measuring") as progress:
        report = run_hostile(options, progress=progress.say)
    show_report(report, json, report.table())
    if markdown:
        write_atomic(markdown, report.markdown().encode())


def durability(options: DurabilityOptions, *, json: FiguresJson = None) -> None:
    """Kill a server on this machine while a client streams: frames that are lost, light, time to restore.

    Args:
        options: What to do.
    """
    with Progress("measuring") as progress:
        report = run_durability(options, progress=progress.say)
    show_report(report, json, report.table())
    if not report.holds:
        raise typer.Exit(1)


def replicas(options: ReplicaBenchOptions, *, json: FiguresJson = None) -> None:
    """Compare replicas under Ray Serve with a plain server on this machine (3 minutes; extra `ray`).

    Args:
        options: What to measure.
    """
    with Progress("measuring") as progress:
        report = run_replica_bench(options, progress=progress.say)
    show_report(report, json, report.table())


def capacity(
    assumed: Assumptions,
    *,
    model: ModelName = "classical",
    seconds: Annotated[float, Interval(ge=0.5, le=3600)] = 12.0,
    json: FiguresJson = None,
) -> None:
    """Compute the machines for 100, 10,000 and a million phones from what a server does here (half a minute).

    Args:
        assumed: What to assume.
        model: Model of the sessions.
        seconds: Seconds of sending.
    """
    with Progress("measuring") as progress:
        report = run_capacity(_PHONES, assumed, model=model, seconds=seconds, progress=progress.say)
    show_report(report, json, report.table())
