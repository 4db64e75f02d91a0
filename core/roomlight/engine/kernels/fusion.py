# pyright: reportMissingParameterType=false
"""Sums and means over frames, voxel by voxel: one pass over memory each, where NumPy makes several."""

import numpy as np
from numba import njit

from roomlight.kernels.common import CACHED


@njit(**CACHED)
def add_volume(volume, colour, opacity, count):
    """Add an initial volume [5, n] to the sums of colour [n, 3], opacity [n] and count [n]."""
    for voxel in range(len(count)):
        alpha = volume[3, voxel]
        if alpha > 0 or volume[4, voxel] < 0:
            count[voxel] += np.float32(1)
            opacity[voxel] += alpha
            for channel in range(3):
                colour[voxel, channel] += volume[channel, voxel]


@njit(**CACHED)
def write_mean(colour, opacity, count, out):
    """Write the mean as an initial volume [5, n]: e = -1 where every observation was empty."""
    zero, one = np.float32(0), np.float32(1)
    for voxel in range(len(count)):
        frames = max(count[voxel], one)
        for channel in range(3):
            out[channel, voxel] = colour[voxel, channel] / frames
        out[3, voxel] = opacity[voxel] / frames
        out[4, voxel] = -one if count[voxel] > zero and opacity[voxel] == zero else zero


@njit(**CACHED)
def write_surfaces(colour, opacity, count, alpha, lobes, volume):
    """Write the mean opacity [n] and its colour, the first three channels of `lobes` [n, c].

    Only where `volume` [5, n], the last frame's, observed something; None: everywhere.
    """
    for voxel in range(len(count)):
        if volume is not None and volume[3, voxel] <= 0 and volume[4, voxel] >= 0:
            continue
        if count[voxel] > 0:
            alpha[voxel] = opacity[voxel] / count[voxel]
        if opacity[voxel] > 0:
            for channel in range(3):
                lobes[voxel, channel] = colour[voxel, channel] / opacity[voxel]


@njit(**CACHED)
def move_towards(values, target, share, observed, start, stop):
    """Move the voxels start..stop of `values` [n, c] by a share to `target`; 0 where `observed` [n] is below 0."""
    for voxel in range(start, stop):
        empty = observed[voxel] < 0
        for channel in range(values.shape[1]):
            value = values[voxel, channel]
            values[voxel, channel] = np.float32(0) if empty else value + share * (target[voxel, channel] - value)
