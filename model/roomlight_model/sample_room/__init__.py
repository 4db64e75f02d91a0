"""The sample room: a furnished living room, lit and walked through, made without PyTorch and without any asset.

`shapes`, `textures` and `furniture` make things; `light`, `scene` and `transport` carry the light; `room` furnishes;
`camera_path` walks; `render` looks; `generate` writes the capture that the package ships.
"""

from roomlight_model.sample_room.generate import Quality, generate_sample

__all__ = ["Quality", "generate_sample"]
