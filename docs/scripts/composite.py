"""Draw the pictures of virtual objects in docs/images.

    python docs/scripts/composite.py              composite.jpg, composite.webp, summary.webp: the sample room
    python docs/scripts/composite.py daylight     composite-daylight.webp: a room lit by its window, generated first

A few minutes each; `pip install 'roomlight[denoise]'` gives smoother pictures. The objects in the sample room are those
of `roomlight demo`. Frames are enlarged twice before the objects are put in, so that the objects' edges are those of
the printed picture.
"""

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from PIL import Image

from roomlight.captures import open_capture
from roomlight.compositing.compositor import Compositor
from roomlight.compositing.objects import VirtualObject
from roomlight.compositing.scene import Scene, parse_scene
from roomlight.conventions import linear_to_srgb8
from roomlight.engine.session import Session
from roomlight.errors import ObjectError
from roomlight.frame import Frame
from roomlight.sample import sample_capture
from roomlight_cli.demo_scene import demo_scene
from roomlight_cli.replay import replay
from roomlight_cli.replay_options import ReplayOptions
from roomlight_generator.sample import generate_sample

IMAGES = Path(__file__).parents[1] / "images"
STILLS = (20, 26)
DAYLIGHT_ROOM, DAYLIGHT_WALK = 1537, 3
"""Chosen by eye among 18 walks through three rooms: a large window, a desk, bright and dark colours."""
DAYLIGHT_STILLS = (6, 22)
DAYLIGHT_OBJECTS: list[dict[str, Any]] = [
    {
        "name": "mirror sphere",
        "shape": "sphere",
        "size_m": 0.3,
        "material": {"kind": "mirror"},
        "position": [-0.75, 0.0, 0.2],
    },
    {
        "name": "chair",
        "shape": "chair",
        "size_m": 0.85,
        "material": {"kind": "diffuse", "base_colour": [0.5, 0.1, 0.05]},
        "position": [-0.5, 0.0, -0.65],
        "yaw_degrees": 150,
    },
    {
        "name": "teapot",
        "shape": "teapot",
        "size_m": 0.26,
        "material": {"kind": "metal", "base_colour": [0.95, 0.64, 0.54], "roughness": 0.2},
        "position": [-1.26, 0.764, 1.67],
        "yaw_degrees": 60,
    },
    {
        "name": "rolling sphere",
        "shape": "sphere",
        "size_m": 0.22,
        "material": {"kind": "glossy", "base_colour": [0.6, 0.05, 0.03]},
        "position": [-1.7, 0.0, -0.3],
        "motion": {"unit": "frames", "keys": [{"at": 6}, {"at": 22, "offset_m": [0.4, 0.0, 1.05]}]},
    },
]
SCALE = 2
GAP = 8
FILM_MS = 170
FILM_SIZE = (480, 360)
SUMMARY_COLUMNS = 1400


def main() -> None:
    """Write the pictures of the sample room, or of the room by daylight."""
    if sys.argv[1:] == ["daylight"]:
        daylight_room()
    else:
        sample_room()


def sample_room() -> None:
    """Write two frames and a film of the sample room with the objects of the demo, and its light."""
    frames, session = recorded(sample_capture())
    stills(session, frames, demo_scene(), STILLS).save(IMAGES / "composite.jpg", quality=88)
    good = Compositor(session, demo_scene(), quality="good")
    film = [Image.fromarray(good.composite(frame).image) for frame in frames]
    film = [picture.resize(FILM_SIZE, Image.Resampling.LANCZOS) for picture in film]
    film[0].save(IMAGES / "composite.webp", save_all=True, append_images=film[1:], duration=FILM_MS, quality=55, loop=0)
    with TemporaryDirectory() as folder:
        replay(sample_capture(), Path(folder) / "light", ReplayOptions(probes_from_capture=True))
        summary = Image.open(Path(folder) / "light" / "summary.png")
        rows = round(summary.height * SUMMARY_COLUMNS / summary.width)
        summary.resize((SUMMARY_COLUMNS, rows), Image.Resampling.LANCZOS).save(IMAGES / "summary.webp", quality=82)


def daylight_room() -> None:
    """Generate the room by daylight, and write two of its frames with objects."""
    with TemporaryDirectory() as folder:
        capture = Path(folder) / "capture"
        generate_sample(capture, room=DAYLIGHT_ROOM, walk=DAYLIGHT_WALK)
        frames, session = recorded(capture)
    scene = parse_scene({"objects": DAYLIGHT_OBJECTS}, load=no_file)
    stills(session, frames, scene, DAYLIGHT_STILLS).save(IMAGES / "composite-daylight.webp", quality=80)


def recorded(capture: Path) -> tuple[list[Frame], Session]:
    """Return the enlarged frames of a capture, and a session that has seen them."""
    frames = [enlarged(frame) for frame in open_capture(capture)]
    session = Session()
    for frame in frames:
        session.push(frame)
    return frames, session


def stills(session: Session, frames: list[Frame], scene: Scene, numbers: tuple[int, ...]) -> Image.Image:
    """Return frames of these numbers in rows, on the left as recorded, on the right with the objects."""
    final = Compositor(session, scene, quality="final")
    pictures: list[Image.Image] = []
    for frame in (frames[number] for number in numbers):
        pictures += [Image.fromarray(linear_to_srgb8(frame.image)), Image.fromarray(final.composite(frame).image)]
    return grid(pictures)


def no_file(name: str) -> VirtualObject:
    """Refuse a file: the scenes here have shapes only."""
    raise ObjectError(f"{name}: these pictures have no object files")


def enlarged(frame: Frame) -> Frame:
    """Return the frame with `SCALE` times as many columns and rows; depth stays as it is."""
    height, width = frame.image.shape[:2]
    size = (SCALE * width, SCALE * height)
    return replace(
        frame,
        image=np.maximum(cv2.resize(frame.image, size, interpolation=cv2.INTER_CUBIC), 0),
        clipped=cv2.resize(frame.clipped.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(bool),
        intrinsics=frame.intrinsics.resized(*size),
    )


def grid(pictures: list[Image.Image]) -> Image.Image:
    """Lay out pictures in rows of two."""
    width, height = pictures[0].size
    rows = len(pictures) // 2
    out = Image.new("RGB", (2 * width + GAP, rows * (height + GAP) - GAP), "white")
    for number, picture in enumerate(pictures):
        out.paste(picture, (number % 2 * (width + GAP), number // 2 * (height + GAP)))
    return out


if __name__ == "__main__":
    main()
