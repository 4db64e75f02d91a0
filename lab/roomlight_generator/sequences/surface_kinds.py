"""Kinds of surface by pixel, so that errors are measured by kind; scenes without their panes.

Frames: world, y up, metres; poses camera-to-world, OpenGL axes.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from roomlight.camera import Intrinsics
from roomlight_generator.rooms.scene import Item, Scene
from roomlight_generator.transport import Tracer

_FLAT: Final = 0.25
"""A pixel shows an edge if a corner lies off its middle's plane by more than this share of its distance from it."""


@dataclass(frozen=True, eq=False)
class SurfaceKinds:
    """Masks of the pixels that show a single surface, by its kind: matt or coated."""

    diffuse: Bool[np.ndarray, "h w"]
    coated: Bool[np.ndarray, "h w"]


def without_glass(scene: Scene) -> Scene:
    """Return the scene without its glass panes."""
    items: list[Item] = []
    for item in scene.items:
        mesh = item.mesh
        keep = ~np.array([material.glass for material in mesh.materials])[mesh.face_materials]
        if keep.all():
            items.append(item)
        elif keep.any():
            part = replace(mesh, faces=mesh.faces[keep], face_materials=mesh.face_materials[keep])
            items.append(replace(item, mesh=part))
    return replace(scene, items=tuple(items))


def surface_kinds(tracer: Tracer, camera: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"]) -> SurfaceKinds:
    """Classify the pixels of a view by first hits: a pixel's middle and corners must lie on one flat surface."""
    height, width = camera.height, camera.width
    larger = Intrinsics(camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5, width + 1, height + 1)
    middle, corner = (_first_hits(tracer, intrinsics, camera_to_world) for intrinsics in (camera, larger))
    material, item, points, normals = middle
    alone = material >= 0
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        part = slice(i, i + height), slice(j, j + width)
        off = corner[2][part] - points
        height_off = np.abs((off * normals).sum(-1))
        alone &= (corner[0][part] == material) & (corner[1][part] == item)
        alone &= height_off < _FLAT * np.linalg.norm(off, axis=-1)
    table = tracer.materials
    plain = (table.mirror == 0) & (table.emission.max(1) == 0)
    diffuse, coated = (alone & (plain & chosen)[material] for chosen in (table.roughness == 0, table.roughness > 0))
    return SurfaceKinds(diffuse, coated)


def _first_hits(
    tracer: Tracer, camera: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return material and item (-1: none), points relative to the camera, and unit normals of the pixel centres."""
    rays = camera.rays().reshape(-1, 3) @ camera_to_world[:3, :3].T
    rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
    hits = tracer.trace(np.tile(camera_to_world[:3, 3].astype(np.float32), (len(rays), 1)), rays)
    hit = hits.face >= 0
    material = np.where(hit, tracer.geometry.material[hits.face], -1)
    item = np.where(hit, tracer.geometry.item[hits.face], -1)
    corners = tracer.geometry.corners[hits.face].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shape = camera.height, camera.width
    points = np.where(hit[:, None], rays * hits.distance_m[:, None], 0.0)
    return material.reshape(shape), item.reshape(shape), points.reshape(*shape, 3), normals.reshape(*shape, 3)
