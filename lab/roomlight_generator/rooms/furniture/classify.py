"""Classify a library model: its role in a room, or None (cars, trees, road signs, swimming pools).

Words of the name decide, then the tags, each in the order of `_WORDS`; models that their words misclassify are listed
in `exceptions`. The roles of all 820 models of the Debian libraries were checked by eye.
"""

import re
from typing import Final

from roomlight_generator.rooms.furniture.exceptions import EXCLUDED, ROLE_OF
from roomlight_generator.rooms.furniture.files.sh3f import LibraryEntry
from roomlight_generator.rooms.roles import CEILING_ROLES, FLAT_ROLES, FLOOR_ROLES, OPENING_ROLES, TOP_ROLES, WALL_ROLES

_OUTDOORS: Final = frozenset({"vehicles", "exterior", "staircases", "garden", "road", "outdoor"})
"""Excluded categories, except for the models that `exceptions` lists."""

_WORDS: Final[tuple[tuple[str, str], ...]] = (
    ("pet", r"cat|dog|bulldog|siamese|rabbit|puppy|kitten"),
    ("person", r"human|female|male|people|woman|man"),
    ("ceiling_fan", r"ceiling fan"),
    ("ceiling_lamp", r"ceiling (lamp|light)|pendant|hanging (light|lamp)|chandelier|ceiling spot"),
    ("wall_lamp", r"wall (lamp|light|spot\w*)|sconce|track lights?"),
    ("floor_lamp", r"floor lamp|standing lamp"),
    ("table_lamp", r"(desk|table|little|bedside|vase)? ?lamp|lantern|candle"),
    ("towel_rack", r"towel rack|towel rail"),
    ("oven", r"oven|stove|range cooker"),
    ("hood", r"(range |kitchen )?hood"),
    ("dishwasher", r"dish ?washer"),
    ("washing_machine", r"(clothes )?washing machine|dryer machine|tumble dryer|dryer"),
    ("fridge", r"fridge|refrigerator|freezer"),
    ("bathtub", r"bath ?tub|bath|corner bathtub|island bath"),
    ("shower", r"shower (stall|cabin|cubicle|tray|door)|shower"),
    ("toilet", r"toilets? unit|toilet|bidet|wc"),
    ("washbasin", r"wash ?basin|vanity|lavatory|pedestal sink"),
    ("radiator", r"radiator|convector"),
    ("bathroom_thing", r"soap|sponge|comb|brush|towel|tissue|toilet paper|medicine|makeup|cosmetics|flacon|lotion"),
    ("child_bed", r"child bed|bunk bed|baby bed|crib|cot|mezzanine bed"),
    ("nightstand", r"bedside table|nightstand|night table"),
    ("wardrobe", r"wardrobe|closet"),
    ("bed", r"bed|futon"),
    ("piano", r"piano"),
    ("office_chair", r"office chair|desk chair|swivel chair"),
    ("sofa", r"sofa|couch|day bed|loveseat|settee"),
    ("armchair", r"arm ?chair|ottoman armchair|recliner"),
    ("stool", r"(bar )?stool|bar chair|pouf|puff"),
    ("bench", r"bench"),
    ("chair", r"chair|seat"),
    ("tv_stand", r"tv stand|television cabinet|tv cabinet"),
    ("coffee_table", r"coffee table|low table"),
    ("side_table", r"side table|end table|console"),
    ("desk", r"desk|writing table"),
    ("dining_table", r"table"),
    ("bookcase", r"bookcase|book ?shel\w+|shelves|shelving"),
    ("dresser", r"dresser|chest|commode|changing table|drawers?"),
    ("sideboard", r"sideboard|buffet|cupboard"),
    ("wall_shelf", r"wall shelf|shelf"),
    ("wall_unit", r"upper \w*"),
    ("kitchen_unit", r"(lower|base|sink|drawers|corner|kitchen) cabinet|sink|worktop|island"),
    ("fireplace", r"fireplace|chimney"),
    ("rug", r"rug|carpet|bath ?mat|door ?mat"),
    ("curtain", r"curtains?"),
    ("wall_television", r"wall (flat )?tv"),
    ("television", r"tv|television"),
    ("laptop", r"laptop|notebook"),
    ("computer", r"computer|imac|monitor|desktop"),
    ("clock", r"wall clock|cuckoo clock"),
    ("mirror", r"mirror"),
    ("picture", r"painting|picture|poster"),
    ("air_conditioner", r"air condition\w*"),
    ("whiteboard", r"white ?board|blackboard"),
    ("exercise", r"treadmill|fitness|indoor bike|table tennis|pool table|billiard|football table|pinball"),
    ("vase", r"vase|pottery|jar"),
    ("plant", r"plant|bonsai|cactus|flowers?|bamboo|ficus|yucca|tulips?|orchids?|lily"),
    ("toy", r"toy|doll|teddy|puzzle|rubik|game|kid"),
    ("kitchen_appliance", r"microwave|toaster|kettle|blender|mixer|coffee (maker|machine|brewer|press)|boiler|cooker"),
    ("tableware", r"plates?|cup|mug|bowl|fork|knife|spoon|bottle|pan|teapot|tray|cutlery|glass|glasses"),
    ("food", r"food|bread|fruits?|cake|apples?"),
    ("electronics", r"radio|speaker|stereo|hifi|amplifier|phone|tablet|camera|printer|console|electronics"),
    ("book", r"books?|newspaper|magazine"),
    ("stationery", r"pencil|pen|stapler|ruler|scissors|calendar|letter tray"),
    ("floor_clutter", r"box|basket|bin|trash|bag|suitcase|backpack|crate|dustbin"),
    ("ornament", r"decoration|statue|ornament|gift"),
)
"""Roles and their keywords, whole words only. The first match counts."""

_PATTERNS: Final = tuple((role, re.compile(rf"\b(?:{words})\b")) for role, words in _WORDS)

_LIMITS_M: Final[dict[str, tuple[float, float]]] = {"person": (0.25, 2.2), "pet": (0.1, 1.3), "rug": (0.003, 0.12)}
"""Plausible heights of roles; a model outside them does not get the role."""

_SURFACE_ROLES: Final = frozenset(
    {"dining_table", "coffee_table", "side_table", "desk", "nightstand", "dresser", "bookcase", "sideboard", "tv_stand",
     "kitchen_unit", "piano", "fireplace", "wall_shelf", "washing_machine", "dishwasher", "fridge", "washbasin",
     "bench", "wall_unit"}
)  # fmt: skip
"""Roles that objects may stand on. Sofa seats and bed covers stay free, although library catalogues allow objects on
them."""

_ELEVATIONS_M: Final[dict[str, float]] = {
    "wall_unit": 1.45,
    "hood": 1.6,
    "wall_shelf": 1.3,
    "wall_lamp": 1.65,
    "picture": 1.3,
    "mirror": 1.1,
    "clock": 1.7,
    "wall_television": 1.0,
    "air_conditioner": 2.05,
    "towel_rack": 0.9,
    "whiteboard": 0.9,
    "wall_clutter": 1.2,
}
"""Default elevation of roles that hang, if the library gives none."""

_HUNG_FLOOR_ROLES: Final = frozenset({"washbasin", "toilet", "radiator", "shower"})
"""Roles that stand on the floor or hang close above it; all other floor roles stand on it."""


def role_of(entry: LibraryEntry) -> str | None:
    """Return the role of a model, or None if it does not belong in a room."""
    if entry.id in EXCLUDED:
        return None
    if entry.id in ROLE_OF:
        return ROLE_OF[entry.id]
    if entry.opening:
        return _opening(entry)
    if entry.category.lower() in _OUTDOORS or entry.category.lower().startswith("doors"):
        return None
    for text in (entry.name, ", ".join(entry.tags), entry.category):
        for role, pattern in _PATTERNS:
            if pattern.search(text.lower()) and _believable(role, entry):
                return _by_size(role, entry)
    return None


def has_surface(role: str, entry: LibraryEntry) -> bool:
    """Return whether objects may stand on it; not if it has a sink."""
    return role in _SURFACE_ROLES and "sink" not in entry.words


def elevation_m(role: str, entry: LibraryEntry) -> float:
    """Return the height of its bottom over the floor."""
    if role in WALL_ROLES:
        return entry.elevation_m or _ELEVATIONS_M[role]
    return entry.elevation_m if role in _HUNG_FLOOR_ROLES or role in OPENING_ROLES else 0.0


def _opening(entry: LibraryEntry) -> str | None:
    if max(entry.width_m, entry.height_m) > 2.6 or entry.depth_m > 0.5:
        return None
    text = f"{entry.name} {' '.join(entry.tags)}".lower()
    if "elevator" in text or "garage" in text:
        return None
    return "window" if "window" in text or entry.elevation_m > 0.3 else "door"


def _believable(role: str, entry: LibraryEntry) -> bool:
    """Return whether its size is plausible for the role: this excludes toy cars and dolls."""
    low, high = _LIMITS_M.get(role, (0.0, 2.6))
    if not low <= entry.height_m <= high or max(entry.width_m, entry.depth_m) > 4.2:
        return False
    if role in FLOOR_ROLES:
        return max(entry.width_m, entry.depth_m, entry.height_m) > 0.22
    if role in TOP_ROLES:
        return max(entry.width_m, entry.depth_m) < 1.3
    return role in WALL_ROLES or role in CEILING_ROLES or role in FLAT_ROLES or role in OPENING_ROLES


def _by_size(role: str, entry: LibraryEntry) -> str:
    """Return the role among those that differ by size alone."""
    height = entry.height_m
    if role == "plant" and height < 0.55:
        return "small_plant"
    if role == "table_lamp" and (height > 1.0 or entry.elevation_m > 0):
        return "floor_lamp" if not entry.elevation_m else ("ceiling_lamp" if entry.elevation_m > 1.6 else "wall_lamp")
    if role == "dining_table" and height < 0.58:
        return "coffee_table" if max(entry.width_m, entry.depth_m) > 0.6 else "side_table"
    if role == "dining_table" and max(entry.width_m, entry.depth_m) < 0.56:
        return "side_table"
    if role == "toy" and max(entry.width_m, entry.depth_m, height) > 0.45:
        return "floor_toy"
    if role == "vase" and height > 0.7:
        return "plant"
    return role
