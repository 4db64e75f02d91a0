"""Polygons to triangles, and normals for files that state none."""

from typing import Any, Final

import numpy as np
from jaxtyping import Float, Float32, Int32, Int64, Integer, UInt64

_CREASE_COSINE: Final = float(np.cos(np.radians(40.0)))
"""Faces of OBJ and PLY files without normals that meet at less than this shade smoothly: a cube stays a cube, and a
scan stays round. glTF demands flat faces instead."""
_BACK_TO_BACK: Final = -0.5


def triangles_of(
    sizes: Int64[np.ndarray, " p"], corners: Int64[np.ndarray, " c"], points: Float[np.ndarray, "n 3"]
) -> Int64[np.ndarray, "t 3"]:
    """Cut polygons into triangles by clipping ears; convex quads and triangles are cut all at once.

    Args:
        sizes: Corners of each polygon; polygons of fewer than three are left out.
        corners: Indices into `corners` themselves stay valid: the result indexes this list, not the points.
        points: The position of each corner.

    Returns:
        Rows of three indices into the list of corners.
    """
    starts = np.cumsum(sizes) - sizes
    pieces: list[np.ndarray] = []
    triangles = starts[sizes == 3]
    pieces.append(triangles[:, None] + np.arange(3))
    quads = starts[sizes == 4]
    if len(quads):
        p = points[corners[quads[:, None] + np.arange(4)]].astype(np.float64)
        # The diagonal 0-2 is inside if both its triangles look the same way.
        first, second = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 0])
        inside = (first * second).sum(axis=1) >= 0
        ways = np.where(inside[:, None], [[0, 1, 2, 0, 2, 3]], [[1, 2, 3, 1, 3, 0]])
        pieces.append((quads[:, None] + ways).reshape(-1, 3))
    for start, size in zip(starts[sizes > 4].tolist(), sizes[sizes > 4].tolist(), strict=True):
        pieces.append(start + ear_clipped(points[corners[start : start + size]].astype(np.float64)))
    return np.concatenate(pieces).astype(np.int64)


def ear_clipped(polygon: Float[np.ndarray, "n 3"]) -> Int64[np.ndarray, "t 3"]:
    """Cut one simple polygon into n - 2 triangles by clipping ears, in its mean plane; a convex one becomes a fan."""
    following = np.roll(polygon, -1, axis=0)
    normal = np.cross(polygon, following).sum(axis=0)  # Newell's: twice the area, for concave polygons too
    axis = int(np.argmax(np.abs(normal)))
    u, v = ((1, 2), (2, 0), (0, 1))[axis]
    flat = polygon[:, [u, v]] * (1.0 if normal[axis] >= 0 else np.array([1.0, -1.0]))
    turns = _cross(np.roll(flat, 1, axis=0), flat, np.roll(flat, -1, axis=0))
    if (turns >= 0).all():
        count = len(polygon) - 2
        return np.stack([np.zeros(count, np.int64), np.arange(1, count + 1), np.arange(2, count + 2)], axis=1)
    left, ears = list(range(len(polygon))), list[tuple[int, int, int]]()
    while len(left) > 3:
        ear = next((at for at in range(len(left)) if _is_ear(flat, left, at)), None)
        if ear is None:  # crosses itself: what is left becomes a fan
            break
        ears.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    ears.extend((left[0], left[at], left[at + 1]) for at in range(1, len(left) - 1))
    return np.array(ears, np.int64)


def _is_ear(flat: Float[np.ndarray, "n 2"], left: list[int], at: int) -> bool:
    a, b, c = left[at - 1], left[at], left[(at + 1) % len(left)]
    if _cross(flat[a], flat[b], flat[c]) <= 0:
        return False
    others = flat[[index for index in left if index not in (a, b, c)]]
    corners = ((flat[a], flat[b]), (flat[b], flat[c]), (flat[c], flat[a]))
    within = np.all([_cross(start, end, others) >= 0 for start, end in corners], axis=0)
    touching = (others[:, None] == flat[[a, b, c]]).all(axis=2).any(axis=1)
    return not (within & ~touching).any()


def _cross(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Any:
    """Return twice the signed area of triangles of 2D points, whose leading axes broadcast."""
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])


def face_normals(points: Float[np.ndarray, "n 3"], faces: Integer[np.ndarray, "f 3"]) -> Float[np.ndarray, "f 3"]:
    """Return twice the area of each triangle along its normal."""
    a, b, c = (points[faces[:, corner]].astype(np.float64) for corner in range(3))
    return np.cross(b - a, c - a)


def row_keys(rows: Float[np.ndarray, "n c"]) -> UInt64[np.ndarray, " n"]:
    """Return a number for each row, the same for equal rows: sorting rows themselves takes ten times as long."""
    bits = (np.ascontiguousarray(rows, np.float32) + np.float32(0)).view(np.uint32).astype(np.uint64)
    keys = np.zeros(len(rows), np.uint64)
    for column in range(bits.shape[1]):
        keys = (keys ^ bits[:, column]) * np.uint64(0x9E3779B97F4A7C15)
        keys ^= keys >> np.uint64(29)
    return keys


def corner_normals(
    points: Float[np.ndarray, "n 3"], faces: Int64[np.ndarray, "f 3"], *, groups: Int32[np.ndarray, " f"] | None = None
) -> Float32[np.ndarray, "3*f 3"]:
    """Return a unit normal for each corner of each triangle: the area-weighted mean of the faces around its vertex that
    shade smoothly with its own face.

    Args:
        points: Vertices; those at the same place are one.
        faces: Triangles.
        groups: A smoothing group of each face, 0 is flat; None: faces that meet at less than 40 degrees are one. Those
            that look opposite ways never shade smoothly together.
    """
    weighted = face_normals(points, faces)
    unit = weighted / np.maximum(np.linalg.norm(weighted, axis=1, keepdims=True), 1e-30)
    _, vertex = np.unique(row_keys(points), return_inverse=True)
    at = vertex.reshape(-1)[faces].reshape(-1)  # vertex of each corner
    face = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(at, kind="stable")
    counts = np.bincount(at)
    starts = np.cumsum(counts) - counts
    total = np.zeros((len(at), 3))
    place = np.empty(len(at), np.int64)
    place[order] = np.arange(len(at)) - np.repeat(starts, counts)
    for step in range(int(counts.max(initial=1))):
        rows = np.flatnonzero(step < counts[at])
        other = face[order[starts[at[rows]] + (place[rows] + step) % counts[at[rows]]]]
        own = face[rows]
        if groups is None:
            smooth = (unit[own] * unit[other]).sum(axis=1) > _CREASE_COSINE
        else:
            smooth = (groups[own] == groups[other]) & (groups[own] > 0)
            smooth &= (unit[own] * unit[other]).sum(axis=1) > _BACK_TO_BACK  # two sides of a sheet are no edge
        smooth |= other == own
        total[rows[smooth]] += weighted[other[smooth]]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 1e-30, total / np.maximum(length, 1e-30), unit[face]).astype(np.float32)
