"""All procedural models: their kinds, the role of each kind, the number of variants."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final
from zlib import crc32

import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.props import (
    bathroom,
    beds,
    ceiling_lamps,
    fireplaces,
    floor_objects,
    kitchen,
    lamps,
    pianos,
    plants,
    rugs,
    screens,
    seating,
    small_objects,
    storage,
    tables,
    tabletop_objects,
    wall_objects,
)
from roomlight_generator.rooms.props.draft import Draft, Maker, scaled_to_size
from roomlight_generator.rooms.scene import Mesh

_SPLIT_KEYS: Final[dict[Split, int]] = {"train": 1, "test": 2}


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of model. Members of a family share their random numbers variant by variant, which makes kitchen units
    match."""

    name: str
    role: str
    make: Maker
    variants: int = 8
    family: str | None = None


def _kitchen() -> list[Kind]:
    kinds = [
        Kind(f"kitchen_unit-{what}-{cm}", "kitchen_unit", partial(kitchen.kitchen_unit, cm / 100, what), 6, "kitchen")
        for what, cm in (("drawers", 60), ("drawers", 80), ("doors", 60), ("doors", 80), ("sink", 80))
    ]
    kinds += [
        Kind(f"wall_unit-{what}-{cm}", "wall_unit", partial(kitchen.wall_unit, cm / 100, what), 6, "kitchen")
        for what, cm in (("doors", 60), ("doors", 80), ("glass", 80), ("open", 60))
    ]
    makers: Sequence[tuple[str, Maker]] = (
        ("oven", kitchen.oven),
        ("dishwasher", kitchen.dishwasher),
        ("fridge", kitchen.fridge),
        ("hood", kitchen.hood),
    )
    return kinds + [Kind(name, name, make, 6, "kitchen") for name, make in makers]


KINDS: Final[tuple[Kind, ...]] = (
    Kind("sofa", "sofa", seating.sofa, 12),
    Kind("armchair", "armchair", seating.armchair, 12),
    Kind("chair", "chair", seating.chair, 14),
    Kind("office_chair", "office_chair", seating.office_chair, 6),
    Kind("stool", "stool", seating.stool),
    Kind("bench", "bench", seating.bench, 6),
    Kind("dining_table", "dining_table", tables.dining_table, 12),
    Kind("coffee_table", "coffee_table", tables.coffee_table, 12),
    Kind("side_table", "side_table", tables.side_table),
    Kind("desk", "desk", tables.desk, 10),
    Kind("nightstand", "nightstand", tables.nightstand),
    Kind("bed", "bed", beds.bed, 12),
    Kind("child_bed", "child_bed", beds.child_bed),
    Kind("wardrobe", "wardrobe", storage.wardrobe, 10),
    Kind("dresser", "dresser", storage.dresser),
    Kind("bookcase", "bookcase", storage.bookcase, 12),
    Kind("sideboard", "sideboard", storage.sideboard),
    Kind("tv_stand", "tv_stand", storage.tv_stand),
    *_kitchen(),
    Kind("washing_machine", "washing_machine", bathroom.washing_machine, 5),
    Kind("bathtub", "bathtub", bathroom.bathtub, 6),
    Kind("shower", "shower", bathroom.shower, 6),
    Kind("toilet", "toilet", bathroom.toilet, 6),
    Kind("washbasin", "washbasin", bathroom.washbasin),
    Kind("towel_rack", "towel_rack", bathroom.towel_rack, 6),
    Kind("radiator", "radiator", bathroom.radiator, 6),
    Kind("bathroom_thing", "bathroom_thing", small_objects.bathroom_thing),
    Kind("floor_lamp", "floor_lamp", lamps.floor_lamp, 12),
    Kind("table_lamp", "table_lamp", lamps.table_lamp, 12),
    Kind("wall_lamp", "wall_lamp", lamps.wall_lamp, 10),
    Kind("flush_dome", "ceiling_lamp", ceiling_lamps.flush_dome, 6),
    Kind("pendant", "ceiling_lamp", ceiling_lamps.pendant, 12),
    Kind("pendant_row", "ceiling_lamp", ceiling_lamps.pendant_row, 5),
    Kind("chandelier", "ceiling_lamp", ceiling_lamps.chandelier, 6),
    Kind("track", "ceiling_lamp", ceiling_lamps.track, 6),
    Kind("batten", "ceiling_lamp", ceiling_lamps.batten, 5),
    Kind("panel", "ceiling_lamp", ceiling_lamps.panel, 8),
    Kind("downlight", "ceiling_lamp", ceiling_lamps.downlight, 4),
    Kind("downlights", "ceiling_lamp", ceiling_lamps.downlights, 6),
    Kind("ceiling_fan", "ceiling_fan", ceiling_lamps.ceiling_fan, 6),
    Kind("plant", "plant", plants.plant, 14),
    Kind("small_plant", "small_plant", plants.small_plant, 14),
    Kind("television", "television", screens.television),
    Kind("wall_television", "wall_television", screens.wall_television, 6),
    Kind("computer", "computer", screens.computer),
    Kind("laptop", "laptop", screens.laptop, 5),
    Kind("electronics", "electronics", screens.electronics, 10),
    Kind("vase", "vase", small_objects.vase, 12),
    Kind("book", "book", small_objects.book, 12),
    Kind("ornament", "ornament", small_objects.ornament, 12),
    Kind("stationery", "stationery", small_objects.stationery),
    Kind("toy", "toy", small_objects.toy, 10),
    Kind("tableware", "tableware", tabletop_objects.tableware, 10),
    Kind("food", "food", tabletop_objects.food, 10),
    Kind("kitchen_appliance", "kitchen_appliance", tabletop_objects.kitchen_appliance, 10),
    Kind("picture", "picture", wall_objects.picture, 24),
    Kind("mirror", "mirror", wall_objects.mirror),
    Kind("clock", "clock", wall_objects.clock),
    Kind("wall_shelf", "wall_shelf", wall_objects.wall_shelf, 10),
    Kind("whiteboard", "whiteboard", wall_objects.whiteboard, 6),
    Kind("air_conditioner", "air_conditioner", wall_objects.air_conditioner, 5),
    Kind("wall_clutter", "wall_clutter", wall_objects.wall_clutter, 10),
    Kind("rug", "rug", rugs.rug, 24),
    Kind("floor_clutter", "floor_clutter", floor_objects.floor_clutter, 14),
    Kind("floor_toy", "floor_toy", floor_objects.floor_toy, 10),
    Kind("exercise", "exercise", floor_objects.exercise),
    Kind("piano", "piano", pianos.piano, 6),
    Kind("fireplace", "fireplace", fireplaces.fireplace),
)


def procedural_models(split: Split, *, variants: int | None = None) -> tuple[FurnitureModel, ...]:
    """Return every variant of every kind for a split; `variants` overrides the number of variants of each kind.

    The id, "procedural/<kind>/<split><number>", alone determines a model: the same id gives a byte-identical mesh.
    Kitchen units, wall units and kitchen appliances of one number match. Meshes are built on demand.
    """
    return tuple(
        _model(kind, split, number)
        for kind in KINDS
        for number in range(kind.variants if variants is None else variants)
    )


def build_draft(kind: Kind, split: Split, number: int) -> Draft:
    """Draw one variant, its mesh not yet built or scaled to its size. `build` may be called once."""
    seed = [crc32((kind.family or kind.name).encode()), _SPLIT_KEYS[split], number]
    return kind.make(np.random.default_rng(seed))


def _load(kind: Kind, split: Split, number: int) -> Mesh:
    draft = build_draft(kind, split, number)
    return scaled_to_size(draft.build(), draft.size)


def _model(kind: Kind, split: Split, number: int) -> FurnitureModel:
    draft = build_draft(kind, split, number)
    width, height, depth = draft.size
    return FurnitureModel(
        id=f"procedural/{kind.name}/{split}{number}",
        name=draft.name,
        role=kind.role,
        split=split,
        width_m=float(width),
        height_m=float(height),
        depth_m=float(depth),
        load=partial(_load, kind, split, number),
        elevation_m=float(draft.elevation_m),
        top_m=None if draft.top_m is None else float(draft.top_m),
        lights=draft.lights,
    )
