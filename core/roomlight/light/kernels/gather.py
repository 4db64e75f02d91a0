# pyright: reportMissingParameterType=false
"""Weighted gathers for the forms of light: sparse resampling, and lobes read from a pyramid of cube maps."""

import numpy as np
from numba import njit

from roomlight.kernels.common import CACHED


@njit(**CACHED, fastmath=True)
def gather_rows(starts, sources, weights, values, out, begin, end):
    """out[r] = sum of weights x values[sources] over starts[r] .. starts[r + 1], for r in begin .. end."""
    channels = values.shape[1]
    for row in range(begin, end):
        for channel in range(channels):
            out[row, channel] = 0.0
        for entry in range(starts[row], starts[row + 1]):
            source, weight = sources[entry], weights[entry]
            for channel in range(channels):
                out[row, channel] += weight * values[source, channel]


@njit(**CACHED, fastmath=True)
def _add_texels(pyramid, first, size, x, y, z, weight, total):
    """Add weight x the bilinear value along (x, y, z) of the level whose padded faces begin at `first`."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face = 0 if x > 0 else 1
        major, across, down = ax, (-z if x > 0 else z), -y
    elif ay >= az:
        face = 2 if y > 0 else 3
        major, across, down = ay, x, (z if y > 0 else -z)
    else:
        face = 4 if z > 0 else 5
        major, across, down = az, (x if z > 0 else -x), -y
    wide = size + 2  # one texel of the neighbouring faces on each side
    column = (across / major + 1) * np.float32(0.5) * size + np.float32(0.5)
    row = (down / major + 1) * np.float32(0.5) * size + np.float32(0.5)
    i, j = int(column), int(row)
    i, j = min(i, size), min(j, size)
    u, v = column - i, row - j
    corner = first + (face * wide + j) * wide + i
    w00, w10 = weight * (1 - u) * (1 - v), weight * u * (1 - v)
    w01, w11 = weight * (1 - u) * v, weight * u * v
    for channel in range(3):
        total[channel] += (
            w00 * pyramid[corner, channel]
            + w10 * pyramid[corner + 1, channel]
            + w01 * pyramid[corner + wide, channel]
            + w11 * pyramid[corner + wide + 1, channel]
        )


@njit(**CACHED, fastmath=True)
def gather_lobes(pyramid, firsts, sizes, normals, samples, out, begin, end):
    """One lobe about each normal: samples are (x, y, z, level, weight) with z along the normal; levels blend."""
    total = np.zeros(3, np.float32)
    for row in range(begin, end):
        nx, ny, nz = normals[row, 0], normals[row, 1], normals[row, 2]
        # A frame about the normal without a branch at the pole (Duff and others 2017).
        sign = np.float32(1.0) if nz >= 0 else np.float32(-1.0)
        a = np.float32(-1.0) / (sign + nz)
        b = nx * ny * a
        tx, ty, tz = 1 + sign * nx * nx * a, sign * b, -sign * nx
        bx, by, bz = b, sign + ny * ny * a, -ny
        total[:] = 0
        for index in range(samples.shape[0]):
            sx, sy, sz = samples[index, 0], samples[index, 1], samples[index, 2]
            level, weight = samples[index, 3], samples[index, 4]
            x = tx * sx + bx * sy + nx * sz
            y = ty * sx + by * sy + ny * sz
            z = tz * sx + bz * sy + nz * sz
            fine = int(level)
            blend = level - fine
            _add_texels(pyramid, firsts[fine], sizes[fine], x, y, z, weight * (1 - blend), total)
            if blend > 0:
                _add_texels(pyramid, firsts[fine + 1], sizes[fine + 1], x, y, z, weight * blend, total)
        for channel in range(3):
            out[row, channel] = total[channel]
