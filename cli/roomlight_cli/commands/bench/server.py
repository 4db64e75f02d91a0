"""`roomlight bench server` and `hostile`: real servers on this machine."""

from roomlight_bench.server.hostile import HostileOptions, run_hostile
from roomlight_bench.server.server import ServerBenchOptions, run_server_bench
from roomlight_cli.console import show_scores
from roomlight_cli.progress import Progress
from roomlight_cli.shared_options import FiguresJson


def server(options: ServerBenchOptions, *, json: FiguresJson = None) -> None:
    """Load a server on this machine with streaming phones, beside direct engine calls (2 minutes).

    Args:
        options: What to measure.
    """
    with Progress("measuring") as progress:
        report = run_server_bench(options, progress=progress.say)
    show_scores(report, json, *report.tables())


def hostile(options: HostileOptions, *, json: FiguresJson = None) -> None:
    """Attack a server on this machine while a neighbour streams: frames that it keeps, latency, memory.

    Args:
        options: What to measure.
    """
    with Progress("measuring") as progress:
        report = run_hostile(options, progress=progress.say)
    show_scores(report, json, *report.tables())
