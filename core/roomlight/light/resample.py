"""Panorama to cube map and back by overlap: light is conserved, and a constant stays constant.

A resampling is a sparse matrix of solid angles A[texel, pixel], estimated by points on the sphere that each belong to
one target and, bilinearly, to the four sources around them. It is then balanced (Sinkhorn) until its rows sum to the
targets' exact solid angles and its columns to the sources'. A panorama's light is kept within 1e-4, and that of any
single pixel within 0.2 %; points without balancing are off by 3 %.

Near a panorama's poles, pixels are so narrow that few points would fall into them: there neighbours in a row are read
together, in groups about as wide as a row is high.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from roomlight.conventions import direction_to_uv, panorama_solid_angles, uv_to_direction
from roomlight.light.cube_geometry import cube_directions, cube_solid_angles, direction_to_face, texel_index
from roomlight.threads import parallel_for

MAX_ROWS: Final = 512
"""Most rows of the panorama of a matrix: enough for the texels of a cube of 256 around its horizon."""
_BALANCED: Final = 1e-4
_SWEEPS: Final = 100  # the narrow pixels at the poles converge last
_ONE_THREAD: Final = 400_000  # entries: for less than a millisecond of work a pool costs more than it saves


@dataclass(frozen=True)
class SparseMap:
    """Rows of weights over sources: row r is sources[starts[r] : starts[r + 1]] with their weights."""

    starts: Int[np.ndarray, " n1"]
    sources: Int[np.ndarray, " m"]
    weights: Float[np.ndarray, " m"]

    def __call__(self, values: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "r c"]:
        """Return the weighted means of the sources' values, float32, a row each."""
        from roomlight.light.kernels.gather import gather_rows  # numba: 0.5 s that clients without cube maps save

        rows = len(self.starts) - 1
        out = np.empty((rows, values.shape[1]), np.float32)
        values = np.ascontiguousarray(values, np.float32)
        arguments = (self.starts, self.sources, self.weights, values, out)
        if len(self.sources) < _ONE_THREAD:
            gather_rows(*arguments, 0, rows)
        else:
            parallel_for(lambda begin, end: gather_rows(*arguments, begin, end), rows)
        return out


@dataclass(frozen=True)
class _Overlap:
    """Solid angles that targets and sources share; (target, source) pairs are unique and sorted by target."""

    target: Int[np.ndarray, " m"]
    source: Int[np.ndarray, " m"]
    shared: Float[np.ndarray, " m"]

    @classmethod
    def of(
        cls,
        pieces: Iterable[tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]],
        sources: int,
    ) -> "_Overlap":
        targets, chosen, shares = (np.concatenate(part) for part in zip(*pieces, strict=True))
        keys, inverse = np.unique(targets * np.int64(sources) + chosen, return_inverse=True)
        return cls(keys // sources, keys % sources, np.bincount(inverse, shares))

    def balanced(self, target_area: Float[np.ndarray, " t"], source_area: Float[np.ndarray, " s"]) -> "_Overlap":
        shared = self.shared
        for _ in range(_SWEEPS):
            shared = shared * (target_area / np.bincount(self.target, shared, len(target_area)))[self.target]
            scale = source_area / np.bincount(self.source, shared, len(source_area))
            if np.abs(scale - 1).max() < _BALANCED:
                break
            shared = shared * scale[self.source]
        return _Overlap(self.target, self.source, shared)


@lru_cache(maxsize=5)  # every size of cube at one height: 25 MB at 120 rows, 60 MB at 512
def panorama_to_cube(rows: int, size: int) -> SparseMap:
    """Make the map from the pixels of a panorama of `rows` (up to `MAX_ROWS`) to the texels of a cube."""
    group, area = _pixel_groups(rows)
    parts = max(2 if size <= 128 else 1, -(-rows // size))  # points along a texel's side: half a pixel apart, or less
    fine = size * parts
    face, row, column = np.unravel_index(np.arange(6 * fine * fine), (6, fine, fine))
    target = (face * size + row // parts) * size + column // parts
    share = np.tile(cube_solid_angles(fine).reshape(-1), 6)
    uv = direction_to_uv(cube_directions(fine))
    x, y = uv[:, 0] * (2 * rows) - 0.5, uv[:, 1] * rows - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    overlap = _Overlap.of(
        (
            (target, group[np.clip(top + down, 0, rows - 1), (left + right) % (2 * rows)], share * across * along)
            for right, across in ((0, 1 - (x - left)), (1, x - left))
            for down, along in ((0, 1 - (y - top)), (1, y - top))
        ),
        len(area),
    ).balanced(np.tile(cube_solid_angles(size).reshape(-1), 6), area)
    members = np.bincount(group.reshape(-1), minlength=len(area))
    firsts = np.cumsum(members) - members  # a group's pixels are adjacent, and groups are in the pixels' order
    repeats = members[overlap.source]
    spread = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    pixel = np.repeat(firsts[overlap.source], repeats) + spread
    return _sparse(
        np.repeat(overlap.target, repeats), pixel, np.repeat(overlap.shared / repeats, repeats), 6 * size * size
    )


@lru_cache(maxsize=5)
def cube_to_panorama(rows: int, size: int) -> SparseMap:
    """Make the map from the texels of a cube to the pixels of a panorama of `rows` (up to `MAX_ROWS`)."""
    parts = max(2, -(-4 * size // rows))  # points half a texel apart, where texels are smallest
    fine = rows * parts
    row, column = np.unravel_index(np.arange(2 * fine * fine), (fine, 2 * fine))
    target = (row // parts) * 2 * rows + column // parts
    share = np.repeat(panorama_solid_angles(fine)[:, 0].astype(np.float64), 2 * fine)
    uv = np.stack([(column + 0.5) / (2 * fine), (row + 0.5) / fine], axis=-1)
    face, across, down = direction_to_face(uv_to_direction(uv))
    x, y = ((t + 1) / 2 * size - 0.5 for t in (across, down))
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    area = np.tile(cube_solid_angles(size).reshape(-1), 6)
    overlap = _Overlap.of(
        (
            (target, texel_index(face, left + i, top + j, size=size), share * wide * high)
            for i, wide in ((0, 1 - (x - left)), (1, x - left))
            for j, high in ((0, 1 - (y - top)), (1, y - top))
        ),
        len(area),
    ).balanced(np.repeat(panorama_solid_angles(rows)[:, 0].astype(np.float64), 2 * rows), area)
    return _sparse(overlap.target, overlap.source, overlap.shared, 2 * rows * rows)


def _pixel_groups(rows: int) -> tuple[Int[np.ndarray, "h w"], Float[np.ndarray, " g"]]:
    """Return the group of each pixel, numbered row by row, and the groups' solid angles."""
    columns = np.arange(2 * rows)
    sine = np.sin((np.arange(rows) + 0.5) / rows * np.pi)
    wanted = np.where(sine < 0.5, 4 * np.ceil(rows * sine / 2), 2 * rows).astype(
        int
    )  # multiples of four: rotations by 90 degrees keep them
    within = columns * wanted[:, None] // (2 * rows)  # [h w]
    group = within + (np.cumsum(wanted) - wanted)[:, None]
    solid_angle = np.repeat(panorama_solid_angles(rows)[:, 0].astype(np.float64), 2 * rows)
    return group, np.bincount(group.reshape(-1), solid_angle)


def _sparse(
    target: Int[np.ndarray, " m"], source: Int[np.ndarray, " m"], shared: Float[np.ndarray, " m"], targets: int
) -> SparseMap:
    starts = np.searchsorted(target, np.arange(targets + 1)).astype(np.int64)
    weights = shared / np.bincount(target, shared, targets)[target]
    return SparseMap(starts, source.astype(np.int32), weights.astype(np.float32))
