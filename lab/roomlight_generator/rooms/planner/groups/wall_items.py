"""Wall items: pictures alone and in rows, mirrors, clocks, shelves, lamps; and radiators below windows."""

from collections.abc import Callable, Iterable
from typing import Final

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.planner.arrangement import FLOOR_AND_WALL, Arrangement, Piece, Zone
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.wall_space import free_wall_spans, wall_point, wall_positions

CLEAR_DEPTH_M: Final = 0.35
"""Free depth kept in front of a wall item at its own height."""

CENTRE_HEIGHT_M: Final[dict[str, tuple[float, float]]] = {
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
"""Range of heights of their centres over the floor, by role."""

GAP_ABOVE_M: Final = 0.12
"""Distance above the furniture below."""


def hang_wall_items(arrangement: Arrangement, wanted: Iterable[tuple[str, float]]) -> None:
    """Hang items of each role, about the mean number that `wanted` gives for the role."""
    for role, mean in wanted:
        number = arrangement.poisson(mean * (0.5 + arrangement.clutter))
        if role == "mirror":
            number -= _hang_above(arrangement, "mirror", ("washbasin", "sideboard", "dresser"))
        if role == "picture" and number >= 2 and arrangement.chance(0.5):
            number -= _hang_row(arrangement, min(number, 4))
        if role == "picture" and number > 0 and arrangement.chance(0.6):
            number -= _hang_above(arrangement, "picture", ("sofa", "bed", "sideboard", "bench", "piano"))
        for _ in range(number):
            _hang_on_free_wall(arrangement, role)


def _choose_bottom_m(
    arrangement: Arrangement, model: FurnitureModel, ceiling: float, floor: float = 0.0
) -> float | None:
    """Return the height of an item's bottom, above `floor` (what stands below); None if it does not fit."""
    if model.role == "air_conditioner":
        y = ceiling - model.height_m - arrangement.uniform(0.08, 0.3)
    else:
        y = arrangement.uniform(*CENTRE_HEIGHT_M.get(model.role, (1.3, 1.6))) - model.height_m / 2
    y = max(y, floor + (GAP_ABOVE_M if floor > 0 else 0.3))
    y = min(y, ceiling - 0.08 - model.height_m)
    return y if y >= floor + (0.05 if floor > 0 else 0.25) else None


def _hang(arrangement: Arrangement, model: FurnitureModel, index: int, along: float, y: float) -> Piece | None:
    """Hang a model on the wall if the space in front of it is free, and reserve that space."""
    wall = arrangement.shell.walls[index]
    away = arrangement.uniform(0.002, 0.008)
    deep = max(model.depth_m + away, CLEAR_DEPTH_M)
    x, z = wall_point(wall, along, deep, 0.002)
    yaw = wall.facing_degrees()
    clear_space = Body.of(x, z, yaw, width=model.width_m + 0.06, depth=deep, low=y, high=y + model.height_m)
    if not arrangement.fits(clear_space, "wall"):
        return None
    piece = arrangement.place(model, *wall_point(wall, along, model.depth_m, away), yaw, y=y, layer="wall")
    if piece is not None:
        arrangement.zones.append(Zone(clear_space, FLOOR_AND_WALL))
    return piece


def _hang_on_free_wall(arrangement: Arrangement, role: str) -> None:
    widest = 0.6 * max(wall.length_m for wall in arrangement.shell.walls)
    model = arrangement.pick(role, width=(0.05, widest), depth=(0.0, 0.45))
    y = None if model is None else _choose_bottom_m(arrangement, model, arrangement.shell.height_m)
    if model is None or y is None:
        return
    spans = free_wall_spans(arrangement, CLEAR_DEPTH_M, low=y, high=y + model.height_m, layer="wall")
    where = "middle" if arrangement.chance(0.5) else "any"
    for index, along in wall_positions(arrangement, spans, model.width_m + 0.12, where)[:5]:
        if _hang(arrangement, model, index, along, y) is not None:
            return


def _wall_behind(arrangement: Arrangement, piece: Piece) -> tuple[int, float] | None:
    """Return the wall behind a piece and the position along it."""
    back_x, back_z = piece.body.to_plan(0.0, -piece.body.half_depth)
    for index, wall in enumerate(arrangement.shell.walls):
        away = float((back_x - wall.start[0]) * wall.inward[0] + (back_z - wall.start[1]) * wall.inward[1])
        yaw = (piece.degrees - wall.facing_degrees() + 180) % 360 - 180
        if abs(away) < 0.2 and abs(yaw) < 12:
            direction = (wall.end - wall.start) / wall.length_m
            along = float((back_x - wall.start[0]) * direction[0] + (back_z - wall.start[1]) * direction[1])
            if 0 < along < wall.length_m:
                return index, along
    return None


def _hang_above(arrangement: Arrangement, role: str, below: tuple[str, ...]) -> int:
    """Hang an item above some of the given pieces; return the number of items."""
    done = 0
    for piece in arrangement.shuffled(arrangement.with_roles(*below))[:2]:
        place = _wall_behind(arrangement, piece)
        if place is None:
            continue
        model = arrangement.pick(role, width=(0.2, max(piece.model.width_m * 1.1, 0.4)), depth=(0.0, 0.3))
        if model is None:
            return done
        index, along = place
        y = _choose_bottom_m(arrangement, model, arrangement.shell.walls[index].height_m, floor=piece.model.height_m)
        if y is not None:
            done += _hang(arrangement, model, index, along + arrangement.uniform(-0.05, 0.05), y) is not None
    return done


def _hang_row(arrangement: Arrangement, number: int) -> int:
    """Hang pictures side by side with their centres on one line; return their number."""
    models = [
        arrangement.pick("picture", width=(0.15, 0.8), height=(0.15, 0.9), depth=(0.0, 0.12)) for _ in range(number)
    ]
    same = arrangement.chance(0.5)
    pictures = [model for model in models if model is not None]
    if same:
        pictures = pictures[:1] * len(pictures)
    if len(pictures) < 2:
        return 0
    gap = arrangement.uniform(0.06, 0.2)
    width = sum(model.width_m for model in pictures) + gap * (len(pictures) - 1)
    middle = arrangement.uniform(1.45, 1.65)
    tallest = max(model.height_m for model in pictures)
    spans = free_wall_spans(
        arrangement, CLEAR_DEPTH_M, low=middle - tallest / 2, high=middle + tallest / 2, layer="wall"
    )
    for index, along in wall_positions(arrangement, spans, width + 0.2, "middle")[:2]:
        cursor, done = along - width / 2, 0
        for model in pictures:
            y = middle - model.height_m / 2
            done += _hang(arrangement, model, index, cursor + model.width_m / 2, y) is not None
            cursor += model.width_m + gap
        return done
    return 0


def lamps_at_bed(arrangement: Arrangement) -> None:
    """Hang a wall lamp above each nightstand."""
    model = arrangement.pick("wall_lamp", width=(0.05, 0.4))
    for piece in arrangement.with_roles("nightstand"):
        place = _wall_behind(arrangement, piece)
        if model is not None and place is not None:
            y = arrangement.uniform(1.25, 1.3)
            _hang(arrangement, model, place[0], place[1], y)


def radiators(arrangement: Arrangement, probability: float) -> None:
    """Place a radiator, with that probability, below each bare window whose sill is high enough."""
    model: FurnitureModel | None = None
    for wall in arrangement.shell.walls:
        for gap in wall.gaps:
            if gap.kind != "window" or gap.covered or gap.bottom_m < 0.4 or not arrangement.chance(probability):
                continue
            widest = min(gap.end_m - gap.start_m + 0.2, 2.0)
            fits = _fits_below(widest, gap.bottom_m - 0.06)
            if model is None or not fits(model):
                model = arrangement.pick("radiator", depth=(0.0, 0.3), also=fits)
            if model is not None:
                x, z = wall_point(wall, (gap.start_m + gap.end_m) / 2, model.depth_m, arrangement.uniform(0.02, 0.045))
                arrangement.place(model, x, z, wall.facing_degrees(), y=max(float(model.elevation_m), 0.0))


def _fits_below(width: float, top: float) -> Callable[[FurnitureModel], bool]:
    return lambda model: model.width_m <= width and model.elevation_m + model.height_m <= top
