"""Where a camera can walk in a room of which only the triangles are known.

The room is the one in which the scene's camera stands, or, without a camera, where most of what lies around a point is
near. Its floor is the lowest large level surface below that point.
"""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float

from roomlight.errors import DatasetError
from roomlight_generator.blender.scene import BlenderRoom, distances
from roomlight_generator.rooms.shapes import sphere_directions
from roomlight_generator.sequences.walk import CLEARANCE_M, FreeSpace

CELL_M: Final = 0.1
REACH_M: Final = 8.0
"""The room is looked for within this distance of the anchor."""
_BODY_M: Final = (0.35, 0.9, 1.3, 1.6)
"""Heights at which the body that walks needs room."""
_ENCLOSED: Final = 0.6
"""Least share of the directions in which a point inside a room sees a surface within `REACH_M`."""
_DOWN: Final = np.array([0.0, -1.0, 0.0], np.float32)
_LEVEL_M: Final = 0.04
"""A floor's unevenness; a carpet lies within it."""
_LEAST_CELLS: Final = 40


def find_floor(room: BlenderRoom) -> tuple[float, FreeSpace]:
    """Return the floor's height in the file's world, and the space above it in a world whose floor is at y = 0.

    Raises:
        DatasetError: no floor of a room is found.
    """
    anchor = _anchor(room)
    floor_y = _floor_height(room, anchor)

    def reach(origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        return distances(room, origins + np.array([0, floor_y, 0], np.float32), directions)

    steps = np.arange(-REACH_M, REACH_M, CELL_M)
    x, z = np.meshgrid(anchor[0] + steps, anchor[2] + steps)
    clear, cells = _clear_floor(
        FreeSpace(np.ones(x.shape, bool), (float(x[0, 0]), float(z[0, 0])), CELL_M, reach), x, z
    )
    walkable = _nearest_region(clear)
    if walkable.sum() < _LEAST_CELLS:
        seen, covered, free = (f"{count * CELL_M**2:.1f} m2" for count in cells)
        raise DatasetError(
            f"{room.path}: too little free floor about ({anchor[0]:.1f}, {-anchor[2]:.1f}) metres in Blender's plan: "
            f"{seen} is seen from {_BODY_M[-1]:g} m above, {covered} of that has a ceiling within {REACH_M:g} m, and "
            f"{free} of that room for a body, but {_LEAST_CELLS * CELL_M**2:.1f} m2 in a piece is needed; put the "
            f"scene's camera into the room, above free floor, or check the scene's unit scale ({room.unit_m:g} m)"
        )
    return floor_y, FreeSpace(walkable, (float(x[0, 0]), float(z[0, 0])), CELL_M, reach)


def _anchor(room: BlenderRoom) -> Float[np.ndarray, "3"]:
    """Return the camera's place if it is inside a room, else the place of a grid that is most enclosed and freest."""
    fan = sphere_directions(128)
    low, high = np.percentile(room.vertices, [2, 98], axis=0)
    count = np.clip(((high - low) / 0.7).astype(int), 1, (20, 4, 20))
    axes = [np.linspace(a, b, n + 2)[1:-1] for a, b, n in zip(low, high, count, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points = grid if room.anchor is None else np.concatenate([room.anchor[None], grid])
    reach = distances(room, np.repeat(points, len(fan), axis=0), np.tile(fan, (len(points), 1))).reshape(
        len(points), -1
    )
    enclosed = (reach < REACH_M).mean(axis=1)
    if room.anchor is not None and enclosed[0] >= _ENCLOSED:
        return room.anchor
    if enclosed.max() < _ENCLOSED:
        raise DatasetError(
            f"{room.path}: no point is inside a room: at most {enclosed.max():.0%} of the directions meet a surface "
            f"within {REACH_M:g} m; close the room's walls, or check the scene's unit scale ({room.unit_m:g} m)"
        )
    score = np.where(enclosed >= _ENCLOSED, np.minimum(reach, REACH_M).min(axis=1), -1)
    return points[int(score.argmax())]


def _floor_height(room: BlenderRoom, anchor: Float[np.ndarray, "3"]) -> float:
    """Return the height of the lowest of the level surfaces that rays from places in the anchor's sight often meet."""
    offsets = np.random.default_rng(0).uniform(-1.5, 1.5, (400, 3)) * [1, 0, 1]
    away = np.linalg.norm(offsets, axis=1)
    offsets = offsets[distances(room, np.tile(anchor, (len(offsets), 1)), offsets / away[:, None]) > away]
    down_m = distances(room, anchor + offsets, np.tile(_DOWN, (len(offsets), 1)))
    heights = anchor[1] - down_m[np.isfinite(down_m)]
    if len(heights) == 0:
        raise DatasetError(f"{room.path}: nothing lies below its camera; put the camera above the room's floor")
    layers, counts = np.unique(np.round(heights / _LEVEL_M).astype(int), return_counts=True)
    often = layers[counts >= 0.08 * len(heights)]
    lowest = (often if len(often) else layers).min() * _LEVEL_M
    return float(np.median(heights[np.abs(heights - lowest) <= _LEVEL_M]))


def _clear_floor(
    free: FreeSpace, x: Float[np.ndarray, "n m"], z: Float[np.ndarray, "n m"]
) -> tuple[Bool[np.ndarray, "n m"], list[int]]:
    """Return the cells with bare floor below them, a ceiling above and room for a body, and how many pass each test."""
    count = x.size
    eyes = np.stack([x.ravel(), np.full(count, _BODY_M[-1]), z.ravel()], axis=1).astype(np.float32)
    down_m = free.distances(eyes, np.tile(_DOWN, (count, 1)))
    walkable = np.abs(down_m - _BODY_M[-1]) <= _LEVEL_M
    counts = [int(walkable.sum())]
    walkable[walkable] = free.distances(eyes[walkable], np.tile(-_DOWN, (counts[0], 1))) < REACH_M
    counts.append(int(walkable.sum()))
    for height in _BODY_M:
        places = np.flatnonzero(walkable)
        eyes[:, 1] = height
        walkable[places] = free.clear(eyes[places], CLEARANCE_M, rays=64)
    return walkable.reshape(x.shape), [*counts, int(walkable.sum())]


def _nearest_region(walkable: Bool[np.ndarray, "n m"]) -> Bool[np.ndarray, "n m"]:
    """Return the connected region nearest to the middle, of those that are large enough for a walk."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(walkable.astype(np.uint8), connectivity=4)
    middle = (np.array(walkable.shape) - 1) / 2
    away = np.hypot(*(np.indices(walkable.shape) - middle[:, None, None]))
    large = [label for label in range(1, count) if stats[label, cv2.CC_STAT_AREA] >= _LEAST_CELLS]
    if not large:
        return np.zeros_like(walkable)
    return np.asarray(labels == min(large, key=lambda label: float(away[labels == label].min())))
