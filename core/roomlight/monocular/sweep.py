"""Depth of a frame by what earlier frames show from elsewhere: a plane sweep with semi-global matching.

A network's depth is smooth and misses legs of tables. Poses are known, so each depth of a pixel has its place in each
other picture: where the pictures agree (census, Zabih and Woodfill 1994), the depth is right. Paths along rows and
columns carry it over bare surfaces (Hirschmueller 2008). What is sharply known corrects the depth around it, up to the
edges of the picture's colours.
"""

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, Float32, Shaped, UInt8, UInt32

from roomlight.camera import Intrinsics, rigid_inverse
from roomlight.monocular.kernels.sweep import REACH, aggregate_lines, census_rows, decide_rows, sweep_rows
from roomlight.monocular.tracks import View
from roomlight.threads import parallel_for

_STEP: Final = 2
"""Pixels of the picture per pixel of the sweep."""
_DEPTHS: Final = 64
"""They rise by equal steps of the root of 1 / depth: a pixel or two of parallax each."""
_FARTHEST_M: Final = 25.0
_NEARER: Final = 3.0
"""The nearest depth is this much nearer than the guess's nearest."""
_MARGIN: Final = 3
"""Grey levels that are no difference."""
_PRIOR: Final = 0.05
"""Cost of a depth e times the guess; a census that differs in each bit costs 1."""
_NEIGHBOUR, _JUMP, _EDGE = 0.1, 0.8, 10.0
"""Cost of the next depth beside a pixel, of any other, and the grey levels that halve the second."""
_PATHS: Final = ((0, 1), (0, -1), (1, 0), (-1, 0))
"""Directions (rows, columns) in which costs are carried; diagonals beside them make depth no better."""
_HEAT: Final = 0.2
"""Summed cost that makes a depth e times less likely."""
_LEAST_CONTRAST: Final = 0.12
"""Costs of a pixel that differ less tell nothing: bare walls match everywhere."""
_SPREAD: Final = 0.1
"""Deviation of log depth that halves a pixel's weight."""
_MOST: Final = 1.0
"""Corrections of log depth this large have no weight."""
_SMOOTH, _COLOUR = 100.0, 7.65
"""How far corrections reach, and over which steps of 8-bit colour (Min et al. 2014)."""
_STAYS: Final = 0.003
"""Weight of no correction."""


def refined(
    view: View,
    others: Sequence[View],
    guess: Float32[np.ndarray, "h w"],
    picture: Float32[np.ndarray, "h w 3"],
) -> Float32[np.ndarray, "h w"]:
    """Return 1 / depth of a view, mended where other views tell it.

    Args:
        others: Views from other places, of pictures of the same size; others are left out.
        guess: About its 1 / depth, per metre, above 0.
        picture: Its sRGB picture in [0, 1], whose edges end what a depth corrects.
    """
    others = [other for other in others if other.grey.shape == view.grey.shape]
    if not others:
        return guess
    tone, weight = _swept(view, others, np.ascontiguousarray(_on_grid(guess)))
    change = tone - np.log(_on_grid(guess))
    weight *= np.maximum(1 - (change / _MOST) ** 2, 0)
    known, total = (np.zeros(guess.shape, np.float32) for _ in range(2))
    _on_grid(known)[:], _on_grid(total)[:] = weight * change, weight
    colours = np.rint(picture * 255).astype(np.uint8)
    spread = cv2.ximgproc.createFastGlobalSmootherFilter(colours, _SMOOTH, _COLOUR)
    return guess * np.exp(spread.filter(known) / (spread.filter(total) + _STAYS))


def _swept(
    view: View, others: Sequence[View], guess: Float32[np.ndarray, "gh gw"]
) -> tuple[Float32[np.ndarray, "gh gw"], Float32[np.ndarray, "gh gw"]]:
    """Return log(1 / depth) at every `_STEP`-th pixel, and how well it is known (0 to 1)."""
    nearest = max(_NEARER * float(np.percentile(guess, 97)), 2 / _FARTHEST_M)
    inverses = (np.linspace(_FARTHEST_M**-0.5, nearest**0.5, _DEPTHS) ** 2).astype(np.float32)
    own, theirs = census(view.grey), np.stack([census(other.grey) for other in others])
    projections = np.stack([_projection(view, other) for other in others])
    costs, contrast = np.empty((*guess.shape, _DEPTHS), np.float32), np.empty_like(guess)
    height, width = guess.shape

    def sweep(start: int, stop: int) -> None:
        sweep_rows(own, theirs, projections, inverses, guess, _PRIOR, _STEP, costs, contrast, start, stop)

    parallel_for(sweep, height)
    sums, grey = np.zeros_like(costs), np.ascontiguousarray(_on_grid(view.grey))
    penalties = np.array([_NEIGHBOUR, _JUMP, _EDGE], np.float32)
    for dy, dx in _PATHS:

        def aggregate(start: int, stop: int, dy: int = dy, dx: int = dx) -> None:
            aggregate_lines(costs, grey, penalties, dy, dx, sums, start, stop)

        parallel_for(aggregate, height if dy == 0 else width)
    tone, spread, tones = np.empty_like(guess), np.empty_like(guess), np.log(inverses)
    parallel_for(lambda start, stop: decide_rows(sums, tones, _HEAT, tone, spread, start, stop), height)
    return tone, np.where(contrast > _LEAST_CONTRAST, 1 / (1 + (spread / _SPREAD) ** 2), 0).astype(np.float32)


def census(grey: UInt8[np.ndarray, "h w"]) -> UInt32[np.ndarray, "2 h w"]:
    """Return which neighbours of each pixel are brighter and which darker, a bit each."""
    signs, padded = np.empty((2, *grey.shape), np.uint32), np.pad(grey, REACH, mode="edge")
    parallel_for(lambda start, stop: census_rows(padded, _MARGIN, signs[0], signs[1], start, stop), len(grey))
    return signs


def _projection(view: View, other: View) -> Float32[np.ndarray, "3 4"]:
    """Return the matrix that takes (column, row, 1, 1 / depth) of a view to homogeneous pixels of another."""
    to_other = rigid_inverse(other.camera_to_world) @ view.camera_to_world
    lens = _lens(other.intrinsics)
    turned = lens @ to_other[:3, :3] @ np.linalg.inv(_lens(view.intrinsics))
    return np.hstack([turned, lens @ to_other[:3, 3:]]).astype(np.float32)


def _lens(k: Intrinsics) -> Float[np.ndarray, "3 3"]:
    """Return the matrix that takes points of the camera (OpenGL axes) to homogeneous pixels."""
    return np.array([[k.fx, 0, -k.cx], [0, -k.fy, -k.cy], [0, 0, -1.0]])


def _on_grid(plane: Shaped[np.ndarray, "h w"]) -> Shaped[np.ndarray, "gh gw"]:
    """Return a view of every `_STEP`-th pixel."""
    return plane[_STEP // 2 :: _STEP, _STEP // 2 :: _STEP]
