# pyright: reportMissingParameterType=false
"""Vectors of triangle corners under a rigid motion, the boxes around objects, and faces that nothing rises above."""

import math

from numba import njit

from roomlight.kernels.common import CACHED


@njit(**CACHED, fastmath=True)
def turn_vectors(vectors, rotation, offset, out, start, stop):
    """Write rotation x vector + offset of rows start..stop of `vectors` [n, 3] to `out`."""
    r = rotation
    for i in range(start, stop):
        x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        out[i, 0] = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + offset[0]
        out[i, 1] = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + offset[1]
        out[i, 2] = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + offset[2]


@njit(**CACHED)
def grow_boxes(corners, object_id, boxes):
    """Extend each object's box [objects, 2, 3], least and greatest corner, by its triangles' corners [f, 3, 3]."""
    for f in range(len(corners)):
        box = boxes[object_id[f]]
        for k in range(3):
            for axis in range(3):
                value = corners[f, k, axis]
                box[0, axis] = min(box[0, axis], value)
                box[1, axis] = max(box[1, axis], value)


@njit(**CACHED)
def fill_open(corners, vertices, tolerance, asked, out):
    """Fill whether no vertex is above the plane of each triangle (counter-clockwise side) by more than a tolerance.

    Args:
        corners: [f, 3, 3] of the triangles.
        vertices: [v, 3] that are tested.
        asked: [f] triangles to test; the others become False.
    """
    for f in range(len(corners)):
        out[f] = False
        if not asked[f]:
            continue
        px, py, pz = corners[f, 0, 0] * 1.0, corners[f, 0, 1] * 1.0, corners[f, 0, 2] * 1.0
        ax, ay, az = corners[f, 1, 0] - px, corners[f, 1, 1] - py, corners[f, 1, 2] - pz
        bx, by, bz = corners[f, 2, 0] - px, corners[f, 2, 1] - py, corners[f, 2, 2] - pz
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        limit = x * px + y * py + z * pz + tolerance * math.sqrt(x * x + y * y + z * z)
        is_open = True
        for v in range(len(vertices)):
            if x * vertices[v, 0] + y * vertices[v, 1] + z * vertices[v, 2] > limit:
                is_open = False
                break
        out[f] = is_open
