"""Sequences of a room, given its index: build the room, solve its light once, render several walks through it.

World frame: y up, metres; poses camera-to-world, OpenGL axes; radiance in kcd/m2.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable
from warnings import warn

import numpy as np
from jaxtyping import Float, Float32

from roomlight.camera import Intrinsics
from roomlight.dataset.recording import Recording, Split
from roomlight_generator.room_request import RoomRequest
from roomlight_generator.rooms.build import Room, build_room, room_generator
from roomlight_generator.rooms.furniture import Catalogue, fallback_models, load_catalogue
from roomlight_generator.rooms.planner import free_floor
from roomlight_generator.sequences.exposure import Exposure, expose
from roomlight_generator.sequences.probes import place_probes
from roomlight_generator.sequences.sensor import Sensor, clipped_radiance, develop
from roomlight_generator.sequences.walk import FRAME_INTERVAL_S, FreeSpace, camera_walk, phone_intrinsics
from roomlight_generator.transport import FrameView, RoomLight, Tracer

PROBES: Final = 3
"""Probes of a sequence."""
PROBE_HEIGHT: Final = 120
"""Rows of a probe's panorama."""

_BODY_M: Final = 0.25
"""Radius of the body that walks."""
_TRIES: Final = 12
"""Walks tried until one has places for its probes.

The first that has is taken: the first view looks anywhere, as a phone's does. Choosing the walk whose first view is
brightest, of four or twelve, leaves a third of real rooms' light around the frame (`stats --against`).
"""


@runtime_checkable  # so that annotations can be checked in the test run
class Views(Protocol):
    """A renderer of a room's frames and panoramas, such as `transport.RoomLight`. Radiance in kcd/m2."""

    def frame(self, intrinsics: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"], *, seed: int) -> FrameView:
        """Render what a pinhole camera sees."""
        ...

    def depth(self, intrinsics: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"]) -> Float32[np.ndarray, "h w"]:
        """Compute the depth of `frame` alone."""
        ...

    def panorama(
        self, position: Float[np.ndarray, "3"], height: int = 120, *, seed: int
    ) -> Float32[np.ndarray, "{height} 2*{height} 3"]:
        """Render the radiance that arrives at a point from all sides, the mean over each pixel."""
        ...


@dataclass(frozen=True, eq=False)
class LitRoom:
    """A room whose light is solved, and the space in which a camera can walk."""

    room: Room
    light: RoomLight
    free: FreeSpace


@dataclass(frozen=True, eq=False)
class CameraPath:
    """A sequence's camera, its camera-to-world poses, and its probes' positions (world, metres)."""

    intrinsics: Intrinsics
    poses: Float[np.ndarray, "f 4 4"]
    probes: Float[np.ndarray, "p 3"]


def render_room(request: RoomRequest) -> Iterator[Recording]:
    """Yield sequences of a room.

    Raises:
        ValueError: if no walk through the room is found; the generator then takes another room.
    """
    catalogue = catalogue_for(request.furniture)
    lit_room = solve_lighting(request.index, seed=request.seed, split=request.split, catalogue=catalogue)
    yield from render_walks(lit_room, request)


def render_walks(lit_room: LitRoom, request: RoomRequest) -> Iterator[Recording]:
    """Yield the recordings of the first walks through the room of a request, whose light is solved."""
    for walk in range(request.count):
        rng = room_generator(request.index, seed=request.seed, split=request.split, purpose=1 + walk)
        path = plan_camera_path(lit_room, rng, frames=request.frames)
        name = f"{lit_room.room.name}-{walk}"
        yield record(lit_room.light, path, rng, name=name, facts=lit_room.room.facts, expose=expose)


def solve_lighting(room_index: int, *, seed: int, split: Split, catalogue: Catalogue) -> LitRoom:
    """Build the room of this index and solve its light."""
    room = build_room(room_index, seed=seed, split=split, catalogue=catalogue)
    tracer = Tracer(room.scene)
    floor = free_floor(room.shell, room.placements, radius_m=_BODY_M)
    light = RoomLight.solve(tracer, room_index)
    return LitRoom(room, light, FreeSpace(floor.free, floor.origin, floor.cell_m, tracer.distances))


def plan_camera_path(lit_room: LitRoom, rng: np.random.Generator, *, frames: int) -> CameraPath:
    """Draw a phone, its walk, and the probes in its first frame's view.

    Raises:
        ValueError: if no walk with places for the probes is found.
    """
    name, free, light = f"room {lit_room.room.name}", lit_room.free, lit_room.light
    return find_camera_path(free, light, rng, name=name, walks=_TRIES, frames=frames)


def find_camera_path(
    free: FreeSpace, views: Views, rng: np.random.Generator, *, name: str, walks: int, frames: int
) -> CameraPath:
    """Draw phones and walks, at most `walks`, until one has places for its probes; `name` is what the error names.

    Raises:
        ValueError: if none has.
    """
    for _ in range(walks):
        path = draw_camera_path(free, views, rng, frames=frames)
        if path is not None:
            return path
    raise ValueError(f"{name}: {walks} walks through it found no place for {PROBES} probes")


def draw_camera_path(
    free: FreeSpace, views: Views, rng: np.random.Generator, *, frames: int, probes: int = PROBES
) -> CameraPath | None:
    """Draw a phone, one walk and its probes; None if there is no place for the walk or the probes."""
    intrinsics = phone_intrinsics(rng)
    poses = camera_walk(free, rng, intrinsics=intrinsics, frames=frames)
    if poses is None:
        return None
    depth_m = views.depth(intrinsics.resized(80, 60), poses[0])
    positions = place_probes(free, rng, intrinsics=intrinsics, camera_to_world=poses[0], depth_m=depth_m, count=probes)
    return None if positions is None else CameraPath(intrinsics, poses, positions)


def record(
    views: Views,
    path: CameraPath,
    rng: np.random.Generator,
    *,
    name: str,
    facts: dict[str, Any],
    expose: Callable[[Float[np.ndarray, "f h w 3"], np.random.Generator], Exposure],
) -> Recording:
    """Render a recording: frames as a phone would give them, exact depth, the light at the probes.

    The world is rotated about the vertical by whole columns of the panoramas, so that walls are not aligned with the
    axes: a phone's session begins in any direction.

    `expose` chooses exposure and white balance from the radiance of the frames (kcd/m2).
    """
    seeds = [int(value) for value in rng.integers(2**31, size=len(path.poses) + len(path.probes))]
    seen = [views.frame(path.intrinsics, pose, seed=seed) for pose, seed in zip(path.poses, seeds, strict=False)]
    radiance = np.stack([view.radiance for view in seen])
    exposure = expose(radiance, rng)
    sensor = Sensor.draw(rng)
    colour = np.stack([
        develop(frame, sensor, rng, multiplier=float(multiplier), gains=exposure.gains)
        for frame, multiplier in zip(radiance, exposure.multiplier, strict=True)
    ])  # fmt: skip
    clipped = np.stack([
        clipped_radiance(frame, picture, multiplier=float(multiplier), gains=exposure.gains)
        for frame, picture, multiplier in zip(radiance, colour, exposure.multiplier, strict=True)
    ])  # fmt: skip
    panoramas = np.zeros((len(path.probes), PROBE_HEIGHT, 2 * PROBE_HEIGHT, 3), np.float32)
    for k, (position, seed) in enumerate(zip(path.probes, seeds[len(path.poses) :], strict=True)):
        panoramas[k] = views.panorama(position, height=PROBE_HEIGHT, seed=seed)
    depth_m = np.stack([view.depth_m for view in seen])
    columns = int(rng.integers(2 * PROBE_HEIGHT))
    # To azimuth atan2(z, x) it adds this angle, as np.roll moves columns.
    angle = 2 * np.pi * columns / (2 * PROBE_HEIGHT)
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, 0, -s, 0], [0, 1, 0, 0], [s, 0, c, 0], [0, 0, 0, 1]])
    return Recording(
        name=name,
        colour=colour,
        depth_mm=np.rint(np.clip(depth_m * 1000, 0, 65535)).astype(np.uint16),
        surface=np.stack([view.surface for view in seen]),
        intrinsics=path.intrinsics,
        camera_to_world=rotation @ path.poses,
        exposure=exposure.relative,
        timestamp_s=np.arange(len(path.poses)) * FRAME_INTERVAL_S,
        probe_positions=path.probes @ rotation[:3, :3].T,
        probe_panoramas=np.roll(exposure.panorama(panoramas), columns, 2).astype(np.float32),
        facts={
            **facts,
            "white_kcd_m2": round(float(1 / exposure.multiplier[0]), 6),
            "white_balance": [round(float(gain), 4) for gain in exposure.gains],
            "brightest_kcd_m2": round(float(panoramas.max(initial=0)), 3),
            "exact_response": sensor.exact_response,
        },
        clipped_radiance=clipped,
    )


@cache
def catalogue_for(furniture: Path | None) -> Catalogue:
    """Load the furniture library (once a process), with the plain models that fill its gaps."""
    catalogue = load_catalogue(furniture, warn=lambda text: warn(text, stacklevel=2))
    return replace(catalogue, fallbacks=(*fallback_models("train"), *fallback_models("test")))
