"""What frames show of the room's surfaces: partial meshes, their textures, keyframes, other exposures, drift."""
