"""Objects that have their place in the world: where they are at a time, and where their light is asked."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import transform_points
from roomlight.compositing.kernels.ground import Supports
from roomlight.compositing.light.probes import box_probes, path_probes
from roomlight.compositing.placement.places import (
    Anchor,
    Placement,
    Plane,
    check_places,
    nearby_support,
    place_at,
    place_at_pixel,
    place_by_pose,
)
from roomlight.compositing.placement.room_geometry import RoomGeometry
from roomlight.compositing.placement.scene import AtPixel, AtPose, SceneObject
from roomlight.compositing.rendering.tracer import TracedObjects
from roomlight.frame import Frame

SINK_M: Final = 0.02
"""An object that moves this far below the plane it stood on no longer stands on it."""

SUPPORT_REACH_M: Final = 1.0
"""Objects reflect their support as a plane up to this distance: half a table."""


@dataclass
class PlacedObject:
    """An object of a scene with its place in the world.

    Attributes:
        number: index in the scene.
        placement: before its motion.
        pivot: anchor in the world, about which it moves.
        support: plane that it stands on or hangs at, before its motion.
        centre: of its bounding sphere, in the object's frame.
        radius_m: of its bounding sphere.
    """

    number: int
    object: SceneObject
    placement: Placement
    pivot: Float[np.ndarray, "3"]
    support: Plane | None
    centre: Float[np.ndarray, "3"]
    radius_m: float

    def matrix_at(self, seconds: float, index: int) -> Float[np.ndarray, "4 4"]:
        """Return object to world at a time since the first frame, in a frame of this index."""
        motion = self.object.motion
        if motion is None:
            return self.placement.object_to_world
        at = seconds if motion.unit == "seconds" else float(index)
        return motion.transform_at(at, self.pivot) @ self.placement.object_to_world

    def support_at(self, matrix: Float[np.ndarray, "4 4"]) -> Plane | None:
        """Return the plane that the object stands on at a transform; None once it has moved below it."""
        if self.support is None:
            return None
        box = self.object.box
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        corners = (box.low + corners * (box.high - box.low)) @ matrix[:3, :3].T + matrix[:3, 3]
        return self.support if float(self.support.height_of(corners).min()) > -SINK_M else None

    def sphere(self, matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4"]:
        """Return centre and radius of the bounding sphere at a transform."""
        scale = np.linalg.norm(matrix[:3, 0])
        return np.append(matrix[:3, :3] @ self.centre + matrix[:3, 3], self.radius_m * scale)


def placement_of(scene_object: SceneObject) -> Placement:
    """Return the placement of an object whose place is a position or a pose. Raises SceneError."""
    place, box = scene_object.place, scene_object.box
    if isinstance(place, AtPose):
        return place_by_pose(place.pose, box, anchor=place.anchor)
    assert not isinstance(place, AtPixel)
    return place_at(np.array(place.position), box, yaw_degrees=place.yaw_degrees, anchor=place.anchor)


def place_object(number: int, scene_object: SceneObject, geometry: RoomGeometry, frame: Frame) -> PlacedObject:
    """Give an object its place in the world, by the frame where its place is a pixel. Raises SceneError."""
    place, box = scene_object.place, scene_object.box
    if isinstance(place, AtPixel):
        placement = place_at_pixel(geometry, frame, place.u, place.v, box, yaw_degrees=place.yaw_degrees)
        anchor: Anchor = "back" if placement.kind == "wall" else "top" if placement.kind == "ceiling" else "base"
        support = placement.support
    else:
        placement = placement_of(scene_object)
        anchor = place.anchor
        support = nearby_support(geometry, placement, box, depth_estimated=frame.depth_estimated)
    matrix = placement.object_to_world
    pivot = transform_points(matrix, box.anchor(anchor))
    centre = (box.low + box.high) / 2
    points = np.concatenate([mesh.vertices[np.unique(mesh.faces)] for mesh, _ in scene_object.geometry.parts])
    radius = float(np.linalg.norm(points - centre.astype(np.float32), axis=1).max())
    return PlacedObject(number, scene_object, placement, pivot, support, centre, radius)


def probe_positions(placed: PlacedObject) -> Float[np.ndarray, "n 3"]:
    """Return where the light of an object is asked: at its centre, over its box, or along its path.

    Raises:
        SceneError: such a place is too far away.
    """
    motion, box = placed.object.motion, placed.object.box
    if motion is None:
        positions = box_probes(box.low, box.high, placed.placement.object_to_world)
        check_places(positions, "place")
        return positions
    times = [key.at for key in motion.keys]
    path = np.concatenate([np.linspace(a, b, 24) for a, b in pairwise(times)] or [np.array(times)])
    path = path[np.linspace(0, len(path) - 1, min(len(path), 500)).astype(np.int64)]
    matrices = [motion.transform_at(float(at), placed.pivot) @ placed.placement.object_to_world for at in path]
    positions = np.stack([matrix[:3, :3] @ placed.centre + matrix[:3, 3] for matrix in matrices])
    check_places(positions, "motion")
    return path_probes(positions)


@dataclass(frozen=True, eq=False)
class PosedObjects:
    """The placed objects at one time, in the order of the scene.

    Attributes:
        matrices: [4, 4] object to world of each.
        spheres: [4] centre and radius of each bounding sphere.
        supports: plane that each stands on, if any.
    """

    matrices: list[Float[np.ndarray, "4 4"]]
    spheres: list[Float[np.ndarray, "4"]]
    supports: list[Plane | None]

    @classmethod
    def at(cls, placed: Sequence[PlacedObject], seconds: float, index: int) -> "PosedObjects":
        """Return the objects at a time since the first frame, in a frame of this index."""
        matrices = [item.matrix_at(seconds, index) for item in placed]
        pairs = list(zip(placed, matrices, strict=True))
        return cls(
            matrices, [item.sphere(pose) for item, pose in pairs], [item.support_at(pose) for item, pose in pairs]
        )

    @property
    def planes(self) -> list[Plane]:
        """Planes that any object stands on."""
        return [plane for plane in self.supports if plane is not None]


def supports_of(objects: TracedObjects, spheres: list[Float[np.ndarray, "4"]], planes: list[Plane | None]) -> Supports:
    """Return the planes that objects stand on as the renderer takes them; each plane once."""
    known: list[Plane] = []
    carriers: list[int] = []
    for plane in planes:
        same = [number for number, other in enumerate(known) if plane is not None and _same(plane, other)]
        if plane is not None and not same:
            known.append(plane)
        carriers.append(-1 if plane is None else same[0] if same else len(known) - 1)
    points = np.array([plane.point for plane in known], np.float32).reshape(-1, 3)
    normals = np.array([plane.normal for plane in known], np.float32).reshape(-1, 3)
    bounding = np.stack(spheres)
    shading = bounding.astype(np.float32)  # a copy
    shading[:, 3] = np.minimum(shading[:, 3], objects.shade_radii)
    ends_m = np.array(
        [0.0 if k < 0 else _plane_end(known[k], sphere, objects) for k, sphere in zip(carriers, bounding, strict=True)],
        np.float32,
    )
    return Supports(points, normals, shading, np.array(carriers, np.int32), ends_m, SUPPORT_REACH_M)


def _plane_end(plane: Plane, sphere: Float[np.ndarray, "4"], objects: TracedObjects) -> float:
    """Return how far from an object its plane is known: as far as a table may reach, or up to an object that passes
    through the plane, because there the table has ended."""
    centre, radius = sphere[:3].astype(np.float64), float(sphere[3])
    end = radius + 0.5 * SUPPORT_REACH_M
    for low, high in objects.bounds:
        middle, half = (low + high) / 2, (high - low) / 2
        height, reach = float(plane.height_of(middle)), float(half @ np.abs(plane.normal))
        if height - reach >= -SINK_M or height + reach <= 0:
            continue
        offset = np.clip(centre, low, high) - centre
        aside = offset - (offset @ plane.normal) * plane.normal
        end = min(end, float(np.linalg.norm(aside)))
    return end


def _same(first: Plane, second: Plane) -> bool:
    apart = float(np.abs(first.height_of(np.asarray(second.point))))
    return float(np.dot(first.normal, second.normal)) > 0.999 and apart < SINK_M / 2


def clusters(spheres: list[Float[np.ndarray, "4"]]) -> list[list[int]]:
    """Group objects that are near each other: their shadows are computed together, under one light."""
    groups: list[list[int]] = []
    for number, sphere in enumerate(spheres):
        near = [
            group
            for group in groups
            if any(
                np.linalg.norm(sphere[:3] - spheres[other][:3]) < 2 * (sphere[3] + spheres[other][3]) for other in group
            )
        ]
        groups = [group for group in groups if group not in near]
        groups.append(sorted([number, *(member for group in near for member in group)]))
    # the largest object leads: its position's light is used
    return [sorted(group, key=lambda member: -float(spheres[member][3])) for group in groups]
