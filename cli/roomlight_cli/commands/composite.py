"""`roomlight composite`: virtual objects in a recording, as pictures or as a film."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from roomlight.compositing.placement.scene import load_scene
from roomlight.compositing.recordings import SHAPE_SIZE_M
from roomlight_cli import arguments
from roomlight_cli.compositing import Output, composite_recording, film_rate, one_object
from roomlight_cli.console import say
from roomlight_cli.lazy import single_command_app

app = single_command_app()
_OBJECT_PANEL = "One object"


@app.command()
def composite(
    capture: Annotated[Path, typer.Argument(help="A recorded capture: a folder, or a Record3D .r3d file.")],
    out: Annotated[Path, typer.Option(help="A folder for pictures, or a film: a file that ends with .mp4.")],
    scene: Annotated[Path | None, typer.Option(help="The objects: a scene.json.")] = None,
    object_file: Annotated[
        str | None,
        typer.Option(
            "--object",
            metavar="FILE|SHAPE",
            rich_help_panel=_OBJECT_PANEL,
            help=f"A GLB, glTF, OBJ or PLY file, or {', '.join(SHAPE_SIZE_M)}.",
        ),
    ] = None,
    pixel: Annotated[
        str | None,
        typer.Option(
            metavar="U,V",
            rich_help_panel=_OBJECT_PANEL,
            help="Put the object on the surface that this pixel of the first frame shows: column U, row V.",
        ),
    ] = None,
    material: Annotated[
        Literal["diffuse", "glossy", "metal", "mirror", "glass"] | None,
        typer.Option(rich_help_panel=_OBJECT_PANEL, help="Replaces the materials of the file."),
    ] = None,
    size: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            rich_help_panel=_OBJECT_PANEL,
            help="Longest side in metres. Default: the file's own size; 0.2 for a sphere, 0.85 for a chair.",
        ),
    ] = None,
    yaw: Annotated[
        float, typer.Option(rich_help_panel=_OBJECT_PANEL, help="Turn about the surface, in degrees.")
    ] = 0.0,
    up: Annotated[
        Literal["y", "z"], typer.Option(rich_help_panel=_OBJECT_PANEL, help="Axis of the file that points up.")
    ] = "y",
    quality: Annotated[
        Literal["preview", "good", "final"], typer.Option(help="preview for speed, final for noise-free pictures.")
    ] = "good",
    picture_format: Annotated[
        Literal["png", "jpeg", "exr"], typer.Option("--picture", help="Format of the pictures; exr is linear.")
    ] = "png",
    layers: Annotated[
        bool, typer.Option("--layers", help="Also write objects, alpha, shadow and depth of each frame apart.")
    ] = False,
    fps: Annotated[
        float | None,
        typer.Option(min=0.1, max=240, help="Frames a second of the film. Default: the recording's, or 30."),
    ] = None,
    online: Annotated[
        bool,
        typer.Option(
            "--online", help="Light each frame by the frames up to it, as an app would, instead of the whole recording."
        ),
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the film or the pictures in --out.")] = False,
    every: Annotated[int, typer.Option(min=1, help="Use every n-th frame only.")] = 1,
    model: arguments.Model = "auto",
    weights: arguments.Weights = None,
    provider: arguments.Runtime = "auto",
    unknown_depth: arguments.UnknownDepthOption = "rim",
    parts: arguments.Parts = None,
    height: Annotated[int, typer.Option(min=16, max=2048, help="Height in pixels of the panoramas of light.")] = 120,
    format_name: arguments.Format = None,
    depth_key: arguments.DepthKey = None,
    depth_unit: arguments.DepthUnit = None,
    min_confidence: arguments.MinConfidence = None,
    camera_convention: arguments.CameraAxes = None,
    pose_direction: arguments.PoseMaps = None,
    world_up: arguments.WorldUp = None,
    max_frames: arguments.MaxFrames = None,
) -> None:
    """Put virtual objects into a recording: lit by the room, with shadows, hidden by real things in front.

    Example: roomlight composite my-capture --object sphere --material mirror --pixel 320,260 --out film.mp4
    """
    if (scene is None) == (object_file is None):
        raise typer.BadParameter("give either --scene scene.json, or --object with --pixel")
    single = {"--pixel": pixel, "--material": material, "--size": size}
    if scene is not None and any(value is not None for value in single.values()):
        given = ", ".join(name for name, value in single.items() if value is not None)
        raise typer.BadParameter(f"{given}: belongs to --object; with --scene, write it into {scene}")
    output = Output(out, picture_format, layers=layers, overwrite=overwrite)
    if scene is not None:
        objects = load_scene(scene)
    else:
        objects = one_object(object_file or "", pixel, size_m=size, material=material, yaw_degrees=yaw, up=up)
    options = arguments.session_options(
        model=model,
        weights=weights,
        provider=provider,
        unknown_depth=unknown_depth,
        parts=parts,
        height=height,
    )
    recording = arguments.capture_options(
        format_name=format_name,
        depth_key=depth_key,
        depth_unit=depth_unit,
        min_confidence=min_confidence,
        camera_convention=camera_convention,
        pose_direction=pose_direction,
        world_up=world_up,
        max_frames=max_frames,
        every=every,
    )
    done = composite_recording(
        (capture, recording), objects, output, quality=quality, online=online, options=options, rate=film_rate(fps)
    )
    say(done)
