"""Arrangement of furniture in a room: placed pieces, reserved zones, and the tests for a new placement.

Plan coordinates (x, z), metres; heights over the floor. Five layers: "floor" furniture, objects on "top" of it, objects
on a "wall" or the "ceiling", and "flat" rugs. Bodies of all layers except rugs must not overlap; zones (a door's swing,
the view from a window, the floor in front of a wardrobe) exclude the layers they name.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, TypeVar

import cv2
import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.furniture import Catalogue
from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.plan import Gap, Placement, Shell, Wall
from roomlight_generator.rooms.planner.body import Body, Segment, contains_point
from roomlight_generator.rooms.planner.free_floor import bare_floor, cells_near, disc, is_obstacle
from roomlight_generator.rooms.planner.shell_bodies import shell_bodies
from roomlight_generator.rooms.shapes import Number

Element = TypeVar("Element")

Snapshot = tuple[int, int, int]
"""Numbers of pieces, zones and tables that `Arrangement.restore` leaves."""

Layer = Literal["floor", "top", "wall", "ceiling", "flat"]

FLOOR_LAYER: Final[frozenset[Layer]] = frozenset({"floor"})
FLOOR_AND_WALL: Final[frozenset[Layer]] = frozenset({"floor", "wall"})
ALL_LAYERS: Final[frozenset[Layer]] = frozenset({"floor", "top", "wall", "ceiling", "flat"})

OBSTACLE_LAYERS: Final[frozenset[Layer]] = frozenset({"floor", "wall", "ceiling"})
"""Layers that can block a person walking; objects on tops stand above furniture that already does."""

WALKER_RADIUS_M: Final = 0.25
"""Radius of a person walking through the room with a phone."""

MIN_FREE_SHARE: Final = 0.32
"""Minimum share of the floor that a walking person can sweep in one connected region; above the guaranteed 0.3
because of the grid."""

MIN_REACHABLE_SHARE: Final = 0.75
"""Minimum share of all cells free for a walking person that must be in that region, so that furniture closes off no
pockets."""

DOORSTEP_M: Final = 0.35
"""Distance from a door to the point inside it that must be reachable."""

UNDER_CEILING_M: Final = 0.005

SILL_M: Final = 0.06
"""Height of a window's sill below its hole."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A placement and the space that it occupies."""

    placement: Placement
    body: Body
    layer: Layer

    @property
    def role(self) -> str:
        """Furniture role of its model."""
        return self.placement.model.role

    @property
    def model(self) -> FurnitureModel:
        """Placed model."""
        return self.placement.model

    @property
    def degrees(self) -> float:
        """Rotation about y in degrees."""
        return self.placement.degrees


@dataclass(frozen=True, eq=False)
class Zone:
    """Space from which the named layers are excluded."""

    body: Body
    excluded_layers: frozenset[Layer]


@dataclass(eq=False)
class Arrangement:
    """Furniture placed so far. `clutter` from 0 (bare) to 1 (crowded) scales the number of small objects."""

    shell: Shell
    catalogue: Catalogue
    rng: np.random.Generator
    split: Split
    clutter: float = 0.5
    pieces: list[Piece] = field(default_factory=list[Piece])
    zones: list[Zone] = field(default_factory=list[Zone])
    tables: list[Piece] = field(default_factory=list[Piece])
    """Tables with seats: lamps may hang low over them."""

    def __post_init__(self) -> None:
        polygon = self.shell.polygon
        self.outline: list[Segment] = [
            (float(x0), float(z0), float(x1), float(z1))
            for (x0, z0), (x1, z1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True)
        ]
        self.area_m2 = abs(sum(x0 * z1 - x1 * z0 for x0, z0, x1, z1 in self.outline)) / 2
        self.fixed: list[Body] = shell_bodies(self.shell)
        self.floor = bare_floor(self.shell, radius_m=WALKER_RADIUS_M)
        self._obstacle_counts = np.zeros(self.floor.free.shape, np.int16)
        for body in filter(is_obstacle, self.fixed):
            self._update_occupancy(body, 1)
        self._disc = disc(WALKER_RADIUS_M / self.floor.cell_m)
        self._doorsteps: list[tuple[int, int]] = []
        self._reserve_gaps()
        self._doorsteps = self._open_doorsteps()
        free = replace(self.floor, free=self.free_cells())
        # An open door's leaf may cut off part of the empty room. People cannot walk under low slopes: such a room must
        # keep most of its walkable area.
        self._min_free_m2 = min(MIN_FREE_SHARE * self.area_m2, 0.7 * free.largest().swept_m2(WALKER_RADIUS_M))
        self._min_reachable_share = min(MIN_REACHABLE_SHARE, 0.9 * free.largest().area_m2() / max(free.area_m2(), 1e-9))

    # Random numbers

    def chance(self, probability: float) -> bool:
        """Return True with the given probability."""
        return bool(self.rng.random() < probability)

    def uniform(self, low: Number, high: Number) -> float:
        """Return a uniform random number from the range; `low` if the range is empty."""
        return float(self.rng.uniform(low, high)) if high > low else float(low)

    def jitter(self, degrees: Number) -> float:
        """Return a small random rotation, normally distributed, clipped at two standard deviations."""
        return float(np.clip(self.rng.normal(0.0, degrees), -2 * degrees, 2 * degrees))

    def poisson(self, mean: float) -> int:
        """Return a Poisson-distributed number with that mean."""
        return int(self.rng.poisson(max(mean, 0.0)))

    def shuffled(self, elements: Sequence[Element]) -> list[Element]:
        """Return the elements in random order."""
        return [elements[int(place)] for place in self.rng.permutation(len(elements))]

    # Choosing models

    def pick(
        self,
        role: str,
        *,
        width: tuple[float, float] = (0.0, 99.0),
        height: tuple[float, float] = (0.0, 99.0),
        depth: tuple[float, float] = (0.0, 99.0),
        also: Callable[[FurnitureModel], bool] | None = None,
    ) -> FurnitureModel | None:
        """Choose a model of that role whose sizes lie in the ranges (metres); None if there is none."""

        def fits(model: FurnitureModel) -> bool:
            return (
                width[0] <= model.width_m <= width[1]
                and height[0] <= model.height_m <= height[1]
                and depth[0] <= model.depth_m <= depth[1]
                and (also is None or also(model))
            )

        return self.catalogue.choose(role, self.split, self.rng, fits=fits)

    # Placing

    def inside(self, body: Body) -> bool:
        """Return whether the body is within the room's walls and under its ceiling."""
        if not contains_point(body.x, body.z, self.outline) or body.crosses(self.outline):
            return False
        if body.high > self.shell.height_m + 0.001:
            return False
        return not self.shell.slopes or all(body.high <= self.shell.ceiling_at(x, z) + 0.001 for x, z in body.corners())

    def fits(self, body: Body, layer: Layer, *, ignore: Iterable[Body] = ()) -> bool:
        """Return whether a body of that layer fits: inside, clear of zones and of bodies that are not ignored."""
        for zone in self.zones:
            if layer in zone.excluded_layers and body.overlaps(zone.body):
                return False
        skip = {id(other) for other in ignore}
        for piece in self.pieces:
            if (
                (piece.layer == "flat") == (layer == "flat")
                and id(piece.body) not in skip
                and body.overlaps(piece.body)
            ):
                return False
        return not any(body.overlaps(other) for other in self.fixed) and self.inside(body)

    def place(
        self,
        model: FurnitureModel | None,
        x: Number,
        z: Number,
        degrees: Number,
        *,
        y: Number = 0.0,
        layer: Layer = "floor",
        ignore: Iterable[Body] = (),
    ) -> Piece | None:
        """Place a model if it fits and the room stays walkable; return None if not (or without a model)."""
        if model is None:
            return None
        placement = Placement(model=model, x=float(x), y=float(y), z=float(z), degrees=float(degrees))
        body = Body.placed(placement)
        if not self.fits(body, layer, ignore=ignore):
            return None
        if layer in OBSTACLE_LAYERS and is_obstacle(body):
            self._update_occupancy(body, 1)
            if not self.walkable():
                self._update_occupancy(body, -1)
                return None
        piece = Piece(placement, body, layer)
        self.pieces.append(piece)
        return piece

    def reserve(self, body: Body, excluded_layers: frozenset[Layer] = FLOOR_LAYER) -> bool:
        """Reserve a space from the named layers; return False if a piece or a wall is already in it."""
        if body.crosses(self.outline) or any(other.overlaps(body) for other in self.fixed):
            return False
        if any(piece.layer in excluded_layers and piece.body.overlaps(body) for piece in self.pieces):
            return False
        self.zones.append(Zone(body, excluded_layers))
        return True

    def snapshot(self) -> Snapshot:
        """Return the current state for `restore`."""
        return len(self.pieces), len(self.zones), len(self.tables)

    def restore(self, snapshot: Snapshot) -> None:
        """Remove everything placed since the snapshot."""
        pieces, zones, tables = snapshot
        for piece in self.pieces[pieces:]:
            if piece.layer in OBSTACLE_LAYERS and is_obstacle(piece.body):
                self._update_occupancy(piece.body, -1)
        del self.pieces[pieces:], self.zones[zones:], self.tables[tables:]

    def with_roles(self, *roles: str) -> list[Piece]:
        """Return the pieces with those roles."""
        return [piece for piece in self.pieces if piece.role in roles]

    # Walking

    def free_cells(self) -> np.ndarray:
        """Return which cells of `floor` the centre of a walking person may occupy now."""
        return self.floor.free & (self._obstacle_counts == 0)

    def walkable(self) -> bool:
        """Return whether enough floor is free in one connected region that every door opens onto."""
        free = self.free_cells().astype(np.uint8)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(free, connectivity=4)
        if count < 2:
            return False
        sizes = stats[1:, cv2.CC_STAT_AREA]
        main = 1 + int(sizes.argmax())
        if sizes.max() < self._min_reachable_share * sizes.sum():
            return False
        region = (labels == main).astype(np.uint8)
        if any(not region[row, column] for row, column in self._doorsteps):
            return False
        swept = cv2.dilate(np.pad(region, 3), self._disc).sum() * self.floor.cell_m**2
        return bool(swept >= self._min_free_m2)

    def _update_occupancy(self, body: Body, by: int) -> None:
        rows, columns, near = cells_near(self.floor, body, WALKER_RADIUS_M)
        self._obstacle_counts[rows, columns] += np.int16(by) * near

    def _open_doorsteps(self) -> list[tuple[int, int]]:
        """Return the cells just inside the doors, if the empty room leaves them free."""
        steps: list[tuple[int, int]] = []
        region = replace(self.floor, free=self.free_cells()).largest().free
        for wall in self.shell.walls:
            for gap in wall.gaps:
                if gap.kind not in ("door", "passage"):
                    continue
                x, z = wall.at((gap.start_m + gap.end_m) / 2, DOORSTEP_M)
                row = round((z - self.floor.origin[1]) / self.floor.cell_m)
                column = round((x - self.floor.origin[0]) / self.floor.cell_m)
                if 0 <= row < region.shape[0] and 0 <= column < region.shape[1] and region[row, column]:
                    steps.append((row, column))
        return steps

    def _reserve_gaps(self) -> None:
        for wall in self.shell.walls:
            for gap in wall.gaps:
                if gap.kind in ("door", "passage"):
                    depth = max(gap.keep_clear_m, 0.6)
                    self.zones.append(Zone(_space_in_front(wall, gap, depth, low=0.0, grow=0.1), ALL_LAYERS))
                elif gap.covered:
                    self.zones.append(Zone(_space_in_front(wall, gap, 0.3, low=gap.bottom_m, grow=0.1), ALL_LAYERS))
                else:
                    self.zones.append(Zone(_space_in_front(wall, gap, 0.4, low=gap.bottom_m - SILL_M), FLOOR_AND_WALL))
                if gap.kind in ("window", "niche") and gap.keep_clear_m > 0:
                    self.zones.append(Zone(_space_in_front(wall, gap, gap.keep_clear_m, low=0.0), ALL_LAYERS))


def _space_in_front(wall: Wall, gap: Gap, depth: float, *, low: float, grow: float = 0.0) -> Body:
    """Return the space in front of a gap in a wall."""
    x, z = wall.at((gap.start_m + gap.end_m) / 2, depth / 2)
    width = gap.end_m - gap.start_m + grow
    return Body.of(x, z, wall.facing_degrees(), width=width, depth=depth, low=low, high=gap.top_m)


def yaw_toward(x0: float, z0: float, x1: float, z1: float) -> float:
    """Return the rotation in degrees that makes an object at the first plan point face the second."""
    return math.degrees(math.atan2(x1 - x0, z1 - z0))
