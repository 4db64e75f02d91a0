"""Rooms per hour at equal error: the generator's light transport against Mitsuba 3, alone and with Open Image Denoise.

    python docs/scripts/transport_cost.py       ten minutes of processor time; needs mitsuba, LLVM 17 or newer, pyoidn

Each room is rendered by both: the first frame and one probe's panorama, at a dataset's sizes. The error of a picture is
the mean square of the difference of log radiance at random pixels, against a reference of many paths for these pixels,
in two halves whose own noise cancels. Mitsuba's cost at our error is interpolated between its errors at several
numbers of paths, in logarithms; where the last does not reach our error, it is that of the last: a lower bound. Costs
are processor time of all threads, so that other work does not disturb them.
"""

import sys
import time
from argparse import ArgumentParser
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float, Float32

from roomlight.conventions import LUMINANCE
from roomlight_generator.rooms.build import build_room, room_generator
from roomlight_generator.rooms.planner import free_floor
from roomlight_generator.sequences.render import PROBE_HEIGHT, LitRoom, catalogue_for, plan_camera_path
from roomlight_generator.sequences.surface_kinds import without_glass
from roomlight_generator.sequences.walk import FreeSpace
from roomlight_generator.transport import RoomLight, Tracer
from roomlight_generator.verification.check import BODY_M, PictureRays, add_sun
from roomlight_generator.verification.reference import Reference

PATHS: Final = (4, 16, 64, 256)
"""Paths of a pixel at which Mitsuba is measured; each number adds to the paths before it."""
GUIDE_PATHS: Final = 8
"""Primary rays of a pixel for the denoiser's albedo and normals."""
FLOOR: Final = 1e-3
"""Radiance below this share of the picture's mean counts as it: black has no logarithm."""
FRAMES: Final = {"first frames": 1, "walks": 31}
PROBES: Final = 3


@dataclass
class Picture:
    """Errors and costs of one kind of picture in one room: ours, and Mitsuba's by number of paths."""

    ours: float
    ours_s: float
    raw: dict[int, float] = field(default_factory=dict)
    denoised: dict[int, float] = field(default_factory=dict)
    path_s: float = 0.0
    denoise_s: float = 0.0

    def mitsuba_s(self, *, denoise: bool) -> float:
        """Return Mitsuba's processor seconds at our error."""
        errors = self.denoised if denoise else self.raw
        logs = np.log([[paths, max(errors[paths], 1e-9)] for paths in PATHS]).T
        lowest = np.minimum.accumulate(logs[1])
        paths = float(np.exp(np.interp(-np.log(max(self.ours, 1e-9)), -lowest, logs[0])))
        return paths * self.path_s + denoise * self.denoise_s


@dataclass
class RoomCost:
    """One room: seconds of our solution, of our further frames of its walk, and of Mitsuba's scene; two pictures."""

    name: str
    solve_s: float
    further_s: float
    load_s: float
    frame: Picture
    panorama: Picture

    def seconds(self, frames: int) -> tuple[float, float, float]:
        """Return processor seconds of a sequence: ours, Mitsuba's at our error, and Mitsuba's with the denoiser."""
        pictures = ((self.frame, frames), (self.panorama, PROBES))
        ours = self.solve_s + self.frame.ours_s + (frames > 1) * self.further_s + PROBES * self.panorama.ours_s
        raw, clean = (
            self.load_s + sum(count * picture.mitsuba_s(denoise=denoise) for picture, count in pictures)
            for denoise in (False, True)
        )
        return ours, raw, clean


def main() -> None:
    """Print a line for each picture, and the table."""
    parser = ArgumentParser(description="Rooms per hour at equal error, against Mitsuba.")
    parser.add_argument("--rooms", type=int, default=4)
    parser.add_argument("--pixels", type=int, default=300, help="compared pixels of a picture")
    parser.add_argument("--paths", type=int, default=8192, help="the reference's paths of a pixel, for each half")
    parser.add_argument("--furniture", type=Path, default=None)
    given = parser.parse_args()
    compare(0, given.furniture, pixels=4, paths=8)  # compiles kernels
    costs = [compare(room, given.furniture, pixels=given.pixels, paths=given.paths) for room in range(given.rooms)]
    lines: list[str] = []
    for cost in costs:
        lines += [f"{cost.name}: solution {cost.solve_s:.2f} s, 30 further frames {cost.further_s:.2f} s"]
        lines += [f"  frame: {cost.frame}", f"  panorama: {cost.panorama}"]
    for kind, frames in FRAMES.items():
        ours, raw, clean = np.array([cost.seconds(frames) for cost in costs]).T
        rates = ", ".join(f"{3600 / seconds.mean():.1f}" for seconds in (ours, raw, clean))
        lines += [f"{kind}: rooms a core-hour at our error: ours, Mitsuba, Mitsuba with denoiser: {rates}"]
        lines += [f"  times of ours, by room: Mitsuba {raw / ours}, with denoiser {clean / ours}"]
    sys.stdout.write("\n".join(lines) + "\n")


def compare(index: int, furniture: Path | None, *, pixels: int, paths: int) -> RoomCost:
    """Render one room by both; the reference has 2 x `paths` paths at each of `pixels` pixels."""
    room = build_room(index, seed=0, split="train", catalogue=catalogue_for(furniture))
    scene = without_glass(room.scene)
    begin = time.process_time()
    light = RoomLight.solve(Tracer(scene), index)
    solve_s = time.process_time() - begin
    floor = free_floor(room.shell, room.placements, radius_m=BODY_M)
    free = FreeSpace(floor.free, floor.origin, floor.cell_m, Tracer(room.scene).distances)
    rng = room_generator(index, seed=0, split="train", purpose=1)
    path = plan_camera_path(LitRoom(room, light, free), rng, probes=1)
    begin = time.process_time()
    reference = Reference(scene, variant="llvm_ad_rgb")
    load_s = time.process_time() - begin

    begin = time.process_time()
    frame = light.frame(path.intrinsics, path.poses[0], seed=index).radiance
    frame_s = time.process_time() - begin
    begin = time.process_time()
    panorama = light.panorama(path.probes[0], PROBE_HEIGHT, seed=index)
    panorama_s = time.process_time() - begin
    begin = time.process_time()
    for number, pose in enumerate(path.poses[1:]):
        light.frame(path.intrinsics, pose, seed=index + number + 1)
    further_s = time.process_time() - begin

    eye = PictureRays.through_pixels(path.intrinsics, path.poses[0])
    around = PictureRays.around(path.probes[0], PROBE_HEIGHT)
    sun = np.zeros((1, *panorama.shape), np.float32)
    add_sun(sun, reference, scene, path.probes[0])
    return RoomCost(
        room.name,
        solve_s,
        further_s,
        load_s,
        _picture(reference, eye, frame, frame_s, np.zeros_like(frame), pixels=pixels, paths=paths, seed=index),
        _picture(reference, around, panorama, panorama_s, sun[0], pixels=pixels, paths=paths, seed=1000 + index),
    )


def _picture(
    reference: Reference,
    rays: PictureRays,
    ours: Float32[np.ndarray, "h w 3"],
    ours_s: float,
    sun: Float32[np.ndarray, "h w 3"],
    *,
    pixels: int,
    paths: int,
    seed: int,
) -> Picture:
    """Measure one picture; the sun's disc, which paths do not meet, is added to Mitsuba's."""
    shape = ours.shape
    directions, spread = rays.directions.reshape(-1, 3), rays.spread.reshape(-1, 2, 3)
    origins = np.tile(rays.origin, (len(directions), 1))
    weight = np.sqrt(np.clip(1 - (directions[:, 1] / np.linalg.norm(directions, axis=1)) ** 2, 1e-3, 1))
    share = np.full(len(weight), 1 / len(weight)) if shape[1] != 2 * shape[0] else weight / weight.sum()
    chosen = np.random.default_rng(seed).choice(len(directions), pixels, replace=False, p=share)
    some, some_spread = directions[chosen], spread[chosen]
    halves = [
        reference.radiance(origins[chosen], some, samples=paths, seed=seed + 7 * half, spread=some_spread)
        + sun.reshape(-1, 3)[chosen]
        for half in (1, 2)
    ]
    floor = FLOOR * float((np.mean(halves, 0) @ LUMINANCE).mean())

    def error(image: Float[np.ndarray, "h w 3"]) -> float:
        ours, a, b = (np.log(np.maximum(light @ LUMINANCE, floor)) for light in (image.reshape(-1, 3)[chosen], *halves))
        return float(((ours - a) * (ours - b)).mean())

    result = Picture(error(ours), ours_s)
    begin = time.process_time()
    guides = reference.first_surfaces(origins, directions, samples=GUIDE_PATHS, spread=spread)
    albedo, normal = (np.ascontiguousarray(guide.reshape(shape)) for guide in guides)
    guides_s = time.process_time() - begin
    total, done, spent_s = np.zeros(shape), 0, 0.0
    for count in PATHS:
        begin = time.process_time()
        more = reference.radiance(origins, directions, samples=count - done, seed=seed + 100 + count, spread=spread)
        total += more.reshape(shape) * (count - done)
        spent_s += time.process_time() - begin
        done = count
        image = (total / count).astype(np.float32)
        result.raw[count] = error(image + sun)
        begin = time.process_time()
        clean = import_module("pyoidn").denoise(image, albedo=albedo, normal=normal, hdr=True)
        result.denoise_s = guides_s + time.process_time() - begin
        result.denoised[count] = error(np.maximum(clean, 0) + sun)
    result.path_s = spent_s / done
    return result


if __name__ == "__main__":
    main()
