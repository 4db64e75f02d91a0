"""Polygons to triangles, and normals for files that state none."""

from typing import Any, Final

import numpy as np
from jaxtyping import Float, Float32, Int32, Int64, Integer, UInt64

from roomlight.compositing.objects.kernels.ears import clip_ears
from roomlight.errors import ObjectError

_CREASE_COSINE: Final = float(np.cos(np.radians(40.0)))
"""Faces of OBJ and PLY files without normals that meet at less than this shade smoothly: a cube stays a cube, and a
scan stays round. glTF demands flat faces instead."""
_BACK_TO_BACK: Final = -0.5
_MAX_TESTS: Final = 1_000_000_000
"""Of a corner against an ear, for all polygons of a file: a few seconds."""
_MANY: Final = 64
_STEPS: Final = 2
"""Directions count as one that differ by less than half in each coordinate of the unit normal."""
_RAMP: Final = 0.2
"""Of the cosine, centred on the limit."""


def triangles_of(
    sizes: Int64[np.ndarray, " p"], corners: Int64[np.ndarray, " c"], points: Float[np.ndarray, "n 3"]
) -> Int64[np.ndarray, "t 3"]:
    """Cut polygons into triangles by clipping ears; convex quads and triangles are cut all at once.

    Args:
        sizes: Corners of each polygon; polygons of fewer than three are left out.
        corners: Index of each polygon corner's point.

    Returns:
        Rows of three indices into `corners`, not into the points.

    Raises:
        ObjectError: Concave polygons of very many corners take too long.
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
    tests = _MAX_TESTS
    for start, size in zip(starts[sizes > 4].tolist(), sizes[sizes > 4].tolist(), strict=True):
        cut, tests = ear_clipped(points[corners[start : start + size]].astype(np.float64), tests)
        pieces.append(start + cut)
    return np.concatenate(pieces).astype(np.int64)


def ear_clipped(polygon: Float[np.ndarray, "n 3"], tests: int = _MAX_TESTS) -> tuple[Int64[np.ndarray, "t 3"], int]:
    """Cut one simple polygon into n - 2 triangles by clipping ears, in its mean plane; a convex one becomes a fan.

    Returns:
        The triangles, and what is left of `tests`.

    Raises:
        ObjectError: It takes more.
    """
    following = np.roll(polygon, -1, axis=0)
    normal = np.cross(polygon, following).sum(axis=0)  # Newell's: twice the area, for concave polygons too
    axis = int(np.argmax(np.abs(normal)))
    u, v = ((1, 2), (2, 0), (0, 1))[axis]
    flat = polygon[:, [u, v]] * (1.0 if normal[axis] >= 0 else np.array([1.0, -1.0]))
    turns = _cross(np.roll(flat, 1, axis=0), flat, np.roll(flat, -1, axis=0))
    if (turns >= 0).all():
        count = len(polygon) - 2
        corners = np.arange(1, count + 1)
        return np.stack([np.zeros(count, np.int64), corners, corners + 1], axis=1), tests
    ears = np.empty((len(polygon) - 2, 3), np.int64)
    left = clip_ears(np.ascontiguousarray(flat), np.roll(np.arange(len(polygon)), -1), ears, tests)
    if left < 0:
        raise ObjectError(f"its concave polygons take more than {_MAX_TESTS:g} steps to cut; export triangles")
    return ears, left


def _cross(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Any:
    """Return twice the signed area of triangles of 2D points, whose leading axes broadcast."""
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])


def face_normals(points: Float[np.ndarray, "n 3"], faces: Integer[np.ndarray, "f 3"]) -> Float[np.ndarray, "f 3"]:
    """Return twice the area of each triangle along its normal."""
    a, b, c = (points[faces[:, corner]].astype(np.float64) for corner in range(3))
    return np.cross(b - a, c - a)


def row_keys(rows: Float[np.ndarray, "n c"]) -> UInt64[np.ndarray, " n"]:
    """Return a number for each row, the same for equal rows: sorting rows themselves takes ten times as long."""
    bits = (np.ascontiguousarray(rows, np.float32) + np.float32(0)).view(np.uint32)
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
        groups: A smoothing group of each face, 0 is flat; None: faces that meet at less than 40 degrees are one. Those
            that look opposite ways never shade smoothly together.
    """
    weighted = face_normals(points, faces)
    size = np.linalg.norm(weighted, axis=1, keepdims=True)
    unit = weighted / np.maximum(size, 1e-30)
    _, vertex = np.unique(row_keys(points), return_inverse=True)
    face = np.repeat(np.arange(len(faces)), 3)
    at = vertex.reshape(-1)[faces].reshape(-1)  # vertex of each corner
    total = weighted[face]
    smooth = size[face, 0] > 1e-30
    if groups is not None:
        smooth &= groups[face] > 0
        at = at * (int(groups.max(initial=0)) + 1) + groups[face]
    corners = np.flatnonzero(smooth)
    corners = corners[np.argsort(at[corners], kind="stable")]
    if len(corners):
        least = _CREASE_COSINE if groups is None else _BACK_TO_BACK  # two sides of a sheet are no edge
        total[corners] = _smoothed(at[corners], weighted[face[corners]], unit[face[corners]], least)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 1e-30, total / np.maximum(length, 1e-30), unit[face]).astype(np.float32)


def _smoothed(
    at: Int64[np.ndarray, " c"], weighted: Float[np.ndarray, "c 3"], unit: Float[np.ndarray, "c 3"], least: float
) -> Float[np.ndarray, "c 3"]:
    """Return for each corner, in the order of vertices, the sum of the normals at its vertex whose cosine with its own
    is above `least`.

    Where a vertex has more than `_MANY` corners, those that look nearly the same way count as one, and the limit is
    soft: the time grows with the number of corners and not with its square.
    """
    _, at, counts = np.unique(at, return_inverse=True, return_counts=True)
    at = at.reshape(-1)
    code = np.arange(len(at)) - np.repeat(np.cumsum(counts) - counts, counts)  # of a corner or a way at its vertex
    many = counts[at] > _MANY
    side = 2 * _STEPS + 1
    code[many] = (np.rint(unit[many] * _STEPS).astype(np.int64) + _STEPS) @ [1, side, side**2]
    keys, bundle = np.unique(at * max(side**3, _MANY) + code, return_inverse=True)
    sums = np.stack([np.bincount(bundle.reshape(-1), weighted[:, axis], len(keys)) for axis in range(3)], axis=1)
    ways = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)
    counts = np.bincount(keys // max(side**3, _MANY))
    starts = np.cumsum(counts) - counts
    width = np.where(many, _RAMP, 1e-9)
    total = np.zeros_like(weighted)
    for step in range(int(counts.max())):
        rows = np.flatnonzero(step < counts[at])
        other = starts[at[rows]] + step
        share = np.clip((np.einsum("ci,ci->c", unit[rows], ways[other]) - least) / width[rows] + 0.5, 0, 1)
        smooth = share > 0
        total[rows[smooth]] += share[smooth, None] * sums[other[smooth]]
    return total
