"""Tables with chairs: dining, cafe and reading tables; desks with whoever sits at them."""

from typing import Final, Literal

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.planner.arrangement import Layout, Piece
from roomlight_generator.rooms.planner.body import Body, within
from roomlight_generator.rooms.planner.wall_space import at_wall, places, stretches, under_slope_m

TUCKED_M: Final = 0.15
"""The most that a chair's box reaches under its table's: its seat is lower than the table's top."""

SEAT_M: Final = 0.62
"""Of a table's side for each chair."""


def chairs_at(
    layout: Layout,
    table: Piece,
    chair: FurnitureModel,
    *,
    sides: tuple[str, ...] = ("front", "back", "left", "right"),
    share: float = 0.9,
    at_most: int = 99,
) -> list[Piece]:
    """Chairs along the sides of a table, each facing it, tucked in a little or now and then pulled out."""
    body = table.body
    seats: list[tuple[float, float, float]] = []
    for side, turn in (("front", 0.0), ("back", 180.0), ("right", 90.0), ("left", 270.0)):
        if side not in sides:
            continue
        ends = side in ("left", "right")
        length = 2 * (body.half_depth if ends else body.half_width)
        if ends and length < 0.65 and body.half_width > body.half_depth * 1.1:
            continue
        number = 1 if ends and length < 1.5 else max(1, int((length - 0.05) / max(SEAT_M, chair.width_m + 0.08)))
        if length < chair.width_m * 0.8:
            continue
        seats += [(turn, (k + 0.5) / number - 0.5, length) for k in range(number)]
    placed: list[Piece] = []
    for turn, at, length in layout.shuffled(seats):
        if len(placed) >= at_most:
            break
        if not layout.chance(share):
            continue
        pulled = layout.chance(0.12)
        tuck = -layout.between(0.08, 0.35) if pulled else layout.between(0.0, 0.12)
        twist = layout.wobble(14.0 if pulled else 4.0)
        ends = turn in (90.0, 270.0)
        # Out from the table's edge until the turned chair's box reaches under it by `tuck`.
        edge = body.half_width if ends else body.half_depth
        probe = Body.of(0.0, 0.0, twist, width=chair.width_m, depth=chair.depth_m, high=1.0)
        extent = probe.half_depth * abs(probe.cosine) + probe.half_width * abs(probe.sine)
        offset = at * length + layout.between(-0.03, 0.03)
        out = edge + extent - tuck
        frame = Body.of(body.x, body.z, table.degrees + turn, width=1.0, depth=1.0, high=1.0)
        x, z = frame.out(offset, out)
        chair_piece = layout.put(chair, x, z, table.degrees + turn + 180 + twist, ignore=(body,))
        if chair_piece is not None:
            placed.append(chair_piece)
    return placed


def dining(
    layout: Layout, *, seats: tuple[int, int] = (2, 8), prefer: Literal["middle", "side"] = "side"
) -> Piece | None:
    """A dining table with chairs around it, in the middle of free floor or near a wall; the table."""
    largest = 1.0 if seats[1] <= 2 else (1.5 if seats[1] <= 4 else 2.8)
    largest = min(largest, 0.5 * max(wall.length_m for wall in layout.shell.walls))
    small = min(largest, 1.3)
    for longest, room in ((largest, 0.6), (largest, 0.6), (largest, 0.55), (small, 0.55), (small, 0.45), (1.0, 0.35)):
        table = layout.pick("dining_table", width=(0.5, longest), depth=(0.5, 1.6), height=(0.6, 0.85))
        chair = layout.pick("chair", width=(0.3, 0.7), depth=(0.3, 0.75), height=(0.6, 1.3))
        if table is None:
            continue
        mark = layout.mark()
        placed = put_table(layout, table, room_m=room, prefer=prefer)
        if placed is None:
            continue
        if chair is None:
            return placed
        at_most = int(layout.rng.integers(seats[0], seats[1] + 1))
        if len(chairs_at(layout, placed, chair, at_most=at_most)) < 2:
            layout.back_to(mark)
            continue
        layout.tables.append(placed)
        if layout.chance(0.3):
            _rug_below(layout, placed)
        return placed
    return None


def _rug_below(layout: Layout, table: Piece) -> None:
    wide, deep = 2 * table.body.half_width + 0.6, 2 * table.body.half_depth + 0.6
    rug = layout.pick("rug", width=(wide, wide + 1.4), depth=(deep, deep + 1.4), height=(0.0, 0.05))
    if rug is not None:
        layout.put(rug, table.body.x, table.body.z, table.degrees + layout.wobble(1.5), layer="flat")


def put_table(
    layout: Layout, table: FurnitureModel, *, room_m: float, prefer: Literal["middle", "side"]
) -> Piece | None:
    """A table with that much room on every side, far from walls ("middle") or as near to them as it may ("side")."""
    longest = max(layout.shell.walls, key=lambda wall: wall.length_m)
    free = layout.floor.points()[layout.free()[layout.floor.free]]
    if not len(free):
        return None
    ranked: list[tuple[float, Body, float]] = []
    for place in layout.rng.integers(len(free), size=60):
        x, z = (float(part) + layout.between(-0.05, 0.05) for part in free[int(place)])
        degrees = longest.facing_degrees() + 90 * int(layout.rng.integers(4)) + layout.wobble(1.5)
        sizes = {"width": table.width_m + 2 * room_m, "depth": table.depth_m + 2 * room_m}
        envelope = Body.of(x, z, degrees, **sizes, high=table.height_m)
        if layout.admits(envelope, "floor"):
            space = _space(layout, x, z)
            ranked.append((-space if prefer == "middle" else space + layout.between(0.0, 0.4), envelope, degrees))
    for _, envelope, degrees in sorted(ranked, key=lambda one: one[0])[:6]:
        placed = layout.put(table, envelope.x, envelope.z, degrees)
        if placed is not None:
            return placed
    return None


def _space(layout: Layout, x: float, z: float) -> float:
    """How far the nearest wall or piece is."""
    nearest = 9.0
    for x0, z0, x1, z1 in layout.outline:
        ex, ez = x1 - x0, z1 - z0
        t = min(max(((x - x0) * ex + (z - z0) * ez) / (ex * ex + ez * ez), 0.0), 1.0)
        nearest = min(nearest, ((x - x0 - t * ex) ** 2 + (z - z0 - t * ez) ** 2) ** 0.5)
    for piece in layout.pieces:
        if piece.layer == "floor":
            right, front = piece.body.into(x, z)
            right, front = max(abs(right) - piece.body.half_width, 0.0), max(abs(front) - piece.body.half_depth, 0.0)
            nearest = min(nearest, (right * right + front * front) ** 0.5)
    return nearest


def desk(layout: Layout, *, seat: str = "office_chair", facing_room: float = 0.0) -> Piece | None:
    """A desk with its back to a wall and a chair before it, or (with that chance) the chair between wall and desk."""
    longest = min(0.6 * max(wall.length_m for wall in layout.shell.walls), 2.4)
    for widest in (longest, longest, min(longest, 1.5), 1.25, 1.1):
        model = layout.pick("desk", width=(0.6, widest), depth=(0.35, 1.3))
        if model is None:
            return None
        chair = layout.pick(seat, depth=(0.3, 0.8)) or layout.pick("chair", depth=(0.3, 0.7))
        turned = layout.chance(facing_room) and layout.area_m2 > 9
        away = (
            layout.between(0.75, 1.1) + (chair.depth_m - 0.5 if chair else 0.0)
            if turned
            else layout.between(0.01, 0.05)
        )
        found = stretches(layout, model.depth_m + away, low=0.0, high=model.height_m, lower_walls=True)
        for index, along in places(layout, found, model.width_m)[:8]:
            wall = layout.shell.walls[index]
            inset = under_slope_m(layout, wall, model.height_m)
            if inset is None:
                continue
            x, z = at_wall(wall, along, model.depth_m, away + inset)
            mark = layout.mark()
            turn = wall.facing_degrees() + (180 if turned else 0) + (layout.wobble(1.5) if turned else 0.0)
            placed = layout.put(model, x, z, turn)
            if placed is None:
                continue
            if chair is None or sit(layout, placed, chair) is not None:
                return placed
            layout.back_to(mark)
    return None


def sit(layout: Layout, desk_piece: Piece, chair: FurnitureModel, *, room_m: float = 0.25) -> Piece | None:
    """A chair before a desk, facing it, with some room behind."""
    body = desk_piece.body
    for _ in range(3):
        turn = layout.wobble(12.0)
        probe = Body.of(0.0, 0.0, turn, width=chair.width_m, depth=chair.depth_m, high=1.0)
        extent = probe.half_depth * abs(probe.cosine) + probe.half_width * abs(probe.sine)
        out = body.half_depth + extent + layout.between(-0.06, 0.22)
        slack = max(body.half_width - chair.width_m / 2 - 0.05, 0.0)
        x, z = body.out(layout.between(-0.35, 0.35) * min(slack, 0.5), out)
        mark = layout.mark()
        placed = layout.put(chair, x, z, desk_piece.degrees + 180 + turn, ignore=(body,))
        if placed is None:
            continue
        x, z = body.out(0.0, out + extent + room_m / 2)
        behind = Body.of(x, z, desk_piece.degrees, width=0.4, depth=room_m, low=0.0, high=1.5)
        if layout.keep_free(behind):
            return placed
        layout.back_to(mark)
    return None


def desk_islands(layout: Layout) -> int:
    """Rows of desks back to back with chairs outside, in lines along the longest wall; how many desks."""
    model = layout.pick("desk", width=(0.9, 1.9), depth=(0.5, 0.95), height=(0.6, 1.2))
    chair = layout.pick("office_chair") or layout.pick("chair")
    if model is None or chair is None:
        return 0
    walls = sorted(range(len(layout.shell.walls)), key=lambda index: -layout.shell.walls[index].length_m)
    wall = layout.shell.walls[walls[int(layout.chance(0.4))]]
    back_to_back = layout.chance(0.75)
    rows = 2 if back_to_back else 1
    room = chair.depth_m + layout.between(0.5, 0.8)
    per_island = int(layout.rng.integers(1, 4))
    aisle = layout.between(0.8, 1.3)
    island_depth = rows * model.depth_m + rows * room
    away = layout.between(0.4, 1.0)
    depth = max(across_m for across_m in _depths(layout))
    count = 0
    missing = 0.05 + 0.25 * (1 - layout.clutter)
    while away + island_depth < depth:
        along = layout.between(0.5, 1.2)
        while along + per_island * model.width_m < wall.length_m - 0.3:
            for k in range(per_island):
                centre = along + (k + 0.5) * (model.width_m + 0.01)
                for row in range(rows):
                    near = room + (row + 0.5) * (model.depth_m + 0.01)
                    x, z = wall.at(centre, away + near)
                    # The first row sits with its back to the wall's side, the second behind it.
                    turn = wall.facing_degrees() + (180 if row == 0 else 0)
                    if not within(float(x), float(z), layout.outline) or layout.chance(missing):
                        continue
                    mark = layout.mark()
                    piece = layout.put(model, float(x), float(z), turn)
                    if piece is None:
                        continue
                    if sit(layout, piece, chair, room_m=0.2) is None:
                        layout.back_to(mark)
                    else:
                        count += 1
            along += per_island * model.width_m + aisle
        away += island_depth + layout.between(0.1, 0.5)
    return count


def _depths(layout: Layout) -> list[float]:
    points = layout.shell.polygon
    return [max(float((point - wall.start) @ wall.inward) for point in points) for wall in layout.shell.walls]


def cafe_tables(layout: Layout, *, density: float = 0.3) -> int:
    """Small tables with two to four chairs of one kind all over the room; how many tables."""
    table = layout.pick("dining_table", width=(0.5, 1.3), depth=(0.5, 1.1), height=(0.6, 1.1))
    table = table or layout.pick("side_table", width=(0.45, 1.1), height=(0.6, 1.1))
    chair = layout.pick("chair", width=(0.3, 0.65), depth=(0.3, 0.7), height=(0.6, 1.3))
    if table is None or chair is None:
        return 0
    other = layout.pick("dining_table", width=(0.5, 1.8), depth=(0.5, 1.1), height=(0.6, 0.9)) or table
    count = 0
    for attempt in range(int(layout.area_m2 * density) + 3):
        mark = layout.mark()
        model = table if layout.chance(0.75) else other
        placed = put_table(
            layout, model, room_m=layout.between(0.5, 0.75) if count or attempt < 2 else 0.35, prefer="side"
        )
        if placed is None:
            continue
        if len(chairs_at(layout, placed, chair, at_most=int(layout.rng.integers(2, 5)))) < 2:
            layout.back_to(mark)
            continue
        layout.tables.append(placed)
        count += 1
    return count


def reading_tables(layout: Layout) -> int:
    """Long tables with chairs on both sides; how many."""
    chair = layout.pick("chair", width=(0.3, 0.7), depth=(0.3, 0.75), height=(0.6, 1.3))
    table = layout.pick("dining_table", width=(1.1, 2.6), depth=(0.6, 1.3), height=(0.65, 0.85))
    if chair is None or table is None:
        return 0
    count = 0
    for _ in range(1 + int(layout.area_m2 / 14)):
        placed = put_table(layout, table, room_m=0.75, prefer="middle")
        if placed is None:
            continue
        chairs_at(layout, placed, chair, sides=("front", "back"), share=0.8)
        layout.tables.append(placed)
        count += 1
    return count
