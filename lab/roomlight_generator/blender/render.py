"""Sequences of a Blender scene, given its number: walk through the room of its camera, render frames and probes.

World frame: y up, metres, the floor at y = 0; poses camera-to-world, OpenGL axes; radiance in kcd/m2.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from roomlight.dataset.recording import LIGHT, Recording, Split
from roomlight_generator.blender.cycles import CyclesViews
from roomlight_generator.blender.floor import find_floor
from roomlight_generator.blender.scene import open_scene
from roomlight_generator.panoramas.render import MEDIAN_KCD_M2, expose
from roomlight_generator.rooms.build import room_generator
from roomlight_generator.sequences.render import find_camera_path, record

_WALKS: Final = 12
"""Walks drawn, until one has places for its probes."""


def render_room(
    room_index: int,
    *,
    seed: int,
    split: Split,
    furniture: Path | None,
    count: int,
    frames: int,
    scenes: Sequence[Path],
    samples: int,
) -> Iterator[Recording]:
    """Yield sequences of a scene; the same arguments give the same recordings.

    Args:
        room_index: Number of the scene in `scenes`.
        seed: Seed of the dataset.
        split: Split of the room.
        furniture: Not used: a scene brings its own.
        count: Number of walks.
        frames: Frames of a walk.
        scenes: Blender files.
        samples: Paths a pixel of frames.

    Raises:
        DatasetError: `bpy` is not installed, the scene cannot be opened, or no room is found in it.
        ValueError: if no walk through the room is found.
    """
    del furniture
    path = scenes[room_index]
    room = open_scene(path)
    floor_y, free = find_floor(room)
    views = CyclesViews(room, floor_y, samples=samples)
    facts: dict[str, Any] = {
        "room_type": "blender",
        "scene": path.name,
        "light": {
            "scenario": "blender",
            "sources": [],
            "lamps": list(room.lamps),
            "emitting_triangles": int((room.kinds == LIGHT).sum()),
        },
        "furniture": {},
        "attributions": [],
    }
    for walk in range(count):
        rng = room_generator(room_index, seed=seed, split=split, purpose=1 + walk)
        camera = find_camera_path(free, views, rng, name=str(path), walks=_WALKS, frames=frames)
        views.set_median(camera.probes[0], float(np.exp(rng.uniform(*np.log(MEDIAN_KCD_M2)))))
        yield record(views, camera, rng, name=f"{path.stem}-{walk}", facts=facts, expose=expose)
