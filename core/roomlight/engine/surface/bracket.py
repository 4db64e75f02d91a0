"""Frames of other exposure: what one frame clips, another one shows.

A phone changes its exposure all the time, and the frames of a session are in one unit. An observation of a surface is
its radiance, whether it was clipped, and a lower bound of its luminance: the image as measured, 1 / exposure where it
was clipped. It gives way to one that knows more (`roomlight.engine.observations.better_share`), in three places:

- a frame takes the radiance of its clipped pixels from the keyframes, before clipped light is estimated
  (`take_clipped_light`), so that its mesh and volume hold it;
- each keyframe takes that of its own clipped pixels from the new frame (`update_keyframes`): later probes see it;
- a probe's panorama and the voxels of the mean volume replace their clipped observations.

Points are matched by reprojection with a depth check. Every frame is the whole bracket of what was seen so far, so
that the order of exposures does not matter.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.camera import Intrinsics, rigid_inverse, transform_points
from roomlight.conventions import LUMINANCE
from roomlight.engine.kernels.bracket import PointArrays, SourceArrays, take_radiance
from roomlight.engine.observations import CLOSER_M
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.surface.texture import Texture
from roomlight.frame import Frame

MIN_RATIO: Final = 1.15
"""A frame is searched only if its brightest pixel is this much brighter than the white of the clipped ones: with equal
exposures nothing is searched."""
MAX_PROJECTIONS: Final = 75_000
"""Most points projected for one frame in each direction: 12 ms on one core. Only meshes that may show them count. A
frame asks the latest ones first; of keyframes that it cannot serve at once, each frame begins with another one."""
_GOLDEN: Final = 0.6180339887498949
"""A step round a circle that comes near every place, also of every second or third frame."""


def take_clipped_light(frame: Frame, depth_m: Float[np.ndarray, "dh dw"], earlier: Iterable[FrameMesh]) -> Frame:
    """Return the frame with the radiance of its clipped pixels taken from earlier frames that show them.

    Pixels that are clipped there too start from the highest white that clipped them.

    Args:
        frame: As measured.
        depth_m: Its completed depth.
        earlier: Meshes of earlier frames; of two that know as much, the later one counts.
    """
    where = np.flatnonzero(frame.clipped)
    bound = frame.image.reshape(-1, 3)[where] @ LUMINANCE
    white = float(np.median(bound)) if len(where) else float("inf")
    sources = [mesh for mesh in reversed(list(earlier)) if _may_know(mesh, white)]
    if sources:
        corners = _corners(frame.clipped, frame.intrinsics, frame.camera_to_world, depth_m)
        sources = [mesh for mesh in sources if _may_show(mesh, corners)]
    if not sources:
        return frame
    depth_camera = frame.intrinsics.resized(depth_m.shape[1], depth_m.shape[0])
    local, known = _points(where, frame.intrinsics, depth_m, depth_camera)
    where = where[known]
    points = _clipped_points(local, frame.camera_to_world, frame.image.reshape(-1, 3)[where], bound[known])
    left = MAX_PROJECTIONS
    for source in sources:
        pending = int(points.clipped.sum())
        if pending == 0 or pending > left:
            break
        left -= pending
        take_radiance(points, _source(source), np.float32(CLOSER_M))
    image, clipped = frame.image.copy(), frame.clipped.copy()
    # as measured: a source's own estimate is left out
    measured = points.radiance * (points.bound / np.maximum(points.radiance @ LUMINANCE, 1e-12))[:, None]
    image.reshape(-1, 3)[where] = np.where(points.clipped[:, None], measured, points.radiance)
    clipped.reshape(-1)[where] = points.clipped
    return replace(frame, image=image, clipped=clipped)


def update_keyframes(mesh: FrameMesh, keyframes: Iterable[FrameMesh], *, turn: int = 0) -> int:
    """Give the radiance that the mesh shows to the keyframes that clipped it; return the number of their pixels.

    `turn` is the number of the frame in its session: another keyframe comes first each time.
    """
    taken, left = 0, MAX_PROJECTIONS
    wanting = [key for key in keyframes if key is not mesh and _may_know(mesh, key.texture.white)]
    first = int(turn * _GOLDEN % 1 * len(wanting))
    for key in wanting[first:] + wanting[:first]:
        texture = key.texture
        if texture.clipped is None or left <= 0:
            continue
        if not _may_show(mesh, _corners(texture.clipped, key.image_camera, key.camera_to_world, key.grid_depth_m)):
            continue
        where = np.flatnonzero(texture.clipped)[:left]
        bound = texture.bound.reshape(-1)[where]
        left -= len(where)
        local, known = _points(where, key.image_camera, key.grid_depth_m, key.grid_camera)
        where = where[known]
        points = _clipped_points(local, key.camera_to_world, texture.image.reshape(-1, 3)[where], bound[known])
        count = int(take_radiance(points, _source(mesh), np.float32(CLOSER_M)))
        if count:
            key.texture = _with_points(texture, where, points)
            taken += count
    return taken


def _clipped_points(
    local: Float[np.ndarray, "n 3"],
    camera_to_world: Float[np.ndarray, "4 4"],
    radiance: Float[np.ndarray, "n 3"],
    bound: Float[np.ndarray, " n"],
) -> PointArrays:
    world = transform_points(camera_to_world, local).astype(np.float32)
    return PointArrays(world, radiance, bound, np.ones(len(local), bool))


def _may_know(mesh: FrameMesh, white: float) -> bool:
    return mesh.texture.peak > MIN_RATIO * white


def _corners(
    clipped: Bool[np.ndarray, "h w"],
    k: Intrinsics,
    camera_to_world: Float[np.ndarray, "4 4"],
    depth_m: Float[np.ndarray, "dh dw"],
) -> Float[np.ndarray, "8 3"]:
    """Return the corners, in world metres, of the part of a camera's view that has its clipped pixels and its depth."""
    rows, columns = (np.flatnonzero(clipped.any(axis=axis))[[0, -1]] + 0.5 for axis in (1, 0))
    far = float(depth_m.max())
    near = float(depth_m[depth_m > 0].min()) if far else far
    x, y, z = (axis.ravel() for axis in np.meshgrid((columns - k.cx) / k.fx, (rows - k.cy) / k.fy, [near, far]))
    return transform_points(camera_to_world, np.stack([x * z, -y * z, -z], axis=-1))


def _may_show(mesh: FrameMesh, corners: Float[np.ndarray, "8 3"]) -> bool:
    """Return False if all corners are beyond one side of the mesh's view, so that nothing between them is in it."""
    k = mesh.image_camera
    x, y, z = transform_points(rigid_inverse(mesh.camera_to_world), corners).T * np.array([[1], [-1], [-1]])
    column, row = k.fx * x + k.cx * z, k.fy * y + k.cy * z  # times the depth
    return all((side >= 0).any() for side in (z, column, k.width * z - column, row, k.height * z - row))


def _source(mesh: FrameMesh) -> SourceArrays:
    texture, bound, view, k = mesh.texture, mesh.texture.bound, mesh.depth_view, mesh.image_camera
    clipped = np.zeros(bound.shape, bool) if texture.clipped is None else texture.clipped
    lens = np.array([k.fx, k.fy, k.cx, k.cy], np.float32)
    return SourceArrays(texture.image, clipped, bound, view.depth, lens, view.lens, view.world_to_camera)


def _with_points(texture: Texture, where: Int[np.ndarray, " n"], points: PointArrays) -> Texture:
    assert texture.clipped is not None
    assert texture.guessed is not None
    image, clipped, guessed = texture.image.copy(), texture.clipped.copy(), texture.guessed.copy()
    image.reshape(-1, 3)[where] = points.radiance
    clipped.reshape(-1)[where] = points.clipped
    estimated = np.maximum(points.radiance @ LUMINANCE - points.bound, 0)  # rounding leaves -1e-7
    guessed.reshape(-1)[where] = np.where(points.clipped, estimated, 0)
    return Texture(image, clipped, guessed) if clipped.any() else Texture(image)


def _points(
    where: Int[np.ndarray, " n"], image: Intrinsics, depth_m: Float[np.ndarray, "dh dw"], depth: Intrinsics
) -> tuple[Float[np.ndarray, "m 3"], Bool[np.ndarray, " n"]]:
    """Return the camera's points at the pixels (flat indices) whose nearest depth is known, and which these are.

    `image` and `depth` are one camera at two sizes.
    """
    row, column = np.divmod(where, image.width)
    x, y = (column + 0.5 - image.cx) / image.fx, (row + 0.5 - image.cy) / image.fy
    i = np.clip((depth.cx + depth.fx * x).astype(int), 0, depth.width - 1)
    j = np.clip((depth.cy + depth.fy * y).astype(int), 0, depth.height - 1)
    z = depth_m[j, i]
    known = z > 0
    return (np.stack([x, -y, -np.ones_like(x)], axis=-1) * z[:, None])[known], known
