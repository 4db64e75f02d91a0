"""From a room's number to its sequences: build it, solve its light once, walk through it several times."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final
from warnings import warn

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.conventions import panorama_solid_angles
from roomlight.dataset.folder import FRAMES
from roomlight.dataset.recording import Recording, Split
from roomlight_generator.rooms.build import Room, build_room, room_generator
from roomlight_generator.rooms.furniture import Catalogue, load_catalogue
from roomlight_generator.rooms.planner import free_floor
from roomlight_generator.rooms.props import procedural_models
from roomlight_generator.sequences.exposure import Exposure, expose
from roomlight_generator.sequences.probes import place_probes
from roomlight_generator.sequences.sensor import Sensor, develop
from roomlight_generator.sequences.walk import FreeSpace, camera_walk, phone_intrinsics, timestamps_s
from roomlight_generator.transport import RoomLight, Tracer

PROBES: Final = 3
PROBE_HEIGHT: Final = 120

_BODY_M: Final = 0.25
_TRIES: Final = 8
"""Walks tried beyond those wanted, until one has room for its probes."""
_CHOICES: Final = (1, 12, 4)
_SHARES: Final = (0.2, 0.4, 0.4)
"""Of one, twelve or four walks that would do, that one is filmed whose first view is brightest for its surroundings;
how often each. People turn a phone to the lit side of a room, some of them with care; of walks that begin anywhere,
panoramas are 1.2 times as bright as the first frame in the median, and seldom darker."""
_GLANCE: Final = (20, 15)
_ALL_ROUND: Final = 8
"""Size of the pictures that are compared, and rows of the panoramas."""
_HALF_MAX: Final = 60_000.0
"""Panoramas are stored as half floats, whose largest is 65,504."""


@dataclass(frozen=True, eq=False)
class LitRoom:
    """A room whose light is solved, ready to be filmed."""

    room: Room
    light: RoomLight
    free: FreeSpace


@dataclass(frozen=True, eq=False)
class CameraPath:
    """Where a sequence is filmed from, and where its probes are."""

    intrinsics: Intrinsics
    poses: Float[np.ndarray, "f 4 4"]
    probes: Float[np.ndarray, "p 3"]


def render_room(
    room_index: int, *, seed: int, split: Split, furniture: Path | None, count: int, frames: int
) -> Iterator[Recording]:
    """`count` sequences of so many frames in one room, one by one; the same arguments give the same recordings.

    ValueError where a walk through it cannot be found: the generator then takes another room.
    """
    stage = solve_lighting(room_index, seed=seed, split=split, catalogue=catalogue_for(furniture))
    yield from render_walks(stage, room_index, seed=seed, split=split, count=count, frames=frames)


def render_walks(
    stage: LitRoom, room_index: int, *, seed: int, split: Split, count: int, frames: int = FRAMES
) -> Iterator[Recording]:
    """The first `count` walks through a room of that number."""
    for walk in range(count):
        rng = room_generator(room_index, seed=seed, split=split, purpose=1 + walk)
        yield render_sequence(stage, plan_camera_path(stage, rng, frames=frames), rng, name=f"{stage.room.name}-{walk}")


def solve_lighting(room_index: int, *, seed: int, split: Split, catalogue: Catalogue) -> LitRoom:
    """Build a room and solve its light."""
    room = build_room(room_index, seed=seed, split=split, catalogue=catalogue)
    tracer = Tracer(room.scene)
    floor = free_floor(room.shell, room.placements, radius_m=_BODY_M)
    light = RoomLight.solve(tracer, room_index)
    return LitRoom(room, light, FreeSpace(floor.free, floor.origin, floor.cell_m, tracer.distances))


def plan_camera_path(
    stage: LitRoom, rng: np.random.Generator, *, frames: int = FRAMES, probes: int = PROBES
) -> CameraPath:
    """A phone, its walk and the probes before its first frame; ValueError where the room is too full for any."""
    wanted = int(rng.choice(_CHOICES, p=_SHARES))
    tries = wanted + _TRIES
    found: list[CameraPath] = []
    for _ in range(tries):
        intrinsics = phone_intrinsics(rng)
        poses = camera_walk(stage.free, rng, intrinsics=intrinsics, frames=frames)
        if poses is None:
            continue
        depth_m = stage.light.depth(intrinsics.resized(80, 60), poses[0])
        positions = place_probes(
            stage.free, rng, intrinsics=intrinsics, camera_to_world=poses[0], depth_m=depth_m, count=probes
        )
        if positions is not None:
            found.append(CameraPath(intrinsics, poses, positions))
        if len(found) == wanted:
            break
    if not found:
        raise ValueError(f"room {stage.room.name}: {tries} walks through it found no place for {probes} probes")
    return found[0] if len(found) == 1 else max(found, key=lambda shot: _lit_side(stage, shot))


def _lit_side(stage: LitRoom, shot: CameraPath) -> float:
    """Mean brightness of the first view over that of everything around the probes. Brightness is the square root of
    radiance: bright all over counts, a lamp alone does not."""
    glance = stage.light.frame(shot.intrinsics.resized(*_GLANCE), shot.poses[0], seed=0)
    around = np.stack([stage.light.panorama(position, height=_ALL_ROUND, seed=0) for position in shot.probes])
    share = panorama_solid_angles(_ALL_ROUND) / (4 * np.pi)
    everything = float((np.sqrt(around).mean(axis=(0, 3)) * share).sum())
    return float(np.sqrt(glance.radiance).mean()) / max(everything, 1e-9)


def render_sequence(stage: LitRoom, shot: CameraPath, rng: np.random.Generator, *, name: str) -> Recording:
    """The recording: frames as a phone would give them, exact depth, the light at the probes.

    Its world is turned about the vertical by whole columns of the panoramas: walls stand along no axis in particular,
    as where a phone's session began.
    """
    seeds = [int(value) for value in rng.integers(2**31, size=len(shot.poses) + len(shot.probes))]
    views = [stage.light.frame(shot.intrinsics, pose, seed=own) for pose, own in zip(shot.poses, seeds, strict=False)]
    radiance = np.stack([view.radiance for view in views])
    exposure = expose(radiance, rng)
    sensor = Sensor.draw(rng)
    colour = np.stack([
        develop(frame, sensor, rng, multiplier=float(multiplier), gains=exposure.gains)
        for frame, multiplier in zip(radiance, exposure.multiplier, strict=True)
    ])  # fmt: skip
    panoramas = np.stack([
        stage.light.panorama(position, height=PROBE_HEIGHT, seed=own)
        for position, own in zip(shot.probes, seeds[len(shot.poses) :], strict=True)
    ])  # fmt: skip
    depth_m = np.stack([view.depth_m for view in views])
    columns = int(rng.integers(2 * PROBE_HEIGHT))
    turn = _turn(2 * np.pi * columns / (2 * PROBE_HEIGHT))
    return Recording(
        name=name,
        colour=colour,
        depth_mm=np.rint(np.clip(depth_m * 1000, 0, 65535)).astype(np.uint16),
        surface=np.stack([view.surface for view in views]),
        intrinsics=shot.intrinsics,
        camera_to_world=turn @ shot.poses,
        exposure=exposure.relative,
        timestamp_s=timestamps_s(len(shot.poses)),
        probe_positions=shot.probes @ turn[:3, :3].T,
        probe_panoramas=np.roll(np.minimum(exposure.panorama(panoramas), _HALF_MAX), columns, 2).astype(np.float32),
        facts={**stage.room.facts, **_facts(exposure, sensor, panoramas)},
    )


def _turn(angle: float) -> Float[np.ndarray, "4 4"]:
    """Takes azimuth atan2(z, x) to azimuth + angle, as np.roll takes columns."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, -s, 0], [0, 1, 0, 0], [s, 0, c, 0], [0, 0, 0, 1]])


def _facts(exposure: Exposure, sensor: Sensor, panoramas: Float[np.ndarray, "p h w 3"]) -> dict[str, Any]:
    return {
        "white_kcd_m2": round(float(1 / exposure.multiplier[0]), 6),
        "white_balance": [round(float(gain), 4) for gain in exposure.gains],
        "brightest_kcd_m2": round(float(panoramas.max()), 3),
        "exact_response": sensor.exact_response,
    }


@cache
def catalogue_for(furniture: Path | None) -> Catalogue:
    """The furniture library (once a process), with the procedural models that fill its gaps."""
    catalogue = load_catalogue(furniture, warn=lambda text: warn(text, stacklevel=2))
    return catalogue.with_procedural([*procedural_models("train"), *procedural_models("test")])
