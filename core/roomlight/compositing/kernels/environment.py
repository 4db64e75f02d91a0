# pyright: reportMissingParameterType=false
"""Panoramas around several positions as a light: radiance, density and samples. World axes, y up."""

import math

import numpy as np
from numba import njit

from roomlight.kernels.common import JIT, KERNEL


@njit(**JIT)
def probe_weights(light, x, y, z, weights):
    """Fill the share of each probe at a point: 1 / (squared distance + `spread_m2`), all of it at a probe without."""
    positions = light.position
    count = positions.shape[0]
    if count == 1:
        weights[0] = 1.0
        return
    total = 0.0
    for k in range(count):
        dx, dy, dz = x - positions[k, 0], y - positions[k, 1], z - positions[k, 2]
        weights[k] = 1 / (dx * dx + dy * dy + dz * dz + light.spread_m2[k] + 1e-8)
        total += weights[k]
    for k in range(count):
        weights[k] /= total


@njit(**JIT)
def angle(y, x):
    """Return atan2(y, x) within 2e-8 (Abramowitz and Stegun 1964, 4.4.49), in a fifth of the library's time."""
    across, up = abs(x), abs(y)
    most = max(across, up)
    t = min(across, up) / most if most > 0 else 0.0
    q = t * t
    turned = 0.0028662257 * q - 0.0161657367
    for k in (0.0429096138, -0.0752896400, 0.1065626393, -0.1420889944, 0.1999355085, -0.3333314528, 1.0):
        turned = turned * q + k
    turned *= t
    if up > across:
        turned = 0.5 * math.pi - turned
    if x < 0:
        turned = math.pi - turned
    return -turned if y < 0 else turned


@njit(**JIT)
def place_of(x, y, z):
    """Return the shares of width and height at which an equirectangular image shows a unit direction."""
    height = min(max(y, -1.0), 1.0)
    return 0.5 + angle(z, x) * (0.5 / math.pi), angle(math.sqrt(1 - height * height), height) * (1 / math.pi)


@njit(**JIT)
def bilinear_at(image, place):
    """Read an equirectangular image [H, 2H, 3] at a place of `place_of`; wraps around, ends at the poles."""
    height, width = image.shape[0], image.shape[1]
    column = place[0] * width - 0.5
    row = min(max(place[1] * height - 0.5, 0.0), height - 1.0)
    left, top = math.floor(column), min(max(int(row), 0), height - 1)
    u, v = column - left, row - top
    bottom = min(top + 1, height - 1)
    right = left + 1 if 0 <= left + 1 < width else 0
    left = left if 0 <= left < width else width - 1
    a, b, c, d = (1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v
    return (
        a * image[top, left, 0] + b * image[top, right, 0] + c * image[bottom, left, 0] + d * image[bottom, right, 0],
        a * image[top, left, 1] + b * image[top, right, 1] + c * image[bottom, left, 1] + d * image[bottom, right, 1],
        a * image[top, left, 2] + b * image[top, right, 2] + c * image[bottom, left, 2] + d * image[bottom, right, 2],
    )


@njit(**JIT)
def mixed_at(images, weights, place):
    """Return the probes' images at a place, mixed by their weights."""
    red, green, blue = 0.0, 0.0, 0.0
    for k in range(images.shape[0]):
        r, g, b = bilinear_at(images[k], place)
        red += weights[k] * r
        green += weights[k] * g
        blue += weights[k] * b
    return red, green, blue


@njit(**JIT)
def pixel_at(light, place):
    """Return the row and column of the pixel that holds a place of `place_of`."""
    height, width = light.density.shape[1], light.density.shape[2]
    return min(int(place[1] * height), height - 1), int(place[0] * width) % width


@njit(**JIT)
def density_at(light, weights, row, column):
    """Return the density per steradian with which `sample` draws the directions of a pixel."""
    total = 0.0
    for k in range(light.density.shape[0]):
        total += weights[k] * light.density[k, row, column]
    return total


@njit(**JIT)
def find(cumulative, begin, end, value):
    """Return the cell in begin .. end whose cumulative interval holds value, and the place within it in [0, 1)."""
    low, high = begin, end
    while high - low > 1:
        middle = (low + high) // 2
        if cumulative[middle] <= value:
            low = middle
        else:
            high = middle
    width = cumulative[low + 1] - cumulative[low]
    return low, min(max((value - cumulative[low]) / width, 0.0), 0.9999999) if width > 0 else 0.5


@njit(**JIT)
def chosen_probe(weights, u):
    """Choose a probe by weight; returns it and u, stretched to [0, 1) again."""
    probe = 0
    while probe < weights.shape[0] - 1 and u >= weights[probe]:
        u -= weights[probe]
        probe += 1
    return probe, min(max(u / max(weights[probe], 1e-12), 0.0), 0.9999999)


@njit(**JIT)
def direction_in(light, row, column, down, across):
    """Return the direction at a place of a pixel, even in solid angle, and its place as by `place_of`."""
    width = light.density.shape[2]
    upper, lower = light.heights[0, row], light.heights[0, row + 1]
    y = upper + (lower - upper) * down
    ring = math.sqrt(max(1 - y * y, 0.0))
    turn = (column + across) / width
    azimuth = (turn - 0.5) * (2 * math.pi)
    return (ring * math.cos(azimuth), y, ring * math.sin(azimuth)), (turn, angle(ring, y) * (1 / math.pi))


@njit(**JIT)
def sample(light, weights, u, v):
    """Draw from (u, v) in [0, 1)^2: a probe by weight, a row, a column, then evenly in solid angle.

    Returns the direction, its place as by `place_of`, and its density per steradian.
    """
    probe, u = chosen_probe(weights, u)
    height, width = light.density.shape[1], light.density.shape[2]
    row, down = find(light.rows[probe], 0, height, v)
    column, across = find(light.columns[probe, row], 0, width, u)
    direction, place = direction_in(light, row, column, down, across)
    return direction, place, density_at(light, weights, row, column)


@njit(**JIT)
def mean_around(light, weights, normal):
    """Return the irradiance / pi around a normal, mixed by the probes' weights."""
    place, rows = place_of(normal[0], normal[1], normal[2]), light.irradiance.shape[1]
    place = (place[0], (place[1] * (rows - 1) + 0.5) / rows)  # its first and last row are on the poles
    return mixed_at(light.irradiance, weights, place)


@njit(**KERNEL)
def add_irradiance(normals, toward, light, out):
    """Add to `out` [3, n] light x cosine around each normal [3, n], over light [m, 3] from directions `toward`."""
    count = normals.shape[1]
    for j in range(len(toward)):
        x, y, z = toward[j, 0], toward[j, 1], toward[j, 2]
        red, green, blue = light[j, 0], light[j, 1], light[j, 2]
        for i in range(count):
            cosine = max(x * normals[0, i] + y * normals[1, i] + z * normals[2, i], np.float32(0))
            out[0, i] += cosine * red
            out[1, i] += cosine * green
            out[2, i] += cosine * blue


@njit(**KERNEL)
def fill_radiance(light, positions, directions, out):
    """Fill the radiance seen from each position in each direction."""
    weights = np.empty(light.radiance.shape[0])
    for i in range(len(directions)):
        probe_weights(light, positions[i, 0], positions[i, 1], positions[i, 2], weights)
        place = place_of(directions[i, 0], directions[i, 1], directions[i, 2])
        out[i, 0], out[i, 1], out[i, 2] = mixed_at(light.radiance, weights, place)


@njit(**KERNEL)
def fill_density(light, directions, out):
    """Fill the density of each direction; of the first probe alone."""
    weights = np.ones(1)
    for i in range(len(directions)):
        row, column = pixel_at(light, place_of(directions[i, 0], directions[i, 1], directions[i, 2]))
        out[i] = density_at(light, weights, row, column)


@njit(**KERNEL)
def fill_samples(light, points, out):
    """Fill the direction that each point of [0, 1)^2 draws; of the first probe alone."""
    weights = np.ones(1)
    for i in range(len(points)):
        direction, _, _ = sample(light, weights, points[i, 0], points[i, 1])
        out[i, 0], out[i, 1], out[i, 2] = direction
