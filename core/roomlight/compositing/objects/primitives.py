"""Objects made from formulas: sphere, cube, plane, and a vase and a chair of swept profiles. Metres, y up."""

from itertools import product
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from roomlight.compositing.objects.materials import Material, diffuse
from roomlight.compositing.objects.polygons import face_normals
from roomlight.compositing.objects.shading import joined_corners
from roomlight.compositing.objects.virtual_object import TriangleMesh, VirtualObject
from roomlight.errors import ObjectError

_SPHERE_SIDE: Final = 24
"""Quads along an edge of the cube that is bulged to a sphere: its outline deviates by 0.05 % of the radius."""


def sphere(radius_m: float, material: Material | None = None) -> VirtualObject:
    """Return a sphere about the origin; 6,912 triangles. Raises ObjectError if the radius is not positive."""
    check_length("radius_m", radius_m)
    on_cube, faces, _ = _cube(_SPHERE_SIDE)
    points = np.tan(on_cube * (np.pi / 4))  # evens out the angles
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    corners = normals[_by_shorter_diagonals(normals, faces)]
    u, middle = (0.5 + np.arctan2(d[..., 2], d[..., 0]) / (2 * np.pi) for d in (corners, corners.sum(axis=1)[:, None]))
    u = np.where(np.abs(corners[..., 1]) == 1, middle, u - np.rint(u - middle))  # the seam has both, a pole the face's
    uvs = np.stack([u, np.arccos(corners[..., 1]) / np.pi], axis=-1).reshape(-1, 2)
    corners = corners.reshape(-1, 3)
    mesh, _ = joined_corners(corners * radius_m, uvs, corners, None)
    return _object("sphere", mesh, material)


def cube(edge_m: float, material: Material | None = None) -> VirtualObject:
    """Return a cube about the origin. Raises ObjectError if the edge is not positive."""
    check_length("edge_m", edge_m)
    return _object("cube", _box(np.zeros(3), np.full(3, edge_m)), material)


def plane(width_m: float, depth_m: float, material: Material | None = None) -> VirtualObject:
    """Return a horizontal rectangle about the origin, x by z, seen from above and below. Raises ObjectError."""
    check_length("width_m", width_m)
    check_length("depth_m", depth_m)
    x, z = width_m / 2, depth_m / 2
    points = np.array([[-x, 0, -z], [-x, 0, z], [x, 0, z], [x, 0, -z]])
    uvs = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]])
    return _object("plane", TriangleMesh.build(points, np.array([[0, 1, 2], [0, 2, 3]]), uvs=uvs), material)


def vase(height_m: float = 0.3, material: Material | None = None) -> VirtualObject:
    """Return a vase with an inside, standing on y = 0. Raises ObjectError if the height is not positive."""
    check_length("height_m", height_m)
    outer = _points("0 0, .17 0, .19 .02, .24 .15, .29 .32, .27 .5, .18 .68, .115 .8, .11 .88, .135 .95, .165 1")
    inner = _points(".145 .99, .11 .93, .09 .86, .1 .78, .16 .66, .25 .5, .26 .32, .21 .15, .15 .04, 0 .03")
    profile = np.concatenate([_smooth(outer, 8), _smooth(inner, 8)])
    return _object("vase", _lathe(profile * height_m, 96), material)


def chair(height_m: float = 0.85, material: Material | None = None) -> VirtualObject:
    """Return a plain wooden chair standing on y = 0, its back at -z. Raises ObjectError."""
    check_length("height_m", height_m)
    leg, seat, back = 0.04, 0.5, 1.0  # relative to the height
    pieces = [
        (np.array([x, (back if z < 0 else seat - 0.02) / 2, z]), np.array([leg, back if z < 0 else seat - 0.02, leg]))
        for x in (-0.22, 0.22)
        for z in (-0.22, 0.22)
    ]
    pieces.append((np.array([0, seat, 0.02]), np.array([0.5, 0.04, 0.5])))
    pieces.extend((np.array([0, y, -0.22]), np.array([0.4, 0.09, 0.025])) for y in (0.68, 0.81, 0.94))
    pieces.extend((np.array([x, 0.25, 0]), np.array([0.025, 0.025, 0.4])) for x in (-0.22, 0.22))
    boxes = [_box(centre * height_m, size * height_m) for centre, size in pieces]
    return _object("chair", merged(boxes), material or diffuse((0.45, 0.28, 0.15)))


def _object(name: str, mesh: TriangleMesh, material: Material | None) -> VirtualObject:
    return VirtualObject(name, ((mesh, material or diffuse()),))


def _points(text: str) -> Float[np.ndarray, "n 2"]:
    """Read "radius height, radius height, ...", relative to the height of the whole."""
    return np.array([[float(number) for number in pair.split()] for pair in text.split(",")])


def check_length(name: str, value: float) -> None:
    """Raise ObjectError for a length that is not positive."""
    if not np.isfinite(value) or value <= 0:
        raise ObjectError(f"{name} must be a positive number of metres, got {value}")


def _cube(side: int) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "f 3"], Float[np.ndarray, "n 2"]]:
    """Return points of [-1, 1]^3, faces and uvs of the six sides of a cube, counter-clockwise from outside."""
    ticks = np.linspace(0.0, 1.0, side + 1)
    u, v = (grid.reshape(-1) for grid in np.meshgrid(ticks, ticks))
    points = np.empty((6, len(u), 3))
    for own, (axis, sign) in zip(points, product(range(3), (-1, 1)), strict=True):
        own[:, axis] = sign
        own[:, (axis + 1) % 3] = (2 * u - 1) * sign
        own[:, (axis + 2) % 3] = 2 * v - 1
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1)
    quads = np.stack([corner, corner + 1, corner + side + 2, corner + side + 1], axis=1)
    halves = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    faces = (np.arange(6)[:, None, None] * len(u) + halves).reshape(-1, 3)
    return points.reshape(-1, 3), faces, np.tile(np.stack([u, 1 - v], axis=1), (6, 1))


def _by_shorter_diagonals(points: Float[np.ndarray, "n 3"], faces: np.ndarray) -> np.ndarray:
    """Split the quads of a cube on a sphere along their shorter diagonals: then no edge is hollow."""
    quads = faces.reshape(6, 2, -1, 3)  # side, half of a quad, quad
    a, b, c, d = (quads[:, half, :, corner] for half, corner in ((0, 0), (0, 1), (0, 2), (1, 2)))
    first, second = (np.linalg.norm(points[p] - points[q], axis=-1) for p, q in ((a, c), (b, d)))
    kept = (first <= second)[..., None]
    halves = [
        np.where(kept, np.stack(along_ac, axis=-1), np.stack(along_bd, axis=-1))
        for along_ac, along_bd in (((a, b, c), (a, b, d)), ((a, c, d), (b, c, d)))
    ]
    return np.concatenate(halves, axis=1).reshape(-1, 3)


def _box(centre: Float[np.ndarray, "3"], size: Float[np.ndarray, "3"]) -> TriangleMesh:
    points, faces, uvs = _cube(1)
    normals = np.repeat([np.eye(3)[axis] * sign for axis in range(3) for sign in (-1, 1)], 4, axis=0)
    return TriangleMesh.build(points * (size / 2) + centre, faces, normals=normals, uvs=uvs)


def merged(meshes: list[TriangleMesh], scale: float = 1.0) -> TriangleMesh:
    """Return one mesh of all, scaled."""
    counts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    return TriangleMesh.build(
        np.concatenate([mesh.vertices for mesh in meshes]) * scale,
        np.concatenate([mesh.faces + first for mesh, first in zip(meshes, counts, strict=False)]),
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        uvs=np.concatenate([mesh.uvs for mesh in meshes]),
    )


def _smooth(points: Float[np.ndarray, "n 2"], parts: int) -> Float[np.ndarray, "m 2"]:
    """Put a Catmull-Rom curve through points (radius, height), `parts` pieces between neighbours."""
    padded = np.concatenate([2 * points[:1] - points[1:2], points, 2 * points[-1:] - points[-2:-1]])
    t = (np.arange(parts) / parts)[:, None]
    pieces = [
        0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)
        for a, b, c, d in zip(padded, padded[1:], padded[2:], padded[3:], strict=False)
    ]
    curve = np.concatenate([*pieces, points[-1:]])
    return np.maximum(curve, 0.0)


def grid_faces(grid: Float[np.ndarray, "rows columns 3"]) -> Int[np.ndarray, "f 3"]:
    """Return two triangles for each square of a grid of points; those without an area are left out."""
    rows, columns = grid.shape[:2]
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    down, right = corner + columns, corner + 1
    faces = np.concatenate([np.stack([corner, down, right], 1), np.stack([right, down, down + 1], 1)])
    return faces[np.linalg.norm(face_normals(grid.reshape(-1, 3), faces), axis=1) > 1e-12]


def _lathe(profile: Float[np.ndarray, "n 2"], around: int) -> TriangleMesh:
    """Turn a profile (radius, height), from the bottom centre outward and up, about the y axis."""
    rows = len(profile)
    angle = np.arange(around + 1) / around * 2 * np.pi
    radius, height = profile[:, 0][:, None], profile[:, 1][:, None]
    points = np.stack([radius * np.cos(angle), height + 0 * angle, radius * np.sin(angle)], axis=-1)
    u, v = np.meshgrid(np.arange(around + 1) / around, 1 - np.arange(rows) / (rows - 1))
    flat, faces = points.reshape(-1, 3), grid_faces(points)
    mesh = TriangleMesh.build(flat, faces, uvs=np.stack([u, v], axis=-1).reshape(-1, 2))
    normals = mesh.normals.reshape(rows, around + 1, 3).copy()
    seam = normals[:, 0] + normals[:, -1]
    normals[:, 0] = normals[:, -1] = seam
    for row in (0, rows - 1):  # poles on the axis
        if profile[row, 0] < 1e-9:
            normals[row] = normals[row].sum(axis=0)
    return TriangleMesh.build(flat, faces, normals=normals.reshape(-1, 3).astype(np.float64), uvs=mesh.uvs)
