"""A furnished room to measure in: boxes within a box, ray cast in NumPy. Only its geometry is realistic.

World frame: metres, y up; the first camera stands at the origin and looks along -z and a little down.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.camera import Intrinsics
from roomlight.frame import Frame

_ROOM: Final = np.array([[-2.4, -1.4, -3.1], [2.2, 1.2, 1.4]])
_FURNITURE: Final = np.array(
    [
        [[-2.4, -1.4, -2.2], [-1.5, -0.9, 0.2]],  # a sofa: seat and back
        [[-2.4, -0.9, -2.2], [-2.1, -0.4, 0.2]],
        [[-0.7, -1.0, -1.9], [0.7, -0.95, -1.1]],  # a table: top and two sides
        [[-0.7, -1.4, -1.9], [-0.6, -1.0, -1.1]],
        [[0.6, -1.4, -1.9], [0.7, -1.0, -1.1]],
        [[1.4, -1.4, -3.1], [2.2, 0.6, -2.5]],  # a wardrobe
        [[1.5, -1.4, -0.6], [2.0, -0.5, -0.1]],  # a chest
        [[-0.2, 0.9, -1.7], [0.2, 1.1, -1.3]],  # a lamp
    ]
)
_LAMP: Final = len(_FURNITURE) - 1
_HORIZONTAL_FIELD_DEGREES: Final = 58.0
_PITCH_DEGREES: Final = -20.0
"""People hold a phone a little downwards: the floor and the furniture are in view."""
_SWAY_DEGREES: Final = 6.0
PROBE: Final = (0.15, -0.6, -1.35)
"""The probe: on the table."""


@dataclass(frozen=True)
class RoomSize:
    """Sizes of a run; the defaults are those of a session.

    Attributes:
        volume_shape: Voxels (z, y, x).
        samples: Of a ray through the volume.
        keyframes: Frames of the camera's turn.
    """

    width: int = 320
    height: int = 240
    volume_shape: tuple[int, int, int] = (64, 60, 84)
    panorama_height: int = 120
    samples: int = 128
    keyframes: int = 24


def views(count: int, size: RoomSize) -> list[Frame]:
    """Return frames of a camera that turns around once on the spot, bobbing a little; colour and depth are exact."""
    return [_view(index, 2 * np.pi * index / count, size) for index in range(count)]


def handheld(count: int, size: RoomSize) -> list[Frame]:
    """Return frames of a camera that looks at the table and sways to both sides once in 30 frames."""
    return [_view(index, np.radians(_SWAY_DEGREES) * np.sin(2 * np.pi * index / 30), size) for index in range(count)]


def _view(index: int, yaw: float, size: RoomSize) -> Frame:
    focal = size.width / 2 / np.tan(np.radians(_HORIZONTAL_FIELD_DEGREES / 2))
    lens = Intrinsics(focal, focal, size.width / 2, size.height / 2, size.width, size.height)
    pose = np.eye(4)
    cosine, sine = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    up, ahead = np.sin(np.radians(_PITCH_DEGREES)), np.cos(np.radians(_PITCH_DEGREES))
    pose[:3, :3] = rotation @ [[1, 0, 0], [0, ahead, -up], [0, up, ahead]]
    pose[:3, 3] = [0.2 * sine, 0.05 * np.sin(3 * yaw), 0.1 - 0.1 * cosine]
    rays = lens.rays().astype(np.float64) @ pose[:3, :3].T  # z-depth 1 in the camera, so that t is z-depth
    depth, box = _cast(pose[:3, 3], rays)
    image = _colour(pose[:3, 3] + depth[..., None] * rays, box)
    clipped = image.min(axis=-1) >= 1
    return Frame(
        index,
        np.minimum(image, 1).astype(np.float32),
        clipped,
        depth.astype(np.float32),
        lens,
        pose,
        timestamp_s=index / 30,
        source=f"bench room, view {index}",
    )


def _cast(
    origin: Float[np.ndarray, "3"], rays: Float[np.ndarray, "h w 3"]
) -> tuple[Float[np.ndarray, "h w"], Int[np.ndarray, "h w"]]:
    """Return the distance in units of the ray, and what it hits: -1 for the room, else the number of the furniture."""
    slope = np.where(np.abs(rays) < 1e-9, 1e-9, rays)
    depth = np.maximum(*((wall - origin) / slope for wall in _ROOM)).min(axis=-1)
    hit = np.full(depth.shape, -1)
    for number, (lower, upper) in enumerate(_FURNITURE):
        first, second = (lower - origin) / slope, (upper - origin) / slope
        enter, leave = np.minimum(first, second).max(axis=-1), np.maximum(first, second).min(axis=-1)
        nearer: Bool[np.ndarray, "h w"] = (enter > 0.01) & (enter < leave) & (enter < depth)
        depth, hit = np.where(nearer, enter, depth), np.where(nearer, number, hit)
    return depth, hit


def _colour(points: Float[np.ndarray, "h w 3"], box: Int[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """Return a striped colour per box, darker away from the lamp; the lamp and a window in the far wall are white."""
    base = np.random.default_rng(1).uniform(0.15, 0.7, (len(_FURNITURE) + 1, 3))[box]
    stripes = 0.8 + 0.2 * np.sign(np.sin(points * 9)).prod(axis=-1, keepdims=True)
    lamp = _FURNITURE[_LAMP].mean(axis=0)
    fall = 1.2 / (1 + ((points - lamp) ** 2).sum(axis=-1, keepdims=True) / 3)
    x, y, z = np.moveaxis(points, -1, 0)
    window = (box == -1) & (z < _ROOM[0, 2] + 1e-3) & (np.abs(x) < 0.8) & (np.abs(y) < 0.6)
    return np.where((window | (box == _LAMP))[..., None], 2.0, base * stripes * fall)
