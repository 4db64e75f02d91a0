"""`roomlight replay`: light at points of a recorded capture, frame by frame."""

from pathlib import Path
from typing import Annotated

import typer

from roomlight_cli import arguments
from roomlight_cli.lazy import single_command_app
from roomlight_cli.replays.replay_options import ReplayOptions
from roomlight_cli.replays.replay_run import run_replay
from roomlight_cli.server_options import Server, Token, refuse_local_model

app = single_command_app()


@app.command()
def replay(
    capture: Annotated[Path, typer.Argument(help="A recorded capture: a folder, or a Record3D .r3d file.")],
    out: Annotated[Path, typer.Option(help="Folder for panoramas, pictures and the report.")],
    probe: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,Z",
            rich_help_panel=arguments.POINTS_PANEL,
            help="Light this point: world metres, y up. Repeatable. Default: one point in front of the first camera.",
        ),
    ] = None,
    pixel: arguments.Pixels = None,
    above: arguments.Above = 0.1,
    probes_from_capture: Annotated[
        bool,
        typer.Option(
            "--probes-from-capture",
            rich_help_panel=arguments.POINTS_PANEL,
            help="Light the positions of the capture's own probes.",
        ),
    ] = False,
    model: arguments.Model = "auto",
    weights: arguments.Weights = None,
    provider: arguments.Runtime = "auto",
    unknown_depth: arguments.UnknownDepthOption = "rim",
    parts: arguments.Parts = None,
    height: Annotated[
        int, typer.Option(min=16, max=2048, help="Panorama height in pixels; the width is twice that.")
    ] = 120,
    every: Annotated[int, typer.Option(min=1, help="Process every n-th frame only.")] = 1,
    interpolate: Annotated[
        bool, typer.Option("--interpolate", help="With --every: interpolate the frames in between.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace what --out holds, also this replay if it is finished.")
    ] = False,
    server: Server = None,
    token: Token = None,
    format_name: arguments.Format = None,
    depth_key: arguments.DepthKey = None,
    depth_unit: arguments.DepthUnit = None,
    min_confidence: arguments.MinConfidence = None,
    camera_convention: arguments.CameraAxes = None,
    pose_direction: arguments.PoseMaps = None,
    world_up: arguments.WorldUp = None,
    max_frames: arguments.MaxFrames = None,
) -> None:
    """Light points of a recording: an HDR panorama per frame, pictures, a video, a report.

    Interrupted, the same command continues. Finished, it says so and returns at once, unless the recording, the
    weights or the results have changed since.
    """
    if (probe or pixel) and probes_from_capture:
        raise typer.BadParameter("--probes-from-capture excludes --probe and --pixel: give either")
    if interpolate and every == 1:
        raise typer.BadParameter("--interpolate fills in the frames that --every leaves out: add --every 2 or more")
    options = ReplayOptions(
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
        session=arguments.session_options(
            model=model,
            weights=weights,
            provider=provider,
            unknown_depth=unknown_depth,
            parts=parts,
            height=height,
        ),
        probes=tuple(arguments.parse_position(text) for text in probe or ()),
        pixels=tuple(arguments.parse_pixel(text) for text in pixel or ()),
        above_m=above,
        probes_from_capture=probes_from_capture,
        every=every,
        interpolate=interpolate,
        overwrite=overwrite,
        server=server,
    )
    if server:
        refuse_local_model(server, options.session)
    run_replay(capture, out, options, token=token)
