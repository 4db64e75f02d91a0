"""Tables with chairs: dining, cafe and reading tables; desks with their chairs."""

from typing import Final, Literal

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.planner.arrangement import Arrangement, Piece
from roomlight_generator.rooms.planner.body import Body, contains_point
from roomlight_generator.rooms.planner.wall_space import free_wall_spans, slope_inset_m, wall_point, wall_positions

SEAT_SPACING_M: Final = 0.62
"""Length of a table's side for each chair."""


def place_chairs(
    arrangement: Arrangement,
    table: Piece,
    chair: FurnitureModel,
    *,
    sides: tuple[str, ...] = ("front", "back", "left", "right"),
    share: float = 0.9,
    at_most: int = 99,
) -> list[Piece]:
    """Place chairs along the sides of a table, each facing it, slightly tucked in or sometimes pulled out."""
    body = table.body
    seats: list[tuple[float, float, float]] = []
    for side, yaw in (("front", 0.0), ("back", 180.0), ("right", 90.0), ("left", 270.0)):
        if side not in sides:
            continue
        ends = side in ("left", "right")
        length = 2 * (body.half_depth if ends else body.half_width)
        if ends and length < 0.65 and body.half_width > body.half_depth * 1.1:
            continue
        number = (
            1 if ends and length < 1.5 else max(1, int((length - 0.05) / max(SEAT_SPACING_M, chair.width_m + 0.08)))
        )
        if length < chair.width_m * 0.8:
            continue
        seats += [(yaw, (k + 0.5) / number - 0.5, length) for k in range(number)]
    placed: list[Piece] = []
    for yaw, at, length in arrangement.shuffled(seats):
        if len(placed) >= at_most:
            break
        if not arrangement.chance(share):
            continue
        pulled = arrangement.chance(0.12)
        tuck = -arrangement.uniform(0.08, 0.35) if pulled else arrangement.uniform(0.0, 0.12)
        twist = arrangement.jitter(14.0 if pulled else 4.0)
        ends = yaw in (90.0, 270.0)
        # Offset from the table's edge at which the rotated chair's box reaches under it by `tuck`.
        edge = body.half_width if ends else body.half_depth
        extent = _half_extent(chair, twist)
        offset = at * length + arrangement.uniform(-0.03, 0.03)
        out = edge + extent - tuck
        frame = Body.of(body.x, body.z, table.degrees + yaw, width=1.0, depth=1.0, high=1.0)
        x, z = frame.to_plan(offset, out)
        chair_piece = arrangement.place(chair, x, z, table.degrees + yaw + 180 + twist, ignore=(body,))
        if chair_piece is not None:
            placed.append(chair_piece)
    return placed


def _half_extent(model: FurnitureModel, degrees: float) -> float:
    """Return half the depth of a rotated model's bounding box."""
    probe = Body.of(0.0, 0.0, degrees, width=model.width_m, depth=model.depth_m, high=1.0)
    return probe.half_depth * abs(probe.cosine) + probe.half_width * abs(probe.sine)


def dining(
    arrangement: Arrangement, *, seats: tuple[int, int] = (2, 8), prefer: Literal["middle", "side"] = "side"
) -> Piece | None:
    """Place a dining table with chairs around it, in the middle of free floor or near a wall; return the table."""
    largest = 1.0 if seats[1] <= 2 else (1.5 if seats[1] <= 4 else 2.8)
    largest = min(largest, 0.5 * max(wall.length_m for wall in arrangement.shell.walls))
    small = min(largest, 1.3)
    for longest, room in ((largest, 0.6), (largest, 0.6), (largest, 0.55), (small, 0.55), (small, 0.45), (1.0, 0.35)):
        table = arrangement.pick("dining_table", width=(0.5, longest), depth=(0.5, 1.6), height=(0.6, 0.85))
        chair = arrangement.pick("chair", width=(0.3, 0.7), depth=(0.3, 0.75), height=(0.6, 1.3))
        if table is None:
            continue
        snapshot = arrangement.snapshot()
        placed = place_table(arrangement, table, room_m=room, prefer=prefer)
        if placed is None:
            continue
        if chair is None:
            return placed
        at_most = int(arrangement.rng.integers(seats[0], seats[1] + 1))
        if len(place_chairs(arrangement, placed, chair, at_most=at_most)) < 2:
            arrangement.restore(snapshot)
            continue
        arrangement.tables.append(placed)
        if arrangement.chance(0.3):
            _place_rug_below(arrangement, placed)
        return placed
    return None


def _place_rug_below(arrangement: Arrangement, table: Piece) -> None:
    wide, deep = 2 * table.body.half_width + 0.6, 2 * table.body.half_depth + 0.6
    rug = arrangement.pick("rug", width=(wide, wide + 1.4), depth=(deep, deep + 1.4), height=(0.0, 0.05))
    if rug is not None:
        arrangement.place(rug, table.body.x, table.body.z, table.degrees + arrangement.jitter(1.5), layer="flat")


def place_table(
    arrangement: Arrangement, table: FurnitureModel, *, room_m: float, prefer: Literal["middle", "side"]
) -> Piece | None:
    """Place a table with a margin on every side, far from walls ("middle") or as near to them as possible ("side")."""
    longest = max(arrangement.shell.walls, key=lambda wall: wall.length_m)
    free = arrangement.floor.points()[arrangement.free_cells()[arrangement.floor.free]]
    if not len(free):
        return None
    ranked: list[tuple[float, Body, float]] = []
    for place in arrangement.rng.integers(len(free), size=60):
        x, z = (float(part) + arrangement.uniform(-0.05, 0.05) for part in free[int(place)])
        degrees = longest.facing_degrees() + 90 * int(arrangement.rng.integers(4)) + arrangement.jitter(1.5)
        sizes = {"width": table.width_m + 2 * room_m, "depth": table.depth_m + 2 * room_m}
        envelope = Body.of(x, z, degrees, **sizes, high=table.height_m)
        if arrangement.fits(envelope, "floor"):
            space = _clearance_m(arrangement, x, z)
            ranked.append((-space if prefer == "middle" else space + arrangement.uniform(0.0, 0.4), envelope, degrees))
    for _, envelope, degrees in sorted(ranked, key=lambda entry: entry[0])[:6]:
        placed = arrangement.place(table, envelope.x, envelope.z, degrees)
        if placed is not None:
            return placed
    return None


def _clearance_m(arrangement: Arrangement, x: float, z: float) -> float:
    """Return the distance to the nearest wall or piece."""
    nearest = 9.0
    for x0, z0, x1, z1 in arrangement.outline:
        ex, ez = x1 - x0, z1 - z0
        t = min(max(((x - x0) * ex + (z - z0) * ez) / (ex * ex + ez * ez), 0.0), 1.0)
        nearest = min(nearest, ((x - x0 - t * ex) ** 2 + (z - z0 - t * ez) ** 2) ** 0.5)
    for piece in arrangement.pieces:
        if piece.layer == "floor":
            right, front = piece.body.to_local(x, z)
            right, front = max(abs(right) - piece.body.half_width, 0.0), max(abs(front) - piece.body.half_depth, 0.0)
            nearest = min(nearest, (right * right + front * front) ** 0.5)
    return nearest


def desk(arrangement: Arrangement, *, seat: str = "office_chair", facing_room: float = 0.0) -> Piece | None:
    """Place a desk and its chair, the desk's back to a wall or (with probability facing_room) the chair's."""
    longest = min(0.6 * max(wall.length_m for wall in arrangement.shell.walls), 2.4)
    for widest in (longest, longest, min(longest, 1.5), 1.25, 1.1):
        model = arrangement.pick("desk", width=(0.6, widest), depth=(0.35, 1.3))
        if model is None:
            return None
        chair = arrangement.pick(seat, depth=(0.3, 0.8)) or arrangement.pick("chair", depth=(0.3, 0.7))
        faces_room = arrangement.chance(facing_room) and arrangement.area_m2 > 9
        away = (
            arrangement.uniform(0.75, 1.1) + (chair.depth_m - 0.5 if chair else 0.0)
            if faces_room
            else arrangement.uniform(0.01, 0.05)
        )
        spans = free_wall_spans(arrangement, model.depth_m + away, low=0.0, high=model.height_m, lower_walls=True)
        for index, along in wall_positions(arrangement, spans, model.width_m)[:8]:
            wall = arrangement.shell.walls[index]
            inset = slope_inset_m(arrangement, wall, model.height_m)
            if inset is None:
                continue
            x, z = wall_point(wall, along, model.depth_m, away + inset)
            snapshot = arrangement.snapshot()
            yaw = wall.facing_degrees() + (180 if faces_room else 0) + (arrangement.jitter(1.5) if faces_room else 0.0)
            placed = arrangement.place(model, x, z, yaw)
            if placed is None:
                continue
            if chair is None or place_desk_chair(arrangement, placed, chair) is not None:
                return placed
            arrangement.restore(snapshot)
    return None


def place_desk_chair(
    arrangement: Arrangement, desk_piece: Piece, chair: FurnitureModel, *, room_m: float = 0.25
) -> Piece | None:
    """Place a chair in front of a desk, facing it, with free floor behind."""
    body = desk_piece.body
    for _ in range(3):
        yaw = arrangement.jitter(12.0)
        extent = _half_extent(chair, yaw)
        out = body.half_depth + extent + arrangement.uniform(-0.06, 0.22)
        slack = max(body.half_width - chair.width_m / 2 - 0.05, 0.0)
        x, z = body.to_plan(arrangement.uniform(-0.35, 0.35) * min(slack, 0.5), out)
        snapshot = arrangement.snapshot()
        placed = arrangement.place(chair, x, z, desk_piece.degrees + 180 + yaw, ignore=(body,))
        if placed is None:
            continue
        x, z = body.to_plan(0.0, out + extent + room_m / 2)
        behind = Body.of(x, z, desk_piece.degrees, width=0.4, depth=room_m, low=0.0, high=1.5)
        if arrangement.reserve(behind):
            return placed
        arrangement.restore(snapshot)
    return None


def desk_islands(arrangement: Arrangement) -> None:
    """Place desks back to back with chairs outside, in rows along the longest wall."""
    model = arrangement.pick("desk", width=(0.9, 1.9), depth=(0.5, 0.95), height=(0.6, 1.2))
    chair = arrangement.pick("office_chair") or arrangement.pick("chair")
    if model is None or chair is None:
        return
    walls = sorted(range(len(arrangement.shell.walls)), key=lambda index: -arrangement.shell.walls[index].length_m)
    wall = arrangement.shell.walls[walls[int(arrangement.chance(0.4))]]
    back_to_back = arrangement.chance(0.75)
    rows = 2 if back_to_back else 1
    room = chair.depth_m + arrangement.uniform(0.5, 0.8)
    per_island = int(arrangement.rng.integers(1, 4))
    aisle = arrangement.uniform(0.8, 1.3)
    island_depth = rows * model.depth_m + rows * room
    away = arrangement.uniform(0.4, 1.0)
    polygon = arrangement.shell.polygon
    depth = max(float(((polygon - side.start) @ side.inward).max()) for side in arrangement.shell.walls)
    skip_probability = 0.05 + 0.25 * (1 - arrangement.clutter)
    while away + island_depth < depth:
        along = arrangement.uniform(0.5, 1.2)
        while along + per_island * model.width_m < wall.length_m - 0.3:
            for k in range(per_island):
                centre = along + (k + 0.5) * (model.width_m + 0.01)
                for row in range(rows):
                    near = room + (row + 0.5) * (model.depth_m + 0.01)
                    x, z = wall.at(centre, away + near)
                    # The first row sits on the wall's side, the second opposite.
                    yaw = wall.facing_degrees() + (180 if row == 0 else 0)
                    if not contains_point(x, z, arrangement.outline) or arrangement.chance(skip_probability):
                        continue
                    snapshot = arrangement.snapshot()
                    piece = arrangement.place(model, x, z, yaw)
                    if piece is not None and place_desk_chair(arrangement, piece, chair, room_m=0.2) is None:
                        arrangement.restore(snapshot)
            along += per_island * model.width_m + aisle
        away += island_depth + arrangement.uniform(0.1, 0.5)


def cafe_tables(arrangement: Arrangement) -> None:
    """Place small tables with two to four chairs of one kind throughout the room."""
    table = arrangement.pick("dining_table", width=(0.5, 1.3), depth=(0.5, 1.1), height=(0.6, 1.1))
    table = table or arrangement.pick("side_table", width=(0.45, 1.1), height=(0.6, 1.1))
    chair = arrangement.pick("chair", width=(0.3, 0.65), depth=(0.3, 0.7), height=(0.6, 1.3))
    if table is None or chair is None:
        return
    other = arrangement.pick("dining_table", width=(0.5, 1.8), depth=(0.5, 1.1), height=(0.6, 0.9)) or table
    count = 0
    for attempt in range(int(arrangement.area_m2 * 0.3) + 3):
        snapshot = arrangement.snapshot()
        model = table if arrangement.chance(0.75) else other
        placed = place_table(
            arrangement, model, room_m=arrangement.uniform(0.5, 0.75) if count or attempt < 2 else 0.35, prefer="side"
        )
        if placed is None:
            continue
        if len(place_chairs(arrangement, placed, chair, at_most=int(arrangement.rng.integers(2, 5)))) < 2:
            arrangement.restore(snapshot)
            continue
        arrangement.tables.append(placed)
        count += 1


def reading_tables(arrangement: Arrangement) -> None:
    """Place long tables with chairs on both sides."""
    chair = arrangement.pick("chair", width=(0.3, 0.7), depth=(0.3, 0.75), height=(0.6, 1.3))
    table = arrangement.pick("dining_table", width=(1.1, 2.6), depth=(0.6, 1.3), height=(0.65, 0.85))
    if chair is None or table is None:
        return
    for _ in range(1 + int(arrangement.area_m2 / 14)):
        placed = place_table(arrangement, table, room_m=0.75, prefer="middle")
        if placed is None:
            continue
        place_chairs(arrangement, placed, chair, sides=("front", "back"), share=0.8)
        arrangement.tables.append(placed)
