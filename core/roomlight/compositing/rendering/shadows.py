"""Shadows and colour bleeding of virtual objects on real surfaces, by differential rendering (Debevec 1998).

A real surface shows frame = albedo E / pi. With objects its irradiance is E - E_blocked + E_bounced, so the picture
changes by the ratio (E - E_blocked + E_bounced) / E in each channel; the albedo cancels. E and E_blocked are sums over
the same directions, sampled from the panorama at the objects' position, so that the ratio is exactly 1 where no object
is in the way. The light has parallax: it comes from the room's surfaces in these directions, as far as they are known.

E_bounced is light that an object's hit surface reflects: diffuse by the panorama's irradiance there, metals by the
panorama blurred as by a roughness of 0.3 or more. The panorama shows the support without the objects: what an object
sees of it is reduced by the shade of a sphere as large as the object, and close to a shaded point by the shade there.

Every 4 x 4 pixels share 16 subsets of samples, fixed in time; a filter over the surface joins them, as far as each
pixel's own samples disagree: borders of hard shadows stay sharp. World metres.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from roomlight.compositing.kernels.grid import fill_points, fill_surfaces
from roomlight.compositing.kernels.shadow_rays import (
    Ground,
    LightPlaces,
    LightSamples,
    Looks,
    Opacities,
    Rays,
    Receivers,
    add_blocked,
    add_bounced,
    fill_taken,
    light_rays,
    object_rays,
)
from roomlight.compositing.kernels.shadows import (
    Change,
    SurfaceGrid,
    extend_ratio,
    fade_ratio,
    filter_change,
    upsample_ratio,
)
from roomlight.compositing.kernels.surfaces import BASE_COLOUR, EMISSIVE, METALLIC_ROUGHNESS
from roomlight.compositing.light.lighting import LightSampler
from roomlight.compositing.picture.crop import CropCamera
from roomlight.compositing.picture.occlusion import depth_edges
from roomlight.compositing.placement.places import Plane
from roomlight.compositing.placement.room_geometry import RoomGeometry
from roomlight.compositing.rendering.light_samples import TILE, light_samples, subset_points
from roomlight.compositing.rendering.room_shade import Lamp, lamp_of, lamp_seen
from roomlight.compositing.rendering.tracer import TracedObjects
from roomlight.conventions import direction_to_uv
from roomlight.threads import parallel_for

SNAP_M: Final = 0.02
SNAP_SHARE: Final = 0.01
"""Points this close to the plane that an object stands on are moved onto it: 2 cm and 1 % of the depth are noise."""
LIFT_M: Final = 5e-4
RATIO_RANGE: Final = (0.02, 4.0)
_EDGE: Final = 0.04
_EDGE_PIXELS: Final = 2
"""Computed pixels this far from a depth edge may have no normal."""
_CONTACT_PIXELS: Final = 3.0
"""Where what takes the light is nearer than this many computed pixels, the shadow has detail between them."""
_CONTACT_RATIO: Final = 0.93
"""Lighter shadows have no contact to show."""
_MOST_REFLECTED: Final = np.float32(12.0)
"""Of one pixel's few rays, relative to its irradiance; the mean over neighbours is limited by `RATIO_RANGE`."""
_MOST_LAYERS: Final = 8
"""Surfaces of glass, cut-outs and partly transparent things that a ray to the light may meet, the last one included."""
_MOST_ALBEDO: Final = 0.8
"""Of floors and tables: white paint."""
_FACING_UP: Final = 0.7
"""Cosine to the vertical of floors and tables, at least."""
_LEAST_ROUGHNESS: Final = 0.3
"""Of mirrors that light matte surfaces, as in the renderer's paths."""
_BLOCK_RAYS: Final = 1 << 17
_FAR_M: Final = 1e3
_UNKNOWN_M: Final = 2.5
"""Distance of light whose surface no frame has shown: lamps and ceilings of rooms. In Mitsuba's small room the error of
the shadow under the true panorama was 0.068 with far light, 0.039 with true distances and 0.036 with this one."""
_NEAREST_RADII: Final = 3.0
"""Surfaces that send light count as at least this far from the object's centre, in its radii."""
_THIRDS: Final = np.full(3, 1 / 3, np.float32)
"""Mean over channels, as a product: NumPy's mean of short rows is slow."""


Smoothing = Callable[
    [Float32[np.ndarray, "h w 3"], SurfaceGrid, Float32[np.ndarray, "h w"], CropCamera], Float32[np.ndarray, "h w 3"]
]
"""Maps a ratio on a grid of surfaces, their depth and their camera to another ratio, such as one eased over time."""


@dataclass(frozen=True)
class ShadowQuality:
    """Effort of the shadows.

    Attributes:
        step: every step-th pixel is computed, the others are interpolated.
        samples: directions to the light from each of these pixels; a filtered pixel uses about 16 times as many.
        bounces: directions toward each object from each of these pixels; 0 leaves colour bleeding out.
        radius: of the filter, in computed pixels; 2 or 4, so that every subset counts the same.
        reach: shadows and reflected light fade out between 0.8 and 1 times this distance from an object's centre, in
            radii of its bounding sphere. With 7 instead of 4 the error of shadows under the true light falls by a
            tenth: an object on a desk shades the wall behind it.
        room_shade: whether real surfaces hide the strongest lamp.
    """

    step: int
    samples: int
    bounces: int
    radius: int = 2
    reach: float = 7.0
    room_shade: bool = True


QUALITIES: Final = {
    "preview": ShadowQuality(step=4, samples=16, bounces=2, reach=4.0, room_shade=False),
    "good": ShadowQuality(step=2, samples=32, bounces=6, radius=4),
    "final": ShadowQuality(step=1, samples=64, bounces=8, radius=4),
}


@dataclass(frozen=True)
class Caster:
    """Objects that cast shadows together, under one light.

    Attributes:
        spheres: [k, 4] centre and radius of each object.
        object_ids: [k] the objects' indices in the scene.
        light: at their position: what they reflect.
        reflection: the light that casts their shadows.
        support: plane that they stand on, if there is one.
        room: real surfaces, which send the light and may hide the strongest lamp; None: the light is far away.
    """

    scene: TracedObjects
    spheres: Float32[np.ndarray, "k 4"]
    object_ids: Int[np.ndarray, " k"]
    light: LightSampler
    reflection: LightSampler
    support: Plane | None = None
    room: RoomGeometry | None = None


def surface_grid(
    depth_m: Float[np.ndarray, "h w"],
    camera: CropCamera,
    camera_to_world: Float[np.ndarray, "4 4"],
    supports: list[Plane],
) -> SurfaceGrid:
    """Return points and normals of the real surfaces on the pixels of a depth image; points near a support lie on it.

    Depth is smoothed within surfaces; pixels at depth edges, without depth and without a normal are not known: a normal
    needs neighbours, which an image of one row or one column lacks.
    """
    known = depth_m > 0
    filled = np.where(known, depth_m, depth_m.max(initial=1.0)).astype(np.float32)
    smooth = np.exp(cv2.bilateralFilter(np.log(filled), 5, 0.02, 2.0)) if min(depth_m.shape) >= 5 else filled
    known &= ~depth_edges(depth_m)
    raw, points, normals = (np.empty((*smooth.shape, 3), np.float32) for _ in range(3))
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    pose = camera_to_world[:3].astype(np.float32)
    parallel_for(lambda start, stop: fill_points(smooth, lens, pose, raw, start, stop), len(raw))
    planes = np.array([(plane.point, plane.normal) for plane in supports], np.float32).reshape(-1, 2, 3)
    arguments = (raw, smooth, pose[:, 3], planes, (np.float32(SNAP_M), np.float32(SNAP_SHARE)), points, normals)
    parallel_for(lambda start, stop: fill_surfaces(*arguments, start, stop), len(raw))
    return SurfaceGrid(points, normals, known & normals.any(axis=-1))


def shadow_ratio(
    casters: list[Caster],
    depth_m: Float[np.ndarray, "h w"],
    camera: CropCamera,
    camera_to_world: Float[np.ndarray, "4 4"],
    quality: ShadowQuality,
    *,
    supports: list[Plane] | None = None,
    smooth: Smoothing | None = None,
    white: Float32[np.ndarray, "h w"] | None = None,
) -> Float32[np.ndarray, "h w 3"]:
    """Return light with objects / light without them on the real surfaces of an image.

    Args:
        casters: The objects, in groups that share a light.
        depth_m: z-depth of the real surfaces at every pixel of `camera`, 0 unknown: ratio 1 or its neighbours'.
        quality: Effort; its `step` is the distance of the pixels that are computed.
        supports: Planes that objects stand on; default: those of the casters.
        smooth: Changes the ratio of the computed pixels, given their surfaces, depth and camera.
        white: How far a pixel of the image is clipped, 0 to 1: windows and lamps there keep their light.
    """
    step = quality.step
    coarse_depth = np.ascontiguousarray(depth_m[step // 2 :: step, step // 2 :: step], np.float32)
    if coarse_depth.size == 0:  # only a rim of the shadow's reach is in the picture
        return np.ones((*depth_m.shape, 3), np.float32)
    coarse_camera = camera.every(step)
    if supports is None:
        supports = [caster.support for caster in casters if caster.support is not None]
    grid = surface_grid(coarse_depth, coarse_camera, camera_to_world, supports)
    parts = [coarse_ratio(caster, grid, quality) for caster in casters]
    ratio = np.ones((*coarse_depth.shape, 3), np.float32)
    for part, _ in parts:  # each takes light of its own
        ratio += part - 1
    np.maximum(ratio, RATIO_RANGE[0], out=ratio)
    if smooth is not None:
        ratio = smooth(ratio, grid, coarse_depth, coarse_camera)
    out = spread_ratio(ratio, grid.known, coarse_depth, depth_m, step)
    pixel_m = coarse_depth / np.float32(coarse_camera.fx)
    for caster, (part, occluder_m) in zip(casters, parts, strict=True):
        fine = grid.known & (occluder_m < _CONTACT_PIXELS * pixel_m) & (part.min(axis=-1) < _CONTACT_RATIO)
        if step > 1 and fine.any():
            coarse = part, grid.known, coarse_depth
            _add_contact(out, caster, coarse, fine, depth_m, (camera, camera_to_world, supports), quality)
    if white is not None and white.any():
        box = np.ones((5, 5), np.uint8)
        near = grid.known & (cv2.dilate(np.ascontiguousarray(white[step // 2 :: step, step // 2 :: step]), box) > 0)
        emits = np.max([_emits(caster, grid, near) for caster in casters], axis=0)
        if emits.any():
            fade_ratio(out, cv2.resize(cv2.dilate(emits, box), white.shape[::-1]), white)
    return out


def _emits(caster: Caster, grid: SurfaceGrid, where: Bool[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Return where the panorama shows more light than a white surface would reflect: windows and lamps, 0 to 1.

    What faces up counts as a floor or table in the sun, whose light the panorama may lack.
    """
    out = np.zeros(grid.known.shape, np.float32)
    normals = grid.normals[where]
    toward = grid.points[where] - np.array(caster.reflection.position, np.float32)
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), np.float32(1e-6))
    shown, most = _grey(caster.reflection.panorama, toward), _grey(caster.light.prefiltered[-1], normals)
    out[where] = np.clip(shown / np.maximum(most, np.float32(1e-6)) - 1, 0, 1) * (normals[:, 1] < _FACING_UP)
    return out


def _grey(
    panorama: Float32[np.ndarray, "ph pw 3"], directions: Float32[np.ndarray, "n 3"]
) -> Float32[np.ndarray, " n"]:
    """Return the mean of the channels of the nearest pixels."""
    height, width = panorama.shape[:2]
    u, v = direction_to_uv(directions).T
    return (
        panorama[np.minimum(v * height, height - 1).astype(int), np.minimum(u * width, width - 1).astype(int)] @ _THIRDS
    )


def _add_contact(
    out: Float32[np.ndarray, "fh fw 3"],
    caster: Caster,
    coarse: tuple[Float32[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"], Float32[np.ndarray, "h w"]],
    detailed_at: Bool[np.ndarray, "h w"],
    depth_m: Float[np.ndarray, "fh fw"],
    view: tuple[CropCamera, Float[np.ndarray, "4 4"], list[Plane]],
    quality: ShadowQuality,
) -> None:
    """Replace a caster's interpolated ratio by that of a grid twice as fine where it touches a surface, in place.

    `coarse` is the ratio on every `step`-th pixel, where it is known, and the depth; `detailed_at` has detail between.
    """
    step, fine, (camera, pose, supports) = quality.step, quality.step // 2, view
    soft = cv2.blur(cv2.dilate(detailed_at.astype(np.float32), np.ones((3, 3), np.uint8)), (3, 3))
    crops: list[slice] = []
    for axis in (0, 1):
        used = np.flatnonzero(soft.any(axis=1 - axis))
        crops.append(slice(int(used[0]) // TILE * TILE, int(used[-1]) + 1))  # whole tiles: samples stay where they are
    rows, columns = crops
    top, left = rows.start * step, columns.start * step
    box = slice(top, rows.stop * step), slice(left, columns.stop * step)
    part = np.ascontiguousarray(depth_m[box])
    height, width = part.shape
    lens = replace(camera, cx=camera.cx - left, cy=camera.cy - top, width=width, height=height).every(fine)
    sampled = np.ascontiguousarray(part[fine // 2 :: fine, fine // 2 :: fine])
    if min(sampled.shape) < TILE:
        return
    share = cv2.resize(soft[rows, columns], None, fx=step, fy=step, interpolation=cv2.INTER_LINEAR)[:height, :width]
    grid = surface_grid(sampled, lens, pose, supports)
    # beyond, no ratio is computed: neither the filter nor the interpolation may take it for 1
    grid = grid._replace(known=grid.known & (share[fine // 2 :: fine, fine // 2 :: fine] > 0.1))
    detailed, _ = coarse_ratio(caster, grid, quality)
    detailed = spread_ratio(detailed, grid.known, sampled, part, fine)
    ratio, known, coarse_m = (np.ascontiguousarray(values[rows, columns]) for values in coarse)
    change = detailed / np.maximum(spread_ratio(ratio, known, coarse_m, part, step), RATIO_RANGE[0])
    share *= cv2.resize(grid.known.astype(np.float32), (width, height), interpolation=cv2.INTER_NEAREST)
    out[box] *= 1 + share[..., None] * (change - 1)


def coarse_ratio(
    caster: Caster, grid: SurfaceGrid, quality: ShadowQuality
) -> tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"]]:
    """Return the ratio of one caster on the known points of a grid, and how far what takes the light there is (mean).

    The ratio is 1 beyond the caster's reach and where the surface is not known.
    """
    height, width = grid.known.shape
    out = np.ones((height, width, 3), np.float32)
    fade = _fade(caster.spheres, grid, quality.reach)
    near = grid.known & (fade > 0)
    rows, columns = np.nonzero(near)
    if len(rows) == 0:
        return out, np.full((height, width), _FAR_M, np.float32)
    subset = (rows % TILE * TILE + columns % TILE).astype(np.int32)
    lamp = lamp_of(caster.reflection) if caster.room is not None and quality.room_shade else None
    seen = np.ones(len(rows), np.float32)
    if lamp is not None and caster.room is not None:
        seen = lamp_seen(lamp, grid, near, caster.room, caster.spheres[0, :3])[near]
    receivers = Receivers(grid.points[near], grid.normals[near], subset, seen)
    received = _light_change(caster, receivers, quality, lamp)
    share = fade[near]
    floor = np.float32(1e-6) + np.float32(1e-3) * received.unblocked.max(initial=0)
    dark, glow = np.ones_like(out), np.zeros_like(out)
    noise, lost, nearness = np.zeros((3, height, width), np.float32)
    blocked = received.blocked / np.maximum(received.unblocked, floor)
    dark[near] = 1 - share[:, None] * np.clip(blocked, 0, 1 - RATIO_RANGE[0])
    # by the smooth irradiance: divided by a noisy one, the mean would be too bright
    reflected = received.bounced / np.maximum(received.irradiance, floor)
    glow[near] = reflected * (share / np.maximum(reflected.max(axis=1) / _MOST_REFLECTED, 1))[:, None]
    noise[near] = share * received.doubt / (np.maximum(received.unblocked, floor) @ _THIRDS)
    lost[near], nearness[near] = received.blocked @ _THIRDS, received.nearness
    occluder_m = cv2.blur(lost, (5, 5)) / np.maximum(cv2.blur(nearness, (5, 5)), np.float32(1e-9))
    occluder_m[occluder_m <= 0] = _FAR_M
    inside = np.zeros((height, width), bool)
    inside[near] = received.inside
    change = Change(dark, noise, occluder_m, glow, near, inside)
    arguments = (change, grid, quality.radius, np.float32(0.02), np.float32(RATIO_RANGE[1]), out)
    parallel_for(lambda start, stop: filter_change(*arguments, start, stop), height)
    return out, occluder_m


def spread_ratio(
    ratio: Float[np.ndarray, "h w 3"],
    known: Bool[np.ndarray, "h w"],
    depth_m: Float[np.ndarray, "h w"],
    fine_depth_m: Float[np.ndarray, "fh fw"],
    step: int,
) -> Float32[np.ndarray, "fh fw 3"]:
    """Interpolate a ratio known on every `step`-th pixel to all pixels, across no depth edge.

    Pixels beside depth edges, which are not known, have the ratio of their surface.
    """
    if step == 1 and known.all():
        return ratio.astype(np.float32)
    extended, is_extended = ratio.copy(), known.copy()
    extend_ratio(ratio, known, depth_m, _EDGE_PIXELS, np.float32(2 * _EDGE), extended, is_extended)
    ratio, known = extended, is_extended
    out = np.empty((*fine_depth_m.shape, 3), np.float32)
    arguments = (ratio, known, depth_m, fine_depth_m, step, np.float32(_EDGE), out)
    parallel_for(lambda start, stop: upsample_ratio(*arguments, start, stop), len(fine_depth_m))
    return out


@dataclass(frozen=True)
class _LightChange:
    """What objects do to the irradiance at points.

    Attributes:
        unblocked: by the samples, without the objects.
        blocked: what the objects take of it.
        doubt: standard deviation of the mean of its channels.
        nearness: sum of what they take / their distance.
        irradiance: without the objects and without the samples' noise.
        bounced: what the objects reflect.
        inside: points that objects hide.
    """

    unblocked: Float32[np.ndarray, "n 3"]
    blocked: Float32[np.ndarray, "n 3"]
    doubt: Float32[np.ndarray, " n"]
    nearness: Float32[np.ndarray, " n"]
    irradiance: Float32[np.ndarray, "n 3"]
    bounced: Float32[np.ndarray, "n 3"]
    inside: Bool[np.ndarray, " n"]


def _light_change(caster: Caster, receivers: Receivers, quality: ShadowQuality, lamp: Lamp | None) -> _LightChange:
    count, samples = len(receivers.points), quality.samples
    light = light_samples(caster.reflection, samples, toward=None if caster.support is None else caster.support.normal)
    levels = caster.light.prefiltered
    unblocked, irradiance = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    blocked, squares, nearness = np.zeros((count, 3), np.float32), *np.zeros((2, count), np.float32)
    bounced, taken, inside = np.zeros((count, 3), np.float32), np.zeros(count, np.float32), np.zeros(count, bool)
    spheres, lift, reach = caster.spheres, np.float32(LIFT_M), np.float32(quality.reach)
    numbers = subset_points(quality.bounces).astype(np.float32).reshape(TILE * TILE, quality.bounces, 2)
    of_lamp = np.zeros(light.directions.shape[:2], bool) if lamp is None else lamp.holds(light.directions)
    places = _light_places(caster, light)
    looks, ground, opacities = _looks(caster.scene, len(levels)), _ground(caster), _opacities(caster.scene)

    def work(start: int, stop: int) -> None:
        rays = _rays((stop - start) * samples, 3)
        arguments = (receivers, light, places, of_lamp, spheres, lift, levels[-1], unblocked, irradiance, rays)
        met = _first(rays, light_rays(*arguments, start, stop))
        add_blocked(met, *_taken(caster, met, opacities, quality.reach), blocked, squares, nearness)
        if quality.bounces:
            rays = _rays((stop - start) * quality.bounces * len(spheres), 1)
            met = _first(rays, object_rays(receivers, spheres, lift, numbers, reach, rays, start, stop))
            hits = caster.scene.trace(met.origin, met.direction)
            whole = np.maximum(unblocked[start:stop] @ _THIRDS, np.float32(1e-9))
            taken[start:stop] = np.minimum(blocked[start:stop] @ _THIRDS / whole, 1)
            add_bounced(met, hits.face, hits.distance_m, caster.object_ids, looks, levels, ground, taken, bounced)
            dark = start + np.flatnonzero(taken[start:stop] > 0.5)  # objects take most light of a point inside them
            inside[dark] = _inside(caster.scene, receivers.points[dark], receivers.normals[dark])

    most = max(1, _BLOCK_RAYS // max(samples, quality.bounces * len(spheres)))
    parallel_for(work, count, pieces_per_thread=2, most=most)
    # with the lamp also where the room hides it: on a surface wrongly taken for shaded, glow would be a bright spot
    irradiance = _at_least_seen(irradiance, receivers.normals, caster)
    variance = squares - (blocked @ _THIRDS) ** 2 / np.float32(samples)
    # All of a few samples agreeing still leaves doubt: half a sample.
    least = np.where(squares > 0, np.float32(0.2 / samples), np.float32(0.05 / samples)) * (unblocked @ _THIRDS)
    doubt = np.sqrt(np.maximum(variance, 0) + least**2)
    return _LightChange(unblocked, blocked, doubt, nearness, irradiance, bounced, inside)


def _inside(
    scene: TracedObjects, points: Float32[np.ndarray, "n 3"], normals: Float32[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """Return which points of real surfaces are inside objects: behind the surface the objects show their back.

    In front of it, also sheets with one side and plants do.
    """
    hits = scene.trace(points + np.float32(LIFT_M) * normals, -normals)
    met = np.flatnonzero(hits.face >= 0)
    a, b, c = scene.surfaces.corners[hits.face[met]].swapaxes(0, 1)
    inside = np.zeros(len(points), bool)
    inside[met] = np.einsum("nc,nc->n", np.cross(b - a, c - a), normals[met]) < 0
    return inside


def _at_least_seen(
    irradiance: Float32[np.ndarray, "n 3"], normals: Float32[np.ndarray, "n 3"], caster: Caster
) -> Float32[np.ndarray, "n 3"]:
    """Raise the irradiance of surfaces that face up to what the brightness of the surface below the object needs.

    Lamps that no frame has shown are missing in the panorama, but the floor shows their light: its radiance is at most
    `_MOST_ALBEDO` x irradiance / pi. Reflected light, divided by too little, would be a bright spot.
    """
    up = np.array([0.0, 1, 0]) if caster.support is None else caster.support.normal
    matte = caster.light.prefiltered[-1]
    u, v = direction_to_uv(-up[None])[0]
    below = matte[min(int(v * len(matte)), len(matte) - 1), min(int(u * matte.shape[1]), matte.shape[1] - 1)]
    facing = (normals @ up.astype(np.float32) > _FACING_UP)[:, None]
    return np.where(facing, np.maximum(irradiance, np.float32(np.pi / _MOST_ALBEDO) * below), irradiance)


def _rays(count: int, channels: int) -> Rays:
    origin, direction = np.empty((2, count, 3), np.float32)
    point, target = np.empty((2, count), np.int32)
    return Rays(origin, direction, point, target, np.empty((count, channels), np.float32))


def _first(rays: Rays, count: int) -> Rays:
    return Rays(*(column[:count] for column in rays))


def _opacities(scene: TracedObjects) -> Opacities:
    """Return the share of light that each material takes.

    Each of the two surfaces of solid glass takes half of its tint, and what it reflects at normal incidence. With an
    index of 1.5 that is 8 % in all: path tracing of a sphere and a cube on a grey floor gives 6 and 10 % of a solid's
    shadow under even light, and 0 and 15 % under a lamp, where a caustic makes up for the sphere's (least squares).
    """
    table = scene.materials
    is_cut = (table.cutoff >= 0) | (scene.texture_means()[table.texture[:, BASE_COLOUR], 3] < 1)
    tint = table.base.mean(axis=1)
    reflected = ((table.ior - 1) / (table.ior + 1)) ** 2
    share = 1 - table.transmission * (1 - reflected) * np.where(table.is_thin, tint, np.sqrt(tint))
    share[~is_cut] *= table.opacity[~is_cut]
    return Opacities(scene.surfaces, table, scene.textures, share.astype(np.float32), is_cut)


def _taken(
    caster: Caster, rays: Rays, opacities: Opacities, reach: float
) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
    """Return the share of each ray's light that the caster's objects take, and how far in metres what takes most is.

    Light that another caster's objects take first is not theirs.
    """
    scene = caster.scene
    hits = scene.trace(rays.origin, rays.direction)
    taken, distance_m, ahead_m = np.empty_like(hits.distance_m), hits.distance_m, np.float32(scene.offset_m())
    fill_taken(opacities, hits, taken)
    left, share = 1 - taken, taken * _own(caster, rays.origin, hits.face, reach)
    onward = np.flatnonzero((left > 0) & (hits.face >= 0))
    far_m = distance_m[onward]
    for _ in range(_MOST_LAYERS - 1):
        if len(onward) == 0:
            break
        far_m, direction = far_m + ahead_m, rays.direction[onward]
        hits = scene.trace(rays.origin[onward] + far_m[:, None] * direction, direction)
        far_m, before, taken = far_m + hits.distance_m, share[onward], np.empty_like(hits.distance_m)
        fill_taken(opacities, hits, taken)
        lost = left[onward] * taken * _own(caster, rays.origin[onward], hits.face, reach)
        left[onward] *= 1 - taken
        share[onward] += lost
        distance_m[onward] = np.where(lost > before, far_m, distance_m[onward])
        more = (hits.face >= 0) & (taken < 1)
        onward, far_m = onward[more], far_m[more]
    return share, distance_m


def _own(
    caster: Caster, points: Float32[np.ndarray, "n 3"], face: Int[np.ndarray, " n"], reach: float
) -> Float32[np.ndarray, " n"]:
    """Return the share of the light that met triangles take which is a caster's.

    All of it for the caster's own objects; for others' what those leave out where their shadows fade out.
    """
    if len(caster.object_ids) == len(caster.scene.objects):
        return np.ones(len(face), np.float32)
    met = caster.scene.surfaces.object_id[face]
    own = np.isin(met, caster.object_ids).astype(np.float32)
    other = np.flatnonzero((own == 0) & (face >= 0))
    low, high = caster.scene.bounds[met[other]].swapaxes(0, 1)
    far = np.linalg.norm(2 * points[other] - low - high, axis=1) / (reach * np.linalg.norm(high - low, axis=1))
    own[other] = 1 - _near(far)
    return own


def _light_places(caster: Caster, light: LightSamples) -> LightPlaces:
    """Return which surfaces of the room send the light of the samples; unknown ones are `_UNKNOWN_M` away."""
    position = np.array(caster.reflection.position, np.float32)
    shape, directions = light.directions.shape, np.ascontiguousarray(light.directions.reshape(-1, 3))
    if caster.room is None:
        return LightPlaces(position, np.zeros(shape[:2], np.float32), np.zeros(shape, np.float32))
    hits = caster.room.cast(np.broadcast_to(position, directions.shape), directions)
    unknown = ~np.isfinite(hits.distance_m)
    distance_m = np.where(unknown, np.float32(_UNKNOWN_M), hits.distance_m)
    # the panorama says nothing about surfaces that are nearer than the objects are wide
    inverse_m = 1 / np.maximum(distance_m, np.float32(_NEAREST_RADII) * caster.spheres[0, 3])
    normals = np.where(unknown[:, None], -directions, hits.normals).astype(np.float32)
    return LightPlaces(position, inverse_m.astype(np.float32).reshape(shape[:2]), normals.reshape(shape))


def _looks(scene: TracedObjects, levels: int) -> Looks:
    """Return the objects' surfaces as matte surfaces around them are lit by them."""
    table = scene.materials
    means = scene.texture_means()
    base, rough = means[table.texture[:, BASE_COLOUR]], means[table.texture[:, METALLIC_ROUGHNESS]]
    colours = table.base * base[:, :3] * ((1 - table.transmission) * table.opacity * base[:, 3])[:, None]
    metal, last = (table.metallic * rough[:, 2])[:, None], levels - 1
    level = np.rint(np.maximum(table.roughness * rough[:, 1], _LEAST_ROUGHNESS) * last)
    return Looks(
        scene.surfaces.corners,
        scene.surfaces.material,
        scene.surfaces.object_id,
        (colours * (1 - metal)).astype(np.float32),
        (colours * metal).astype(np.float32),
        table.emissive * means[table.texture[:, EMISSIVE], :3],
        np.clip(level, 1, last).astype(np.int32),
    )


def _ground(caster: Caster) -> Ground:
    spheres = caster.spheres.copy()
    spheres[:, 3] = np.minimum(spheres[:, 3], caster.scene.shade_radii[caster.object_ids])
    if caster.support is None:
        return Ground(False, np.zeros(3, np.float32), np.array([0, 1, 0], np.float32), spheres)
    plane = caster.support
    return Ground(True, plane.point.astype(np.float32), plane.normal.astype(np.float32), spheres)


def _fade(spheres: Float[np.ndarray, "k 4"], grid: SurfaceGrid, reach: float) -> Float32[np.ndarray, "h w"]:
    """Return 1 near an object and 0 beyond `reach` radii from its centre."""
    fade = np.zeros(grid.known.shape, np.float32)
    for x, y, z, radius in spheres:
        offset = grid.points - np.array([x, y, z], np.float32)
        far = np.sqrt(np.einsum("hwc,hwc->hw", offset, offset)) / np.float32(reach * radius)
        fade = np.maximum(fade, _near(far))
    return fade


def _near(far: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return 1 up to 0.8 of an object's reach and 0 from 1 on."""
    return np.clip((1 - far) / np.float32(0.2), 0, 1)
