"""Furnishing a room: radiators, the room type's programme, lamps, walls, tops, and whoever is there."""

import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.plan import Placement, Shell
from roomlight_generator.rooms.planner.arrangement import Layout
from roomlight_generator.rooms.planner.ceiling import light_ceiling
from roomlight_generator.rooms.planner.chooser import Chooser
from roomlight_generator.rooms.planner.loose import person, pet, second_room
from roomlight_generator.rooms.planner.room_types import RoomType
from roomlight_generator.rooms.planner.tops import dress_tops
from roomlight_generator.rooms.planner.wall_items import hang_all, lamps_at_bed, radiators


def furnish(
    shell: Shell, room_type: RoomType, catalogue: Chooser, rng: np.random.Generator, *, split: Split
) -> tuple[Placement, ...]:
    """Furniture for a room of that type, world frame.

    Nothing meets anything else (boxes that touch by less than 1 mm apart; chairs reach up to 0.15 m under their
    tables, rugs lie below furniture, things on top stand inside the box of what carries them where its top is lower),
    all of it inside the walls and under the ceiling but for the pieces on the shell's spots; doors stay clear, and
    `free_floor` has a connected region over at least 0.3 of the floor (of rooms whose low slopes or open doors leave
    hardly that: over 0.7 of what a body could sweep of the empty room). ValueError for a room type of the test split
    in the training split.
    """
    if room_type.split == "test" and split == "train":
        raise ValueError(f"rooms of type {room_type.name} are kept for the test split: choose another type to train on")
    clutter = float(rng.uniform(*room_type.clutter))
    layout = Layout(shell, catalogue, rng, split, clutter)
    if layout.chance(0.75):
        radiators(layout, room_type.radiators / 0.75)
    room_type.furnish(layout)
    light_ceiling(layout, room_type.ceiling)
    hang_all(layout, room_type.wall_items)
    if layout.chance(0.15):
        lamps_at_bed(layout)
    dress_tops(layout)
    person(layout, room_type.people)
    pet(layout, room_type.pets)
    return tuple([piece.placement for piece in layout.pieces] + second_room(layout))
