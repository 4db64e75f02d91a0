"""Beds and the furniture around them."""

from roomlight_generator.rooms.planner.arrangement import Arrangement, Piece
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.wall_space import free_wall_spans, slope_inset_m, wall_point, wall_positions

DOUBLE_M = 1.25
"""Minimum width of a double bed, which needs access on both sides."""


def bed(arrangement: Arrangement, *, role: str = "bed", widest: float = 2.3, rug: float = 0.4) -> Piece | None:
    """Place a bed with its head against a wall, nightstands at its sides, sometimes a rug; return the bed."""
    if arrangement.area_m2 < 10:
        widest = min(widest, 1.7)
    tries = ((widest, 2.0), (widest, 1.2), (min(widest, 1.7), 1.2), (1.2, 1.2), (1.2, 0.9), (widest, 0.86))
    for attempt, (largest, highest) in enumerate(tries):
        width, height = (0.5, largest), (0.1, highest)
        model = arrangement.pick(role, width=width, height=height) or arrangement.pick(
            "bed", width=width, height=height
        )
        if model is None:
            continue
        double = model.width_m >= DOUBLE_M
        away = arrangement.uniform(0.01, 0.04)
        spans = free_wall_spans(arrangement, model.depth_m + away, low=0.0, high=model.height_m, lower_walls=True)
        # A double bed has its head in the middle of a wall; a single bed stands in a corner.
        width = model.width_m + (0.9 if double else 0.02)
        options = wall_positions(arrangement, spans, width, "middle" if double else "corner")
        options += wall_positions(arrangement, spans, model.width_m + 0.02, "any")
        for index, along in options[:10]:
            wall = arrangement.shell.walls[index]
            inset = slope_inset_m(arrangement, wall, model.height_m)
            if inset is None:
                continue
            x, z = wall_point(wall, along, model.depth_m, away + inset)
            snapshot = arrangement.snapshot()
            placed = arrangement.place(model, x, z, wall.facing_degrees())
            if placed is None:
                continue
            accessible = [_reserve_access(arrangement, placed, side) for side in (-1, 1)]
            if not any(accessible) or (double and attempt < 3 and arrangement.area_m2 > 11 and not all(accessible)):
                arrangement.restore(snapshot)
                continue
            _place_nightstands(arrangement, placed, double=double)
            if arrangement.chance(rug):
                _place_rug(arrangement, placed)
            if arrangement.chance(0.2):
                _place_bench(arrangement, placed)
            return placed
    return None


def _reserve_access(arrangement: Arrangement, placed: Piece, side: int) -> bool:
    """Reserve the floor along the lower part of a side; the nightstand stands at its upper part."""
    lower = 0.55 * 2 * placed.body.half_depth
    x, z = placed.body.to_plan(side * (placed.body.half_width + 0.26), placed.body.half_depth - lower / 2)
    return arrangement.reserve(Body.of(x, z, placed.degrees, width=0.5, depth=lower, low=0.0, high=1.9))


def _place_nightstands(arrangement: Arrangement, placed: Piece, *, double: bool) -> None:
    model = arrangement.pick("nightstand", width=(0.2, 0.8), depth=(0.2, 0.6), height=(0.25, 0.9))
    if model is None or arrangement.chance(0.06):
        return
    for side in arrangement.shuffled((-1, 1))[: 2 if double else 1]:
        gap = arrangement.uniform(0.02, 0.1)
        right = side * (placed.body.half_width + gap + model.width_m / 2)
        x, z = placed.body.to_plan(right, -placed.body.half_depth + model.depth_m / 2 + arrangement.uniform(0.0, 0.03))
        if arrangement.place(model, x, z, placed.degrees + arrangement.jitter(1.0)) is None and not double:
            x, z = placed.body.to_plan(-right, -placed.body.half_depth + model.depth_m / 2)
            arrangement.place(model, x, z, placed.degrees)


def _place_rug(arrangement: Arrangement, placed: Piece) -> None:
    beyond = placed.model.width_m + 0.9
    rug = arrangement.pick("rug", width=(1.0, beyond + 0.8), depth=(0.9, 2.6), height=(0.0, 0.05))
    if rug is None:
        return
    quarter = 90.0 if rug.depth_m > rug.width_m * 1.05 else 0.0
    reach = (rug.width_m if quarter else rug.depth_m) / 2
    x, z = placed.body.to_plan(0.0, placed.body.half_depth + 0.5 - reach)
    arrangement.place(rug, x, z, placed.degrees + quarter + arrangement.jitter(1.5), layer="flat")


def _place_bench(arrangement: Arrangement, placed: Piece) -> None:
    bench = arrangement.pick("bench", width=(0.5, placed.model.width_m), depth=(0.25, 0.6), height=(0.3, 0.9))
    if bench is not None:
        x, z = placed.body.to_plan(0.0, placed.body.half_depth + bench.depth_m / 2 + 0.06)
        arrangement.place(bench, x, z, placed.degrees + arrangement.jitter(1.0))
