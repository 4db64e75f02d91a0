# pyright: reportMissingParameterType=false
"""Plane sweep and semi-global matching; readable twins in `reference`."""

import math
from typing import Any

import numpy as np
from numba import njit
from numba.extending import intrinsic

from roomlight.kernels.common import KERNEL

REACH = 4
"""Pixels that a census looks at to each side."""
UNSEEN, MOST = 0.3, 0.6
"""Cost of a depth that no view sees, and the most that a view tells."""


@njit(**KERNEL)
def census_rows(padded, margin, brighter, darker, start, stop):
    """Write the ternary census of rows start..stop of a picture: 31 neighbours, every other pixel in 9 x 7.

    Args:
        padded: 8-bit picture with a rim of `REACH` pixels [h + 8, w + 8].
        margin: Grey levels within which a neighbour counts as equal.
        brighter, darker: Out [h, w]: a bit for each neighbour that is.
    """
    width = brighter.shape[1]
    for row in range(start, stop):
        brighter[row] = 0
        darker[row] = 0
        bit = np.uint32(1)
        for dy in range(-3, 4):
            for dx in range(-REACH, REACH + 1):
                if (dx + dy) & 1 or (dx == 0 and dy == 0):
                    continue
                for column in range(width):
                    change = np.int32(padded[row + dy + REACH, column + dx + REACH])
                    change -= np.int32(padded[row + REACH, column + REACH])
                    brighter[row, column] |= bit if change > margin else np.uint32(0)
                    darker[row, column] |= bit if change < -margin else np.uint32(0)
                bit = np.uint32(bit << np.uint32(1))


def _typed_ones(_context: Any, value: Any) -> Any:
    """Count the bits of an unsigned integer."""

    def count(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return value(value), count


_ones: Any = intrinsic(_typed_ones)


@njit(**KERNEL)
def sweep_rows(census, others, projections, inverses, guess, prior, step, costs, contrast, start, stop):
    """Write the cost of each depth for rows start..stop of a grid of pixels.

    A pixel's cost is the share of census bits that differ, the mean of the best two of the views that see the point,
    plus that of a depth far from the guess.

    Args:
        census: Of the view [2, h, w].
        others: Of other views [n, 2, h, w].
        projections: [n, 3, 4]: pixel (column, row, 1) + inverse depth to homogeneous pixels of the other view.
        inverses: The depths' 1 / depth [k].
        guess: About 1 / depth at the grid's pixels [gh, gw].
        prior: Cost of a depth that is e times the guess.
        step: Pixels of the grid's step; it begins at step // 2.
        costs: Out [gh, gw, k].
        contrast: Out [gh, gw]: greatest less least cost without the guess.
    """
    count, _, height, width = others.shape
    depths = len(inverses)
    tones = np.log(inverses)
    place, seen = np.empty(depths, np.int32), np.empty(depths, np.int32)
    first, second = np.empty(depths, np.float32), np.empty(depths, np.float32)
    for gy in range(start, stop):
        row = gy * step + step // 2
        y = np.float32(row + 0.5)
        for gx in range(costs.shape[1]):
            column = gx * step + step // 2
            x = np.float32(column + 0.5)
            brighter, darker = census[0, row, column], census[1, row, column]
            first[:], second[:], seen[:] = 2, 2, 0
            for n in range(count):
                # 1. where each depth's point is in the other view; -1 outside
                p = projections[n]
                u0, v0 = p[0, 0] * x + p[0, 1] * y + p[0, 2], p[1, 0] * x + p[1, 1] * y + p[1, 2]
                w0 = p[2, 0] * x + p[2, 1] * y + p[2, 2]
                for k in range(depths):
                    w = w0 + p[2, 3] * inverses[k]
                    scale = np.float32(1) / w
                    u, v = (u0 + p[0, 3] * inverses[k]) * scale, (v0 + p[1, 3] * inverses[k]) * scale
                    inside = (w > np.float32(1e-6)) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
                    place[k] = np.int32(v) * width + np.int32(u) if inside else -1
                # 2. the best two of the views
                bright, dark = others[n, 0].ravel(), others[n, 1].ravel()
                for k in range(depths):
                    if place[k] < 0:
                        continue
                    differ = _ones(brighter ^ bright[place[k]]) + _ones(darker ^ dark[place[k]])
                    cost = np.float32(differ) * np.float32(1 / 31)
                    seen[k] += 1
                    second[k] = min(second[k], max(cost, first[k]))
                    first[k] = min(first[k], cost)
            # 3. their mean, and the guess
            middle = np.float32(math.log(guess[gy, gx]))
            most, least = np.float32(0), np.float32(2)
            for k in range(depths):
                cost = np.float32(UNSEEN)
                if seen[k] > 0:
                    cost = np.float32(0.5) * (first[k] + second[k]) if seen[k] > 2 else first[k]
                    most, least = max(most, cost), min(least, cost)
                far = min(abs(tones[k] - middle), np.float32(1))
                costs[gy, gx, k] = min(cost, np.float32(MOST)) + np.float32(prior) * far
            contrast[gy, gx] = max(most - least, np.float32(0))


@njit(**KERNEL)
def aggregate_lines(costs, grey, penalties, dy, dx, sums, start, stop):
    """Add the least costs of the paths of one direction to `sums`, for its lines start..stop.

    Args:
        costs: [gh, gw, k].
        grey: 8-bit grey of the grid's pixels [gh, gw].
        penalties: Of a depth beside, of any other, and the grey step that halves the second.
        dy, dx: Step of the path: one is 0, the other 1 or -1.
        sums: In and out [gh, gw, k].
    """
    height, width, depths = costs.shape
    near, far, edge = penalties[0], penalties[1], penalties[2]
    before, now = np.empty(depths, np.float32), np.empty(depths, np.float32)
    for line in range(start, stop):
        # lines begin at the border that the direction leaves
        if dy == 0:
            row, column = line, 0 if dx > 0 else width - 1
        else:
            row, column = 0 if dy > 0 else height - 1, line
        least = np.float32(0)
        before[:] = 0
        last = np.int32(grey[row, column])
        while 0 <= row < height and 0 <= column < width:
            here = np.int32(grey[row, column])
            jump = max(far * edge / (edge + abs(here - last)), near)
            smallest = np.float32(1e9)
            for k in range(depths):
                best = min(before[k], least + jump)
                if k > 0:
                    best = min(best, before[k - 1] + near)
                if k + 1 < depths:
                    best = min(best, before[k + 1] + near)
                value = costs[row, column, k] + best - least
                now[k] = value
                sums[row, column, k] += value
                smallest = min(smallest, value)
            before, now = now, before
            least, last = smallest, here
            row += dy
            column += dx


@njit(**KERNEL)
def decide_rows(sums, tones, heat, answer, spread, start, stop):
    """Write the depth of least cost and how sharply it is known, for rows start..stop.

    Args:
        sums: Summed costs [gh, gw, k].
        tones: log(1 / depth) [k], rising.
        heat: Cost that makes a depth e times less likely.
        answer: Out [gh, gw]: log(1 / depth), the mean over the neighbours of the best.
        spread: Out [gh, gw]: deviation of log(1 / depth) over all depths.
    """
    depths = len(tones)
    for row in range(start, stop):
        for column in range(sums.shape[1]):
            best = 0
            for k in range(1, depths):
                if sums[row, column, k] < sums[row, column, best]:
                    best = k
            least = sums[row, column, best]
            weight, middle, total, mean, square = 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(depths):
                share = math.exp((least - sums[row, column, k]) / heat)
                total += share
                mean += share * tones[k]
                square += share * tones[k] * tones[k]
                if abs(k - best) <= 2:
                    weight += share
                    middle += share * tones[k]
            answer[row, column] = middle / weight
            mean /= total
            spread[row, column] = math.sqrt(max(square / total - mean * mean, 0.0))
