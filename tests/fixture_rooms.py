"""The small dataset in `tests/data/rooms`: short sequences of the generator, for tests that need realistic light.

`python tests/fixture_rooms.py` generates it again (two minutes): two rooms of the train split and two of the test
split, with a sequence of four frames each. All furniture is the generator's own, so that no library has to be credited.
"""

import shutil
import sys
from functools import cache
from pathlib import Path

from roomlight.dataset.recording import Split
from roomlight_generator.generate import GenerateOptions, generate
from roomlight_generator.rooms.furniture import Catalogue, catalogue, fallback_models
from roomlight_generator.sequences.render import render_walks, solve_lighting

FOLDER = Path(__file__).parent / "data" / "rooms"
ROOMS: dict[Split, int] = {"train": 2, "test": 2}
FRAMES = 4
SEED = 21


@cache
def plain_catalogue():
    """The generator's own furniture."""
    return Catalogue(fallbacks=(*fallback_models("train"), *fallback_models("test")))


def lit_room(room_index, *, seed=SEED, split: Split = "train"):
    """A room with its lighting solved, furnished without a library."""
    return solve_lighting(room_index, seed=seed, split=split, catalogue=plain_catalogue())


def render_room(request):
    """What `roomlight_generator.sequences.render.render_room` does without a library."""
    assert request.furniture is None
    yield from render_walks(lit_room(request.index, seed=request.seed, split=request.split), request)


def main():
    shutil.rmtree(FOLDER, ignore_errors=True)
    catalogue.INSTALLED_FOLDER = FOLDER  # furniture installed on this machine must not be used
    for split, rooms in ROOMS.items():
        options = GenerateOptions(
            rooms,
            seed=SEED,
            split=split,
            shard_size=rooms,
            sequences_per_room=1,
            frames=FRAMES,
            renderer="fixture_rooms:render_room",
        )
        generate(FOLDER, options, workers=1)
    (FOLDER / "dataset.lock").unlink()


if __name__ == "__main__":
    sys.exit(main())
