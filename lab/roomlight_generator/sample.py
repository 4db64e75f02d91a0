"""The sample capture that RoomLight ships: one sequence of the generator, with the plain fallback models alone.

It does not use the furniture library: anyone makes the same files, and no furniture author must be credited.
"""

from dataclasses import replace
from pathlib import Path
from typing import Final

from roomlight.dataset.extract import write_capture
from roomlight.dataset.sequence_files import encode
from roomlight_generator.rooms.build import room_generator
from roomlight_generator.rooms.furniture import Catalogue, fallback_models
from roomlight_generator.sequences.render import plan_camera_path, render_sequence, solve_lighting

SEED: Final = 11
ROOM: Final = 1504
WALK: Final = 5
"""Chosen by eye among 61 coloured rooms: a living room at dusk, violet walls, a sofa and a low table.

The files that the package ships were made by an earlier generator: the same numbers now give another room."""


def generate_sample(out: Path, *, seed: int = SEED, room: int = ROOM, walk: int = WALK) -> None:
    """Write one sequence as a capture folder; the same arguments give the same files.

    Raises:
        OutputError: if `out` holds files already or cannot be written.
        ValueError: if no walk through the room is found.
    """
    catalogue = Catalogue(fallbacks=fallback_models("train"))
    lit_room = solve_lighting(room, seed=seed, split="train", catalogue=catalogue)
    rng = room_generator(room, seed=seed, split="train", purpose=1 + walk)
    recording = render_sequence(lit_room, plan_camera_path(lit_room, rng), rng, name="sample room")
    # no training data: the true radiance of clipped pixels would be a quarter of the files
    write_capture(encode(replace(recording, clipped_radiance=None)), out)
