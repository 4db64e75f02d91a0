"""`roomlight stream`: a recording played to a server, with rate, latency and light on the terminal."""

import asyncio
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import RenderableType
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from roomlight.errors import RoomLightError
from roomlight_cli.console import err, out, print_notes, remark, say
from roomlight_cli.options import Flag
from roomlight_cli.probe_notes import percent, probe_warnings
from roomlight_cli.progress import Progress
from roomlight_cli.shared_options import Token, print_recovery
from roomlight_cli.stream import StreamOptions, Tally
from roomlight_cli.stream import stream as play
from roomlight_client import AsyncClient


def stream(
    capture: Path,
    options: StreamOptions,
    *,
    server: Annotated[str, Flag(metavar="URL")] = "http://localhost:8090",
    token: Token = None,
) -> None:
    """Play a recording to a server as a phone would stream it; show rate, latency and light.

    Args:
        capture: A recorded capture: a folder or its zip, a file (.r3d, .sens, .bag, .mcap), or a video.
        options: What to play.
        server: The server's address.
        token: The server's.
    """
    tally, stopped = Tally(), False

    async def streamed(show: Callable[[Tally], object]) -> None:
        async with AsyncClient(server, token=token, on_recovery=print_recovery) as client:
            await play(capture, client, options, tally=tally, show=show)

    with _live_tally(tally) as show:
        try:
            asyncio.run(streamed(show))
        except KeyboardInterrupt:
            stopped = True
        except RoomLightError:
            if tally.sent:
                _print_result(tally, options)
            raise
    _print_result(tally, options)
    if stopped:
        err.print("stopped; " + ("the session stays" if options.keep else "the session is deleted"), soft_wrap=True)
        raise typer.Exit(130)


@contextmanager
def _live_tally(tally: Tally) -> Generator[Callable[[Tally], None]]:
    """Yield what shows the tally: as a table on a terminal, else as lines of progress."""
    if err.is_interactive:
        with Live(_live_table(tally), console=err, transient=True, refresh_per_second=4) as live:
            yield lambda now: live.update(_live_table(now))
    else:
        with Progress("streaming") as progress:
            yield lambda now: progress.count(now.due, now.frames)


def _live_table(tally: Tally) -> RenderableType:
    table = Table.grid(padding=(0, 2))
    rate = f"{tally.due} of {tally.frames}, {tally.rate(time.perf_counter()):.1f} per second"
    for name, value in (("frames", rate), *_rows(tally)):
        table.add_row(name, escape(value))
    return table


def _print_result(tally: Tally, options: StreamOptions) -> None:
    say(f"{tally.sent} of {tally.frames} frames sent, {tally.processed} in the light")
    for name, value in _rows(tally):
        say(f"  {name}: {value}")
    for warning in probe_warnings(tally.light.coverage) if tally.light else ():
        remark("  warning:", warning, out)
    print_notes(tally.notes)
    for reason in tally.reasons:
        remark("refused", reason)
    if options.keep and tally.session_id:
        say(f"The session stays: {tally.session_id}")


def _rows(tally: Tally) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for name, values in (("frame latency", tally.frame_ms), ("light latency", tally.light_ms)):
        if values:
            median, high = np.percentile(values, (50, 95))
            rows.append((name, f"{median:.0f} ms (median), {high:.0f} ms (95 %)"))
    counts = {
        "dropped here": tally.dropped,
        "superseded": tally.superseded,
        "server busy": tally.busy,
        "overtaken": tally.overtaken,
        "refused": tally.refused,
        "lost": tally.lost,
        "unreadable": tally.unreadable,
    }
    missing = ", ".join(f"{count} {outcome}" for outcome, count in counts.items() if count)
    rows.append(("not in the light", missing or "none"))
    if tally.pace < 0.95:
        rows.append(("pace", f"{tally.pace:.2f} of the recording's: reading it does not keep up"))
    light = tally.light
    if light is not None:
        main = light.main_light
        x, y, z = main.direction.tolist()
        red, green, blue = (light.harmonics.coefficients[0] * 0.2820948).tolist()  # the constant harmonic's value
        rows.append(
            ("light", f"{percent(light.coverage)} of the sphere seen, mean ({red:.2f}, {green:.2f}, {blue:.2f})")
        )
        red, green, blue = main.intensity.tolist()
        rows.append(
            ("main light", f"({red:.2f}, {green:.2f}, {blue:.2f}) from direction ({x:+.2f}, {y:+.2f}, {z:+.2f})")
        )
    return rows
