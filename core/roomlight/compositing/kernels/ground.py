# pyright: reportMissingParameterType=false
"""Light from the surfaces that objects stand on: near, so it has parallax, and in the objects' own shade.

A panorama is light from far away. A ray that leaves an object downward meets its support first: the panorama is read
where its probe sees that point, not along the ray.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from roomlight.compositing.kernels.environment import bilinear_at, mixed_at, place_of
from roomlight.kernels.common import JIT


class Supports(NamedTuple):
    """Planes that objects stand on, and the objects as spheres that shade them.

    Attributes:
        points: [k, 3] on the planes, world metres.
        normals: [k, 3] unit.
        spheres: [m, 4] centre and radius, each as large as an object seen from above.
        carriers: [m] the plane that each of these objects stands on, -1 for none.
        ends_m: [m] distance from each of these objects at which its plane is known no longer.
        reach_m: distance along a ray up to which the planes reach; beyond it the panorama is far away again.
    """

    points: np.ndarray
    normals: np.ndarray
    spheres: np.ndarray
    carriers: np.ndarray
    ends_m: np.ndarray
    reach_m: float


@njit(**JIT)
def _height_over(supports, k, x, y, z):
    """Return the height of a point over plane k in metres."""
    n, q = supports.normals[k], supports.points[k]
    return (x - q[0]) * n[0] + (y - q[1]) * n[1] + (z - q[2]) * n[2]


@njit(**JIT)
def _plane_share(supports, k, x, y, z):
    """Return how far plane k is known under a point: 1 near its objects, falling smoothly to 0 at their `ends_m`."""
    n = supports.normals[k]
    most = 0.0
    for m in range(supports.spheres.shape[0]):
        if supports.carriers[m] != k:
            continue
        ox, oy, oz = supports.spheres[m, 0] - x, supports.spheres[m, 1] - y, supports.spheres[m, 2] - z
        rise = ox * n[0] + oy * n[1] + oz * n[2]
        far = math.sqrt(max(ox * ox + oy * oy + oz * oz - rise * rise, 0.0))
        end, half = supports.ends_m[m], 0.5 * (supports.ends_m[m] - supports.spheres[m, 3])
        share = min(max((end - far) / max(half, 1e-6), 0.0), 1.0)
        most = max(most, share * share * (3 - 2 * share))
    return most


@njit(**JIT)
def next_plane_below(supports, x, y, z, above_m):
    """Return the highest plane under a point that lies more than `above_m` below it, and the point's height over it.

    The plane is -1 where there is none.
    """
    best, least = -1, 1e30
    for k in range(supports.points.shape[0]):
        height = _height_over(supports, k, x, y, z)
        if above_m < height < least:
            best, least = k, height
    return best, least


@njit(**JIT)
def light_left(spheres, normal, x, y, z):
    """Return the share of light that a point of a plane has left beside and under spheres that stand on it.

    A sphere of radius r whose centre is at height h and distance d takes r^2 h / d^3 of a uniform sky's irradiance.

    Args:
        spheres: [k, 4] centre and radius.
        normal: [3] of the plane, unit.
    """
    left = 1.0
    for k in range(spheres.shape[0]):
        ox, oy, oz = spheres[k, 0] - x, spheres[k, 1] - y, spheres[k, 2] - z
        height = ox * normal[0] + oy * normal[1] + oz * normal[2]
        square = ox * ox + oy * oy + oz * oz
        radius = spheres[k, 3]
        taken = radius * radius * max(height, 0.0) / max(square * math.sqrt(square), 1e-9)
        left *= 1 - min(taken, 1.0)
    return left


@njit(**JIT)
def _plane_radiance(positions, images, weights, n, x, y, z):
    """Return the probes' weight that sees a point of a plane with normal n from above, and its mean radiance there."""
    red, green, blue, known = 0.0, 0.0, 0.0, 0.0
    for j in range(images.shape[0]):
        vx, vy, vz = x - positions[j, 0], y - positions[j, 1], z - positions[j, 2]
        above = -(vx * n[0] + vy * n[1] + vz * n[2])
        length = math.sqrt(vx * vx + vy * vy + vz * vz)
        if above <= 0.02 * length:  # the probe is below the plane, or sees it edge on
            continue
        r, g, b = bilinear_at(images[j], place_of(vx / length, vy / length, vz / length))
        red, green, blue = red + weights[j] * r, green + weights[j] * g, blue + weights[j] * b
        known += weights[j]
    scale = 1 / known if known > 0 else 0.0
    return known, red * scale, green * scale, blue * scale


@njit(**JIT)
def arriving(world, images, weights, p, d, place):
    """Return the radiance that arrives at point p from direction d, of the supports and of the panoramas `images`.

    `place` is the direction's `place_of`.
    """
    light, supports = world.light, world.supports
    r, g, b = mixed_at(images, weights, place)
    if supports.points.shape[0] == 0:
        return r, g, b
    red, green, blue, rest = 0.0, 0.0, 0.0, 1.0
    above_m = -0.01
    for _ in range(supports.points.shape[0]):
        k, above_m = next_plane_below(supports, p[0], p[1], p[2], above_m)
        if k < 0:
            break
        n, height = supports.normals[k], max(above_m, 0.0)
        down = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
        if down * supports.reach_m <= height:
            continue
        share = rest * _plane_share(supports, k, p[0], p[1], p[2])
        if share <= 0:
            continue
        far = height / down
        x, y, z = p[0] + far * d[0], p[1] + far * d[1], p[2] + far * d[2]
        known, e, f, h = _plane_radiance(light.position, images, weights, n, x, y, z)
        if known <= 0:
            continue
        near = min(2 * (1 - far / supports.reach_m), 1.0)
        left = share * light_left(supports.spheres, n, x, y, z)
        red += left * (near * e + (1 - near) * r)
        green += left * (near * f + (1 - near) * g)
        blue += left * (near * h + (1 - near) * b)
        rest -= share
        if rest <= 0:
            break
    return red + rest * r, green + rest * g, blue + rest * b
