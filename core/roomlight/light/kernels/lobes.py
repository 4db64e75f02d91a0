# pyright: reportMissingParameterType=false
"""Lobes of light among directions: their edge, and the way to their centre."""

import math

from numba import njit

from roomlight.kernels.common import JIT


@njit(**JIT)
def lobe(rays, axis, inner, outer, shares):
    """Write 1 for rays within `inner` radians of the axis and 0 beyond `outer`; smooth between, so nothing flickers.

    Args:
        rays: float64 [n, 3], unit vectors.
        axis: float64 [3], unit vector.
        inner: radians.
        outer: radians.
        shares: float64 [n], written.
    """
    for n in range(len(rays)):
        cosine = rays[n, 0] * axis[0] + rays[n, 1] * axis[1] + rays[n, 2] * axis[2]
        ramp = (outer - math.acos(min(max(cosine, -1.0), 1.0))) / (outer - inner)
        ramp = min(max(ramp, 0.0), 1.0)
        shares[n] = ramp * ramp * (3 - 2 * ramp)


@njit(**JIT)
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
