# pyright: reportMissingParameterType=false
"""Ears of polygons: corners whose triangle holds no other corner."""

from typing import Any

from numba import njit

from roomlight.kernels.common import JIT, KERNEL

_EXACT: dict[str, Any] = KERNEL | {"fastmath": False}
_INLINED: dict[str, Any] = JIT | {"fastmath": False}


@njit(**_INLINED)
def _turn(flat, a, b, c):
    """Return twice the signed area of a triangle of three corners."""
    return (flat[b, 0] - flat[a, 0]) * (flat[c, 1] - flat[a, 1]) - (flat[b, 1] - flat[a, 1]) * (flat[c, 0] - flat[a, 0])


@njit(**_INLINED)
def _holds(flat, a, b, c, p):
    """Return whether a corner lies in a triangle, at none of its corners."""
    if _turn(flat, c, a, p) < 0 or _turn(flat, a, b, p) < 0 or _turn(flat, b, c, p) < 0:
        return False
    touches = False
    for corner in (a, b, c):
        touches |= flat[p, 0] == flat[corner, 0] and flat[p, 1] == flat[corner, 1]
    return not touches


@njit(**_EXACT)
def clip_ears(flat, after, ears, tests):
    """Cut the ears of a polygon of counter-clockwise corners into `ears`, whose rest becomes a fan where none is left.

    `after` holds the corner that follows each. Returns what is left of `tests`, of a corner in a triangle each; below 0
    the polygon is not cut.
    """
    before, tried = len(flat) - 1, 0
    for row in range(len(ears)):
        left = len(flat) - row
        while left > 3 and tried < left:
            a, b, c = before, after[before], after[after[before]]
            clear, at, tests = _turn(flat, a, b, c) > 0, after[c], tests - 1
            while clear and at != a:
                tests -= 1
                clear = not _holds(flat, a, b, c, at)
                at = after[at]
            if clear or tests < 0:
                break
            before, tried = b, tried + 1
        if tests < 0:
            return tests
        ears[row] = (before, after[before], after[after[before]])
        after[before] = after[after[before]]
        tried = 0 if tried < left else tried - 1
    return tests
