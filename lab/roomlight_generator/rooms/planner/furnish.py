"""Furnish a room: radiators, the room type's programme, lamps, wall items, objects on tops, people and pets."""

import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.furniture import Catalogue
from roomlight_generator.rooms.plan import Placement, Shell
from roomlight_generator.rooms.planner.arrangement import Arrangement
from roomlight_generator.rooms.planner.groups.ceiling import light_ceiling
from roomlight_generator.rooms.planner.groups.loose_items import furnish_second_room, place_being
from roomlight_generator.rooms.planner.groups.tabletops import place_on_tops
from roomlight_generator.rooms.planner.groups.wall_items import hang_wall_items, lamps_at_bed, radiators
from roomlight_generator.rooms.planner.room_types import RoomType


def furnish(
    shell: Shell, room_type: RoomType, catalogue: Catalogue, rng: np.random.Generator, *, split: Split
) -> tuple[Placement, ...]:
    """Furnish a shell for a room type; placements are in the world frame.

    Bodies do not overlap (by more than 1 mm; exceptions: chairs reach up to 0.15 m under their tables, rugs lie below
    furniture, objects on tops stand inside the box of their support if its top is lower). All of them are inside the
    walls and under the ceiling, except for the pieces on the shell's spots. Doors stay clear, and `free_floor` has a
    connected region over at least 0.3 of the floor (in rooms whose low slopes or open doors leave less: over 0.7 of the
    area that a person could sweep in the empty room).

    Raises:
        ValueError: a room type of the test split was given for the training split.
    """
    if room_type.split == "test" and split == "train":
        raise ValueError(f"room type {room_type.name} is reserved for the test split: choose another type for training")
    clutter = float(rng.uniform(*room_type.clutter))
    arrangement = Arrangement(shell, catalogue, rng, split, clutter)
    if arrangement.chance(0.75):
        radiators(arrangement, room_type.radiators / 0.75)
    room_type.furnish(arrangement)
    light_ceiling(arrangement, room_type.ceiling)
    hang_wall_items(arrangement, room_type.wall_items)
    if arrangement.chance(0.15):
        lamps_at_bed(arrangement)
    place_on_tops(arrangement)
    place_being(arrangement, "person", room_type.people)
    place_being(arrangement, "pet", room_type.pets)
    return tuple([piece.placement for piece in arrangement.pieces] + furnish_second_room(arrangement))
