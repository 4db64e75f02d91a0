"""Free floor: a grid of the positions where a person can walk.

Plan coordinates (x, z), metres. Rows of the grid go along z, columns along x.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float

from roomlight_generator.rooms.plan import Placement, Shell, inside_outline
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.shell_bodies import shell_bodies

OBSTACLE_HEIGHTS_M: Final = (0.05, 1.9)
"""Height range of obstacles: anything within it blocks a person. Rugs and lamps overhead do not."""


@dataclass(frozen=True, eq=False)
class FreeFloor:
    """free[row, column] says whether a person may stand with their centre at origin + cell_m * (column, row)."""

    free: Bool[np.ndarray, "rows columns"]
    origin: tuple[float, float]
    cell_m: float

    def points(self) -> Float[np.ndarray, "n 2"]:
        """Return the plan points (x, z) of all free cells."""
        rows, columns = np.nonzero(self.free)
        return np.stack([self.origin[0] + self.cell_m * columns, self.origin[1] + self.cell_m * rows], 1)

    def area_m2(self) -> float:
        """Return the area of the free cells."""
        return float(self.free.sum()) * self.cell_m**2

    def largest(self) -> "FreeFloor":
        """Return the largest connected region (4-neighbourhood)."""
        if not self.free.any():
            return self
        _, labels, stats, _ = cv2.connectedComponentsWithStats(self.free.astype(np.uint8), connectivity=4)
        return replace(self, free=labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax()))

    def swept_m2(self, radius_m: float) -> float:
        """Return the area that a disc covers when its centre visits all free cells."""
        steps = math.ceil(radius_m / self.cell_m)
        padded = np.pad(self.free.astype(np.uint8), steps)
        return float(cv2.dilate(padded, disc(radius_m / self.cell_m)).sum()) * self.cell_m**2


def disc(radius_cells: float) -> np.ndarray:
    """Return a filled circle as a structuring element."""
    reach = math.ceil(radius_cells)
    along = np.arange(-reach, reach + 1)
    return (along[:, None] ** 2 + along[None, :] ** 2 <= radius_cells**2).astype(np.uint8)


def bare_floor(shell: Shell, *, radius_m: float, cell_m: float = 0.1) -> FreeFloor:
    """Return the positions free for the centre of a disc in the unfurnished room: inside, radius_m from every wall."""
    low, high = shell.polygon.min(0), shell.polygon.max(0)
    columns, rows = (int(n) for n in np.floor((high - low) / cell_m) + 1)
    x, z = np.meshgrid(float(low[0]) + cell_m * np.arange(columns), float(low[1]) + cell_m * np.arange(rows))
    inside, nearest = inside_outline(shell.polygon, x, z)
    head = np.full(x.shape, True)
    for normal, d in shell.slopes:
        head &= (d - normal[0] * x - normal[2] * z) / normal[1] >= OBSTACLE_HEIGHTS_M[1]
    return FreeFloor(inside & (nearest >= radius_m**2) & head, (float(low[0]), float(low[1])), cell_m)


def cells_near(floor: FreeFloor, body: Body, radius_m: float) -> tuple[slice, slice, Bool[np.ndarray, "r c"]]:
    """Return rows and columns of the grid near a body, and which of their cells are within radius_m of it."""
    reach = body.reach + radius_m + floor.cell_m
    rows, columns = floor.free.shape
    first_column = min(max(math.floor((body.x - reach - floor.origin[0]) / floor.cell_m), 0), columns)
    last_column = min(max(math.ceil((body.x + reach - floor.origin[0]) / floor.cell_m) + 1, first_column), columns)
    first_row = min(max(math.floor((body.z - reach - floor.origin[1]) / floor.cell_m), 0), rows)
    last_row = min(max(math.ceil((body.z + reach - floor.origin[1]) / floor.cell_m) + 1, first_row), rows)
    dx = floor.origin[0] + floor.cell_m * np.arange(first_column, last_column) - body.x
    dz = (floor.origin[1] + floor.cell_m * np.arange(first_row, last_row) - body.z)[:, None]
    right = np.maximum(np.abs(dx * body.cosine - dz * body.sine) - body.half_width, 0)
    front = np.maximum(np.abs(dx * body.sine + dz * body.cosine) - body.half_depth, 0)
    near = right * right + front * front < radius_m * radius_m
    return slice(first_row, last_row), slice(first_column, last_column), near


def is_obstacle(body: Body) -> bool:
    """Return whether the body lies within the height range of obstacles."""
    return body.low < OBSTACLE_HEIGHTS_M[1] and body.high > OBSTACLE_HEIGHTS_M[0]


def free_floor(shell: Shell, placements: Iterable[Placement], *, radius_m: float, cell_m: float = 0.1) -> FreeFloor:
    """Return where the centre of a person of that radius may be, all regions of it (see `FreeFloor.largest`).

    Placements between 0.05 and 1.9 m of height are obstacles, and so are curtains and open doors of the shell, walls,
    and slanted ceilings lower than 1.9 m.
    """
    floor = bare_floor(shell, radius_m=radius_m, cell_m=cell_m)
    free = floor.free.copy()
    for body in [*shell_bodies(shell), *map(Body.placed, placements)]:
        if is_obstacle(body):
            rows, columns, near = cells_near(floor, body, radius_m)
            free[rows, columns] &= ~near
    return replace(floor, free=free)
