"""Places to sit and look: sofa and television, sofa and armchairs, a reading corner."""

from typing import Final

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.planner.arrangement import Layer, Layout, Piece, turn_toward
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.wall_space import across, at_wall, before, places, stand, stretches

VIEWING_M: Final = (1.8, 4.0)
"""From the television's face to the middle of the sofa."""

VIEW_OVER_M: Final = 0.6
"""Between sofa and television nothing is higher."""

SIGHT: Final[frozenset[Layer]] = frozenset({"floor", "top", "ceiling"})


def tv_lounge(layout: Layout) -> Piece | None:
    """A television by a wall, a sofa opposite, and what belongs between and beside; the sofa, or None."""
    widest = min(3.2, 0.75 * max(wall.length_m for wall in layout.shell.walls))
    if layout.area_m2 < 16:
        widest = min(widest, 2.1)
    for _ in range(3):
        sofa = layout.pick("sofa", width=(1.0, widest))
        screen = _screen(layout)
        if sofa is None or screen is None:
            return None
        stand_model, television = screen
        placed = _face(layout, sofa, stand_model, television)
        if placed is not None:
            _surround(layout, placed)
            return placed
    return None


def _screen(layout: Layout) -> tuple[FurnitureModel | None, FurnitureModel] | None:
    """A stand and the television on it, or None and one for the wall."""
    wall_television = layout.pick("wall_television", width=(0.5, 1.9))
    if wall_television is not None and layout.chance(0.3):
        stand = layout.pick("tv_stand", height=(0.0, 0.75)) if layout.chance(0.7) else None
        return (stand, wall_television)
    for role in ("tv_stand", "tv_stand", "sideboard", "dresser"):
        stand = layout.pick(role, height=(0.2, 1.0), also=lambda model: model.top_m is not None)
        if stand is None:
            continue
        widest, deepest = stand.width_m - 0.04, stand.depth_m - 0.03
        television = layout.pick("television", width=(0.35, widest), depth=(0.0, deepest), height=(0.2, 1.1))
        if television is not None:
            return (stand, television)
    return (None, wall_television) if wall_television is not None else None


def _face(
    layout: Layout, sofa: FurnitureModel, stand: FurnitureModel | None, television: FurnitureModel
) -> Piece | None:
    """Puts television and sofa opposite each other; the sofa."""
    bulk = stand if stand is not None else television
    on_wall = television.role == "wall_television"
    top = 1.2 if stand is None else (stand.height_m if on_wall else (stand.top_m or 0.0) + television.height_m)
    width = max(bulk.width_m, television.width_m)
    low = 0.9 if stand is None else 0.0
    found = stretches(layout, bulk.depth_m + 0.05, low=low, high=top)
    for index, along in places(layout, found, width, "any")[:14]:
        wall = layout.shell.walls[index]
        depth, parallel = across(layout, wall, along)
        away = layout.between(0.015, 0.05)
        face = away + (bulk.depth_m / 2 + television.depth_m / 2 if not on_wall else television.depth_m)
        farthest = depth - 0.03 - sofa.depth_m / 2
        distance = farthest - face
        if not (parallel and distance <= VIEWING_M[1] and layout.chance(0.85)):
            distance = layout.between(2.1, min(3.6, depth - 0.65 - sofa.depth_m / 2 - face))
        if not VIEWING_M[0] <= distance <= min(VIEWING_M[1], farthest - face + 0.001):
            continue
        mark = layout.mark()
        turn = wall.facing_degrees()
        if not _put_screen(layout, stand, television, (index, along), away):
            layout.back_to(mark)
            continue
        x, z = wall.at(along + layout.between(-0.15, 0.15), face + distance)
        floating = farthest - face - distance > 0.1
        seat = layout.put(sofa, float(x), float(z), turn + 180 + (layout.wobble(1.5) if floating else 0.0))
        if seat is None or not _keep_view(layout, seat, distance):
            layout.back_to(mark)
            continue
        return seat
    return None


def _put_screen(
    layout: Layout, stand: FurnitureModel | None, television: FurnitureModel, place: tuple[int, float], away: float
) -> Piece | None:
    index, along = place
    wall = layout.shell.walls[index]
    turn = wall.facing_degrees()
    base: Piece | None = None
    if stand is not None:
        base = layout.put(stand, *at_wall(wall, along, stand.depth_m, away), turn)
        if base is None:
            return None
    if television.role == "wall_television":
        lowest = 0.1 + (stand.height_m if stand is not None else 0.6)
        y = max(lowest, layout.between(1.05, 1.3) - television.height_m / 2)
        if y + television.height_m > wall.height_m - 0.05:
            return None
        x, z = at_wall(wall, along, television.depth_m, layout.between(0.005, 0.02))
        return layout.put(television, x, z, turn, y=y, layer="wall")
    if base is None or stand is None or stand.top_m is None:
        return None
    slack = max((stand.width_m - television.width_m) / 2 - 0.02, 0.0)
    x, z = base.body.out(layout.between(-0.3, 0.3) * slack, 0.0)
    return layout.put(television, x, z, turn + layout.wobble(1.0), y=stand.top_m, layer="top", ignore=(base.body,))


def _keep_view(layout: Layout, seat: Piece, distance: float) -> bool:
    """Nothing tall stands before the sofa, as far as the television."""
    length = distance - seat.body.half_depth - 0.5
    if length <= 0.1:
        return True
    x, z = seat.body.out(0.0, seat.body.half_depth + length / 2)
    width = min(2 * seat.body.half_width, 1.4)
    view = Body.of(x, z, seat.degrees, width=width, depth=length, low=VIEW_OVER_M, high=1.3)
    return layout.keep_free(view, SIGHT)


def conversation(layout: Layout) -> Piece | None:
    """A sofa with its back to a wall, armchairs opposite; the sofa, or None."""
    widest = 2.1 if layout.area_m2 < 18 else 3.0
    for _ in range(3):
        sofa = layout.pick("sofa", width=(1.0, widest))
        seat = stand(layout, sofa, where="middle", clear_m=0.85)
        if seat is None:
            continue
        # Its zone kept the way open while others were put; now what stands there is part of the group.
        layout.zones.pop()
        table = _surround(layout, seat)
        anchor = table or seat
        chair = layout.pick("armchair", width=(0.4, 1.1))
        if chair is not None:
            for side in layout.shuffled((-0.55, 0.55))[: 1 + int(layout.chance(0.6))]:
                gap = layout.between(0.35, 0.6) if table is not None else layout.between(0.9, 1.4)
                front = anchor.body.half_depth + chair.depth_m / 2 + gap
                x, z = anchor.body.out(side * (1 + 0.2 * chair.width_m), front)
                target = seat.body.out(side * 0.5, 0.0)
                layout.put(chair, x, z, turn_toward(x, z, *target) + layout.wobble(7))
        return seat
    return None


def _surround(layout: Layout, seat: Piece) -> Piece | None:
    """Coffee table, armchairs at the sides, side tables and a lamp by the sofa, a rug below; the coffee table."""
    table = _coffee_table(layout, seat)
    _rug_below(layout, seat, table)
    if layout.chance(0.6):
        _side_seats(layout, seat, table)
    for side in layout.shuffled((-1, 1)):
        kind = layout.rng.random()
        if kind < 0.4:
            model = layout.pick("side_table", width=(0.2, 0.7), depth=(0.2, 0.7))
        elif kind < 0.7:
            model = layout.pick("floor_lamp", width=(0.1, 0.7), depth=(0.1, 0.9))
        elif kind < 0.8:
            model = layout.pick("plant", width=(0.15, 0.8))
        else:
            continue
        _next_to(layout, seat, model, side)
    return table


def _coffee_table(layout: Layout, seat: Piece) -> Piece | None:
    """Before the sofa, its long side along it."""
    if layout.chance(0.08):
        return None
    sofa = seat.model
    model = layout.pick("coffee_table", width=(0.3, max(sofa.width_m * 0.85, 0.8)), height=(0.15, 0.62))
    if model is None:
        return None
    quarter = 90.0 if model.depth_m > model.width_m * 1.2 else 0.0
    reach = model.width_m / 2 if quarter else model.depth_m / 2
    for gap in (layout.between(0.3, 0.5), 0.3):
        x, z = seat.body.out(layout.between(-0.12, 0.12), seat.body.half_depth + gap + reach)
        placed = layout.put(model, x, z, seat.degrees + quarter + layout.wobble(2.5))
        if placed is not None:
            return placed
    return None


def _rug_below(layout: Layout, seat: Piece, table: Piece | None) -> None:
    if layout.chance(0.25):
        return
    sofa = seat.model
    for largest in (3.4, 2.4, 1.7):
        rug = layout.pick("rug", width=(0.9, max(largest, sofa.width_m)), depth=(0.7, largest), height=(0.0, 0.05))
        if rug is None:
            continue
        # The wide side goes along the sofa.
        quarter = 90.0 if rug.depth_m > rug.width_m * 1.05 else 0.0
        x, z = seat.body.out(layout.between(-0.1, 0.1), seat.body.half_depth + 0.45)
        if table is not None:
            x, z = (table.body.x + x) / 2, (table.body.z + z) / 2
        if layout.put(rug, x, z, seat.degrees + quarter + layout.wobble(2.0), layer="flat") is not None:
            return


def _side_seats(layout: Layout, seat: Piece, table: Piece | None) -> None:
    """Armchairs, or a second sofa, at right angles to the sofa, turned a little toward the middle."""
    middle = (table.body.x, table.body.z) if table is not None else seat.body.out(0.0, seat.body.half_depth + 0.7)
    _, front_middle = seat.body.into(*middle)
    half_table = table.body.half_width if table is not None else 0.3
    second = layout.chance(0.25)
    model = layout.pick("sofa", width=(1.0, 2.1), depth=(0.4, 1.0)) if second else layout.pick("armchair")
    if model is None:
        return
    for side in layout.shuffled((-1, 1))[: 1 if second else 1 + int(layout.chance(0.5))]:
        for push in (0.0, 0.25, 0.5):
            right = side * (max(half_table, 0.75 * seat.body.half_width) + 0.35 + push + model.depth_m / 2)
            front = front_middle + (0.1 if second else layout.between(-0.15, 0.5))
            x, z = seat.body.out(right, front)
            turn = seat.degrees - 90 * side if second else turn_toward(x, z, *middle)
            if layout.put(model, x, z, turn + layout.wobble(1.0 if second else 8.0)) is not None:
                break


def _next_to(layout: Layout, seat: Piece, model: FurnitureModel | None, side: int) -> Piece | None:
    """Beside a seat, toward its back."""
    if model is None:
        return None
    right = side * (seat.body.half_width + model.width_m / 2 + layout.between(0.03, 0.12))
    slack = max(seat.body.half_depth - model.depth_m / 2, 0.0)
    x, z = seat.body.out(right, -slack + layout.between(0.0, 0.15))
    return layout.put(model, x, z, seat.degrees + layout.wobble(2.0))


def reading_corner(layout: Layout) -> Piece | None:
    """An armchair in a corner, turned to the room, with a lamp or a small table."""
    model = layout.pick("armchair", width=(0.4, 1.1), depth=(0.4, 1.2))
    if model is None:
        return None
    half = (model.width_m**2 + model.depth_m**2) ** 0.5 / 2
    found = stretches(layout, 2 * half, low=0.0, high=model.height_m)
    for index, along in places(layout, found, 2 * half, "corner")[:8]:
        wall = layout.shell.walls[index]
        x, z = (float(part) for part in wall.at(along, half + 0.02))
        middle = layout.shell.polygon.mean(0)
        turn = turn_toward(x, z, float(middle[0]), float(middle[1]))
        facing = wall.facing_degrees()
        turned = facing + min(max((turn - facing + 180) % 360 - 180, -50.0), 50.0)
        mark = layout.mark()
        seat = layout.put(model, x, z, turned + layout.wobble(6))
        if seat is None:
            continue
        if not layout.keep_free(before(seat, 0.35)):
            layout.back_to(mark)
            continue
        side = 1 if layout.chance(0.5) else -1
        lamp = layout.pick("floor_lamp", width=(0.1, 0.6), depth=(0.1, 0.6))
        if _next_to(layout, seat, lamp, side) is None:
            _next_to(layout, seat, lamp, -side)
        if layout.chance(0.5):
            _next_to(layout, seat, layout.pick("side_table", width=(0.2, 0.6), depth=(0.2, 0.6)), -side)
        return seat
    return None
