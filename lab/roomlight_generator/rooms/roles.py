"""Furniture roles: the categories shared by the furniture library and the room planner."""

from typing import Final

FLOOR_ROLES: Final = (
    "sofa", "armchair", "chair", "office_chair", "stool", "bench", "dining_table", "coffee_table", "side_table",
    "desk", "bed", "child_bed", "nightstand", "wardrobe", "dresser", "bookcase", "sideboard", "tv_stand",
    "kitchen_unit", "oven", "fridge", "dishwasher", "washing_machine", "bathtub", "shower", "toilet", "washbasin",
    "radiator", "floor_lamp", "plant", "piano", "fireplace", "person", "pet", "floor_toy", "floor_clutter", "exercise",
)  # fmt: skip
"""Roles that stand on the floor. floor_clutter: boxes, baskets, bins, bags; exercise: bikes, treadmills, game
tables."""

WALL_ROLES: Final = (
    "wall_unit", "hood", "wall_shelf", "wall_lamp", "picture", "mirror", "clock", "wall_television", "air_conditioner",
    "towel_rack", "whiteboard", "wall_clutter",
)  # fmt: skip
"""Roles that hang on a wall at their own elevation, back against it."""

CEILING_ROLES: Final = ("ceiling_lamp", "ceiling_fan")
"""Roles that hang from the ceiling: their top touches it."""

TOP_ROLES: Final = (
    "television", "computer", "laptop", "table_lamp", "small_plant", "vase", "book", "tableware", "food",
    "kitchen_appliance", "electronics", "toy", "bathroom_thing", "ornament", "stationery",
)  # fmt: skip
"""Roles that stand on top of other furniture."""

LAMP_ROLES: Final = ("ceiling_lamp", "floor_lamp", "table_lamp", "wall_lamp")

FLAT_ROLES: Final = ("rug",)
"""Roles that lie flat on the floor and block nothing."""

OPENING_ROLES: Final = ("door", "window", "curtain")

ROLES: Final = (*FLOOR_ROLES, *WALL_ROLES, *CEILING_ROLES, *TOP_ROLES, *FLAT_ROLES, *OPENING_ROLES)
