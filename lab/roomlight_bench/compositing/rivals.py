"""Rendered objects by size, and beside Mitsuba 3: `roomlight bench composite --sizes` and `--mitsuba`.

Sizes: one sphere at several numbers of triangles and of pixels, in each quality: time to build its tree, and to render.

Mitsuba renders the same sphere under the same panorama with the same number of surfaces on a path, by each of several
samplers, as `scalar_rgb` and, where a usable LLVM is installed, as `llvm_ad_rgb` after a first picture that compiles.
An error is the RMSE against the renderer's own picture of many samples, relative to that picture's mean; the two
pictures of many samples are compared as well. Processor time of all threads; building the scene is not counted.
"""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, TypeVar, cast

import numpy as np
from jaxtyping import Float
from rich import box
from rich.table import Table

from roomlight.camera import Intrinsics
from roomlight.compositing.light.lighting import ProbeSet
from roomlight.compositing.objects.materials import Material, diffuse, rough_metal
from roomlight.compositing.objects.primitives import sphere
from roomlight.compositing.objects.virtual_object import TriangleMesh, VirtualObject
from roomlight.compositing.rendering.renderer import PRESETS, RenderSettings, render_objects
from roomlight.compositing.rendering.tracer import TracedObjects
from roomlight_bench.reporting import Criterion, short_number
from roomlight_bench.timing import ProgressCallback
from roomlight_generator.verification.reference import usable_variant

FASTER: Final = 3.0
"""Target: Mitsuba's time at our error, relative to ours, of its fastest sampler and variant."""
ALIKE: Final = 0.02
"""Greatest difference of the two renderers' pictures of many samples: noise is 0.01, and ours has triangles."""
SAMPLERS: Final = ("multijitter", "ldsampler", "independent")
REPEATS: Final = 3
"""Pictures by each effort."""
COUNTS: Final = (4, 16, 64)
REFERENCE: Final = 2048
SIDE: Final = 48
TRIANGLES: Final = (100, 5_000, 50_000, 500_000)
SIDES: Final = (64, 128, 256)
"""Columns and rows of square pictures that the sphere fills to 60 %."""
_BOUNCES: Final = 6
_ALPHA: Final = 0.25
_FIELD_DEG: Final = 30.0
_EYE: Final = (0.0, 0.5, 2.5)
_COLOUR: Final = (0.8, 0.5, 0.2)
_FINER: Final = 4
"""Rows of Mitsuba's panorama, relative to ours: its rows are at other heights."""

Picture = Float[np.ndarray, "h w 3"]


_T = TypeVar("_T")


@dataclass(frozen=True)
class SizeTimes:
    """Processor time in milliseconds for one sphere: its tree, and its picture by quality."""

    triangles: int
    pixels: int
    build_ms: float
    render_ms: dict[str, float]


@dataclass(frozen=True)
class Effort:
    """Relative RMSE and processor time at a number of samples a pixel."""

    samples: int
    cpu_ms: float
    error: float


@dataclass(frozen=True)
class Rivalry:
    """One material in both renderers.

    Attributes:
        material: Name of the material.
        ours: Efforts by growing numbers of samples.
        mitsuba: The same by variant and sampler of Mitsuba.
        difference: RMSE between the two pictures of many samples, relative to their mean.
    """

    material: str
    ours: tuple[Effort, ...]
    mitsuba: Mapping[str, tuple[Effort, ...]]
    difference: float

    def time_ratios(self) -> dict[str, float]:
        """Return each rival's time / ours at the error of our most samples, by a power law through its efforts."""
        wanted = self.ours[-1]
        return {
            name: _power_law([(effort.error, effort.cpu_ms) for effort in efforts], wanted.error) / wanted.cpu_ms
            for name, efforts in self.mitsuba.items()
        }

    def error_ratios(self) -> dict[str, float]:
        """Return each rival's error / ours at the time of our most samples."""
        wanted = self.ours[-1]
        return {
            name: _power_law([(effort.cpu_ms, effort.error) for effort in efforts], wanted.cpu_ms) / wanted.error
            for name, efforts in self.mitsuba.items()
        }


@dataclass(frozen=True)
class RivalReport:
    """Sizes and rivalries; either may be empty."""

    sizes: tuple[SizeTimes, ...] = ()
    rivals: tuple[Rivalry, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return asdict(self) | {"criteria": [asdict(criterion) for criterion in self.criteria()]}

    def criteria(self) -> tuple[Criterion, ...]:
        """Return for each material the limits on the fastest rival's time, and on the difference of the pictures."""
        criteria: list[Criterion] = []
        for rivalry in self.rivals:
            ratio = min(rivalry.time_ratios().values())
            name = f"fastest Mitsuba's time at our error, {rivalry.material} (at least {FASTER:g} times ours)"
            criteria.append(Criterion(name, ratio, FASTER, ratio >= FASTER))
            name = f"difference of the pictures of many samples, {rivalry.material} (at most {ALIKE:g})"
            criteria.append(Criterion(name, rivalry.difference, ALIKE, rivalry.difference <= ALIKE))
        return tuple(criteria)

    def size_table(self) -> Table:
        """Return a table with a row per size."""
        table = _table("A sphere by size, processor time in milliseconds")
        for heading in ("triangles", "pixels", "tree", *PRESETS):
            table.add_column(heading, justify="right")
        for row in self.sizes:
            times = (row.build_ms, *(row.render_ms[name] for name in PRESETS))
            table.add_row(str(row.triangles), str(row.pixels), *(short_number(value) for value in times))
        return table

    def rival_table(self) -> Table:
        """Return a table with a row per material, renderer and number of samples."""
        table = _table("The same sphere in Mitsuba 3: CPU ms and relative RMSE by samples; Mitsuba relative to ours")
        counts = [effort.samples for effort in self.rivals[0].ours] if self.rivals else []
        for heading in ("material", "renderer", *map(str, counts), "time at our error", "error at our time"):
            table.add_column(heading, justify="right")
        for row in self.rivals:
            table.add_row(row.material, "ours", *map(_effort_text, row.ours), "1", "1")
            times, errors = row.time_ratios(), row.error_ratios()
            for name, efforts in row.mitsuba.items():
                table.add_row("", name, *map(_effort_text, efforts), f"{times[name]:.1f}", f"{errors[name]:.1f}")
        return table


def run_sizes(
    *,
    triangles: tuple[int, ...] = TRIANGLES,
    sides: tuple[int, ...] = SIDES,
    progress: ProgressCallback | None = None,
) -> tuple[SizeTimes, ...]:
    """Time a sphere of each number of triangles at the middle size, and one of the second at each size."""
    middle = sides[len(sides) // 2]
    wanted = [(count, middle) for count in triangles]
    wanted += [(triangles[min(1, len(triangles) - 1)], side) for side in sides if side != middle]
    lights = ProbeSet.single(_panorama())
    sizes: list[SizeTimes] = []
    for count, side in wanted:
        if progress is not None:
            progress(f"a sphere of {count} triangles, {side} x {side} pixels")
        sphere = _sphere_of(count)
        built, build_ms = _timed(lambda sphere=sphere: TracedObjects([sphere]))
        times: dict[str, float] = {}
        pixels = 0
        for name in PRESETS:
            render = _renderer(built, lights, side, name)
            pixels = int(np.count_nonzero(render().max(axis=-1)))  # also loads kernels and tables
            _, times[name] = _timed(render)
        sizes.append(SizeTimes(sphere.triangles, pixels, build_ms, times))
    return tuple(sizes)


def run_rivals(
    *,
    counts: tuple[int, ...] = COUNTS,
    reference: int = REFERENCE,
    samplers: tuple[str, ...] = SAMPLERS,
    progress: ProgressCallback | None = None,
) -> tuple[Rivalry, ...]:
    """Render spheres by both renderers at each number of samples.

    Raises:
        ImportError: Mitsuba is not installed.
    """
    report = progress or _ignore
    variants = tuple(dict.fromkeys(("scalar_rgb", usable_variant())))
    lights = ProbeSet.single(_panorama())
    rivalries: list[Rivalry] = []
    for name, material in {"diffuse": diffuse(_COLOUR), "rough metal": rough_metal(_ALPHA**0.5)}.items():
        scene = TracedObjects([sphere(0.5, material)])

        def ours(samples: int, seed: int, scene: TracedObjects = scene) -> Picture:
            return _renderer(scene, lights, SIDE, RenderSettings(samples, _BOUNCES, denoised=False), seed)()

        report(f"{name}: ours")
        exact = ours(reference, 99)
        efforts = _efforts(ours, counts, exact)
        report(f"{name}: Mitsuba, {reference} samples")
        theirs = _mitsuba(material, "scalar_rgb", SAMPLERS[0])(reference, 99)
        rivals: dict[str, tuple[Effort, ...]] = {}
        for variant in variants:
            for sampler in samplers:
                report(f"{name}: Mitsuba, {variant}, {sampler}")
                rivals[f"{variant}, {sampler}"] = _efforts(_mitsuba(material, variant, sampler), counts, theirs)
        rivalries.append(Rivalry(name, efforts, rivals, _error(exact, theirs)))
    return tuple(rivalries)


def _ignore(_: str) -> None:
    pass


def _efforts(render: Callable[[int, int], Picture], counts: tuple[int, ...], exact: Picture) -> tuple[Effort, ...]:
    """Render `REPEATS` pictures of each number of samples, after one that is not measured; returns their means."""
    efforts: list[Effort] = []
    for samples in counts:
        render(samples, 0)
        timed = [_timed(lambda samples=samples, seed=seed: render(samples, seed)) for seed in range(1, REPEATS + 1)]
        squares = [_error(picture, exact) ** 2 for picture, _ in timed]
        times = [cpu_ms for _, cpu_ms in timed]
        efforts.append(Effort(samples, float(np.mean(times)), float(np.mean(squares)) ** 0.5))
    return tuple(efforts)


def _error(picture: Picture, exact: Picture) -> float:
    """Return the RMSE in the pixels that show the object, relative to their mean."""
    covered = (exact > 0).any(axis=-1)
    return float(np.sqrt(np.mean((picture - exact)[covered] ** 2)) / exact[covered].mean())


def _effort_text(effort: Effort) -> str:
    return f"{effort.cpu_ms:.3g} ms {effort.error:.2g}"


def _renderer(
    scene: TracedObjects, lights: ProbeSet, side: int, quality: str | RenderSettings, seed: int = 0
) -> Callable[[], Picture]:
    focal = side / 2 / np.tan(np.radians(_FIELD_DEG / 2))
    camera = Intrinsics(focal, focal, side / 2, side / 2, side, side)
    pose = np.eye(4)
    back = np.array(_EYE) / np.linalg.norm(_EYE)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    pose[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
    pose[:3, 3] = _EYE
    return lambda: render_objects(scene, camera, pose, lights, quality=quality, seed=seed).radiance


def _mitsuba(material: Material, variant: str, sampler: str) -> Callable[[int, int], Picture]:
    import mitsuba

    mitsuba.set_variant(variant)
    grey = {"type": "rgb", "value": list(material.base_colour)}
    bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": grey}
    if material.metallic:
        bsdf = {"type": "roughconductor", "material": "none", "alpha": _ALPHA, "distribution": "ggx"}
    scene = mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": _BOUNCES + 1, "rr_depth": 1000, "hide_emitters": True},
            "light": {"type": "envmap", "bitmap": mitsuba.Bitmap(_mitsuba_panorama())},
            "sphere": {"type": "sphere", "radius": 0.5, "bsdf": bsdf},
            "sensor": {
                "type": "perspective",
                "fov": _FIELD_DEG,
                "to_world": mitsuba.ScalarTransform4f().look_at(origin=list(_EYE), target=[0, 0, 0], up=[0, 1, 0]),
                "film": {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}},
                "sampler": {"type": sampler},
            },
        }
    )

    def render(samples: int, seed: int) -> Picture:
        if sampler == "multijitter":  # takes rectangles only, and would round up
            samples = math.isqrt(samples) ** 2
        mitsuba.set_variant(variant)
        image: Any = mitsuba.render(scene, spp=samples, seed=cast(Any, seed))
        return np.array(image)[..., :3]

    return render


def _mitsuba_panorama() -> Float[np.ndarray, "h w 3"]:
    """Resample the panorama so that Mitsuba reads it by the same directions: -z at its left edge, rows on the poles."""
    rows = _FINER * len(_panorama())
    theta = np.arange(rows) / (rows - 1) * np.pi
    phi = (np.arange(2 * rows) + 0.5) / (2 * rows) * 2 * np.pi
    x, z = np.sin(theta)[:, None] * np.sin(phi), -np.sin(theta)[:, None] * np.cos(phi)
    directions = np.stack([x, np.broadcast_to(np.cos(theta)[:, None], x.shape), z], axis=-1).reshape(-1, 3)
    seen = ProbeSet.single(_panorama()).radiance(np.zeros_like(directions), directions)
    return seen.reshape(rows, 2 * rows, 3)


def _sphere_of(triangles: int) -> VirtualObject:
    """Return a rough metal sphere of about so many triangles: rings of quads."""
    rows = max(4, round((triangles / 4) ** 0.5))
    theta = np.linspace(0, np.pi, rows + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, 2 * rows + 1)
    normals = np.stack(
        [np.sin(theta) * np.cos(phi), np.cos(theta) + 0 * phi, np.sin(theta) * np.sin(phi)], axis=-1
    ).reshape(-1, 3)
    first = (np.arange(rows)[:, None] * (2 * rows + 1) + np.arange(2 * rows)).reshape(-1)
    below = first + 2 * rows + 1
    faces = np.concatenate([np.stack([first, first + 1, below], 1), np.stack([first + 1, below + 1, below], 1)])
    mesh = TriangleMesh.build(0.5 * normals, faces, normals=normals)
    return VirtualObject("sphere", ((mesh, rough_metal(_ALPHA**0.5)),))


def _panorama() -> Float[np.ndarray, "h w 3"]:
    """Return an uneven room with a small lamp."""
    rng = np.random.default_rng(7)
    panorama = np.kron(rng.random((4, 8, 3)), np.ones((8, 8, 1)))
    panorama[6:9, 20:24] = 20.0
    return panorama.astype(np.float32)


def _timed(work: Callable[[], _T]) -> tuple[_T, float]:
    began = time.process_time()
    made = work()
    return made, (time.process_time() - began) * 1e3


def _power_law(points: list[tuple[float, float]], at: float) -> float:
    """Return y at x by the straight line through the logarithms of some points (x, y)."""
    x, y = np.log(np.maximum(np.array(points), 1e-12)).T
    slope, start = np.polyfit(x, y, 1)
    return float(np.exp(start + slope * np.log(at)))


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, show_edge=False)
