# pyright: reportMissingParameterType=false
"""Functions of all kernels: random numbers from hashes, keys of directions, the coat's lobe and its tables.

Directions and points that are passed on their own are tuples (x, y, z) in world axes, y up, metres.
"""

import math
from typing import Any

import numpy as np
from numba import njit

from roomlight.kernels.common import CACHED, mixed, tangents
from roomlight.kernels.microfacets import dielectric, distribution, masking

ALLOCATING: dict[str, Any] = CACHED | {"fastmath": True, "error_model": "numpy"}
"""For kernels that make arrays of their own."""
JIT: dict[str, Any] = {**ALLOCATING, "_nrt": False}
"""For all others: with reference counting on, each call counts a reference to every array argument, 5 ns each."""

PHI1 = 0.7548776662466927  # R2 sequence (Roberts): 1 / plastic number, and its square
PHI2 = 0.5698402909980532
COAT_INDEX = 1.5
LEAST_COSINE = 0.02  # between the viewer and a shading normal that leans away from it


@njit(**JIT)
def unit(value):
    """Turn a hash into a uniform number in [0, 1)."""
    return np.float64(value >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(**JIT)
def fraction(value):
    """Return the fractional part of a number that is not negative."""
    return value - np.floor(value)


@njit(**JIT)
def cosine_direction(nx, ny, nz, r1, r2):
    """Draw a direction about a normal in proportion to its cosine; the fourth value is the cosine."""
    ax, ay, az, bx, by, bz = tangents(nx, ny, nz)
    radius, angle = math.sqrt(r1), 2 * math.pi * r2
    s, t, c = radius * math.cos(angle), radius * math.sin(angle), math.sqrt(max(1 - r1, 1e-9))
    return s * ax + t * bx + c * nx, s * ay + t * by + c * ny, s * az + t * bz + c * nz, c


@njit(**JIT)
def direction_bucket(x, y, z, half):
    """Find the node of an octahedral grid that is nearest to a direction, of (2 half + 1)^2, the axes among them.

    Nodes, not cells: walls' normals lie on the axes and must not flicker between neighbours.
    """
    total = abs(x) + abs(y) + abs(z)
    u, v = x / total, y / total
    if z < 0:
        u, v = (1 - abs(v)) * (1.0 if u >= 0 else -1.0), (1 - abs(u)) * (1.0 if v >= 0 else -1.0)
    side = 2 * half + 1
    return np.int64(np.floor(u * half + half + 0.5)) * side + np.int64(np.floor(v * half + half + 0.5))


@njit(**JIT)
def slot_of(keys, key):
    """Find a key, or the empty place (-1) where it would go, in a table of a power of two places."""
    mask = np.int64(len(keys) - 1)
    at = np.int64(mixed(np.uint64(key)) & np.uint64(mask))
    while keys[at] != key and keys[at] != -1:
        at = (at + 1) & mask
    return at


@njit(**JIT)
def rehash(old_keys, old_values, keys, values):
    """Move all entries to a larger table."""
    for i in range(len(old_keys)):
        if old_keys[i] != -1:
            at = slot_of(keys, old_keys[i])
            keys[at], values[at] = old_keys[i], old_values[i]


@njit(**JIT)
def in_table(table, alpha, cosine):
    """Interpolate a coat table bilinearly; its rows reach alpha = 0.64 (`coat.ROUGHEST`)."""
    row = min(alpha / 0.64, 0.999999) * (table.shape[0] - 1)
    column = min(max(cosine, 0.0), 0.999999) * (table.shape[1] - 1)
    i, j = np.int64(row), np.int64(column)
    f, g = row - i, column - j
    low = table[i, j] * (1 - g) + table[i, j + 1] * g
    return low * (1 - f) + (table[i + 1, j] * (1 - g) + table[i + 1, j + 1] * g) * f


@njit(**JIT)
def in_row(row, alpha):
    """Interpolate linearly a table that has one value for each alpha."""
    at = min(alpha / 0.64, 0.999999) * (len(row) - 1)
    i = np.int64(at)
    return row[i] * (1 - (at - i)) + row[i + 1] * (at - i)


@njit(**JIT)
def lobe(normal, view, light, alpha):
    """Return the lobe's BRDF times the light's cosine, and its density by visible normals, for a light direction."""
    nx, ny, nz = normal
    vx, vy, vz = view
    lx, ly, lz = light
    cos_l = nx * lx + ny * ly + nz * lz
    if cos_l <= 0:
        return 0.0, 0.0
    cos_v = max(nx * vx + ny * vy + nz * vz, LEAST_COSINE)
    hx, hy, hz = vx + lx, vy + ly, vz + lz
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    if length < 1e-6:
        return 0.0, 0.0
    cos_h = min((nx * hx + ny * hy + nz * hz) / length, 1.0)
    toward = max((vx * hx + vy * hy + vz * hz) / length, 0.0)
    reflectance, _ = dielectric(toward, COAT_INDEX)
    density = distribution(cos_h, alpha) * masking(cos_v, alpha) / (4 * cos_v)
    return density * reflectance * masking(cos_l, alpha), density


@njit(**JIT)
def sky_radiance(panorama, x, y, z):
    """Interpolate bilinearly an equirectangular panorama in the project's convention."""
    height, width = panorama.shape[0], panorama.shape[1]
    column = (0.5 + math.atan2(z, x) / (2 * math.pi)) * width - 0.5
    row = math.acos(min(max(y, -1.0), 1.0)) / math.pi * height - 0.5
    c0, r0 = np.int64(np.floor(column)), np.int64(np.floor(row))
    f, g = column - c0, row - r0
    c1, r1 = (c0 + 1) % width, min(max(r0 + 1, 0), height - 1)
    c0, r0 = c0 % width, min(max(r0, 0), height - 1)
    w00, w01, w10, w11 = (1 - g) * (1 - f), (1 - g) * f, g * (1 - f), g * f
    return (
        w00 * panorama[r0, c0, 0] + w01 * panorama[r0, c1, 0] + w10 * panorama[r1, c0, 0] + w11 * panorama[r1, c1, 0],
        w00 * panorama[r0, c0, 1] + w01 * panorama[r0, c1, 1] + w10 * panorama[r1, c0, 1] + w11 * panorama[r1, c1, 1],
        w00 * panorama[r0, c0, 2] + w01 * panorama[r0, c1, 2] + w10 * panorama[r1, c0, 2] + w11 * panorama[r1, c1, 2],
    )
