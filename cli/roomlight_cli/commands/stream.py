"""`roomlight stream`, and what a command needs to reach a server. Registered by `cli`."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.markup import escape

from roomlight.errors import RoomLightError
from roomlight_cli import arguments as given
from roomlight_cli.console import err, out, say

if TYPE_CHECKING:
    from rich.console import RenderableType

    from roomlight.engine.session import SessionOptions
    from roomlight_cli.stream import StreamOptions, Tally

Server = Annotated[
    str | None, typer.Option(metavar="URL", help="Let a `roomlight serve` there do the work, e.g. http://host:8090.")
]
Token = Annotated[
    str | None,
    typer.Option(
        envvar="ROOMLIGHT_TOKEN", show_default=False, help="The server's bearer token; best as ROOMLIGHT_TOKEN."
    ),
]


def refuse_local_model(server: str, session: "SessionOptions") -> None:
    """Options of the engine here mean nothing to one elsewhere: typer's own error."""
    if session.weights is not None or session.provider != "auto" or session.allow_untrained:
        raise typer.BadParameter(
            "--weights, --provider and --allow-untrained are the server's own: give them to the `roomlight serve` "
            f"at {server}"
        )


def stream(
    capture: Annotated[Path, typer.Argument(help="A recorded capture: a folder, or a Record3D .r3d file.")],
    server: Annotated[str, typer.Option(metavar="URL", help="The server's address.")] = "http://localhost:8090",
    token: Token = None,
    fps: Annotated[
        float | None,
        typer.Option(
            help="Frames sent a second; the recording keeps its pace. Without times of its own this is the pace (3)."
        ),
    ] = None,
    probe: Annotated[
        str | None, typer.Option(help="A point X,Y,Z in world metres (y up) whose light is shown.")
    ] = None,
    colour: Annotated[
        Literal["jpeg", "png", "exact"], typer.Option(help="How frames travel: as a phone's, lossless, or as floats.")
    ] = "jpeg",
    in_flight: Annotated[int, typer.Option(min=1, help="Frames on their way at once; others that are due drop.")] = 2,
    session: Annotated[str | None, typer.Option(metavar="ID", help="Play into this session.")] = None,
    keep: Annotated[bool, typer.Option("--keep", help="Leave the session on the server at the end.")] = False,
    mode: Annotated[Literal["auto", "classical", "single", "video"], typer.Option(help="The model.")] = "auto",
    height: Annotated[int, typer.Option(min=16, max=512, help="Panorama height in pixels.")] = 120,
    format_name: given.Format = None,
    depth_key: given.DepthKey = None,
    depth_unit: given.DepthUnit = None,
    min_confidence: given.MinConfidence = None,
    camera_convention: given.CameraAxes = None,
    pose_direction: given.PoseMaps = None,
    world_up: given.WorldUp = None,
    max_frames: given.MaxFrames = None,
) -> None:
    """Play a recording to a server at its real pace, as a phone would stream it, and show rate, latency and light."""
    from roomlight_cli.stream import StreamOptions

    _play(
        capture,
        server,
        token,
        StreamOptions(
            capture=given.capture_options(
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
            probe=given.parse_position(probe) if probe else None,
            session_id=session,
            keep=keep,
            mode=mode,
            height=height,
        ),
    )


def _play(path: Path, server: str, token: str | None, options: "StreamOptions") -> None:
    from rich.live import Live

    from roomlight_cli.stream import Tally
    from roomlight_cli.stream import stream as play
    from roomlight_client import AsyncClient

    tally = Tally()

    async def run(live: Live) -> None:
        async with AsyncClient(server, token=token) as client:
            await play(path, client, options, tally=tally, show=lambda now: live.update(_picture(now)))

    stopped = False
    with Live(_picture(tally), console=err, transient=True, refresh_per_second=4) as live:
        try:
            asyncio.run(run(live))
        except KeyboardInterrupt:
            stopped = True
        except RoomLightError:
            live.stop()
            if tally.sent:
                _tell(tally, options)
            raise
    _tell(tally, options)
    if stopped:
        err.print("stopped; " + ("the session stays" if options.keep else "the session is deleted"), soft_wrap=True)
        raise typer.Exit(130)


def _picture(tally: "Tally") -> "RenderableType":
    import time

    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    rows = [("frames", f"{tally.due} of {tally.frames}, {tally.rate(time.perf_counter()):.1f} a second"), *_rows(tally)]
    for name, value in rows:
        table.add_row(name, escape(value))
    return table


def _tell(tally: "Tally", options: "StreamOptions") -> None:
    out.print(f"{tally.sent} of {tally.frames} frames sent, {tally.processed} in the light", soft_wrap=True)
    for name, value in _rows(tally):
        say(f"  {name}: {value}")
    for reason in tally.reasons:
        err.print(f"[yellow]refused[/] {escape(reason)}", soft_wrap=True)
    if options.keep and tally.session_id:
        say(f"The session stays: {tally.session_id}")


def _rows(tally: "Tally") -> list[tuple[str, str]]:
    """What is worth saying by now, as (name, value)."""
    from roomlight_cli.stream import percentile_ms

    rows: list[tuple[str, str]] = []
    for name, values in (("latency", tally.frame_ms), ("light's latency", tally.light_ms)):
        half, most = percentile_ms(values, 0.5), percentile_ms(values, 0.95)
        if half is not None and most is not None:
            rows.append((name, f"{half:.0f} ms (median), {most:.0f} ms (95 %)"))
    fates = {
        "dropped here": tally.dropped,
        "superseded": tally.superseded,
        "server busy": tally.busy,
        "overtaken": tally.overtaken,
        "refused": tally.refused,
        "lost": tally.lost,
        "unreadable": tally.unreadable,
    }
    missing = ", ".join(f"{count} {fate}" for fate, count in fates.items() if count)
    rows.append(("not in the light", missing or "none"))
    if tally.pace < 0.95:
        rows.append(("pace", f"{tally.pace:.2f} of the recording's: reading it does not keep up"))
    light = tally.light
    if light is not None:
        main = light.main_light
        x, y, z = main.direction.tolist()
        red, green, blue = (light.harmonics.coefficients[0] * 0.2820948).tolist()  # the constant harmonic's value
        rows.append(("light", f"{light.coverage:.0%} seen, mean ({red:.2f}, {green:.2f}, {blue:.2f})"))
        red, green, blue = main.intensity.tolist()
        rows.append(
            ("main light", f"({red:.2f}, {green:.2f}, {blue:.2f}) from direction ({x:+.2f}, {y:+.2f}, {z:+.2f})")
        )
    return rows
