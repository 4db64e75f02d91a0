"""Triangle meshes of primitive shapes: rectangles, boxes, surfaces of revolution.

Frames: right-handed, y up, metres. Faces of every closed shape point outward, so that a ray that hits a back face
started inside an object. `step` is the maximum edge length: the irradiance cache is stored at the vertices.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight_generator.rooms.scene import Material, Mesh

Number = int | float
"""A length or an angle, int or float: the runtime type checker of the test run does not accept an int for a float."""

Vector = Sequence[Number] | Float[np.ndarray, "3"]


_BARE: Final = Material()


def with_material(mesh: Mesh, material: Material) -> Mesh:
    """Return the shape in one material. Coordinates in metres become repeats of its texture (those of `unit_uv` are
    kept if the texture has the size 1 x 1)."""
    uvs = mesh.uvs
    if material.texture is not None:
        uvs = (uvs / np.array(material.texture.size_m, np.float32)).astype(np.float32)
    return replace(mesh, uvs=uvs, materials=(material,))


def rotated(mesh: Mesh, degrees: Number, axis: str = "y") -> Mesh:
    """Rotate about an axis through the origin, counter-clockwise seen from its tip."""
    return mesh.transformed(_rotation(degrees, axis), np.zeros(3, np.float32))


def _mesh(vertices: np.ndarray, normals: np.ndarray, uvs: np.ndarray, faces: np.ndarray) -> Mesh:
    return Mesh(
        vertices.astype(np.float32),
        normals.astype(np.float32),
        uvs.astype(np.float32),
        faces.astype(np.int32),
        np.zeros(len(faces), np.int32),
        (_BARE,),
    )


def _rotation(degrees: Number, axis: str) -> Float[np.ndarray, "3 3"]:
    c, s = float(np.cos(np.radians(degrees))), float(np.sin(np.radians(degrees)))
    rows = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }
    return np.array(rows[axis], np.float32)


def _grid_faces(rows: int, columns: int) -> Int[np.ndarray, "f 3"]:
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


def subdivided(length: Number, step: Number, breaks: Sequence[Number] = ()) -> Float[np.ndarray, " n"]:
    """Return coordinates from 0 to length that include the breaks and are at most `step` apart."""
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
    """Make a flat rectangle, normal along edge_u x edge_v; a hole is (u0, u1, v0, v1) in metres along the edges.

    Texture coordinates are metres, or 0 to 1 with v downward (as images are stored) if `unit_uv` is set.
    """
    start, u, v = (np.asarray(part, np.float32) for part in (origin, edge_u, edge_v))
    length_u, length_v = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    along_u = subdivided(length_u, step, hole[:2] if hole else ())
    along_v = subdivided(length_v, step, hole[2:] if hole else ())
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
    return _mesh(
        vertices.reshape(-1, 3).astype(np.float32),
        np.broadcast_to(normal.astype(np.float32), (count, 3)).copy(),
        uv.astype(np.float32),
        faces,
    )


@dataclass(frozen=True, eq=False)
class _BoxTemplate:
    """A rounded box of half size 1 per axis, to be scaled: vertex = core * inner + radius * normal."""

    inner: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    axis: Int[np.ndarray, " v"]
    faces: Int[np.ndarray, "f 3"]


@lru_cache(maxsize=512)
def _box_template(pieces: tuple[int, int, int], arcs: int) -> _BoxTemplate:
    """Build six grids, each with `pieces` segments along its flat part and `arcs` segments to half an edge."""
    arc = np.tan(np.linspace(0, np.pi / 4, arcs + 1))[1:]
    inner: list[np.ndarray] = []
    normals: list[np.ndarray] = []
    axes: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    offset = 0
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        lines: list[tuple[np.ndarray, np.ndarray]] = []
        for other in (a, b):
            flat = np.linspace(-1, 1, pieces[other] + 1)
            lines.append(
                (
                    np.concatenate([np.full(arcs, -1.0), flat, np.full(arcs, 1.0)]),
                    np.concatenate([-arc[::-1], np.zeros(len(flat)), arc]),
                )
            )
        for sign in (1, -1):
            place_a, place_b = np.meshgrid(lines[0][0], lines[1][0])
            slope_a, slope_b = np.meshgrid(lines[0][1], lines[1][1])
            direction = np.empty((*place_a.shape, 3))
            direction[..., a], direction[..., b], direction[..., axis] = slope_a, slope_b, sign
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
            middle = np.empty_like(direction)
            middle[..., a], middle[..., b], middle[..., axis] = place_a, place_b, sign
            grid = _grid_faces(len(lines[1][0]) - 1, len(lines[0][0]) - 1)
            inner.append(middle.reshape(-1, 3))
            normals.append(direction.reshape(-1, 3))
            axes.append(np.full(place_a.size, axis))
            faces.append((grid if sign > 0 else grid[:, ::-1]) + offset)
            offset += place_a.size
    return _BoxTemplate(np.concatenate(inner), np.concatenate(normals), np.concatenate(axes), np.concatenate(faces))


def _along_grain(
    points: Float[np.ndarray, "*v 3"], axis: Int[np.ndarray, " n"], half: Float[np.ndarray, "*u 3"]
) -> Float[np.ndarray, "*v 2"]:
    """Return texture coordinates in metres for points on faces across `axis`: u runs along the longer side of each
    face."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    swap = half[..., a] < half[..., b]
    rows = np.arange(len(axis))
    first, second = points[..., rows, a], points[..., rows, b]
    return np.stack([np.where(swap, second, first), np.where(swap, first, second)], -1)


def box(
    width: Number, height: Number, depth: Number, *, radius: Number = 0.008, step: Number = 0.1, arcs: int = 2
) -> Mesh:
    """Make a box with rounded edges, centred in x and z and standing on y = 0; half an edge has `arcs` segments."""
    half = np.array([width, height, depth], np.float64) / 2
    radius = float(min(radius, half.min() * 0.999))
    core = half - radius
    a, b, c = (max(1, int(np.ceil(2 * length / step - 1e-6))) for length in core)
    template = _box_template((a, b, c), arcs)
    points = core * template.inner + radius * template.normals
    uv = _along_grain(points, template.axis, half)
    points[:, 1] += half[1]
    return _mesh(points, template.normals, uv, template.faces)


def block(width: Number, height: Number, depth: Number) -> Mesh:
    """Make a sharp-edged box (12 triangles), centred in x and z and standing on y = 0."""
    template = _box_template((1, 1, 1), 0)
    half = np.array([width, height, depth], np.float64) / 2
    points = half * template.inner
    uv = _along_grain(points, template.axis, half)
    return _mesh(points + np.array([0.0, half[1], 0.0]), template.normals, uv, template.faces)


def lathe(lines: Sequence[Sequence[tuple[Number, Number]]], *, segments: int = 32) -> Mesh:
    """Make a surface of revolution about the y axis: each line of (radius, height) is smooth, with creases between
    lines.

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
    return _mesh(
        np.concatenate(vertices).astype(np.float32),
        np.concatenate(normals).astype(np.float32),
        np.concatenate(uvs).astype(np.float32),
        np.concatenate(faces).astype(np.int32),
    )


def sphere(radius: Number, *, rings: int = 18, segments: int = 36) -> Mesh:
    """Make a sphere about the origin."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    line = [(max(float(radius * np.cos(t)), 1e-5), float(radius * np.sin(t))) for t in angle]
    return lathe([line], segments=segments)


def faces_match_normals(mesh: Mesh) -> Bool[np.ndarray, " f"]:
    """Return, for each face with an area, whether its vertex order agrees with its vertices' normals."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    geometric_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return (geometric_normals * mesh.normals[mesh.faces].mean(1)).sum(1) > -1e-12
