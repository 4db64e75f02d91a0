# pyright: reportMissingParameterType=false
"""Accumulation of one probe's panorama, in place; readable reference: `roomlight.engine.blend.accumulate_reference`."""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float32
from numba import njit

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


class StateArrays(NamedTuple):
    """The arrays of `roomlight.engine.blend.PanoramaState`."""

    radiance: Float32[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"]
    seen: Float32[np.ndarray, "h w"]
    clipped: Float32[np.ndarray, "h w"]
    guessed: Float32[np.ndarray, "h w"]
    changed: Float32[np.ndarray, "h w"]


class DetailArrays(NamedTuple):
    """What one frame shows (see `roomlight.engine.mesh.PartialPanorama`), and the weight of it."""

    radiance: Float32[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"]
    clipped: Float32[np.ndarray, "h w"]
    guessed: Float32[np.ndarray, "h w"]
    weight: Float32[np.ndarray, "h w"]
    lowest: Float32[np.ndarray, "h w"]
    highest: Float32[np.ndarray, "h w"]


@njit(nogil=True, cache=True)
def better_share(clipped, bound, new_clipped, new_bound):
    """Return how much of an observation a new one of the same surface replaces; see `roomlight.engine.bracket`."""
    zero, one = np.float32(0), np.float32(1)
    if clipped <= zero:
        return zero
    # bound / clipped is at least the white of the exposure that clipped
    if new_bound * clipped > HIGHER * bound:
        return one
    if new_clipped < clipped and new_bound >= bound * (one - NOISE * clipped):
        return (clipped - new_clipped) / clipped
    return zero


@njit(nogil=True, cache=True)
def luminance(red, green, blue):
    """Return the luminance of a linear RGB radiance (`roomlight.conventions.LUMINANCE`)."""
    return np.float32(0.2126) * red + np.float32(0.7152) * green + np.float32(0.0722) * blue


@njit(nogil=True, cache=True, fastmath=True)
def accumulate_rows(state, hdr, detail, closer_m, start, stop):
    """Update rows start..stop of the state (`StateArrays`); `detail` is `DetailArrays`, hdr [h, w, 3]."""
    one, zero = np.float32(1), np.float32(0)
    radiance, new = state.radiance, detail.radiance
    for row in range(start, stop):
        for column in range(state.depth.shape[1]):
            blend = detail.weight[row, column]
            before = state.seen[row, column]
            clipped = state.clipped[row, column]
            nearer = state.depth[row, column] - detail.depth[row, column]
            if nearer < closer_m:
                weight, blend = blend, max(blend - one, zero)
                if nearer > -closer_m and weight > zero and before > zero:
                    shown = luminance(radiance[row, column, 0], radiance[row, column, 1], radiance[row, column, 2])
                    bound = shown - state.guessed[row, column]
                    if clipped > zero:
                        new_bound = luminance(new[row, column, 0], new[row, column, 1], new[row, column, 2])
                        new_bound -= detail.guessed[row, column]
                        better = better_share(clipped, bound, detail.clipped[row, column], new_bound)
                        blend = max(blend, better * min(weight, one))
                    brighter = detail.lowest[row, column] > CHANGED * shown + LEAST_CHANGE
                    darker = CHANGED * detail.highest[row, column] + LEAST_CHANGE < bound
                    count = state.changed[row, column] + one if brighter or darker else zero
                    if count >= CHANGED_FRAMES:
                        blend, count = max(blend, min(weight, one)), zero
                    state.changed[row, column] = count
            for c in range(3):
                held = (one - before) * hdr[row, column, c] + before * radiance[row, column, c]
                radiance[row, column, c] = blend * new[row, column, c] + (one - blend) * held
            state.depth[row, column] = blend * detail.depth[row, column] + (one - blend) * state.depth[row, column]
            state.seen[row, column] = min(before + blend, one)
            state.clipped[row, column] = blend * detail.clipped[row, column] + (one - blend) * clipped
            guessed = blend * detail.guessed[row, column] + (one - blend) * state.guessed[row, column]
            state.guessed[row, column] = guessed
