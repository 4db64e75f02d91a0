"""`roomlight stream`: a recording played to a server, with rate, latency and light on the terminal."""

import asyncio
import time
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import RenderableType
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from roomlight.errors import RoomLightError
from roomlight_cli import arguments
from roomlight_cli.console import err, out, print_notes, say
from roomlight_cli.lazy import single_command_app
from roomlight_cli.probe_notes import percent, probe_warnings
from roomlight_cli.server_options import Token, recovery_line
from roomlight_cli.stream import StreamOptions, Tally, percentile_ms
from roomlight_cli.stream import stream as play
from roomlight_client import AsyncClient, RecoveryEvent

app = single_command_app()


@app.command()
def stream(
    capture: Annotated[Path, typer.Argument(help="A recorded capture: a folder, or a Record3D .r3d file.")],
    server: Annotated[str, typer.Option(metavar="URL", help="The server's address.")] = "http://localhost:8090",
    token: Token = None,
    fps: Annotated[
        float | None,
        typer.Option(
            help="Frames sent per second; the recording keeps its pace. For a recording without timestamps this is the "
            "pace (default: 3)."
        ),
    ] = None,
    probe: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            rich_help_panel=arguments.POINTS_PANEL,
            help="Show the light at this point: world metres, y up. Default: one point in front of the first camera.",
        ),
    ] = None,
    pixel: Annotated[
        str | None,
        typer.Option(
            metavar="U,V",
            rich_help_panel=arguments.POINTS_PANEL,
            help="Show the light above the surface that this pixel of the first colour image shows: column U, row V "
            "from the top left.",
        ),
    ] = None,
    above: arguments.Above = 0.1,
    colour: Annotated[
        Literal["jpeg", "png", "exact"],
        typer.Option(help="How frames travel: jpeg as from a phone, png without loss, exact as floats."),
    ] = "jpeg",
    in_flight: Annotated[
        int, typer.Option(min=1, help="Unanswered frames at the same time; other frames that are due are dropped.")
    ] = 2,
    session: Annotated[str | None, typer.Option(metavar="ID", help="Play into this session.")] = None,
    keep: Annotated[bool, typer.Option("--keep", help="Leave the session on the server at the end.")] = False,
    model: arguments.Model = "auto",
    height: Annotated[
        int, typer.Option(min=16, max=512, help="Panorama height in pixels; the width is twice that.")
    ] = 120,
    format_name: arguments.Format = None,
    depth_key: arguments.DepthKey = None,
    depth_unit: arguments.DepthUnit = None,
    min_confidence: arguments.MinConfidence = None,
    camera_convention: arguments.CameraAxes = None,
    pose_direction: arguments.PoseMaps = None,
    world_up: arguments.WorldUp = None,
    max_frames: arguments.MaxFrames = None,
) -> None:
    """Play a recording to a server as a phone would stream it; show rate, latency and light."""
    if probe and pixel:
        raise typer.BadParameter("a stream shows the light at one point: give --probe or --pixel, not both")
    options = StreamOptions(
        capture=arguments.capture_options(
            format_name=format_name,
            depth_key=depth_key,
            depth_unit=depth_unit,
            min_confidence=min_confidence,
            camera_convention=camera_convention,
            pose_direction=pose_direction,
            world_up=world_up,
            max_frames=max_frames,
        ),
        fps=fps,
        colour=colour,
        in_flight=in_flight,
        probe=arguments.parse_position(probe) if probe else None,
        pixel=arguments.parse_pixel(pixel) if pixel else None,
        above_m=above,
        session_id=session,
        keep=keep,
        model=model,
        height=height,
    )
    _play(capture, server, token, options)


def _play(path: Path, server: str, token: str | None, options: StreamOptions) -> None:
    tally = Tally()

    async def run(live: Live) -> None:
        def tell(event: RecoveryEvent) -> None:
            live.console.print(f"[yellow]{escape(recovery_line(event))}[/]", soft_wrap=True)

        async with AsyncClient(server, token=token, on_recovery=tell) as client:
            await play(path, client, options, tally=tally, show=lambda now: live.update(_live_table(now)))

    stopped = False
    with Live(_live_table(tally), console=err, transient=True, refresh_per_second=4) as live:
        try:
            asyncio.run(run(live))
        except KeyboardInterrupt:
            stopped = True
        except RoomLightError:
            live.stop()
            if tally.sent:
                _print_result(tally, options)
            raise
    _print_result(tally, options)
    if stopped:
        err.print("stopped; " + ("the session stays" if options.keep else "the session is deleted"), soft_wrap=True)
        raise typer.Exit(130)


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
        out.print(f"  [yellow]warning:[/] {escape(warning)}", soft_wrap=True)
    print_notes(tally.notes)
    for reason in tally.reasons:
        err.print(f"[yellow]refused[/] {escape(reason)}", soft_wrap=True)
    if options.keep and tally.session_id:
        say(f"The session stays: {tally.session_id}")


def _rows(tally: Tally) -> list[tuple[str, str]]:
    """Return what is known by now, as (name, value)."""
    rows: list[tuple[str, str]] = []
    for name, values in (("frame latency", tally.frame_ms), ("light latency", tally.light_ms)):
        median, high = percentile_ms(values, 0.5), percentile_ms(values, 0.95)
        if median is not None and high is not None:
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
