"""The virtual objects of `roomlight demo`, placed in the sample room: world metres, y up."""

from typing import Any, Final

from roomlight.compositing.placement.scene import Scene, parse_scene
from roomlight.errors import ObjectError

_FLOOR_M: Final = 0.0
_LOW_TABLE_M: Final = 0.424
"""Heights of the floor and of the low table in the sample room."""

_OBJECTS: Final[list[dict[str, Any]]] = [
    {
        "name": "mirror sphere",
        "shape": "sphere",
        "size_m": 0.16,
        "material": {"kind": "mirror"},
        "position": [-1.6, _LOW_TABLE_M, 0.3],
    },
    {
        "name": "teapot",
        "shape": "teapot",
        "size_m": 0.22,
        "material": {"kind": "metal", "base_colour": [0.95, 0.64, 0.54], "roughness": 0.2},
        "position": [-1.12, _LOW_TABLE_M, 0.36],
        "yaw_degrees": 20,
    },
    {
        "name": "chair",
        "shape": "chair",
        "size_m": 0.8,
        "material": {"kind": "diffuse", "base_colour": [0.03, 0.22, 0.24]},
        "position": [0.5, _FLOOR_M, -0.75],
        "yaw_degrees": -40,
    },
    {
        "name": "rolling sphere",
        "shape": "sphere",
        "size_m": 0.24,
        "material": {"kind": "glossy", "base_colour": [0.6, 0.05, 0.03]},
        "position": [-0.3, _FLOOR_M, 0.1],
        "motion": {
            "unit": "frames",
            "easing": "smooth",
            "keys": [{"at": 20}, {"at": 30, "offset_m": [1.2, 0.0, 0.4]}],
        },
    },
    {
        "name": "sliding vase",
        "shape": "vase",
        "size_m": 0.2,
        "material": {"kind": "glossy", "base_colour": [0.02, 0.16, 0.4], "roughness": 0.15},
        "position": [-1.5, _LOW_TABLE_M, 0.62],
        "motion": {
            "unit": "frames",
            "easing": "smooth",
            "keys": [
                {"at": 0},
                {"at": 8, "offset_m": [0.3, 0.0, 0.0]},
                {"at": 16, "offset_m": [0.3, 0.0, 0.0]},
                {"at": 24},
            ],
        },
    },
]


def demo_scene() -> Scene:
    """Return the scene: a mirror sphere and a teapot on the low table, a chair, and two objects that move."""
    return parse_scene({"objects": _OBJECTS}, load=_no_file)


def _no_file(name: str) -> Any:
    raise ObjectError(f"{name}: the demo has no object files")
