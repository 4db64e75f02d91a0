"""The Utah teapot (Martin Newell, 1975) from its Bezier patches, in Blinn's proportions. Metres, y up.

The control points of the turned parts lie on four quarter circles, so a profile of four points stands for four patches.
Handle and spout are given by the middle of each ring's inner and outer side, and its half width.
"""

from typing import Final

import numpy as np
from jaxtyping import Float, Int

from roomlight.compositing.objects.materials import Material, diffuse
from roomlight.compositing.objects.polygons import face_normals
from roomlight.compositing.objects.primitives import check_length, grid_faces, merged
from roomlight.compositing.objects.virtual_object import TriangleMesh, VirtualObject
from roomlight.errors import ObjectError

_QUARTER: Final = 0.56
"""Newell's distance of a quarter circle's control points from its ends, in radii."""
_HEIGHT: Final = 3.15
_TURNED: Final = (
    ((1.4, 2.4), (1.3375, 2.53125), (1.4375, 2.53125), (1.5, 2.4)),  # rim
    ((1.5, 2.4), (1.75, 1.875), (2.0, 1.35), (2.0, 0.9)),  # body
    ((2.0, 0.9), (2.0, 0.45), (1.5, 0.225), (1.5, 0.15)),
    ((1.5, 0.15), (1.5, 0.075), (1.425, 0.0), (0.0, 0.0)),  # bottom
    ((0.0, 3.15), (0.8, 3.15), (0.0, 2.85), (0.2, 2.7)),  # lid
    ((0.2, 2.7), (0.4, 2.55), (1.3, 2.55), (1.3, 2.4)),
)
"""Profiles (radius, height), from the inside of the pot's upper edge, or from the top of the lid, outward and down."""
_HANDLE: Final = (
    ((-1.6, 2.025, -1.5, 2.25, 0.3), (-2.3, 2.025, -2.5, 2.25, 0.3), (-2.7, 2.025, -3.0, 2.25, 0.3),
     (-2.7, 1.8, -3.0, 1.8, 0.3)),
    ((-2.7, 1.8, -3.0, 1.8, 0.3), (-2.7, 1.575, -3.0, 1.35, 0.3), (-2.5, 1.125, -2.65, 0.9375, 0.3),
     (-2.0, 0.9, -1.9, 0.6, 0.3)),
)  # fmt: skip
_SPOUT: Final = (
    ((1.7, 1.425, 1.7, 0.6, 0.66), (2.6, 1.425, 3.1, 0.825, 0.66), (2.3, 2.1, 2.4, 2.025, 0.25),
     (2.7, 2.4, 3.3, 2.4, 0.25)),
    ((2.7, 2.4, 3.3, 2.4, 0.25), (2.8, 2.475, 3.525, 2.49375, 0.25), (2.9, 2.475, 3.45, 2.5125, 0.15),
     (2.8, 2.4, 3.2, 2.4, 0.15)),
)  # fmt: skip
"""Rings (x, height) of the inner and of the outer side, and half the width."""

Points = Float[np.ndarray, "_ _ 3"]


def teapot(height_m: float = 0.16, material: Material | None = None, *, parts: int = 8) -> VirtualObject:
    """Return the teapot standing on y = 0, its spout toward +x; 4,032 triangles with 8 parts along a patch's side.

    Raises:
        ObjectError: The height is not positive, or `parts` is not 2 to 64.
    """
    check_length("height_m", height_m)
    if not 2 <= parts <= 64:
        raise ObjectError(f"parts must be 2 to 64, got {parts}")
    pot, lid = (_surface([_turned(row) for row in rows], parts) for rows in (_TURNED[:4], _TURNED[4:]))
    tubes = [_surface([_tube(row) for row in rows], parts) for rows in (_HANDLE, _SPOUT)]
    pieces = [_mesh(pot), _mesh(lid), *(_mesh(tube) for tube in tubes)]
    return VirtualObject("teapot", ((merged(pieces, height_m / _HEIGHT), material or diffuse()),))


def _turned(profile: tuple[tuple[float, float], ...]) -> Points:
    """Return control points [4, 13, 3] of four patches around the y axis."""
    k = _QUARTER
    quarter = [(1, 0), (1, k), (k, 1), (0, 1), (-k, 1), (-1, k), (-1, 0), (-1, -k), (-k, -1), (0, -1), (k, -1), (1, -k)]
    circle = np.array([*quarter, quarter[0]], np.float64)
    return np.array([[(radius * x, height, -radius * y) for x, y in circle] for radius, height in profile])


def _tube(rings: tuple[tuple[float, float, float, float, float], ...]) -> Points:
    """Return control points [4, 7, 3] of two mirrored patches around a tube."""
    return np.array(
        [
            [(x0, y0, 0), (x0, y0, -w), (x1, y1, -w), (x1, y1, 0), (x1, y1, w), (x0, y0, w), (x0, y0, 0)]
            for x0, y0, x1, y1, w in rings
        ]
    )


def _surface(pieces: list[Points], parts: int) -> Points:
    """Evaluate rows of patches, one after the other, on a grid of `parts` a patch; shared borders occur once."""
    share = np.arange(parts + 1) / parts
    basis = np.stack([(1 - share) ** 3, 3 * share * (1 - share) ** 2, 3 * share**2 * (1 - share), share**3], axis=1)
    rows: list[Points] = []
    for control in pieces:
        columns = [
            np.einsum("ir,jc,rck->ijk", basis, basis, control[:, first : first + 4])
            for first in range(0, control.shape[1] - 1, 3)
        ]
        joined = np.concatenate([columns[0], *(column[:, 1:] for column in columns[1:])], axis=1)
        rows.append(joined if not rows else joined[1:])
    return np.concatenate(rows)


def _mesh(grid: Points) -> TriangleMesh:
    """Make a mesh of a grid whose last column is its first; faces without an area are left out."""
    rows, columns = grid.shape[:2]
    points = grid.reshape(-1, 3)
    faces = grid_faces(grid)
    v, u = np.meshgrid(np.arange(rows) / (rows - 1), np.arange(columns) / (columns - 1), indexing="ij")
    return TriangleMesh.build(
        points, faces, normals=_normals(grid, faces), uvs=np.stack([u, v], axis=-1).reshape(-1, 2)
    )


def _normals(grid: Points, faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the mean normals of the faces; points at one place, at the seam and at the poles, share theirs."""
    points = grid.reshape(-1, 3)
    weighted = face_normals(points, faces)
    _, same = np.unique(np.round(points, 6), axis=0, return_inverse=True)
    same = same.reshape(-1)
    total = np.zeros((same.max() + 1, 3))
    for corner in range(3):
        np.add.at(total, same[faces[:, corner]], weighted)
    return total[same]
