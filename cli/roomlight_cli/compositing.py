"""Compositing of a recording into a folder of pictures or a film: output, progress and messages."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import typer

from roomlight.captures import Capture, CaptureOptions, open_capture
from roomlight.compositing.picture.layer_files import PICTURE_ENDINGS, PictureFormat, encode_layers, encode_picture
from roomlight.compositing.picture.layers import Composite
from roomlight.compositing.placement.scene import Scene
from roomlight.compositing.recordings import composite_capture, scene_of_object
from roomlight.engine.session import SessionOptions
from roomlight.errors import OutputError
from roomlight.files import write_atomic
from roomlight.frame import Frame
from roomlight_cli.arguments import parse_pixel
from roomlight_cli.console import print_notes, progress_bars
from roomlight_cli.video import VideoWriter

DEFAULT_RATE: Final = 30.0
"""Frames a second of the film of a recording without timestamps."""


@dataclass(frozen=True)
class Output:
    """Where composited frames go: a film if `path` ends with .mp4, else a folder with a picture for each frame.

    Attributes:
        path: The film or the folder.
        picture_format: Format of the pictures.
        layers: Also write the layers of each frame, into a folder of its own.
        overwrite: Replace what is there.

    Raises:
        OutputError: Something is there already, or the name is of another film format.
    """

    path: Path
    picture_format: PictureFormat = "png"
    layers: bool = False
    overwrite: bool = False

    def __post_init__(self) -> None:
        path = self.path
        if path.suffix.lower() in (".mov", ".mkv", ".avi", ".webm", ".gif"):
            raise OutputError(f"{path}: films are written as .mp4; anything else is a folder of pictures")
        if self.is_film and self.layers:
            raise OutputError(f"{path}: a film has no layers; give a folder with --layers")
        if self.is_film and path.is_dir():
            raise OutputError(f"{path}: is a folder; name a file that ends with .mp4")
        if not self.is_film and path.is_file():
            raise OutputError(f"{path}: is a file; the pictures need a folder, a film a name that ends with .mp4")
        if not self.overwrite and (path.is_file() or (path.is_dir() and any(path.iterdir()))):
            raise OutputError(f"{path}: exists already; choose another --out, or replace it with --overwrite")

    @property
    def is_film(self) -> bool:
        """Whether the frames become one film."""
        return self.path.suffix.lower() == ".mp4"


def one_object(
    source: str, pixel: str | None, *, size_m: float | None, material: str | None, yaw_degrees: float, up: str = "y"
) -> Scene:
    """Return the scene of --object. Raises typer.BadParameter without a pixel, SceneError and ObjectError."""
    if pixel is None:
        raise typer.BadParameter("--object needs --pixel U,V: the pixel of the first frame that shows where it stands")
    place = parse_pixel(pixel)
    return scene_of_object(source, place, size_m=size_m, material=material, yaw_degrees=yaw_degrees, up=up)


def film_rate(fps: float | None) -> Callable[[Capture], float]:
    """Return what chooses the film's frames a second: the option, else the recording's own, else `DEFAULT_RATE`."""
    return lambda capture: fps or min(max(capture.frames_per_second or DEFAULT_RATE, 0.1), 240.0)


def composite_recording(
    source: tuple[Path, CaptureOptions],
    scene: Scene,
    output: Output,
    *,
    quality: str,
    online: bool,
    options: SessionOptions,
    rate: Callable[[Capture], float],
) -> str:
    """Composite a recording and write it; return the sentence that says what was written where.

    Raises:
        CaptureError: The recording cannot be read.
        SceneError: A place is refused.
        OutputError: A file cannot be written.
    """
    capture = open_capture(*source)
    frames = _Watched(capture)
    made = composite_capture(frames, scene, quality=quality, online=online, options=options)
    count, times = 0, 1 if online else 2
    with ExitStack() as stack:
        bars = stack.enter_context(progress_bars())
        bar = bars.add_task("reading the room" if not online else "compositing", total=times * capture.frame_count)
        frames.watch = lambda: bars.advance(bar)
        film = (
            stack.enter_context(VideoWriter(output.path, frames_per_second=rate(capture))) if output.is_film else None
        )
        for picture in made:
            bars.update(bar, description="compositing")
            if film is not None:
                height, width = (side - side % 2 for side in picture.image.shape[:2])
                film.write(picture.image[:height, :width])
            else:
                _write_pictures(picture, output)
            count += 1
    print_notes(capture.notes)
    skipped = f", {len(capture.skipped)} skipped" if capture.skipped else ""
    kind = "film" if output.is_film else "pictures"
    return f"{count} frames{skipped}; {kind}: {output.path}"


class _Watched:
    """A capture that reports each frame it yields, in every iteration."""

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self.watch: Callable[[], object] = lambda: None

    def __iter__(self) -> Iterator[Frame]:
        for frame in self._capture:
            yield frame
            self.watch()


def _write_pictures(picture: Composite, output: Output) -> None:
    stem = f"{picture.frame.index:06d}"
    name = f"{stem}.{PICTURE_ENDINGS[output.picture_format]}"
    write_atomic(output.path / name, encode_picture(picture, output.picture_format))
    if output.layers:
        for layer, data in encode_layers(picture).items():
            write_atomic(output.path / stem / layer, data)
