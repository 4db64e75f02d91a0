"""The room as one mesh: the partial meshes of the keyframes, merged and simplified by vertex clustering.

Vertices that share a cell of a cubic grid become one vertex, their mean; triangles with fewer than three different
vertices disappear (Rossignac and Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993). This
also merges surfaces that several keyframes show. World metres, y up; colours are linear RGB.
"""

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float32, Int

from roomlight.camera import rigid_inverse
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.light.glb import glb_file

MAX_TRIANGLES: Final = 100_000
"""Default bound: 1 to 3 MB of glTF. The sample room has as many at cells of 6 cm."""
_FIRST_CELL_M: Final = 0.02
"""Finest cell: about the distance of the vertices at 3 m."""
_KEY_BITS: Final = 21
"""Bits of a vertex index, three of which fit into 64 bits."""
_GROWTH: Final = 1.15
"""Cells grow at least by this factor until the mesh is within its bound: a quarter of the triangles less."""


@dataclass(frozen=True)
class RoomMesh:
    """A triangle mesh in world metres with a colour for each vertex, linear RGB."""

    vertices: Float32[np.ndarray, "v 3"]
    colours: Float32[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]


def room_mesh(meshes: list[FrameMesh], *, max_triangles: int = MAX_TRIANGLES) -> RoomMesh:
    """Merge the meshes of keyframes into at most `max_triangles` triangles."""
    parts = [(mesh.vertices, _vertex_colours(mesh), mesh.faces) for mesh in meshes]
    first = np.cumsum([0, *(len(vertices) for vertices, _, _ in parts)])
    vertices = np.concatenate([np.zeros((0, 3), np.float32), *(part[0] for part in parts)])
    colours = np.concatenate([np.zeros((0, 3), np.float32), *(part[1] for part in parts)])
    faces = np.concatenate(
        [np.zeros((0, 3), np.int64), *(part[2] + at for part, at in zip(parts, first, strict=False))]
    )
    weights = np.ones(len(vertices), np.float32)
    cell_m = _FIRST_CELL_M
    while True:
        clustered = _clustered(vertices, colours, weights, faces, cell_m)
        if len(faces) and not len(clustered[3]):  # no triangle is larger than a cell: some stay as they are
            faces = faces[:: -(-len(faces) // max_triangles)]
            break
        vertices, colours, weights, faces = clustered
        if len(faces) <= max_triangles:
            break
        cell_m *= max(_GROWTH, (len(faces) / max_triangles) ** 0.5)  # a surface has 1 / cell^2 triangles
    return RoomMesh(vertices, colours, faces.astype(np.int32))


def _vertex_colours(mesh: FrameMesh) -> Float32[np.ndarray, "v 3"]:
    camera, k = rigid_inverse(mesh.camera_to_world), mesh.image_camera
    points = mesh.vertices @ camera[:3, :3].T + camera[:3, 3]
    depth_m = np.maximum(-points[:, 2], 1e-6)
    column = (points[:, 0] / depth_m * k.fx + k.cx - 0.5).astype(np.float32)
    row = (-points[:, 1] / depth_m * k.fy + k.cy - 0.5).astype(np.float32)
    shape = mesh.grid_depth_m.shape
    maps = column.reshape(shape), row.reshape(shape)
    read = cv2.remap(mesh.texture.image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return read.reshape(-1, 3).astype(np.float32)


def _clustered(
    vertices: Float32[np.ndarray, "v 3"],
    colours: Float32[np.ndarray, "v 3"],
    weights: Float32[np.ndarray, " v"],
    faces: Int[np.ndarray, "f 3"],
    cell_m: float,
) -> tuple[Float32[np.ndarray, "w 3"], Float32[np.ndarray, "w 3"], Float32[np.ndarray, " w"], Int[np.ndarray, "g 3"]]:
    """Merge the vertices of each cell into their weighted mean; vertices without a triangle are left out."""
    used, faces = _used(len(vertices), faces)
    vertices, colours, weights = vertices[used], colours[used], weights[used]
    cells = np.floor(vertices / cell_m).astype(np.int64) + 2**20  # cameras are within 10 km, 500,000 cells
    key = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    keys, cluster = np.unique(key, return_inverse=True)
    total = np.bincount(cluster, weights, len(keys))

    def mean(values: Float32[np.ndarray, "v 3"]) -> Float32[np.ndarray, "w 3"]:
        sums = [np.bincount(cluster, weights * values[:, axis], len(keys)) for axis in range(3)]
        return (np.stack(sums, axis=-1) / total[:, None]).astype(np.float32)

    moved = cluster[faces]
    a, b, c = moved[:, 0], moved[:, 1], moved[:, 2]
    moved = moved[(a != b) & (b != c) & (c != a)]
    # turned so that the smallest vertex is first, copies of a triangle become equal and keep their orientation
    turned = np.take_along_axis(moved, (moved.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    return mean(vertices), mean(colours), total.astype(np.float32), _without_copies(turned)


def _used(count: int, faces: Int[np.ndarray, "f 3"]) -> tuple[Int[np.ndarray, " u"], Int[np.ndarray, "f 3"]]:
    """Return the indices of the vertices that faces use, and the faces with indices into these."""
    is_used = np.zeros(count, bool)
    is_used[faces] = True
    return np.flatnonzero(is_used), (np.cumsum(is_used) - 1)[faces]


def _without_copies(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "g 3"]:
    """Return each face once. Sorting one number per face takes a tenth of the time of sorting rows."""
    if not len(faces) or faces.max() >= 1 << _KEY_BITS:
        return np.unique(faces, axis=0)
    keys = np.unique((faces[:, 0] << 2 * _KEY_BITS) | (faces[:, 1] << _KEY_BITS) | faces[:, 2])
    mask = (1 << _KEY_BITS) - 1
    return np.stack([keys >> 2 * _KEY_BITS, (keys >> _KEY_BITS) & mask, keys & mask], axis=-1)


def to_glb(mesh: RoomMesh) -> bytes:
    """Encode as binary glTF 2.0: unlit, double sided, colours as 16-bit linear RGBA, radiance above 1 is white."""
    used, faces = _used(len(mesh.vertices), mesh.faces)
    positions = np.ascontiguousarray(mesh.vertices[used], "<f4")
    colours = np.full((len(used), 4), 65535, "<u2")
    colours[:, :3] = np.rint(np.clip(mesh.colours[used], 0, 1) * 65535)
    parts = [positions.tobytes(), colours.tobytes(), np.ascontiguousarray(faces, "<u4").tobytes()]
    bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "RoomLight"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "room"}],
        "materials": [{"extensions": {"KHR_materials_unlit": {}}, "doubleSided": True}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2, "material": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(positions), "type": "VEC3", **bounds},
            {"bufferView": 1, "componentType": 5123, "count": len(colours), "type": "VEC4", "normalized": True},
            {"bufferView": 2, "componentType": 5125, "count": faces.size, "type": "SCALAR"},
        ],
    }
    return glb_file(document, parts)
