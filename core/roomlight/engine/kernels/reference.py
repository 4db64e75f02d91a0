"""Readable references of the kernels in NumPy, equation by equation: tests compare the fast ones with them.

They have the signatures of the functions that call the kernels, and are slow.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.camera import rigid_inverse
from roomlight.conventions import LUMINANCE, panorama_directions
from roomlight.engine.kernels.blend import (
    AGREES,
    APART,
    BEGINS,
    BEYOND,
    CHANGED,
    DIFFERS,
    LEAST_CHANGE,
    SAME_VIEW,
    SEEN_THROUGH_FRAMES,
    UNBOUNDED,
)
from roomlight.engine.observations import CLOSER_M, better_share
from roomlight.engine.panorama.blend import AT_PROBE, PanoramaState, PartialPanorama, neighbourhood, replaced_by_change
from roomlight.engine.surface.mesh import DepthView
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.engine.volume.sglv import LOBE_CHANNELS, MAX_SAMPLES, Far, Sglv, check_position
from roomlight.frame import Frame


def initial_volume_reference(
    grid: VolumeGrid, frame: Frame, *, far_unknown: bool = True
) -> Float[np.ndarray, "5 z y x"]:
    """Compute `roomlight.engine.volume.grid.initial_volume`."""
    camera_from_volume = rigid_inverse(frame.camera_to_world) @ grid.volume_to_world
    centres = grid.centres_m()
    in_camera = centres @ camera_from_volume[:3, :3].T + camera_from_volume[:3, 3]
    xy, depth_of_voxel = frame.intrinsics.project(in_camera)
    size = np.array([frame.intrinsics.width, frame.intrinsics.height])
    with np.errstate(invalid="ignore"):
        seen = (depth_of_voxel > 0) & (xy >= 0).all(axis=-1) & (xy < size).all(axis=-1)
    uv = (xy[seen] / size).astype(np.float64)
    z = depth_of_voxel[seen]

    depth, known_share = _bilinear_known(frame.depth_m, uv)
    unknown = known_share < 0.5
    camera_in_volume = rigid_inverse(camera_from_volume)[:3, 3]
    far = _exit_depth(grid, camera_in_volume, centres[seen], z) - grid.edge_m
    surface = np.where(unknown, far, depth)

    v = grid.edge_m
    in_front = 4 * ((z - surface) / v + 1)
    behind = 4 * ((surface - z) / v + 5)
    alpha = np.clip(np.where(surface > z, in_front, behind), 0, 1)
    if not far_unknown:
        alpha = np.where(unknown, 0, alpha)
    empty = np.where(~unknown & ((surface - z) / v > 3), -1.0, 0.0)

    volume = np.zeros((5, *grid.shape), np.float32)
    volume[:3, seen] = (alpha[:, None] * _bilinear(frame.image, uv)).T
    volume[3, seen] = alpha
    volume[4, seen] = empty
    return volume


def render_rays_reference(
    sglv: Sglv,
    position_world: tuple[float, float, float],
    directions_world: Float[np.ndarray, "n 3"],
    *,
    samples: int = MAX_SAMPLES,
    step_m: float | None = None,
    far: Far = "boundary",
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Compute `roomlight.engine.volume.sglv.render_rays` by equations 1 and 2 in float64, without early exit."""
    grid = sglv.grid
    step = grid.edge_m if step_m is None else step_m
    rotation = grid.world_to_volume[:3, :3]
    origin = rotation @ check_position(position_world) + grid.world_to_volume[:3, 3]
    directions = directions_world.astype(np.float64) @ rotation.T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        to_walls = np.stack([(grid.lower_m - origin) / directions, (grid.upper_m - origin) / directions])
    enter = np.maximum(np.nanmax(to_walls.min(axis=0), axis=-1), 0.0)
    leave = np.nanmin(to_walls.max(axis=0), axis=-1)
    hits = leave > enter
    enter = np.where(hits, enter, 0.0)  # a ray beside the volume and parallel to it enters at infinity

    values = np.zeros((len(directions), LOBE_CHANNELS))
    left = np.ones(len(directions))
    for sample in range(samples):
        t = enter + (sample + 0.5) * step
        inside = hits & (t < leave)
        here = _trilinear(sglv, origin + t[:, None] * directions)
        weight = np.where(inside, left * here[:, 0], 0.0)
        values += weight[:, None] * here[:, 1:]
        left -= weight
    if far == "boundary":
        here = _trilinear(sglv, origin + np.where(hits, leave, 0.0)[:, None] * directions)
        values += np.where(hits, left, 0.0)[:, None] * here[:, 1:]
    colour, weight, bandwidth, lobe_direction = values[:, :3], values[:, 3:6], values[:, 6:7], values[:, 7:]
    cosine = (directions * lobe_direction).sum(axis=-1, keepdims=True)
    radiance = colour + weight * np.exp(bandwidth * (cosine - 1))
    return radiance.astype(np.float32), left.astype(np.float32)


def accumulate_reference(
    state: PanoramaState,
    partial: PartialPanorama,
    *,
    hdr: Float[np.ndarray, "h w 3"] | None,
    weight: Float[np.ndarray, "h w"],
    unseen_m: float,
    camera: Float[np.ndarray, "3"] = AT_PROBE,
) -> None:
    """Compute `roomlight.engine.panorama.blend.accumulate`."""
    detail, depth_m = partial.radiance, partial.depth_m
    clipped = np.zeros_like(weight) if partial.clipped is None else partial.clipped
    guessed = np.zeros_like(weight) if partial.guessed is None else partial.guessed
    bound, new_bound = state.radiance @ LUMINANCE - state.guessed, detail @ LUMINANCE - guessed
    same = (abs(state.depth_m - depth_m) < CLOSER_M) & (weight > 0) & (state.observed > 0)
    lowest, highest, brightest = extremes_around(detail, clipped, guessed, weight=weight)
    shown = state.radiance @ LUMINANCE
    differs = same & ((lowest > CHANGED * shown + LEAST_CHANGE) | (CHANGED * highest + LEAST_CHANGE < bound))
    confirmed = (CHANGED * lowest + LEAST_CHANGE >= bound) & (brightest <= CHANGED * shown + LEAST_CHANGE)
    point = panorama_directions(len(weight)) * depth_m[..., None]
    before, now = state.viewed_from - point, camera - point
    lengths = np.linalg.norm(before, axis=-1) * np.linalg.norm(now, axis=-1)
    near = (before * now).sum(axis=-1) >= SAME_VIEW * lengths
    state.changed[same & ~differs] = 0
    measured = np.ones_like(weight) if partial.measured is None else partial.measured.astype(np.float32)
    state.measured[same] = np.maximum(state.measured, measured)[same]
    replaced = replaced_by_change(
        state, np.where(differs, np.where(near, BEGINS, DIFFERS), np.where(same, AGREES, APART))
    )
    state.forget(replaced, unseen_m)
    closer = state.is_closer(depth_m)
    state.viewed_from[((weight > 0) & closer) | (same & ~differs & confirmed)] = camera
    blend = np.maximum(weight - ~closer, 0)
    better = better_share(state.clipped, bound, clipped, new_bound) * np.minimum(weight, 1)
    blend = np.where(same & ~replaced, np.maximum(blend, better), blend)
    known = state.observed[..., None]
    background = (1 - known) * (state.radiance if hdr is None else hdr) + known * state.radiance
    state.radiance[:] = blend[..., None] * detail + (1 - blend[..., None]) * background
    for accumulated, new in (
        (state.depth_m, depth_m),
        (state.clipped, clipped),
        (state.guessed, guessed),
        (state.measured, measured),
    ):
        accumulated[:] = blend * new + (1 - blend) * accumulated
    state.observed[:] = np.minimum(state.observed + blend, 1)


def seen_through_reference(
    state: PanoramaState,
    shown_m: Float[np.ndarray, "h w"],
    position: Float[np.ndarray, "3"],
    view: DepthView,
    farthest_m: float,
) -> Bool[np.ndarray, "h w"]:
    """Compute `roomlight.engine.kernels.blend.count_seen_through`; return `gone`."""
    points = position + state.depth_m[..., None] * panorama_directions(len(shown_m))
    x, y, z = np.moveaxis(points @ view.world_to_camera[:3, :3].T + view.world_to_camera[:3, 3], -1, 0)
    column, row = view.lens[2] - view.lens[0] * x / z, view.lens[3] + view.lens[1] * y / z
    rows, columns = view.depth.shape
    inside = (z < 0) & (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    measured = view.depth[np.where(inside, row, 0).astype(int), np.where(inside, column, 0).astype(int)]
    stays = (state.depth_m >= farthest_m) | ((shown_m > 0) & (abs(shown_m - state.depth_m) < CLOSER_M))
    through = ~stays & inside & (measured > -z + np.maximum(CLOSER_M, -BEYOND * z)) & (state.observed > 0)
    again = (stays | inside) & ~through & (state.observed > 0)
    state.changed[again] = np.maximum(state.changed, 0)[again]
    state.changed[through] = np.minimum(state.changed, 0)[through] - 1
    gone = state.changed <= -SEEN_THROUGH_FRAMES
    state.changed[gone] = 0
    return gone


def extremes_around(
    detail: Float[np.ndarray, "h w 3"],
    clipped: Float[np.ndarray, "h w"],
    guessed: Float[np.ndarray, "h w"],
    *,
    weight: Float[np.ndarray, "h w"],
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Return least lower bound, greatest possible luminance and greatest lower bound around each seen pixel.

    Unseen pixels are left out, and have no values; a clipped one has no upper bound. Panoramas wrap around; pixels at
    the two edge columns see fewer neighbours.
    """
    lowest, highest, brightest = (np.zeros_like(weight) for _ in range(3))
    seen, around = weight > 0, neighbourhood(len(weight))
    rows, columns = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
    if len(rows):
        reach = len(around) // 2
        top, left = max(rows[0] - reach, 0), max(columns[0] - reach, 0)
        box = np.s_[top : rows[-1] + 1 + reach, left : columns[-1] + 1 + reach]
        luminance, seen, zero = np.asarray(detail[box] @ LUMINANCE, np.float32), seen[box], np.float32(0)
        bound = luminance - guessed[box]
        lowest[box] = cv2.erode(np.where(seen, bound, UNBOUNDED), around)
        limit = np.where(clipped[box] > 0, UNBOUNDED, luminance)
        highest[box] = cv2.dilate(np.where(seen, limit, zero), around)
        brightest[box] = cv2.dilate(np.where(seen, bound, zero), around)
    return lowest, highest, brightest


def _bilinear(image: Float[np.ndarray, "h w 3"], uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    corners, weights = _corners(image.shape[1], image.shape[0], uv)
    return sum(w[:, None] * image[row, column] for (row, column), w in zip(corners, weights, strict=True))  # pyright: ignore[reportReturnType]


def _bilinear_known(
    depth_m: Float[np.ndarray, "h w"], uv: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Interpolate depth bilinearly over the known samples only; return it with the known share of the weight."""
    corners, weights = _corners(depth_m.shape[1], depth_m.shape[0], uv)
    total, share = np.zeros(len(uv)), np.zeros(len(uv))
    for (row, column), weight in zip(corners, weights, strict=True):
        value = depth_m[row, column]
        total += weight * value
        share += weight * (value > 0)
    return total / np.maximum(share, 1e-6), share


def _corners(
    width: int, height: int, uv: Float[np.ndarray, "n 2"]
) -> tuple[list[tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]], list[Float[np.ndarray, " n"]]]:
    """Return (row, column) of the four samples around each (u, v), and their bilinear weights."""
    column = np.clip(uv[:, 0] * width - 0.5, 0, width - 1)
    row = np.clip(uv[:, 1] * height - 0.5, 0, height - 1)
    i0, j0 = column.astype(int), row.astype(int)
    i1, j1 = np.minimum(i0 + 1, width - 1), np.minimum(j0 + 1, height - 1)
    fi, fj = column - i0, row - j0
    corners = [(j0, i0), (j0, i1), (j1, i0), (j1, i1)]
    return corners, [(1 - fj) * (1 - fi), (1 - fj) * fi, fj * (1 - fi), fj * fi]


def _exit_depth(
    grid: VolumeGrid,
    camera: Float[np.ndarray, "3"],
    points: Float[np.ndarray, "n 3"],
    depth: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Return the z-depth at which the camera's ray through each point (volume frame) leaves the volume."""
    direction = points - camera
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        wall = np.where(direction > 0, grid.upper_m, grid.lower_m)
        reach = np.where(np.abs(direction) > 1e-9, (wall - camera) / direction, np.inf)
    return depth * reach.min(axis=-1)


def _trilinear(sglv: Sglv, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 11"]:
    """Interpolate (alpha, c, w, lambda, s) at points of the volume frame; constant beyond the outermost centres."""
    grid = sglv.grid
    counts = np.array(grid.shape[::-1])
    index = np.clip((points - grid.lower_m) / grid.voxel_m - 0.5, 0, counts - 1)
    low = np.minimum(index.astype(int), counts - 1)
    high = np.minimum(low + 1, counts - 1)
    fraction = index - low
    result = np.zeros((len(points), 1 + LOBE_CHANNELS))
    for corner in range(8):
        bits = [(corner >> axis) & 1 for axis in range(3)]
        weight = np.prod([fraction[:, a] if bit else 1 - fraction[:, a] for a, bit in enumerate(bits)], axis=0)
        i, j, k = (high[:, a] if bit else low[:, a] for a, bit in enumerate(bits))
        result[:, 0] += weight * sglv.alpha[k, j, i]
        result[:, 1:] += weight[:, None] * sglv.lobes[k, j, i]
    return result
