"""Where windows, doors, passages and niches go: proposed at random, kept where they fit, else left away."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from roomlight_generator.rooms.shell.holes import AnyHole, Cover, Door, DoorLook, Niche, Passage, Window, edge_m
from roomlight_generator.rooms.shell.outline import Envelope, Side, envelope
from roomlight_generator.rooms.shell.sheets import Point, area, triangles, within
from roomlight_generator.rooms.shell.style import ShellStyle, between
from roomlight_generator.rooms.shell.window_choice import WindowTaste, choose_taste

_TRIES: Final = 14
_HEADROOM: Final = 0.09
"""Between a hole's top and the ceiling."""

VIEW_M: Final = 3.0
"""A window is put only where nothing of the building stands so near before it."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The main room's holes, and the second room behind one of them with its own."""

    holes: tuple[AnyHole, ...]
    skylights: tuple[Window, ...]
    second: Envelope | None
    second_holes: tuple[AnyHole, ...]


class _Board:
    """What is taken so far: stretches of the sides, and plan areas outside."""

    def __init__(self, room: Envelope, beams_m: float) -> None:
        self.room = room
        self.holes: list[AnyHole] = []
        self.outside: list[list[Point]] = []
        self.swings: list[list[Point]] = []
        self._triangles = triangles(room.corners)
        self._beams_m = beams_m

    def overlaps(self, footprint: Sequence[Point], others: Sequence[Sequence[Point]]) -> float:
        """The area a footprint shares with others."""
        shared = (within(footprint, other) for other in others)
        return sum((area(piece) for piece in shared if piece), 0.0)

    def free_outside(self, footprint: Sequence[Point]) -> bool:
        """Whether a plan area lies outside all rooms."""
        return self.overlaps(footprint, [*self._triangles, *self.outside]) < 1e-6

    def fits(self, hole: AnyHole, *, behind_m: float, front_m: float) -> bool:
        """Whether there is wall for it, nothing behind it, and free floor before it.

        From a window one must not see the building's own outside: nothing stands in its view, 27 degrees to each side.
        """
        side = self.room.sides[hole.side]
        start, end = edge_m(hole)
        top = max(gap.top_m for gap in hole.gaps()) + _HEADROOM
        if start < 0.03 or end > side.length_m - 0.03:
            return False
        if min(side.height_at(start), side.height_at(end)) - self._beams_m < top:
            return False
        for other in self.holes:
            if other.side == hole.side:
                low, high = edge_m(other)
                if start < high + 0.04 and end > low - 0.04:
                    return False
                if isinstance(hole, Window) and _leads_on(other):
                    return False
        flare = 0.5 * behind_m if isinstance(hole, Window) else 0.0
        if not self.free_outside(side.footprint(hole.rect[0], hole.rect[1], 0.003, behind_m, flare=flare)):
            return False
        front = side.footprint(start, end, -max(front_m, 0.05), -0.001)
        if isinstance(hole, Door) and self.overlaps(front, self.swings) > 1e-6:
            return False
        return self.overlaps(front, self._triangles) > area(front) - 1e-6


def _leads_on(hole: AnyHole) -> bool:
    """Whether the second room is behind it."""
    return isinstance(hole, Passage) or (isinstance(hole, Door) and hole.through)


def choose_layout(room: Envelope, style: ShellStyle, rng: np.random.Generator, *, beams_m: float) -> Layout:
    """Doors first (with the second room), then windows, then niches; beams take beams_m off the walls' height."""
    board = _Board(room, beams_m)
    wall_m = between(rng, style.wall_m)
    look = _door_look(rng)
    second: Envelope | None = None
    second_holes: tuple[AnyHole, ...] = ()
    kind = rng.random()
    closed = int(rng.integers(style.doors[0], style.doors[1] + 1))
    if kind < style.open_door + style.passage:
        found = _through(board, look, wall_m, rng, passage=kind >= style.open_door)
        if found is not None:
            second, second_holes = found
    if second is None:
        closed = max(closed, 1)
    for _ in range(closed):
        _closed_door(board, look, wall_m, rng)
    taste = choose_taste(style, room.height_m - beams_m, wall_m, abs(area(room.corners)), rng)
    count = int(rng.integers(style.windows[0], style.windows[1] + 1))
    lights = _skylights(room, style, taste, count, rng) if rng.random() < style.skylights else []
    _windows(board, taste, max(count - len(lights), 0), rng)
    if rng.random() < style.niche:
        _niche(board, wall_m, rng)
    return Layout(tuple(board.holes), tuple(lights), second, second_holes)


def _sides_by_length(room: Envelope, least_m: float) -> tuple[list[int], np.ndarray]:
    """Sides at least so long, and their weights for drawing one."""
    sides = [i for i, side in enumerate(room.sides) if side.length_m >= least_m]
    weights = np.array([room.sides[i].length_m for i in sides])
    return sides, weights / max(float(weights.sum()), 1e-9)


def _door_look(rng: np.random.Generator) -> DoorLook:
    """One make of door for the whole home."""
    panelled = rng.random() < 0.55
    panels = ((1, 1), (1, 2), (2, 2), (2, 3), (1, 3), (1, 4))[int(rng.integers(6))]
    return DoorLook(
        leaf="panels" if panelled else "flush",
        panels=panels,
        lining_m=between(rng, (0.025, 0.04)),
        architrave_m=between(rng, (0.05, 0.1)),
    )


def _along(side: Side, width: float, edge: float, rng: np.random.Generator) -> float:
    """Where a doorway starts: mostly near a corner, as doors are."""
    room_left = side.length_m - width - 2 * edge
    if room_left <= 0:
        return edge
    near = min(between(rng, (0.03, 0.35)), room_left)
    where = rng.random()
    if where < 0.35:
        return edge + near
    return edge + (room_left - near if where < 0.7 else float(rng.random()) * room_left)


def _closed_door(board: _Board, look: DoorLook, wall_m: float, rng: np.random.Generator) -> None:
    width, height = between(rng, (0.68, 0.92)), between(rng, (1.96, 2.1))
    height = min(height, board.room.height_m - 0.2)
    sides, weights = _sides_by_length(board.room, width + 0.3)
    for _ in range(_TRIES if sides else 0):
        i = int(rng.choice(sides, p=weights))
        start = _along(board.room.sides[i], width, look.architrave_m + 0.03, rng)
        make = replace(look, hinge_right=bool(rng.random() < 0.5), swings_in=bool(rng.random() < 0.6))
        depth = float(min(wall_m, 0.07 if make.swings_in else 0.16) - 0.004)
        door = Door(i, (start, start + width, 0.0, height), depth, make)
        if board.fits(door, behind_m=depth + 0.02, front_m=door.keep_clear_m):
            board.holes.append(door)
            return


def _through(
    board: _Board, look: DoorLook, wall_m: float, rng: np.random.Generator, *, passage: bool
) -> tuple[Envelope, tuple[AnyHole, ...]] | None:
    """An open door or a passage, and the second room behind it; None where there is no place for one."""
    double = rng.random() < 0.2
    if passage:
        width, height = between(rng, (0.85, 1.9)), between(rng, (2.0, 2.5))
    else:
        width, height = between(rng, (1.3, 1.7) if double else (0.7, 0.95)), between(rng, (1.96, 2.12))
    height = min(height, board.room.height_m - 0.2)
    sides, weights = _sides_by_length(board.room, width + 0.3)
    for _ in range(2 * _TRIES if sides else 0):
        i = int(rng.choice(sides, p=weights))
        side = board.room.sides[i]
        start = _along(side, width, look.architrave_m + 0.03, rng)
        rect = (start, start + width, 0.0, height)
        if passage:
            arch = float(rng.choice([0.0, between(rng, (0.1, 0.35))], p=[0.65, 0.35]))
            hole: Door | Passage = Passage(i, rect, wall_m, min(arch, width / 2), bool(rng.random() < 0.5))
        else:
            inward = bool(rng.random() < 0.5)
            make = replace(
                look,
                leaves=2 if double else 1,
                hinge_right=bool(rng.random() < 0.5),
                swings_in=inward,
                open_degrees=between(rng, (35.0, 92.0) if inward else (60.0, 105.0)),
            )
            leaf = width / make.leaves
            hole = Door(i, rect, wall_m, make, through=True, keep_clear_m=leaf + 0.05 if inward else 0.6)
        if not board.fits(hole, behind_m=wall_m + 1.0, front_m=hole.keep_clear_m):
            continue
        corners = _second_corners(board, side, hole, rng)
        if corners is None:
            continue
        board.holes.append(hole)
        board.outside.append(corners)
        if isinstance(hole, Door) and hole.look.swings_in:
            board.swings.append(side.footprint(start, start + width, -hole.keep_clear_m, -0.001))
        tall = max(height + 0.15, between(rng, (2.35, 2.9)))
        second = envelope(corners, tall, ())
        return second, _second_holes(second, look, rng)
    return None


def _second_corners(board: _Board, side: Side, hole: AnyHole, rng: np.random.Generator) -> list[Point] | None:
    """Plan of the second room: a corridor along the wall or a small room, its near wall `depth_m` behind the side."""
    s0, s1 = hole.rect[:2]
    for _ in range(6):
        corridor = rng.random() < 0.5
        deep = between(rng, (1.1, 1.7) if corridor else (2.0, 3.8))
        left, right = between(rng, (0.15, 2.4)), between(rng, (0.15, 2.4))
        low = min(max(s0 - left, 0.0), s0 - 0.12)
        high = max(min(s1 + right, side.length_m), s1 + 0.12)
        corners = side.footprint(low, high, hole.depth_m, hole.depth_m + deep)
        if board.free_outside(side.footprint(low - 0.02, high + 0.02, hole.depth_m, hole.depth_m + deep + 0.02)):
            return corners
    return None


def _second_holes(second: Envelope, look: DoorLook, rng: np.random.Generator) -> tuple[AnyHole, ...]:
    """A shut door on the wall one looks at, half the time."""
    far = second.sides[1]
    width, height = 0.8, min(2.02, second.height_m - 0.2)
    free = far.length_m - width - 2 * look.architrave_m - 0.1
    if free < 0 or rng.random() < 0.5:
        return ()
    start = look.architrave_m + 0.05 + float(rng.random()) * free
    return (Door(1, (start, start + width, 0.0, height), 0.06, replace(look, hinge_right=bool(rng.random() < 0.5))),)


def _windows(board: _Board, taste: WindowTaste, count: int, rng: np.random.Generator) -> None:
    """On one wall or two: evenly over each, else wherever there is place."""
    sides, weights = _sides_by_length(board.room, 0.75)
    if not sides or not count:
        return
    # Bays are made for windows: one in each of their sides.
    bays = _bay_sides(board.room)
    for i in bays:
        count -= _row(board, i, 1, replace(taste, cover=Cover("none")) if taste.cover.curtains else taste, rng)
    order = [int(i) for i in rng.choice(sides, size=len(sides), replace=False, p=weights) if i not in bays]
    split = count if taste.in_a_row or rng.random() < 0.55 else (count + 1) // 2
    left = count
    for i in order if left > 0 else []:
        here = min(split if left == count else left, left)
        left -= _row(board, i, here, taste, rng)
        if left <= 0:
            return


def _bay_sides(room: Envelope) -> list[int]:
    """Sides at an angle to the others, and one between two of them."""
    count = len(room.sides)
    oblique = [min(abs(side.plane.u[0]), abs(side.plane.u[2])) > 1e-6 for side in room.sides]
    return [i for i in range(count) if oblique[i] or (oblique[i - 1] and oblique[(i + 1) % count])]


def _row(board: _Board, i: int, count: int, taste: WindowTaste, rng: np.random.Generator) -> int:
    """Windows spread over a wall, what its doors leave of it; returns how many found a place."""
    side = board.room.sides[i]
    placed = 0
    low, high = _widest_free(board, i)
    for n in range(count, 0, -1):
        cell = (high - low) / n
        if cell < taste.least_cell_m and n > 1:
            continue
        width = min(taste.width_m, cell - taste.pier_m)
        jitter = float(rng.uniform(-0.5, 0.5)) * max(cell - width - taste.pier_m, 0.0) * (n == 1)
        for k in range(n):
            middle = low + (k + 0.5) * cell + jitter
            window = taste.window(i, middle - width / 2, middle + width / 2)
            if window is not None and board.fits(window, behind_m=window.depth_m + VIEW_M, front_m=0.1):
                board.holes.append(window)
                placed += 1
        if placed:
            return placed
    for _ in range(4):
        width = between(rng, (min(0.6, taste.width_m), taste.width_m))
        start = between(rng, (0.0, max(side.length_m - width, 0.01)))
        window = taste.window(i, start, start + width)
        if window is not None and board.fits(window, behind_m=window.depth_m + VIEW_M, front_m=0.1):
            board.holes.append(window)
            return 1
    return 0


def _widest_free(board: _Board, i: int) -> tuple[float, float]:
    """The longest stretch of a side that no hole has taken."""
    side = board.room.sides[i]
    taken = sorted(edge_m(hole) for hole in board.holes if hole.side == i)
    stops = [0.0, *(stop for span in taken for stop in span), side.length_m]
    spans = list(zip(stops[::2], stops[1::2], strict=True))
    return max(spans, key=lambda span: span[1] - span[0])


def _skylights(
    room: Envelope, style: ShellStyle, taste: WindowTaste, count: int, rng: np.random.Generator
) -> list[Window]:
    """Up to two a slope, side by side at one height."""
    found: list[Window] = []
    for k, slope in enumerate(room.slopes):
        wanted = int(rng.integers(1, 3))
        wide, tall = between(rng, (0.55, 1.1)), min(between(rng, (0.8, 1.4)), slope.rise_m - 0.35)
        if tall < 0.45 or (k > 0 and rng.random() < 0.35):
            continue
        low = between(rng, (0.15, max(slope.rise_m - tall - 0.15, 0.16)))
        cell = slope.length_m / wanted
        for n in range(wanted):
            start = n * cell + between(rng, (0.2, max(cell - wide - 0.2, 0.21)))
            window = taste.skylight(k, (start, start + wide, low, low + tall), max(style.wall_m[0], 0.16))
            if start + wide < slope.length_m - 0.15 and _on_slope(room, k, window):
                found.append(window)
    return found[: max(count, 1)] if style.windows[1] else []


def _on_slope(room: Envelope, k: int, window: Window) -> bool:
    """Whether the hole lies on the slope's part that is ceiling, with a hand's breadth around it."""
    plane = room.slopes[k].plane
    s0, s1, h0, h1 = window.rect
    corners = [plane.at(s, h) for s in (s0 - 0.1, s1 + 0.1) for h in (h0 - 0.1, h1 + 0.1)]
    ground = [(float(p[0]), float(p[2])) for p in (corners[0], corners[2], corners[3], corners[1])]
    if area(ground) < 0:
        ground.reverse()
    inside = sum(area(piece) for triangle in triangles(room.corners) if (piece := within(ground, triangle)))
    lowest = all(float(p[1]) < room.ceiling_at(float(p[0]), float(p[2])) + 1e-6 for p in corners)
    return lowest and inside > area(ground) - 1e-6


def _niche(board: _Board, wall_m: float, rng: np.random.Generator) -> None:
    width, low = between(rng, (0.4, 1.1)), between(rng, (0.6, 1.1))
    high = low + between(rng, (0.5, 1.1))
    depth = between(rng, (0.1, 0.25))
    shelves = tuple(float(h) for h in np.linspace(low, high, int(rng.integers(1, 4)) + 1)[1:-1])
    sides, weights = _sides_by_length(board.room, width + 0.4)
    for _ in range(_TRIES if sides else 0):
        i = int(rng.choice(sides, p=weights))
        start = 0.1 + float(rng.random()) * (board.room.sides[i].length_m - width - 0.2)
        niche = Niche(i, (start, start + width, low, high), depth, shelves)
        if board.fits(niche, behind_m=max(depth, wall_m) + 0.02, front_m=0.3):
            board.holes.append(niche)
            return
