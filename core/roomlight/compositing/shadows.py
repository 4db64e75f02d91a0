"""Shadows and colour bleeding of virtual objects on real surfaces, by differential rendering (Debevec 1998).

A real surface shows frame = albedo E / pi. With objects its irradiance is E - E_blocked + E_bounced, so the picture
changes by the ratio (E - E_blocked + E_bounced) / E in each channel; the albedo cancels. E and E_blocked are sums over
the same directions, sampled from the panorama at the objects' position, so that the ratio is exactly 1 where no object
is in the way. E_bounced is light that an object's hit surface reflects, diffuse by the panorama's irradiance there.

Every 4 x 4 pixels share 16 subsets of samples, fixed in time; a filter over the surface joins them, as far as each
pixel's own samples disagree: borders of hard shadows stay sharp. World metres.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from roomlight.compositing.crop import CropCamera
from roomlight.compositing.kernels.shadows import (
    LightSamples,
    Receivers,
    SurfaceGrid,
    aim_at_spheres,
    filter_ratio,
    gather_light,
    sum_blocked,
    upsample_ratio,
)
from roomlight.compositing.lighting import LightSampler
from roomlight.compositing.occlusion import depth_edges
from roomlight.compositing.placing import Plane
from roomlight.compositing.tracer import Hits, ObjectScene
from roomlight.conventions import LUMINANCE, direction_to_uv, panorama_directions
from roomlight.threads import parallel_for

TILE: Final = 4
"""Side of the tiles whose pixels use different subsets of the samples."""
REACH: Final = 4.0
"""Shadows fade out between 0.8 and 1 times this distance from an object's centre, in radii of its bounding sphere."""
SNAP_M: Final = 0.02
SNAP_SHARE: Final = 0.01
"""Points this close to the plane that an object stands on are moved onto it: 2 cm and 1 % of the depth are noise."""
LIFT_M: Final = 5e-4
RATIO_RANGE: Final = (0.02, 4.0)
_EDGE: Final = 0.04
_ALONG_PLANE: Final = 0.1


@dataclass(frozen=True)
class ShadowQuality:
    """Effort of the shadows.

    Attributes:
        step: every step-th pixel is computed, the others are interpolated.
        samples: directions to the light from each of these pixels; a filtered pixel uses about 16 times as many.
        bounces: directions toward each object from each of these pixels; 0 leaves colour bleeding out.
        radius: of the filter, in computed pixels; 2 or 4, so that every subset counts the same.
    """

    step: int
    samples: int
    bounces: int
    radius: int = 2


QUALITIES: Final = {
    "preview": ShadowQuality(step=4, samples=16, bounces=2),
    "good": ShadowQuality(step=2, samples=32, bounces=6, radius=4),
    "final": ShadowQuality(step=1, samples=64, bounces=8, radius=4),
}


@dataclass(frozen=True)
class Caster:
    """Objects that cast shadows together, under one light.

    Attributes:
        scene: the objects in the world.
        spheres: [k, 4] centre and radius of each object.
        object_ids: [k] the objects' indices in the scene.
        light: at their position.
        support: plane that they stand on, if there is one.
    """

    scene: ObjectScene
    spheres: Float32[np.ndarray, "k 4"]
    object_ids: Int[np.ndarray, " k"]
    light: LightSampler
    support: Plane | None = None


def surface_grid(
    depth_m: Float[np.ndarray, "h w"],
    camera: CropCamera,
    camera_to_world: Float[np.ndarray, "4 4"],
    supports: list[Plane],
) -> SurfaceGrid:
    """Return points and normals of the real surfaces on the pixels of a depth image; points near a support lie on it.

    Depth is smoothed within surfaces; pixels at depth edges and without depth are not known.
    """
    known = depth_m > 0
    filled = np.where(known, depth_m, depth_m.max(initial=1.0)).astype(np.float32)
    smooth = np.exp(cv2.bilateralFilter(np.log(filled), 5, 0.02, 2.0)) if min(depth_m.shape) >= 5 else filled
    known &= ~depth_edges(depth_m)
    rotation, origin = camera_to_world[:3, :3].astype(np.float32), camera_to_world[:3, 3].astype(np.float32)
    points = np.ascontiguousarray((camera.rays() * smooth[..., None]) @ rotation.T + origin)
    padded = cv2.copyMakeBorder(points, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    right, up = padded[1:-1, 2:] - padded[1:-1, :-2], padded[:-2, 1:-1] - padded[2:, 1:-1]
    normals = np.cross(right, up)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), np.float32(1e-12))
    tolerance = SNAP_M + SNAP_SHARE * smooth
    for plane in supports:
        height = plane.height_of(points)
        near = (np.abs(height) < tolerance) & (normals @ plane.normal.astype(np.float32) > 0.7)
        points[near] -= height[near][:, None] * plane.normal.astype(np.float32)
        normals[near] = plane.normal
    return SurfaceGrid(points, normals.astype(np.float32), known)


def shadow_ratio(
    casters: list[Caster],
    depth_m: Float[np.ndarray, "h w"],
    camera: CropCamera,
    camera_to_world: Float[np.ndarray, "4 4"],
    quality: ShadowQuality,
) -> Float32[np.ndarray, "h w 3"]:
    """Return light with objects / light without them on the real surfaces of an image.

    depth_m:  z-depth of the real surfaces at every pixel of `camera`, 0 unknown: ratio 1 or its neighbours'.
    """
    step = quality.step
    coarse_depth = np.ascontiguousarray(depth_m[step // 2 :: step, step // 2 :: step], np.float32)
    supports = [caster.support for caster in casters if caster.support is not None]
    grid = surface_grid(coarse_depth, camera.every(step), camera_to_world, supports)
    ratio = np.ones((*coarse_depth.shape, 3), np.float32)
    for caster in casters:
        ratio *= coarse_ratio(caster, grid, quality)
    return spread_ratio(ratio, grid.known, coarse_depth, depth_m, step)


def coarse_ratio(caster: Caster, grid: SurfaceGrid, quality: ShadowQuality) -> Float32[np.ndarray, "h w 3"]:
    """Return the ratio of one caster on a grid of surfaces; 1 beyond its reach and where the surface is not known."""
    height, width = grid.known.shape
    ratio, noise = np.ones((height, width, 3), np.float32), np.zeros((height, width), np.float32)
    fade = _fade(caster.spheres, grid)
    chosen = grid.known & (fade > 0)
    rows, columns = np.nonzero(chosen)
    if len(rows) == 0:
        return ratio
    subset = (rows % TILE * TILE + columns % TILE).astype(np.int32)
    receivers = Receivers(grid.points[chosen], grid.normals[chosen], subset)
    toward = None if caster.support is None else caster.support.normal
    light = light_samples(caster.light, quality.samples, toward=toward)
    unblocked, blocked, spread = _blocked(caster, receivers, light)
    floor = np.float32(1e-6) + np.float32(1e-3) * unblocked.max(initial=0)
    lit = np.maximum(unblocked, floor)
    bounced = _bounced(caster, receivers, quality.bounces)
    share = fade[chosen][:, None]
    ratio[chosen] = 1 + share * (np.clip((unblocked - blocked + bounced) / lit, *RATIO_RANGE) - 1)
    # rays toward an object meet it or miss it: the mean of a few is uncertain by about itself
    doubt = (bounced @ LUMINANCE) / np.float32(np.sqrt(max(quality.bounces, 1)))
    noise[chosen] = np.hypot(spread, doubt) / (lit @ LUMINANCE) * share[:, 0]
    out = np.empty_like(ratio)
    plane_m = np.float32(0.02)
    parallel_for(lambda i, j: filter_ratio(ratio, noise, grid, quality.radius, plane_m, out, i, j), height)
    return out


def spread_ratio(
    ratio: Float[np.ndarray, "h w 3"],
    known: Bool[np.ndarray, "h w"],
    depth_m: Float[np.ndarray, "h w"],
    fine_depth_m: Float[np.ndarray, "fh fw"],
    step: int,
) -> Float32[np.ndarray, "fh fw 3"]:
    """Interpolate a ratio known on every `step`-th pixel to all pixels, across no depth edge."""
    if step == 1 and known.all():
        return ratio.astype(np.float32)
    out = np.empty((*fine_depth_m.shape, 3), np.float32)
    arguments = (ratio, known, depth_m, fine_depth_m, step, np.float32(_EDGE), out)
    parallel_for(lambda start, stop: upsample_ratio(*arguments, start, stop), len(fine_depth_m))
    return out


def light_samples(light: LightSampler, count: int, *, toward: Float[np.ndarray, "3"] | None = None) -> LightSamples:
    """Sample a panorama in TILE^2 subsets of `count` directions each, in proportion to luminance.

    toward:  normal of the surface that most points lie on: its cosine is sampled too.
    """
    drawn = light
    if toward is not None:
        cosine = panorama_directions(len(light.panorama)) @ toward.astype(np.float32)
        drawn = LightSampler(light.panorama * np.maximum(cosine, np.float32(0.15))[..., None], light.position)
    points = _subset_points(count)
    directions, density = drawn.sample(points)
    radiance = light.radiance(directions)
    weights = radiance / np.maximum(density, np.float32(1e-9))[:, None] / np.float32(count)
    shape = (TILE * TILE, count, 3)
    return LightSamples(directions.reshape(shape), weights.reshape(shape).astype(np.float32))


@lru_cache(maxsize=8)
def _subset_points(count: int) -> Float[np.ndarray, "n 2"]:
    """Return TILE^2 Hammersley sets of `count` points, each shifted by a point of the R2 sequence (Roberts 2018)."""
    index = np.arange(count)
    inverse = np.zeros(count)
    for bit in range(20):
        inverse += ((index >> bit) & 1) * 0.5 ** (bit + 1)
    hammersley = np.stack([(index + 0.5) / count, inverse], axis=-1)
    order = np.arange(TILE * TILE)[:, None, None]
    points = (hammersley + order * np.array([0.7548776662466927, 0.5698402909980532])) % 1.0
    points = points.reshape(-1, 2)
    points.setflags(write=False)
    return points


def _blocked(
    caster: Caster, receivers: Receivers, light: LightSamples
) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 3"], Float32[np.ndarray, " n"]]:
    """Return irradiance without objects, what they block of it, and the standard deviation of its luminance."""
    count, samples = len(receivers.points), light.directions.shape[1]
    unblocked, candidates = np.empty((count, 3), np.float32), np.empty((count, samples), np.uint8)
    lift = np.float32(LIFT_M)
    arguments = (receivers, light, caster.spheres, lift, unblocked, candidates)
    parallel_for(lambda start, stop: gather_light(*arguments, start, stop), count)
    flat = np.flatnonzero(candidates)
    pairs = np.stack(np.divmod(flat, samples), axis=1)
    point = pairs[:, 0]
    directions = light.directions[receivers.subset[point], pairs[:, 1]]
    share = _opacity(caster.scene, receivers.points[point] + lift * receivers.normals[point], directions)
    blocked, squares = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
    sum_blocked(receivers, light, pairs, share, blocked, squares)
    variance = squares - (blocked.mean(axis=1) ** 2) / np.float32(samples)
    # All of a few samples agreeing still leaves doubt: half a sample.
    least = np.where(squares > 0, np.float32(0.2 / samples), np.float32(0.05 / samples)) * unblocked.mean(axis=1)
    return unblocked, blocked, np.sqrt(np.maximum(variance, 0) + least**2)


def _opacity(
    scene: ObjectScene, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
) -> Float32[np.ndarray, " n"]:
    """Return the share of light that the first object along each ray takes: glass and openings let light through."""
    table = scene.materials
    clear = (1 - table.transmission * table.base.mean(axis=1)) * table.opacity
    if (clear > 0.999).all():
        return scene.occluded(origins, directions).astype(np.float32)
    hits = scene.intersect(origins, directions)
    material = scene.surfaces.material[hits.face]
    return np.where(hits.face >= 0, clear[material], np.float32(0)).astype(np.float32)


def _bounced(caster: Caster, receivers: Receivers, count: int) -> Float32[np.ndarray, "n 3"]:
    """Return the irradiance that objects reflect onto the points."""
    points = len(receivers.points)
    result = np.zeros((points, 3), np.float32)
    if count == 0:
        return result
    spheres = caster.spheres
    numbers = _subset_points(count).astype(np.float32).reshape(TILE * TILE, count, 2)
    directions = np.empty((points, len(spheres), count, 3), np.float32)
    factors = np.empty((points, len(spheres), count), np.float32)
    arguments = (receivers, spheres, np.float32(LIFT_M), numbers, np.float32(REACH), directions, factors)
    parallel_for(lambda start, stop: aim_at_spheres(*arguments, start, stop), points)
    point, target, sample = np.nonzero(factors > 1e-4)
    along = directions[point, target, sample]
    origins = receivers.points[point] + np.float32(LIFT_M) * receivers.normals[point]
    hits = caster.scene.intersect(origins, along)
    # a ray aimed at one object that meets another is counted where it was aimed at that one
    hit = hits.object_id == caster.object_ids[target]
    light = _leaving(caster, origins[hit], along[hit], _taken(hits, hit))
    light *= factors[point[hit], target[hit], sample[hit]][:, None]
    for channel in range(3):
        result[:, channel] = np.bincount(point[hit], light[:, channel], points)
    return result


@dataclass(frozen=True)
class _Struck:
    distance_m: Float32[np.ndarray, " n"]
    face: Int[np.ndarray, " n"]
    normal: Float32[np.ndarray, "n 3"]


def _taken(hits: Hits, chosen: Bool[np.ndarray, " n"]) -> _Struck:
    return _Struck(hits.distance_m[chosen], hits.face[chosen], hits.normal[chosen])


def _leaving(
    caster: Caster,
    origins: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
    struck: _Struck,
) -> Float[np.ndarray, "n 3"]:
    """Return the radiance that leaves the hit surfaces toward the points, from prefiltered light.

    The underside of an object near its support sees the support in the object's own shadow: light from below is taken
    away there, over a quarter of the object's radius.
    """
    table, material = caster.scene.materials, caster.scene.surfaces.material[struck.face]
    normal = struck.normal * -np.sign((struck.normal * directions).sum(axis=1, keepdims=True))
    colour = _mean_colours(caster.scene)[material]
    metal = table.metallic[material][:, None]
    solid = ((1 - table.transmission) * table.opacity)[material][:, None]
    levels = caster.light.prefiltered
    diffuse = colour * (1 - metal) * _look_up(levels[-1], normal)
    mirrored = directions - 2 * (directions * normal).sum(axis=1, keepdims=True) * normal
    glossy = colour * metal * _look_up(levels[len(levels) // 2], mirrored)
    light = solid * (diffuse + glossy) + table.emissive[material]
    if caster.support is not None:
        height = caster.support.height_of(origins + struck.distance_m[:, None] * directions)
        radius = np.float32(caster.spheres[:, 3].max() / 4)
        down = np.maximum(-normal @ caster.support.normal.astype(np.float32), 0)
        light *= (1 - down * np.exp(-np.maximum(height, 0) / radius))[:, None]
    return light


def _mean_colours(scene: ObjectScene) -> Float32[np.ndarray, "m 3"]:
    """Return each material's base colour times its texture's mean."""
    colours = scene.materials.base.copy()
    for row, texture in enumerate(scene.materials.texture[:, 0]):
        if texture >= 0:
            colours[row] *= _texture_mean(scene, row)
    return colours


def _texture_mean(scene: ObjectScene, row: int) -> Float[np.ndarray, "3"]:
    face = int(np.flatnonzero(scene.surfaces.material == row)[0])
    held = scene.objects[scene.surfaces.object_id[face]]
    texture = held.parts[scene.surfaces.part[face]][1].base_colour_texture
    assert texture is not None
    return texture.texels[::4, ::4, :3].mean(axis=(0, 1)) / 65535


def _look_up(panorama: Float[np.ndarray, "h w 3"], directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    height, width = panorama.shape[:2]
    uv = direction_to_uv(directions)
    columns = np.minimum((uv[:, 0] * width).astype(np.int64), width - 1)
    rows = np.minimum((uv[:, 1] * height).astype(np.int64), height - 1)
    return panorama[rows, columns]


def _fade(spheres: Float[np.ndarray, "k 4"], grid: SurfaceGrid) -> Float32[np.ndarray, "h w"]:
    """Return 1 near an object and 0 beyond its reach."""
    fade = np.zeros(grid.known.shape, np.float32)
    for x, y, z, radius in spheres:
        offset = grid.points - np.array([x, y, z], np.float32)
        far = np.sqrt((offset**2).sum(axis=-1)) / np.float32(REACH * radius)
        fade = np.maximum(fade, np.clip((1 - far) / np.float32(0.2), 0, 1))
    return fade
