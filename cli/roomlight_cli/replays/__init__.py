"""Replays: the loop over a recording, its output folder, its pictures."""
