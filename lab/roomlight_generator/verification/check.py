"""Comparison of the generator's light with a path tracer's, on the generator's own rooms.

Each room is solved as for a dataset; its first frame and one probe are rendered by both, from the same triangles. Glass
is removed for both: the path tracer leaves it out (`verification.reference`).

A path tracer's picture of a sunlit room has 25 % noise after 500 paths a pixel. Errors are therefore measured at some
of the frame's pixels, and over blocks of 4 x 4 around them (which average out our own noise), with as many paths each
as they need; whole pictures, with few paths, serve for viewing and for sums. Errors are given with and without the
reference's remaining noise (`verification.deviation`); rooms in which it exceeds `JUDGED_NOISE` are counted apart.

World frame: y up, metres; radiance in kcd/m2.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.camera import Intrinsics
from roomlight.conventions import direction_to_uv, panorama_directions, panorama_solid_angles
from roomlight.dataset.recording import Split
from roomlight.errors import DatasetError
from roomlight.metrics import log_l2
from roomlight_generator.rooms.build import build_room, room_generator
from roomlight_generator.rooms.planner import free_floor
from roomlight_generator.rooms.scene import Scene
from roomlight_generator.sequences.render import LitRoom, catalogue_for, plan_camera_path
from roomlight_generator.sequences.surface_kinds import SurfaceKinds, surface_kinds, without_glass
from roomlight_generator.sequences.walk import FreeSpace
from roomlight_generator.transport import RoomLight, Tracer
from roomlight_generator.verification.deviation import Deviation, cube_normals, deviation, irradiance, luminance, pooled
from roomlight_generator.verification.reference import Reference

FRAME: Final = (160, 120)
"""Width and height of the frame."""
PROBE_HEIGHT: Final = 120
BODY_M: Final = 0.25
"""Radius of the body that walks, as for a dataset."""
BLOCK: Final = 4
"""Pixels along a block's side."""
POINTS: Final = 96
"""Blocks of each kind of surface in a room: if their errors scatter by 5 %, the mean is known to 0.5 %."""
NOISE: Final = 0.02
"""Mean noise at which the reference stops: a sixth of a 5 % error, in squares."""
PATHS: Final = 12_000_000
"""Most paths for a room's points: a minute on two cores. Few rooms reach `NOISE` with that many."""
BLOCK_SHARE: Final = 0.75
"""Share of these paths for blocks; the rest is for single pixels."""
JUDGED_NOISE: Final = 0.05
"""Rooms whose reference has more noise in the blocks than this, the target error, are not judged."""

_LEAST_BLOCKS: Final = 12
_PATHS_A_ROUND: Final = 500_000
_SUN_SAMPLES: Final = 256


@dataclass(frozen=True, eq=False)
class View:
    """One picture by both renderers, the reference in two halves, and the seconds that each took."""

    ours: Float[np.ndarray, "h w 3"]
    halves: Float[np.ndarray, "2 h w 3"]
    ours_s: float
    reference_s: float

    @property
    def reference(self) -> Float[np.ndarray, "h w 3"]:
        """The mean of the halves."""
        return self.halves.mean(0)


@dataclass(frozen=True)
class SurfaceDeviation:
    """Errors of one kind of surface in a frame, for single pixels and blocks of 4 x 4.

    bias is the signed relative difference of the sums over all its pixels.
    """

    pixels: Deviation
    blocks: Deviation
    bias: float


@dataclass(frozen=True)
class ProbeDeviation:
    """Errors of irradiance at 26 normals, and of the panorama.

    Attributes:
        irradiance: Mean relative error of luminance.
        noise: The reference's own mean relative error.
        bias: Relative difference of the sums.
        log_l2: Error of the panorama, in units in which the frame's geometric mean is 0.18.
    """

    irradiance: float
    noise: float
    bias: float
    log_l2: float


@dataclass(frozen=True, eq=False)
class RoomCheck:
    """One room's figures and pictures.

    Attributes:
        diffuse, coated: None if too little of such surfaces is in view.
        paths: Paths of each point.
        points_s: Seconds for the points.
    """

    name: str
    about: str
    solve_s: float
    frame: View
    panorama: View
    kinds: SurfaceKinds
    diffuse: SurfaceDeviation | None
    coated: SurfaceDeviation | None
    probe: ProbeDeviation
    paths: int
    points_s: float


@dataclass(frozen=True, eq=False)
class CheckReport:
    """All rooms, and the messages of rooms without a place for a camera and its probe."""

    rooms: tuple[RoomCheck, ...]
    left_out: tuple[str, ...]

    def diffuse(self) -> SurfaceDeviation | None:
        """Average over all rooms, weighted by points; the bias is the mean of the rooms'."""
        return _pooled([room.diffuse for room in self.rooms])

    def judged(self) -> tuple[RoomCheck, ...]:
        """Return the rooms in which the reference has at most `JUDGED_NOISE` on diffuse surfaces."""
        known = [room for room in self.rooms if room.diffuse is not None]
        return tuple(room for room in known if room.diffuse and room.diffuse.blocks.noise <= JUDGED_NOISE)

    def coated(self) -> SurfaceDeviation | None:
        """Average over all rooms, weighted by points; the bias is the mean of the rooms'."""
        return _pooled([room.coated for room in self.rooms])

    def probe(self) -> ProbeDeviation:
        """Average over the rooms."""
        probes = [room.probe for room in self.rooms]
        names = ("irradiance", "noise", "bias", "log_l2")
        return ProbeDeviation(*(float(np.mean([getattr(probe, name) for probe in probes])) for name in names))


def check_rooms(
    rooms: int,
    *,
    seed: int = 0,
    split: Split = "train",
    furniture: Path | None = None,
    first: int = 0,
    samples: int = 64,
    paths: int = PATHS,
    done: Callable[[RoomCheck], None] | None = None,
) -> CheckReport:
    """Compare both renderers in a number of rooms.

    A room without a place for a camera is left out, and the next room is taken.

    Args:
        rooms: Number of rooms.
        seed: Seed of the rooms.
        split: Split of the rooms.
        furniture: Furniture library; default: the installed libraries.
        first: Index of the first room.
        samples: Paths of a pixel in pictures.
        paths: Most paths for the points of a room.
        done: Called after each room.

    Raises:
        ImportError: if Mitsuba is not installed.
    """
    catalogue = catalogue_for(furniture)
    checks: list[RoomCheck] = []
    left_out: list[str] = []
    index = first
    while len(checks) < rooms:
        room = build_room(index, seed=seed, split=split, catalogue=catalogue)
        tracer = Tracer(without_glass(room.scene))
        begin = time.perf_counter()
        light = RoomLight.solve(tracer, index)
        solve_s = time.perf_counter() - begin
        floor = free_floor(room.shell, room.placements, radius_m=BODY_M)
        free = FreeSpace(floor.free, floor.origin, floor.cell_m, Tracer(room.scene).distances)
        lit_room = LitRoom(room, light, free)
        try:
            path = plan_camera_path(lit_room, room_generator(index, seed=seed, split=split, purpose=1), probes=1)
        except (DatasetError, ValueError) as error:
            left_out.append(str(error))
        else:
            camera = path.intrinsics.resized(*FRAME)
            check = _compared(
                light, camera, path.poses[0], path.probes[0], samples=samples, paths=paths, seed=index,
                probe_height=PROBE_HEIGHT, solve_s=solve_s, name=room.name,
                about=f"{room.room_type}, {_light(lit_room)}",
            )  # fmt: skip
            checks.append(check)
            if done:
                done(check)
        index += 1
    return CheckReport(tuple(checks), tuple(left_out))


def check_view(
    scene: Scene,
    camera: Intrinsics,
    camera_to_world: Float[np.ndarray, "4 4"],
    probe: Float[np.ndarray, "3"],
    *,
    samples: int,
    paths: int,
    seed: int = 0,
    probe_height: int = PROBE_HEIGHT,
    name: str = "",
    about: str = "",
) -> RoomCheck:
    """Check one frame and one probe (world, metres) of a scene without its glass."""
    begin = time.perf_counter()
    light = RoomLight.solve(Tracer(without_glass(scene)), seed)
    solve_s = time.perf_counter() - begin
    return _compared(
        light, camera, camera_to_world, probe, samples=samples, paths=paths, seed=seed, probe_height=probe_height,
        solve_s=solve_s, name=name, about=about,
    )  # fmt: skip


def _compared(
    light: RoomLight,
    camera: Intrinsics,
    camera_to_world: Float[np.ndarray, "4 4"],
    probe: Float[np.ndarray, "3"],
    *,
    samples: int,
    paths: int,
    seed: int,
    probe_height: int,
    solve_s: float,
    name: str,
    about: str,
) -> RoomCheck:
    """Render one frame and one probe of a solved scene by both, and compare them."""
    tracer = light.tracer
    scene = tracer.scene
    reference = Reference(scene)
    seeds = np.random.SeedSequence([seed, 0x636B]).generate_state(6).tolist()

    begin = time.perf_counter()
    frame = light.frame(camera, camera_to_world, seed=seed).radiance
    frame_s = time.perf_counter() - begin
    eye = PictureRays.through_pixels(camera, camera_to_world)
    frames = _rendered(reference, frame, frame_s, eye, samples=samples, seeds=seeds[:2])

    begin = time.perf_counter()
    panorama = light.panorama(probe, height=probe_height, seed=seed)
    panorama_s = time.perf_counter() - begin
    around = PictureRays.around(probe, probe_height)
    panoramas = _rendered(reference, panorama, panorama_s, around, samples=samples, seeds=seeds[2:4])
    add_sun(panoramas.halves, reference, scene, probe)

    begin = time.perf_counter()
    kinds = surface_kinds(tracer, camera, camera_to_world)
    rng = np.random.default_rng(seeds[4])
    chosen = {"diffuse": _blocks_of(kinds.diffuse, rng), "coated": _blocks_of(kinds.coated, rng)}
    every = np.concatenate(list(chosen.values()))
    for_blocks = int(BLOCK_SHARE * paths)
    blocks, spent = _points(reference, eye, every, size=BLOCK, paths=for_blocks, seed=seeds[5])
    pixel = every + rng.integers(BLOCK, size=every.shape)
    pixels, spent_on_pixels = _points(reference, eye, pixel, size=1, paths=paths - for_blocks, seed=seeds[5] + 1)
    surfaces: dict[str, SurfaceDeviation | None] = {}
    start = 0
    for kind, at in chosen.items():
        part = slice(start, start + len(at))
        start += len(at)
        surfaces[kind] = None
        if len(at):
            of_kind = getattr(kinds, kind)
            bias = luminance(frame)[of_kind].sum() / max(luminance(frames.reference)[of_kind].sum(), 1e-30) - 1
            own = [frame[row : row + BLOCK, column : column + BLOCK].mean((0, 1)) for row, column in at.tolist()]
            surfaces[kind] = SurfaceDeviation(
                pixels=deviation(frame[tuple(pixel[part].T)], pixels[:, part]),
                blocks=deviation(np.array(own), blocks[:, part]),
                bias=float(bias),
            )
    return RoomCheck(
        name=name,
        about=about,
        solve_s=solve_s,
        frame=frames,
        panorama=panoramas,
        kinds=kinds,
        diffuse=surfaces["diffuse"],
        coated=surfaces["coated"],
        probe=_probe_deviation(panoramas, frames.reference),
        paths=max(spent, spent_on_pixels),
        points_s=time.perf_counter() - begin,
    )


@dataclass(frozen=True, eq=False)
class PictureRays:
    """A picture's rays from one point (world frame), and the two vectors that span the pixel of each ray."""

    origin: Float[np.ndarray, "3"]
    directions: Float[np.ndarray, "h w 3"]
    spread: Float[np.ndarray, "h w 2 3"]

    @classmethod
    def through_pixels(cls, camera: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"]) -> "PictureRays":
        """Return the rays of a frame."""
        rotation = camera_to_world[:3, :3]
        across = np.array([[1 / camera.fx, 0, 0], [0, -1 / camera.fy, 0]]) @ rotation.T
        spread = np.tile(across, (camera.height, camera.width, 1, 1))
        return cls(camera_to_world[:3, 3], camera.rays().astype(np.float64) @ rotation.T, spread)

    @classmethod
    def around(cls, position: Float[np.ndarray, "3"], height: int) -> "PictureRays":
        """Return the rays of a panorama."""
        directions = panorama_directions(height).astype(np.float64)
        x, y, z = np.moveaxis(directions, -1, 0)
        ring = np.sqrt(x**2 + z**2)
        along = np.stack([-z, np.zeros_like(x), x], -1)
        down = np.stack([x * y / ring, -ring, z * y / ring], -1)
        return cls(np.asarray(position, np.float64), directions, np.stack([along, down], -2) * (np.pi / height))


def _rendered(
    reference: Reference,
    ours: Float[np.ndarray, "h w 3"],
    ours_s: float,
    rays: PictureRays,
    *,
    samples: int,
    seeds: list[int],
) -> View:
    """Render the reference's two halves beside our picture."""
    begin = time.perf_counter()
    directions, spread = rays.directions.reshape(-1, 3), rays.spread.reshape(-1, 2, 3)
    origins = np.tile(rays.origin, (len(directions), 1))
    share = max(1, samples // 2)
    halves = [
        reference.radiance(origins, directions, samples=share, seed=seed, spread=spread).reshape(ours.shape)
        for seed in seeds
    ]
    return View(ours, np.stack(halves), ours_s, time.perf_counter() - begin)


def add_sun(
    halves: Float[np.ndarray, "2 h w 3"], reference: Reference, scene: Scene, position: Float[np.ndarray, "3"]
) -> None:
    """Add the sun's disc to a panorama where it is in view, because paths do not meet it."""
    if scene.sky.sun is None:
        return
    height, width = halves.shape[1:3]
    uv = direction_to_uv(reference.sun_seen(position, samples=_SUN_SAMPLES))
    row = np.minimum((uv[:, 1] * height).astype(int), height - 1)
    column = np.minimum((uv[:, 0] * width).astype(int), width - 1)
    radiance = np.array(scene.sky.sun.irradiance) / _SUN_SAMPLES / panorama_solid_angles(height)[row]
    for half in halves:
        np.add.at(half, (row, column), radiance.astype(np.float32))


def _blocks_of(kind: Bool[np.ndarray, "h w"], rng: np.random.Generator) -> Int[np.ndarray, "n 2"]:
    """Choose blocks whose pixels all show the kind, by their upper left pixels; none if there are few."""
    rows, columns = kind.shape[0] // BLOCK, kind.shape[1] // BLOCK
    whole = kind[: rows * BLOCK, : columns * BLOCK].reshape(rows, BLOCK, columns, BLOCK).all((1, 3))
    at = np.argwhere(whole)
    if len(at) < _LEAST_BLOCKS:
        at = at[:0]
    return BLOCK * rng.permutation(at)[:POINTS]


def _points(
    reference: Reference, rays: PictureRays, at: Int[np.ndarray, "n 2"], *, size: int, paths: int, seed: int
) -> tuple[Float[np.ndarray, "2 n 3"], int]:
    """Compute the reference's halves over squares of pixels, given by their upper left pixels; also the paths used."""
    count = len(at)
    halves = np.zeros((2, count, 3), np.float32)
    if not count:
        return halves, 0
    first = tuple(at.T)
    spread = rays.spread[first]
    directions = rays.directions[first] + spread.sum(1) * ((size - 1) / 2)
    origins = np.tile(rays.origin, (count, 1))
    share = max(1, min(_PATHS_A_ROUND, paths) // (2 * count))
    rounds = 0
    while not rounds or 2 * (rounds + 1) * share * count <= paths:
        for half in range(2):
            own = (seed % 2**31 + 7919 * rounds) * 2 + half
            seen = reference.radiance(origins, directions, samples=share, seed=own, spread=size * spread)
            halves[half] += (seen - halves[half]) / (rounds + 1)
        rounds += 1
        if deviation(halves.mean(0), halves).noise <= NOISE:
            break
    return halves, 2 * share * rounds


def _probe_deviation(view: View, frame: Float[np.ndarray, "h w 3"]) -> ProbeDeviation:
    normals = cube_normals()
    ours, a, b = (luminance(irradiance(panorama, normals)) for panorama in (view.ours, *view.halves))
    truth = np.maximum((a + b) / 2, 1e-12)
    luminances = luminance(frame)
    scale = np.float32(0.18 / np.exp(np.log(np.maximum(luminances, 1e-3 * luminances.mean() + 1e-12)).mean()))
    return ProbeDeviation(
        irradiance=float((np.abs(ours - truth) / truth).mean()),
        noise=float((np.abs(a - b) / 2 / truth).mean()),
        bias=float(ours.sum() / truth.sum() - 1),
        log_l2=log_l2(scale * view.ours, scale * view.reference),
    )


def _pooled(parts: list[SurfaceDeviation | None]) -> SurfaceDeviation | None:
    known = [part for part in parts if part is not None]
    pixels, blocks = pooled([part.pixels for part in known]), pooled([part.blocks for part in known])
    if pixels is None or blocks is None:
        return None
    return SurfaceDeviation(pixels, blocks, float(np.mean([part.bias for part in known])))


def _light(lit_room: LitRoom) -> str:
    facts = lit_room.room.facts["light"]
    kinds = sorted({str(source["kind"]) for source in facts["sources"]})
    return f"{facts['scenario']}: {', '.join(kinds)}"
