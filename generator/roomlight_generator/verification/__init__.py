"""Checks the generator's light transport against Mitsuba."""
