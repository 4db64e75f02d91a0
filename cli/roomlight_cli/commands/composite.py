"""`roomlight composite`: virtual objects in a recording, as pictures or as a film."""

from pathlib import Path

from roomlight.captures import CaptureOptions
from roomlight_cli.compositing import CompositeOptions, ObjectOptions, composite_recording
from roomlight_cli.console import say
from roomlight_cli.shared_options import LightOptions


def composite(
    capture: Path,
    objects: ObjectOptions,
    options: CompositeOptions,
    light: LightOptions,
    reading: CaptureOptions,
) -> None:
    """Put virtual objects into a recording: lit by the room, with shadows, hidden by real things in front.

    Example: roomlight composite my-capture --object sphere --material mirror --pixel 320,260 --out film.mp4

    Args:
        capture: A recorded capture: a folder or its zip, a file (.r3d, .sens, .bag, .mcap), or a video.
        objects: Which objects.
        options: What to write.
        light: How to estimate the light.
        reading: How to read the capture.
    """
    say(composite_recording(capture, objects.load(), options, light=light, reading=reading))
