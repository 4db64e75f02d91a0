"""Keyframes that later frames contradict: a lamp was switched, a person has gone, an exposure had failed.

A frame contradicts a vertex of a keyframe if it sees through it, or shows the same surface with other light: as much
as in `roomlight.engine.panorama.blend`, from any direction. What it hides or does not show, it does not contradict.
Each pixel is compared with all around the other one, so that a pose that is off by 5 cm at 2 m is no change.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from roomlight.conventions import luminance
from roomlight.engine.kernels.blend import BEYOND, CHANGED, LEAST_CHANGE, UNBOUNDED
from roomlight.engine.observations import CLOSER_M
from roomlight.engine.surface.mesh import FrameMesh

CONTRADICTED: Final = 0.01
"""A keyframe is contradicted if this share of its vertices is: by a lamp of 30 cm at 2 m."""
_EVERY: Final = 4
"""Every fourth vertex of every fourth row is compared."""
_SAME_M: Final = 0.15
"""Two depths are of one surface within 15 cm."""
_PIXEL: Final = np.zeros(1)
_AROUND: Final = np.linspace(-1, 1, 7) / 54
"""Rows and columns that are compared around a pixel, in widths of the image: up to 1.2 degrees."""


class _Pixels(NamedTuple):
    """Pixels of a mesh's grid, or of its image."""

    mesh: FrameMesh
    row: Int[np.ndarray, " n"]
    column: Int[np.ndarray, " n"]


def contradicts(mesh: FrameMesh, keyframe: FrameMesh) -> bool:
    """Return whether a frame contradicts a keyframe."""
    own, theirs, z = _in_view(mesh, keyframe, _EVERY)
    least = CONTRADICTED * keyframe.measured[_EVERY // 2 :: _EVERY, _EVERY // 2 :: _EVERY].size
    for around in (_PIXEL, _AROUND):  # few pixels are left for the second one
        if len(z) <= least:
            return False
        changed = _sees_through(own, theirs, z, around) | _shows_other_light(own, theirs, z, around)
        own, theirs = (_Pixels(at.mesh, at.row[changed], at.column[changed]) for at in (own, theirs))
        z = z[changed]
    return len(z) > least


def not_seen_through(mesh: FrameMesh, keyframe: FrameMesh) -> Float[np.ndarray, "v 3"]:
    """Return those vertices of a keyframe, world metres, that a frame does not see through."""
    own, theirs, z = _in_view(mesh, keyframe, 1)
    through = _sees_through(own, theirs, z, _PIXEL)
    stays = keyframe.grid_depth_m > 0
    stays[theirs.row[through], theirs.column[through]] = False
    return keyframe.vertices_at(np.s_[:, :])[stays.reshape(-1)]


def _in_view(mesh: FrameMesh, keyframe: FrameMesh, step: int) -> tuple[_Pixels, _Pixels, Float[np.ndarray, " n"]]:
    """Return where a frame shows every n-th measured vertex of a keyframe: its pixels, theirs, their z-depth in it."""
    every = np.s_[step // 2 :: step, step // 2 :: step]
    measured = keyframe.measured[every]
    inside, xy, z = mesh.find(keyframe.vertices_at(every)[measured.reshape(-1)])
    column, row = xy.astype(int).T
    rows, columns = (step * axis[inside] + step // 2 for axis in np.nonzero(measured))
    return _Pixels(mesh, row, column), _Pixels(keyframe, rows, columns), z


def _sees_through(
    own: _Pixels, theirs: _Pixels, z: Float[np.ndarray, " n"], around: Float[np.ndarray, " k"]
) -> Bool[np.ndarray, " n"]:
    """Return where all around a pixel is farther than a vertex, at `z` from the camera, and than all around that."""
    mesh, keyframe = own.mesh, theirs.mesh
    measured = [_around(at.mesh.measured, at, around).all(axis=0) for at in (own, theirs)]
    nearest = _around(mesh.grid_depth_m, own, around).min(axis=0)
    farthest = _around(keyframe.grid_depth_m, theirs, around).max(axis=0)
    behind = nearest - z - (farthest - keyframe.grid_depth_m[theirs.row, theirs.column])
    return measured[0] & measured[1] & (behind > np.maximum(CLOSER_M, BEYOND * z))


def _shows_other_light(
    own: _Pixels, theirs: _Pixels, z: Float[np.ndarray, " n"], around: Float[np.ndarray, " k"]
) -> Bool[np.ndarray, " n"]:
    """Return where a vertex's surface is seen, and all around is brighter or darker than all around the vertex."""
    depth, measured = (plane[own.row, own.column] for plane in (own.mesh.grid_depth_m, own.mesh.measured))
    (lowest, highest), (least, most) = (_light(at, around) for at in (own, theirs))
    other = (lowest > CHANGED * most + LEAST_CHANGE) | (CHANGED * highest + LEAST_CHANGE < least)
    return measured & (np.abs(depth - z) < _SAME_M) & other


def _light(at: _Pixels, around: Float[np.ndarray, " k"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the least lower bound of the luminance around pixels of the grid, and the greatest possible luminance."""
    texture = at.mesh.texture
    height, width = texture.image.shape[:2]
    column, row = (at.mesh.grid.uv()[at.row, at.column] * (width, height)).astype(int).T
    at = _Pixels(at.mesh, row, column)
    shown = luminance(_around(texture.image, at, around))
    if texture.clipped is None or texture.guessed is None:
        return shown.min(axis=0), shown.max(axis=0)
    clipped, guessed = (_around(plane, at, around) for plane in (texture.clipped, texture.guessed))
    return (shown - guessed).min(axis=0), np.where(clipped, UNBOUNDED, shown).max(axis=0)


def _around(
    image: Shaped[np.ndarray, "h w *c"], at: _Pixels, around: Float[np.ndarray, " k"]
) -> Shaped[np.ndarray, "kk n *c"]:
    """Return the values around pixels of an image; those beyond its border count as those at it."""
    if len(around) == 1:
        return image[at.row, at.column][None]
    height, width = image.shape[:2]
    offsets = np.rint(around * width).astype(int)[:, None]
    rows, columns = np.clip(at.row + offsets, 0, height - 1), np.clip(at.column + offsets, 0, width - 1)
    return image[rows[:, None], columns].reshape(-1, len(at.row), *image.shape[2:])
