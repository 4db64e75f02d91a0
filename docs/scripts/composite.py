"""Draw the pictures of virtual objects in docs/images.

    python docs/scripts/composite.py              composite.jpg, composite.webp, summary.webp: the sample room

A few minutes; `pip install 'roomlight[denoise]'` gives smoother pictures. The objects in the sample room are those
of `roomlight demo`. Frames are enlarged twice before the objects are put in, so that the objects' edges are those of
the printed picture.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from PIL import Image

from roomlight.captures import open_capture
from roomlight.compositing.compositor import Compositor
from roomlight.compositing.placement.scene import Scene, load_scene
from roomlight.conventions import linear_to_srgb8
from roomlight.engine.session import Session
from roomlight.frame import Frame
from roomlight.sample import sample_capture
from roomlight_cli.commands.demo import SCENE
from roomlight_cli.replays.replay import replay
from roomlight_cli.replays.replay_options import ReplayOptions

IMAGES = Path(__file__).parents[1] / "images"
STILLS = (20, 26)
SCALE = 2
GAP = 8
FILM_MS = 170
FILM_SIZE = (480, 360)
SUMMARY_COLUMNS = 1400


def main() -> None:
    """Write two frames and a film of the sample room with the objects of the demo, and its light."""
    frames, session = recorded(sample_capture())
    stills(session, frames, load_scene(SCENE), STILLS).save(IMAGES / "composite.jpg", quality=88)
    good = Compositor(session, load_scene(SCENE), quality="good")
    film = [Image.fromarray(good.composite(frame).image) for frame in frames]
    film = [picture.resize(FILM_SIZE, Image.Resampling.LANCZOS) for picture in film]
    film[0].save(IMAGES / "composite.webp", save_all=True, append_images=film[1:], duration=FILM_MS, quality=55, loop=0)
    with TemporaryDirectory() as folder:
        replay(sample_capture(), Path(folder) / "light", ReplayOptions(probes_from_capture=True))
        summary = Image.open(Path(folder) / "light" / "summary.png")
        rows = round(summary.height * SUMMARY_COLUMNS / summary.width)
        summary.resize((SUMMARY_COLUMNS, rows), Image.Resampling.LANCZOS).save(IMAGES / "summary.webp", quality=82)


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
