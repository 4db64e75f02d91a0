# pyright: reportMissingParameterType=false
"""Light that objects block and reflect, at points of real surfaces; joint bilateral filters of the result."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit


class Receivers(NamedTuple):
    """Points of real surfaces.

    Attributes:
        points: [n, 3] world metres, float32.
        normals: [n, 3] unit, float32.
        subset: [n] which subset of the light samples a point uses.
    """

    points: np.ndarray
    normals: np.ndarray
    subset: np.ndarray


class LightSamples(NamedTuple):
    """Directions sampled from a panorama, in subsets that each estimate the irradiance.

    Attributes:
        directions: [s, m, 3] unit, toward the light.
        weights: [s, m, 3] radiance / (pdf m): a sum of weight x cosine over a subset is the irradiance.
    """

    directions: np.ndarray
    weights: np.ndarray


@njit(nogil=True, cache=True, fastmath=True)
def gather_light(receivers, light, spheres, lift_m, unblocked, candidates, start, stop):
    """Sum the unblocked irradiance of points start..stop, and mark the samples whose ray meets a bounding sphere.

    spheres:     [k, 4] centre and radius.
    unblocked:   [n, 3] out.
    candidates:  [n, m] out, 1 where the ray must be traced.
    """
    zero = np.float32(0)
    for i in range(start, stop):
        s = receivers.subset[i]
        nx, ny, nz = receivers.normals[i, 0], receivers.normals[i, 1], receivers.normals[i, 2]
        px = receivers.points[i, 0] + lift_m * nx
        py = receivers.points[i, 1] + lift_m * ny
        pz = receivers.points[i, 2] + lift_m * nz
        red, green, blue = zero, zero, zero
        for j in range(light.directions.shape[1]):
            candidates[i, j] = 0
            dx, dy, dz = light.directions[s, j, 0], light.directions[s, j, 1], light.directions[s, j, 2]
            cosine = nx * dx + ny * dy + nz * dz
            if cosine <= zero:
                continue
            red += light.weights[s, j, 0] * cosine
            green += light.weights[s, j, 1] * cosine
            blue += light.weights[s, j, 2] * cosine
            for k in range(spheres.shape[0]):
                ox, oy, oz = spheres[k, 0] - px, spheres[k, 1] - py, spheres[k, 2] - pz
                along = ox * dx + oy * dy + oz * dz
                square = ox * ox + oy * oy + oz * oz
                radius2 = spheres[k, 3] * spheres[k, 3]
                if square < radius2 or (along > zero and square - along * along < radius2):
                    candidates[i, j] = 1
                    break
        unblocked[i, 0], unblocked[i, 1], unblocked[i, 2] = red, green, blue


@njit(nogil=True, cache=True, fastmath=True)
def sum_blocked(receivers, light, pairs, share, blocked, squares):
    """Add the light that each (point, sample) pair loses: weight x cosine x share.

    pairs:    [p, 2] indices of point and sample.
    share:    [p] 1 where an object blocks the ray, less where it lets light through.
    blocked:  [n, 3] out, must begin at 0.
    squares:  [n] out: sum of squares of the blocked luminance, for its variance; must begin at 0.
    """
    for p in range(pairs.shape[0]):
        if share[p] == 0:
            continue
        i, j = pairs[p, 0], pairs[p, 1]
        s = receivers.subset[i]
        cosine = np.float32(0)
        for axis in range(3):
            cosine += receivers.normals[i, axis] * light.directions[s, j, axis]
        lost = np.float32(0)
        for c in range(3):
            value = light.weights[s, j, c] * cosine * share[p]
            blocked[i, c] += value
            lost += value
        squares[i] += lost * lost / np.float32(9)


@njit(nogil=True, cache=True, fastmath=True)
def aim_at_spheres(receivers, spheres, lift_m, numbers, reach, directions, factors, start, stop):
    """Choose directions from points start..stop toward bounding spheres, for the light that objects reflect.

    numbers:     [s, m, 2] low-discrepancy numbers in [0, 1), a row a subset.
    reach:       in sphere radii; farther points get none.
    directions:  [n, k, m, 3] out.
    factors:     [n, k, m] out: cosine / (pdf m); 0 where nothing is to be traced.
    """
    zero, one = np.float32(0), np.float32(1)
    count = numbers.shape[1]
    for i in range(start, stop):
        s = receivers.subset[i]
        nx, ny, nz = receivers.normals[i, 0], receivers.normals[i, 1], receivers.normals[i, 2]
        for k in range(spheres.shape[0]):
            ox = spheres[k, 0] - receivers.points[i, 0] - lift_m * nx
            oy = spheres[k, 1] - receivers.points[i, 1] - lift_m * ny
            oz = spheres[k, 2] - receivers.points[i, 2] - lift_m * nz
            far2 = ox * ox + oy * oy + oz * oz
            radius = spheres[k, 3]
            far = math.sqrt(far2)
            toward = nx * ox + ny * oy + nz * oz
            outside = far > np.float32(1.02) * radius
            if far > reach * radius or (outside and toward < -radius):
                for m in range(count):
                    factors[i, k, m] = zero
                continue
            if outside:  # uniform in the cone of the sphere
                ax, ay, az = ox / far, oy / far, oz / far
                least = math.sqrt(max(zero, one - radius * radius / far2))
            else:  # cosine-weighted over the hemisphere
                ax, ay, az = nx, ny, nz
                least = zero
            if abs(ax) < np.float32(0.7):
                ux, uy, uz = zero, az, -ay
            else:
                ux, uy, uz = -az, zero, ax
            length = math.sqrt(ux * ux + uy * uy + uz * uz)
            ux, uy, uz = ux / length, uy / length, uz / length
            vx, vy, vz = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
            for m in range(count):
                first, second = numbers[s, m, 0], numbers[s, m, 1]
                height = one - first * (one - least) if outside else math.sqrt(one - first)
                ring = math.sqrt(max(zero, one - height * height))
                angle = np.float32(2 * math.pi) * second
                cu, cv = ring * math.cos(angle), ring * math.sin(angle)
                dx = height * ax + cu * ux + cv * vx
                dy = height * ay + cu * uy + cv * vy
                dz = height * az + cu * uz + cv * vz
                directions[i, k, m, 0], directions[i, k, m, 1], directions[i, k, m, 2] = dx, dy, dz
                if outside:
                    cosine = max(zero, dx * nx + dy * ny + dz * nz)
                    factors[i, k, m] = cosine * np.float32(2 * math.pi) * (one - least) / count
                else:
                    factors[i, k, m] = np.float32(math.pi) / count


class SurfaceGrid(NamedTuple):
    """Real surfaces on a grid of pixels.

    Attributes:
        points: [h, w, 3] world metres.
        normals: [h, w, 3] unit.
        known: [h, w].
    """

    points: np.ndarray
    normals: np.ndarray
    known: np.ndarray


@njit(nogil=True, cache=True, fastmath=True)
def filter_ratio(ratio, noise, grid, radius, plane_m, out, start, stop):
    """Smooth rows start..stop of a ratio image over one surface, as far as its sampling noise allows.

    ratio:    [h, w, 3] light with objects / without.
    noise:    [h, w] standard deviation of the ratio's luminance.
    plane_m:  distance from a pixel's plane at which a neighbour's weight falls to 1/e.
    """
    height, width = noise.shape
    for i in range(start, stop):
        for j in range(width):
            for c in range(3):
                out[i, j, c] = ratio[i, j, c]
            if not grid.known[i, j]:
                continue
            here = (ratio[i, j, 0] + ratio[i, j, 1] + ratio[i, j, 2]) / np.float32(3)
            total = np.float32(0)
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            for y in range(max(0, i - radius), min(height, i + radius + 1)):
                rim_y = np.float32(0.5) if abs(y - i) == radius else np.float32(1)
                for x in range(max(0, j - radius), min(width, j + radius + 1)):
                    if not grid.known[y, x]:
                        continue
                    # half the weight on the rim: over 2 radius pixels every subset of samples counts the same
                    rim = rim_y * np.float32(0.5) if abs(x - j) == radius else rim_y
                    off, facing = np.float32(0), np.float32(0)
                    for axis in range(3):
                        off += (grid.points[y, x, axis] - grid.points[i, j, axis]) * grid.normals[i, j, axis]
                        facing += grid.normals[y, x, axis] * grid.normals[i, j, axis]
                    off = abs(off) / plane_m
                    if off > 3 or facing < np.float32(0.5):
                        continue
                    there = (ratio[y, x, 0] + ratio[y, x, 1] + ratio[y, x, 2]) / np.float32(3)
                    spread = noise[i, j] * noise[i, j] + noise[y, x] * noise[y, x]
                    change = (there - here) * (there - here) / (np.float32(8) * spread + np.float32(1e-8))
                    weight = rim * math.exp(-off * off - change) * facing
                    total += weight
                    red += weight * ratio[y, x, 0]
                    green += weight * ratio[y, x, 1]
                    blue += weight * ratio[y, x, 2]
            if total > 0:
                out[i, j, 0], out[i, j, 1], out[i, j, 2] = red / total, green / total, blue / total


@njit(nogil=True, cache=True, fastmath=True)
def upsample_ratio(ratio, known, depth, fine_depth, step, edge, out, start, stop):
    """Interpolate a ratio image to rows start..stop of a finer grid, across no depth edge.

    ratio, known, depth:  [h, w, 3], [h, w], [h, w] on every `step`-th pixel, from step // 2 on.
    fine_depth:           [fh, fw] z-depth, 0 unknown.
    edge:                 relative difference of depth at which a neighbour's weight falls to 1/e.
    """
    height, width = depth.shape
    for i in range(start, stop):
        y = np.float32(i - step // 2) / np.float32(step)
        top = (i - step // 2) // step
        for j in range(fine_depth.shape[1]):
            x = np.float32(j - step // 2) / np.float32(step)
            left = (j - step // 2) // step
            here = fine_depth[i, j]
            total = np.float32(0)
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            for dy in range(2):
                row = min(max(top + dy, 0), height - 1)
                share_y = abs(np.float32(1 - dy) - (y - top))
                for dx in range(2):
                    column = min(max(left + dx, 0), width - 1)
                    if not known[row, column]:
                        continue
                    weight = share_y * abs(np.float32(1 - dx) - (x - left)) + np.float32(1e-4)
                    if here > 0:
                        change = (depth[row, column] - here) / (edge * here)
                        weight *= math.exp(-min(change * change, np.float32(30)))
                    total += weight
                    red += weight * ratio[row, column, 0]
                    green += weight * ratio[row, column, 1]
                    blue += weight * ratio[row, column, 2]
            if total > np.float32(1e-9):
                out[i, j, 0], out[i, j, 1], out[i, j, 2] = red / total, green / total, blue / total
            else:
                out[i, j, 0], out[i, j, 1], out[i, j, 2] = np.float32(1), np.float32(1), np.float32(1)
