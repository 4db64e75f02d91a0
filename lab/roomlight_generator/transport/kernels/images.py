# pyright: reportMissingParameterType=false
"""Kernels over pixel grids: smoothing within surfaces, edges that need more rays, light that those rays take over.

A pixel's kind is a number that is equal for pixels of one surface, or -1 where the pixel shows none.
"""

import math

import numpy as np
from numba import njit

from roomlight_generator.transport.kernels.common import ALLOCATING, JIT

REACH = 4  # pixels to each side that decide about an outlier: 80 in all; in rough coats a quarter of them are known
FEW = 8  # a pixel is an outlier if fewer than a share 1 / FEW of the pixels around it are similar
ALIKE = 0.4  # natural logarithm of brightness over which smoothing fades: noise is smoothed, a shadow's edge is kept


@njit(**ALLOCATING)
def smooth(grid, image, known, spread, step, out):
    """Write a bilateral mean over 5 x 5 pixels.

    The mean is over known pixels of the same kind, in one plane, of one direction and alike in brightness. Pixels of
    kind -1 are copied.

    Args:
        grid: The surfaces that the pixels show.
        image: The pixels, [h, w, 3].
        known: Which pixels have a value, [h, w]; set where `out` then has a value.
        spread: Factor of each pixel on the tolerance of brightness, `ALIKE`, [h, w].
        step: Distance of the 5 x 5 pixels from each other.
        out: Receives the means, [h, w, 3].
    """
    kind, position, normal, foot = grid
    had = known.copy()
    height, width = kind.shape
    radius, count = 2, 5
    fall = np.empty((count, count))
    for a in range(count):
        for b in range(count):
            fall[a, b] = math.exp(-((a - radius) ** 2 + (b - radius) ** 2) / 4.0)
    for y in range(height):
        for x in range(width):
            k = kind[y, x]
            if k < 0:
                for c in range(3):
                    out[y, x, c] = image[y, x, c]
                continue
            px, py, pz = position[y, x, 0], position[y, x, 1], position[y, x, 2]
            nx, ny, nz = normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]
            here = image[y, x, 0] + image[y, x, 1] + image[y, x, 2] + 1e-7
            narrow = 1 / (1.5 * step * foot[y, x])
            likeness = 1 / (ALIKE * spread[y, x]) if had[y, x] else 0.0
            total, red, green, blue = 0.0, 0.0, 0.0, 0.0
            for a in range(count):
                j = y + (a - radius) * step
                if j < 0 or j >= height:
                    continue
                for b in range(count):
                    i = x + (b - radius) * step
                    if i < 0 or i >= width or kind[j, i] != k or not had[j, i]:
                        continue
                    agree = nx * normal[j, i, 0] + ny * normal[j, i, 1] + nz * normal[j, i, 2]
                    if agree < 0.9:
                        continue
                    off = (
                        nx * (position[j, i, 0] - px) + ny * (position[j, i, 1] - py) + nz * (position[j, i, 2] - pz)
                    ) * narrow
                    if abs(off) > 1:
                        continue
                    there = image[j, i, 0] + image[j, i, 1] + image[j, i, 2] + 1e-7
                    # (a - b) / (a + b) is half the difference of logarithms, and cheaper.
                    differ = 2 * (there - here) / (there + here) * likeness
                    w = fall[a, b] * (1 - off * off) * (agree - 0.9) * 10 / (1 + differ * differ * differ * differ)
                    total += w
                    red += w * image[j, i, 0]
                    green += w * image[j, i, 1]
                    blue += w * image[j, i, 2]
            if total > 1e-9:
                out[y, x, 0], out[y, x, 1], out[y, x, 2] = red / total, green / total, blue / total
                known[y, x] = True
            else:
                out[y, x, 0], out[y, x, 1], out[y, x, 2] = image[y, x, 0], image[y, x, 1], image[y, x, 2]


@njit(**ALLOCATING)
def tame(image, kind, known, most):
    """Darken outliers: known pixels brighter than `most` times the mean of their surroundings.

    The surroundings are the known pixels of the same kind within `REACH` pixels that are less than half as bright. The
    pixel is an outlier only if nearly all known pixels are: few rays found its light by chance.
    """
    height, width = kind.shape
    total = np.zeros((height, width))
    for y in range(height):
        for x in range(width):
            if kind[y, x] >= 0 and known[y, x]:
                total[y, x] = image[y, x, 0] + image[y, x, 1] + image[y, x, 2]
    for y in range(height):
        for x in range(width):
            here = total[y, x]
            if here <= 0:
                continue
            count, bright, dim = 0, 0, 0.0
            for j in range(max(y - REACH, 0), min(y + REACH + 1, height)):
                for i in range(max(x - REACH, 0), min(x + REACH + 1, width)):
                    if kind[j, i] == kind[y, x] and known[j, i]:
                        count += 1
                        if total[j, i] > 0.5 * here:
                            bright += 1
                        else:
                            dim += total[j, i]
            # A cell is two or three pixels wide: a cell that a rare ray hit is a block of 4 to 9 pixels out of 81.
            if count < 6 or bright * FEW > count + FEW:
                continue
            limit = most * dim / (count - bright)
            if here > limit:
                for c in range(3):
                    image[y, x, c] *= limit / here


@njit(**JIT)
def _differ(grid, y, x, j, i):
    kind, position, normal, foot = grid
    if kind[y, x] != kind[j, i]:
        return True
    if kind[y, x] < 0:
        return False
    agree = normal[y, x, 0] * normal[j, i, 0] + normal[y, x, 1] * normal[j, i, 1] + normal[y, x, 2] * normal[j, i, 2]
    if agree < 0.85:
        return True
    dx = position[j, i, 0] - position[y, x, 0]
    dy = position[j, i, 1] - position[y, x, 1]
    dz = position[j, i, 2] - position[y, x, 2]
    off = dx * normal[y, x, 0] + dy * normal[y, x, 1] + dz * normal[y, x, 2]
    return abs(off) > 2.5 * foot[y, x]


@njit(**JIT)
def edges(grid, image, out):
    """Mark neighbouring pixels that show different surfaces, or whose brightness differs threefold."""
    height, width = grid.kind.shape
    for y in range(height):
        for x in range(width):
            for k in range(2):
                j, i = y + k, x + 1 - k
                if j >= height or i >= width:
                    continue
                here = image[y, x, 0] + image[y, x, 1] + image[y, x, 2] + 1e-6
                there = image[j, i, 0] + image[j, i, 1] + image[j, i, 2] + 1e-6
                jump = here > 3 * there or there > 3 * here
                if jump or _differ(grid, y, x, j, i):
                    out[y, x] = True
                    out[j, i] = True


@njit(**JIT)
def borrow(grid, received, lobe, rays, out):
    """Copy to extra rays what both images hold at the nearest of 3 x 3 pixels of the same surface.

    Args:
        grid: The surfaces that the pixels show.
        received: Irradiance of the pixels, [h, w, 3].
        lobe: Reflections of the pixels, [h, w, 3].
        rays: The surfaces that the extra rays met (`ExtraRays`).
        out: Receives both, and whether such a pixel exists (`Borrowed`).
    """
    kind, position, normal, foot = grid
    pixel_y, pixel_x, kinds, positions, normals = rays
    received_out, lobe_out, was_borrowed = out
    height, width = kind.shape
    for r in range(len(kinds)):
        was_borrowed[r] = False
        if kinds[r] < 0:
            continue
        best = 1e30
        for j in range(max(pixel_y[r] - 1, 0), min(pixel_y[r] + 2, height)):
            for i in range(max(pixel_x[r] - 1, 0), min(pixel_x[r] + 2, width)):
                if kind[j, i] != kinds[r]:
                    continue
                nx, ny, nz = normal[j, i, 0], normal[j, i, 1], normal[j, i, 2]
                if nx * normals[r, 0] + ny * normals[r, 1] + nz * normals[r, 2] < 0.9:
                    continue
                dx = positions[r, 0] - position[j, i, 0]
                dy = positions[r, 1] - position[j, i, 1]
                dz = positions[r, 2] - position[j, i, 2]
                if abs(dx * nx + dy * ny + dz * nz) > 1.5 * foot[j, i]:
                    continue
                d_sq = dx * dx + dy * dy + dz * dz
                if d_sq < best:
                    best = d_sq
                    was_borrowed[r] = True
                    for c in range(3):
                        received_out[r, c] = received[j, i, c]
                        lobe_out[r, c] = lobe[j, i, c]
