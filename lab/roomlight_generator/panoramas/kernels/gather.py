# pyright: reportMissingParameterType=false
"""Light that points receive from a shell with a panorama on it: from samples of its bright parts, and all around.

World frame: y up, metres. Furniture is not known here: the callers trace the rays that these kernels write.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64
from numba import njit

from roomlight.kernels.common import mixed
from roomlight_generator.panoramas.kernels.shell_views import (
    nearest,
    place,
    radiance_at,
    shade_at,
)
from roomlight_generator.transport.kernels.common import JIT, PHI1, PHI2, cosine_direction, fraction, unit

OFF_M = 2e-3
"""Rays start this far off a surface."""


class LightSamples(NamedTuple):
    """Points of the shell's bright parts, each for an area of it: position, normal, radiance times area, area."""

    position: Float64[np.ndarray, "m 3"]
    normal: Float64[np.ndarray, "m 3"]
    power: Float32[np.ndarray, "m 3"]
    area: Float64[np.ndarray, " m"]


class Rays(NamedTuple):
    """Rays of several points, [n * m]: origins, unit directions, and the distance to what they lead to."""

    origin: Float32[np.ndarray, "r 3"]
    direction: Float32[np.ndarray, "r 3"]
    distance: Float32[np.ndarray, " r"]


@njit(**JIT)
def nodes(shell, position, normal):
    """Write the nodes of all light maps, moved a little into their faces' rectangles.

    Args:
        position, normal: Receive the nodes' positions and normals, [n, 3].
    """
    for f in range(len(shell.start)):
        rows, columns = shell.shape[f, 0], shell.shape[f, 1]
        o, axes = shell.origin[f], shell.axes[f]
        n = axes[0, 1] * axes[1, 2] - axes[0, 2] * axes[1, 1]
        m = axes[0, 2] * axes[1, 0] - axes[0, 0] * axes[1, 2]
        k = axes[0, 0] * axes[1, 1] - axes[0, 1] * axes[1, 0]
        for i in range(rows):
            for j in range(columns):
                at = shell.start[f] + i * columns + j
                b = shell.spacing_m[f] * min(max(j, 0.2), columns - 1.2)
                a = shell.spacing_m[f] * min(max(i, 0.2), rows - 1.2)
                for c in range(3):
                    position[at, c] = o[c] + b * axes[0, c] + a * axes[1, c]
                normal[at, 0], normal[at, 1], normal[at, 2] = n, m, k


@njit(**JIT)
def light_samples(shell, panorama, pixels, power, position, normal, weighted, area):
    """Place samples on the shell at pixels of the panorama.

    Args:
        pixels: Row and column of each sample, [m, 2].
        power: Radiance times solid angle from the panorama's centre, [m, 3].
        position, normal: Receive the samples' positions and normals, [m, 3].
        weighted: Receives radiance times area, [m, 3].
        area: Solid angle of each sample from the centre; becomes its area, [m].
    """
    height, width = panorama.kinds.shape
    ox, oy, oz = panorama.centre
    for k in range(len(pixels)):
        polar = (pixels[k, 0] + 0.5) / height * math.pi
        azimuth = ((pixels[k, 1] + 0.5) / width - 0.5) * 2 * math.pi
        dx, dy, dz = math.sin(polar) * math.cos(azimuth), math.cos(polar), math.sin(polar) * math.sin(azimuth)
        t, triangle = nearest(shell, ox, oy, oz, dx, dy, dz)
        n = shell.normal[triangle]
        cosine = max(-(n[0] * dx + n[1] * dy + n[2] * dz), 0.02)
        position[k, 0], position[k, 1], position[k, 2] = ox + t * dx, oy + t * dy, oz + t * dz
        for c in range(3):
            normal[k, c] = n[c]
            weighted[k, c] = power[k, c] * t * t / cosine
        area[k] *= t * t / cosine


@njit(**JIT)
def light_rays(shell, lights, position, normal, weight, rays):
    """Write the rays from points to all light samples, and their weights.

    The weight is irradiance per radiance times area: that of a disc of the sample's area that faces the point, and 0 if
    the shell hides the sample.

    Args:
        lights: The samples, m of them.
        position, normal: The points, [n, 3].
        weight: Receives the weights, [n, m].
        rays: Receives the rays, [n * m].
    """
    count = len(lights.area)
    for i in range(len(position)):
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        x, y, z = position[i, 0] + OFF_M * nx, position[i, 1] + OFF_M * ny, position[i, 2] + OFF_M * nz
        for k in range(count):
            at = i * count + k
            dx, dy, dz = lights.position[k, 0] - x, lights.position[k, 1] - y, lights.position[k, 2] - z
            length = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-6)
            dx, dy, dz = dx / length, dy / length, dz / length
            here = nx * dx + ny * dy + nz * dz
            there = -(lights.normal[k, 0] * dx + lights.normal[k, 1] * dy + lights.normal[k, 2] * dz)
            weight[i, k] = 0.0
            rays.origin[at, 0], rays.origin[at, 1], rays.origin[at, 2] = x, y, z
            rays.direction[at, 0], rays.direction[at, 1], rays.direction[at, 2] = dx, dy, dz
            rays.distance[at] = 0.99 * length
            if here > 0 and there > 0:
                reach, _ = nearest(shell, x, y, z, dx, dy, dz)
                if reach > 0.99 * length:
                    weight[i, k] = here * there / (length * length + lights.area[k] / math.pi)


@njit(**JIT)
def gather_rays(shell, shade, panorama, position, normal, samples, radiance, rays):
    """Write cosine-distributed rays from points, and the radiance of the shell where each ray meets it.

    Args:
        shade: Factors of the light that the shell reflects, by node of its light maps; empty: 1 everywhere.
        position, normal: The points, [n, 3].
        samples: Rays of a point.
        radiance: Receives the radiance, [n * samples, 3].
        rays: Receives the rays, [n * samples].
    """
    for i in range(len(position)):
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        x, y, z = position[i, 0] + OFF_M * nx, position[i, 1] + OFF_M * ny, position[i, 2] + OFF_M * nz
        h = mixed(np.uint64(i) + np.uint64(0x5DEECE66D))
        first, second = unit(h), unit(mixed(h))
        for k in range(samples):
            at = i * samples + k
            r1, r2 = fraction(first + PHI1 * k), fraction(second + PHI2 * k)
            dx, dy, dz, _ = cosine_direction(nx, ny, nz, r1, r2)
            t, triangle = nearest(shell, x, y, z, dx, dy, dz)
            rays.origin[at, 0], rays.origin[at, 1], rays.origin[at, 2] = x, y, z
            rays.direction[at, 0], rays.direction[at, 1], rays.direction[at, 2] = dx, dy, dz
            rays.distance[at] = t
            radiance[at, 0], radiance[at, 1], radiance[at, 2] = 0.0, 0.0, 0.0
            if triangle >= 0:
                px, py, pz = x + t * dx, y + t * dy, z + t * dz
                u, v = place(panorama, px, py, pz)
                r, g, b = radiance_at(shell, shade, panorama, shell.face[triangle], u, v, px, py, pz)
                radiance[at, 0], radiance[at, 1], radiance[at, 2] = r, g, b


@njit(**JIT)
def irradiance_map(shell, irradiance, panorama, out):
    """Write the irradiance of the shell's light maps where each pixel of the panorama lies."""
    ox, oy, oz = panorama.centre
    for row in range(len(out)):
        polar = (row + 0.5) / len(out) * math.pi
        for column in range(out.shape[1]):
            azimuth = ((column + 0.5) / out.shape[1] - 0.5) * 2 * math.pi
            dx, dy, dz = math.sin(polar) * math.cos(azimuth), math.cos(polar), math.sin(polar) * math.sin(azimuth)
            t, triangle = nearest(shell, ox, oy, oz, dx, dy, dz)
            r, g, b = shade_at(shell, irradiance, shell.face[triangle], ox + t * dx, oy + t * dy, oz + t * dz)
            out[row, column, 0], out[row, column, 1], out[row, column, 2] = r, g, b
