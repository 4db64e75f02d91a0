"""Composites of a session's last frame: the scene of a request, its limits, and the answer's bytes."""

import io
import itertools
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from roomlight.captures import CaptureOptions, open_capture
from roomlight.compositing.compositor import Compositor, check_in_view
from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.compositing.picture.layer_files import encode_layers, encode_picture
from roomlight.compositing.picture.layers import Composite
from roomlight.compositing.placement.scene import Scene, parse_scene
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import ObjectError, SceneError
from roomlight.frame import Frame
from roomlight.sample import sample_capture
from roomlight.wire.compositing import CompositeFormat, CompositeMaterial, CompositeQuality, CompositeRequest
from roomlight.wire.frame_message import column_major
from roomlight_server.base.problems import ProblemError

BOXES: Final[dict[CompositeQuality, tuple[int, int]]] = {
    "preview": (1920, 1440),
    "good": (1280, 960),
    "final": (1280, 960),
}
"""Width and height that frames are reduced to fit into, by quality; upright frames turn the box."""
MAX_PATHS: Final = 20_000_000
"""Light paths of one composite, about 50 s of CPU time: larger objects get fewer paths a pixel."""
_PIXEL_BYTES: Final = 150
"""Memory a pixel while a composite is made: the frame, the layers and their files."""
MEDIA_TYPES: Final[dict[CompositeFormat, str]] = {
    "png": "image/png",
    "jpeg": "image/jpeg",
    "exr": "image/x-exr",
    "layers": "application/zip",
}


@dataclass(frozen=True)
class Made:
    """A composite, and the poses of its objects by name: 16 numbers, column by column, of the anchor `origin`."""

    picture: Composite
    poses: dict[str, list[float]]


def scene_of(request: CompositeRequest, files: Mapping[str, VirtualObject], scale: float) -> Scene:
    """Return the scene of a request; pixels are scaled from the frame as it was sent to the frame that is composited.

    Raises:
        ProblemError: A field is refused (422).
    """
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


def memory_of(width: int, height: int, quality: CompositeQuality) -> int:
    """Return the memory of a composite of a frame of this size, in bytes."""
    box_width, box_height = BOXES[quality]
    return min(width * height, box_width * box_height) * _PIXEL_BYTES


def make(engine: Session, frame: Frame, scene: Scene, quality: CompositeQuality) -> Made:
    """Composite one frame.

    Raises:
        SceneError: A place is refused, or an object is not in view.
    """
    compositor = Compositor(engine, scene, quality=quality, max_paths=MAX_PATHS)
    try:
        picture = compositor.composite(frame)
        check_in_view(compositor, frame)
        names = [placed.name for placed in scene.objects]
        poses = {name: column_major(compositor.placement(name).object_to_world) for name in names}
        return Made(picture, poses)
    finally:
        compositor.close()


def encode(made: Composite, form: CompositeFormat) -> bytes:
    """Return the bytes of an answer; `layers` is a zip without compression, whose files are compressed already."""
    if form != "layers":
        return encode_picture(made, form)
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_STORED) as archive:
        for name, content in encode_layers(made).items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return data.getvalue()


def warm_up() -> None:
    """Compile every kernel of composites: shapes of each material on a frame of the sample, in two qualities."""
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
