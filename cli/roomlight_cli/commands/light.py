"""`roomlight light`: HDR light at points of a room, from one photograph, with its depth or without."""

from pathlib import Path

from rich.markup import escape

from roomlight.captures.photo import Photo, PhotoOptions, read_photo
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.session import warm_up
from roomlight.light.sources import FileFormat
from roomlight_cli.console import out as terminal
from roomlight_cli.console import print_notes, say
from roomlight_cli.photo import PhotoLight, PhotoPoints, light_photo
from roomlight_cli.probe_notes import percent, position_text, probe_warnings
from roomlight_cli.progress import Progress
from roomlight_cli.shared_options import LightOptions


def light(
    image: Path,
    points: PhotoPoints,
    reading: PhotoOptions,
    options: LightOptions,
    *,
    out: Path,
    depth: Path | None = None,
    forms: tuple[FileFormat, ...] = (),
) -> None:
    """Light points of one photograph; depth that is not given is estimated.

    Each point gets an HDR panorama (EXR and PNG), a picture of a mirror sphere and a glossy sphere, and its main light.

    Args:
        image: The photograph: JPEG, PNG, HEIC, or linear EXR.
        points: Where to light.
        reading: How to read the photograph.
        options: How to estimate the light.
        out: Folder for panoramas and pictures.
        depth: Its depth: 16-bit PNG in millimetres, EXR in metres, or .npy (integers: mm, floats: m). Default: the
            depth map inside a HEIC portrait, else estimated.
        forms: Also write the light in this form: usdz, glb, ktx2, ... Repeatable.
    """
    photo = read_photo(image, depth, reading)
    positions = points.positions(photo.frame)
    graphs = choose_graphs(options)
    _print_field_of_view(photo)
    print_notes(photo.notes)
    with Progress("estimating the light"):
        warm_up()
        lights = light_photo(photo.frame, positions, out, options=options, graphs=graphs, forms=forms)
    for lit in lights:
        _print_light(lit)
    panorama, _, spheres = lights[0].files
    say(f"Picture: {out / spheres}; panorama: {out / panorama}; figures: {out / 'light.json'}")


def _print_field_of_view(photo: Photo) -> None:
    sources = {
        "option": "from --fov",
        "depth": "from the calibration of the photo's depth",
        "exif": f"from the focal length in EXIF, {photo.focal_35mm or 0:g} mm on 35 mm film",
        "default": "the default",
    }
    say(f"field of view {photo.fov_deg:.1f} degrees, horizontal: {sources[photo.fov_source]}")
    if photo.fov_source == "default":
        terminal.print(
            "[yellow]warning:[/] the photo does not state its focal length; give --fov, or distances are distorted",
            soft_wrap=True,
        )


def _print_light(lit: PhotoLight) -> None:
    coverage = lit.light.coverage
    say(f"{position_text(lit.position)}: {percent(coverage)} of the sphere around it is in the photograph")
    for warning in probe_warnings(coverage, inside_volume=lit.inside_volume, behind_camera=lit.behind_camera):
        terminal.print(f"  [yellow]warning:[/] {escape(warning)}", soft_wrap=True)
    say(f"  {_main_light_text(lit)}")


def _main_light_text(lit: PhotoLight) -> str:
    red, green, blue = lit.light.main_light.intensity.tolist()
    if not any((red, green, blue)):
        return "no main light: it comes evenly from all directions"
    elevation, azimuth = lit.heading
    return (
        f"main light {abs(elevation):.0f} degrees {'above' if elevation >= 0 else 'below'} the horizon, "
        f"{abs(azimuth):.0f} degrees to the {'right' if azimuth >= 0 else 'left'} of the view; "
        f"intensity {red:.3g} {green:.3g} {blue:.3g} (RGB)"
    )
