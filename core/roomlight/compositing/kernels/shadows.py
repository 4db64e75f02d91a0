# pyright: reportMissingParameterType=false
"""Joint bilateral filters of images of the change that objects make to the light on real surfaces."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from roomlight.kernels.common import CACHED, JIT, KERNEL


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


class Change(NamedTuple):
    """What objects do to the light of each pixel of a grid.

    Attributes:
        dark: [h, w, 3] share of the light that they leave.
        noise: [h, w] standard deviation of the mean of `dark`'s channels.
        occluder_m: [h, w] mean distance of what takes the light; large where nothing does.
        glow: [h, w, 3] light that they reflect, as a share.
        near: [h, w] where they change anything.
        inside: [h, w] where they hide the surface: what it sees of their lit walls shows nowhere.
    """

    dark: np.ndarray
    noise: np.ndarray
    occluder_m: np.ndarray
    glow: np.ndarray
    near: np.ndarray
    inside: np.ndarray


_SPREAD = np.float32(0.5)
"""Width of the filter over the distance of what takes the light."""


@njit(**CACHED, fastmath=True)
def filter_change(change, grid, radius, plane_m, most_ratio, out, start, stop):
    """Smooth rows start..stop over one surface, and write dark + glow.

    `dark` is smoothed as far as its sampling noise allows, and over less than the distance of the objects that take the
    light, but a pixel at least: a shadow is sharp where they touch the surface (Mehta 2012). `glow`, which has no
    sharp borders, is smoothed wherever `dark` changes slowly: at a contact both change together. It is that of points
    outside the objects alone.

    Args:
        plane_m: distance from a pixel's plane at which a neighbour's weight falls to 1/e.
        most_ratio: greatest result.
        out: [h, w, 3] must begin at 1; pixels that are not near keep it.
    """
    dark, noise, glow = change.dark, change.noise, change.glow
    height, width = noise.shape
    for i in range(start, stop):
        for j in range(width):
            if not change.near[i, j]:
                continue
            here = (dark[i, j, 0] + dark[i, j, 1] + dark[i, j, 2]) / np.float32(3)
            total, glow_total = np.float32(0), np.float32(0)
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            glow_red, glow_green, glow_blue = np.float32(0), np.float32(0), np.float32(0)
            for y in range(max(0, i - radius), min(height, i + radius + 1)):
                rim_y = np.float32(0.5) if abs(y - i) == radius else np.float32(1)
                for x in range(max(0, j - radius), min(width, j + radius + 1)):
                    if not grid.known[y, x]:
                        continue
                    # half the weight on the rim: over 2 radius pixels every subset of samples counts the same
                    rim = rim_y * np.float32(0.5) if abs(x - j) == radius else rim_y
                    off, facing, apart = np.float32(0), np.float32(0), np.float32(0)
                    for axis in range(3):
                        step = grid.points[y, x, axis] - grid.points[i, j, axis]
                        apart += step * step
                        off += step * grid.normals[i, j, axis]
                        facing += grid.normals[y, x, axis] * grid.normals[i, j, axis]
                    off = off * off / (plane_m * plane_m)
                    if off > 9 or facing < np.float32(0.5):
                        continue
                    there = (dark[y, x, 0] + dark[y, x, 1] + dark[y, x, 2]) / np.float32(3)
                    spread = noise[i, j] * noise[i, j] + noise[y, x] * noise[y, x]
                    step = (there - here) * (there - here)
                    near = rim * facing
                    if off > np.float32(1e-3):
                        near *= math.exp(-off)
                    weight = near * math.exp(-min(step / (np.float32(8) * spread + np.float32(1e-8)), np.float32(30)))
                    near *= math.exp(-min(step / (np.float32(8) * spread + np.float32(0.02)), np.float32(30)))
                    blur_m = _SPREAD * min(change.occluder_m[i, j], change.occluder_m[y, x])
                    close = math.exp(-np.float32(0.5) * np.float32((y - i) * (y - i) + (x - j) * (x - j)))
                    weight *= max(math.exp(-min(apart / (blur_m * blur_m + np.float32(1e-9)), np.float32(30))), close)
                    if change.inside[y, x]:
                        near = np.float32(0)
                    glow_total += near
                    glow_red += near * glow[y, x, 0]
                    glow_green += near * glow[y, x, 1]
                    glow_blue += near * glow[y, x, 2]
                    total += weight
                    red += weight * dark[y, x, 0]
                    green += weight * dark[y, x, 1]
                    blue += weight * dark[y, x, 2]
            red, green, blue = red / total, green / total, blue / total
            glow_total = max(glow_total, np.float32(1e-9))
            glow_red, glow_green, glow_blue = glow_red / glow_total, glow_green / glow_total, glow_blue / glow_total
            most = np.float32(most_ratio) - max(red, green, blue)  # of glow, whose colour stays as it is
            dim = min(most / max(glow_red, glow_green, glow_blue, np.float32(1e-9)), np.float32(1))
            out[i, j, 0], out[i, j, 1] = red + dim * glow_red, green + dim * glow_green
            out[i, j, 2] = blue + dim * glow_blue


@njit(**KERNEL)
def extend_ratio(ratio, known, depth, reach, edge, out, is_extended):
    """Give pixels that are not known the mean of the known ones around them, at most `reach` away, of their depth.

    Args:
        ratio, known, depth: [h, w, 3], [h, w], [h, w].
        edge: relative difference of depth from which a pixel shows another surface.
        out, is_extended: copies of `ratio` and `known`, which are changed.
    """
    one = np.float32(1)
    height, width = depth.shape
    for i in range(height):
        for j in range(width):
            if known[i, j] or depth[i, j] <= 0:
                continue
            total, red, green, blue = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
            for y in range(max(0, i - reach), min(height, i + reach + 1)):
                for x in range(max(0, j - reach), min(width, j + reach + 1)):
                    if known[y, x] and abs(depth[y, x] - depth[i, j]) < edge * depth[i, j]:
                        weight = one / np.float32((y - i) * (y - i) + (x - j) * (x - j))
                        total += weight
                        red += weight * (ratio[y, x, 0] - one)  # exactly 1 where all are 1
                        green += weight * (ratio[y, x, 1] - one)
                        blue += weight * (ratio[y, x, 2] - one)
            if total > 0:
                out[i, j, 0], out[i, j, 1], out[i, j, 2] = one + red / total, one + green / total, one + blue / total
                is_extended[i, j] = True


@njit(**JIT)
def _is_unity(ratio, known, row, near, far):
    """Return whether two neighbours change nothing."""
    one = np.float32(1)
    for column in (near, far):
        if known[row, column] and (
            ratio[row, column, 0] != one or ratio[row, column, 1] != one or ratio[row, column, 2] != one
        ):
            return False
    return True


@njit(**CACHED, fastmath=True)
def upsample_ratio(ratio, known, depth, fine_depth, step, edge, out, start, stop):
    """Interpolate a ratio image to rows start..stop of a finer grid, across no depth edge.

    Args:
        ratio, known, depth: [h, w, 3], [h, w], [h, w] on every `step`-th pixel, from step // 2 on.
        fine_depth: [fh, fw] z-depth, 0 unknown.
        edge: relative difference of depth at which a neighbour's weight falls to 1/8.
    """
    height, width = depth.shape
    one = np.float32(1)
    begin = step // 2
    for i in range(start, stop):
        top = (i - begin) // step
        down = np.float32(i - begin) / np.float32(step) - top
        first, second = max(top, 0), min(top + 1, height - 1)
        for left in range(-begin // step, (fine_depth.shape[1] - 1 - begin) // step + 1):
            near, far = min(max(left, 0), width - 1), min(left + 1, width - 1)
            columns = range(max(left * step + begin, 0), min((left + 1) * step + begin, fine_depth.shape[1]))
            if _is_unity(ratio, known, first, near, far) and _is_unity(ratio, known, second, near, far):
                for j in columns:
                    out[i, j, 0], out[i, j, 1], out[i, j, 2] = one, one, one
                continue
            for j in columns:
                across = np.float32(j - begin) / np.float32(step) - left
                here = fine_depth[i, j]
                total = np.float32(0)
                red, green, blue = np.float32(0), np.float32(0), np.float32(0)
                for dx in range(2):
                    column = far if dx else near
                    share_x = across if dx else one - across
                    for dy in range(2):
                        row = second if dy else first
                        if not known[row, column]:
                            continue
                        weight = (down if dy else one - down) * share_x + np.float32(1e-4)
                        if here > 0:
                            change = (depth[row, column] - here) / (edge * here)
                            close = one / (one + change * change)
                            weight *= close * close * close
                        total += weight
                        # differences from 1: where all are 1, the result is exactly 1
                        red += weight * (ratio[row, column, 0] - one)
                        green += weight * (ratio[row, column, 1] - one)
                        blue += weight * (ratio[row, column, 2] - one)
                scale = one / total if total > np.float32(1e-9) else np.float32(0)
                out[i, j, 0], out[i, j, 1], out[i, j, 2] = one + red * scale, one + green * scale, one + blue * scale


@njit(**JIT)
def _clipped_share(value, low, high):
    """Return how far a channel is clipped: 0 up to `low`, 1 from `high` on."""
    return min(max((value - low) / (high - low), np.float32(0)), np.float32(1))


@njit(**KERNEL)
def fill_clipped_share(image, low, high, out):
    """Fill [h, w] with how far all channels are clipped: 0 at `low` or below, 1 at `high`."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            least = min(image[i, j, 0], image[i, j, 1], image[i, j, 2])
            out[i, j] = _clipped_share(least, low, high)


@njit(**KERNEL)
def fade_ratio(ratio, emits, clipped):
    """Fade a ratio [h, w, 3] to 1 by the product of two shares [h, w]."""
    one = np.float32(1)
    for i in range(ratio.shape[0]):
        for j in range(ratio.shape[1]):
            share = emits[i, j] * clipped[i, j]
            if share > 0:
                for axis in range(3):
                    ratio[i, j, axis] += share * (one - ratio[i, j, axis])


@njit(**JIT)
def _middle(image, i, j):
    """Return the channel between the greatest and the least."""
    red, green, blue = image[i, j, 0], image[i, j, 1], image[i, j, 2]
    return max(min(red, green), min(max(red, green), blue))


@njit(**KERNEL)
def fill_unclipped(image, low, out):
    """Fill [h, w, 4] with the channels and the middle one of pixels below `low`, and 0 elsewhere."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            is_below = max(image[i, j, 0], image[i, j, 1], image[i, j, 2]) < low
            for axis in range(3):
                out[i, j, axis] = image[i, j, axis] if is_below else np.float32(0)
            out[i, j, 3] = _middle(image, i, j) if is_below else np.float32(0)


@njit(**KERNEL)
def restore_clipped(ratio, image, low, high, excess, unclipped):
    """Raise a ratio [h, w, 3] below 1 where channels are clipped: light above white hides a weak shadow.

    A clipped value v is a lower bound. Its excess x counts as exponentially distributed, and the ratio r becomes the
    expected min(1, r (1 + x)) = r + r m (1 - exp((1 - 1 / r) / m)), where m is the mean of x. All channels have one m:
    each with its own, white floors would turn yellow. Where one channel alone is clipped, as red on wood, it has at
    least the excess by which its ratio to the middle one would be that of the unclipped pixels around: at the same m,
    the shadow would turn green.

    Args:
        image: [h, w, 3] linear.
        low, high: values where a channel begins to be clipped, and where it is.
        excess: [h, w] mean of x, as a share of white, where all channels are clipped.
        unclipped: [h, w, 4] means around each pixel of what `fill_unclipped` fills.
    """
    one = np.float32(1)
    for i in range(ratio.shape[0]):
        for j in range(ratio.shape[1]):
            if min(ratio[i, j, 0], ratio[i, j, 1], ratio[i, j, 2]) >= one:
                continue
            mean = np.float32(0)
            for axis in range(3):
                share = _clipped_share(image[i, j, axis], low, high)
                mean += excess[i, j] * share / np.float32(3)
            if mean < np.float32(1e-3):
                continue
            middle = _middle(image, i, j)
            alone = min(max((high - middle) / (high - low), np.float32(0)), one)
            per_unclipped = middle / (max(unclipped[i, j, 3], np.float32(0.01)) * high)
            for axis in range(3):
                r = ratio[i, j, axis]
                if r < one:
                    share = _clipped_share(image[i, j, axis], low, high)
                    own = min(unclipped[i, j, axis] * per_unclipped - one, np.float32(2) * excess[i, j])
                    m = max(alone * share * own, mean)
                    ratio[i, j, axis] += r * m * (one - math.exp((one - one / r) / m))
