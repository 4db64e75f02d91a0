"""Virtual objects in a whole recording, and scenes of one object on a pixel.

scene = scene_of_object("sphere", pixel=(320, 260), size_m=0.2, material="mirror")
for picture in composite_capture("my-capture", scene):
    picture.image
"""

import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from roomlight.captures import open_capture
from roomlight.compositing.compositor import Compositor
from roomlight.compositing.light.probes import GivenLight
from roomlight.compositing.picture.layers import Composite
from roomlight.compositing.placement.places import check_pixel
from roomlight.compositing.placement.scene import (
    SHAPE_SIZE_M,
    AtPixel,
    Scene,
    SceneObject,
    naming_object,
    parse_scene,
)
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import CaptureError, OptionError, SceneError
from roomlight.frame import Frame


def scene_of_object(
    source: str | Path,
    pixel: tuple[float, float],
    *,
    size_m: float | None = None,
    material: str | None = None,
    yaw_degrees: float = 0.0,
    up: str = "y",
) -> Scene:
    """Return a scene of one object that stands on the surface behind a pixel of the first frame that is used.

    Args:
        source: A shape (a key of `SHAPE_SIZE_M`), or a glTF, GLB, OBJ or PLY file.
        pixel: Column and row.
        size_m: Longest side; None: `SHAPE_SIZE_M` for a shape, the file's own metres for a file.
        material: diffuse, glossy, metal, mirror or glass; None: the file's own.
        yaw_degrees: About the surface's normal.
        up: The file's axis that points up, y or z.

    Raises:
        SceneError: A value is refused; the message names its field.
        ObjectError: The file is refused.

    Examples:
        >>> import roomlight as rl
        >>> [item.name for item in rl.scene_of_object("sphere", (160.0, 200.0), material="mirror").objects]
        ['sphere']
    """
    from roomlight.compositing.loading import load_object  # the loader's libraries are slow to import

    shape = str(source) if str(source) in SHAPE_SIZE_M else None
    spec: dict[str, Any] = {"name": Path(source).stem[:100], "pixel": list(pixel), "yaw_degrees": yaw_degrees, "up": up}
    spec |= {"file": str(source)} if shape is None else {"shape": shape}
    spec |= {} if size_m is None else {"size_m": size_m}
    spec |= {} if material is None else {"material": {"kind": material}}
    if shape is None and not Path(source).exists():
        raise SceneError(f"object {str(source)!r}: neither a file nor one of the shapes {', '.join(SHAPE_SIZE_M)}")
    return parse_scene({"objects": [spec]}, load=load_object)


def composite_capture(
    capture: str | Path | Iterable[Frame],
    scene: Scene | Sequence[SceneObject] | str | Path,
    *,
    quality: str = "good",
    seed: int = 0,
    online: bool = False,
    first_frame: int = 0,
    last_frame: int | None = None,
    options: SessionOptions | None = None,
    light: GivenLight | None = None,
) -> Iterator[Composite]:
    """Yield the frames of a recording with the objects in them.

    The recording is read twice: first for the light and the geometry of the room, then for the pictures. Objects are
    placed at the first frame, or at the frame that their pixel belongs to; earlier frames are yielded without them.

    Args:
        capture: A recording's path, or frames that can be iterated twice, such as a list or `rl.open_capture(...)`.
        scene: The objects, or the path of a scene.json.
        quality: preview, good or final.
        seed: Of the sampling points.
        online: Read the recording once: each picture knows only the frames up to its own, as in an app.
        first_frame: Index of the first frame to yield. Shadows of earlier ones are computed: the pictures have the
            same bytes.
        last_frame: Index of the last frame to yield; None: the recording's last.
        options: Of the session that estimates the light.
        light: Replaces the estimate, as in `Compositor`.

    Raises:
        OptionError: The quality is unknown, the light is refused, or an iterator is given without `online`.
        CaptureError: The recording cannot be read, or has no such frame.
        SceneError: The scene or a place is refused.

    Examples:
        >>> import roomlight as rl
        >>> frames = list(rl.open_capture(rl.sample_capture()))[:2]
        >>> scene = rl.scene_of_object("sphere", (160.0, 200.0))
        >>> pictures = list(rl.composite_capture(frames, scene, quality="preview"))
    """
    frames = open_capture(Path(capture)) if isinstance(capture, str | Path) else capture
    if not online and iter(frames) is frames:
        raise OptionError("capture is an iterator, which can be read once: give a list, or online=True")
    session = Session(options or SessionOptions())
    session.most_gains = sys.maxsize  # the first frames are composited after the last was read
    compositor = Compositor(session, scene, quality=quality, seed=seed, light=light)
    return _composited(
        frames, compositor, session, online, first_frame, sys.maxsize if last_frame is None else last_frame
    )


def _composited(
    frames: Iterable[Frame], compositor: Compositor, session: Session, online: bool, first: int, last: int
) -> Iterator[Composite]:
    read: list[int] = []
    if not online:
        for frame in frames:
            _check_pixels(compositor.scene, frame, is_first=not read)
            session.push(frame)
            compositor.geometry.update(session, latest=False)  # later the session drops keyframes and rooms
            read.append(frame.index)
        _check_frames(compositor.scene, read)
    any_frame, is_whole = False, True
    for frame in frames:
        if frame.index > last:
            is_whole = False
            break
        if online:
            session.push(frame)
            read.append(frame.index)
        if frame.index < first:
            compositor.follow(frame)
            continue
        yield compositor.composite(frame)
        any_frame = True
    if not any_frame:
        of = f" of index {first} to {last}" if last < sys.maxsize else f" from index {first} on" if first else ""
        raise CaptureError(f"the recording has no usable frame{of}")
    if online and is_whole:
        _check_frames(compositor.scene, read)


def _check_pixels(scene: Scene, frame: Frame, *, is_first: bool) -> None:
    """Raise SceneError for an object whose pixel lies outside this frame: before the recording is read to its end."""
    for number, item in enumerate(scene.objects):
        place = item.place
        if isinstance(place, AtPixel) and (place.frame == frame.index or (is_first and place.frame is None)):
            with naming_object(number, item.name):
                check_pixel(frame, place.u, place.v)


def _check_frames(scene: Scene, read: Sequence[int]) -> None:
    """Raise SceneError for an object whose pixel belongs to none of the frames, by index, that were read."""
    for number, item in enumerate(scene.objects):
        index = item.place.frame if isinstance(item.place, AtPixel) else None
        if read and index is not None and index not in read:
            with naming_object(number, item.name):
                among = f"{len(read)} usable frames of index {read[0]} to {read[-1]}"
                raise SceneError(f"frame: the recording has no frame {index} among its {among}")
