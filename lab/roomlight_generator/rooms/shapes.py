"""Triangle meshes of primitive shapes: blocks, surfaces of revolution. They have no texture coordinates.

Frames: right-handed, y up, metres. Faces of every closed shape point outward, so that a ray that hits a back face
started inside an object.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from roomlight_generator.rooms.scene import Material, Mesh

Number = int | float
"""A length or an angle, int or float: the runtime type checker of the test run does not accept an int for a float."""

_BARE: Final = Material()


def with_material(mesh: Mesh, material: Material) -> Mesh:
    """Return the shape in one material."""
    return replace(mesh, materials=(material,))


def bare_mesh(
    vertices: Float[np.ndarray, "v 3"], normals: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> Mesh:
    """Return a mesh of one plain material."""
    return Mesh(
        vertices.astype(np.float32),
        normals.astype(np.float32),
        np.zeros((len(vertices), 2), np.float32),
        faces.astype(np.int32),
        np.zeros(len(faces), np.int32),
        (_BARE,),
    )


def grid_faces(rows: int, columns: int) -> Int[np.ndarray, "f 3"]:
    """Return the triangles of a (rows + 1) x (columns + 1) vertex grid; the normal is d/d(column) x d/d(row)."""
    index = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)


def smooth_normals(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "v 3"]:
    """Return area-weighted vertex normals; vertices within 10 micrometres of each other share one, to hide seams."""
    cell = np.rint(vertices * 1e5).astype(np.int64)
    _, place = np.unique(cell @ np.array([1, 1 << 21, 1 << 42]), return_inverse=True)
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    at, count = place[faces].T.ravel(), int(place.max()) + 1
    total = np.stack([np.bincount(at, np.tile(area[:, k], 3), count) for k in range(3)], 1)
    normals = total[place]
    return (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)).astype(np.float32)


def sphere_directions(count: int) -> Float[np.ndarray, "{count} 3"]:
    """Return unit directions spread evenly over the sphere (a Fibonacci lattice), float32."""
    k = np.arange(count) + 0.5
    y = 1 - 2 * k / count
    ring = np.sqrt(1 - y * y)
    azimuth = np.pi * (1 + np.sqrt(5)) * k
    return np.stack([ring * np.cos(azimuth), y, ring * np.sin(azimuth)], axis=1).astype(np.float32)


def block(width: Number, height: Number, depth: Number) -> Mesh:
    """Make a sharp-edged box (12 triangles), centred in x and z and standing on y = 0."""
    half = np.array([width, height, depth], np.float64) / 2
    corners = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]])
    vertices, normals, faces = np.empty((6, 4, 3)), np.zeros((6, 4, 3)), []
    for side in range(6):
        axis, sign = side // 2, 1 - 2 * (side % 2)
        vertices[side][:, [(axis + 1) % 3, (axis + 2) % 3]] = corners
        vertices[side, :, axis] = normals[side, :, axis] = sign
        faces.append(4 * side + grid_faces(1, 1)[:, ::sign])
    points = half * vertices.reshape(-1, 3) + [0.0, half[1], 0.0]
    return bare_mesh(points, normals.reshape(-1, 3), np.concatenate(faces))


def lathe(lines: Sequence[Sequence[tuple[Number, Number]]], *, segments: int = 32) -> Mesh:
    """Make a surface of revolution about the y axis: each line of (radius, height) is smooth, with creases between
    lines.

    A line that rises on the outside and closes inward over the top faces outward.
    """
    vertices: list[np.ndarray] = []
    normals: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    offset = 0
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    for line in lines:
        profile = np.asarray(line, np.float64)
        tangent = np.gradient(profile, axis=0)
        normal = np.stack([tangent[:, 1], -tangent[:, 0]], 1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        ring = np.stack([np.cos(angle), np.zeros_like(angle), -np.sin(angle)], 1)
        up = np.array([0.0, 1.0, 0.0])
        vertices.append((profile[:, None, :1] * ring + profile[:, None, 1:] * up).reshape(-1, 3))
        normals.append((normal[:, None, :1] * ring + normal[:, None, 1:] * up).reshape(-1, 3))
        faces.append(grid_faces(len(profile) - 1, segments) + offset)
        offset += len(profile) * (segments + 1)
    return bare_mesh(np.concatenate(vertices), np.concatenate(normals), np.concatenate(faces))


def sphere(radius: Number, *, rings: int = 18, segments: int = 36) -> Mesh:
    """Make a sphere about the origin."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    line = [(max(float(radius * np.cos(t)), 1e-5), float(radius * np.sin(t))) for t in angle]
    return lathe([line], segments=segments)
