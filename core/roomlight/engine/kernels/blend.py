# pyright: reportMissingParameterType=false
"""Accumulation of one probe's panorama, in place.

Readable twin: `reference.accumulate_reference`.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float32
from numba import njit

from roomlight.kernels.common import CACHED

HIGHER: Final = np.float32(1.2)
"""A lower bound of the radiance counts as higher from this ratio on: a quarter of a stop."""
NOISE: Final = np.float32(0.1)
"""Relative noise of a radiance at which it still agrees with a lower bound."""
CHANGED: Final = np.float32(2)
"""A surface's light has changed if it shows this many times more or less than before: one stop."""
LEAST_CHANGE: Final = np.float32(0.05)
"""Smallest change of luminance, relative to white: the noise of dark places is no change."""
CHANGED_FRAMES: Final = np.float32(2)
"""Consecutive frames that must show a change before it is taken over."""
BEYOND: Final = np.float32(0.05)
"""A frame sees through a surface if it measures more than this share of the z-depth beyond it, and `CLOSER_M` at
least."""
SEEN_THROUGH_FRAMES: Final = np.float32(2)
"""Consecutive frames that must see through a surface before it is forgotten."""
SAME_VIEW: Final = np.float32(np.cos(np.radians(5)))
"""Cosine of the angle, seen from the surface, up to which two cameras see the same of it. A hand-held camera that walks
turns by 1 to 3 degrees about a surface from frame to frame."""
UNBOUNDED: Final = np.float32(1e30)
"""Luminance of a clipped pixel, at most."""
APART, AGREES, DIFFERS, BEGINS = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)
"""How a pixel of a frame compares with the accumulated panorama.

APART: the frame shows another surface there, or nothing. AGREES: the same surface with the same light. DIFFERS: the
same surface with other light. BEGINS: as DIFFERS, and a camera at the same place showed the accumulated light before,
so that the light has changed and no reflection explains it."""


class StateArrays(NamedTuple):
    """The arrays of `roomlight.engine.panorama.blend.PanoramaState`."""

    radiance: Float32[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"]
    observed: Float32[np.ndarray, "h w"]
    clipped: Float32[np.ndarray, "h w"]
    guessed: Float32[np.ndarray, "h w"]
    changed: Float32[np.ndarray, "h w"]
    viewed_from: Float32[np.ndarray, "h w 3"]
    measured: Float32[np.ndarray, "h w"]


class DetailArrays(NamedTuple):
    """What one frame shows a probe.

    radiance to guessed:         as in `roomlight.engine.panorama.blend.PartialPanorama`.

    Attributes:
        weight: Of the frame, 0 where its mesh is not visible.
        lowest, highest, brightest: Around each pixel, the least lower bound, the greatest possible luminance and the
            greatest lower bound (`find_extremes`).
        camera: Its position in metres from the probe, world axes.
        measured: 1 where depth was measured, 0 elsewhere.
    """

    radiance: Float32[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"]
    clipped: Float32[np.ndarray, "h w"]
    guessed: Float32[np.ndarray, "h w"]
    weight: Float32[np.ndarray, "h w"]
    lowest: Float32[np.ndarray, "h w"]
    highest: Float32[np.ndarray, "h w"]
    brightest: Float32[np.ndarray, "h w"]
    camera: Float32[np.ndarray, "3"]
    measured: Float32[np.ndarray, "h w"]


@njit(**CACHED)
def better_share(clipped, bound, new_clipped, new_bound):
    """Return how much of an observation a new one of the same surface replaces (`roomlight.engine.surface.bracket`)."""
    zero, one = np.float32(0), np.float32(1)
    if clipped <= zero:
        return zero
    # bound / clipped is at least the white of the exposure that clipped
    if new_bound * clipped > HIGHER * bound:
        return one
    if new_clipped < clipped and new_bound >= bound * (one - NOISE * clipped):
        return (clipped - new_clipped) / clipped
    return zero


@njit(**CACHED)
def luminance(red, green, blue):
    """Return the luminance of a linear RGB radiance (`roomlight.conventions.LUMINANCE`)."""
    return np.float32(0.2126) * red + np.float32(0.7152) * green + np.float32(0.0722) * blue


@njit(**CACHED, error_model="numpy")
def find_extremes(radiance, clipped, guessed, weight, reach, around):
    """Write what `reference.extremes_around` returns of each seen pixel into `around` [3, h, w]; others are undefined.

    The square of 2 `reach` + 1 pixels is searched along rows, then along columns, in loops without branches.

    Returns:
        The first seen row and the row after the last; 0, 0 if nothing is seen.
    """
    rows, columns = weight.shape
    top, bottom, left, right = rows, 0, columns, 0
    for row in range(rows):
        any_seen = 0
        for column in range(columns):
            any_seen |= np.int32(weight[row, column] > 0)
        if any_seen:
            top, bottom = min(top, row), row + 1
            first, last = 0, columns
            while first < left and weight[row, first] <= 0:
                first += 1
            while last > right and weight[row, last - 1] <= 0:
                last -= 1
            left, right = min(left, first), max(right, last)
    if bottom == 0:
        return 0, 0
    stride, zero = right - left + 2 * reach, np.float32(0)  # with a margin around what is seen
    least = np.full((bottom - top + 2 * reach) * stride, UNBOUNDED, np.float32)
    most, bright = np.zeros_like(least), np.zeros_like(least)
    for row in range(top, bottom):
        for column in range(left, right):
            if weight[row, column] > zero:
                red, green, blue = radiance[row, column, 0], radiance[row, column, 1], radiance[row, column, 2]
                shown, at = luminance(red, green, blue), (row - top + reach) * stride + column - left + reach
                least[at] = bright[at] = shown - guessed[row, column]
                most[at] = UNBOUNDED if clipped[row, column] > zero else shown
    for step in (1, stride):
        least, most, bright = (
            _widened(least, step, reach, True),
            _widened(most, step, reach, False),
            _widened(bright, step, reach, False),
        )
    for row in range(top, bottom):
        start = (row - top) * stride
        for column in range(right - left):
            around[0, row, left + column] = least[start + column]
            around[1, row, left + column] = most[start + column]
            around[2, row, left + column] = bright[start + column]
    return top, bottom


@njit(**CACHED, fastmath={"nnan", "nsz"})
def _widened(values, step, reach, lower):
    """Return the least, or the greatest, of each value and the 2 `reach` that follow it, `step` apart."""
    out = values.copy()
    for ahead in range(step, (2 * reach + 1) * step, step):
        others = values[ahead:]
        if lower:
            for i in range(len(others)):
                out[i] = min(out[i], others[i])
        else:
            for i in range(len(others)):
                out[i] = max(out[i], others[i])
    return out


@njit(**CACHED)
def same_view(before, now, ray, distance):
    """Return whether two cameras, relative to the probe, see the point at `distance` along `ray` from one direction."""
    before_squared, now_squared, dot = np.float32(0), np.float32(0), np.float32(0)
    for axis in range(3):
        point = distance * ray[axis]
        first, second = before[axis] - point, now[axis] - point
        before_squared, now_squared, dot = (
            before_squared + first * first,
            now_squared + second * second,
            dot + first * second,
        )
    return dot >= SAME_VIEW * np.sqrt(before_squared * now_squared)


@njit(**CACHED, error_model="numpy")
def count_seen_through(state, shown_m, rays, position, view, closer_m, farthest_m, gone):
    """Count down in `state.changed` where a frame sees through what was observed; light that changes counts up.

    1. A surface that the frame shows in the same direction stays; so does what is farther than depth is kept.
    2. The observed point in the frame's depth: it says nothing if it lies beside it.
    3. Seen through if the depth there lies beyond it by `closer_m` and `BEYOND`; otherwise the count begins again.

    Args:
        state: `StateArrays`.
        shown_m: what the frame shows, distance along the ray in metres, 0 where it shows nothing, [h, w].
        rays: directions of the pixels, [h w, 3].
        position: of the panorama, world metres, [3].
        view: least measured depth around each sample, 0 = not measured (`DepthView`).
        closer_m: least distance between two surfaces.
        farthest_m: points from here on may be farther than their depth says.
        gone: output [h, w]: what `SEEN_THROUGH_FRAMES` consecutive frames saw through.

    Returns:
        How many these are.
    """
    zero, count = np.float32(0), 0
    m, lens, depth = view.world_to_camera, view.lens, view.depth
    for row in range(state.depth.shape[0]):
        for column in range(state.depth.shape[1]):
            gone[row, column] = False
            distance, shown = state.depth[row, column], shown_m[row, column]
            if state.observed[row, column] <= zero:
                continue
            # 1.
            through = distance < farthest_m and not (shown > zero and abs(shown - distance) < closer_m)
            if through:  # 2.
                ray = rays[row * state.depth.shape[1] + column]
                x, y, z = (
                    position[0] + distance * ray[0],
                    position[1] + distance * ray[1],
                    position[2] + distance * ray[2],
                )
                away = -(m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3])
                j = lens[2] + lens[0] * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / away
                i = lens[3] - lens[1] * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / away
                if not (away > zero and 0 <= j < depth.shape[1] and 0 <= i < depth.shape[0]):
                    continue
                through = depth[int(i), int(j)] > away + max(closer_m, BEYOND * away)  # 3.
            if not through:
                state.changed[row, column] = max(state.changed[row, column], zero)
                continue
            state.changed[row, column] = min(state.changed[row, column], zero) - np.float32(1)
            if state.changed[row, column] <= -SEEN_THROUGH_FRAMES:
                state.changed[row, column], gone[row, column] = zero, True
                count += 1
    return count


@njit(**CACHED, fastmath=True)
def compare_rows(state, detail, rays, closer_m, comparison, start, stop):
    """Write into `comparison` [h, w] how rows start..stop of a frame compare with the state; see `APART`.

    Where they agree, counts of changes are reset, and `viewed_from` becomes this camera if nothing around differs. A
    surface counts as measured if one of them measured it.

    1. Another surface, or nothing observed before: APART.
    2. Darker or brighter than the accumulated light allows: BEGINS if both cameras look from one direction, else
       DIFFERS.
    3. Otherwise: AGREES.
    """
    zero = np.float32(0)
    radiance, columns = state.radiance, state.depth.shape[1]
    for row in range(start, stop):
        for column in range(columns):
            # 1. the surface
            comparison[row, column] = APART
            if detail.weight[row, column] <= zero or state.observed[row, column] <= zero:
                continue
            if abs(state.depth[row, column] - detail.depth[row, column]) >= closer_m:
                continue
            state.measured[row, column] = max(state.measured[row, column], detail.measured[row, column])
            # 2. its light
            shown = luminance(radiance[row, column, 0], radiance[row, column, 1], radiance[row, column, 2])
            bound = shown - state.guessed[row, column]
            lowest, most = detail.lowest[row, column], CHANGED * shown + LEAST_CHANGE
            if lowest > most or CHANGED * detail.highest[row, column] + LEAST_CHANGE < bound:
                ray = rays[row * columns + column]
                same = same_view(state.viewed_from[row, column], detail.camera, ray, detail.depth[row, column])
                comparison[row, column] = BEGINS if same else DIFFERS
                continue
            # 3. the same light
            comparison[row, column] = AGREES
            state.changed[row, column] = zero
            if CHANGED * lowest + LEAST_CHANGE >= bound and detail.brightest[row, column] <= most:
                for axis in range(3):
                    state.viewed_from[row, column, axis] = detail.camera[axis]


@njit(**CACHED, fastmath=True)
def accumulate_rows(state, hdr, detail, closer_m, only_seen, start, stop):
    """Update rows start..stop of the state (`StateArrays`); `detail` is `DetailArrays`, hdr [h, w, 3].

    only_seen: whether pixels without weight stay as they are.

    1. The conservative rule: a surface that is not closer than the accumulated one loses 1 of its weight.
    2. A clipped observation of the same surface gives way to one that knows more (`better_share`).
    3. Radiance, depth and whether it was measured, share observed, clipping: the frame's by the weight, the state's by
       the rest, inferred light behind both.
    """
    one, zero = np.float32(1), np.float32(0)
    radiance, new = state.radiance, detail.radiance
    for row in range(start, stop):
        for column in range(state.depth.shape[1]):
            blend = detail.weight[row, column]
            if only_seen and blend <= zero:
                continue
            before = state.observed[row, column]
            clipped, known = state.clipped[row, column], state.guessed[row, column]
            nearer = state.depth[row, column] - detail.depth[row, column]
            fresh = blend > zero and nearer >= closer_m
            if nearer < closer_m:  # 1.
                weight, blend = blend, max(blend - one, zero)
                # 2.
                if nearer > -closer_m and weight > zero and before > zero and clipped > zero:
                    shown = luminance(radiance[row, column, 0], radiance[row, column, 1], radiance[row, column, 2])
                    bound = shown - state.guessed[row, column]
                    new_bound = luminance(new[row, column, 0], new[row, column, 1], new[row, column, 2])
                    new_bound -= detail.guessed[row, column]
                    better = better_share(clipped, bound, detail.clipped[row, column], new_bound)
                    blend = max(blend, better * min(weight, one))
            for c in range(3):  # 3.
                background = (one - before) * hdr[row, column, c] + before * radiance[row, column, c]
                radiance[row, column, c] = blend * new[row, column, c] + (one - blend) * background
                if fresh:
                    state.viewed_from[row, column, c] = detail.camera[c]
            state.depth[row, column] = blend * detail.depth[row, column] + (one - blend) * state.depth[row, column]
            state.observed[row, column] = min(before + blend, one)
            state.clipped[row, column] = blend * detail.clipped[row, column] + (one - blend) * clipped
            state.measured[row, column] = (
                blend * detail.measured[row, column] + (one - blend) * state.measured[row, column]
            )
            state.guessed[row, column] = blend * detail.guessed[row, column] + (one - blend) * known
