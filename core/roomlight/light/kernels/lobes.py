# pyright: reportMissingParameterType=false
"""Lobes of light among directions: their edge, and the way to their centre."""

import math

import numpy as np
from numba import njit

from roomlight.kernels.common import KERNEL


@njit(**KERNEL)
def lobe(cosines, inner, outer, shares):
    """Write 1 up to `inner` radians from the axis and 0 beyond `outer`; smooth between, so that nothing flickers.

    `cosines`, of the angles to the axis, and `shares`, which is written, are float64 [n].
    """
    least = math.cos(outer)
    for n in range(len(cosines)):
        ramp = 0.0
        if cosines[n] > least:
            ramp = min((outer - math.acos(min(cosines[n], 1.0))) / (outer - inner), 1.0)
        shares[n] = ramp * ramp * (3 - 2 * ramp)


@njit(**KERNEL)
def shift_to_centre(rays, power, direction, widths):
    """Return the direction after steps to the mean of the rays, by power and distance (mean shift).

    Args:
        rays: float64 [n, 3], unit vectors.
        power: float64 [n], at least 0.
        direction: float64 [3], unit vector.
        widths: float64 [steps], of the steps' kernels (standard deviation), in radians.
    """
    x, y, z = direction[0], direction[1], direction[2]
    for width in widths:
        sharpness = 1 / (width * width)
        mean_x, mean_y, mean_z = 0.0, 0.0, 0.0
        for n in range(len(rays)):
            if power[n] == 0:
                continue
            cosine = rays[n, 0] * x + rays[n, 1] * y + rays[n, 2] * z
            pull = power[n] * math.exp((cosine - 1) * sharpness)
            mean_x += pull * rays[n, 0]
            mean_y += pull * rays[n, 1]
            mean_z += pull * rays[n, 2]
        length = math.sqrt(mean_x * mean_x + mean_y * mean_y + mean_z * mean_z)
        if length < 1e-30:
            break
        x, y, z = mean_x / length, mean_y / length, mean_z / length
    return x, y, z


@njit(**KERNEL)
def gather(kernel, power, gathered):
    """Write power @ kernel, float64 [n] @ float32 [n, k], into `gathered`, float32 [k].

    Rows without power cost nothing, and no matrix is copied.
    """
    gathered[:] = 0
    for row in range(len(power)):
        if power[row] > 0:
            factor = np.float32(power[row])
            for column in range(len(gathered)):
                gathered[column] += factor * kernel[row, column]
