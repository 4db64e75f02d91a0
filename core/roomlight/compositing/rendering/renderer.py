"""Virtual objects rendered under panoramas: radiance, coverage and depth, ready to be put over a frame.

Frames: world metres, y up; the camera as in `roomlight.camera`. Only the pixels around the objects are computed. Every
pixel has its own fixed low-discrepancy points, so equal inputs give equal bytes, and a still object does not shimmer.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, Int64, UInt8, UInt64

from roomlight.camera import Intrinsics, check_rigid, rigid_inverse
from roomlight.compositing.kernels import paths as path_kernels
from roomlight.compositing.kernels.environment import fill_radiance
from roomlight.compositing.kernels.film import average_samples, smooth_alike
from roomlight.compositing.kernels.ground import Supports
from roomlight.compositing.kernels.preview import shade_hits
from roomlight.compositing.light.lighting import Environment, ProbeSet
from roomlight.compositing.objects.materials import MaterialArrays, lobe_table
from roomlight.compositing.objects.primitives import sphere
from roomlight.compositing.objects.textures import TextureArrays
from roomlight.compositing.rendering.denoise import denoise
from roomlight.compositing.rendering.tracer import Emitters, Surfaces, TracedObjects
from roomlight.errors import OptionError
from roomlight.rays import RayHits
from roomlight.threads import parallel_for

Background = Callable[[Float32[np.ndarray, "n 3"]], Float[np.ndarray, "n 3"]]
"""Maps unit world directions to the radiance that the camera sees behind glass; rows of NaN: the probes' light."""


@dataclass(frozen=True)
class RenderSettings:
    """How many paths, how long, and whether they are denoised.

    Attributes:
        samples: Paths a pixel, a power of two; 0 shades first hits by prefiltered panoramas instead.
        bounces: Most surfaces that a path meets.
        denoised: Denoise by Open Image Denoise where it is installed.
        least: Paths that every pixel gets, a power of two; more only where these differ. 0: all get `samples`.
        smoothed: Average neighbours of one colour and normal, as far as their noise hides how they differ.
    """

    samples: int
    bounces: int
    denoised: bool
    least: int = 0
    smoothed: bool = False


PRESETS: Final[dict[str, RenderSettings]] = {
    "preview": RenderSettings(0, 1, denoised=False),
    "good": RenderSettings(64, 6, denoised=False, least=16, smoothed=True),
    "final": RenderSettings(256, 12, denoised=True),
}
_EDGE_SAMPLES: Final = 8
"""Rays in a pixel on an outline of a preview."""
_MOST_LAYERS: Final = 16
"""Surfaces of cut-outs and of partly transparent things that a ray of a preview may meet, the last one included."""
_COVERED: Final = np.float32(0.99)
"""Alpha from which a preview shows nothing behind."""
_COVERAGE_SAMPLES: Final = 4
"""Rays that decide whether a pixel and its neighbours are worth paths."""
_BRIGHTEST_CAUSTIC: Final = 10.0
"""Light that reaches a matte surface through glass is limited to this multiple of the panorama's mean: a lamp seen so
is a rare bright dot."""
_LEAST_NOISE: Final = 3 / 255
"""Standard error on a screen up to which samples are enough: about the noise of a camera."""
_SMOOTHED_NOISE: Final = 2 * _LEAST_NOISE
"""The same before neighbours are averaged."""
_BLOCK_RAYS: Final = 1 << 15
"""Rays of a block: 6 MB of paths, which stay in a core's cache."""
_NO_SUPPORTS: Final = Supports(
    *(np.zeros((0, columns), np.float32) for columns in (3, 3, 4)),
    carriers=np.zeros(0, np.int32),
    ends_m=np.zeros(0, np.float32),
    reach_m=1.0,
)
"""Objects stand on nothing: all light is far away."""


@dataclass(frozen=True)
class RenderedObjects:
    """Objects as the camera sees them.

    Attributes:
        radiance: [h, w, 3] linear RGB times alpha.
        alpha: [h, w] share of the pixel that objects cover, 0 to 1; glass covers, and holds what is seen through it.
        depth_m: [h, w] z-depth, mean over the covered part; 0 where no object is.
        object_id: [h, w] the nearest object's index in the scene; -1 where no object is.
        samples: most paths a pixel that were traced; 0 for a preview.
    """

    radiance: Float32[np.ndarray, "h w 3"]
    alpha: Float32[np.ndarray, "h w"]
    depth_m: Float32[np.ndarray, "h w"]
    object_id: Int32[np.ndarray, "h w"]
    samples: int = 0


class _World(NamedTuple):
    surfaces: Surfaces
    materials: MaterialArrays
    textures: TextureArrays
    light: Environment
    lobe: Float32[np.ndarray, "c r 3"]
    supports: Supports
    is_open: Bool[np.ndarray, " f"]
    emitters: Emitters


class _Stage(NamedTuple):
    scene: TracedObjects
    world: _World
    settings: RenderSettings
    background: Background | None


class _View(NamedTuple):
    camera_to_world: Float[np.ndarray, "4 4"]
    fx: float
    fy: float
    cx: float
    cy: float
    column: Int64[np.ndarray, " p"]
    row: Int64[np.ndarray, " p"]
    key: UInt64[np.ndarray, " p"]
    jitter: bool

    def part(self, chosen: "slice | Int64[np.ndarray, ' q']") -> "_View":
        return self._replace(column=self.column[chosen], row=self.row[chosen], key=self.key[chosen])


class _Paths(NamedTuple):
    origin: Float32[np.ndarray, "n 3"]
    direction: Float32[np.ndarray, "n 3"]
    throughput: Float32[np.ndarray, "n 3"]
    share: Float32[np.ndarray, " n"]
    density: Float32[np.ndarray, " n"]
    layer: Float32[np.ndarray, " n"]
    flags: UInt8[np.ndarray, " n"]
    slot: Int32[np.ndarray, " n"]


class _Queue(NamedTuple):
    origin: Float32[np.ndarray, "n 3"]
    direction: Float32[np.ndarray, "n 3"]
    light: Float32[np.ndarray, "n 3"]
    reach_m: Float32[np.ndarray, " n"]
    slot: Int32[np.ndarray, " n"]


class _Film(NamedTuple):
    """A value for each sample, or, reduced, for each pixel; albedo and normal, for the denoisers, may have no rows.

    `doubt` of a pixel is the variance of the mean of its samples, of the mean of their channels: negative where the
    first surfaces are mirrors and glass, whose samples differ by what they show. Of a sample it is 1 where that
    scatters light.
    """

    radiance: Float32[np.ndarray, "n 3"]
    alpha: Float32[np.ndarray, " n"]
    depth_m: Float32[np.ndarray, " n"]
    object_id: Int32[np.ndarray, " n"]
    albedo: Float32[np.ndarray, "n 3"]
    normal: Float32[np.ndarray, "n 3"]
    doubt: Float32[np.ndarray, " n"]


class _Settings(NamedTuple):
    samples: int
    first: int
    depth: int
    max_bounces: int
    background: bool
    offset_m: float
    brightest: float


def render_objects(
    scene: TracedObjects,
    camera: Intrinsics,
    camera_to_world: Float[np.ndarray, "4 4"],
    lights: ProbeSet,
    *,
    quality: str | RenderSettings = "good",
    seed: int = 0,
    background: Background | None = None,
    supports: Supports | None = None,
    max_paths: int | None = None,
) -> RenderedObjects:
    """Render the objects as seen by the camera and lit by the probes.

    Args:
        scene: The objects, in the world.
        camera: Size, focal length and principal point of the frame.
        quality: `preview`, `good`, `final`, or settings of one's own.
        seed: Chooses the sampling points; keep it from frame to frame.
        background: What glass shows of the frame behind it; None: the probes' light.
        supports: Surfaces that the objects stand on, which they reflect as near ones; None: all light is far away.
        max_paths: Limit on the paths of the picture: where objects cover so many pixels that it is exceeded, each pixel
            gets half as many paths, and so on, but one at least. None: no limit.

    Raises:
        OptionError: The quality is unknown, or its samples are not a power of two up to 65536.
        ValueError: The pose is not rigid.
    """
    settings = _checked_settings(quality)
    pose = check_rigid(camera_to_world)
    pixels = _pixels_around(scene, camera, pose)
    film = _film(camera.width * camera.height, extra=settings.denoised or settings.smoothed)
    if len(pixels):
        light = lights.environment if settings.samples else lights.panoramas
        is_open = scene.is_open() if settings.samples else np.zeros(0, bool)
        materials = scene.materials if settings.samples else scene.materials_from(pose[:3, 3], camera.fx)
        tables = scene.surfaces, materials, scene.textures
        world = _World(*tables, light, lobe_table(), supports or _NO_SUPPORTS, is_open, scene.emitters)
        stage = _Stage(scene, world, settings, background)
        row, column = np.divmod(pixels, camera.width)
        key = _mixed_keys(pixels, seed)
        view = _View(pose, camera.fx, camera.fy, camera.cx, camera.cy, column, row, key, jitter=True)
        if settings.samples == 0:
            _preview(stage, lights, view, film, camera)
        else:
            settings = _sampled(stage, view, film, camera, max_paths)
    shape = camera.height, camera.width
    radiance, alpha = film.radiance.reshape(*shape, 3), film.alpha.reshape(shape)
    if settings.denoised and len(pixels):
        radiance = denoise(radiance, alpha, film.albedo.reshape(*shape, 3), film.normal.reshape(*shape, 3))
    if settings.smoothed and len(pixels):
        radiance = _smoothed(film, pixels, camera)
    depth_m, object_id = film.depth_m.reshape(shape), film.object_id.reshape(shape)
    return RenderedObjects(radiance, alpha, depth_m, object_id, settings.samples)


def warm_up(quality: str) -> None:
    """Compile the kernels of a quality, or load them from numba's cache, by a sphere in 16 x 16 pixels."""
    camera, pose = Intrinsics(16.0, 16.0, 8.0, 8.0, 16, 16), np.eye(4)
    pose[2, 3] = 1.0
    lights = ProbeSet.single(np.ones((8, 16, 3), np.float32))
    render_objects(TracedObjects([sphere(0.5)]), camera, pose, lights, quality=quality)


def _checked_settings(quality: str | RenderSettings) -> RenderSettings:
    if isinstance(quality, str):
        if (preset := PRESETS.get(quality)) is None:
            raise OptionError(f"quality must be {', '.join(PRESETS)} or RenderSettings, got {quality!r}")
        return preset
    samples = quality.samples
    for name, count in (("samples", samples), ("least", quality.least)):
        if count < 0 or count > 65536 or count & (count - 1):
            raise OptionError(f"{name} must be 0 or a power of two up to 65536, got {count}")
    if not 1 <= quality.bounces <= 64:
        raise OptionError(f"bounces must be 1 to 64, got {quality.bounces}")
    return quality


def _pixels_around(scene: TracedObjects, camera: Intrinsics, pose: Float[np.ndarray, "4 4"]) -> Int64[np.ndarray, " p"]:
    """Return the pixels, row by row, of the rectangles around the objects' projected boxes."""
    inverse = rigid_inverse(pose)
    mask = np.zeros((camera.height, camera.width), bool)
    for low, high in scene.bounds:
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        local = corners @ inverse[:3, :3].T + inverse[:3, 3]
        nearest, farthest = -local[:, 2].max(), -local[:, 2].min()
        if farthest <= 0:
            continue
        if nearest <= 1e-3 * farthest:  # reaches behind the camera: its projection has no bounds
            mask[:] = True
            break
        xy, _ = camera.project(local)
        left, top = np.clip(np.floor(xy.min(axis=0)) - 1, 0, [camera.width, camera.height]).astype(int)
        right, bottom = np.clip(np.ceil(xy.max(axis=0)) + 1, 0, [camera.width, camera.height]).astype(int)
        mask[top:bottom, left:right] = True
    return np.flatnonzero(mask)


def _mixed_keys(pixels: Int64[np.ndarray, " p"], seed: int) -> UInt64[np.ndarray, " p"]:
    with np.errstate(over="ignore"):
        offset = np.uint64(seed & 0xFFFFFFFF) * np.uint64(0x9E3779B97F4A7C15)
        return (pixels.astype(np.uint64) + np.uint64(1)) * np.uint64(0xBF58476D1CE4E5B9) ^ offset


def _film(count: int, *, extra: bool = True) -> _Film:
    """Make an empty film; `extra`: with albedo and normals."""
    radiance, albedo, normal = (np.zeros((rows, 3), np.float32) for rows in (count, count * extra, count * extra))
    alpha, depth_m, doubt = np.zeros((3, count), np.float32)
    doubt = -doubt  # a sum of -0.0, which marks mirrors without noise, must not become 0.0
    return _Film(radiance, alpha, depth_m, np.full(count, -1, np.int32), albedo, normal, doubt)


def _paths(count: int) -> _Paths:
    origin, direction, throughput = np.empty((3, count, 3), np.float32)
    share, density, layer = np.empty((3, count), np.float32)
    flags, slot = np.empty(count, np.uint8), np.empty(count, np.int32)
    return _Paths(origin, direction, throughput, share, density, layer, flags, slot)


def _queue(count: int) -> _Queue:
    origin, direction, light = np.empty((3, count, 3), np.float32)
    return _Queue(origin, direction, light, np.empty(count, np.float32), np.empty(count, np.int32))


def _camera_hits(scene: TracedObjects, view: _View, samples: int) -> tuple[_Paths, RayHits]:
    """Trace camera rays, `samples` a pixel."""
    count = len(view.column) * samples
    paths = _paths(count)
    hits = RayHits(np.empty(count, np.int32), *np.empty((3, count), np.float32))

    def work(start: int, stop: int) -> None:
        rays = slice(start * samples, stop * samples)
        own = _Paths(*(column[rays] for column in paths))
        path_kernels.camera_rays(view.part(slice(start, stop)), samples, 0, own)
        for column, part in zip(hits, scene.trace(own.origin, own.direction), strict=True):
            column[rays] = part

    parallel_for(work, len(view.column), pieces_per_thread=2)
    return paths, hits


def _preview(stage: _Stage, lights: ProbeSet, view: _View, film: _Film, camera: Intrinsics) -> None:
    """Shade pixel centres, and several points of the pixels on outlines."""
    scene = stage.scene
    pixels = view.row * camera.width + view.column
    centres = view._replace(jitter=False)
    paths, hits = _camera_hits(scene, centres, 1)
    _store(film, pixels, _shaded(stage, lights, centres, paths, hits))
    chosen = np.flatnonzero(_on_outline(film.object_id.reshape(camera.height, camera.width), view))
    if len(chosen) == 0:
        return
    part = view.part(chosen)
    paths, hits = _camera_hits(scene, part, _EDGE_SAMPLES)
    ids = np.where(hits.face >= 0, scene.surfaces.object_id[hits.face], -1).reshape(-1, _EDGE_SAMPLES)
    mixed = (ids >= 0).any(axis=1)  # also where all meet one object: a mirror's rim shows a half of the room in a pixel
    rays = np.repeat(mixed, _EDGE_SAMPLES)
    paths, hits = _Paths(*(column[rays] for column in paths)), RayHits(*(column[rays] for column in hits))
    shaded = _shaded(stage, lights, part.part(np.flatnonzero(mixed)), paths, hits)
    _store(film, pixels[chosen[mixed]], _reduced(shaded, _EDGE_SAMPLES, extra=False))


def _shaded(stage: _Stage, lights: ProbeSet, view: _View, paths: _Paths, hits: RayHits) -> _Film:
    """Shade hits, and what is behind those that leave a part of their pixel uncovered; changes paths and hits."""
    film = _film(len(paths.slot), extra=False)
    mips, world, background, scene = lights.prefiltered, stage.world, stage.background, stage.scene
    ahead_m = np.float32(scene.offset_m())

    def work(begin: int, end: int) -> None:
        behind = np.empty((0 if background is None else end - begin, 3), np.float32)
        for _ in range(_MOST_LAYERS):
            face = hits.face[begin:end]
            if background is not None:
                glass = (face >= 0) & (world.materials.transmission[world.surfaces.material[face]] > 0)
                behind[glass] = background(paths.direction[begin:end][glass])
            shade_hits(world, mips, view, paths, hits, behind, film, begin, end)
            onward = begin + np.flatnonzero((face >= 0) & (film.alpha[begin:end] < _COVERED))
            if len(onward) == 0:
                break
            face[:] = -1
            directions = paths.direction[onward]
            paths.origin[onward] += (hits.distance_m[onward] + ahead_m)[:, None] * directions
            for column, part in zip(hits, scene.trace(paths.origin[onward], directions), strict=True):
                column[onward] = part

    parallel_for(work, len(paths.slot), most=_BLOCK_RAYS)
    return film


def _on_outline(object_id: Int32[np.ndarray, "h w"], view: _View) -> Bool[np.ndarray, " p"]:
    """Return which pixels of the view have another object, or none, among their eight neighbours."""
    top, left = max(int(view.row.min()) - 1, 0), max(int(view.column.min()) - 1, 0)
    ids = (object_id[top : view.row.max() + 2, left : view.column.max() + 2] + 1).astype(np.float32)
    box = np.ones((3, 3), np.uint8)
    mixed = cv2.dilate(ids, box) != cv2.erode(ids, box)
    return mixed[view.row - top, view.column - left]


def _sampled(stage: _Stage, view: _View, film: _Film, camera: Intrinsics, max_paths: int | None) -> RenderSettings:
    """Trace paths through the pixels that objects cover, and their neighbours; return the settings within the limit."""
    pixels = view.row * camera.width + view.column
    _, hits = _camera_hits(stage.scene, view, _COVERAGE_SAMPLES)
    covered = np.zeros(camera.width * camera.height, np.uint8)
    covered[pixels] = (hits.face.reshape(-1, _COVERAGE_SAMPLES) >= 0).any(axis=1)
    grown = cv2.dilate(covered.reshape(camera.height, camera.width), np.ones((3, 3), np.uint8)).reshape(-1)
    chosen = np.flatnonzero(grown[pixels])
    view, pixels, settings = view.part(chosen), pixels[chosen], stage.settings
    while max_paths is not None and settings.samples > 1 and settings.samples * len(pixels) > max_paths:
        settings = replace(settings, samples=settings.samples // 2)
    stage = stage._replace(settings=settings)
    per_pass = min(settings.samples, _BLOCK_RAYS)
    per_block = max(1, _BLOCK_RAYS // per_pass)
    sparing = 0 < settings.least < settings.samples == per_pass

    def work(start: int, stop: int) -> None:
        for block in range(start, stop):
            own = slice(block * per_block, (block + 1) * per_block)
            part, total = view.part(own), _film(len(pixels[own]))
            if sparing:
                total = _spared(stage, part)
            else:
                for first in range(0, settings.samples, per_pass):
                    _accumulate(total, _traced(stage, part, first, per_pass), per_pass / settings.samples)
            _store(film, pixels[own], total)

    parallel_for(work, -(-len(pixels) // per_block), pieces_per_thread=16)
    return settings


def _spared(stage: _Stage, view: _View) -> _Film:
    """Trace the least samples, and twice as many of the pixels where these differ, until they are all."""
    settings = stage.settings
    count = settings.least
    out = _traced(stage, view, 0, count)
    noisy = np.flatnonzero(_is_noisy(out, view, settings.smoothed))
    while len(noisy) and count < settings.samples:
        more = _traced(stage, view.part(noisy), count, count)
        total = _film(len(noisy))
        for half in (_Film(*(column[noisy] for column in out)), more):
            _accumulate(total, half, 0.5)
        for whole, own in zip(out, total, strict=True):
            whole[noisy] = own
        noisy = noisy[_is_noisy(total, view.part(noisy), settings.smoothed)]
        count *= 2
    return out


def _is_noisy(film: _Film, view: _View, smoothed: bool) -> Bool[np.ndarray, " p"]:
    """Return which pixels are on an outline, or have a visible standard error.

    Of mirrors and glass also those beside them: few samples of glass may all have missed a window that its neighbours'
    have met, and would stay as dark dots.
    """
    slope = 0.44 * np.maximum(film.radiance.mean(axis=1), 0.005) ** (1 / 2.4 - 1)  # of sRGB's curve
    most = _SMOOTHED_NOISE if smoothed else _LEAST_NOISE
    noisy = np.sqrt(np.abs(film.doubt)) * slope > most
    row, column = view.row - view.row.min(), view.column - view.column.min()
    image = np.zeros((row.max() + 1, column.max() + 1), np.uint8)
    image[row, column] = noisy & (film.alpha == 1)
    beside = cv2.dilate(image, np.ones((3, 3), np.uint8))[row, column] > 0
    beside &= np.signbit(film.doubt) & (film.alpha > 0)  # also -0.0: all samples are equal
    return noisy | beside | ((film.alpha > 0) & (film.alpha < 1))


def _smoothed(film: _Film, pixels: Int64[np.ndarray, " p"], camera: Intrinsics) -> Float32[np.ndarray, "h w 3"]:
    """Return the film's radiance, averaged over neighbours that look alike."""
    whole = [column.reshape(camera.height, camera.width, *column.shape[1:]) for column in film]
    top, bottom = int(pixels[0]) // camera.width, int(pixels[-1]) // camera.width + 1
    out = whole[0].copy()
    parallel_for(lambda start, stop: smooth_alike(_Film(*whole), out, top + start, top + stop), bottom - top)
    return out


def _traced(stage: _Stage, view: _View, first: int, samples: int) -> _Film:
    """Trace so many samples of some pixels, from `first` on, in this thread; return their mean."""
    scene, world, settings, background = stage
    count = len(view.column) * samples
    emits = len(world.emitters.face) > 0
    film, paths, queues = _film(count), _paths(count), (_queue(count * (1 + emits)), _queue(count))
    path_kernels.camera_rays(view, samples, first, paths)
    offset_m, live = scene.offset_m(), count
    brightest = max(_BRIGHTEST_CAUSTIC * float(world.light.radiance.mean()), 1e-30)
    for depth in range(settings.bounces + 1):
        hits = scene.trace(paths.origin[:live], paths.direction[:live])
        step = _Settings(samples, first, depth, settings.bounces, background is not None, offset_m, brightest)
        live, shadows, escaped = path_kernels.bounce(world, view, paths, live, hits, film, queues, step)
        shadow, escape = queues
        if shadows:
            reach_m = shadow.reach_m[:shadows] if emits else None
            blocked = scene.blocked(shadow.origin[:shadows], shadow.direction[:shadows], reach_m)
            path_kernels.add_lit(shadow, blocked, shadows, film.radiance)
        if escaped and background is not None:
            _add_background(world, _Queue(*(column[:escaped] for column in escape)), film, background)
        if live == 0:
            break
    return _reduced(film, samples)


def _add_background(world: _World, rays: _Queue, film: _Film, background: Background) -> None:
    seen = np.ascontiguousarray(background(rays.direction), np.float32)
    unknown = ~np.isfinite(seen).all(axis=1)
    if unknown.any():
        light = np.empty((int(unknown.sum()), 3), np.float32)
        fill_radiance(world.light, rays.origin[unknown], rays.direction[unknown], light)
        seen[unknown] = light
    film.radiance[rays.slot] += rays.light * seen  # a slot has one path: no index comes twice


def _reduced(film: _Film, samples: int, *, extra: bool = True) -> _Film:
    """Average the samples of each pixel; the object is the nearest sample's."""
    count = len(film.alpha) // samples
    out = _film(count, extra=extra)
    average_samples(film, samples, out, 0, count)
    return out


def _accumulate(total: _Film, part: _Film, weight: float) -> None:
    """Add a share of all samples to the mean of all; depth is averaged by coverage."""
    share = np.float32(weight)
    before, after = total.alpha.copy(), part.alpha * share
    covered = np.maximum(before + after, np.float32(1e-12))
    total.depth_m[:] = (total.depth_m * before + part.depth_m * after) / covered
    total.alpha[:] = before + after
    total.doubt[:] += part.doubt * share**2
    np.copyto(total.object_id, part.object_id, where=total.object_id < 0)
    for name in ("radiance", "albedo", "normal"):
        getattr(total, name)[:] += getattr(part, name) * share


def _store(film: _Film, pixels: Int64[np.ndarray, " p"], part: _Film) -> None:
    for whole, own in zip(film, part, strict=True):
        if len(whole) and len(own):
            whole[pixels] = own
    film.radiance[pixels] = np.maximum(part.radiance, 0)  # a control variate's noise can be below zero
