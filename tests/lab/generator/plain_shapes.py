"""Rectangles of many triangles, with a hole if wanted, and rooms of them; areas, volumes and directions of faces."""

from itertools import pairwise

import numpy as np

from roomlight.compositing.objects.polygons import face_normals
from roomlight_generator.rooms.scene import Mesh
from roomlight_generator.rooms.shapes import bare_mesh, grid_faces


def rectangle(origin, edge_u, edge_v, *, step: float = 0.1, hole=None) -> Mesh:
    """Normal along edge_u x edge_v, edges of at most `step`; a hole is (u0, u1, v0, v1) in metres along the edges."""
    start, u, v = (np.asarray(part, np.float64) for part in (origin, edge_u, edge_v))
    length_u, length_v = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    along_u, along_v = (
        _steps(length_u, step, hole[:2] if hole else ()),
        _steps(length_v, step, hole[2:] if hole else ()),
    )
    gu, gv = np.meshgrid(along_u, along_v)
    vertices = start + gu[..., None] * (u / length_u) + gv[..., None] * (v / length_v)
    faces = grid_faces(len(along_v) - 1, len(along_u) - 1)
    if hole:
        middle_u, middle_v = gu.ravel()[faces].mean(1), gv.ravel()[faces].mean(1)
        inside = (middle_u > hole[0]) & (middle_u < hole[1]) & (middle_v > hole[2]) & (middle_v < hole[3])
        faces = faces[~inside]
    normals = np.broadcast_to(np.cross(u, v) / (length_u * length_v), (gu.size, 3))
    return bare_mesh(vertices.reshape(-1, 3), normals, faces)


def room_sides(width, height, depth, *, step: float = 0.1) -> dict[str, Mesh]:
    """The sides of a room about the y axis, standing on y = 0, that face its inside, by name."""
    x, z = width / 2, depth / 2
    return {
        "floor": rectangle([-x, 0, -z], [0, 0, depth], [width, 0, 0], step=step),
        "ceiling": rectangle([-x, height, -z], [width, 0, 0], [0, 0, depth], step=step),
        "back": rectangle([-x, 0, -z], [width, 0, 0], [0, height, 0], step=step),
        "front": rectangle([-x, 0, z], [0, height, 0], [width, 0, 0], step=step),
        "left": rectangle([-x, 0, -z], [0, height, 0], [0, 0, depth], step=step),
        "right": rectangle([x, 0, -z], [0, 0, depth], [0, height, 0], step=step),
    }


def faces_match_normals(mesh: Mesh) -> np.ndarray:
    """Return, for each face with an area, whether its vertex order agrees with its vertices' normals."""
    return (face_normals(mesh.vertices, mesh.faces) * mesh.normals[mesh.faces].mean(1)).sum(1) > -1e-12


def area_m2(vertices, faces) -> np.ndarray:
    """Return the area of each triangle."""
    return np.linalg.norm(face_normals(vertices, faces), axis=1) / 2


def volume_m3(vertices, faces) -> float:
    """Return the volume within a closed surface, negative if it faces inward."""
    corners = vertices[faces].astype(np.float64)
    return float((corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6)


def _steps(length, step, breaks):
    stops = [0.0, *breaks, length]
    pieces = [
        np.linspace(low, high, max(1, int(np.ceil((high - low) / step))) + 1)[1:] for low, high in pairwise(stops)
    ]
    return np.concatenate([np.zeros(1), *pieces])
