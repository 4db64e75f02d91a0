"""`roomlight light`: HDR light at points of a room, from one photograph, with its depth or without, or from a video."""

import math
from collections.abc import Iterator
from dataclasses import fields
from itertools import chain
from pathlib import Path

from roomlight.captures import CaptureOptions, open_capture
from roomlight.captures.photo import Photo, PhotoOptions, read_photo
from roomlight.captures.recognition import VIDEOS
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.session import warm_up
from roomlight.errors import OptionError
from roomlight.frame import Frame
from roomlight.light.sources import SavedFormat
from roomlight_cli.console import out as terminal
from roomlight_cli.console import print_notes, print_skipped, remark, say
from roomlight_cli.photo import PhotoLight, PhotoPoints, check_output, light_photo
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
    forms: tuple[SavedFormat, ...] = (),
    overwrite: bool = False,
) -> None:
    """Light points of one photograph, or of a video without poses; what is not given is estimated.

    Each point gets an HDR panorama (EXR and PNG), a picture of a mirror sphere and a glossy sphere, and its main light.

    Args:
        image: The photograph: JPEG, PNG, WebP, TIFF, HEIC, or linear EXR. Or a video: MP4, MOV, MKV or WebM.
        points: Where to light.
        reading: How to read the photograph.
        options: How to estimate the light.
        out: Folder for panoramas and pictures.
        depth: Its depth along the view's axis: 16-bit PNG in millimetres, EXR in metres, or .npy or TIFF (integers: mm,
            floats: m). Default: the depth inside a HEIC portrait or an EXR, else estimated.
        forms: Also write the light in this form: usdz, glb, ktx2, ... Repeatable.
        overwrite: Replace the light that `--out` holds.
    """
    check_output(out, overwrite=overwrite)
    if image.suffix.lower() in VIDEOS:
        _light_video(image, points, _video_options(image, depth, reading), options, out, forms)
        return
    photo = read_photo(image, depth, reading)
    positions = points.positions(photo.frame)
    graphs = choose_graphs(options)
    print_notes(photo.notes)
    with Progress("estimating the light"):
        warm_up()
        lights = light_photo([photo.frame], positions, out, options=options, graphs=graphs, forms=forms)
    _print_field_of_view(photo)
    _print_tilt(photo)
    _print_lights(lights, out)


def _video_options(video: Path, depth: Path | None, reading: PhotoOptions) -> CaptureOptions:
    """Return how to read a video. Raises OptionError for what only a photograph has."""
    taken = {name: getattr(reading, name) for name in ("fov_deg", "world_up", "depth_model")}
    given = [f.name for f in fields(reading) if f.name not in taken and getattr(reading, f.name) != f.default]
    given += [] if depth is None else ["depth"]
    if given:
        raise OptionError(f"{given[0]} is for photographs; {video} is a video, whose depth is estimated")
    return CaptureOptions(**taken)


def _light_video(
    video: Path,
    points: PhotoPoints,
    reading: CaptureOptions,
    options: LightOptions,
    out: Path,
    forms: tuple[SavedFormat, ...],
) -> None:
    capture = open_capture(video, reading)
    with Progress("estimating the light") as progress:
        warm_up()
        capture.prepare(progress.count_of)
        frames = iter(capture)
        first = next(frames)
        positions = points.positions(first)

        def counted() -> Iterator[Frame]:
            for number, frame in enumerate(chain([first], frames), 1):
                yield frame
                progress.count_of("estimating the light", number, capture.frame_count)

        lights = light_photo(counted(), positions, out, options=options, graphs=choose_graphs(options), forms=forms)
    print_notes([*capture.notes, *(capture.pixel_notes() if points.pixels else [])])
    print_skipped([record.reason for record in capture.skipped])
    _print_lights(lights, out)


def _print_lights(lights: list[PhotoLight], out: Path) -> None:
    for lit in lights:
        _print_light(lit)
    panorama, _, spheres = lights[0].files
    say(f"Picture: {out / spheres}; panorama: {out / panorama}; figures: {out / 'light.json'}")


def _print_tilt(photo: Photo) -> None:
    right, up, back = photo.frame.camera_to_world[1, :3].tolist()
    pitch, roll = math.degrees(math.asin(max(-1.0, min(1.0, -back)))), math.degrees(math.atan2(right, up))
    if max(abs(pitch), abs(roll)) > 0.5:
        say(f"the camera looks {abs(pitch):.0f} degrees {'up' if pitch > 0 else 'down'}, rolled by {abs(roll):.0f}")


def _print_field_of_view(photo: Photo) -> None:
    sources = {
        "option": "from --fov",
        "depth": "from the calibration of the photo's depth",
        "exif": f"from the focal length in EXIF, {photo.focal_35mm or 0:g} mm on 35 mm film",
        "default": "the default",
    }
    say(f"field of view {photo.fov_deg:.1f} degrees, horizontal: {sources[photo.fov_source]}")
    if photo.fov_source == "default":
        text = "the photo does not state its field of view; give --fov, or distances are distorted"
        remark("warning:", text, terminal)


def _print_light(lit: PhotoLight) -> None:
    coverage = lit.light.coverage
    say(f"{position_text(lit.position)}: {percent(coverage)} of the sphere around it seen")
    for warning in probe_warnings(coverage, inside_volume=lit.inside_volume, behind_camera=lit.behind_camera):
        remark("  warning:", warning, terminal)
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
