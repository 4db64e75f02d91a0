"""What hangs on the walls: pictures alone and in rows, mirrors, clocks, shelves, lamps; and radiators below windows."""

from collections.abc import Callable, Iterable
from typing import Final

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.planner.arrangement import LEANING, Layout, Piece, Zone
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.wall_space import at_wall, places, stretches

SEEN_M: Final = 0.35
"""Before a thing on a wall nothing stands nearer than this at its own height."""

MIDDLE_M: Final[dict[str, tuple[float, float]]] = {
    "picture": (1.42, 1.68),
    "mirror": (1.42, 1.62),
    "clock": (1.75, 2.1),
    "wall_shelf": (1.2, 1.75),
    "wall_lamp": (1.55, 1.9),
    "wall_television": (1.2, 1.45),
    "towel_rack": (1.0, 1.35),
    "whiteboard": (1.35, 1.55),
    "wall_clutter": (1.35, 1.75),
    "wall_unit": (1.6, 1.8),
}
"""Heights of their middles over the floor."""

OVER_M: Final = 0.12
"""Above furniture that they hang over."""


def hang_all(layout: Layout, wanted: Iterable[tuple[str, float]]) -> None:
    """Hangs about that many of each role."""
    for role, mean in wanted:
        number = layout.count(mean * (0.5 + layout.clutter))
        if role == "mirror":
            number -= _over(layout, "mirror", ("washbasin", "sideboard", "dresser"))
        if role == "picture" and number >= 2 and layout.chance(0.5):
            number -= _row(layout, min(number, 4))
        if role == "picture" and number > 0 and layout.chance(0.6):
            number -= _over(layout, "picture", ("sofa", "bed", "sideboard", "bench", "piano"))
        for _ in range(number):
            _hang_somewhere(layout, role)


def _height(layout: Layout, model: FurnitureModel, ceiling: float, floor: float = 0.0) -> float | None:
    """The height of its bottom, over whatever stands below (floor), under the ceiling; None where it does not go."""
    if model.role == "air_conditioner":
        y = ceiling - model.height_m - layout.between(0.08, 0.3)
    else:
        y = layout.between(*MIDDLE_M.get(model.role, (1.3, 1.6))) - model.height_m / 2
    y = max(y, floor + (OVER_M if floor > 0 else 0.3))
    y = min(y, ceiling - 0.08 - model.height_m)
    return y if y >= floor + (0.05 if floor > 0 else 0.25) else None


def _put(layout: Layout, model: FurnitureModel, index: int, along: float, y: float) -> Piece | None:
    """On the wall, if nothing stands close before it; keeps it that way."""
    wall = layout.shell.walls[index]
    away = layout.between(0.002, 0.008)
    deep = max(model.depth_m + away, SEEN_M)
    x, z = at_wall(wall, along, deep, 0.002)
    turn = wall.facing_degrees()
    seen = Body.of(x, z, turn, width=model.width_m + 0.06, depth=deep, low=y, high=y + model.height_m)
    if not layout.admits(seen, "wall"):
        return None
    piece = layout.put(model, *at_wall(wall, along, model.depth_m, away), turn, y=y, layer="wall")
    if piece is not None:
        layout.zones.append(Zone(seen, LEANING))
    return piece


def _hang_somewhere(layout: Layout, role: str) -> Piece | None:
    widest = 0.6 * max(wall.length_m for wall in layout.shell.walls)
    model = layout.pick(role, width=(0.05, widest), depth=(0.0, 0.45))
    if model is None:
        return None
    y = _height(layout, model, layout.shell.height_m)
    if y is None:
        return None
    found = stretches(layout, SEEN_M, low=y, high=y + model.height_m, layer="wall")
    where = "middle" if layout.chance(0.5) else "any"
    for index, along in places(layout, found, model.width_m + 0.12, where)[:5]:
        piece = _put(layout, model, index, along, y)
        if piece is not None:
            return piece
    return None


def _wall_behind(layout: Layout, piece: Piece) -> tuple[int, float] | None:
    """The wall that a piece stands with its back to, and where along it."""
    back_x, back_z = piece.body.out(0.0, -piece.body.half_depth)
    for index, wall in enumerate(layout.shell.walls):
        away = float((back_x - wall.start[0]) * wall.inward[0] + (back_z - wall.start[1]) * wall.inward[1])
        turn = (piece.degrees - wall.facing_degrees() + 180) % 360 - 180
        if abs(away) < 0.2 and abs(turn) < 12:
            direction = (wall.end - wall.start) / wall.length_m
            along = float((back_x - wall.start[0]) * direction[0] + (back_z - wall.start[1]) * direction[1])
            if 0 < along < wall.length_m:
                return index, along
    return None


def _over(layout: Layout, role: str, below: tuple[str, ...]) -> int:
    """One above each of some of the pieces below; how many."""
    done = 0
    for piece in layout.shuffled(layout.having(*below))[:2]:
        place = _wall_behind(layout, piece)
        if place is None:
            continue
        model = layout.pick(role, width=(0.2, max(piece.model.width_m * 1.1, 0.4)), depth=(0.0, 0.3))
        if model is None:
            return done
        index, along = place
        y = _height(layout, model, layout.shell.walls[index].height_m, floor=piece.model.height_m)
        if y is not None:
            done += _put(layout, model, index, along + layout.between(-0.05, 0.05), y) is not None
    return done


def _row(layout: Layout, number: int) -> int:
    """Pictures side by side with their middles on one line; how many."""
    models = [layout.pick("picture", width=(0.15, 0.8), height=(0.15, 0.9), depth=(0.0, 0.12)) for _ in range(number)]
    same = layout.chance(0.5)
    pictures = [model for model in models if model is not None]
    if same:
        pictures = pictures[:1] * len(pictures)
    if len(pictures) < 2:
        return 0
    gap = layout.between(0.06, 0.2)
    width = sum(model.width_m for model in pictures) + gap * (len(pictures) - 1)
    middle = layout.between(1.45, 1.65)
    tallest = max(model.height_m for model in pictures)
    found = stretches(layout, SEEN_M, low=middle - tallest / 2, high=middle + tallest / 2, layer="wall")
    for index, along in places(layout, found, width + 0.2, "middle")[:2]:
        cursor, done = along - width / 2, 0
        for model in pictures:
            y = middle - model.height_m / 2
            done += _put(layout, model, index, cursor + model.width_m / 2, y) is not None
            cursor += model.width_m + gap
        return done
    return 0


def lamps_at_bed(layout: Layout) -> None:
    """A wall lamp above each nightstand."""
    model = layout.pick("wall_lamp", width=(0.05, 0.4))
    for piece in layout.having("nightstand"):
        place = _wall_behind(layout, piece)
        if model is not None and place is not None:
            y = layout.between(1.25, 1.3)
            _put(layout, model, place[0], place[1], y)


def radiators(layout: Layout, probability: float) -> None:
    """One below each bare window whose sill is high enough, with that probability."""
    model: FurnitureModel | None = None
    for wall in layout.shell.walls:
        for gap in wall.gaps:
            if gap.kind != "window" or gap.covered or gap.bottom_m < 0.4 or not layout.chance(probability):
                continue
            widest = min(gap.end_m - gap.start_m + 0.2, 2.0)
            fits = _below(widest, gap.bottom_m - 0.06)
            if model is None or not fits(model):
                model = layout.pick("radiator", depth=(0.0, 0.3), also=fits)
            if model is not None:
                x, z = at_wall(wall, (gap.start_m + gap.end_m) / 2, model.depth_m, layout.between(0.02, 0.045))
                layout.put(model, x, z, wall.facing_degrees(), y=max(float(model.elevation_m), 0.0))


def _below(width: float, top: float) -> Callable[[FurnitureModel], bool]:
    return lambda model: model.width_m <= width and model.elevation_m + model.height_m <= top
