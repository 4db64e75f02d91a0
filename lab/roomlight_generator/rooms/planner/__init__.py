"""Plausible furniture placement: room types, and furnishing of a shell for one. Plan coordinates in metres."""

from roomlight_generator.rooms.planner.chooser import Chooser
from roomlight_generator.rooms.planner.free_floor import FreeFloor, free_floor
from roomlight_generator.rooms.planner.furnish import furnish
from roomlight_generator.rooms.planner.room_types import ROOM_TYPES, RoomType

__all__ = ["ROOM_TYPES", "Chooser", "FreeFloor", "RoomType", "free_floor", "furnish"]
