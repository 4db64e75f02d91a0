"""Rendered objects by size, and beside Mitsuba 3: `roomlight bench composite --sizes` and `--mitsuba`.

Sizes: one sphere at several numbers of triangles and of pixels, in each quality: time to build its tree, and to render.

Mitsuba renders the same sphere under the same panorama with the same number of surfaces on a path. Each renderer's
error is the RMSE against its own picture of many samples, relative to that picture's mean: materials differ by 2 %
between the two, which is no noise. Processor time of all threads; building the scene is not counted.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Final, TypeVar, cast

import numpy as np
from jaxtyping import Float
from rich import box
from rich.table import Table

from roomlight.camera import Intrinsics
from roomlight.compositing.lighting import ProbeSet
from roomlight.compositing.materials import Material, diffuse, rough_metal
from roomlight.compositing.objects import TriangleMesh, VirtualObject
from roomlight.compositing.primitives import sphere
from roomlight.compositing.rendering import PRESETS, RenderSettings, render_objects
from roomlight.compositing.tracer import ObjectScene
from roomlight_bench.reporting import Criterion, short_number
from roomlight_bench.timing import ProgressCallback

FASTER: Final = 3.0
"""Target: Mitsuba's time at our error, relative to ours."""
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
    """One material in both renderers."""

    material: str
    ours: tuple[Effort, ...]
    mitsuba: tuple[Effort, ...]

    def time_ratio(self) -> float:
        """Return Mitsuba's time / ours at the error of our most samples, by a power law through its efforts."""
        wanted = self.ours[-1]
        return _power_law([(one.error, one.cpu_ms) for one in self.mitsuba], wanted.error) / wanted.cpu_ms

    def error_ratio(self) -> float:
        """Return Mitsuba's error / ours at the time of our most samples."""
        wanted = self.ours[-1]
        return _power_law([(one.cpu_ms, one.error) for one in self.mitsuba], wanted.cpu_ms) / wanted.error


@dataclass(frozen=True)
class RivalReport:
    """Sizes and rivalries; either may be empty."""

    sizes: tuple[SizeTimes, ...] = ()
    rivals: tuple[Rivalry, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return asdict(self) | {"criteria": [asdict(one) for one in self.criteria()]}

    def criteria(self) -> tuple[Criterion, ...]:
        """Return the limit on time at equal error, for each material."""
        return tuple(
            Criterion(
                f"Mitsuba's time at our error, {one.material} (at least {FASTER:g} times ours)",
                one.time_ratio(),
                FASTER,
                one.time_ratio() >= FASTER,
            )
            for one in self.rivals
        )

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
        table = _table("The same sphere in Mitsuba 3: relative RMSE against each renderer's own reference")
        for heading in ("material", "samples", "ours: CPU ms", "error", "Mitsuba: CPU ms", "error"):
            table.add_column(heading, justify="right")
        for row in self.rivals:
            for ours, other in zip(row.ours, row.mitsuba, strict=True):
                values = (ours.cpu_ms, ours.error, other.cpu_ms, other.error)
                table.add_row(row.material, str(ours.samples), *(short_number(value) for value in values))
            table.add_row(
                f"[bold]{row.material}[/bold]",
                "",
                "time at equal error",
                f"{row.time_ratio():.1f}",
                "error at equal time",
                f"{row.error_ratio():.1f}",
            )
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
    found: list[SizeTimes] = []
    for count, side in wanted:
        if progress is not None:
            progress(f"a sphere of {count} triangles, {side} x {side} pixels")
        one = _sphere_of(count)
        built, build_ms = _timed(lambda one=one: ObjectScene([one]))
        times: dict[str, float] = {}
        pixels = 0
        for name in PRESETS:
            render = _renderer(built, lights, side, name)
            pixels = int(np.count_nonzero(render().max(axis=-1)))  # also loads kernels and tables
            _, times[name] = _timed(render)
        found.append(SizeTimes(one.triangles, pixels, build_ms, times))
    return tuple(found)


def run_rivals(
    *, counts: tuple[int, ...] = COUNTS, reference: int = REFERENCE, progress: ProgressCallback | None = None
) -> tuple[Rivalry, ...]:
    """Render spheres by both renderers at each number of samples.

    Raises:
        ImportError: Mitsuba is not installed.
    """
    lights = ProbeSet.single(_panorama())
    found: list[Rivalry] = []
    for name, material in {"diffuse": diffuse(_COLOUR), "rough metal": rough_metal(_ALPHA**0.5)}.items():
        scene = ObjectScene([sphere(0.5, material)])

        def ours(samples: int, seed: int, scene: ObjectScene = scene) -> Picture:
            return _renderer(scene, lights, SIDE, RenderSettings(samples, _BOUNCES, denoised=False), seed)()

        efforts: list[tuple[Effort, ...]] = []
        for label, render in (("ours", ours), ("Mitsuba", _mitsuba(material))):
            if progress is not None:
                progress(f"{name}: {label}")
            efforts.append(_efforts(render, counts, reference))
        found.append(Rivalry(name, *efforts))
    return tuple(found)


def _efforts(render: Callable[[int, int], Picture], counts: tuple[int, ...], reference: int) -> tuple[Effort, ...]:
    exact = render(reference, 99)
    covered = (exact > 0).any(axis=-1)
    found: list[Effort] = []
    for samples in counts:
        picture, cpu_ms = _timed(lambda samples=samples: render(samples, 1))
        error = float(np.sqrt(np.mean((picture - exact)[covered] ** 2)) / exact[covered].mean())
        found.append(Effort(samples, cpu_ms, error))
    return tuple(found)


def _renderer(
    scene: ObjectScene, lights: ProbeSet, side: int, quality: str | RenderSettings, seed: int = 0
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


def _mitsuba(material: Material) -> Callable[[int, int], Picture]:
    import mitsuba

    mitsuba.set_variant("scalar_rgb")
    grey = {"type": "rgb", "value": list(material.base_colour)}
    bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": grey}
    if material.metallic:
        bsdf = {"type": "roughconductor", "material": "none", "alpha": _ALPHA, "distribution": "ggx"}
    scene = mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": _BOUNCES + 1, "rr_depth": 1000, "hide_emitters": True},
            "light": {"type": "envmap", "bitmap": mitsuba.Bitmap(_panorama())},
            "sphere": {"type": "sphere", "radius": 0.5, "bsdf": bsdf},
            "sensor": {
                "type": "perspective",
                "fov": _FIELD_DEG,
                "to_world": mitsuba.ScalarTransform4f().look_at(origin=list(_EYE), target=[0, 0, 0], up=[0, 1, 0]),
                "film": {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}},
                "sampler": {"type": "multijitter"},
            },
        }
    )

    def render(samples: int, seed: int) -> Picture:
        found: Any = mitsuba.render(scene, spp=samples, seed=cast(Any, seed))
        return np.array(found)[..., :3]

    return render


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
