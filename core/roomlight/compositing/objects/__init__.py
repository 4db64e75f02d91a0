"""Virtual objects: meshes, materials, textures, and the files that they are read from."""
