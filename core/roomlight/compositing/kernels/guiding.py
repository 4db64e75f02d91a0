# pyright: reportMissingParameterType=false
"""Directions of the light drawn in proportion to light x scattering, by cells of the panorama.

The panorama has 8 x 16 cells (fewer rows: one cell a row). A guide holds the probability of each cell at one surface,
from the cell's light and from the scattering toward its mean direction; within a cell, pixels are drawn by their light.
A guide costs 4 microseconds, so it is made once for the samples of a pixel. Any guide without zeros is unbiased, as the
density is that of the guide: a sample may use a neighbour's.
"""

import math

from numba import njit

from roomlight.compositing.kernels.environment import density_at, direction_in, find
from roomlight.compositing.kernels.scattering import Scatter, evaluate
from roomlight.kernels.common import JIT

_BY_LIGHT_ALONE = 0.1
"""Part of the probability that does not regard the scattering: cells at the horizon and in narrow lobes."""
_WIDEST_ROUGHNESS = 0.35
"""Lobes count as at least this rough: a narrower one misses the cells' mean directions."""


@njit(**JIT)
def cell_of(light, row, column):
    """Return the cell, row and column, that holds a pixel."""
    rows, columns = light.cells.shape[1], light.cells.shape[2]
    height, width = light.density.shape[1], light.density.shape[2]
    return ((row + 1) * rows - 1) // height, ((column + 1) * columns - 1) // width


@njit(**JIT)
def cell_share(light, weights, i, j):
    """Return the probability of a cell by its light alone."""
    total = 0.0
    for k in range(light.cells.shape[0]):
        total += weights[k] * light.cells[k, i, j]
    return total


@njit(**JIT)
def fill_guide(light, weights, scatter, frame, local_view, guide):
    """Fill the probability of each cell, and of each row of cells, at a surface with a frame (normal, a, b)."""
    cells, rows = guide
    normal, a, b = frame
    f0, f90, base, roughness, share, lobe = scatter
    wide = Scatter(f0, f90, base, max(roughness, _WIDEST_ROUGHNESS), share, lobe)
    total = 0.0
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            x, y, z = 0.0, 0.0, 0.0
            for k in range(light.cells.shape[0]):
                part = weights[k] * light.cells[k, i, j]
                x += part * light.toward[k, i, j, 0]
                y += part * light.toward[k, i, j, 1]
                z += part * light.toward[k, i, j, 2]
            length = math.sqrt(x * x + y * y + z * z)
            cells[i, j] = 0.0
            up = normal[0] * x + normal[1] * y + normal[2] * z
            if up <= 0:
                continue
            scale = 1 / length
            local = (
                (a[0] * x + a[1] * y + a[2] * z) * scale,
                (b[0] * x + b[1] * y + b[2] * z) * scale,
                up * scale,
            )
            value, _ = evaluate(wide, local_view, local)
            cells[i, j] = (value[0] + value[1] + value[2]) * cell_share(light, weights, i, j)
            total += cells[i, j]
    guided = (1 - _BY_LIGHT_ALONE) / total if total > 0 else 0.0
    alone = _BY_LIGHT_ALONE if total > 0 else 1.0
    for i in range(cells.shape[0]):
        rows[i] = 0.0
        for j in range(cells.shape[1]):
            cells[i, j] = guided * cells[i, j] + alone * cell_share(light, weights, i, j)
            rows[i] += cells[i, j]


@njit(**JIT)
def guided_density(light, weights, guide, row, column):
    """Return the density per steradian with which `guided_sample` draws the directions of a pixel."""
    i, j = cell_of(light, row, column)
    by_light = cell_share(light, weights, i, j)
    if by_light <= 0:
        return 0.0
    return density_at(light, weights, row, column) * guide[0][i, j] / by_light


@njit(**JIT)
def _stepped(shares, value):
    """Choose an entry in proportion to the shares; returns it and the value, stretched to [0, 1) again."""
    last = 0
    for k in range(shares.shape[0]):
        if shares[k] <= 0:
            continue
        last = k
        if value < shares[k]:
            break
        value -= shares[k]
    return last, min(max(value / max(shares[last], 1e-30), 0.0), 0.9999999)


@njit(**JIT)
def guided_sample(light, weights, guide, u, v):
    """Draw from (u, v) in [0, 1)^2: a cell by the guide, a probe and a pixel in it by light.

    Returns the direction, its place as by `place_of`, and its density per steradian.
    """
    cells, rows = guide
    i, v = _stepped(rows, v)
    j, u = _stepped(cells[i], u * rows[i])
    height, width = light.density.shape[1], light.density.shape[2]
    count, probe = light.cells.shape[0], 0
    if count > 1:
        u *= cell_share(light, weights, i, j)
        while probe < count - 1 and u >= weights[probe] * light.cells[probe, i, j]:
            u -= weights[probe] * light.cells[probe, i, j]
            probe += 1
        u = min(max(u / max(weights[probe] * light.cells[probe, i, j], 1e-30), 0.0), 0.9999999)
    top, bottom = i * height // cells.shape[0], (i + 1) * height // cells.shape[0]
    left, right = j * width // cells.shape[1], (j + 1) * width // cells.shape[1]
    band = light.bands[probe, j]
    row, down = find(band, top, bottom, band[top] + (band[bottom] - band[top]) * v)
    along = light.columns[probe, row]
    column, across = find(along, left, right, along[left] + (along[right] - along[left]) * u)
    direction, place = direction_in(light, row, column, down, across)
    return direction, place, guided_density(light, weights, guide, row, column)
