"""Furniture placement: room types, and the furnishing of a shell for a room type. Plan coordinates (x, z) in metres.

Start at `furnish.furnish`. `room_types` lists what stands in which room, `groups` places what stands together,
`arrangement` tests each placement; `wall_space` and `free_floor` find the places.
"""

from roomlight_generator.rooms.planner.free_floor import free_floor
from roomlight_generator.rooms.planner.furnish import furnish
from roomlight_generator.rooms.planner.room_types import ROOM_TYPES, RoomType

__all__ = ["ROOM_TYPES", "RoomType", "free_floor", "furnish"]
