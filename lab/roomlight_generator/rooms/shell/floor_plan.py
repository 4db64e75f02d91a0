"""Place windows, doors, passages and niches: proposed at random, kept if they fit, otherwise dropped."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from roomlight_generator.rooms.shell.holes import (
    AnyHole,
    Cover,
    Door,
    DoorDesign,
    Niche,
    Passage,
    Window,
    edge_m,
    leads_to_second_room,
)
from roomlight_generator.rooms.shell.outline import Envelope, Side, envelope
from roomlight_generator.rooms.shell.polygons import Point, area, intersection, triangles
from roomlight_generator.rooms.shell.style import ShellStyle, uniform
from roomlight_generator.rooms.shell.window_style import WindowStyle, choose_window_style

_MAX_ATTEMPTS: Final = 14
_CEILING_CLEARANCE_M: Final = 0.09
"""Between a hole's top and the ceiling."""

CLEAR_VIEW_M: Final = 3.0
"""A window is placed only if no part of the building is nearer than this in front of it."""


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """The main room's holes, and the second room behind one of them with its own holes."""

    holes: tuple[AnyHole, ...]
    skylights: tuple[Window, ...]
    second: Envelope | None
    second_holes: tuple[AnyHole, ...]


class _Occupancy:
    """Occupied stretches of the sides, and occupied plan areas outside the room."""

    def __init__(self, room: Envelope, beams_m: float) -> None:
        self.room = room
        self.holes: list[AnyHole] = []
        self.outside: list[list[Point]] = []
        self.swings: list[list[Point]] = []
        self._triangles = triangles(room.corners)
        self._beams_m = beams_m

    def overlaps(self, footprint: Sequence[Point], others: Sequence[Sequence[Point]]) -> float:
        """Return the area that a footprint shares with others."""
        shared = (intersection(footprint, other) for other in others)
        return sum((area(piece) for piece in shared if piece), 0.0)

    def free_outside(self, footprint: Sequence[Point]) -> bool:
        """Return whether a plan area lies outside all rooms."""
        return self.overlaps(footprint, [*self._triangles, *self.outside]) < 1e-6

    def fits(self, hole: AnyHole, *, behind_m: float, front_m: float) -> bool:
        """Return whether the wall has space for a hole, the space behind it is empty and the floor in front of it is
        free.

        The building's own exterior must not be visible from a window: its view, 27 degrees to each side, must be empty.
        """
        side = self.room.sides[hole.side]
        start, end = edge_m(hole)
        top = max(gap.top_m for gap in hole.gaps()) + _CEILING_CLEARANCE_M
        if start < 0.03 or end > side.length_m - 0.03:
            return False
        if min(side.height_at(start), side.height_at(end)) - self._beams_m < top:
            return False
        for other in self.holes:
            if other.side == hole.side:
                low, high = edge_m(other)
                if start < high + 0.04 and end > low - 0.04:
                    return False
                if isinstance(hole, Window) and leads_to_second_room(other):
                    return False
        flare = 0.5 * behind_m if isinstance(hole, Window) else 0.0
        if not self.free_outside(side.footprint(hole.rect[0], hole.rect[1], 0.003, behind_m, flare=flare)):
            return False
        front = side.footprint(start, end, -max(front_m, 0.05), -0.001)
        if isinstance(hole, Door) and self.overlaps(front, self.swings) > 1e-6:
            return False
        return self.overlaps(front, self._triangles) > area(front) - 1e-6


def choose_floor_plan(room: Envelope, style: ShellStyle, rng: np.random.Generator, *, beams_m: float) -> FloorPlan:
    """Place doors (with the second room), then windows, then niches; beams lower the usable wall by beams_m."""
    occupancy = _Occupancy(room, beams_m)
    wall_m = uniform(rng, style.wall_m)
    design = _choose_door_design(rng)
    second: Envelope | None = None
    second_holes: tuple[AnyHole, ...] = ()
    kind = rng.random()
    closed = int(rng.integers(style.doors[0], style.doors[1] + 1))
    if kind < style.open_door + style.passage:
        second = _place_second_room(occupancy, design, wall_m, rng, passage=kind >= style.open_door)
        if second is not None:
            second_holes = _second_holes(occupancy, second, style, design, wall_m, rng)
    if second is None:
        closed = max(closed, 1)
    for _ in range(closed):
        _place_closed_door(occupancy, design, wall_m, rng)
    window_style = choose_window_style(style, room.height_m - beams_m, wall_m, abs(area(room.corners)), rng)
    count = int(rng.integers(style.windows[0], style.windows[1] + 1))
    skylights = _choose_skylights(room, style, window_style, count, rng) if rng.random() < style.skylights else []
    _place_windows(occupancy, window_style, max(count - len(skylights), 0), rng)
    if rng.random() < style.niche:
        _place_niche(occupancy, wall_m, rng)
    return FloorPlan(tuple(occupancy.holes), tuple(skylights), second, second_holes)


def _sides_by_length(room: Envelope, least_m: float) -> tuple[list[int], np.ndarray]:
    """Return the sides that are at least least_m long, and their sampling weights."""
    sides = [i for i, side in enumerate(room.sides) if side.length_m >= least_m]
    weights = np.array([room.sides[i].length_m for i in sides])
    return sides, weights / max(float(weights.sum()), 1e-9)


def _choose_door_design(rng: np.random.Generator) -> DoorDesign:
    """Choose one door design for the whole home."""
    panelled = rng.random() < 0.55
    panels = ((1, 1), (1, 2), (2, 2), (2, 3), (1, 3), (1, 4))[int(rng.integers(6))]
    rng.random()  # not used; without it every seed would give other rooms
    return DoorDesign(
        leaf="panels" if panelled else "flush",
        panels=panels,
        architrave_m=uniform(rng, (0.05, 0.1)),
    )


def _choose_doorway_start(side: Side, width: float, edge: float, rng: np.random.Generator) -> float:
    """Choose where a doorway starts: usually near a corner."""
    room_left = side.length_m - width - 2 * edge
    if room_left <= 0:
        return edge
    near = min(uniform(rng, (0.03, 0.35)), room_left)
    where = rng.random()
    if where < 0.35:
        return edge + near
    return edge + (room_left - near if where < 0.7 else float(rng.random()) * room_left)


def _place_closed_door(occupancy: _Occupancy, design: DoorDesign, wall_m: float, rng: np.random.Generator) -> None:
    width, height = uniform(rng, (0.68, 0.92)), uniform(rng, (1.96, 2.1))
    height = min(height, occupancy.room.height_m - 0.2)
    sides, weights = _sides_by_length(occupancy.room, width + 0.3)
    for _ in range(_MAX_ATTEMPTS if sides else 0):
        i = int(rng.choice(sides, p=weights))
        start = _choose_doorway_start(occupancy.room.sides[i], width, design.architrave_m + 0.03, rng)
        door_design = replace(design, hinge_right=bool(rng.random() < 0.5), swings_in=bool(rng.random() < 0.6))
        depth = float(min(wall_m, 0.07 if door_design.swings_in else 0.16) - 0.004)
        door = Door(i, (start, start + width, 0.0, height), depth, door_design)
        if occupancy.fits(door, behind_m=depth + 0.02, front_m=door.keep_clear_m):
            occupancy.holes.append(door)
            return


def _place_second_room(
    occupancy: _Occupancy, design: DoorDesign, wall_m: float, rng: np.random.Generator, *, passage: bool
) -> Envelope | None:
    """Place an open door or a passage, and the second room behind it; return None if there is no space."""
    double = rng.random() < 0.2
    if passage:
        width, height = uniform(rng, (0.85, 1.9)), uniform(rng, (2.0, 2.5))
    else:
        width, height = uniform(rng, (1.3, 1.7) if double else (0.7, 0.95)), uniform(rng, (1.96, 2.12))
    height = min(height, occupancy.room.height_m - 0.2)
    sides, weights = _sides_by_length(occupancy.room, width + 0.3)
    for _ in range(2 * _MAX_ATTEMPTS if sides else 0):
        i = int(rng.choice(sides, p=weights))
        side = occupancy.room.sides[i]
        start = _choose_doorway_start(side, width, design.architrave_m + 0.03, rng)
        rect = (start, start + width, 0.0, height)
        if passage:
            arch = float(rng.choice([0.0, uniform(rng, (0.1, 0.35))], p=[0.65, 0.35]))
            hole: Door | Passage = Passage(i, rect, wall_m, min(arch, width / 2), bool(rng.random() < 0.5))
        else:
            inward = bool(rng.random() < 0.5)
            door_design = replace(
                design,
                leaves=2 if double else 1,
                hinge_right=bool(rng.random() < 0.5),
                swings_in=inward,
                open_degrees=uniform(rng, (35.0, 92.0) if inward else (60.0, 105.0)),
            )
            leaf = width / door_design.leaves
            hole = Door(i, rect, wall_m, door_design, to_second_room=True, keep_clear_m=leaf + 0.05 if inward else 0.6)
        if not occupancy.fits(hole, behind_m=wall_m + 1.0, front_m=hole.keep_clear_m):
            continue
        corners = _choose_second_room_corners(occupancy, side, hole, rng)
        if corners is None:
            continue
        occupancy.holes.append(hole)
        occupancy.outside.append(corners)
        if isinstance(hole, Door) and hole.design.swings_in:
            occupancy.swings.append(side.footprint(start, start + width, -hole.keep_clear_m, -0.001))
        height_m = max(height + 0.15, uniform(rng, (2.35, 2.9)))
        return envelope(corners, height_m, ())
    return None


def _choose_second_room_corners(
    occupancy: _Occupancy, side: Side, hole: AnyHole, rng: np.random.Generator
) -> list[Point] | None:
    """Return the plan of the second room: a corridor along the wall or a small room, `depth_m` behind the side."""
    s0, s1 = hole.rect[:2]
    for _ in range(6):
        corridor = rng.random() < 0.5
        depth_m = uniform(rng, (1.1, 1.7) if corridor else (2.0, 3.8))
        left, right = uniform(rng, (0.15, 2.4)), uniform(rng, (0.15, 2.4))
        low = min(max(s0 - left, 0.0), s0 - 0.12)
        high = max(min(s1 + right, side.length_m), s1 + 0.12)
        corners = side.footprint(low, high, hole.depth_m, hole.depth_m + depth_m)
        if occupancy.free_outside(side.footprint(low - 0.02, high + 0.02, hole.depth_m, hole.depth_m + depth_m + 0.02)):
            return corners
    return None


def _second_holes(
    occupancy: _Occupancy,
    second: Envelope,
    style: ShellStyle,
    design: DoorDesign,
    wall_m: float,
    rng: np.random.Generator,
) -> tuple[AnyHole, ...]:
    """Choose a window opposite the entry, with no part of the building before it, or in half of the rooms a door."""
    far = second.sides[1]
    if rng.random() < style.second_window:
        # Without curtains, over nearly the whole wall.
        window_style = choose_window_style(style, second.height_m, wall_m, abs(area(second.corners)), rng)
        window = replace(window_style, cover=Cover("none")).window(1, 0.12, far.length_m - 0.12)
        if window is not None:
            behind_m = wall_m + CLEAR_VIEW_M
            view = far.footprint(window.rect[0], window.rect[1], 0.003, behind_m, flare=0.5 * behind_m)
            if occupancy.free_outside(view):
                return (window,)
    width, height = 0.8, min(2.02, second.height_m - 0.2)
    free = far.length_m - width - 2 * design.architrave_m - 0.1
    if free < 0 or rng.random() < 0.5:
        return ()
    start = design.architrave_m + 0.05 + float(rng.random()) * free
    return (Door(1, (start, start + width, 0.0, height), 0.06, replace(design, hinge_right=bool(rng.random() < 0.5))),)


def _place_windows(occupancy: _Occupancy, window_style: WindowStyle, count: int, rng: np.random.Generator) -> None:
    """Place windows on one wall or two: evenly spaced on each, otherwise wherever there is space."""
    sides, weights = _sides_by_length(occupancy.room, 0.75)
    if not sides or not count:
        return
    # A bay has a window in each of its sides.
    bays = _bay_sides(occupancy.room)
    for i in bays:
        count -= _place_window_row(
            occupancy,
            i,
            1,
            replace(window_style, cover=Cover("none")) if window_style.cover.curtains else window_style,
            rng,
        )
    order = [int(i) for i in rng.choice(sides, size=len(sides), replace=False, p=weights) if i not in bays]
    split = count if window_style.fills_wall_first or rng.random() < 0.55 else (count + 1) // 2
    left = count
    for i in order if left > 0 else []:
        here = min(split if left == count else left, left)
        left -= _place_window_row(occupancy, i, here, window_style, rng)
        if left <= 0:
            return


def _bay_sides(room: Envelope) -> list[int]:
    """Return the sides at an angle to the others, and any side between two of them."""
    count = len(room.sides)
    oblique = [min(abs(side.plane.u[0]), abs(side.plane.u[2])) > 1e-6 for side in room.sides]
    return [i for i in range(count) if oblique[i] or (oblique[i - 1] and oblique[(i + 1) % count])]


def _place_window_row(
    occupancy: _Occupancy, i: int, count: int, window_style: WindowStyle, rng: np.random.Generator
) -> int:
    """Spread windows over the part of a wall that its doors leave free; return how many were placed."""
    side = occupancy.room.sides[i]
    placed = 0
    low, high = _longest_free_stretch(occupancy, i)
    for n in range(count, 0, -1):
        cell = (high - low) / n
        if n > 1 and cell < window_style.pier_m + min(window_style.width_m, 0.6):
            continue
        width = min(window_style.width_m, cell - window_style.pier_m)
        jitter = float(rng.uniform(-0.5, 0.5)) * max(cell - width - window_style.pier_m, 0.0) * (n == 1)
        for k in range(n):
            middle = low + (k + 0.5) * cell + jitter
            window = window_style.window(i, middle - width / 2, middle + width / 2)
            if window is not None and occupancy.fits(window, behind_m=window.depth_m + CLEAR_VIEW_M, front_m=0.1):
                occupancy.holes.append(window)
                placed += 1
        if placed:
            return placed
    for _ in range(4):
        width = uniform(rng, (min(0.6, window_style.width_m), window_style.width_m))
        start = uniform(rng, (0.0, max(side.length_m - width, 0.01)))
        window = window_style.window(i, start, start + width)
        if window is not None and occupancy.fits(window, behind_m=window.depth_m + CLEAR_VIEW_M, front_m=0.1):
            occupancy.holes.append(window)
            return 1
    return 0


def _longest_free_stretch(occupancy: _Occupancy, i: int) -> tuple[float, float]:
    side = occupancy.room.sides[i]
    taken = sorted(edge_m(hole) for hole in occupancy.holes if hole.side == i)
    stops = [0.0, *(stop for span in taken for stop in span), side.length_m]
    spans = list(zip(stops[::2], stops[1::2], strict=True))
    return max(spans, key=lambda span: span[1] - span[0])


def _choose_skylights(
    room: Envelope, style: ShellStyle, window_style: WindowStyle, count: int, rng: np.random.Generator
) -> list[Window]:
    """Place up to two skylights in each slope, side by side at one height."""
    skylights: list[Window] = []
    for k, slope in enumerate(room.slopes):
        wanted = int(rng.integers(1, 3))
        width_m, height_m = uniform(rng, (0.55, 1.1)), min(uniform(rng, (0.8, 1.4)), slope.rise_m - 0.35)
        if height_m < 0.45 or (k > 0 and rng.random() < 0.35):
            continue
        low = uniform(rng, (0.15, max(slope.rise_m - height_m - 0.15, 0.16)))
        cell = slope.length_m / wanted
        for n in range(wanted):
            start = n * cell + uniform(rng, (0.2, max(cell - width_m - 0.2, 0.21)))
            window = window_style.skylight(k, (start, start + width_m, low, low + height_m), max(style.wall_m[0], 0.16))
            if start + width_m < slope.length_m - 0.15 and _on_slope(room, k, window):
                skylights.append(window)
    return skylights[: max(count, 1)] if style.windows[1] else []


def _on_slope(room: Envelope, k: int, window: Window) -> bool:
    """Return whether the hole lies within the part of the slope that is ceiling, with a margin around it."""
    plane = room.slopes[k].plane
    s0, s1, h0, h1 = window.rect
    corners = [plane.at(s, h) for s in (s0 - 0.1, s1 + 0.1) for h in (h0 - 0.1, h1 + 0.1)]
    ground = [(float(p[0]), float(p[2])) for p in (corners[0], corners[2], corners[3], corners[1])]
    if area(ground) < 0:
        ground.reverse()
    inside = sum(area(piece) for triangle in triangles(room.corners) if (piece := intersection(ground, triangle)))
    lowest = all(float(p[1]) < room.ceiling_at(float(p[0]), float(p[2])) + 1e-6 for p in corners)
    return lowest and inside > area(ground) - 1e-6


def _place_niche(occupancy: _Occupancy, wall_m: float, rng: np.random.Generator) -> None:
    width, low = uniform(rng, (0.4, 1.1)), uniform(rng, (0.6, 1.1))
    high = low + uniform(rng, (0.5, 1.1))
    depth = uniform(rng, (0.1, 0.25))
    shelves = tuple(float(h) for h in np.linspace(low, high, int(rng.integers(1, 4)) + 1)[1:-1])
    sides, weights = _sides_by_length(occupancy.room, width + 0.4)
    for _ in range(_MAX_ATTEMPTS if sides else 0):
        i = int(rng.choice(sides, p=weights))
        start = 0.1 + float(rng.random()) * (occupancy.room.sides[i].length_m - width - 0.2)
        niche = Niche(i, (start, start + width, low, high), depth, shelves)
        if occupancy.fits(niche, behind_m=max(depth, wall_m) + 0.02, front_m=0.3):
            occupancy.holes.append(niche)
            return
