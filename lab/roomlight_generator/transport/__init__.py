"""The renderer: light transport in a room, frames and panoramas. Needs no PyTorch.

Start at `room_light.RoomLight`. `tracer` traces rays; `lights` samples direct light; `patches` solves the light
between surfaces once for each room; `irradiance_cache` interpolates it for views; `view`, `paths`, `reflections` and
`grid` render pictures; `kernels` holds the compiled loops.
"""

from roomlight_generator.transport.room_light import FrameView, RoomLight, z_depth
from roomlight_generator.transport.tracer import Tracer

__all__ = ["FrameView", "RoomLight", "Tracer", "z_depth"]
