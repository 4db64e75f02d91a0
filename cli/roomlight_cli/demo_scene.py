"""The virtual objects of `roomlight demo`, placed in the sample room: world metres, y up."""

from typing import Any, Final

from roomlight.compositing.scene import Scene, parse_scene
from roomlight.errors import ObjectError

_OBJECTS: Final[list[dict[str, Any]]] = [
    {"name": "chair", "shape": "chair", "size_m": 0.8, "position": [-0.95, 0.0, 1.3], "yaw_degrees": 200},
    {
        "name": "mirror sphere",
        "shape": "sphere",
        "size_m": 0.15,
        "material": {"kind": "mirror"},
        "position": [-0.28, 0.895, 0.68],
    },
    {
        "name": "rolling sphere",
        "shape": "sphere",
        "size_m": 0.22,
        "material": {"kind": "glossy", "base_colour": [0.6, 0.05, 0.03]},
        "position": [-0.65, 0.0, 1.75],
        "motion": {"unit": "frames", "keys": [{"at": 0}, {"at": 9, "offset_m": [-0.1, 0.0, -1.3]}]},
    },
    {
        "name": "sliding vase",
        "shape": "vase",
        "size_m": 0.16,
        "material": {"kind": "metal", "base_colour": [0.95, 0.64, 0.54], "roughness": 0.25},
        "position": [-0.3, 0.895, 0.25],
        "motion": {
            "unit": "frames",
            "easing": "smooth",
            "keys": [{"at": 19}, {"at": 30, "offset_m": [0.0, 0.0, 0.25]}],
        },
    },
]


def demo_scene() -> Scene:
    """Return the scene: a chair, a mirror sphere, and two objects that move."""
    return parse_scene({"objects": _OBJECTS}, load=_no_file)


def _no_file(name: str) -> Any:
    raise ObjectError(f"{name}: the demo has no object files")
