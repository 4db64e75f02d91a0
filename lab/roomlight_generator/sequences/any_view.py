"""Single views from anywhere in a room, without probes: what networks that estimate depth are trained on.

World frame: y up, metres; poses camera-to-world, OpenGL axes. A sequence has one lens; its views do not follow each
other, and each is exposed by itself.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.dataset.recording import Recording
from roomlight_generator.panoramas.render import expose as expose_panorama
from roomlight_generator.panoramas.render import lit_room
from roomlight_generator.room_request import RoomRequest
from roomlight_generator.rooms.build import room_generator
from roomlight_generator.sequences.exposure import Exposure, expose
from roomlight_generator.sequences.render import CameraPath, Views, catalogue_for, record, solve_lighting
from roomlight_generator.sequences.walk import FreeSpace, camera_axes

FIELD_OF_VIEW_DEGREES: Final = (48.0, 92.0)
"""Across the long side: from a phone's main camera, cropped, to its wide camera."""
SIZE: Final = (256, 192)
"""Width and height of the long side first; a quarter of the sequences is upright."""
_HEIGHT_M: Final = (0.35, 2.0)
_NEAR_M: Final = 0.25
_APART_S: Final = 60.0
"""Seconds between the views: exposure has settled."""
_TRIES: Final = 40


def render_views(request: RoomRequest) -> Iterator[Recording]:
    """Yield sequences of single views of a generated room.

    Raises:
        ValueError: if the room has no place for a camera; the generator then takes another room.
    """
    catalogue = catalogue_for(request.furniture)
    room = solve_lighting(request.index, seed=request.seed, split=request.split, catalogue=catalogue)
    yield from _views(request, room.free, room.light, name=room.room.name, facts=room.room.facts, expose=expose)


def render_panorama_views(request: RoomRequest) -> Iterator[Recording]:
    """Yield sequences of single views of a room lit by a panorama, as `render_views` does.

    Raises:
        DatasetError: if the folder of panoramas cannot be read or has none for this split.
        ValueError: if the room has no place for a camera.
    """
    room, facts = lit_room(request)
    name = f"panorama-{request.index}"
    yield from _views(request, room.free_space(), room, name=name, facts=facts, expose=expose_panorama)


def _views(
    request: RoomRequest,
    free: FreeSpace,
    views: Views,
    *,
    name: str,
    facts: dict[str, Any],
    expose: Callable[..., Exposure],
) -> Iterator[Recording]:
    """Yield recordings of drawn views, exposed apart from each other."""
    for walk in range(request.count):
        rng = room_generator(request.index, seed=request.seed, split=request.split, purpose=1 + walk)
        path = draw_views(free, rng, frames=request.frames)
        exposed = partial(expose, interval_s=_APART_S)
        yield record(views, path, rng, name=f"{name}-{walk}", facts=facts, expose=exposed)


def draw_views(free: FreeSpace, rng: np.random.Generator, *, frames: int) -> CameraPath:
    """Draw a lens and views: at any height, to any side, tilted and rolled as hands do.

    Raises:
        ValueError: if the room has no free place.
    """
    width, height = SIZE if rng.random() < 0.75 else SIZE[::-1]
    focal = max(SIZE) / 2 / np.tan(np.radians(rng.uniform(*FIELD_OF_VIEW_DEGREES)) / 2)
    off = np.clip(rng.normal(0, 0.01, 2), -0.03, 0.03)
    lens = Intrinsics(
        float(focal), float(focal), width * (0.5 + float(off[0])), height * (0.5 + float(off[1])), width, height
    )
    places = np.argwhere(free.walkable)
    if len(places) == 0:
        raise ValueError("the room has no free place for a camera")
    poses: list[Float[np.ndarray, "4 4"]] = []
    for _ in range(_TRIES * frames):
        row, column = places[rng.integers(len(places))] + rng.uniform(-0.4, 0.4, 2)
        x, z = free.origin[0] + column * free.cell_m, free.origin[1] + row * free.cell_m
        at = np.array([x, rng.uniform(*_HEIGHT_M), z])
        pitch = np.clip(rng.normal(-0.25, 0.35), -1.25, 0.7)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = camera_axes(rng.uniform(0, 2 * np.pi), pitch, rng.normal(0, 0.06)), at
        rays = lens.resized(12, 9).rays().reshape(-1, 3)
        seen = (rays / np.linalg.norm(rays, axis=1, keepdims=True)) @ pose[:3, :3].T
        far_m = free.distances(np.tile(at.astype(np.float32), (len(seen), 1)), seen.astype(np.float32))
        if np.quantile(far_m, 0.1) > _NEAR_M and np.median(far_m) > 2 * _NEAR_M:
            poses.append(pose)
            if len(poses) == frames:
                return CameraPath(lens, np.stack(poses), np.zeros((0, 3)))
    raise ValueError(f"only {len(poses)} of {frames} views are not blocked")
