"""Compiled loops of the readers of objects."""
