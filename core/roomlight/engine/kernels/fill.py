# pyright: reportMissingParameterType=false
"""Two levels of a push-pull pyramid, and how its fill is mixed with light; tests have readable twins in NumPy.

Pixels of a level are [row, column, channel], premultiplied by their weight, which is the last channel. Columns wrap
around, the pole rows repeat. Each kernel goes over its pixels once, where NumPy would write an array for each step.
"""

import numpy as np
from numba import njit

from roomlight.engine.kernels.blend import luminance
from roomlight.kernels.common import CACHED

_TINY = np.finfo(np.float32).tiny


@njit(**CACHED)
def premultiply(image, weight, out):
    """Write the finest level [h, w, c + 1] of an image [h, w, c]; return whether every pixel has full weight.

    Weights are clipped to 0..1; NaN counts as 0. The colour of a pixel without weight is not read.
    """
    zero, one, complete = np.float32(0), np.float32(1), True
    height, width, colours = image.shape
    for row in range(height):
        for column in range(width):
            share = weight[row, column]
            share = min(share, one) if share > zero else zero
            complete = complete and share >= one
            for channel in range(colours):
                out[row, column, channel] = share * image[row, column, channel] if share > zero else zero
            out[row, column, colours] = share
    return complete


@njit(**CACHED)
def put_before(image, weight, filled):
    """Put an image [h, w, c] before a fill of the same size, in place: weight x image + (1 - weight) x fill."""
    zero, one = np.float32(0), np.float32(1)
    height, width, colours = image.shape
    for row in range(height):
        for column in range(width):
            share = min(max(weight[row, column], zero), one)
            for channel in range(colours):
                filled[row, column, channel] = (
                    share * image[row, column, channel] + (one - share) * filled[row, column, channel]
                )


@njit(**CACHED)
def mix_beyond(hdr, ldr, mask, weight, colour_share, dark, out):
    """Compute `roomlight.engine.panorama.blend.fill_in` into `out` [h, w, 3]."""
    height, width = mask.shape
    for row in range(height):
        for column in range(width):
            if mask[row, column]:
                for channel in range(3):
                    out[row, column, channel] = hdr[row, column, channel]
                continue
            for channel in range(3):
                light = hdr[row, column, channel]
                out[row, column, channel] = light + weight[row, column] * (ldr[row, column, channel] - light)
            mixed = luminance(out[row, column, 0], out[row, column, 1], out[row, column, 2])
            fill = luminance(ldr[row, column, 0], ldr[row, column, 1], ldr[row, column, 2])
            for channel in range(3):
                colour = (ldr[row, column, channel] + dark) / (fill + dark)
                out[row, column, channel] += colour_share * (mixed * colour - out[row, column, channel])


@njit(**CACHED)
def mute(light, colour, own, out):
    """Move the colour of light [h, w, 3] toward `colour` [3] of luminance 1, into `out`; `own` is its share."""
    height, width, _ = light.shape
    for row in range(height):
        for column in range(width):
            level = luminance(light[row, column, 0], light[row, column, 1], light[row, column, 2])
            for channel in range(3):
                grey = level * colour[channel]
                out[row, column, channel] = grey + own * (light[row, column, channel] - grey)


@njit(**CACHED)
def halve(pixels, row_sums, out):
    """Write the coarser level [(h + 1) / 2, (w + 1) / 2, c], by the tent filter (1 3 3 1) / 8, with Gortler's gain.

    `row_sums` is a buffer [w, c].
    """
    height, width, channels = pixels.shape
    eighth, three, tiny = np.float32(0.125), np.float32(3), np.float32(_TINY)
    for row in range(out.shape[0]):
        # 1. four rows, of which the first and last may be one
        a, b = max(2 * row - 1, 0), 2 * row
        c, d = min(2 * row + 1, height - 1), min(2 * row + 2, height - 1)
        for column in range(width):
            for channel in range(channels):
                row_sums[column, channel] = eighth * (
                    pixels[a, column, channel]
                    + three * (pixels[b, column, channel] + pixels[c, column, channel])
                    + pixels[d, column, channel]
                )
        # 2. four columns, or the only one
        for column in range(out.shape[1]):
            a, b = (2 * column - 1) % width, 2 * column
            c, d = (2 * column + 1) % width, (2 * column + 2) % width
            for channel in range(channels):
                if width == 1:
                    out[row, column, channel] = row_sums[0, channel]
                else:
                    out[row, column, channel] = eighth * (
                        row_sums[a, channel]
                        + three * (row_sums[b, channel] + row_sums[c, channel])
                        + row_sums[d, channel]
                    )
            # 3. A coarse pixel has the weights of its pixels together, at most 1: saturation keeps the pull local, and
            # the factor 4 gives full weight to a parent of one known pixel in four (Gortler's rule).
            share = out[row, column, channels - 1]
            gain = min(np.float32(1), np.float32(4) * share) / max(share, tiny)
            for channel in range(channels):
                out[row, column, channel] *= gain


@njit(**CACHED)
def pull(coarse, level, row_sums, out):
    """Write the filled level [h, w, c - 1]: its own colour, and the coarser one's where its weight leaves room.

    `row_sums` is a buffer [w2, c - 1].
    """
    height, width, channels = level.shape
    rows, columns, colours = coarse.shape[0], coarse.shape[1], channels - 1
    near, far, one = np.float32(0.75), np.float32(0.25), np.float32(1)
    for row in range(height):
        this, other = row, row
        if rows < height:
            this = row // 2
            other = min(this + 1, rows - 1) if row % 2 else max(this - 1, 0)
        for column in range(columns):
            for channel in range(colours):
                row_sums[column, channel] = near * coarse[this, column, channel] + far * coarse[other, column, channel]
        for column in range(width):
            this, other = column, column
            if columns < width:
                this = column // 2
                other = (this + 1) % columns if column % 2 else (this - 1) % columns
            room = one - level[row, column, colours]
            for channel in range(colours):
                around = near * row_sums[this, channel] + far * row_sums[other, channel]
                out[row, column, channel] = level[row, column, channel] + room * around
