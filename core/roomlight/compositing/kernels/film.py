# pyright: reportMissingParameterType=false
"""Samples of pixels averaged to pixels, and pixels averaged where they look alike."""

import math

import numpy as np
from numba import njit

from roomlight.kernels.common import CACHED

_RADIUS = 3


@njit(**CACHED)
def average_samples(film, samples, out, start, stop):
    """Average the samples of pixels start..stop; the object is the nearest sample's, depth the covered ones' mean.

    Args:
        film: a value for each sample, `samples` a pixel; albedo and normal may be left out (no rows).
        out: the same for each pixel.
    """
    extra = len(film.albedo) > 0
    for i in range(start, stop):
        covered, depth, nearest, object_id = 0.0, 0.0, 1e30, -1
        red, green, blue = 0.0, 0.0, 0.0
        squares, scattering = 0.0, 0.0
        first = i * samples
        for s in range(first, first + samples):
            red += film.radiance[s, 0]
            green += film.radiance[s, 1]
            blue += film.radiance[s, 2]
            grey = (film.radiance[s, 0] + film.radiance[s, 1] + film.radiance[s, 2]) / 3
            squares += grey * grey
            scattering += film.doubt[s]
            alpha = film.alpha[s]
            if alpha > 0:
                covered += alpha
                depth += alpha * film.depth_m[s]
                if film.depth_m[s] < nearest:
                    nearest, object_id = film.depth_m[s], film.object_id[s]
        out.radiance[i, 0], out.radiance[i, 1], out.radiance[i, 2] = red / samples, green / samples, blue / samples
        mean = (red + green + blue) / (3 * samples)
        variance = max(squares / samples - mean * mean, 0.0) / samples
        out.doubt[i] = variance if scattering > 0 else -variance
        out.alpha[i] = covered / samples
        out.depth_m[i] = depth / max(covered, 1e-12)
        out.object_id[i] = object_id
        if extra:
            for axis in range(3):
                albedo, normal = 0.0, 0.0
                for s in range(first, first + samples):
                    albedo += film.albedo[s, axis]
                    normal += film.normal[s, axis]
                out.albedo[i, axis], out.normal[i, axis] = albedo / samples, normal / samples


@njit(**CACHED, fastmath=True)
def smooth_alike(film, out, start, stop):
    """Average rows start..stop over neighbours of one object that look alike (joint bilateral filter).

    A neighbour counts by its normal, by its albedo, and by how its difference compares with the noise of both pixels:
    what is more than noise, such as a shadow's border, stays. Outlines, mirrors and glass stay as they are.

    Args:
        film: images of radiance, alpha, object, albedo, normal and `doubt`, the variance of the mean of the channels,
            negative for mirrors and glass.
        out: [h, w, 3] radiance; begins as the film's.
    """
    height, width = film.alpha.shape
    light, doubt, normal, albedo = film.radiance, film.doubt, film.normal, film.albedo
    for i in range(start, stop):
        for j in range(width):
            if film.alpha[i, j] < 1 or doubt[i, j] <= 0:
                continue
            here = (light[i, j, 0] + light[i, j, 1] + light[i, j, 2]) / np.float32(3)
            total, red, green, blue = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
            for y in range(max(0, i - _RADIUS), min(height, i + _RADIUS + 1)):
                for x in range(max(0, j - _RADIUS), min(width, j + _RADIUS + 1)):
                    if film.alpha[y, x] < 1 or doubt[y, x] < 0 or film.object_id[y, x] != film.object_id[i, j]:
                        continue
                    turned, painted = np.float32(0), np.float32(0)
                    for axis in range(3):
                        turned += (normal[y, x, axis] - normal[i, j, axis]) ** 2
                        painted += (albedo[y, x, axis] - albedo[i, j, axis]) ** 2
                    there = (light[y, x, 0] + light[y, x, 1] + light[y, x, 2]) / np.float32(3)
                    noise = np.float32(4) * (doubt[i, j] + doubt[y, x]) + np.float32(1e-12)
                    apart = (there - here) * (there - here) / noise
                    apart += turned * np.float32(60) + painted * np.float32(400)
                    if apart > 12:
                        continue
                    weight = math.exp(-apart)
                    total += weight
                    red += weight * light[y, x, 0]
                    green += weight * light[y, x, 1]
                    blue += weight * light[y, x, 2]
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = red / total, green / total, blue / total
