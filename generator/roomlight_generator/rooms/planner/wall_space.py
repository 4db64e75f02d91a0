"""Room along the walls: where on which wall something of a size may stand or hang with its back to it.

`along` is the distance from a wall's left end (seen from inside) to the middle of the thing, metres.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.plan import Wall
from roomlight_generator.rooms.planner.arrangement import SILL_M, STANDING, Layer, Layout, Piece
from roomlight_generator.rooms.planner.body import Body

Where = Literal["any", "corner", "middle"]

CORNER_M = 0.03
"""Left between a thing and its neighbour or the end of the wall."""


@dataclass(frozen=True)
class Stretch:
    """A free part of a wall, from start_m to end_m along it."""

    wall: int
    start_m: float
    end_m: float

    @property
    def length_m(self) -> float:
        """How long."""
        return self.end_m - self.start_m


def stretches(
    layout: Layout,
    depth: float,
    *,
    low: float,
    high: float,
    layer: Layer = "floor",
    walls: Iterable[int] | None = None,
    lower_walls: bool = False,
) -> list[Stretch]:
    """The parts of the walls before which a layer of that depth, from low to high, is free.

    Turned neighbours count with their bounding box in the wall's frame, so that a stretch is free all over. Walls that
    end below `high` under a slanted ceiling count only with lower_walls.
    """
    found: list[Stretch] = []
    everything = [
        *layout.fixed,
        *(piece.body for piece in layout.pieces if piece.layer != "flat"),
        *(zone.body for zone in layout.zones if layer in zone.bars),
    ]
    bodies = [body for body in everything if body.low < high and low < body.high]
    for index in range(len(layout.shell.walls)) if walls is None else walls:
        wall = layout.shell.walls[index]
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
                found.append(Stretch(index, at, min(first, length)))
            at = max(at, last)
        if length - at > 0.05:
            found.append(Stretch(index, at, length))
    return [one for one in found if one.length_m > 0.05]


def under_slope_m(layout: Layout, wall: Wall, height: float) -> float | None:
    """How far from the wall the ceiling is high enough, 0 where the wall itself is; None where not near enough.

    Low things stand up to 0.6 m away from it, high ones 0.3 m: more would leave a room behind them.
    """
    if wall.height_m >= height:
        return 0.0
    if not layout.shell.slopes:
        return None
    for step in range(1, 13 if height < 1.3 else 7):
        away = 0.05 * step
        heights = [layout.shell.ceiling_at(*(float(part) for part in wall.at(wall.length_m * share, away)))
                   for share in (0.2, 0.5, 0.8)]  # fmt: skip
        if min(heights) > height + 0.02:
            return away
    return None


def at_wall(wall: Wall, along: float, depth: float, away: float) -> tuple[float, float]:
    """Where the middle of something of that depth is, its back so far away from the wall."""
    x, z = wall.at(along, away + depth / 2)
    return float(x), float(z)


def places(layout: Layout, found: Sequence[Stretch], width: float, where: Where = "any") -> list[tuple[int, float]]:
    """(wall, along) for a thing of that width in those stretches, in the order to try them."""
    room = [one for one in found if one.length_m >= width + 0.01]
    corners: list[tuple[int, float]] = []
    others: list[tuple[int, float]] = []
    for one in room:
        length = layout.shell.walls[one.wall].length_m
        slack = one.length_m - width
        gap = min(layout.between(0.01, CORNER_M + 0.03), slack / 2)
        left, right = one.start_m + gap + width / 2, one.end_m - gap - width / 2
        (corners if one.start_m < 0.01 else others).append((one.wall, left))
        (corners if one.end_m > length - 0.01 else others).append((one.wall, right))
        others.append((one.wall, layout.between(left, right)))
        if where != "corner":
            middle = [(one.wall, (left + right) / 2)] * 2
            others.extend(middle)
    if where == "corner":
        return layout.shuffled(corners) + layout.shuffled(others)
    if where == "middle":
        central = [(one.wall, (one.start_m + one.end_m) / 2) for one in room]
        # Long free walls first, with chance in it.
        keys = [one.length_m * layout.between(0.5, 1.5) for one in room]
        order = sorted(range(len(room)), key=lambda place: -keys[place])
        return [central[place] for place in order] + layout.shuffled(others)
    return layout.shuffled(corners + others)


def stand(
    layout: Layout,
    model: FurnitureModel | None,
    *,
    where: Where = "any",
    clear_m: float = 0.0,
    walls: Iterable[int] | None = None,
    accept: Callable[[int, float], bool] | None = None,
    tries: int = 8,
) -> Piece | None:
    """Stands a model with its back to a wall, 1 to 5 cm from it, and keeps clear_m of floor free before it."""
    if model is None:
        return None
    away = layout.between(0.01, 0.05)
    turn = layout.wobble(0.7) if layout.chance(0.5) else 0.0
    lower = layout.chance(0.7)
    depth = model.depth_m + away
    lowest, highest = float(model.elevation_m), float(model.elevation_m + model.height_m)
    found = stretches(layout, depth, low=0.0, high=highest, walls=walls, lower_walls=lower)
    tried = 0
    for index, along in places(layout, found, model.width_m, where):
        if accept is not None and not accept(index, along):
            continue
        tried += 1
        if tried > tries:
            break
        wall = layout.shell.walls[index]
        inset = under_slope_m(layout, wall, highest)
        if inset is None:
            continue
        # A slight turn moves the back's corners toward the wall.
        back_off = abs(turn) * 0.0175 * model.width_m / 2
        x, z = at_wall(wall, along, model.depth_m, away + inset + back_off)
        mark = layout.mark()
        piece = layout.put(model, x, z, wall.facing_degrees() + turn, y=lowest)
        if piece is None:
            continue
        if clear_m > 0 and not layout.keep_free(before(piece, clear_m), STANDING):
            layout.back_to(mark)
            continue
        return piece
    return None


def before(piece: Piece, depth: float, *, shrink: float = 0.04) -> Body:
    """The floor before a piece, to that depth, a little narrower than it."""
    body = piece.body
    x, z = body.out(0.0, body.half_depth + depth / 2 + 0.005)
    width = max(2 * body.half_width - shrink, 0.1)
    return Body.of(x, z, piece.degrees, width=width, depth=depth, low=0.0, high=1.9)


def across(layout: Layout, wall: Wall, along: float) -> tuple[float, bool]:
    """How deep the room is from that point of a wall, and whether a parallel wall stands at the far end."""
    x, z = (float(part) for part in wall.at(along, 0.01))
    nx, nz = float(wall.inward[0]), float(wall.inward[1])
    best, parallel = 99.0, False
    for (x0, z0, x1, z1), other in zip(layout.outline, layout.shell.walls, strict=True):
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
