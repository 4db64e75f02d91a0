"""RoomLight: HDR indoor light at any point of a room, from RGB, depth and poses. Torch-free domain code."""

__version__ = "0.1.0"
