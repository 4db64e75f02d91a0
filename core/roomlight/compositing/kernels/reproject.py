# pyright: reportMissingParameterType=false
"""Depth and images of an earlier frame, as a later camera sees them."""

import numpy as np
from numba import njit

from roomlight.kernels.common import CACHED


@njit(**CACHED, fastmath=True)
def splat_depth(depth, age, lens, transform, new_lens, out, out_age):
    """Project an earlier depth image into a later camera; the nearest surface wins, gaps stay 0.

    Args:
        depth, age: [h, w] z-depth, 0 unknown; frames since it was measured.
        lens: fx, fy, cx, cy of both images' depth pixels; `new_lens` of the later one.
        transform: [3, 4] earlier camera to later camera.
        out, out_age: [oh, ow] must begin at 0.
    """
    height, width = depth.shape
    out_height, out_width = out.shape
    for i in range(height):
        y = -(np.float32(i) + np.float32(0.5) - lens[3]) / lens[1]
        for j in range(width):
            d = depth[i, j]
            if d <= 0:
                continue
            px, py, pz = (np.float32(j) + np.float32(0.5) - lens[2]) / lens[0] * d, y * d, -d
            ahead = -(transform[2, 0] * px + transform[2, 1] * py + transform[2, 2] * pz + transform[2, 3])
            if ahead <= np.float32(0.01):
                continue
            u = transform[0, 0] * px + transform[0, 1] * py + transform[0, 2] * pz + transform[0, 3]
            v = transform[1, 0] * px + transform[1, 1] * py + transform[1, 2] * pz + transform[1, 3]
            column = int(np.floor(new_lens[2] + new_lens[0] * u / ahead))
            row = int(np.floor(new_lens[3] - new_lens[1] * v / ahead))
            if (
                0 <= row < out_height
                and 0 <= column < out_width
                and (out[row, column] == 0 or ahead < out[row, column])
            ):
                out[row, column] = ahead
                out_age[row, column] = age[i, j]


@njit(**CACHED, fastmath=True)
def accumulate_image(
    image, fresh, known, points, world_to_before, lens, before, before_known, share, slack, start, stop
):
    """Blend rows start..stop of `fresh` with an earlier image of the same surfaces.

    Args:
        image: [h, w, 3] out; pixels that the earlier image does not show keep their value.
        fresh, known: [h, w, 3], [h, w].
        points: [h, w, 3] world positions of the pixels.
        world_to_before: [3, 4]; lens: fx, fy, cx, cy of the earlier image's pixels.
        before: [bh, bw, 4] the earlier image, and its z-depth.
        share: of the new image, 0 to 1.
        slack: how far the earlier value may lie outside the range of the new one's neighbours.
    """
    height, width = known.shape
    before_height, before_width = before_known.shape
    for i in range(start, stop):
        for j in range(width):
            if not known[i, j]:
                continue
            x, y, z = points[i, j, 0], points[i, j, 1], points[i, j, 2]
            m = world_to_before
            ahead = -(m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3])
            if ahead <= np.float32(0.01):
                continue
            column = lens[2] + lens[0] * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / ahead - np.float32(0.5)
            row = lens[3] - lens[1] * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / ahead - np.float32(0.5)
            left, top = int(np.floor(column)), int(np.floor(row))
            if left < -1 or top < -1 or left >= before_width or top >= before_height:
                continue
            total = np.float32(0)
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            for dy in range(2):
                r = min(max(top + dy, 0), before_height - 1)
                for dx in range(2):
                    c = min(max(left + dx, 0), before_width - 1)
                    if not before_known[r, c] or abs(before[r, c, 3] - ahead) > np.float32(0.04) * ahead:
                        continue
                    weight = abs(np.float32(1 - dx) - (column - left)) * abs(np.float32(1 - dy) - (row - top))
                    total += weight
                    red += weight * before[r, c, 0]
                    green += weight * before[r, c, 1]
                    blue += weight * before[r, c, 2]
            if total < np.float32(0.25):
                continue
            for channel in range(3):
                previous = (red, green, blue)[channel] / total
                low, high = np.float32(1e9), np.float32(-1e9)
                for r in range(max(0, i - 1), min(height, i + 2)):
                    for c in range(max(0, j - 1), min(width, j + 2)):
                        if known[r, c]:
                            low, high = min(low, fresh[r, c, channel]), max(high, fresh[r, c, channel])
                previous = min(max(previous, low - slack), high + slack)
                image[i, j, channel] = previous + share * (fresh[i, j, channel] - previous)
