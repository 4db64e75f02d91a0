"""Files of furniture libraries: archives, catalogues, OBJ models, textures, the packed cache."""
