"""Beds with what stands around them."""

from roomlight_generator.rooms.planner.arrangement import Layout, Piece
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.wall_space import at_wall, places, stretches, under_slope_m

DOUBLE_M = 1.25
"""A bed from that width is for two: both get out on their own side."""


def bed(layout: Layout, *, role: str = "bed", widest: float = 2.3, rug: float = 0.4) -> Piece | None:
    """A bed with its head against a wall, nightstands at its sides, sometimes a rug; the bed."""
    if layout.area_m2 < 10:
        widest = min(widest, 1.7)
    tries = ((widest, 2.0), (widest, 1.2), (min(widest, 1.7), 1.2), (1.2, 1.2), (1.2, 0.9), (widest, 0.86))
    for attempt, (largest, highest) in enumerate(tries):
        width, height = (0.5, largest), (0.1, highest)
        model = layout.pick(role, width=width, height=height) or layout.pick("bed", width=width, height=height)
        if model is None:
            continue
        double = model.width_m >= DOUBLE_M
        away = layout.between(0.01, 0.04)
        found = stretches(layout, model.depth_m + away, low=0.0, high=model.height_m, lower_walls=True)
        # Two want their head in the middle of a wall; a single bed stands in a corner.
        width = model.width_m + (0.9 if double else 0.02)
        options = places(layout, found, width, "middle" if double else "corner")
        options += places(layout, found, model.width_m + 0.02, "any")
        for index, along in options[:10]:
            wall = layout.shell.walls[index]
            inset = under_slope_m(layout, wall, model.height_m)
            if inset is None:
                continue
            x, z = at_wall(wall, along, model.depth_m, away + inset)
            mark = layout.mark()
            placed = layout.put(model, x, z, wall.facing_degrees())
            if placed is None:
                continue
            ways = [_way_out(layout, placed, side) for side in (-1, 1)]
            if not any(ways) or (double and attempt < 3 and layout.area_m2 > 11 and not all(ways)):
                layout.back_to(mark)
                continue
            _nightstands(layout, placed, double=double)
            if layout.chance(rug):
                _rug(layout, placed)
            if layout.chance(0.2):
                _bench(layout, placed)
            return placed
    return None


def _way_out(layout: Layout, placed: Piece, side: int) -> bool:
    """Free floor along the lower part of a side; nightstands stand behind it."""
    lower = 0.55 * 2 * placed.body.half_depth
    x, z = placed.body.out(side * (placed.body.half_width + 0.26), placed.body.half_depth - lower / 2)
    return layout.keep_free(Body.of(x, z, placed.degrees, width=0.5, depth=lower, low=0.0, high=1.9))


def _nightstands(layout: Layout, placed: Piece, *, double: bool) -> None:
    model = layout.pick("nightstand", width=(0.2, 0.8), depth=(0.2, 0.6), height=(0.25, 0.9))
    if model is None or layout.chance(0.06):
        return
    for side in layout.shuffled((-1, 1))[: 2 if double else 1]:
        gap = layout.between(0.02, 0.1)
        right = side * (placed.body.half_width + gap + model.width_m / 2)
        x, z = placed.body.out(right, -placed.body.half_depth + model.depth_m / 2 + layout.between(0.0, 0.03))
        if layout.put(model, x, z, placed.degrees + layout.wobble(1.0)) is None and not double:
            x, z = placed.body.out(-right, -placed.body.half_depth + model.depth_m / 2)
            layout.put(model, x, z, placed.degrees)


def _rug(layout: Layout, placed: Piece) -> None:
    beyond = placed.model.width_m + 0.9
    rug = layout.pick("rug", width=(1.0, beyond + 0.8), depth=(0.9, 2.6), height=(0.0, 0.05))
    if rug is None:
        return
    quarter = 90.0 if rug.depth_m > rug.width_m * 1.05 else 0.0
    reach = (rug.width_m if quarter else rug.depth_m) / 2
    x, z = placed.body.out(0.0, placed.body.half_depth + 0.5 - reach)
    layout.put(rug, x, z, placed.degrees + quarter + layout.wobble(1.5), layer="flat")


def _bench(layout: Layout, placed: Piece) -> None:
    bench = layout.pick("bench", width=(0.5, placed.model.width_m), depth=(0.25, 0.6), height=(0.3, 0.9))
    if bench is not None:
        x, z = placed.body.out(0.0, placed.body.half_depth + bench.depth_m / 2 + 0.06)
        layout.put(bench, x, z, placed.degrees + layout.wobble(1.0))
