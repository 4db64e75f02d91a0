"""Small things on top of furniture: lamps, books, vases, plates, screens."""

from typing import Final

import numpy as np

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.planner.arrangement import Layout, Piece

MARGIN_M: Final = 0.02
"""Between a thing and the edge of what it stands on."""

Weights = tuple[tuple[str, float], ...]

_DECORATION: Final[Weights] = (
    ("vase", 1.0), ("ornament", 1.5), ("small_plant", 1.0), ("book", 1.0), ("table_lamp", 0.6), ("electronics", 0.4),
)  # fmt: skip

THINGS: Final[dict[str, Weights]] = {
    "coffee_table": (("book", 1.5), ("vase", 0.7), ("small_plant", 0.7), ("tableware", 0.8), ("food", 0.7),
                     ("electronics", 0.5), ("ornament", 0.7), ("toy", 0.2)),
    "dining_table": (("tableware", 2.5), ("vase", 0.7), ("food", 1.2), ("small_plant", 0.6), ("book", 0.3)),
    "desk": (("book", 1.5), ("stationery", 2.0), ("electronics", 0.8), ("tableware", 0.6), ("small_plant", 0.6),
             ("ornament", 0.4), ("table_lamp", 0.4)),
    "side_table": (("book", 1.0), ("tableware", 0.7), ("small_plant", 0.8), ("vase", 0.7), ("ornament", 0.6)),
    "nightstand": (("book", 1.2), ("electronics", 0.8), ("tableware", 0.5), ("small_plant", 0.4), ("ornament", 0.5)),
    "sideboard": _DECORATION,
    "dresser": _DECORATION,
    "tv_stand": (("ornament", 1.0), ("electronics", 1.5), ("small_plant", 0.7), ("book", 0.6), ("vase", 0.6)),
    "bookcase": (("ornament", 1.0), ("small_plant", 1.0), ("vase", 0.8), ("book", 1.2)),
    "wardrobe": (("ornament", 0.2), ("book", 0.3)),
    "piano": (("ornament", 1.0), ("book", 1.0), ("table_lamp", 0.7), ("vase", 0.6)),
    "fireplace": (("ornament", 1.5), ("vase", 1.0), ("small_plant", 0.5)),
    "kitchen_unit": (("kitchen_appliance", 1.6), ("tableware", 1.4), ("food", 1.2), ("small_plant", 0.3),
                     ("vase", 0.3)),
    "dishwasher": (("kitchen_appliance", 1.0), ("tableware", 1.0), ("food", 0.7)),
    "oven": (("tableware", 0.5),),
    "fridge": (("food", 0.2),),
    "washbasin": (("bathroom_thing", 1.0),),
    "washing_machine": (("bathroom_thing", 1.0),),
    "bathtub": (),
    "wall_shelf": (("book", 1.5), ("ornament", 1.2), ("small_plant", 0.8), ("vase", 0.6)),
}  # fmt: skip
"""What stands on what, by relative frequency."""

PER_M2: Final[dict[str, float]] = {
    "coffee_table": 4.0, "dining_table": 3.5, "desk": 4.0, "side_table": 5.0, "nightstand": 6.0, "sideboard": 4.5,
    "dresser": 4.0, "tv_stand": 2.5, "bookcase": 4.0, "wardrobe": 0.6, "piano": 2.0, "fireplace": 6.0,
    "kitchen_unit": 3.0, "dishwasher": 2.0, "oven": 1.0, "fridge": 0.5, "washbasin": 7.0, "washing_machine": 4.0,
    "wall_shelf": 14.0,
}  # fmt: skip
"""How many things on a square metre in a room of middling clutter."""

HIGHEST_M: Final = 2.1
"""Nothing is put on what is higher."""


def dress_tops(layout: Layout) -> None:
    """Screens and lamps where they belong, then small things as the clutter wants."""
    supports = [piece for piece in layout.pieces if piece.model.top_m is not None]
    for support in supports:
        if support.role == "desk":
            _screen(layout, support)
    _lamps(layout, supports)
    for support in layout.shuffled(supports):
        _small_things(layout, support)


def put_on(
    layout: Layout, support: Piece, model: FurnitureModel | None, right: float, front: float, turn: float
) -> Piece | None:
    """On the support at an offset from its middle, wholly over its footprint; None where it does not fit."""
    top = support.model.top_m
    if model is None or top is None:
        return None
    x, z = support.body.out(right, front)
    placed = layout.put(
        model, x, z, support.degrees + turn, y=support.placement.y + top, layer="top", ignore=(support.body,)
    )
    if placed is None:
        return None
    for corner in placed.body.corners():
        side, depth = support.body.into(*corner)
        if abs(side) > support.body.half_width - MARGIN_M / 2 or abs(depth) > support.body.half_depth - MARGIN_M / 2:
            layout.pieces.remove(placed)
            return None
    return placed


def _screen(layout: Layout, support: Piece) -> None:
    """A computer or a laptop that faces whoever sits before the desk."""
    width, depth = support.model.width_m, support.model.depth_m

    def pick(role: str) -> FurnitureModel | None:
        return layout.pick(role, width=(0.1, width - 0.05), depth=(0.05, depth - 0.05), height=(0.0, 0.7))

    kind = layout.rng.random()
    if kind < 0.85:
        model = pick("laptop" if kind < 0.4 else "computer") or pick("laptop")
        if model is None:
            return
        slack = (depth - model.depth_m) / 2 - MARGIN_M
        front = -slack * layout.between(0.5, 0.95) if model.role == "computer" else slack * layout.between(-0.1, 0.7)
        side = max((width - model.width_m) / 2 - MARGIN_M - 0.03, 0.0)
        put_on(layout, support, model, layout.between(-0.4, 0.4) * side, front, layout.wobble(4))


def _lamps(layout: Layout, supports: list[Piece]) -> None:
    """Table lamps by beds (a pair of the same), on desks, side tables, sideboards, reading tables."""
    shares = {"nightstand": 0.75, "side_table": 0.5, "desk": 0.45, "sideboard": 0.25, "dresser": 0.25, "tv_stand": 0.08}
    by_bed = layout.pick("table_lamp", width=(0.05, 0.45), depth=(0.05, 0.45), height=(0.1, 0.7))
    pair = layout.chance(shares["nightstand"])
    for support in supports:
        model = by_bed
        if support.role == "nightstand":
            if not pair:
                continue
        elif not layout.chance(shares.get(support.role, 0.0)):
            continue
        else:
            model = layout.pick("table_lamp", width=(0.05, 0.6), depth=(0.05, 0.6), height=(0.1, 0.8))
        if model is None:
            continue
        _somewhere(layout, support, model, edge=support.role == "desk")


def _somewhere(layout: Layout, support: Piece, model: FurnitureModel, *, edge: bool = False) -> Piece | None:
    turn = layout.wobble(18) if model.role not in ("food", "vase", "small_plant") else layout.between(0, 360)
    half = max(model.width_m, model.depth_m) / 2 if abs(turn) > 36 else model.width_m / 2
    side = support.body.half_width - half - MARGIN_M
    depth = support.body.half_depth - model.depth_m / 2 - MARGIN_M
    if side < 0 or depth < 0:
        return None
    for _ in range(4):
        right = layout.between(-side, side)
        if edge:
            right = side * layout.between(0.8, 1.0) * (1 if layout.chance(0.5) else -1)
        front = layout.between(-depth, depth) if not edge else -depth * layout.between(0.4, 1.0)
        placed = put_on(layout, support, model, right, front, turn)
        if placed is not None:
            return placed
    return None


def _small_things(layout: Layout, support: Piece) -> None:
    kinds = THINGS.get(support.role, ())
    if kinds and layout.having("child_bed", "floor_toy"):
        kinds = (*kinds, ("toy", 2.5))
    model = support.model
    if "sink" in f"{model.id} {model.name}".lower():
        return
    if not kinds or support.placement.y + (model.top_m or 0.0) > HIGHEST_M:
        return
    area = model.width_m * model.depth_m
    number = min(layout.count(PER_M2.get(support.role, 2.0) * area * 2.2 * layout.clutter), 9)
    weights = np.array([weight for _, weight in kinds])
    shares = weights / weights.sum()
    tallest = 0.6 if support.role not in ("coffee_table", "dining_table") else 0.45
    for _ in range(number):
        role = kinds[int(layout.rng.choice(len(kinds), p=shares))][0]
        widest, deepest = min(model.width_m - 0.04, 0.7), min(model.depth_m - 0.04, 0.7)
        thing = layout.pick(role, width=(0.0, widest), depth=(0.0, deepest), height=(0.0, tallest))
        if thing is not None:
            _somewhere(layout, support, thing)
