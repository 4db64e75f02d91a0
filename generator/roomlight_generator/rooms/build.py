"""A whole room from a seed: type, finishes, shell, furniture, light."""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.finishes import RECOLOURABLE_ROLES, recoloured, shell_finishes
from roomlight_generator.rooms.furniture import Catalogue
from roomlight_generator.rooms.lights import light_room
from roomlight_generator.rooms.plan import Placement, Shell
from roomlight_generator.rooms.planner import ROOM_TYPES, RoomType, furnish
from roomlight_generator.rooms.scene import Item, Scene
from roomlight_generator.rooms.shell import STYLES, ShellStyle, build_shell

_SPLIT_KEYS: Final[dict[Split, int]] = {"train": 0x7261, "test": 0x7465}

_RESERVED_SHARE: Final = 0.4
"""How many of the test rooms are of the reserved types; the rest show known types with unknown furniture."""


_REPAINTED: Final = 0.4
"""The share of furniture in another colour than its model's."""


@dataclass(frozen=True, eq=False)
class Room:
    """A room ready for its light to be solved: `facts` are what statistics report."""

    name: str
    scene: Scene
    shell: Shell
    placements: tuple[Placement, ...]
    room_type: str
    facts: dict[str, Any]


def room_generator(index: int, *, seed: int, split: Split, purpose: int = 0) -> np.random.Generator:
    """The random numbers of one room: no two of (seed, split, index, purpose) share them."""
    return np.random.default_rng(np.random.SeedSequence([seed, _SPLIT_KEYS[split], index, purpose]))


def build_room(index: int, *, seed: int, split: Split, catalogue: Catalogue) -> Room:
    """The room of this number. The same arguments give the same room, to the byte."""
    rng = room_generator(index, seed=seed, split=split)
    room_type = _choose_type(split, rng)
    finishes = shell_finishes(
        room_type.name,
        split,
        rng,
        wall_textures=catalogue.surfaces("wall", split),
        floor_textures=catalogue.surfaces("floor", split),
    )
    shell = build_shell(_style(room_type, rng), finishes, rng)
    placements = furnish(shell, room_type, catalogue, rng, split=split)
    items = [_repainted(placement.item(), rng) for placement in placements]
    lighting = light_room(shell, placements, items, rng, split=split)
    scene = Scene(items=lighting.items, openings=shell.openings, sky=lighting.sky)
    roles: dict[str, int] = {}
    for placement in placements:
        roles[placement.model.role] = roles.get(placement.model.role, 0) + 1
    facts = {
        "room_type": room_type.name,
        "split": split,
        "seed": seed,
        "room": index,
        "triangles": scene.triangle_count(),
        "furniture": roles,
        "models": sorted({placement.model.id for placement in placements}),
        "attributions": scene.attributions(),
        "light": lighting.facts,
    }
    return Room(f"{split}-{index:06d}", scene, shell, placements, room_type.name, facts)


def _choose_type(split: Split, rng: np.random.Generator) -> RoomType:
    reserved = [one for one in ROOM_TYPES.values() if one.split == "test"]
    known = [one for one in ROOM_TYPES.values() if one.split == "train"]
    types = reserved if split == "test" and rng.random() < _RESERVED_SHARE else known
    return types[int(rng.integers(len(types)))]


def _style(room_type: RoomType, rng: np.random.Generator) -> ShellStyle:
    """The shell that suits a room type: the usual one of its kind, with the type's own sizes and chances."""
    usual = STYLES[room_type.name]
    windows = room_type.windows
    if rng.random() < room_type.p_windowless:
        windows = (0, 0)
    elif windows[0] == 0:
        windows = (1, max(1, windows[1]))
    behind_doors = 0.72 * room_type.p_second_room
    return replace(
        usual,
        area_m2=room_type.area_m2,
        aspect=room_type.aspect,
        height_m=room_type.height_m,
        windows=windows,
        doors=room_type.doors,
        slanted=room_type.p_attic,
        skylights=usual.skylights if windows[1] else 0.0,
        l_shape=room_type.p_l_shape,
        open_door=behind_doors,
        passage=room_type.p_second_room - behind_doors,
    )


def _repainted(item: Item, rng: np.random.Generator) -> Item:
    """Now and then another colour, so that one sofa is many."""
    if item.role not in RECOLOURABLE_ROLES or rng.random() > _REPAINTED:
        return item
    return replace(item, mesh=replace(item.mesh, materials=recoloured(item.mesh.materials, rng)))
