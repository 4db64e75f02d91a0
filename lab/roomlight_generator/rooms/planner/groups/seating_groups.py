"""Seating groups: sofa and television, sofa and armchairs, a reading corner."""

from typing import Final

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.planner.arrangement import Arrangement, Layer, Piece, yaw_toward
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.wall_space import (
    depth_at_wall,
    free_wall_spans,
    place_at_wall,
    place_with_floor,
    wall_point,
    wall_positions,
)

VIEWING_DISTANCE_M: Final = (1.8, 4.0)
"""Distance from the television's face to the middle of the sofa."""

MAX_VIEW_OBSTACLE_M: Final = 0.6
"""Maximum height of objects between sofa and television."""

VIEW_BLOCKING_LAYERS: Final[frozenset[Layer]] = frozenset({"floor", "top", "ceiling"})


def tv_lounge(arrangement: Arrangement) -> Piece | None:
    """Place a television at a wall, a sofa opposite, and furniture around the sofa; return the sofa."""
    widest = min(3.2, 0.75 * max(wall.length_m for wall in arrangement.shell.walls))
    if arrangement.area_m2 < 16:
        widest = min(widest, 2.1)
    for _ in range(3):
        sofa = arrangement.pick("sofa", width=(1.0, widest))
        screen = _pick_screen(arrangement)
        if sofa is None or screen is None:
            return None
        stand_model, television = screen
        placed = _place_facing(arrangement, sofa, stand_model, television)
        if placed is not None:
            _furnish_around(arrangement, placed)
            return placed
    return None


def _pick_screen(arrangement: Arrangement) -> tuple[FurnitureModel | None, FurnitureModel] | None:
    """Choose a stand and the television on it, or None and a wall-mounted television."""
    wall_television = arrangement.pick("wall_television", width=(0.5, 1.9))
    if wall_television is not None and arrangement.chance(0.3):
        stand = arrangement.pick("tv_stand", height=(0.0, 0.75)) if arrangement.chance(0.7) else None
        return (stand, wall_television)
    for role in ("tv_stand", "tv_stand", "sideboard", "dresser"):
        stand = arrangement.pick(role, height=(0.2, 1.0), also=lambda model: model.top_m is not None)
        if stand is None:
            continue
        widest, deepest = stand.width_m - 0.04, stand.depth_m - 0.03
        television = arrangement.pick("television", width=(0.35, widest), depth=(0.0, deepest), height=(0.2, 1.1))
        if television is not None:
            return (stand, television)
    return (None, wall_television) if wall_television is not None else None


def _place_facing(
    arrangement: Arrangement, sofa: FurnitureModel, stand: FurnitureModel | None, television: FurnitureModel
) -> Piece | None:
    """Place television and sofa facing each other; return the sofa."""
    bulk = stand if stand is not None else television
    on_wall = television.role == "wall_television"
    top = 1.2 if stand is None else (stand.height_m if on_wall else (stand.top_m or 0.0) + television.height_m)
    width = max(bulk.width_m, television.width_m)
    low = 0.9 if stand is None else 0.0
    spans = free_wall_spans(arrangement, bulk.depth_m + 0.05, low=low, high=top)
    for index, along in wall_positions(arrangement, spans, width, "any")[:14]:
        wall = arrangement.shell.walls[index]
        depth, parallel = depth_at_wall(arrangement, wall, along)
        away = arrangement.uniform(0.015, 0.05)
        face = away + (bulk.depth_m / 2 + television.depth_m / 2 if not on_wall else television.depth_m)
        farthest = depth - 0.03 - sofa.depth_m / 2
        distance = farthest - face
        if not (parallel and distance <= VIEWING_DISTANCE_M[1] and arrangement.chance(0.85)):
            distance = arrangement.uniform(2.1, min(3.6, depth - 0.65 - sofa.depth_m / 2 - face))
        if not VIEWING_DISTANCE_M[0] <= distance <= min(VIEWING_DISTANCE_M[1], farthest - face + 0.001):
            continue
        snapshot = arrangement.snapshot()
        yaw = wall.facing_degrees()
        if not _place_screen(arrangement, stand, television, (index, along), away):
            arrangement.restore(snapshot)
            continue
        x, z = wall.at(along + arrangement.uniform(-0.15, 0.15), face + distance)
        floating = farthest - face - distance > 0.1
        seat = arrangement.place(sofa, x, z, yaw + 180 + (arrangement.jitter(1.5) if floating else 0.0))
        if seat is None or not _reserve_view(arrangement, seat, distance):
            arrangement.restore(snapshot)
            continue
        return seat
    return None


def _place_screen(
    arrangement: Arrangement,
    stand: FurnitureModel | None,
    television: FurnitureModel,
    place: tuple[int, float],
    away: float,
) -> Piece | None:
    index, along = place
    wall = arrangement.shell.walls[index]
    yaw = wall.facing_degrees()
    base: Piece | None = None
    if stand is not None:
        base = arrangement.place(stand, *wall_point(wall, along, stand.depth_m, away), yaw)
        if base is None:
            return None
    if television.role == "wall_television":
        lowest = 0.1 + (stand.height_m if stand is not None else 0.6)
        y = max(lowest, arrangement.uniform(1.05, 1.3) - television.height_m / 2)
        if y + television.height_m > wall.height_m - 0.05:
            return None
        x, z = wall_point(wall, along, television.depth_m, arrangement.uniform(0.005, 0.02))
        return arrangement.place(television, x, z, yaw, y=y, layer="wall")
    if base is None or stand is None or stand.top_m is None:
        return None
    slack = max((stand.width_m - television.width_m) / 2 - 0.02, 0.0)
    x, z = base.body.to_plan(arrangement.uniform(-0.3, 0.3) * slack, 0.0)
    return arrangement.place(
        television, x, z, yaw + arrangement.jitter(1.0), y=stand.top_m, layer="top", ignore=(base.body,)
    )


def _reserve_view(arrangement: Arrangement, seat: Piece, distance: float) -> bool:
    """Reserve the view from the sofa to the television; return False if something blocks it."""
    length = distance - seat.body.half_depth - 0.5
    if length <= 0.1:
        return True
    x, z = seat.body.to_plan(0.0, seat.body.half_depth + length / 2)
    width = min(2 * seat.body.half_width, 1.4)
    view = Body.of(x, z, seat.degrees, width=width, depth=length, low=MAX_VIEW_OBSTACLE_M, high=1.3)
    return arrangement.reserve(view, VIEW_BLOCKING_LAYERS)


def conversation_group(arrangement: Arrangement) -> Piece | None:
    """Place a sofa with its back to a wall, and armchairs opposite; return the sofa."""
    widest = 2.1 if arrangement.area_m2 < 18 else 3.0
    for _ in range(3):
        sofa = arrangement.pick("sofa", width=(1.0, widest))
        seat = place_at_wall(arrangement, sofa, where="middle", clear_m=0.85)
        if seat is None:
            continue
        # The sofa's zone kept its front free while it was being placed; from now on the group may use that space.
        arrangement.zones.pop()
        table = _furnish_around(arrangement, seat)
        anchor = table or seat
        chair = arrangement.pick("armchair", width=(0.4, 1.1))
        if chair is not None:
            for side in arrangement.shuffled((-0.55, 0.55))[: 1 + int(arrangement.chance(0.6))]:
                gap = arrangement.uniform(0.35, 0.6) if table is not None else arrangement.uniform(0.9, 1.4)
                front = anchor.body.half_depth + chair.depth_m / 2 + gap
                x, z = anchor.body.to_plan(side * (1 + 0.2 * chair.width_m), front)
                target = seat.body.to_plan(side * 0.5, 0.0)
                arrangement.place(chair, x, z, yaw_toward(x, z, *target) + arrangement.jitter(7))
        return seat
    return None


def _furnish_around(arrangement: Arrangement, seat: Piece) -> Piece | None:
    """Place coffee table, rug, armchairs at the sides, side tables and a lamp by a sofa; return the coffee table."""
    table = _place_coffee_table(arrangement, seat)
    _place_rug_below(arrangement, seat, table)
    if arrangement.chance(0.6):
        _place_side_seats(arrangement, seat, table)
    for side in arrangement.shuffled((-1, 1)):
        kind = arrangement.rng.random()
        if kind < 0.4:
            model = arrangement.pick("side_table", width=(0.2, 0.7), depth=(0.2, 0.7))
        elif kind < 0.7:
            model = arrangement.pick("floor_lamp", width=(0.1, 0.7), depth=(0.1, 0.9))
        elif kind < 0.8:
            model = arrangement.pick("plant", width=(0.15, 0.8))
        else:
            continue
        _place_next_to(arrangement, seat, model, side)
    return table


def _place_coffee_table(arrangement: Arrangement, seat: Piece) -> Piece | None:
    """Place a coffee table in front of the sofa, its long side along it."""
    if arrangement.chance(0.08):
        return None
    sofa = seat.model
    model = arrangement.pick("coffee_table", width=(0.3, max(sofa.width_m * 0.85, 0.8)), height=(0.15, 0.62))
    if model is None:
        return None
    quarter = 90.0 if model.depth_m > model.width_m * 1.2 else 0.0
    reach = model.width_m / 2 if quarter else model.depth_m / 2
    for gap in (arrangement.uniform(0.3, 0.5), 0.3):
        x, z = seat.body.to_plan(arrangement.uniform(-0.12, 0.12), seat.body.half_depth + gap + reach)
        placed = arrangement.place(model, x, z, seat.degrees + quarter + arrangement.jitter(2.5))
        if placed is not None:
            return placed
    return None


def _place_rug_below(arrangement: Arrangement, seat: Piece, table: Piece | None) -> None:
    if arrangement.chance(0.25):
        return
    sofa = seat.model
    for largest in (3.4, 2.4, 1.7):
        rug = arrangement.pick("rug", width=(0.9, max(largest, sofa.width_m)), depth=(0.7, largest), height=(0.0, 0.05))
        if rug is None:
            continue
        # The long side goes along the sofa.
        quarter = 90.0 if rug.depth_m > rug.width_m * 1.05 else 0.0
        x, z = seat.body.to_plan(arrangement.uniform(-0.1, 0.1), seat.body.half_depth + 0.45)
        if table is not None:
            x, z = (table.body.x + x) / 2, (table.body.z + z) / 2
        if arrangement.place(rug, x, z, seat.degrees + quarter + arrangement.jitter(2.0), layer="flat") is not None:
            return


def _place_side_seats(arrangement: Arrangement, seat: Piece, table: Piece | None) -> None:
    """Place armchairs, or a second sofa, at right angles to the sofa, rotated slightly toward the middle."""
    middle = (table.body.x, table.body.z) if table is not None else seat.body.to_plan(0.0, seat.body.half_depth + 0.7)
    _, front_middle = seat.body.to_local(*middle)
    half_table = table.body.half_width if table is not None else 0.3
    second = arrangement.chance(0.25)
    model = arrangement.pick("sofa", width=(1.0, 2.1), depth=(0.4, 1.0)) if second else arrangement.pick("armchair")
    if model is None:
        return
    for side in arrangement.shuffled((-1, 1))[: 1 if second else 1 + int(arrangement.chance(0.5))]:
        for push in (0.0, 0.25, 0.5):
            right = side * (max(half_table, 0.75 * seat.body.half_width) + 0.35 + push + model.depth_m / 2)
            front = front_middle + (0.1 if second else arrangement.uniform(-0.15, 0.5))
            x, z = seat.body.to_plan(right, front)
            yaw = seat.degrees - 90 * side if second else yaw_toward(x, z, *middle)
            if arrangement.place(model, x, z, yaw + arrangement.jitter(1.0 if second else 8.0)) is not None:
                break


def _place_next_to(arrangement: Arrangement, seat: Piece, model: FurnitureModel | None, side: int) -> Piece | None:
    """Place a model beside a seat, toward its back."""
    if model is None:
        return None
    right = side * (seat.body.half_width + model.width_m / 2 + arrangement.uniform(0.03, 0.12))
    slack = max(seat.body.half_depth - model.depth_m / 2, 0.0)
    x, z = seat.body.to_plan(right, -slack + arrangement.uniform(0.0, 0.15))
    return arrangement.place(model, x, z, seat.degrees + arrangement.jitter(2.0))


def reading_corner(arrangement: Arrangement) -> Piece | None:
    """Place an armchair in a corner, facing the room, with a lamp or a small table."""
    model = arrangement.pick("armchair", width=(0.4, 1.1), depth=(0.4, 1.2))
    if model is None:
        return None
    half = (model.width_m**2 + model.depth_m**2) ** 0.5 / 2
    spans = free_wall_spans(arrangement, 2 * half, low=0.0, high=model.height_m)
    for index, along in wall_positions(arrangement, spans, 2 * half, "corner")[:8]:
        wall = arrangement.shell.walls[index]
        x, z = wall.at(along, half + 0.02)
        middle = arrangement.shell.polygon.mean(0)
        yaw = yaw_toward(x, z, float(middle[0]), float(middle[1]))
        facing = wall.facing_degrees()
        clamped_yaw = facing + min(max((yaw - facing + 180) % 360 - 180, -50.0), 50.0)
        seat = place_with_floor(arrangement, model, x, z, clamped_yaw + arrangement.jitter(6), 0.35)
        if seat is None:
            continue
        side = 1 if arrangement.chance(0.5) else -1
        lamp = arrangement.pick("floor_lamp", width=(0.1, 0.6), depth=(0.1, 0.6))
        if _place_next_to(arrangement, seat, lamp, side) is None:
            _place_next_to(arrangement, seat, lamp, -side)
        if arrangement.chance(0.5):
            _place_next_to(arrangement, seat, arrangement.pick("side_table", width=(0.2, 0.6), depth=(0.2, 0.6)), -side)
        return seat
    return None
