"""Kitchen runs: an unbroken line of units along a wall, round a corner too, wall units and a hood above."""

from typing import Final

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.planner.arrangement import STANDING, Layout, Piece
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.wall_space import Stretch, at_wall, stretches

Range = tuple[float, float]

COUNTER_M: Final = (0.7, 1.0)
"""Heights of what carries a worktop."""

TAP_M: Final = 0.35

WALL_UNIT_M: Final = (1.38, 1.55)
"""The bottom of wall units."""

BACK_M: Final = 0.012
WAY_M: Final = 0.85


def _counter(
    layout: Layout, role: str, *, like: FurnitureModel | None = None, sink: bool | None = None
) -> FurnitureModel | None:
    """A piece as high as a worktop, and as high as `like` where one is given."""

    def fits(model: FurnitureModel) -> bool:
        has_sink = "sink" in f"{model.id} {model.name}".lower()
        # A tap stands over its worktop.
        over = model.height_m - (like.height_m if like is not None else COUNTER_M[1])
        even = over <= 0.0 if like is None else -0.07 < over < (TAP_M if has_sink else 0.07)
        return even and (sink is None or has_sink == sink)

    def matches(model: FurnitureModel) -> bool:
        return fits(model) and like is not None and _family(model) == _family(like)

    own = layout.pick(
        role, width=(0.3, 1.4), depth=(0.4, 0.8), height=(COUNTER_M[0], COUNTER_M[1] + TAP_M), also=matches
    )
    return own or layout.pick(
        role, width=(0.3, 1.4), depth=(0.4, 0.8), height=(COUNTER_M[0], COUNTER_M[1] + TAP_M), also=fits
    )


def _family(model: FurnitureModel) -> tuple[str, str]:
    """Models made to match share the first and the last part of their ids: "procedural/<kind>/train3"."""
    return model.id.split("/")[0], model.id.split("/")[-1]


def _matching(
    layout: Layout, role: str, like: FurnitureModel, *, width: Range, depth: Range, height: Range
) -> FurnitureModel | None:
    """One made to match where there is one, else any."""

    def matches(model: FurnitureModel) -> bool:
        return _family(model) == _family(like)

    own = layout.pick(role, width=width, depth=depth, height=height, also=matches)
    return own or layout.pick(role, width=width, depth=depth, height=height)


def kitchen(layout: Layout, *, longest: float = 4.5, corner: float = 0.45, island: float = 0.35) -> list[Piece]:
    """Units along one wall, or round a corner; the pieces on the floor."""
    unit = _counter(layout, "kitchen_unit", sink=False) or _counter(layout, "kitchen_unit")
    if unit is None:
        return []
    found = stretches(layout, 0.66, low=0.0, high=COUNTER_M[1] - 0.06)
    ranked = sorted(
        (one for one in found if one.length_m >= 0.7), key=lambda one: -one.length_m * layout.between(0.75, 1.25)
    )
    for stretch in ranked[:4]:
        mark = layout.mark()
        turns = layout.chance(corner)
        pieces, from_left = _run(layout, stretch, unit, longest, turns=turns)
        if not pieces:
            layout.back_to(mark)
            continue
        if turns:
            pieces += _second_leg(layout, stretch, unit, pieces, from_left=from_left)
        _above(layout, stretch.wall, pieces)
        if layout.chance(island) and layout.area_m2 > 14:
            _island(layout, pieces, unit)
        if len(pieces) < 4 and layout.area_m2 > 6:
            pieces += _opposite(layout, pieces, unit)
        return pieces
    return []


def _sequence(layout: Layout, unit: FurnitureModel, length: float, *, turns: bool) -> list[FurnitureModel]:
    """What stands in a run of that length, from the corner on; a run that turns there begins with a low unit."""
    sink = _counter(layout, "kitchen_unit", like=unit, sink=True) or unit
    oven = _counter(layout, "oven", like=unit) or _matching(
        layout, "oven", unit, width=(0.3, 1.0), depth=(0.4, 0.8), height=(0.6, 1.1)
    )
    washer = _counter(layout, layout.shuffled(("dishwasher", "dishwasher", "washing_machine"))[0], like=unit)
    fridge = _matching(layout, "fridge", unit, width=(0.4, 1.0), depth=(0.4, 0.85), height=(0.7, 2.2))
    wanted = [sink, oven, fridge if layout.chance(0.9) else None, unit, washer if layout.chance(0.6) else None]
    used = 0.0
    fitted: list[FurnitureModel] = []
    for model in wanted:
        if model is not None and used + model.width_m + 0.002 <= length:
            fitted.append(model)
            used += model.width_m + 0.002
    cold = [model for model in fitted if model.role == "fridge"]
    fitted = [model for model in fitted if model.role != "fridge"]
    if layout.chance(0.5):
        fitted.reverse()
    other = _counter(layout, "kitchen_unit", like=unit, sink=False) or unit
    while used + min(unit.width_m, other.width_m) + 0.002 <= length:
        extra = unit if used + unit.width_m + 0.002 <= length and layout.chance(0.75) else other
        if used + extra.width_m + 0.002 > length:
            extra = unit if unit.width_m < other.width_m else other
        fitted.insert(int(layout.rng.integers(len(fitted) + 1)), extra)
        used += extra.width_m + 0.002
    if turns:
        # Nothing that opens stands in the corner, nothing high either.
        fitted.sort(key=lambda model: model is not unit)
        fitted[1:] = layout.shuffled(fitted[1:])
    at_end = turns or layout.chance(0.5)
    return fitted + cold if at_end else cold + fitted


def _run(
    layout: Layout, stretch: Stretch, unit: FurnitureModel, longest: float, *, turns: bool
) -> tuple[list[Piece], bool]:
    """Units side by side from one end of the stretch; the end at a corner where one is. Whether that is its left."""
    wall = layout.shell.walls[stretch.wall]
    left_corner, right_corner = stretch.start_m < 0.01, stretch.end_m > wall.length_m - 0.01
    from_left = left_corner if left_corner != right_corner else layout.chance(0.5)
    length = min(stretch.length_m - 0.02, layout.between(0.7, 1.0) * longest)
    turns = turns and (left_corner if from_left else right_corner)
    line = _sequence(layout, unit, length, turns=turns)
    cursor = stretch.start_m + 0.01 if from_left else stretch.end_m - 0.01
    return _line_up(layout, stretch.wall, line, cursor, unit, step=1 if from_left else -1), from_left


def _opposite(layout: Layout, first: list[Piece], unit: FurnitureModel) -> list[Piece]:
    """A second, plain run where the first is short, along another wall."""
    roles = {piece.role for piece in first}
    found = stretches(layout, 0.66, low=0.0, high=COUNTER_M[1] - 0.06)
    for stretch in sorted(found, key=lambda one: -one.length_m)[:3]:
        length = min(stretch.length_m - 0.02, 3.0)
        fridge = _matching(layout, "fridge", unit, width=(0.4, 1.0), depth=(0.4, 0.85), height=(0.7, 2.2))
        line = [fridge] if fridge is not None and "fridge" not in roles else []
        line += [unit] * int((length - sum(model.width_m for model in line)) / (unit.width_m + 0.002))
        run = _line_up(layout, stretch.wall, line, stretch.start_m + 0.01, unit, step=1) if len(line) > 1 else []
        if run:
            _above(layout, stretch.wall, run)
            return run
    return []


def _line_up(
    layout: Layout, index: int, line: list[FurnitureModel], cursor: float, unit: FurnitureModel, *, step: int
) -> list[Piece]:
    """One beside the other without gaps; what does not fit is replaced by a unit, or ends the run."""
    pieces: list[Piece] = []
    waiting: list[FurnitureModel] = []
    for model in line:
        # A sink whose tap meets the sill waits for the next place, a unit stands there instead.
        for choice in (*waiting, model, unit):
            piece = _beside(layout, index, choice, cursor, step)
            if piece is None:
                continue
            if choice in waiting:
                waiting.remove(choice)
            if choice is not model and model.role != "kitchen_unit":
                waiting.append(model)
            pieces.append(piece)
            cursor += step * (choice.width_m + 0.002)
            break
        else:
            if pieces:
                return pieces
    return pieces


def _beside(layout: Layout, index: int, model: FurnitureModel, cursor: float, step: int) -> Piece | None:
    """One more piece of a run, with a way before it."""
    wall = layout.shell.walls[index]
    mark = layout.mark()
    x, z = at_wall(wall, cursor + step * (model.width_m / 2 + 0.001), model.depth_m, BACK_M)
    piece = layout.put(model, x, z, wall.facing_degrees())
    if piece is None:
        return None
    # A run that turns a corner may meet its own zone there, so a narrow way will do.
    if layout.keep_free(_way(piece, WAY_M)) or layout.keep_free(_way(piece, 0.6)):
        return piece
    layout.back_to(mark)
    return None


def _way(piece: Piece, depth: float) -> Body:
    x, z = piece.body.out(0.0, piece.body.half_depth + depth / 2 + 0.005)
    width = 2 * piece.body.half_width - 0.02
    return Body.of(x, z, piece.degrees, width=width, depth=depth, low=0.0, high=1.9)


def _second_leg(
    layout: Layout, stretch: Stretch, unit: FurnitureModel, first: list[Piece], *, from_left: bool
) -> list[Piece]:
    """Round the corner that the run began at."""
    walls = layout.shell.walls
    index = (stretch.wall + (-1 if from_left else 1)) % len(walls)
    wall, here = walls[index], walls[stretch.wall]
    at_corner = stretch.start_m < 0.01 if from_left else stretch.end_m > here.length_m - 0.01
    if not at_corner or abs(float(wall.inward @ here.inward)) > 0.02 or first[0].model.height_m > 1.2:
        return []
    used = max(piece.model.depth_m for piece in first) + BACK_M + 0.004
    length = min(wall.length_m - used - 0.05, layout.between(0.9, 2.6))
    line = [unit] * int(length / unit.width_m)
    cursor = wall.length_m - used if from_left else used
    # The corner of two runs has no floor before it: the first unit's way was kept along the other wall.
    kept = [zone for zone in layout.zones if zone.bars == STANDING]
    reach = [zone for zone in kept if zone.body.overlaps(_corner_space(layout, index, used, from_left=from_left))]
    for zone in reach:
        layout.zones.remove(zone)
    placed = _line_up(layout, index, line, cursor, unit, step=-1 if from_left else 1)
    layout.zones.extend(zone for zone in reach if not any(zone.body.overlaps(piece.body) for piece in placed))
    if placed:
        _above(layout, index, placed)
    return placed


def _corner_space(layout: Layout, index: int, used: float, *, from_left: bool) -> Body:
    wall = layout.shell.walls[index]
    along = wall.length_m - used - 0.5 if from_left else used + 0.5
    x, z = at_wall(wall, along, 0.6, 0.0)
    return Body.of(x, z, wall.facing_degrees(), width=1.0, depth=0.6, low=0.0, high=1.0)


def _above(layout: Layout, index: int, run: list[Piece]) -> None:
    """A hood over the oven, wall units over the rest, where no window is."""
    wall = layout.shell.walls[index]
    direction = (wall.end - wall.start) / wall.length_m
    low = [piece for piece in run if piece.model.height_m < 1.2]
    if not low:
        return
    along = [float((piece.body.x - wall.start[0]) * direction[0] + (piece.body.z - wall.start[1]) * direction[1])
             for piece in low]  # fmt: skip
    for piece, place in zip(low, along, strict=True):
        if piece.role == "oven":
            hood = _matching(layout, "hood", low[0].model, width=(0.3, 1.1), depth=(0.1, 0.7), height=(0.05, 1.2))
            if hood is not None:
                lowest = piece.model.height_m + 0.6
                y = min(max(lowest, layout.between(1.5, 1.65)), wall.height_m - hood.height_m - 0.02)
                if y >= lowest - 0.1:
                    x, z = at_wall(wall, place, hood.depth_m, 0.005)
                    layout.put(hood, x, z, wall.facing_degrees(), y=y, layer="wall")
    if layout.chance(0.15):
        return
    cabinet = _matching(layout, "wall_unit", low[0].model, width=(0.25, 1.3), depth=(0.15, 0.5), height=(0.25, 1.0))
    if cabinet is None:
        return
    y = layout.between(*WALL_UNIT_M)
    if y + cabinet.height_m > wall.height_m - 0.02:
        y = wall.height_m - 0.03 - cabinet.height_m
        if y < WALL_UNIT_M[0] - 0.06:
            return
    first = min(place - piece.body.half_width for piece, place in zip(low, along, strict=True))
    last = max(place + piece.body.half_width for piece, place in zip(low, along, strict=True))
    free = stretches(layout, cabinet.depth_m + 0.01, low=y, high=y + cabinet.height_m, layer="wall", walls=(index,))
    for stretch in free:
        start, end = max(stretch.start_m, first), min(stretch.end_m, last)
        count = int((end - start + 0.001) / (cabinet.width_m + 0.002))
        for k in range(count):
            place = start + (k + 0.5) * (cabinet.width_m + 0.002)
            x, z = at_wall(wall, place, cabinet.depth_m, 0.005)
            layout.put(cabinet, x, z, wall.facing_degrees(), y=y, layer="wall")


def _island(layout: Layout, run: list[Piece], unit: FurnitureModel) -> None:
    """Two or three units before the run, stools on their far side."""
    middle = run[len(run) // 2]
    count = 2 + int(layout.chance(0.5))
    stool = layout.pick("stool", height=(0.4, 1.2), width=(0.2, 0.6), depth=(0.2, 0.6))
    out = middle.body.half_depth + WAY_M + 0.15 + unit.depth_m / 2
    row: list[Piece] = []
    mark = layout.mark()
    for k in range(count):
        x, z = middle.body.out((k - (count - 1) / 2) * (unit.width_m + 0.002), out)
        piece = layout.put(unit, x, z, middle.degrees + 180)
        if piece is None:
            layout.back_to(mark)
            return
        row.append(piece)
    if stool is not None:
        for piece in row:
            x, z = middle.body.out(0.0, 0.0)
            back = -(piece.body.half_depth + stool.depth_m / 2 + layout.between(0.03, 0.2))
            x, z = piece.body.out(layout.between(-0.1, 0.1), back)
            layout.put(stool, x, z, piece.degrees + layout.wobble(15))
