"""Directions on the six faces of a cube map, by OpenGL's table.

Faces come in the order +X -X +Y -Y +Z -Z. On a face, `across` runs with the columns and `down` with the rows (row 0
is stored first), both -1 .. 1 over the face (OpenGL's sc / |ma| and tc / |ma|):

| face | across | down | row 0 shows | column 0 shows |
|------|--------|------|-------------|----------------|
| +X   | -z     | -y   | +y          | +z             |
| -X   | +z     | -y   | +y          | -z             |
| +Y   | +x     | +z   | -z          | -x             |
| -Y   | +x     | -z   | +z          | -x             |
| +Z   | +x     | -y   | +y          | -x             |
| -Z   | -x     | -y   | +y          | +x             |

A sampler that gets a world direction returns the light from that direction. As in every GL cube map, a face seen from
inside the cube is mirrored. three.js treats cube textures that it did not render itself as left-handed and negates x
before the look-up: `environmentTexture` of `client/js/src/three.ts` mirrors the faces for it.
"""

from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float, Int

FACES: Final = ("+X", "-X", "+Y", "-Y", "+Z", "-Z")

# [face, (across, down, forward), xyz]
_AXES: Final = np.array(
    [
        [[0, 0, -1], [0, -1, 0], [1, 0, 0]],
        [[0, 0, 1], [0, -1, 0], [-1, 0, 0]],
        [[1, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[1, 0, 0], [0, 0, -1], [0, -1, 0]],
        [[1, 0, 0], [0, -1, 0], [0, 0, 1]],
        [[-1, 0, 0], [0, -1, 0], [0, 0, -1]],
    ],
    np.float64,
)


def face_to_direction(
    face: Int[np.ndarray, " n"], across: Float[np.ndarray, " n"], down: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """Return the unit directions of points on faces; a point a little beyond a face's edge lies on its neighbour."""
    local = np.stack([across, down, np.ones_like(across)], axis=-1)
    direction = np.einsum("na,nax->nx", local, _AXES[face])
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def direction_to_face(
    direction: Float[np.ndarray, "n 3"],
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return (face, across, down) of directions of any length but 0; inverse of `face_to_direction`."""
    axis = np.argmax(np.abs(direction), axis=-1)
    major = np.take_along_axis(direction, axis[:, None], axis=-1)[:, 0]
    face = 2 * axis + (major < 0)
    local = np.einsum("nx,nax->na", direction, _AXES[face][:, :2]) / np.abs(major)[:, None]
    return face, local[:, 0], local[:, 1]


def cube_directions(size: int) -> Float[np.ndarray, "6*{size}*{size} 3"]:
    """Return the unit directions of the texel centres, face by face and row by row."""
    ticks = (np.arange(size) + 0.5) / size * 2 - 1
    face, down, across = np.meshgrid(np.arange(6), ticks, ticks, indexing="ij")
    return face_to_direction(face.reshape(-1), across.reshape(-1), down.reshape(-1))


def cube_solid_angles(size: int) -> Float[np.ndarray, "{size} {size}"]:
    """Return the exact solid angle in steradians of each texel of one face; six faces cover 4 pi."""
    edges = np.linspace(-1, 1, size + 1)
    x, y = np.meshgrid(edges, edges)
    corner = np.arctan2(x * y, np.sqrt(x * x + y * y + 1))
    return corner[1:, 1:] - corner[1:, :-1] - corner[:-1, 1:] + corner[:-1, :-1]


def texel_index(
    face: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], *, size: int
) -> Int[np.ndarray, " n"]:
    """Return the index of texels in a list of all faces; one step beyond a face's edge is the neighbouring texel."""
    inside = (column >= 0) & (column < size) & (row >= 0) & (row < size)
    index = (face * size + row) * size + column
    outside = np.flatnonzero(~inside)
    if len(outside):
        across, down = ((line[outside] + 0.5) / size * 2 - 1 for line in (column, row))
        face, across, down = direction_to_face(face_to_direction(face[outside], across, down))
        column, row = (np.clip(((t + 1) / 2 * size).astype(int), 0, size - 1) for t in (across, down))
        index[outside] = (face * size + row) * size + column
    return index


@lru_cache(maxsize=16)
def padded_indices(size: int) -> Int[np.ndarray, " n"]:
    """Return texel indices [6 (s + 2) (s + 2)] of the faces, each with a border of neighbours' texels; read-only."""
    steps = np.arange(-1, size + 1)
    face, row, column = (grid.reshape(-1) for grid in np.meshgrid(np.arange(6), steps, steps, indexing="ij"))
    index = texel_index(face, column, row, size=size)
    index.setflags(write=False)
    return index
