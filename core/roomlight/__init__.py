"""RoomLight: HDR indoor light at any point of a room, from RGB, depth and poses.

    import roomlight as rl

    session = rl.Session()
    for frame in rl.open_capture("my-capture"):
        session.push(frame)
    light = session.light_at((0.2, -0.1, -1.5))  # world metres, y up
    light.panorama, light.observed, light.coverage, light.main_light, light.harmonics
    light.cube(size=64)
    light.save("light.exr")  # or .hdr, .png, .ktx2, .json

Conventions (axes, units, colour): `roomlight.conventions`. Packages, from the lowest layer to the highest:

    light     forms of light: panoramas, harmonics, main light, cube maps, files
    captures  recorded captures: readers and writers
    dataset   training sequences in folders and shards
    wire      messages of the session server
    engine    frames in, light out: the lighting volume, the models, the session
    compositing  virtual objects in the frames of a session

Importing `roomlight` loads none of them; the names below are loaded on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from roomlight.camera import Intrinsics
    from roomlight.captures import CaptureOptions, open_capture
    from roomlight.compositing.compositor import Compositor, composite
    from roomlight.compositing.picture.layers import Composite
    from roomlight.compositing.placement.scene import load_scene
    from roomlight.compositing.recordings import composite_capture, scene_of_object
    from roomlight.conventions import Position
    from roomlight.engine.session import FrameReport, Session, SessionOptions
    from roomlight.errors import (
        CaptureError,
        DatasetError,
        FrameError,
        FurnitureError,
        ImageError,
        ModelError,
        ObjectError,
        OptionError,
        OutputError,
        ProbeError,
        RoomLightError,
        SceneError,
        ServerError,
        StateError,
        UnknownFormatError,
        WireError,
    )
    from roomlight.frame import Frame
    from roomlight.light.cube import CubeMap
    from roomlight.light.light import Light
    from roomlight.light.main_light import MainLight
    from roomlight.light.spherical_harmonics import SphericalHarmonics
    from roomlight.placement import point_at_pixel, point_in_view
    from roomlight.sample import sample_capture

__version__ = "0.1.0"

__all__ = [
    "CaptureError",
    "CaptureOptions",
    "Composite",
    "Compositor",
    "CubeMap",
    "DatasetError",
    "Frame",
    "FrameError",
    "FrameReport",
    "FurnitureError",
    "ImageError",
    "Intrinsics",
    "Light",
    "MainLight",
    "ModelError",
    "ObjectError",
    "OptionError",
    "OutputError",
    "Position",
    "ProbeError",
    "RoomLightError",
    "SceneError",
    "ServerError",
    "Session",
    "SessionOptions",
    "SphericalHarmonics",
    "StateError",
    "UnknownFormatError",
    "WireError",
    "__version__",
    "composite",
    "composite_capture",
    "load_scene",
    "open_capture",
    "point_at_pixel",
    "point_in_view",
    "sample_capture",
    "scene_of_object",
]

_MODULES: Final = {
    "CaptureOptions": "roomlight.captures",
    "Composite": "roomlight.compositing.picture.layers",
    "Compositor": "roomlight.compositing.compositor",
    "CubeMap": "roomlight.light.cube",
    "Frame": "roomlight.frame",
    "FrameReport": "roomlight.engine.session",
    "Intrinsics": "roomlight.camera",
    "Light": "roomlight.light.light",
    "MainLight": "roomlight.light.main_light",
    "Position": "roomlight.conventions",
    "Session": "roomlight.engine.session",
    "SessionOptions": "roomlight.engine.session",
    "SphericalHarmonics": "roomlight.light.spherical_harmonics",
    "composite": "roomlight.compositing.compositor",
    "composite_capture": "roomlight.compositing.recordings",
    "load_scene": "roomlight.compositing.placement.scene",
    "open_capture": "roomlight.captures",
    "point_at_pixel": "roomlight.placement",
    "point_in_view": "roomlight.placement",
    "sample_capture": "roomlight.sample",
    "scene_of_object": "roomlight.compositing.recordings",
}
"""Where each name is defined; errors are all in `roomlight.errors`."""


def __getattr__(name: str) -> object:
    """Import a public name on first use (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module 'roomlight' has no attribute {name!r}")
    value = getattr(import_module(_MODULES.get(name, "roomlight.errors")), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
