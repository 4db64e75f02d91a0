"""Build a complete room from a seed: room type, finishes, shell, furniture, lights."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.finishes import shell_finishes
from roomlight_generator.rooms.furniture import Catalogue
from roomlight_generator.rooms.lights import LIGHT_KINDS, LightKind, light_room
from roomlight_generator.rooms.plan import Placement, Shell
from roomlight_generator.rooms.planner import ROOM_TYPES, RoomType, furnish
from roomlight_generator.rooms.scene import Scene, attributions
from roomlight_generator.rooms.shell import STYLES, ShellStyle, build_shell

_SPLIT_KEYS: Final[dict[Split, int]] = {"train": 0x7261, "test": 0x7465}

_RESERVED_SHARE: Final = 0.4
"""Share of test rooms that have a reserved room type; the others have a known type with furniture unseen in
training."""


@dataclass(frozen=True, eq=False)
class Room:
    """A furnished, lit room whose light transport is not yet solved.

    Attributes:
        facts: Metadata that statistics report.
    """

    name: str
    scene: Scene
    shell: Shell
    placements: tuple[Placement, ...]
    facts: dict[str, Any]


def room_generator(index: int, *, seed: int, split: Split, purpose: int = 0) -> np.random.Generator:
    """Return the random generator of a room; its stream is unique to (seed, split, index, purpose)."""
    return np.random.default_rng(np.random.SeedSequence([seed, _SPLIT_KEYS[split], index, purpose]))


def build_room(index: int, *, seed: int, split: Split, catalogue: Catalogue) -> Room:
    """Build the room with this index in its split. The same arguments give a byte-identical room."""
    rng = room_generator(index, seed=seed, split=split)
    room_type = _choose_type(split, rng)
    finishes = shell_finishes(room_type.name, rng)
    kind = list(LIGHT_KINDS)[int(rng.choice(len(LIGHT_KINDS), p=list(LIGHT_KINDS.values())))]
    shell = build_shell(_shell_style(room_type, kind, rng), finishes, rng)
    placements = furnish(shell, room_type, catalogue, rng, split=split)
    items = [placement.item() for placement in placements]
    lighting = light_room(shell, placements, items, rng, wanted=kind)
    scene = Scene(items=lighting.items, openings=shell.openings, sky=lighting.sky)
    facts = {
        "room_type": room_type.name,
        "split": split,
        "seed": seed,
        "room": index,
        "triangles": scene.triangle_count(),
        "furniture": dict(Counter(placement.model.role for placement in placements)),
        "models": sorted({placement.model.id for placement in placements}),
        "attributions": attributions(scene.items),
        "light": lighting.facts,
    }
    return Room(f"{split}-{index:06d}", scene, shell, placements, facts)


def _choose_type(split: Split, rng: np.random.Generator) -> RoomType:
    reserved = [room_type for room_type in ROOM_TYPES.values() if room_type.split == "test"]
    unreserved = [room_type for room_type in ROOM_TYPES.values() if room_type.split == "train"]
    types = reserved if split == "test" and rng.random() < _RESERVED_SHARE else unreserved
    return types[int(rng.integers(len(types)))]


def _shell_style(room_type: RoomType, kind: LightKind, rng: np.random.Generator) -> ShellStyle:
    """Return the type's entry in `STYLES` with its sizes and chances, and what a kind of light needs."""
    default = STYLES[room_type.name]
    windows = room_type.windows
    lit_by_windows = kind in ("windows alone", "sunbeams")
    if kind == "open to bright" or (not lit_by_windows and rng.random() < room_type.p_windowless):
        windows = (0, 0)
    elif windows[0] == 0:
        windows = (1, max(1, windows[1]))
    second_room = 1.0 if kind == "open to bright" else room_type.p_second_room
    behind_doors = (0.3 if kind == "open to bright" else 0.72) * second_room
    return replace(
        default,
        area_m2=room_type.area_m2,
        aspect=room_type.aspect,
        height_m=room_type.height_m,
        windows=windows,
        covers=(("none", 1.0),) if kind == "sunbeams" else default.covers,
        doors=room_type.doors,
        slanted=room_type.p_attic,
        skylights=default.skylights if windows[1] else 0.0,
        l_shape=room_type.p_l_shape,
        open_door=behind_doors,
        passage=second_room - behind_doors,
        second_window=0.7 if kind == "open to bright" else default.second_window,
    )
