"""Free space along walls: positions where an object of a given size can stand or hang with its back to a wall.

`along` is the distance from a wall's left end (seen from inside) to the centre of the object, metres.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.plan import Wall
from roomlight_generator.rooms.planner.arrangement import SILL_M, Arrangement, Layer, Piece
from roomlight_generator.rooms.planner.body import Body

WallPreference = Literal["any", "corner", "middle"]

CORNER_M = 0.03
"""Distance between an object and its neighbour or the end of the wall."""


@dataclass(frozen=True)
class WallSpan:
    """A free part of a wall, from start_m to end_m along it."""

    wall: int
    start_m: float
    end_m: float

    @property
    def length_m(self) -> float:
        """Length of the span."""
        return self.end_m - self.start_m


def free_wall_spans(
    arrangement: Arrangement,
    depth: float,
    *,
    low: float,
    high: float,
    layer: Layer = "floor",
    walls: Iterable[int] | None = None,
    lower_walls: bool = False,
) -> list[WallSpan]:
    """Return the parts of the walls in front of which a box is free.

    Rotated neighbours count with their bounding box in the wall's frame, so that a span is free over its whole depth.

    Args:
        depth, low, high: Depth of the box, heights of its bottom and top, metres.
        walls: Indices of the walls; None: all walls.
        lower_walls: Include walls that end below `high` under a slanted ceiling.
    """
    spans: list[WallSpan] = []
    everything = [
        *arrangement.fixed,
        *(piece.body for piece in arrangement.pieces if piece.layer != "flat"),
        *(zone.body for zone in arrangement.zones if layer in zone.excluded_layers),
    ]
    bodies = [body for body in everything if body.low < high and low < body.high]
    for index in range(len(arrangement.shell.walls)) if walls is None else walls:
        wall = arrangement.shell.walls[index]
        if wall.height_m < high and not lower_walls:
            continue
        taken = [(gap.start_m, gap.end_m) for gap in wall.gaps if gap.bottom_m - SILL_M < high and low < gap.top_m]
        start, length = wall.start, wall.length_m
        dx, dz = (float(part) for part in (wall.end - start) / length)
        nx, nz = float(wall.inward[0]), float(wall.inward[1])
        sx, sz = float(start[0]), float(start[1])
        for body in bodies:
            away = (body.x - sx) * nx + (body.z - sz) * nz
            if abs(away - depth / 2) > body.reach + depth / 2:
                continue
            corners = [((x - sx) * nx + (z - sz) * nz, (x - sx) * dx + (z - sz) * dz) for x, z in body.corners()]
            if min(corners)[0] < depth - 0.001 and max(corners)[0] > 0.001:
                along = [place for _, place in corners]
                taken.append((min(along), max(along)))
        at = 0.0
        for first, last in sorted(taken):
            if first - at > 0.05:
                spans.append(WallSpan(index, at, min(first, length)))
            at = max(at, last)
        if length - at > 0.05:
            spans.append(WallSpan(index, at, length))
    return [span for span in spans if span.length_m > 0.05]


def slope_inset_m(arrangement: Arrangement, wall: Wall, height: float) -> float | None:
    """Return the distance from the wall at which the ceiling is high enough, 0 at a high wall; None if it is too far.

    Low objects stand up to 0.6 m from the wall, high objects 0.3 m: more would leave a usable space behind them.
    """
    if wall.height_m >= height:
        return 0.0
    if not arrangement.shell.slopes:
        return None
    for step in range(1, 13 if height < 1.3 else 7):
        away = 0.05 * step
        heights = [arrangement.shell.ceiling_at(*wall.at(wall.length_m * share, away)) for share in (0.2, 0.5, 0.8)]
        if min(heights) > height + 0.02:
            return away
    return None


def wall_point(wall: Wall, along: float, depth: float, away: float) -> tuple[float, float]:
    """Return the centre of an object of that depth whose back is `away` metres from the wall."""
    return wall.at(along, away + depth / 2)


def wall_positions(
    arrangement: Arrangement, spans: Sequence[WallSpan], width: float, where: WallPreference = "any"
) -> list[tuple[int, float]]:
    """Return candidate positions (wall, along) for an object of that width in those spans, in the order to try them."""
    room = [span for span in spans if span.length_m >= width + 0.01]
    corners: list[tuple[int, float]] = []
    others: list[tuple[int, float]] = []
    for span in room:
        length = arrangement.shell.walls[span.wall].length_m
        slack = span.length_m - width
        gap = min(arrangement.uniform(0.01, CORNER_M + 0.03), slack / 2)
        left, right = span.start_m + gap + width / 2, span.end_m - gap - width / 2
        (corners if span.start_m < 0.01 else others).append((span.wall, left))
        (corners if span.end_m > length - 0.01 else others).append((span.wall, right))
        others.append((span.wall, arrangement.uniform(left, right)))
        if where != "corner":
            middle = [(span.wall, (left + right) / 2)] * 2
            others.extend(middle)
    if where == "corner":
        return arrangement.shuffled(corners) + arrangement.shuffled(others)
    if where == "middle":
        central = [(span.wall, (span.start_m + span.end_m) / 2) for span in room]
        # Long free walls come first, with random variation.
        keys = [span.length_m * arrangement.uniform(0.5, 1.5) for span in room]
        order = sorted(range(len(room)), key=lambda place: -keys[place])
        return [central[place] for place in order] + arrangement.shuffled(others)
    return arrangement.shuffled(corners + others)


def place_at_wall(
    arrangement: Arrangement,
    model: FurnitureModel | None,
    *,
    where: WallPreference = "any",
    clear_m: float = 0.0,
    tries: int = 8,
) -> Piece | None:
    """Place a model with its back to a wall, 1 to 5 cm from it; None without a model or a place.

    `clear_m` is the depth of floor in front of the model to reserve.
    """
    if model is None:
        return None
    away = arrangement.uniform(0.01, 0.05)
    yaw = arrangement.jitter(0.7) if arrangement.chance(0.5) else 0.0
    lower = arrangement.chance(0.7)
    depth = model.depth_m + away
    lowest, highest = float(model.elevation_m), float(model.elevation_m + model.height_m)
    spans = free_wall_spans(arrangement, depth, low=0.0, high=highest, lower_walls=lower)
    for index, along in wall_positions(arrangement, spans, model.width_m, where)[:tries]:
        wall = arrangement.shell.walls[index]
        inset = slope_inset_m(arrangement, wall, highest)
        if inset is None:
            continue
        # A slight rotation moves the back's corners toward the wall.
        back_off = abs(yaw) * 0.0175 * model.width_m / 2
        x, z = wall_point(wall, along, model.depth_m, away + inset + back_off)
        piece = place_with_floor(arrangement, model, x, z, wall.facing_degrees() + yaw, clear_m, y=lowest)
        if piece is not None:
            return piece
    return None


def place_with_floor(
    arrangement: Arrangement,
    model: FurnitureModel,
    x: float,
    z: float,
    degrees: float,
    clear_m: float,
    *,
    y: float = 0.0,
) -> Piece | None:
    """Place a model and reserve the floor in front of it, to that depth; None if the one or the other does not fit."""
    snapshot = arrangement.snapshot()
    piece = arrangement.place(model, x, z, degrees, y=y)
    if piece is not None and clear_m > 0 and not arrangement.reserve(floor_in_front(piece, clear_m)):
        arrangement.restore(snapshot)
        return None
    return piece


def floor_in_front(piece: Piece, depth: float, *, shrink: float = 0.04) -> Body:
    """Return the floor in front of a piece, to that depth, slightly narrower than it."""
    body = piece.body
    x, z = body.to_plan(0.0, body.half_depth + depth / 2 + 0.005)
    width = max(2 * body.half_width - shrink, 0.1)
    return Body.of(x, z, piece.degrees, width=width, depth=depth, low=0.0, high=1.9)


def depth_at_wall(arrangement: Arrangement, wall: Wall, along: float) -> tuple[float, bool]:
    """Return the depth of the room from that point of a wall, and whether the wall at the far end is parallel."""
    x, z = wall.at(along, 0.01)
    nx, nz = float(wall.inward[0]), float(wall.inward[1])
    best, parallel = 99.0, False
    for (x0, z0, x1, z1), other in zip(arrangement.outline, arrangement.shell.walls, strict=True):
        ex, ez = x1 - x0, z1 - z0
        det = nz * ex - nx * ez
        if abs(det) < 1e-9:
            continue
        t = (ex * (z0 - z) - ez * (x0 - x)) / det
        s = (nx * (z0 - z) - nz * (x0 - x)) / det
        if 0 <= s <= 1 and 0 < t < best:
            facing = float(other.inward[0]) * nx + float(other.inward[1]) * nz
            best, parallel = t, facing < -0.999
    return best + 0.01, parallel
