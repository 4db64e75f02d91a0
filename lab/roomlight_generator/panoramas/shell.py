"""The shell of a room around a panorama's centre: floor, walls and ceiling, all of them seen from the centre.

World frame: y up, metres; the floor is at y = 0, the panorama's centre above the origin. Triangles face the room.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float

from roomlight_generator.panoramas.kernels import shell_views
from roomlight_generator.panoramas.kernels.shell_views import ShellArrays

CENTRE_M: Final = (1.2, 1.7)
"""Range of the centre's height: a tripod's."""
SIDE_M: Final = (1.2, 3.5)
"""Range of the distances of the walls."""
HALL_SHARE: Final = 1 / 7
"""Share of the rooms that are halls: with walls twice as far, and higher."""

_ABOVE_M: Final = (0.9, 1.6)
_HALL_ABOVE_M: Final = (2.0, 4.0)
"""Range of the ceiling's height above the centre."""
_SHAPES: Final = ("box", "corner", "slope", "gable")
_SHAPE_SHARES: Final = (0.55, 0.2, 0.12, 0.13)
_NODE_M: Final = (0.1, 0.25)
_NODES: Final = (3000, 1500)
"""Distance of a light map's nodes, and about how many there are at most (larger faces have coarser maps): on the floor,
and on all other faces together. Contact shadows are on the floor."""
CELL_M: Final = 0.1
"""Squares of the walkable floor."""
_WALL_M: Final = 0.32
"""Distance from the walls in which the camera does not walk."""


@dataclass(frozen=True, eq=False)
class PanoramaShell:
    """A shell: its triangles, the panorama's centre, its plan and facts.

    Attributes:
        centre: where the panorama was taken.
        plan: corners (x, z) of the floor.
        lowest_m: the ceiling's least height.
        reach_m: how far from the centre the camera walks.
    """

    arrays: ShellArrays
    centre: Float[np.ndarray, "3"]
    plan: Float[np.ndarray, "n 2"]
    lowest_m: float
    reach_m: float
    facts: dict[str, Any]

    @property
    def nodes(self) -> int:
        """Number of nodes of all light maps."""
        return int((self.arrays.shape[:, 0] * self.arrays.shape[:, 1]).sum())

    def distances(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        """Return the distance in metres along each ray to the shell."""
        out = np.empty(len(origins), np.float32)
        begin, along = (np.ascontiguousarray(part, np.float32) for part in (origins, directions))
        shell_views.distances(self.arrays, begin, along, out)
        return out

    def walkable(self) -> tuple[Bool[np.ndarray, "nz nx"], Float[np.ndarray, "nz nx 2"]]:
        """Return the squares where a camera can be, near the centre and off the walls, and their middles (x, z)."""
        low, high = self.plan.min(axis=0), self.plan.max(axis=0)
        columns, rows = (np.floor((high - low) / CELL_M).astype(int) + 1).tolist()
        x, z = low[0] + CELL_M * np.arange(columns), low[1] + CELL_M * np.arange(rows)
        points = np.stack(np.meshgrid(x, z), axis=-1)
        near = np.hypot(points[..., 0], points[..., 1]) <= self.reach_m
        return inside_plan(points, self.plan, _WALL_M) & near, points


def draw_shell(rng: np.random.Generator) -> PanoramaShell:
    """Draw a shell at random: a box, a box without a corner, or a room with a sloped ceiling or a gable."""
    hall = rng.random() < HALL_SHARE
    size = 2.0 if hall else 1.0
    west, east, north, south = (size * rng.uniform(*SIDE_M, 4)).tolist()
    height = float(rng.uniform(*CENTRE_M))
    above = float(rng.uniform(*(_HALL_ABOVE_M if hall else _ABOVE_M)))
    shape = str(rng.choice(_SHAPES, p=_SHAPE_SHARES))
    plan = np.array([[-west, -north], [east, -north], [east, south], [-west, south]])
    if shape == "corner":
        cut_x, cut_z = rng.uniform(0.45, 0.8, 2) * [east, south]
        plan = np.array([
            [-west, -north], [east, -north], [east, cut_z], [cut_x, cut_z], [cut_x, south], [-west, south]
        ])  # fmt: skip
    lowest = height + above
    if shape in ("box", "corner"):
        polygons = _flat_room(plan, lowest)
    else:
        rise = float(rng.uniform(0.5, 1.6)) * size
        lowest = height + max(0.45, above - 0.5 * rise)
        polygons = _sloped_room(
            plan, lowest, lowest + rise, gable=shape == "gable", ridge=float(rng.uniform(0.35, 0.65))
        )
    top = max(float(polygon[:, 1].max()) for polygon in polygons)
    facts = {
        "shape": shape,
        "hall": hall,
        "centre_m": round(height, 3),
        "size_m": [round(value, 2) for value in (west + east, top, north + south)],
    }
    centre = np.array([0.0, height, 0.0])
    return PanoramaShell(_arrays(polygons, centre), centre, plan, lowest, 1.1 * size, facts)


def _flat_room(plan: Float[np.ndarray, "n 2"], top_m: float) -> list[Float[np.ndarray, "_ 3"]]:
    """Return floor, ceiling and walls of a room with a level ceiling; a notched plan is cut into two rectangles."""
    parts = [plan]
    if len(plan) != 4:
        parts = [_rectangle(plan[0], plan[2]), _rectangle([plan[0, 0], plan[2, 1]], plan[4])]
    levels = [_lifted(part, level) for part in parts for level in (0.0, top_m)]
    following = np.roll(plan, -1, axis=0)
    walls = [
        np.array([[a[0], 0, a[1]], [b[0], 0, b[1]], [b[0], top_m, b[1]], [a[0], top_m, a[1]]])
        for a, b in zip(plan, following, strict=True)
    ]
    return levels + walls


def _rectangle(low: Any, high: Any) -> Float[np.ndarray, "4 2"]:
    return np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])


def _lifted(plan: Float[np.ndarray, "n 2"], y: float) -> Float[np.ndarray, "n 3"]:
    return np.stack([plan[:, 0], np.full(len(plan), y), plan[:, 1]], axis=1)


def _sloped_room(
    plan: Float[np.ndarray, "4 2"], eaves_m: float, top_m: float, *, gable: bool, ridge: float
) -> list[Float[np.ndarray, "_ 3"]]:
    """Return a room whose ceiling rises along x to `top_m`: to the far wall, or to a ridge at a share of the width."""
    (west, north), (east, south) = plan[0], plan[2]
    middle = west + ridge * (east - west)
    profile = [(west, eaves_m), (middle, top_m), (east, eaves_m)] if gable else [(west, eaves_m), (east, top_m)]
    ceilings = [
        np.array([[x0, y0, north], [x1, y1, north], [x1, y1, south], [x0, y0, south]])
        for (x0, y0), (x1, y1) in pairwise(profile)
    ]
    ends = [np.array([[west, 0.0, z], *([x, y, z] for x, y in profile), [east, 0.0, z]]) for z in (north, south)]
    sides = [
        np.array([[x, 0.0, north], [x, 0.0, south], [x, y, south], [x, y, north]]) for x, y in (profile[0], profile[-1])
    ]
    return [_lifted(plan, 0.0), *ceilings, *ends, *sides]


def _arrays(polygons: list[Float[np.ndarray, "_ 3"]], centre: Float[np.ndarray, "3"]) -> ShellArrays:
    """Triangulate convex planar polygons, turn them to the centre, and lay out their light maps."""
    corners, edges, normals, faces = [], [], [], []
    origins, axes, extents = [], [], []
    for number, polygon in enumerate(polygons):
        first = polygon[1] - polygon[0]
        normal = np.cross(first, polygon[2] - polygon[0])
        normal /= np.linalg.norm(normal) * np.sign(normal @ (centre - polygon[0]))
        for k in range(1, len(polygon) - 1):
            corners.append(polygon[0])
            edges.append([polygon[k] - polygon[0], polygon[k + 1] - polygon[0]])
            normals.append(normal)
            faces.append(number)
        along = first / np.linalg.norm(first)
        frame = np.stack([along, np.cross(normal, along)])
        flat = (polygon - polygon[0]) @ frame.T
        origins.append(polygon[0] + flat.min(axis=0) @ frame)
        axes.append(frame)
        extents.append(flat.max(axis=0) - flat.min(axis=0))
    extent = np.array(extents)
    area = extent.prod(axis=1)
    level = np.array([float(np.ptp(polygon[:, 1])) + float(polygon[0, 1]) < 1e-6 for polygon in polygons])
    spacing = np.where(level, *(
        max(least, float(np.sqrt(area[part].sum() / most)))
        for least, most, part in zip(_NODE_M, _NODES, (level, ~level), strict=True)
    ))  # fmt: skip
    shape = (np.ceil(extent[:, ::-1] / spacing[:, None]).astype(np.int32) + 1).clip(2)
    start = np.concatenate([[0], np.cumsum(shape.prod(axis=1))[:-1]]).astype(np.int32)
    return ShellArrays(
        np.array(corners, np.float64),
        np.array(edges, np.float64),
        np.array(normals, np.float64),
        np.array(faces, np.int32),
        np.array(origins, np.float64),
        np.array(axes, np.float64),
        np.ascontiguousarray(shape),
        start,
        spacing,
    )


def inside_plan(
    points: Float[np.ndarray, "*shape 2"], plan: Float[np.ndarray, "n 2"], margin_m: float
) -> Bool[np.ndarray, "*shape"]:
    """Return which points are in a plan and farther than a margin from its walls; walls follow the axes."""
    inside = np.zeros(points.shape[:-1], bool)
    clear = np.ones(points.shape[:-1], bool)
    for a, b in zip(plan, np.roll(plan, -1, axis=0), strict=True):
        low, high = np.minimum(a, b), np.maximum(a, b)
        off = np.maximum(np.maximum(low - points, points - high), 0)
        clear &= np.hypot(off[..., 0], off[..., 1]) >= margin_m
        if a[0] == b[0]:  # even-odd rule along x
            inside ^= (points[..., 1] >= low[1]) & (points[..., 1] < high[1]) & (points[..., 0] < a[0])
    return inside & clear
