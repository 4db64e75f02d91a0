"""Rendering of objects, and of the shadows that they cast on real surfaces."""
