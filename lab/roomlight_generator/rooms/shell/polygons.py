"""Outlines in a plane: clipping, intersection, difference and triangulation of polygons; (s, h) in metres."""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

OVERLAP: Final = 0.0005
"""Overlap of neighbouring surfaces, metres (reasons in `mesh_builder`)."""

Point = tuple[float, float]
Outline = Sequence[Point]
"""Corners of a convex area, counter-clockwise as (s, h) is seen."""

Rect = tuple[float, float, float, float]
"""s0, s1, h0, h1."""


def rect(s0: float, s1: float, h0: float, h1: float) -> list[Point]:
    """Return a rectangle as an outline."""
    return [(s0, h0), (s1, h0), (s1, h1), (s0, h1)]


def clip_half_plane(outline: Outline, a: float, b: float, c: float) -> list[Point]:
    """Return the part of a convex outline where a s + b h <= c; may be empty."""
    kept: list[Point] = []
    signs = [a * s + b * h - c for s, h in outline]
    for i, (s, h) in enumerate(outline):
        j = (i + 1) % len(outline)
        if signs[i] <= 0:
            kept.append((s, h))
        if (signs[i] < 0 < signs[j]) or (signs[j] < 0 < signs[i]):
            t = signs[i] / (signs[i] - signs[j])
            kept.append((s + t * (outline[j][0] - s), h + t * (outline[j][1] - h)))
    return kept if len(kept) >= 3 and area(kept) > 1e-9 else []


def intersection(outline: Outline, other: Outline) -> list[Point]:
    """Return the intersection of two convex outlines."""
    polygon = list(outline)
    for (s0, h0), (s1, h1) in zip(other, [*other[1:], other[0]], strict=True):
        a, b = h1 - h0, s0 - s1
        polygon = clip_half_plane(polygon, a, b, a * s0 + b * h0) if polygon else polygon
    return polygon


def difference(pieces: Iterable[Outline], hole: Outline) -> list[list[Point]]:
    """Subtract a convex hole from convex pieces; the rest overlaps the hole's edge by `OVERLAP`."""
    left: list[list[Point]] = []
    for piece in pieces:
        rest = list(piece)
        if not intersection(rest, hole):
            left.append(rest)
            continue
        for (s0, h0), (s1, h1) in zip(hole, [*hole[1:], hole[0]], strict=True):
            if not rest:
                break
            a, b = h1 - h0, s0 - s1
            length = float(np.hypot(a, b))
            a, b = a / length, b / length
            c = a * s0 + b * h0
            outside = clip_half_plane(rest, -a, -b, -(c - OVERLAP))
            if outside:
                left.append(outside)
            rest = clip_half_plane(rest, a, b, c)
    return left


def area(outline: Outline) -> float:
    """Return the signed area, positive for counter-clockwise."""
    total = 0.0
    for (s0, h0), (s1, h1) in zip(outline, [*outline[1:], outline[0]], strict=True):
        total += s0 * h1 - s1 * h0
    return total / 2


def triangles(outline: Outline) -> list[list[Point]]:
    """Cut a simple counter-clockwise outline into triangles (ear clipping).

    Raises:
        ValueError: the outline crosses itself or runs clockwise.
    """
    left = list(outline)
    corners: list[list[Point]] = []
    while len(left) > 3:
        for i in range(len(left)):
            a, b, c = left[i - 1], left[i], left[(i + 1) % len(left)]
            turn = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
            if turn > 1e-12 and not any(_inside(p, (a, b, c)) for p in left if p not in (a, b, c)):
                corners.append([a, b, c])
                del left[i]
                break
        else:
            raise ValueError(f"the outline {list(outline)} crosses itself or runs clockwise: it cannot be triangulated")
    corners.append(left)
    return corners


def _inside(point: Point, triangle: tuple[Point, Point, Point]) -> bool:
    for (s0, h0), (s1, h1) in zip(triangle, (triangle[1], triangle[2], triangle[0]), strict=True):
        if (s1 - s0) * (point[1] - h0) - (h1 - h0) * (point[0] - s0) < -1e-12:
            return False
    return True
