"""The outdoors as the kernels read it: openings, sky and sun.

Frames: world, y up, metres; radiance in kcd/m2.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int32

from roomlight_generator.rooms.scene import Opening
from roomlight_generator.transport.tracer import Tracer


class Outdoors(NamedTuple):
    """Openings, the sky's panorama and the sun.

    Attributes:
        hole: Columns: corner, sides u and v, the unit normal away from the room, then u.u, u.v, v.v.
        parts: First slot of each opening in `Lights.piece_at`, and the numbers of parts into which its sides are cut.
    """

    hole: Float32[np.ndarray, "o 15"]
    parts: Int32[np.ndarray, "o 3"]
    panorama: Float32[np.ndarray, "h w 3"]
    sun_direction: Float32[np.ndarray, "3"]
    sun_irradiance: Float32[np.ndarray, "3"]
    sun_radius: float


def build_outdoors(tracer: Tracer, parts: Int32[np.ndarray, "o 3"]) -> Outdoors:
    """Collect the openings, sky and sun of the tracer's scene."""
    sky = tracer.scene.sky
    sun = sky.sun
    return Outdoors(
        _holes(tracer, tracer.scene.openings),
        parts,
        np.ascontiguousarray(sky.panorama, np.float32),
        np.array((0, 1, 0) if sun is None else sun.direction, np.float32),
        np.array((0, 0, 0) if sun is None else sun.irradiance, np.float32),
        0.00465 if sun is None else float(sun.angular_radius),
    )


def _holes(tracer: Tracer, openings: tuple[Opening, ...]) -> Float32[np.ndarray, "o 15"]:
    corner, u, v = (
        np.array([getattr(opening, name) for opening in openings], np.float64).reshape(-1, 3)
        for name in ("corner", "edge_u", "edge_v")
    )
    outward = np.cross(u, v)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    inside = np.median(tracer.geometry.corners[:, 0], axis=0)
    outward *= np.where(((corner - inside) * outward).sum(1) < 0, -1, 1)[:, None]
    products = np.stack([(u * u).sum(1), (u * v).sum(1), (v * v).sum(1)], 1)
    return np.concatenate([corner, u, v, outward, products], 1).astype(np.float32)
