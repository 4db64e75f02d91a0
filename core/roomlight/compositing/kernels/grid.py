# pyright: reportMissingParameterType=false
"""Points and normals of the real surfaces on a grid of pixels."""

import math

import numpy as np
from numba import njit

from roomlight.kernels.common import CACHED


@njit(**CACHED, fastmath=True)
def fill_points(depth, lens, camera_to_world, out, start, stop):
    """Fill the world positions of rows start..stop of a depth image.

    Args:
        depth: [h, w] z-depth.
        lens: fx, fy, cx, cy of its pixels.
        camera_to_world: [3, 4].
        out: [h, w, 3].
    """
    m = camera_to_world
    half = np.float32(0.5)
    for i in range(start, stop):
        y = -(np.float32(i) + half - lens[3]) / lens[1]
        for j in range(depth.shape[1]):
            x, far = (np.float32(j) + half - lens[2]) / lens[0], depth[i, j]
            for axis in range(3):
                out[i, j, axis] = far * (m[axis, 0] * x + m[axis, 1] * y - m[axis, 2]) + m[axis, 3]


_WIDE = 5
"""Pixels to each side that tell the normal of a plane where the next ones do not, if they lie on it too."""


@njit(**CACHED, fastmath=True)
def _normal(raw, i, j, reach):
    """Return the unit normal of world positions [h, w, 3] at a pixel, by those `reach` pixels to each side."""
    height, width = raw.shape[:2]
    above, below = max(i - reach, 0), min(i + reach, height - 1)
    left, right = max(j - reach, 0), min(j + reach, width - 1)
    ax, ay, az = (
        raw[i, right, 0] - raw[i, left, 0],
        raw[i, right, 1] - raw[i, left, 1],
        raw[i, right, 2] - raw[i, left, 2],
    )
    bx, by, bz = (
        raw[above, j, 0] - raw[below, j, 0],
        raw[above, j, 1] - raw[below, j, 1],
        raw[above, j, 2] - raw[below, j, 2],
    )
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    scale = np.float32(1) / max(math.sqrt(x * x + y * y + z * z), np.float32(1e-12))
    return x * scale, y * scale, z * scale


@njit(**CACHED, fastmath=True)
def fill_surfaces(raw, depth, eye, planes, tolerance, points, normals, start, stop):
    """Fill normals of rows start..stop by differences of neighbours, and move points near a plane onto it.

    Points move along the line of sight, so that they stay where their pixels show them: moved along the normal, points
    seen at a low angle would come to lie under the object that stands there.

    Args:
        raw: [h, w, 3] world positions.
        depth: [h, w] their z-depth.
        eye: [3] the camera's position.
        planes: [k, 2, 3] a point and the unit normal of each.
        tolerance: distance from a plane that counts as noise: metres, and share of the depth.
        points, normals: [h, w, 3] out.
    """
    width = depth.shape[1]
    for i in range(start, stop):
        for j in range(width):
            x, y, z = _normal(raw, i, j, 1)
            px, py, pz = raw[i, j, 0], raw[i, j, 1], raw[i, j, 2]
            near = tolerance[0] + tolerance[1] * depth[i, j]
            for k in range(planes.shape[0]):
                n, q = planes[k, 1], planes[k, 0]
                rise = (px - q[0]) * n[0] + (py - q[1]) * n[1] + (pz - q[2]) * n[2]
                if abs(rise) >= near:
                    continue
                flat = x * n[0] + y * n[1] + z * n[2] > np.float32(0.7)
                if not flat:  # a sensor's steps of depth tilt neighbours; low things on the plane rise beyond `near`
                    wx, wy, wz = _normal(raw, i, j, _WIDE)
                    flat = wx * n[0] + wy * n[1] + wz * n[2] > np.float32(0.7)
                    for di, dj in ((-_WIDE, 0), (_WIDE, 0), (0, -_WIDE), (0, _WIDE)):
                        p = raw[min(max(i + di, 0), raw.shape[0] - 1), min(max(j + dj, 0), raw.shape[1] - 1)]
                        flat &= abs((p[0] - q[0]) * n[0] + (p[1] - q[1]) * n[1] + (p[2] - q[2]) * n[2]) < near
                if flat:
                    above_eye = (eye[0] - q[0]) * n[0] + (eye[1] - q[1]) * n[1] + (eye[2] - q[2]) * n[2]
                    fall = above_eye - rise
                    if abs(fall) > np.float32(0.05):
                        share = rise / fall
                        px, py, pz = px + share * (px - eye[0]), py + share * (py - eye[1]), pz + share * (pz - eye[2])
                    else:  # seen edge on
                        px, py, pz = px - rise * n[0], py - rise * n[1], pz - rise * n[2]
                    x, y, z = n[0], n[1], n[2]
            points[i, j, 0], points[i, j, 1], points[i, j, 2] = px, py, pz
            normals[i, j, 0], normals[i, j, 1], normals[i, j, 2] = x, y, z
