"""Where real surfaces already keep the strongest lamp's light from real surfaces, so that an object cannot darken them.

A panorama shows the light at the object. A point beside it may lie in the shade of a table, or beside a window's patch
of sun: there, rays toward the lamp meet the session's geometry much nearer than those from the object do.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from roomlight.compositing.kernels.shadows import SurfaceGrid
from roomlight.compositing.light.lighting import LightSampler
from roomlight.compositing.placement.room_geometry import RoomGeometry
from roomlight.conventions import LUMINANCE, panorama_directions, panorama_solid_angles

_CONE: Final = float(np.cos(np.radians(8.0)))
"""Directions this close to the brightest one belong to its lamp."""
_LEAST_SHARE: Final = 0.1
"""A lamp that gives less of all light casts no shadow worth testing."""
_LEAST_COSINE: Final = 0.1
"""Rays closer to a surface meet its own noise."""
_LIFT_M: Final = 0.05
_NEARER: Final = 0.8
"""Rays that meet something at this share of the object's own distance are blocked."""


@dataclass(frozen=True)
class Lamp:
    """The brightest direction of a panorama, if it gives a tenth of the light or more.

    Attributes:
        direction: unit, toward the lamp.
        intensity: [3] irradiance on a surface that faces it, from within 8 degrees.
    """

    direction: Float32[np.ndarray, "3"]
    intensity: Float32[np.ndarray, "3"]

    def holds(self, directions: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Return which directions belong to the lamp."""
        return np.asarray(directions @ self.direction > _CONE)


def lamp_of(light: LightSampler) -> Lamp | None:
    """Return the lamp of a panorama, or None if no direction stands out."""
    panorama = light.panorama
    height = len(panorama)
    directions = panorama_directions(height)
    solid_angle = np.broadcast_to(panorama_solid_angles(height), panorama.shape[:2])[..., None]
    row, column = np.unravel_index(int((panorama @ LUMINANCE).argmax()), panorama.shape[:2])
    direction = directions[row, column].astype(np.float32)
    inside = directions @ direction > _CONE
    power = panorama * solid_angle
    intensity = power[inside].sum(axis=0).astype(np.float32)
    if intensity @ LUMINANCE < _LEAST_SHARE * (power.sum(axis=(0, 1)) @ LUMINANCE):
        return None
    return Lamp(direction, intensity)


def lamp_seen(
    lamp: Lamp,
    grid: SurfaceGrid,
    wanted: Bool[np.ndarray, "h w"],
    room: RoomGeometry,
    position: Float[np.ndarray, "3"],
) -> Float32[np.ndarray, "h w"]:
    """Return 1 where surfaces see the lamp, 0 where the room's geometry hides it; 1 also where nothing is known.

    Args:
        position: the object's, which sees the lamp.
    """
    seen = np.ones(wanted.shape, np.float32)
    tested = wanted & (grid.normals @ lamp.direction > _LEAST_COSINE)
    if not tested.any():
        return seen
    own = float(room.cast(position[None].astype(np.float32), lamp.direction[None]).distance_m[0])
    origins = grid.points[tested] + np.float32(_LIFT_M) * grid.normals[tested]
    if np.isfinite(own):
        along = position.astype(np.float32) + np.float32(own) * lamp.direction - origins
        far_m = np.linalg.norm(along, axis=1)
        along /= far_m[:, None]
    else:
        along, far_m = np.ascontiguousarray(np.broadcast_to(lamp.direction, origins.shape)), np.float32(np.inf)
    met = room.cast(origins, along).distance_m
    seen[tested] = ~((met > _LIFT_M) & (met < _NEARER * far_m))
    return cv2.blur(seen, (3, 3), borderType=cv2.BORDER_REPLICATE)
