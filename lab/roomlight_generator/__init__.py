"""Generator of training data: furnished rooms, their light, and recordings of camera walks through them.

Start at `generate.generate`, which assigns shards to worker processes.

- `room_request`: what a renderer of rooms is asked for.
- `worker`, `worker_pool`: the processes that make shards, and the pool that starts and replaces them.
- `rooms`: shells, finishes, furniture, placement and lamps; `rooms.build.build_room` makes a room from a seed.
- `transport`: the renderer. `transport.RoomLight` solves a room's light once, then renders frames and panoramas.
- `sequences`: camera walks, probe positions, the phone's exposure and sensor; renders the recordings.
- `panoramas`: a second renderer, for rooms lit by real HDR panoramas.
- `blender`: rooms of other authors, from Blender files.
- `light_stats`: the light of a dataset beside real panoramas; `reports` shows datasets as contact sheets and tables.

`roomlight.dataset` writes the files; `docs/dataset.md` describes them.
"""
