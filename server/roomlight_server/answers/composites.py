"""Composites of a session's last frame: the scene of a request, its limits, and the answer's bytes.

The compositor is imported by `load`: a server answers 0.2 s earlier without it.
"""

import io
import itertools
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import ObjectError, SceneError
from roomlight.frame import Frame
from roomlight.sample import sample_capture
from roomlight.wire.compositing import CompositeFormat, CompositeMaterial, CompositeQuality, CompositeRequest
from roomlight.wire.frame_message import column_major
from roomlight_server.base.problems import ProblemError
from roomlight_server.work.object_packing import object_bytes

if TYPE_CHECKING:
    from roomlight.compositing.objects.virtual_object import VirtualObject
    from roomlight.compositing.picture.layers import Composite
    from roomlight.compositing.placement.scene import Scene

BOXES: Final[dict[CompositeQuality, tuple[int, int]]] = {
    "preview": (1920, 1440),
    "good": (1280, 960),
    "final": (1280, 960),
}
"""Width and height that frames are reduced to fit into, by quality; upright frames turn the box."""
MAX_PATHS: Final = 20_000_000
"""Light paths of one composite, about 50 s of CPU time: larger objects get fewer paths a pixel."""
_PIXEL_BYTES: Final[dict[CompositeQuality, int]] = {"preview": 150, "good": 250, "final": 250}
"""Memory a pixel while a composite is made: the frame, the layers and their files. At most 125 and 224 were measured,
with sixteen glass spheres that fill the picture."""
_TRIANGLE_BYTES: Final = 200
"""Memory a triangle of the scene: its place in the world and Embree's tree."""
MEDIA_TYPES: Final[dict[CompositeFormat, str]] = {
    "png": "image/png",
    "jpeg": "image/jpeg",
    "exr": "image/x-exr",
    "layers": "application/zip",
}


@dataclass(frozen=True)
class Made:
    """A composite and, by name, the poses of its objects (16 numbers, column by column, of the anchor `origin`) and the
    share of each that nothing real hides."""

    picture: "Composite"
    poses: dict[str, list[float]]
    visible: dict[str, float]


def scene_of(request: CompositeRequest, files: "Mapping[str, VirtualObject]", scale: float) -> "Scene":
    """Return the scene of a request; pixels are scaled from the frame as it was sent to the frame that is composited.

    Raises:
        ProblemError: A field is refused (422).
    """
    from roomlight.compositing.placement.scene import parse_scene

    specs: list[dict[str, Any]] = []
    for number, requested in enumerate(request.objects):
        spec = requested.model_dump(exclude_none=True)
        spec["name"] = requested.name or f"object-{number}"
        if requested.object is not None:
            spec["file"] = spec.pop("object")
        if requested.pixel is not None:
            spec["pixel"] = [value * scale for value in requested.pixel]
        if requested.pose is not None:
            spec["pose"] = np.reshape(requested.pose, (4, 4)).T.tolist()
        specs.append(spec)
    try:
        return parse_scene({"objects": specs}, load=files.__getitem__)
    except (SceneError, ObjectError) as error:
        raise ProblemError("invalid", str(error), field="objects", rule=str(error)) from error


def memory_of(
    size: tuple[int, int],
    quality: CompositeQuality,
    placed: "Sequence[VirtualObject]",
    files: "Iterable[VirtualObject]",
) -> int:
    """Return the most memory that a composite takes, in bytes.

    Args:
        size: Width and height of the frame.
        placed: The uploaded object of each place, again where it stands twice.
        files: The same without repetition: their textures are copied once.
    """
    box_width, box_height = BOXES[quality]
    pixels = min(size[0] * size[1], box_width * box_height)
    triangles = sum(virtual.triangles for virtual in placed)
    copied = sum(object_bytes(virtual) for virtual in files)
    return pixels * _PIXEL_BYTES[quality] + triangles * _TRIANGLE_BYTES + copied


def make(engine: Session, frame: Frame, scene: "Scene", quality: CompositeQuality) -> Made:
    """Composite one frame. Raises SceneError if a place is refused, or an object is not in view."""
    from roomlight.compositing.compositor import Compositor, check_in_view

    compositor = Compositor(engine, scene, quality=quality, max_paths=MAX_PATHS)
    try:
        picture = compositor.composite(frame)
        check_in_view(compositor, frame)
        names = [placed.name for placed in scene.objects]
        poses = {name: column_major(compositor.placement(name).object_to_world) for name in names}
        return Made(picture, poses, {name: picture.visible.get(number, 1.0) for number, name in enumerate(names)})
    finally:
        compositor.close()


def encode(made: "Composite", form: CompositeFormat) -> bytes:
    """Return the bytes of an answer; `layers` is a zip without compression, whose files are compressed already."""
    from roomlight.compositing.picture.layer_files import encode_layers, encode_picture

    if form != "layers":
        return encode_picture(made, form)
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_STORED) as archive:
        for name, content in encode_layers(made).items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return data.getvalue()


def load() -> None:
    """Import what composites are made with, so that the first one need not."""
    for module in ("compositor", "picture.layer_files", "placement.scene"):
        import_module(f"roomlight.compositing.{module}")


def warm_up() -> None:
    """Compile every kernel of composites: shapes of each material on a frame of the sample, in two qualities."""
    from roomlight.captures import CaptureOptions, open_capture

    first, second = (frame.resized(160, 120) for frame in open_capture(sample_capture(), CaptureOptions(max_frames=2)))
    engine = Session(SessionOptions(model="classical", height=16))
    engine.push(first)
    engine.push(second)
    places = itertools.product((60.0, 80.0, 100.0), (70.0, 90.0))
    kinds = ("diffuse", "glossy", "metal", "mirror", "glass", None)
    objects = [
        {
            "shape": "sphere" if kind else "cube",
            "size_m": 0.1,
            "pixel": list(pixel),
            "material": kind and CompositeMaterial(kind=kind),
        }
        for kind, pixel in zip(kinds, places, strict=True)
    ]
    scene = scene_of(CompositeRequest.model_validate({"objects": objects}), {}, 1.0)
    for quality in ("preview", "good"):
        picture = make(engine, second, scene, quality).picture
        for form in ("png", "jpeg", "exr", "layers"):
            encode(picture, form)
