"""Lights of a room: emitters, sun, sky, and direct light from them at points."""
