"""Small objects on top of furniture: lamps, books, vases, plates, screens."""

from typing import Final

import numpy as np

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.planner.arrangement import Arrangement, Piece

MARGIN_M: Final = 0.02
"""Margin between an object and the edge of its support."""

Weights = tuple[tuple[str, float], ...]

_DECORATION: Final[Weights] = (
    ("vase", 1.0), ("ornament", 1.5), ("small_plant", 1.0), ("book", 1.0), ("table_lamp", 0.6), ("electronics", 0.4),
)  # fmt: skip

TOP_ROLE_WEIGHTS: Final[dict[str, Weights]] = {
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
"""Roles on top of each role, with relative frequencies."""

OBJECTS_PER_M2: Final[dict[str, float]] = {
    "coffee_table": 4.0, "dining_table": 3.5, "desk": 4.0, "side_table": 5.0, "nightstand": 6.0, "sideboard": 4.5,
    "dresser": 4.0, "tv_stand": 2.5, "bookcase": 4.0, "wardrobe": 0.6, "piano": 2.0, "fireplace": 6.0,
    "kitchen_unit": 3.0, "dishwasher": 2.0, "oven": 1.0, "fridge": 0.5, "washbasin": 7.0, "washing_machine": 4.0,
    "wall_shelf": 14.0,
}  # fmt: skip
"""Mean number of objects per square metre at medium clutter."""

MAX_SUPPORT_HEIGHT_M: Final = 2.1
"""Maximum height of a support."""


def place_on_tops(arrangement: Arrangement) -> None:
    """Place screens and lamps, then small objects in proportion to the clutter."""
    supports = [piece for piece in arrangement.pieces if piece.model.top_m is not None]
    for support in supports:
        if support.role == "desk":
            _place_screen(arrangement, support)
    _place_lamps(arrangement, supports)
    for support in arrangement.shuffled(supports):
        _place_small_objects(arrangement, support)


def place_on(
    arrangement: Arrangement, support: Piece, model: FurnitureModel | None, right: float, front: float, yaw: float
) -> Piece | None:
    """Place a model on a support at an offset from its centre, entirely over its footprint; None if it does not fit."""
    top = support.model.top_m
    if model is None or top is None:
        return None
    x, z = support.body.to_plan(right, front)
    placed = arrangement.place(
        model, x, z, support.degrees + yaw, y=support.placement.y + top, layer="top", ignore=(support.body,)
    )
    if placed is None:
        return None
    for corner in placed.body.corners():
        side, depth = support.body.to_local(*corner)
        if abs(side) > support.body.half_width - MARGIN_M / 2 or abs(depth) > support.body.half_depth - MARGIN_M / 2:
            arrangement.pieces.remove(placed)
            return None
    return placed


def _place_screen(arrangement: Arrangement, support: Piece) -> None:
    """Place a computer or a laptop that faces the desk's user."""
    width, depth = support.model.width_m, support.model.depth_m

    def pick(role: str) -> FurnitureModel | None:
        return arrangement.pick(role, width=(0.1, width - 0.05), depth=(0.05, depth - 0.05), height=(0.0, 0.7))

    kind = arrangement.rng.random()
    if kind < 0.85:
        model = pick("laptop" if kind < 0.4 else "computer") or pick("laptop")
        if model is None:
            return
        slack = (depth - model.depth_m) / 2 - MARGIN_M
        front = (
            -slack * arrangement.uniform(0.5, 0.95)
            if model.role == "computer"
            else slack * arrangement.uniform(-0.1, 0.7)
        )
        side = max((width - model.width_m) / 2 - MARGIN_M - 0.03, 0.0)
        place_on(arrangement, support, model, arrangement.uniform(-0.4, 0.4) * side, front, arrangement.jitter(4))


def _place_lamps(arrangement: Arrangement, supports: list[Piece]) -> None:
    """Place table lamps by beds (a matching pair), on desks, side tables, sideboards, reading tables."""
    shares = {"nightstand": 0.75, "side_table": 0.5, "desk": 0.45, "sideboard": 0.25, "dresser": 0.25, "tv_stand": 0.08}
    by_bed = arrangement.pick("table_lamp", width=(0.05, 0.45), depth=(0.05, 0.45), height=(0.1, 0.7))
    pair = arrangement.chance(shares["nightstand"])
    for support in supports:
        model = by_bed
        if support.role == "nightstand":
            if not pair:
                continue
        elif not arrangement.chance(shares.get(support.role, 0.0)):
            continue
        else:
            model = arrangement.pick("table_lamp", width=(0.05, 0.6), depth=(0.05, 0.6), height=(0.1, 0.8))
        if model is None:
            continue
        _place_randomly(arrangement, support, model, edge=support.role == "desk")


def _place_randomly(arrangement: Arrangement, support: Piece, model: FurnitureModel, *, edge: bool = False) -> None:
    yaw = arrangement.jitter(18) if model.role not in ("food", "vase", "small_plant") else arrangement.uniform(0, 360)
    half = max(model.width_m, model.depth_m) / 2 if abs(yaw) > 36 else model.width_m / 2
    side = support.body.half_width - half - MARGIN_M
    depth = support.body.half_depth - model.depth_m / 2 - MARGIN_M
    if side < 0 or depth < 0:
        return
    for _ in range(4):
        right = arrangement.uniform(-side, side)
        if edge:
            right = side * arrangement.uniform(0.8, 1.0) * (1 if arrangement.chance(0.5) else -1)
        front = arrangement.uniform(-depth, depth) if not edge else -depth * arrangement.uniform(0.4, 1.0)
        if place_on(arrangement, support, model, right, front, yaw) is not None:
            return


def _place_small_objects(arrangement: Arrangement, support: Piece) -> None:
    kinds = TOP_ROLE_WEIGHTS.get(support.role, ())
    if kinds and arrangement.with_roles("child_bed", "floor_toy"):
        kinds = (*kinds, ("toy", 2.5))
    model = support.model
    if "sink" in f"{model.id} {model.name}".lower():
        return
    if not kinds or support.placement.y + (model.top_m or 0.0) > MAX_SUPPORT_HEIGHT_M:
        return
    area = model.width_m * model.depth_m
    number = min(arrangement.poisson(OBJECTS_PER_M2.get(support.role, 2.0) * area * 2.2 * arrangement.clutter), 9)
    weights = np.array([weight for _, weight in kinds])
    shares = weights / weights.sum()
    tallest = 0.6 if support.role not in ("coffee_table", "dining_table") else 0.45
    for _ in range(number):
        role = kinds[int(arrangement.rng.choice(len(kinds), p=shares))][0]
        widest, deepest = min(model.width_m - 0.04, 0.7), min(model.depth_m - 0.04, 0.7)
        item = arrangement.pick(role, width=(0.0, widest), depth=(0.0, deepest), height=(0.0, tallest))
        if item is not None:
            _place_randomly(arrangement, support, item)
