"""Classify a library model: its role in a room, or None (cars, trees, road signs, swimming pools).

Words of the name decide, then the tags, in the order of `models.toml`, which also lists the models that their words
misclassify. The roles of all 820 models of the Debian libraries were checked by eye.
"""

import re
from typing import Final

from roomlight_generator.rooms.furniture.exceptions import EXCLUDED, MODELS, ROLE_OF
from roomlight_generator.rooms.furniture.files.sh3f import LibraryEntry
from roomlight_generator.rooms.roles import CEILING_ROLES, FLAT_ROLES, FLOOR_ROLES, OPENING_ROLES, TOP_ROLES, WALL_ROLES

_OUTDOORS: Final = frozenset({"vehicles", "exterior", "staircases", "garden", "road", "outdoor"})
"""Excluded categories, except for the models that `exceptions` lists."""

_PATTERNS: Final = tuple((role, re.compile(rf"\b(?:{words})\b")) for role, words in MODELS["keywords"].items())
"""Roles and their keywords, whole words only. The first match counts."""

_LIMITS_M: Final[dict[str, tuple[float, float]]] = MODELS["heights_m"]
_SURFACE_ROLES: Final = frozenset(MODELS["surfaces"].split())
_ELEVATIONS_M: Final[dict[str, float]] = MODELS["elevations_m"]

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
