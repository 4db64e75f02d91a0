"""A room's large surfaces: walls with holes, floor, ceiling; and the trim: skirting, mouldings, beams.

Every surface overlaps its neighbours by `OVERLAP` (see `roomlight_generator.rooms.shell.mesh_builder`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomlight_generator.rooms.finishes import RoomFinishes
from roomlight_generator.rooms.scene import Item, Material
from roomlight_generator.rooms.shell.holes import AnyHole, Door, Passage, Window
from roomlight_generator.rooms.shell.mesh_builder import MeshBuilder, Plane
from roomlight_generator.rooms.shell.outline import OUTER_MARGIN_M, Envelope, Side, offset_outline, wall_cut
from roomlight_generator.rooms.shell.polygons import (
    OVERLAP,
    Outline,
    Point,
    clip_half_plane,
    difference,
    rect,
    triangles,
)


@dataclass(frozen=True)
class Trim:
    """Trim along the walls; heights in metres.

    Attributes:
        lower_m: Band of the lower wall (from, to); None: walls have no lower part.
    """

    lower_m: tuple[float, float] | None = None
    lower_sides: frozenset[int] = frozenset()
    rail: bool = False
    skirting_m: float = 0.0
    crown_m: float = 0.0
    accent: bool = True


def arch_outline(hole: Passage) -> list[Point]:
    """Return the outline of a passage: a rectangle whose top may be arched."""
    s0, s1, h0, h1 = hole.rect
    if hole.arch_m < 0.02:
        return rect(s0, s1, h0, h1)
    middle, half = (s0 + s1) / 2, (s1 - s0) / 2
    angles = np.linspace(0, np.pi, 13)
    base = h1 - hole.arch_m
    top = [(middle + half * float(np.cos(t)), base + hole.arch_m * float(np.sin(t))) for t in angles]
    return [(s0, h0), (s1, h0), *top]


def hole_outline(hole: AnyHole) -> list[Point]:
    """Return the outline of any hole in its plane."""
    return arch_outline(hole) if isinstance(hole, Passage) else rect(*hole.rect)


def build_wall(
    room: Envelope, index: int, holes: Sequence[Outline], finishes: RoomFinishes, trim: Trim, *, accent: bool
) -> MeshBuilder:
    """Build one wall with its holes cut out, in one or two finishes."""
    side = room.sides[index]
    whole: Outline = rect(-OVERLAP, side.length_m + OVERLAP, -OUTER_MARGIN_M, room.height_m + OUTER_MARGIN_M)
    for slope in room.slopes:
        whole = clip_half_plane(whole, *wall_cut(slope, side.plane, OUTER_MARGIN_M))
    material = (finishes.accent_wall if accent else None) or finishes.wall
    parts: list[tuple[Outline, Material]] = [(whole, material)]
    if trim.lower_m is not None and index in trim.lower_sides and finishes.lower_wall is not None:
        low, high = trim.lower_m
        band = clip_half_plane(clip_half_plane(whole, 0.0, 1.0, high), 0.0, -1.0, -low if low > 0 else OUTER_MARGIN_M)
        parts = [(clip_half_plane(whole, 0.0, -1.0, -(high - OVERLAP)), material), (band, finishes.lower_wall)]
        if low > 0:
            parts.append((clip_half_plane(whole, 0.0, 1.0, low + OVERLAP), material))
    builder = MeshBuilder()
    for outline, chosen in parts:
        pieces: list[Outline] = [outline] if outline else []
        for hole in holes:
            pieces = list(difference(pieces, hole))
        for piece in pieces:
            builder.panel(side.plane, piece, chosen)
    return builder


def build_floor(room: Envelope, material: Material) -> MeshBuilder:
    """Build the floor, which extends under the walls."""
    builder = MeshBuilder()
    plane = Plane(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0]))
    for piece in triangles(offset_outline(room.corners, OUTER_MARGIN_M)):
        builder.panel(plane, [(x, -z) for x, z in reversed(piece)], material)
    return builder


def build_ceiling(room: Envelope, material: Material, skylights: Sequence[Window]) -> MeshBuilder:
    """Build the flat ceiling and the slopes with their skylights' holes, each extended past the crease and over the
    walls."""
    builder = MeshBuilder()
    pieces = triangles(offset_outline(room.corners, OUTER_MARGIN_M))
    flat = Plane(np.array([0.0, room.height_m, 0.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    planes = [(0.0, 0.0, room.height_m)]
    for slope in room.slopes:
        # Height over plan as a x + b z + c.
        up = slope.normal[1]
        planes.append((-float(slope.normal[0] / up), -float(slope.normal[2] / up), float(slope.offset / up)))
    for k, (a, b, c) in enumerate(planes):
        for piece in pieces:
            part: Outline = piece
            for j, (other_a, other_b, other_c) in enumerate(planes):
                if j != k and part:
                    part = clip_half_plane(part, a - other_a, b - other_b, other_c - c + OUTER_MARGIN_M)
            if not part:
                continue
            if k == 0:
                builder.panel(flat, part, material)
                continue
            plane = room.slopes[k - 1].plane
            world = np.array([[x, a * x + b * z + c, z] for x, z in part]) - plane.origin
            on_slope: list[Outline] = [[(float(p @ plane.u), float(p @ plane.v)) for p in world]]
            for window in skylights:
                if window.side == k - 1:
                    on_slope = list(difference(on_slope, rect(*window.rect)))
            for outline in on_slope:
                builder.panel(plane, outline, material)
    return builder


def _free_spans(side: Side, holes: Sequence[AnyHole], low: float, high: float) -> list[tuple[float, float, bool, bool]]:
    """Return a side's stretches without holes between two heights: (from, to, starts, ends at a corner)."""
    cuts: list[tuple[float, float]] = []
    for hole in holes:
        edge = 0.0
        if isinstance(hole, Door):
            edge = hole.design.architrave_m
        elif isinstance(hole, Passage) and hole.lined:
            edge = 0.07
        if hole.rect[2] < high and hole.rect[3] > low:
            cuts.append((hole.rect[0] - edge, hole.rect[1] + edge))
    cuts.sort()
    stops = [0.0, *(stop for cut in cuts for stop in cut), side.length_m]
    spans = list(zip(stops[::2], stops[1::2], strict=True))
    last = len(spans) - 1
    return [(low, high, k == 0, k == last) for k, (low, high) in enumerate(spans) if high - low > 0.01]


def _sweep_along(
    side: Side, holes: Sequence[AnyHole], profile: Sequence[Point], material: Material, builder: MeshBuilder
) -> None:
    low, high = min(h for _, h in profile), max(h for _, h in profile)
    for start, end, first, last in _free_spans(side, holes, low, high):
        mitres = (side.turn_before if first else None, side.turn_after if last else None)
        builder.swept(side.plane, profile, (start, end), mitres, material)


def trim_items(
    room: Envelope, index: int, holes: Sequence[AnyHole], finishes: RoomFinishes, moulding: Material, trim: Trim
) -> list[Item]:
    """Build the skirting board, chair rail and crown moulding of one wall."""
    side = room.sides[index]
    items: list[Item] = []
    if trim.skirting_m > 0:
        builder, height_m = MeshBuilder(), trim.skirting_m
        profile = [(0.014, 0.0), (0.014, height_m - 0.012), (0.006, height_m), (0.0, height_m)]
        _sweep_along(side, holes, profile, finishes.skirting, builder)
        if builder:
            items.append(Item(f"skirting {index}", "skirting", builder.mesh()))
    builder = MeshBuilder()
    if trim.rail and trim.lower_m is not None and index in trim.lower_sides:
        at = trim.lower_m[1]
        if side.least_height_m > at + 0.1:
            _sweep_along(
                side,
                holes,
                [(0.0, at - 0.02), (0.02, at - 0.012), (0.02, at + 0.02), (0.0, at + 0.02)],
                moulding,
                builder,
            )
    flat = side.least_height_m > room.height_m - 1e-6 and not room.slopes
    if trim.crown_m > 0 and flat:
        top, depth_m = room.height_m, trim.crown_m
        turn = np.linspace(0, np.pi / 2, 4)
        cove = [(depth_m * float(1 - np.cos(t)), top - depth_m * float(1 - np.sin(t))) for t in turn]
        profile = [(0.0, top - depth_m - 0.012), (0.008, top - depth_m - 0.012), *[(a + 0.008, h) for a, h in cove]]
        _sweep_along(side, [], profile, moulding, builder)
    if builder:
        items.append(Item(f"moulding {index}", "moulding", builder.mesh()))
    return items


def beam_items(
    room: Envelope, skylights: Sequence[Window], material: Material, depth_m: float, rng: np.random.Generator
) -> list[Item]:
    """Build beams below a flat ceiling along its shorter side, none in the middle (the place of lamps); rafters on
    slopes, but not across a skylight."""
    width_m = float(rng.uniform(0.08, 0.2))
    spacing = float(rng.uniform(0.6, 1.25))
    builder = MeshBuilder()
    for k, slope in enumerate(room.slopes):
        count = max(2, round(slope.length_m / spacing))
        rise = slope.rise_m if slope.rise_m > 0.3 else 0.0
        for n in range(count + 1 if rise else 0):
            middle = n * slope.length_m / count
            start, end = max(middle - width_m / 2, 0.0), min(middle + width_m / 2, slope.length_m)
            if any(
                light.side == k and light.rect[0] < end + 0.03 and light.rect[1] > start - 0.03 for light in skylights
            ):
                continue
            builder.bar(
                slope.plane, (start, end, -0.2, rise + depth_m * 0.5), (-depth_m * 0.7, OVERLAP), material, back=False
            )
    if not room.slopes:
        points = np.array(room.corners)
        size = np.ptp(points, axis=0)
        plane = Plane(np.array([0.0, room.height_m, 0.0]), np.array([1.0, 0, 0]), np.array([0.0, 0, 1.0]))
        across = 0 if size[0] >= size[1] else 1
        low, high = points[:, across].min(), points[:, across].max()
        count = max(2, 2 * round((high - low) / spacing / 2))
        step = (high - low) / count
        for n in range(count):
            middle = float(low + (n + 0.5) * step)
            for start, end in _chords(points, across, middle, width_m):
                span = (middle - width_m / 2, middle + width_m / 2, start, end)
                box = span if across == 0 else (span[2], span[3], span[0], span[1])
                builder.bar(plane, box, (-depth_m, OVERLAP), material, back=False)
    return [Item("beams", "beam", builder.mesh())] if builder else []


def _chords(points: np.ndarray, across: int, middle: float, width_m: float) -> list[tuple[float, float]]:
    """Return where lines at both edges of a beam run inside the outline; 1 cm into the walls at each end."""
    spans: list[list[tuple[float, float]]] = []
    for place in (middle - width_m / 2, middle + width_m / 2):
        hits: list[float] = []
        for i in range(len(points)):
            a, b = points[i], points[(i + 1) % len(points)]
            if (a[across] > place) != (b[across] > place):
                t = (place - a[across]) / (b[across] - a[across])
                hits.append(float(a[1 - across] + t * (b[1 - across] - a[1 - across])))
        hits.sort()
        spans.append(list(zip(hits[::2], hits[1::2], strict=True)))
    common = [(max(a[0], b[0]), min(a[1], b[1])) for a in spans[0] for b in spans[1]]
    return [(low - 0.01, high + 0.01) for low, high in common if high - low > 0.3]
