"""`roomlight light`: HDR light at points of a room, from one photograph with depth."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from roomlight.engine.session import choose_graphs, warm_up
from roomlight_cli import arguments
from roomlight_cli.console import err, out, print_notes, say
from roomlight_cli.lazy import single_command_app
from roomlight_cli.photo import DepthOrientation, Photo, PhotoLight, light_photo, photo_positions, read_photo
from roomlight_cli.probe_notes import percent, position_text, probe_warnings

app = single_command_app()


@app.command()
def light(
    image: Annotated[Path, typer.Argument(help="The photograph: JPEG, PNG, or linear EXR.")],
    depth: Annotated[
        Path,
        typer.Option(help="Its depth: 16-bit PNG in millimetres, EXR in metres, or .npy (integers: mm, floats: m)."),
    ],
    folder: Annotated[Path, typer.Option("--out", help="Folder for panoramas and pictures.")],
    probe: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,Z",
            rich_help_panel=arguments.POINTS_PANEL,
            help="Light this point: metres from the camera, x right, y up, z backward (negative in front). Repeatable.",
        ),
    ] = None,
    pixel: Annotated[
        list[str] | None,
        typer.Option(
            metavar="U,V",
            rich_help_panel=arguments.POINTS_PANEL,
            help="Light a point above the surface that this pixel of the upright photo shows: column U, row V from the "
            "top left. Repeatable.",
        ),
    ] = None,
    above: arguments.Above = 0.1,
    fov: Annotated[
        float | None,
        typer.Option(
            min=5,
            max=150,
            help="Horizontal field of view of the upright photo in degrees. Default: by the focal length in its EXIF, "
            "else 60.",
        ),
    ] = None,
    depth_unit: Annotated[
        float | None, typer.Option(min=1e-6, max=1000, help="Metres per stored unit of a PNG or .npy.")
    ] = None,
    depth_orientation: Annotated[
        DepthOrientation,
        typer.Option(
            help="For a photo that EXIF rotates: whether the depth is upright, as viewers show the photo, or has its "
            "stored rows and columns. auto decides by the aspect."
        ),
    ] = "auto",
    height: Annotated[
        int, typer.Option(min=16, max=2048, help="Panorama height in pixels; the width is twice that.")
    ] = 120,
    model: arguments.Model = "auto",
    weights: arguments.Weights = None,
    provider: arguments.Runtime = "auto",
    unknown_depth: arguments.UnknownDepthOption = "rim",
    parts: arguments.Parts = None,
) -> None:
    """Light points of one photograph that has depth.

    Each point gets an HDR panorama (EXR and PNG), a picture of a mirror sphere and a glossy sphere, and its main light.
    """
    if not probe and not pixel:
        raise typer.BadParameter("give the points to light: --pixel U,V of the photo, or --probe X,Y,Z in metres")
    positions = [arguments.parse_position(text) for text in probe or ()]
    pixels = [arguments.parse_pixel(text) for text in pixel or ()]
    options = arguments.session_options(
        model=model,
        weights=weights,
        provider=provider,
        unknown_depth=unknown_depth,
        parts=parts,
        height=height,
    )
    photo = read_photo(image, depth, fov_deg=fov, depth_unit_m=depth_unit, depth_orientation=depth_orientation)
    positions = photo_positions(photo.frame, positions, pixels, above_m=above)
    graphs = choose_graphs(options)
    print_notes(photo.notes)
    _print_field_of_view(photo)
    with err.status("estimating the light"):
        warm_up()
        lights = light_photo(photo.frame, positions, folder, options=options, graphs=graphs)
    for one in lights:
        _print_light(one)
    panorama, _, spheres = lights[0].files
    say(f"Picture: {folder / spheres}; panorama: {folder / panorama}; figures: {folder / 'light.json'}")


def _print_field_of_view(photo: Photo) -> None:
    sources = {
        "option": "from --fov",
        "exif": f"from the focal length in EXIF, {photo.focal_35mm or 0:g} mm on 35 mm film",
        "default": "the default",
    }
    say(f"field of view {photo.fov_deg:.1f} degrees, horizontal: {sources[photo.fov_source]}")
    if photo.fov_source == "default":
        out.print(
            "[yellow]warning:[/] the photo does not state its focal length; give --fov, or distances are distorted",
            soft_wrap=True,
        )


def _print_light(one: PhotoLight) -> None:
    coverage = one.light.coverage
    say(f"{position_text(one.position)}: {percent(coverage)} of the sphere around it is in the photograph")
    for warning in probe_warnings(coverage, inside_volume=one.inside_volume, behind_camera=one.behind_camera):
        out.print(f"  [yellow]warning:[/] {escape(warning)}", soft_wrap=True)
    say(f"  {_main_light_text(one)}")


def _main_light_text(one: PhotoLight) -> str:
    red, green, blue = one.light.main_light.intensity.tolist()
    if not any((red, green, blue)):
        return "no main light: it comes evenly from all directions"
    elevation, azimuth = one.heading
    return (
        f"main light {abs(elevation):.0f} degrees {'above' if elevation >= 0 else 'below'} the horizon, "
        f"{abs(azimuth):.0f} degrees to the {'right' if azimuth >= 0 else 'left'} of the view; "
        f"intensity {red:.3g} {green:.3g} {blue:.3g} (RGB)"
    )
