# pyright: reportMissingParameterType=false
"""Vectors of triangle corners under a rigid motion, and the boxes around objects."""

from numba import njit


@njit(nogil=True, cache=True, fastmath=True)
def turn_vectors(vectors, rotation, offset, out, start, stop):
    """Write rotation x vector + offset of rows start..stop of `vectors` [n, 3] to `out`."""
    r = rotation
    for i in range(start, stop):
        x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        out[i, 0] = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + offset[0]
        out[i, 1] = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + offset[1]
        out[i, 2] = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + offset[2]


@njit(nogil=True, cache=True)
def grow_boxes(corners, object_id, boxes):
    """Extend each object's box [objects, 2, 3], least and greatest corner, by its triangles' corners [f, 3, 3]."""
    for f in range(len(corners)):
        box = boxes[object_id[f]]
        for k in range(3):
            for axis in range(3):
                value = corners[f, k, axis]
                box[0, axis] = min(box[0, axis], value)
                box[1, axis] = max(box[1, axis], value)
