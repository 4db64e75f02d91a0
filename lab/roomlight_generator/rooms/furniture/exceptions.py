"""Models that keyword classification gets wrong, by id, from `models.toml`."""

from pathlib import Path
from typing import Any, Final

from roomlight_generator.rooms.tables import read_table

MODELS: Final[dict[str, Any]] = read_table(Path(__file__).with_name("models.toml"))
"""The whole table; its comments say what the parts are."""

_LIBRARIES: Final = {
    "B0": "Blend Swap CC-0", "BY": "Blend Swap CC-BY", "K": "Kator Legaz", "R": "Reallusion", "S": "Scopia"
}  # fmt: skip


def _ids(text: str) -> list[str]:
    """Expand abbreviated ids to the libraries' ids: `S:tv K:fluorescent` to `Scopia#tv`, `Kator Legaz#fluorescent`."""
    parts = [word.partition(":") for word in text.split()]
    return [f"{_LIBRARIES[library]}#{name}" for library, _, name in parts]


ROLE_OF: Final[dict[str, str]] = {identity: role for role, text in MODELS["roles"].items() for identity in _ids(text)}

EXCLUDED: Final = frozenset(_ids(MODELS["excluded"]))
"""Models without a role although their keywords match that of a role."""

KIND_OF: Final[dict[str, dict[str, str]]] = {_ids(key)[0]: kinds for key, kinds in MODELS["kinds"].items()}
"""Kinds of model parts (see `materials.make_material`), by the name of their material."""

_OFFSET_M: Final[tuple[float, float, float]] = MODELS["bulb_offset_m"]
LIGHT_OFFSETS_M: Final = dict.fromkeys(_ids(MODELS["sunk_bulbs"]), _OFFSET_M)
"""Offsets, in metres, that move enclosed bulbs out of their sockets."""
