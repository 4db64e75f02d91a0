"""Comparison of the renderer (`transport`) with Mitsuba, an unbiased path tracer.

Start at `check.check_rooms`, which renders rooms by both. `reference` converts a room to Mitsuba and traces it;
`deviation` separates our error from the reference's noise.
"""
