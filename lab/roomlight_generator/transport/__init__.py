"""Light transport in a room: ray tracing, a cache of indirect light, frames and panoramas. Needs no PyTorch.

Start at `room_light.RoomLight`; `tracer` traces rays, `direct` samples lights, `patches` and `irradiance_cache` hold
indirect light.
"""

from roomlight_generator.transport.room_light import FrameView, RoomLight
from roomlight_generator.transport.tracer import Tracer

__all__ = ["FrameView", "RoomLight", "Tracer"]
