"""Triangle meshes of simple things: grids, rounded boxes, cushions, lathed and swept shapes.

Frames: right-handed, y up, metres. Every closed shape is wound outward, so that a ray that meets a back face knows
it started inside something. `step` is the longest edge wanted: the light cache lives on the vertices.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

Number = int | float
"""A length or an angle as one writes it: 0 and 0.02. The test run's checker takes no int for a float."""

Vector = Sequence[Number] | Float[np.ndarray, "3"]


@dataclass(frozen=True)
class Mesh:
    """Triangles with smooth normals, texture coordinates (metres unless said otherwise) and a material's name."""

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    uv: Float[np.ndarray, "v 2"]
    faces: Int[np.ndarray, "f 3"]
    material: str = ""
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def of(self, material: str, tint: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> "Mesh":
        """The same shape in a material, its colour multiplied by a tint."""
        return replace(self, material=material, tint=tint)

    def moved(self, x: Number, y: Number, z: Number) -> "Mesh":
        """Translated by metres."""
        return replace(self, vertices=self.vertices + np.array([x, y, z], np.float32))

    def turned(self, degrees: Number, axis: str = "y") -> "Mesh":
        """Rotated about an axis through the origin, counter-clockwise seen from its tip."""
        rotation = _rotation(degrees, axis)
        return replace(self, vertices=self.vertices @ rotation.T, normals=self.normals @ rotation.T)


def moved(meshes: Sequence[Mesh], x: Number, y: Number, z: Number, *, degrees: Number = 0.0) -> list[Mesh]:
    """A piece of furniture turned about the vertical axis, then put in its place."""
    return [mesh.turned(degrees).moved(x, y, z) for mesh in meshes]


def _rotation(degrees: Number, axis: str) -> Float[np.ndarray, "3 3"]:
    c, s = float(np.cos(np.radians(degrees))), float(np.sin(np.radians(degrees)))
    rows = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }
    return np.array(rows[axis], np.float32)


def _grid_faces(rows: int, columns: int) -> Int[np.ndarray, "f 3"]:
    """Triangles of a (rows + 1) x (columns + 1) vertex grid; normal is d/d(column) x d/d(row)."""
    index = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)


def smooth_normals(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "v 3"]:
    """Area-weighted vertex normals; vertices at the same place (to 10 micrometres) share one, so seams do not show."""
    _, place = np.unique(np.rint(vertices * 1e5).astype(np.int64), axis=0, return_inverse=True)
    place = place.reshape(-1)
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros((int(place.max()) + 1, 3), np.float64)
    for corner in range(3):
        np.add.at(total, place[faces[:, corner]], area)
    normals = total[place]
    return (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)).astype(np.float32)


def spaced(length: Number, step: Number, breaks: Sequence[Number] = ()) -> Float[np.ndarray, " n"]:
    """Coordinates from 0 to length, no further apart than step, that include the breaks."""
    stops = [0.0, *sorted(breaks), length]
    pieces = [
        np.linspace(low, high, max(1, int(np.ceil((high - low) / step))) + 1)[1:] for low, high in pairwise(stops)
    ]
    return np.concatenate([np.zeros(1), *pieces]).astype(np.float32)


def rectangle(
    origin: Vector,
    edge_u: Vector,
    edge_v: Vector,
    *,
    step: Number = 0.1,
    hole: tuple[Number, Number, Number, Number] | None = None,
    unit_uv: bool = False,
) -> Mesh:
    """A flat rectangle, normal along edge_u x edge_v; a hole is (u0, u1, v0, v1) in metres along the edges.

    Texture coordinates are metres, or 0 to 1 with v downward (as images are stored) where `unit_uv` is set.
    """
    start, u, v = (np.asarray(part, np.float32) for part in (origin, edge_u, edge_v))
    length_u, length_v = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    along_u = spaced(length_u, step, hole[:2] if hole else ())
    along_v = spaced(length_v, step, hole[2:] if hole else ())
    gu, gv = np.meshgrid(along_u, along_v)
    vertices = start + gu[..., None] * (u / length_u) + gv[..., None] * (v / length_v)
    faces = _grid_faces(len(along_v) - 1, len(along_u) - 1)
    if hole:
        middle_u, middle_v = gu.ravel()[faces].mean(1), gv.ravel()[faces].mean(1)
        inside = (middle_u > hole[0]) & (middle_u < hole[1]) & (middle_v > hole[2]) & (middle_v < hole[3])
        faces = faces[~inside]
    normal = np.cross(u, v) / (length_u * length_v)
    uv = np.stack([gu / length_u, 1 - gv / length_v] if unit_uv else [gu, gv], -1).reshape(-1, 2)
    count = gu.size
    return Mesh(
        vertices.reshape(-1, 3).astype(np.float32),
        np.broadcast_to(normal.astype(np.float32), (count, 3)).copy(),
        uv.astype(np.float32),
        faces,
    )


def box(
    width: Number, height: Number, depth: Number, *, radius: Number = 0.008, step: Number = 0.1, arcs: int = 2
) -> Mesh:
    """A box with rounded edges, centred in x and z and standing on y = 0; half an edge has `arcs` segments."""
    half = np.array([width, height, depth]) / 2
    radius = float(min(radius, half.min() * 0.999))
    core = half - radius
    arc = np.tan(np.linspace(0, np.pi / 4, arcs + 1))[1:]
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
    offset = 0
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        lines: list[tuple[np.ndarray, np.ndarray]] = []
        for other in (a, b):
            inner = spaced(2 * float(core[other]), step) - core[other]
            place = np.concatenate([np.full(arcs, -core[other]), inner, np.full(arcs, core[other])])
            slope = np.concatenate([-arc[::-1], np.zeros(len(inner)), arc])
            lines.append((place, slope))
        for sign in (1, -1):
            place_a, place_b = np.meshgrid(lines[0][0], lines[1][0])
            slope_a, slope_b = np.meshgrid(lines[0][1], lines[1][1])
            direction = np.empty((*place_a.shape, 3))
            direction[..., a], direction[..., b], direction[..., axis] = slope_a, slope_b, sign
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
            middle = np.empty_like(direction)
            middle[..., a], middle[..., b], middle[..., axis] = place_a, place_b, sign * core[axis]
            points = middle + radius * direction
            faces = _grid_faces(len(lines[1][0]) - 1, len(lines[0][0]) - 1)
            if sign < 0:
                faces = faces[:, ::-1]
            # Grain runs along the longer side of each face.
            pair = (a, b) if half[a] >= half[b] else (b, a)
            uv = points[..., list(pair)]
            parts.append((points.reshape(-1, 3), direction.reshape(-1, 3), uv.reshape(-1, 2), faces + offset))
            offset += points.shape[0] * points.shape[1]
    vertices, normals, uv, faces = (np.concatenate(part) for part in zip(*parts, strict=True))
    vertices[:, 1] += half[1]
    return Mesh(vertices.astype(np.float32), normals.astype(np.float32), uv.astype(np.float32), faces.astype(np.int32))


def cushion(width: Number, height: Number, depth: Number, *, plump: Number = 0.5, radius: Number = 0.05) -> Mesh:
    """A soft box, thickest in the middle of its largest side: `height` is its thickness, standing on y = 0.

    plump 0 is a rounded box; 1 tapers to nothing at the seams, as a scatter cushion does.
    """
    base = box(width, height, depth, radius=min(radius, height * 0.49), step=0.05, arcs=3)
    points = base.vertices.copy()
    x, z = 2 * points[:, 0] / width, 2 * points[:, 2] / depth
    profile = 1 - plump * (1 - np.sqrt(np.clip(1 - x**4, 0, 1) * np.clip(1 - z**4, 0, 1)))
    points[:, 1] = height / 2 + (points[:, 1] - height / 2) * profile
    # Corners of a filled cover stand out a little: its sides are drawn in between them.
    points[:, 0] *= 1 - 0.05 * plump * (1 - z**2)
    points[:, 2] *= 1 - 0.05 * plump * (1 - x**2)
    return replace(base, vertices=points.astype(np.float32), normals=smooth_normals(points, base.faces))


def lathe(lines: Sequence[Sequence[tuple[Number, Number]]], *, segments: int = 32) -> Mesh:
    """Turned about the y axis: each line of (radius, height) is smooth, corners lie between lines.

    A line that rises on the outside and closes inward over the top faces outward.
    """
    vertices: list[np.ndarray] = []
    normals: list[np.ndarray] = []
    uvs: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    offset = 0
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    for line in lines:
        profile = np.asarray(line, np.float64)
        tangent = np.gradient(profile, axis=0)
        normal = np.stack([tangent[:, 1], -tangent[:, 0]], 1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        run = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
        ring = np.stack([np.cos(angle), np.zeros_like(angle), -np.sin(angle)], 1)
        up = np.array([0.0, 1.0, 0.0])
        vertices.append((profile[:, None, :1] * ring + profile[:, None, 1:] * up).reshape(-1, 3))
        normals.append((normal[:, None, :1] * ring + normal[:, None, 1:] * up).reshape(-1, 3))
        width = np.broadcast_to(angle * float(profile[:, 0].max()), (len(profile), segments + 1))
        uvs.append(np.stack([width, np.broadcast_to(run[:, None], width.shape)], -1).reshape(-1, 2))
        faces.append(_grid_faces(len(profile) - 1, segments) + offset)
        offset += len(profile) * (segments + 1)
    return Mesh(
        np.concatenate(vertices).astype(np.float32),
        np.concatenate(normals).astype(np.float32),
        np.concatenate(uvs).astype(np.float32),
        np.concatenate(faces).astype(np.int32),
    )


def rod(start: Vector, end: Vector, radius: Number, end_radius: Number | None = None, *, segments: int = 14) -> Mesh:
    """A straight round bar between two points, closed at both ends, tapering where `end_radius` differs."""
    low, high = np.asarray(start, np.float64), np.asarray(end, np.float64)
    length = float(np.linalg.norm(high - low))
    top = radius if end_radius is None else end_radius
    steps = max(2, int(length / 0.1) + 1)
    side = [(radius + (top - radius) * t, length * t) for t in np.linspace(0, 1, steps)]
    mesh = lathe([[(1e-4, 0.0), (radius, 0.0)], side, [(top, length), (1e-4, length)]], segments=segments)
    y = (high - low) / length
    x = np.cross(y, [0.0, 0.0, 1.0] if abs(y[2]) < 0.9 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    frame = np.stack([x, y, np.cross(x, y)], 1).astype(np.float32)
    return replace(mesh, vertices=mesh.vertices @ frame.T + low.astype(np.float32), normals=mesh.normals @ frame.T)


def sphere(radius: Number, *, rings: int = 18, segments: int = 36) -> Mesh:
    """A ball about the origin."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    line = [(max(float(radius * np.cos(t)), 1e-5), float(radius * np.sin(t))) for t in angle]
    return lathe([line], segments=segments)


def sheet(points: Float[np.ndarray, "rows columns 3"], *, thickness: Number = 0.004) -> Mesh:
    """A thin bent surface seen from both sides (a leaf, a curtain): two layers, each facing out."""
    rows, columns = points.shape[:2]
    faces = _grid_faces(rows - 1, columns - 1)
    middle = points.reshape(-1, 3).astype(np.float32)
    normals = smooth_normals(middle, faces)
    lengths_u = np.linalg.norm(np.diff(points, axis=1), axis=-1).mean(0)
    lengths_v = np.linalg.norm(np.diff(points, axis=0), axis=-1).mean(1)
    u, v = np.meshgrid(np.concatenate([[0], np.cumsum(lengths_u)]), np.concatenate([[0], np.cumsum(lengths_v)]))
    uv = np.stack([u, v], -1).reshape(-1, 2).astype(np.float32)
    half = np.float32(thickness / 2)
    return Mesh(
        np.concatenate([middle + half * normals, middle - half * normals]),
        np.concatenate([normals, -normals]),
        np.concatenate([uv, uv]),
        np.concatenate([faces, faces[:, ::-1] + len(middle)]).astype(np.int32),
    )


def faces_look_along_normals(mesh: Mesh) -> Bool[np.ndarray, " f"]:
    """For each face with an area, whether its winding agrees with its vertices' normals."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    wound = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return (wound * mesh.normals[mesh.faces].mean(1)).sum(1) > -1e-12
