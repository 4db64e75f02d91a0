"""Kitchens: an unbroken run of units along a wall, possibly around a corner, with wall units and a hood above."""

from typing import Final

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.planner.arrangement import FLOOR_LAYER, Arrangement, Piece
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.wall_space import WallSpan, floor_in_front, free_wall_spans, wall_point

COUNTER_M: Final = (0.7, 1.0)
"""Heights of units that carry a worktop."""

TAP_HEIGHT_M: Final = 0.35

WALL_UNIT_M: Final = (1.38, 1.55)
"""Height of the bottom of wall units."""

BACK_GAP_M: Final = 0.012
ACCESS_DEPTH_M: Final = 0.85


def _pick_counter_unit(
    arrangement: Arrangement, role: str, *, like: FurnitureModel | None = None, sink: bool | None = None
) -> FurnitureModel | None:
    """Choose a unit of worktop height, and of the same height as `like` if given: `like` itself where it fits."""

    def fits(model: FurnitureModel) -> bool:
        has_sink = "sink" in f"{model.id} {model.name}".lower()
        # A tap rises above the worktop.
        over = model.height_m - (like.height_m if like is not None else COUNTER_M[1])
        even = over <= 0.0 if like is None else -0.07 < over < (TAP_HEIGHT_M if has_sink else 0.07)
        return even and (sink is None or has_sink == sink)

    def matches(model: FurnitureModel) -> bool:
        return fits(model) and like is not None and model.id == like.id

    height = COUNTER_M[0], COUNTER_M[1] + TAP_HEIGHT_M
    own = arrangement.pick(role, width=(0.3, 1.4), depth=(0.4, 0.8), height=height, also=matches)
    return own or arrangement.pick(role, width=(0.3, 1.4), depth=(0.4, 0.8), height=height, also=fits)


def kitchen(arrangement: Arrangement, *, longest: float = 4.5, corner: float = 0.45, island: float = 0.35) -> None:
    """Place units along one wall, or around a corner."""
    unit = _pick_counter_unit(arrangement, "kitchen_unit", sink=False) or _pick_counter_unit(
        arrangement, "kitchen_unit"
    )
    if unit is None:
        return
    spans = free_wall_spans(arrangement, 0.66, low=0.0, high=COUNTER_M[1] - 0.06)
    ranked = sorted(
        (span for span in spans if span.length_m >= 0.7),
        key=lambda span: -span.length_m * arrangement.uniform(0.75, 1.25),
    )
    for span in ranked[:4]:
        snapshot = arrangement.snapshot()
        turns = arrangement.chance(corner)
        pieces, from_left = _place_run(arrangement, span, unit, longest, turns=turns)
        if not pieces:
            arrangement.restore(snapshot)
            continue
        if turns:
            pieces += _place_corner_run(arrangement, span, unit, pieces, from_left=from_left)
        _place_wall_units(arrangement, span.wall, pieces)
        if arrangement.chance(island) and arrangement.area_m2 > 14:
            _place_island(arrangement, pieces, unit)
        if len(pieces) < 4 and arrangement.area_m2 > 6:
            _place_opposite_run(arrangement, pieces, unit)
        return


def _choose_run_models(
    arrangement: Arrangement, unit: FurnitureModel, length: float, *, turns: bool
) -> list[FurnitureModel]:
    """Choose the units of a run of that length from the corner on; a run that turns there begins with a low unit."""
    sink = _pick_counter_unit(arrangement, "kitchen_unit", like=unit, sink=True) or unit
    oven = _pick_counter_unit(arrangement, "oven", like=unit) or arrangement.pick(
        "oven", width=(0.3, 1.0), depth=(0.4, 0.8), height=(0.6, 1.1)
    )
    washer = _pick_counter_unit(
        arrangement, arrangement.shuffled(("dishwasher", "dishwasher", "washing_machine"))[0], like=unit
    )
    fridge = arrangement.pick("fridge", width=(0.4, 1.0), depth=(0.4, 0.85), height=(0.7, 2.2))
    wanted = [
        sink,
        oven,
        fridge if arrangement.chance(0.9) else None,
        unit,
        washer if arrangement.chance(0.6) else None,
    ]
    used = 0.0
    fitted: list[FurnitureModel] = []
    for model in wanted:
        if model is not None and used + model.width_m + 0.002 <= length:
            fitted.append(model)
            used += model.width_m + 0.002
    fridges = [model for model in fitted if model.role == "fridge"]
    fitted = [model for model in fitted if model.role != "fridge"]
    if arrangement.chance(0.5):
        fitted.reverse()
    other = _pick_counter_unit(arrangement, "kitchen_unit", like=unit, sink=False) or unit
    while used + min(unit.width_m, other.width_m) + 0.002 <= length:
        extra = unit if used + unit.width_m + 0.002 <= length and arrangement.chance(0.75) else other
        if used + extra.width_m + 0.002 > length:
            extra = unit if unit.width_m < other.width_m else other
        fitted.insert(int(arrangement.rng.integers(len(fitted) + 1)), extra)
        used += extra.width_m + 0.002
    if turns:
        # The corner holds no unit that opens and no high unit.
        fitted.sort(key=lambda model: model is not unit)
        fitted[1:] = arrangement.shuffled(fitted[1:])
    at_end = turns or arrangement.chance(0.5)
    return fitted + fridges if at_end else fridges + fitted


def _place_run(
    arrangement: Arrangement, span: WallSpan, unit: FurnitureModel, longest: float, *, turns: bool
) -> tuple[list[Piece], bool]:
    """Place units side by side from one end of the span, at a corner if there is one; and whether it is the left."""
    wall = arrangement.shell.walls[span.wall]
    left_corner, right_corner = span.start_m < 0.01, span.end_m > wall.length_m - 0.01
    from_left = left_corner if left_corner != right_corner else arrangement.chance(0.5)
    length = min(span.length_m - 0.02, arrangement.uniform(0.7, 1.0) * longest)
    turns = turns and (left_corner if from_left else right_corner)
    line = _choose_run_models(arrangement, unit, length, turns=turns)
    cursor = span.start_m + 0.01 if from_left else span.end_m - 0.01
    return _place_side_by_side(arrangement, span.wall, line, cursor, unit, step=1 if from_left else -1), from_left


def _place_opposite_run(arrangement: Arrangement, first: list[Piece], unit: FurnitureModel) -> None:
    """If the first run is short, place a second, plain run along another wall."""
    roles = {piece.role for piece in first}
    spans = free_wall_spans(arrangement, 0.66, low=0.0, high=COUNTER_M[1] - 0.06)
    for span in sorted(spans, key=lambda span: -span.length_m)[:3]:
        length = min(span.length_m - 0.02, 3.0)
        fridge = arrangement.pick("fridge", width=(0.4, 1.0), depth=(0.4, 0.85), height=(0.7, 2.2))
        line = [fridge] if fridge is not None and "fridge" not in roles else []
        line += [unit] * int((length - sum(model.width_m for model in line)) / (unit.width_m + 0.002))
        run = (
            _place_side_by_side(arrangement, span.wall, line, span.start_m + 0.01, unit, step=1)
            if len(line) > 1
            else []
        )
        if run:
            _place_wall_units(arrangement, span.wall, run)
            return


def _place_side_by_side(
    arrangement: Arrangement, index: int, line: list[FurnitureModel], cursor: float, unit: FurnitureModel, *, step: int
) -> list[Piece]:
    """Place models side by side without gaps; a model that does not fit is replaced by a unit, or ends the run."""
    pieces: list[Piece] = []
    deferred: list[FurnitureModel] = []
    for model in line:
        # A sink whose tap would overlap the window sill is deferred to the next position; a unit takes its place.
        for choice in (*deferred, model, unit):
            piece = _place_next(arrangement, index, choice, cursor, step)
            if piece is None:
                continue
            if choice in deferred:
                deferred.remove(choice)
            if choice is not model and model.role != "kitchen_unit":
                deferred.append(model)
            pieces.append(piece)
            cursor += step * (choice.width_m + 0.002)
            break
        else:
            if pieces:
                return pieces
    return pieces


def _place_next(arrangement: Arrangement, index: int, model: FurnitureModel, cursor: float, step: int) -> Piece | None:
    """Place one more piece of a run and reserve the floor in front of it."""
    wall = arrangement.shell.walls[index]
    snapshot = arrangement.snapshot()
    x, z = wall_point(wall, cursor + step * (model.width_m / 2 + 0.001), model.depth_m, BACK_GAP_M)
    piece = arrangement.place(model, x, z, wall.facing_degrees())
    if piece is None:
        return None
    # In a corner a run can meet its own zone, so a shallow zone suffices.
    if any(arrangement.reserve(floor_in_front(piece, depth, shrink=0.02)) for depth in (ACCESS_DEPTH_M, 0.6)):
        return piece
    arrangement.restore(snapshot)
    return None


def _place_corner_run(
    arrangement: Arrangement, span: WallSpan, unit: FurnitureModel, first: list[Piece], *, from_left: bool
) -> list[Piece]:
    """Continue the run around the corner where it began."""
    walls = arrangement.shell.walls
    index = (span.wall + (-1 if from_left else 1)) % len(walls)
    wall, here = walls[index], walls[span.wall]
    at_corner = span.start_m < 0.01 if from_left else span.end_m > here.length_m - 0.01
    if not at_corner or abs(float(wall.inward @ here.inward)) > 0.02 or first[0].model.height_m > 1.2:
        return []
    used = max(piece.model.depth_m for piece in first) + BACK_GAP_M + 0.004
    length = min(wall.length_m - used - 0.05, arrangement.uniform(0.9, 2.6))
    line = [unit] * int(length / unit.width_m)
    cursor = wall.length_m - used if from_left else used
    # The corner of two runs has no floor in front of it: the first unit's zone was reserved along the other wall.
    kept = [zone for zone in arrangement.zones if zone.excluded_layers == FLOOR_LAYER]
    reach = [zone for zone in kept if zone.body.overlaps(_corner_space(arrangement, index, used, from_left=from_left))]
    for zone in reach:
        arrangement.zones.remove(zone)
    placed = _place_side_by_side(arrangement, index, line, cursor, unit, step=-1 if from_left else 1)
    arrangement.zones.extend(zone for zone in reach if not any(zone.body.overlaps(piece.body) for piece in placed))
    if placed:
        _place_wall_units(arrangement, index, placed)
    return placed


def _corner_space(arrangement: Arrangement, index: int, used: float, *, from_left: bool) -> Body:
    wall = arrangement.shell.walls[index]
    along = wall.length_m - used - 0.5 if from_left else used + 0.5
    x, z = wall_point(wall, along, 0.6, 0.0)
    return Body.of(x, z, wall.facing_degrees(), width=1.0, depth=0.6, low=0.0, high=1.0)


def _place_wall_units(arrangement: Arrangement, index: int, run: list[Piece]) -> None:
    """Place a hood over the oven and wall units over the rest, except at windows."""
    wall = arrangement.shell.walls[index]
    direction = (wall.end - wall.start) / wall.length_m
    low = [piece for piece in run if piece.model.height_m < 1.2]
    if not low:
        return
    along = [float((piece.body.x - wall.start[0]) * direction[0] + (piece.body.z - wall.start[1]) * direction[1])
             for piece in low]  # fmt: skip
    for piece, place in zip(low, along, strict=True):
        if piece.role == "oven":
            hood = arrangement.pick("hood", width=(0.3, 1.1), depth=(0.1, 0.7), height=(0.05, 1.2))
            if hood is not None:
                lowest = piece.model.height_m + 0.6
                y = min(max(lowest, arrangement.uniform(1.5, 1.65)), wall.height_m - hood.height_m - 0.02)
                if y >= lowest - 0.1:
                    x, z = wall_point(wall, place, hood.depth_m, 0.005)
                    arrangement.place(hood, x, z, wall.facing_degrees(), y=y, layer="wall")
    if arrangement.chance(0.15):
        return
    cabinet = arrangement.pick("wall_unit", width=(0.25, 1.3), depth=(0.15, 0.5), height=(0.25, 1.0))
    if cabinet is None:
        return
    y = arrangement.uniform(*WALL_UNIT_M)
    if y + cabinet.height_m > wall.height_m - 0.02:
        y = wall.height_m - 0.03 - cabinet.height_m
        if y < WALL_UNIT_M[0] - 0.06:
            return
    first = min(place - piece.body.half_width for piece, place in zip(low, along, strict=True))
    last = max(place + piece.body.half_width for piece, place in zip(low, along, strict=True))
    free = free_wall_spans(
        arrangement, cabinet.depth_m + 0.01, low=y, high=y + cabinet.height_m, layer="wall", walls=(index,)
    )
    for span in free:
        start, end = max(span.start_m, first), min(span.end_m, last)
        count = int((end - start + 0.001) / (cabinet.width_m + 0.002))
        for k in range(count):
            place = start + (k + 0.5) * (cabinet.width_m + 0.002)
            x, z = wall_point(wall, place, cabinet.depth_m, 0.005)
            arrangement.place(cabinet, x, z, wall.facing_degrees(), y=y, layer="wall")


def _place_island(arrangement: Arrangement, run: list[Piece], unit: FurnitureModel) -> None:
    """Place two or three units in front of the run, with stools on their far side."""
    middle = run[len(run) // 2]
    count = 2 + int(arrangement.chance(0.5))
    stool = arrangement.pick("stool", height=(0.4, 1.2), width=(0.2, 0.6), depth=(0.2, 0.6))
    out = middle.body.half_depth + ACCESS_DEPTH_M + 0.15 + unit.depth_m / 2
    row: list[Piece] = []
    snapshot = arrangement.snapshot()
    for k in range(count):
        x, z = middle.body.to_plan((k - (count - 1) / 2) * (unit.width_m + 0.002), out)
        piece = arrangement.place(unit, x, z, middle.degrees + 180)
        if piece is None:
            arrangement.restore(snapshot)
            return
        row.append(piece)
    if stool is not None:
        for piece in row:
            back = -(piece.body.half_depth + stool.depth_m / 2 + arrangement.uniform(0.03, 0.2))
            x, z = piece.body.to_plan(arrangement.uniform(-0.1, 0.1), back)
            arrangement.place(stool, x, z, piece.degrees + arrangement.jitter(15))
