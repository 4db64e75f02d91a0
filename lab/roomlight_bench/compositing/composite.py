"""`roomlight bench composite`: what a frame with virtual objects costs, part by part.

The benchmark's room, a hand-held camera of 640 x 480 pixels with 8-bit colour noise and depth of 256 x 192 samples, as
phones send. The session takes every tenth frame. Processor time stands beside the time that passed: on a machine with
other work the first one is nearly the same, the second one is not. Ratios are against the engine's stage `volume`,
timed after every frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from roomlight.compositing.compositor import Compositor
from roomlight.compositing.objects.materials import glossy, mirror
from roomlight.compositing.objects.primitives import chair, sphere
from roomlight.compositing.picture.layers import Composite
from roomlight.compositing.picture.stage_clock import StageClock
from roomlight.compositing.placement.scene import AtPosition, Motion, SceneObject
from roomlight.compositing.rendering.denoise import denoiser_name
from roomlight.conventions import linear_to_srgb, srgb8_to_linear
from roomlight.engine.preparation import WORKING_SIZE
from roomlight.engine.session import Session, SessionOptions, warm_up
from roomlight.engine.volume.grid import VolumeGrid, initial_volume
from roomlight.frame import Frame
from roomlight_bench.compositing.report import CompositeReport, PartTimes, PresetTimes
from roomlight_bench.reporting import describe_machine
from roomlight_bench.stages.room import RoomSize, handheld, views
from roomlight_bench.timing import ProgressCallback

PARTS: Final = {
    "place": "new surfaces",
    "light": "light update",
    "depth": "real depth",
    "camera": "camera measurement",
    "scene": "scene build",
    "render": "objects",
    "occlusion": "occlusion",
    "shadow": "shadows",
    "combine": "composite",
}
"""Stages of a `Composite` and their names in the report."""
FEWER: Final = {"preview": 1, "good": 3, "final": 10}
"""A preset takes this share of the frames: many paths take seconds, and vary less."""
UNMEASURED: Final = 2
"""First frames that are not measured: kernels are loaded, objects are placed."""
PUSH_EVERY: Final = 10
"""The session takes every tenth frame, three per second of 30, from the first measured one on; and the very first."""
COLOUR_NOISE: Final = 0.01
"""Standard deviation of the encoded colour: a phone by lamplight."""
DEPTH_NOISE_M: Final = 0.006
"""Standard deviation of depth: LiDAR and time-of-flight cameras at 2 m."""


@dataclass(frozen=True)
class CompositeSize:
    """Sizes of a run; the defaults are a phone's.

    Attributes:
        depth: Columns and rows.
        keyframes: Frames of a turn of the camera, from which the session knows the room.
    """

    width: int = 640
    height: int = 480
    depth: tuple[int, int] = (256, 192)
    keyframes: int = 12
    panorama_height: int = 120


def objects() -> list[SceneObject]:
    """Return what is measured, each in a scene of its own: spheres on the table, a chair behind it."""
    on_table, across = AtPosition((0.1, -0.95, -1.45)), AtPosition((-0.3, -0.95, -1.45))
    motion = Motion.model_validate({"unit": "frames", "keys": [{"at": 0}, {"at": 60, "offset_m": [0.6, 0, 0.1]}]})
    return [
        SceneObject("glossy sphere", sphere(0.14, glossy((0.7, 0.15, 0.1), 0.25)), on_table),
        SceneObject("mirror sphere", sphere(0.14, mirror()), on_table),
        SceneObject("mirror sphere, moving", sphere(0.14, mirror()), across, motion),
        SceneObject("chair", chair(0.85), AtPosition((0.2, -1.4, -2.3), 30.0)),
    ]


def run_composite(
    *,
    frames: int = 30,
    final: bool = False,
    progress: ProgressCallback | None = None,
    size: CompositeSize | None = None,
) -> CompositeReport:
    """Time every preset and object; a minute on two idle cores, ten more with `final`.

    Args:
        frames: Measured frames of a preview, at least 1; the slower presets take fewer.
    """
    report: ProgressCallback = progress or (lambda _: None)
    size = size or CompositeSize()
    report("compiling kernels")
    warm_up()
    report("building the room")
    seen = handheld(frames + UNMEASURED, RoomSize(size.width, size.height))
    phone = [_as_phone(frame, size, seed) for seed, frame in enumerate(seen)]
    room = views(size.keyframes, RoomSize(320, 240))
    presets = ("preview", "good", "final") if final else ("preview", "good")
    times: list[PresetTimes] = []
    for preset in presets:
        count = max(1, frames // FEWER[preset]) + UNMEASURED
        for scene_object in objects():
            times.append(_timed(_session(room, size), scene_object, preset, phone[:count], report))
    return CompositeReport(
        times=tuple(times),
        denoiser=denoiser_name(),
        image=(size.width, size.height),
        depth=size.depth,
        machine=describe_machine(),
    )


def _session(room: Sequence[Frame], size: CompositeSize) -> Session:
    session = Session(SessionOptions(model="classical", height=size.panorama_height))
    for frame in room:
        session.push(frame)
    return session


def _timed(
    session: Session, scene_object: SceneObject, preset: str, frames: Sequence[Frame], progress: ProgressCallback
) -> PresetTimes:
    """Composite the frames one after the other; the first ones do not count."""
    stage = frames[0].resized(*WORKING_SIZE)
    grid = VolumeGrid.from_frame(stage)
    compositor = Compositor(session, [scene_object], quality=preset)
    made: list[Composite] = []
    volume_ms: list[tuple[float, float]] = []
    for number, frame in enumerate(frames):
        progress(f"{preset}: {scene_object.name}, frame {number + 1} of {len(frames)}")
        if number == 0 or (number - UNMEASURED) % PUSH_EVERY == 0:
            session.push(frame)
        made.append(compositor.composite(frame))
        clock = StageClock()
        with clock.stage("volume"):
            initial_volume(grid, stage)
        volume_ms.append((clock.wall_ms["volume"], clock.cpu_ms["volume"]))
    compositor.close()
    measured = made[UNMEASURED:]
    walls = {name: [result.stage_ms.get(stage, 0.0) for result in measured] for stage, name in PARTS.items()}
    cpus = {name: [result.stage_cpu_ms.get(stage, 0.0) for result in measured] for stage, name in PARTS.items()}
    volume = np.median(np.array(volume_ms[UNMEASURED:]), axis=0)
    return PresetTimes(
        preset,
        scene_object.name,
        scene_object.geometry.triangles,
        float(np.mean([(result.crop_alpha > 0).sum() for result in measured])),
        tuple(PartTimes.of(name, walls[name], cpus[name]) for name in PARTS.values()),
        PartTimes.of("whole frame", _sums(walls), _sums(cpus)),
        (float(volume[0]), float(volume[1])),
        len(measured),
    )


def _sums(columns: dict[str, list[float]]) -> list[float]:
    return [sum(row) for row in zip(*columns.values(), strict=True)]


def _as_phone(frame: Frame, size: CompositeSize, seed: int) -> Frame:
    """Return the frame with noise in colour and depth, colour rounded to 8 bits, depth of the sensor's size."""
    noise = np.random.default_rng([seed, 1]).normal(0, COLOUR_NOISE, frame.image.shape)
    encoded = np.rint(np.clip(linear_to_srgb(frame.image) + noise, 0, 1) * 255).astype(np.uint8)
    depth_m = cv2.resize(frame.depth_m, size.depth, interpolation=cv2.INTER_NEAREST_EXACT)
    depth_m = depth_m + np.random.default_rng(seed).normal(0, DEPTH_NOISE_M, depth_m.shape)
    return replace(frame, image=srgb8_to_linear(encoded).astype(np.float32), depth_m=depth_m.astype(np.float32))
