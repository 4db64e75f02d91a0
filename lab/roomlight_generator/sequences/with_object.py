"""One view of a generated room with and without a real object in it: the truth for virtual objects in pictures.

The object becomes an item of the room's scene, so that the room lights it, it shades the room, and both reflect each
other. World metres, y up; poses camera-to-world, OpenGL axes; radiance in kcd/m2.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from roomlight.camera import Intrinsics, transform_points
from roomlight_generator.rooms.scene import Item, Mesh, Scene
from roomlight_generator.transport import FrameView, RoomLight, Tracer
from roomlight_generator.transport.paths import unit_rows

OBJECT: Final = "object"
"""Name and role of the item."""

DISTANCE_M: Final = (0.7, 2.4)
"""Distance of resting places from the camera."""
_LEVEL: Final = 0.995
_CANDIDATES: Final = 400
_RING: Final = 16
_FLAT_M: Final = 0.004
_SIDE_CLEARANCE: Final = 1.25
"""Free width around an object, in units of its radius."""
_DOWN: Final = np.array([[0.0, -1.0, 0.0]], np.float32)
_LIFT_M: Final = 0.1
"""A surface is looked for from this far over a point."""


@dataclass(frozen=True)
class RestingPlace:
    """A pixel (column and row, fractions allowed) that shows a level surface with room for an object."""

    u: float
    v: float
    point: tuple[float, float, float]


def render_pair(
    scene: Scene, mesh: Mesh, intrinsics: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"], *, seed: int
) -> tuple[FrameView, Bool[np.ndarray, "h w"], FrameView]:
    """Render a view of the room with the object, a mesh in the world, and one without it; the light is solved anew.

    Blotches that differ between the views would pass for the object's shadow: both are precise (`RoomLight.solve`).
    The mask is of the pixels whose centre shows the object.
    """
    tracer = Tracer(replace(scene, items=(*scene.items, Item(OBJECT, OBJECT, mesh))))
    view, bare = (
        RoomLight.solve(room, seed, precise=True).frame(intrinsics, camera_to_world, seed=seed)
        for room in (tracer, Tracer(scene))
    )
    directions = unit_rows(intrinsics.rays().reshape(-1, 3) @ camera_to_world[:3, :3].T)
    origins = np.broadcast_to(camera_to_world[:3, 3], directions.shape)
    hits = tracer.trace(np.ascontiguousarray(origins, np.float32), directions)
    covered = (hits.face >= 0) & (tracer.geometry.item[hits.face] == len(scene.items))
    return view, covered.reshape(view.depth_m.shape), bare


def find_resting_place(
    tracer: Tracer,
    intrinsics: Intrinsics,
    camera_to_world: Float[np.ndarray, "4 4"],
    rng: np.random.Generator,
    *,
    radius_m: float,
    height_m: float,
) -> RestingPlace | None:
    """Find a place in view for an upright cylinder on a floor or a table; None if there is no such place.

    The surface under the whole foot is level, the cylinder and a margin around it are empty, and the camera sees its
    bottom, middle and top inside the picture. Places near the picture's middle are preferred.
    """
    count = _CANDIDATES
    u, v = rng.uniform(0.12, 0.88, count) * intrinsics.width, rng.uniform(0.2, 0.92, count) * intrinsics.height
    local = np.stack([(u - intrinsics.cx) / intrinsics.fx, -(v - intrinsics.cy) / intrinsics.fy, -np.ones(count)], 1)
    directions = unit_rows(local @ camera_to_world[:3, :3].T)
    eye = camera_to_world[:3, 3].astype(np.float32)
    hits = tracer.trace(np.broadcast_to(eye, directions.shape).copy(), directions)
    normals = tracer.geometry.normals[hits.face].mean(axis=1)
    near, far = DISTANCE_M
    good = (hits.face >= 0) & (np.abs(normals[:, 1]) > _LEVEL) & (directions[:, 1] < 0)
    good &= (hits.distance_m > near) & (hits.distance_m < far)
    points = eye + hits.distance_m[:, None] * directions
    off_centre = np.hypot(u / intrinsics.width - 0.5, v / intrinsics.height - 0.6)
    for k in np.argsort(off_centre + rng.uniform(0, 0.15, count)):
        if (
            good[k]
            and _fits(tracer, points[k], eye, radius_m, height_m)
            and _in_picture(intrinsics, camera_to_world, points[k], radius_m, height_m)
        ):
            x, y, z = points[k].astype(float).tolist()
            return RestingPlace(float(u[k]) - 0.5, float(v[k]) - 0.5, (x, y, z))
    return None


def height_above_surface(tracer: Tracer, base: Float[np.ndarray, "3"]) -> float:
    """Return how far a point lies above the surface under or just over it, in metres; negative below the surface."""
    start = np.asarray(base, np.float32)[None] + np.array([[0, _LIFT_M, 0]], np.float32)
    return float(tracer.distances(start, _DOWN)[0]) - _LIFT_M


def _fits(
    tracer: Tracer, point: Float[np.ndarray, "3"], eye: Float[np.ndarray, "3"], radius_m: float, height_m: float
) -> bool:
    angle = np.arange(_RING) / _RING * 2 * np.pi
    ring = np.stack([np.cos(angle), np.zeros(_RING), np.sin(angle)], axis=1).astype(np.float32)
    foot = np.concatenate([point[None] + share * radius_m * ring for share in (0.5, 1.0)])
    top = foot + np.array([0, height_m, 0], np.float32)
    down = tracer.distances(top, np.broadcast_to(_DOWN, top.shape))
    if (np.abs(down - height_m) > _FLAT_M).any():
        return False
    for share in (0.05, 0.35, 0.7, 1.05):
        middle = np.broadcast_to(point + np.array([0, share * height_m, 0], np.float32), ring.shape)
        if (tracer.distances(middle, ring) < _SIDE_CLEARANCE * radius_m).any():
            return False
    seen = point + np.outer([0.1, 0.5, 1.0], [0, height_m, 0]).astype(np.float32)
    away = seen - eye
    reach = np.linalg.norm(away, axis=1)
    free = tracer.distances(np.broadcast_to(eye, seen.shape), unit_rows(away))
    return bool((free > reach - 0.01).all())


def _in_picture(
    intrinsics: Intrinsics,
    camera_to_world: Float[np.ndarray, "4 4"],
    point: Float[np.ndarray, "3"],
    radius_m: float,
    height_m: float,
) -> bool:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (0, 1) for z in (-1, 1)]) * [radius_m, height_m, radius_m]
    inverse = np.linalg.inv(camera_to_world)
    xy, _ = intrinsics.project(transform_points(inverse, corners + point))
    margin = 0.03 * intrinsics.width
    return bool(((xy > margin) & (xy < [intrinsics.width - margin, intrinsics.height - margin])).all())
