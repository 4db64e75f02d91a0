"""The plan of a room's shell: floor, walls and ceiling as the furniture planner sees them.

World frame, metres, floor at y = 0. Plan coordinates are (x, z).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.scene import Item, Opening


@dataclass(frozen=True, eq=False)
class Gap:
    """An opening in a wall: from start_m to end_m along the wall, bottom_m to top_m above the floor.

    A window with a sill has bottom_m > 0: low furniture may stand below it.

    Attributes:
        keep_clear_m: Depth of floor in front of it that must stay free (a door's swing, a walkway).
        covered: Curtains or blinds hang in front of it, so nothing may hang or lean there.
    """

    kind: Literal["window", "door", "passage", "niche"]
    start_m: float
    end_m: float
    bottom_m: float
    top_m: float
    keep_clear_m: float = 0.0
    covered: bool = False


@dataclass(frozen=True, eq=False)
class Wall:
    """A straight inner wall.

    Seen from inside, start is at the left and end at the right: (end - start) / length = (inward_z, -inward_x).

    Attributes:
        inward: Unit normal into the room.
        height_m: Minimum height along it; slanted ceilings make it lower than the room's.
    """

    start: Float[np.ndarray, "2"]
    end: Float[np.ndarray, "2"]
    inward: Float[np.ndarray, "2"]
    height_m: float
    gaps: tuple[Gap, ...] = ()

    @property
    def length_m(self) -> float:
        """Length of the wall."""
        return float(np.linalg.norm(self.end - self.start))

    def at(self, along_m: float, away_m: float = 0.0) -> tuple[float, float]:
        """Return the plan point along_m from the wall's start and away_m from the wall into the room."""
        direction = (self.end - self.start) / max(self.length_m, 1e-9)
        x, z = (self.start + along_m * direction + away_m * self.inward).tolist()
        return x, z

    def facing_degrees(self) -> float:
        """Return the rotation (`Mesh.placed`) that puts a model's back to this wall: +z maps to `inward`."""
        return float(np.degrees(np.arctan2(self.inward[0], self.inward[1])))


@dataclass(frozen=True, eq=False)
class Shell:
    """A room without furniture.

    Attributes:
        items: Walls, floor, ceiling, frames, doors, curtains, part of a second room.
        polygon: Floor outline of the main room, clockwise seen from above (x to the right, z down the page).
        walls: A wall for each side of the polygon, in the same order.
        height_m: Height of the flat ceiling; `ceiling_at` gives the height at any point.
        spots: Free plan points (x, z, free radius) in a second room or corridor visible through an open door, each with
            space for one piece of furniture.
    """

    items: tuple[Item, ...]
    openings: tuple[Opening, ...]
    polygon: Float[np.ndarray, "n 2"]
    walls: tuple[Wall, ...]
    height_m: float
    slopes: tuple[tuple[Float[np.ndarray, "3"], float], ...] = ()
    spots: tuple[tuple[float, float, float], ...] = ()

    def ceiling_at(self, x: float, z: float) -> float:
        """Return the ceiling height over a plan point: the minimum of the flat ceiling and of each slope n . (x, y,
        z) = d."""
        heights = [(d - n[0] * x - n[2] * z) / n[1] for n, d in self.slopes]
        return float(min([self.height_m, *heights]))

    def contains(self, x: float, z: float, margin_m: float = 0.0) -> bool:
        """Return whether the plan point lies inside the polygon, at least margin_m from every wall."""
        inside, squared_m2 = inside_outline(self.polygon, np.array(x, np.float64), np.array(z, np.float64))
        return bool(inside) and float(squared_m2) >= margin_m**2


def inside_outline(
    polygon: Float[np.ndarray, "n 2"], x: Float[np.ndarray, "*shape"], z: Float[np.ndarray, "*shape"]
) -> tuple[Bool[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]:
    """Return which plan points lie inside an outline, and their squared distances from it."""
    inside, nearest = np.zeros(np.shape(x), bool), np.full(np.shape(x), np.inf)
    for (x0, z0), (x1, z1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if z0 != z1:
            inside ^= ((z0 > z) != (z1 > z)) & (x < x0 + (z - z0) * (x1 - x0) / (z1 - z0))
        along = ((x - x0) * (x1 - x0) + (z - z0) * (z1 - z0)) / max((x1 - x0) ** 2 + (z1 - z0) ** 2, 1e-12)
        along = np.clip(along, 0, 1)
        np.minimum(nearest, (x - x0 - along * (x1 - x0)) ** 2 + (z - z0 - along * (z1 - z0)) ** 2, out=nearest)
    return inside, nearest


@dataclass(frozen=True, eq=False)
class Placement:
    """A placed model: rotated about y by degrees, its origin moved to (x, y, z)."""

    model: FurnitureModel
    x: float
    y: float
    z: float
    degrees: float

    def item(self) -> Item:
        """Return the item in world coordinates."""
        model = self.model
        mesh = model.mesh.placed(self.x, self.y, self.z, degrees=self.degrees)
        return Item(name=model.name, role=model.role, mesh=mesh, attribution=model.attribution)

    def light_positions(self) -> Float[np.ndarray, "n 3"]:
        """Return the positions of its bulbs, world frame."""
        c, s = np.cos(np.radians(self.degrees)), np.sin(np.radians(self.degrees))
        rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        local = np.array([light.position for light in self.model.lights], np.float64).reshape(-1, 3)
        return local @ rotation.T + np.array([self.x, self.y, self.z])
