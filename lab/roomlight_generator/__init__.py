"""Generator of training data: furnished rooms, their light, and recordings of camera walks through them.

Start at `generate.generate`, which assigns shards to worker processes (`worker`). A worker builds a room
(`rooms`), solves its light (`transport`) and records walks through it (`sequences`). `verification` compares the light
with Mitsuba's, `stats` measures a finished dataset. Files are written by `roomlight.dataset`; see `docs/dataset.md`.
"""
