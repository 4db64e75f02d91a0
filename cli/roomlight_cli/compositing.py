"""Compositing of a recording into a folder of pictures or a film: options, output, progress and messages."""

import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from annotated_types import Ge, Interval

from roomlight.camera import Intrinsics
from roomlight.captures import Capture, CaptureOptions, open_capture
from roomlight.compositing.picture.layer_files import (
    LAYER_FILES,
    PICTURE_ENDINGS,
    PictureFormat,
    encode_layers,
    encode_picture,
    layer_path,
)
from roomlight.compositing.picture.layers import Composite
from roomlight.compositing.placement.places import Placement
from roomlight.compositing.placement.scene import MAX_SIZE_M, AtPixel, Scene, load_scene
from roomlight.compositing.recordings import composite_capture, scene_of_object
from roomlight.engine.session import SessionOptions, warm_up
from roomlight.errors import OptionError, OutputError
from roomlight.files import check_writable, remove_outputs, write_atomic
from roomlight.frame import Frame
from roomlight.imaging.exr import sequence_metadata
from roomlight.imaging.video_writer import MOST_ROWS, VideoWriter
from roomlight.notes import distinct
from roomlight.rules import check_options
from roomlight_cli.console import counted, print_notes, print_skipped, remark, say, stopped_by_signals
from roomlight_cli.options import Flag
from roomlight_cli.progress import LOADING, Progress, duration
from roomlight_server.work.compiling import compile_beside

LONG_S: Final = 300.0
"""Time left of more than this is told with what makes it shorter."""
_OBLONG: Final = 0.05
"""From this relative difference of the focal lengths on pixels are oblong; below, lenses and calibrations differ."""
_PLACES: Final = {
    "floor": "stands on a surface",
    "slope": "stands on a slope",
    "wall": "hangs on a wall,",
    "ceiling": "hangs from a ceiling,",
}
_STEM: Final = "[0-9]" * 6
_PICTURES: Final = tuple(f"{_STEM}.{ending}" for ending in PICTURE_ENDINGS.values())


@dataclass(frozen=True)
class ObjectOptions:
    """Which objects to composite: those of a scene file, or a single one.

    Attributes:
        scene: The objects: a scene.json.
        object: A GLB, glTF, OBJ or PLY file, or sphere, cube, plane, vase, chair, teapot.
        pixel: Put the object on the surface that this pixel of the first frame that is used shows: column U, row V,
            without the distortion of its lens.
        material: Replaces the materials of the file.
        size_m: Longest side in metres. Default: the file's own size; 0.2 for a sphere, 0.85 for a chair.
        yaw_degrees: Turn about the surface, in degrees.
        up: Axis of the file that points up.

    Raises:
        OptionError: There are not objects of exactly one kind, or the object has no place.
    """

    scene: Path | None = None
    object: Annotated[str | None, Flag(metavar="FILE|SHAPE")] = None
    pixel: tuple[float, float] | None = None
    material: Literal["diffuse", "glossy", "metal", "mirror", "glass"] | None = None
    size_m: Annotated[float | None, Interval(gt=0, le=MAX_SIZE_M), Flag(metavar="M")] = None
    yaw_degrees: float = 0.0
    up: Literal["y", "z"] = "y"

    def __post_init__(self) -> None:
        check_options(self)
        if (self.scene is None) == (self.object is None):
            raise OptionError("give either `scene`, a scene.json, or `object` with `pixel`")
        if self.object is not None and self.pixel is None:
            raise OptionError("`object` needs `pixel` U,V: the pixel of the first frame that shows where it stands")
        own = (f for f in fields(self) if f.name not in ("scene", "object"))
        given = [f.name for f in own if getattr(self, f.name) != f.default]
        if self.scene is not None and given:
            names = ", ".join(f"`{name}`" for name in given)
            raise OptionError(f"{names}: belongs to `object`; with `scene`, write it into {self.scene}")

    def load(self) -> Scene:
        """Read the objects. Raises SceneError and ObjectError."""
        if self.scene is not None:
            return load_scene(self.scene)
        assert self.object is not None
        assert self.pixel is not None
        return scene_of_object(
            self.object,
            self.pixel,
            size_m=self.size_m,
            material=self.material,
            yaw_degrees=self.yaw_degrees,
            up=self.up,
        )


@dataclass(frozen=True)
class CompositeOptions:
    """How to render composites, and where they go.

    Attributes:
        out: A folder for pictures, or a film: a file that ends with .mp4.
        quality: preview for speed, final for noise-free pictures.
        picture: Format of the pictures; exr is linear. Default: png.
        layers: Also write frame, objects, alpha, shadow, depth and object_id of each frame apart.
        fps: Frames a second of the film. Default: the recording's, or as of 30 records a second.
        online: Light each frame by the frames up to it, as an app would, instead of the whole recording.
        first_frame: Write the pictures from this number on, as they would be among all; those before stay.
        last_frame: Write the pictures up to this number.
        overwrite: Replace the film or the pictures in `--out`.

    Raises:
        OptionError: A value is out of range.
        OutputError: What would be written is at `out` already, or its name is of another film format.
    """

    out: Path
    quality: Literal["preview", "good", "final"] = "good"
    picture: PictureFormat | None = None
    layers: bool = False
    fps: Annotated[float, Interval(ge=0.1, le=240)] | None = None
    online: bool = False
    first_frame: Annotated[int, Ge(0)] = 0
    last_frame: Annotated[int, Ge(0)] | None = None
    overwrite: bool = False

    def __post_init__(self) -> None:
        check_options(self)
        if self.last_frame is not None and self.last_frame < self.first_frame:
            raise OptionError(f"`last_frame` {self.last_frame} is before `first_frame` {self.first_frame}")
        try:
            self._check_out(self.out)
        except OSError as error:  # a name too long, a folder that may not be entered
            raise OutputError(f"{self.out}: cannot be used for output ({error.strerror or error})") from error

    def _check_out(self, path: Path) -> None:
        if path.suffix.lower() in (".mov", ".mkv", ".avi", ".webm", ".gif"):
            raise OutputError(f"{path}: films are written as .mp4; anything else is a folder of pictures")
        if self.is_film and self.layers:
            raise OutputError(f"{path}: a film has no layers; give a folder with --layers")
        if self.is_film and self.picture is not None:
            raise OutputError(f"{path}: a film has no `picture` format; give a folder, or leave it out")
        if not self.is_film and self.fps is not None:
            raise OutputError(f"{path}: `fps` is of films; name a file that ends with .mp4, or leave it out")
        if self.is_film and path.is_dir():
            raise OutputError(f"{path}: is a folder; name a file that ends with .mp4")
        if not self.is_film and path.is_file():
            raise OutputError(f"{path}: is a file; the pictures need a folder, a film a name that ends with .mp4")
        if self.overwrite or not path.exists():
            return
        if not self.is_film and (self.first_frame or self.last_frame is not None):
            if made := self.numbers():
                raise OutputError(
                    f"{path}: has pictures of these frames, {made[0]} to {made[-1]}; give others by --first-frame and "
                    "--last-frame, or replace them with --overwrite"
                )
        elif not self.is_film and (made := self.numbers()):
            raise OutputError(
                f"{path}: has pictures {made[0]} to {made[-1]}; go on with --first-frame {int(made[-1]) + 1}, choose "
                "another --out, or replace them with --overwrite"
            )
        elif path.is_file() or any(path.iterdir()):
            raise OutputError(f"{path}: exists already; choose another --out, or replace it with --overwrite")

    def numbers(self, *patterns: str) -> list[str]:
        """Return the numbers, as they are written, of files in `out` (pictures) in place of the frames to write."""
        names = {path.stem[-6:] for pattern in patterns or _PICTURES for path in self.out.glob(pattern)}
        return sorted(name for name in names if self.first_frame <= int(name) <= self.last)

    @property
    def last(self) -> int:
        """The number of the last picture to write."""
        return sys.maxsize if self.last_frame is None else self.last_frame

    @property
    def is_film(self) -> bool:
        """Whether the frames become one film."""
        return self.out.suffix.lower() == ".mp4"

    def rate(self, capture: Capture) -> float:
        """Return the film's frames a second."""
        return self.fps or min(max(capture.film_rate, 0.1), 240.0)


def composite_recording(
    path: Path, scene: Scene, options: CompositeOptions, *, light: SessionOptions, reading: CaptureOptions
) -> str:
    """Composite a recording and write it; return the sentence that says what was written where.

    Raises:
        CaptureError: The recording cannot be read.
        SceneError: A place is refused.
        OutputError: A file cannot be written.
        typer.Exit: Ctrl-C or SIGTERM stopped it (code 130 or 143).
    """
    check_writable(options.out if options.is_film else options.out / "000000.png")
    print_notes(distinct(note for item in scene.objects for note in item.geometry.notes))
    capture, advised, unseen = open_capture(path, reading), False, dict(enumerate(scene.objects))
    compile_beside(options.quality)
    placements: dict[int, Placement] = {}
    count = following = start = height = width = 0
    last = min(options.last, capture.frame_count * reading.every - 1)
    passes = ["compositing"] if options.online else ["reading the room (pass 1 of 2)", "compositing (pass 2 of 2)"]

    def kept() -> str:
        if count and not options.is_film:
            return f"{options.out} keeps {counted(count, 'picture')}; go on with --first-frame {following}"
        return "no film was written" if options.is_film else "nothing was written"

    with stopped_by_signals(kept), ExitStack() as stack:
        progress = stack.enter_context(Progress(LOADING))
        warm_up()
        film = options.out if options.is_film else None
        frames = _ReportedFrames(capture, last // reading.every + 1, passes, progress.count_of, film)
        made = composite_capture(
            frames,
            scene,
            quality=options.quality,
            online=options.online,
            first_frame=options.first_frame,
            last_frame=options.last_frame,
            options=light,
        )
        capture.prepare(progress.count_of)
        write = stack.enter_context(_output(options, capture, reading.every))
        for picture in made:
            write(picture)
            start = start if count else picture.frame.index
            height, width = picture.image.shape[:2]
            count, following = count + 1, picture.frame.index + 1
            if count > 1 and options.quality != "preview":  # the first has compilation in its time
                advised = advised or _advise(picture, (last - picture.frame.index) // reading.every)
            placements |= picture.placements
            for number in np.unique(picture.crop_object_id[picture.crop_alpha > 0]).tolist():
                unseen.pop(number, None)
    print_notes(capture.notes)
    if any(isinstance(item.place, AtPixel) and item.place.frame is None for item in scene.objects):
        print_notes(capture.pixel_notes())
    print_skipped([record.reason for record in capture.skipped])
    rate = options.rate(capture)
    if options.is_film and options.fps is None and (pace := capture.pace_note(count, start, following - 1, rate=rate)):
        print_notes([pace])
    if options.is_film and (height % 2 or width % 2):
        even = f"{width - width % 2} x {height - height % 2}"
        remark("note:", f"H.264 has even sides: the film shows {even} of {width} x {height} pixels, from the top left")
    for number, placement in sorted(placements.items()):
        if placement.kind is not None:
            where = f"{_PLACES[placement.kind]} {placement.distance_m:.1f} m away"
            say(f"object {scene.objects[number].name!r} {where}")
    for item in unseen.values():
        size_m = float(np.ptp(item.geometry.bounds(), axis=0).max())
        remark("warning:", f"object {item.name!r}, {size_m:.3g} m long, covers no pixel of any picture")
    skipped = f", {len(capture.skipped)} skipped" if capture.skipped else ""
    kind = "film" if options.is_film else "pictures"
    return f"{counted(count, 'frame')}{skipped}; {kind}: {options.out}"


class _ReportedFrames:
    """A capture that reports each frame it yields, by the name of the iteration; those of a film have one size.

    `count` of its frames are composited.
    """

    def __init__(
        self,
        capture: Capture,
        count: int,
        passes: list[str],
        report: Callable[[str, int, int], None],
        film: Path | None,
    ) -> None:
        self._capture, self._passes, self._report, self._film = capture, iter(passes), report, film
        self._count = count

    def __iter__(self) -> Iterator[Frame]:
        name = next(self._passes)
        is_read = name.startswith("reading")  # else the first frame takes longest, and is not of the pace
        total = self._capture.frame_count if is_read else self._count
        self._report(name if is_read else f"{name}: places, light and first picture", 0, total)
        first: Intrinsics | None = None
        for number, frame in enumerate(self._capture, 1):
            own = frame.intrinsics
            first = first or own
            rows = abs(own.height - first.height)
            if self._film is not None and (own.width != first.width or rows > MOST_ROWS * own.height):
                raise OutputError(
                    f"{self._film}: a film has pictures of one size, but {frame.source} has {own.width} x {own.height} "
                    f"pixels and the first {first.width} x {first.height}; give a folder"
                )
            yield frame
            self._report(name, number, total)


@contextmanager
def _output(options: CompositeOptions, capture: Capture, every: int) -> Generator[Callable[[Composite], None]]:
    """Yield what writes a composite: into the film, or into the folder, which is cleared before the first."""
    if options.is_film:
        with VideoWriter(options.out, frames_per_second=options.rate(capture)) as film:
            yield lambda picture: film.write(picture.image)
        return
    rate = capture.film_rate * every  # at which indices count
    is_clear = False

    def write(picture: Composite) -> None:
        nonlocal is_clear
        if not is_clear:
            _clear(options, picture.frame, capture.path)
            is_clear = True
        _write_pictures(picture, options, rate)

    yield write


def _advise(picture: Composite, left: int) -> bool:
    """Say what is faster if so many pictures at the pace of this one take long; return whether they do."""
    left_s = sum(picture.stage_ms.values()) / 1000 * left
    if left_s > LONG_S:
        remark("note:", f"{duration(left_s)} left at the pace of one picture; --quality preview is faster")
    return left_s > LONG_S


def _clear(options: CompositeOptions, frame: Frame, recording: Path) -> None:
    """Remove the pictures and layers that an earlier run left in place of the frames to write; other files stay.

    Within the recording's folder all stay, which may be its own.

    Raises:
        OutputError: A file cannot be removed, or `out` holds the recording's own pictures.
    """
    source, out = Path(frame.source), options.out
    try:
        if source.match(f"{_STEM}.*") and source.parent.resolve() == out.resolve():
            raise OutputError(f"{out}: holds the recording's own pictures; choose another --out")
        if out.resolve().is_relative_to(recording.resolve()):
            return
    except OSError as error:
        raise OutputError(f"{out}: cannot be used for output ({error.strerror or error})") from error
    for pattern in (*_PICTURES, *(layer_path(layer, _STEM) for layer in LAYER_FILES)):
        files = (pattern.replace(_STEM, number) for number in options.numbers(pattern))
        remove_outputs(out, files, folders=pattern.partition("/")[0])


def _write_pictures(picture: Composite, options: CompositeOptions, rate: float) -> None:
    frame, index = picture.frame, picture.frame.index
    source = Path(frame.source).name.encode(errors="replace").decode()  # a name may not be UTF-8
    metadata = {"roomlight:source": source, **sequence_metadata(index, rate)}
    k, pose = frame.intrinsics, frame.camera_to_world.ravel()
    metadata["roomlight:intrinsics"] = f"{k.fx:.9g} {k.fy:.9g} {k.cx:.9g} {k.cy:.9g}"
    if abs(k.fy / k.fx - 1) > _OBLONG:
        metadata["pixelAspectRatio"] = round(k.fy / k.fx, 4)
    metadata["roomlight:exposure"] = f"{frame.exposure:.9g}"
    metadata["roomlight:gain"] = " ".join(f"{value:.9g}" for value in picture.gain)
    metadata["roomlight:camera_to_world"] = " ".join(f"{value:.9g}" for value in pose)
    if frame.timestamp_s is not None:
        metadata["roomlight:timestamp_s"] = f"{frame.timestamp_s:.6f}"
    form = options.picture or "png"
    name = f"{index:06d}.{PICTURE_ENDINGS[form]}"
    if options.layers:
        for layer, data in encode_layers(picture, metadata=metadata).items():
            write_atomic(options.out / layer_path(layer, f"{index:06d}"), data)
    write_atomic(options.out / name, encode_picture(picture, form, metadata=metadata))  # last: its frame is whole
