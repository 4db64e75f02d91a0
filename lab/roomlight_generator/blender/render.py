"""Sequences of a Blender scene, given its number: walk through the room of its camera, render frames and probes.

World frame: y up, metres, the floor at y = 0; poses camera-to-world, OpenGL axes; radiance in kcd/m2.
"""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from roomlight.dataset.recording import LIGHT, Recording
from roomlight_generator.blender.cycles import CyclesViews
from roomlight_generator.blender.floor import find_floor
from roomlight_generator.blender.scene import open_scene
from roomlight_generator.panoramas.render import MEDIAN_KCD_M2, expose
from roomlight_generator.room_request import RoomRequest
from roomlight_generator.rooms.build import room_generator
from roomlight_generator.sequences.render import find_camera_path, record

_WALKS: Final = 12
"""Walks drawn, until one has places for its probes."""


def render_room(request: RoomRequest) -> Iterator[Recording]:
    """Yield sequences of a scene.

    Raises:
        DatasetError: `bpy` is not installed, the scene cannot be opened, it has no light, or no room is found in it.
        ValueError: if no walk through the room is found.
    """
    path = request.scenes[request.index]
    room = open_scene(path)
    floor_y, free = find_floor(room)
    views = CyclesViews(room, floor_y, samples=request.samples)
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
    for walk in range(request.count):
        rng = room_generator(request.index, seed=request.seed, split=request.split, purpose=1 + walk)
        camera = find_camera_path(free, views, rng, name=str(path), walks=_WALKS, frames=request.frames)
        views.set_median(camera.probes[0], float(np.exp(rng.uniform(*np.log(MEDIAN_KCD_M2)))))
        yield record(views, camera, rng, name=f"{path.stem}-{walk}", facts=facts, expose=expose)
