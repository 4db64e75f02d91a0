"""Where objects stand: the room's surfaces, places on them, scenes."""
