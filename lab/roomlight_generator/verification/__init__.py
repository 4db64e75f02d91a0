"""Check of the generator's light transport against Mitsuba, an unbiased path tracer. Start at `check`."""
