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
        reach_m: distance along a ray up to which the planes reach; beyond it the panorama is far away again.
    """

    points: np.ndarray
    normals: np.ndarray
    spheres: np.ndarray
    carriers: np.ndarray
    reach_m: float


@njit(**JIT)
def _near_its_objects(supports, k, x, y, z):
    """Return whether a point is over the part of plane k around an object that stands on it: tables end somewhere."""
    n = supports.normals[k]
    for m in range(supports.spheres.shape[0]):
        if supports.carriers[m] != k:
            continue
        ox, oy, oz = supports.spheres[m, 0] - x, supports.spheres[m, 1] - y, supports.spheres[m, 2] - z
        rise = ox * n[0] + oy * n[1] + oz * n[2]
        reach = supports.spheres[m, 3] + 0.5 * supports.reach_m
        if ox * ox + oy * oy + oz * oz - rise * rise < reach * reach:
            return True
    return False


@njit(**JIT)
def support_below(supports, x, y, z):
    """Return the nearest plane under a point and the height above it; -1 where there is none."""
    best, least = -1, 1e30
    for k in range(supports.points.shape[0]):
        n = supports.normals[k]
        height = (
            (x - supports.points[k, 0]) * n[0] + (y - supports.points[k, 1]) * n[1] + (z - supports.points[k, 2]) * n[2]
        )
        if -0.01 < height < least and _near_its_objects(supports, k, x, y, z):
            best, least = k, height
    return best, max(least, 0.0)


@njit(**JIT)
def light_left(spheres, normal, x, y, z):
    """Return the share of light that a point of a plane has left beside and under spheres that stand on it.

    A sphere of radius r whose centre is at height h and distance d takes r^2 h / d^3 of a uniform sky's irradiance.

    spheres:  [k, 4] centre and radius.
    normal:   [3] of the plane, unit.
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
def arriving(world, images, weights, p, d):
    """Return the radiance that arrives at point p from direction d, of the supports and of the panoramas `images`."""
    return arriving_at(world, images, weights, p, d, place_of(d[0], d[1], d[2]))


@njit(**JIT)
def arriving_at(world, images, weights, p, d, place):
    """Return `arriving` for a direction whose `place_of` is known."""
    light, supports = world.light, world.supports
    r, g, b = mixed_at(images, weights, place)
    if supports.points.shape[0] == 0:
        return r, g, b
    k, height = support_below(supports, p[0], p[1], p[2])
    if k < 0:
        return r, g, b
    n = supports.normals[k]
    down = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
    if down * supports.reach_m <= height:
        return r, g, b
    far = height / down
    x, y, z = p[0] + far * d[0], p[1] + far * d[1], p[2] + far * d[2]
    red, green, blue, known = 0.0, 0.0, 0.0, 0.0
    for j in range(images.shape[0]):
        vx, vy, vz = x - light.position[j, 0], y - light.position[j, 1], z - light.position[j, 2]
        above = -(vx * n[0] + vy * n[1] + vz * n[2])
        length = math.sqrt(vx * vx + vy * vy + vz * vz)
        if above <= 0.02 * length:  # the probe is below the plane, or sees it edge on
            continue
        e, f, h = bilinear_at(images[j], place_of(vx / length, vy / length, vz / length))
        red, green, blue = red + weights[j] * e, green + weights[j] * f, blue + weights[j] * h
        known += weights[j]
    if known <= 0:
        return r, g, b
    near = min(2 * (1 - far / supports.reach_m), 1.0)
    left = light_left(supports.spheres, n, x, y, z)
    scale = near * left / known
    rest = (1 - near) * left
    return rest * r + scale * red, rest * g + scale * green, rest * b + scale * blue
