"""A room while it is being furnished: what stands where, what must stay free, and what may still be put.

Plan coordinates (x, z), metres; heights over the floor. Five layers: "floor" furniture, things on "top" of it, things
on a "wall" or the "ceiling", and "flat" rugs. Bodies of all layers but rugs keep clear of each other; zones (a door's
swing, the view from a window, the floor before a wardrobe) keep out the layers they name.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, TypeVar

import cv2
import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.plan import Gap, Placement, Shell, Wall
from roomlight_generator.rooms.planner.body import Body, Segment, within
from roomlight_generator.rooms.planner.chooser import Chooser
from roomlight_generator.rooms.planner.free_floor import bare_floor, disc, in_the_way, shadow
from roomlight_generator.rooms.planner.shell_bodies import shell_bodies
from roomlight_generator.rooms.shapes import Number

Thing = TypeVar("Thing")

Layer = Literal["floor", "top", "wall", "ceiling", "flat"]

STANDING: Final[frozenset[Layer]] = frozenset({"floor"})
LEANING: Final[frozenset[Layer]] = frozenset({"floor", "wall"})
EVERYTHING: Final[frozenset[Layer]] = frozenset({"floor", "top", "wall", "ceiling", "flat"})

COUNTED: Final[frozenset[Layer]] = frozenset({"floor", "wall", "ceiling"})
"""Layers that may stand in a walker's way; things on tops are over what does already."""

BODY_RADIUS_M: Final = 0.25
"""Of whoever walks through the room with a phone."""

FREE_SHARE: Final = 0.32
"""Of the floor, that a walking body can sweep in one piece; a little above the 0.3 that is promised, for the grid."""

REACHED_SHARE: Final = 0.75
"""Of all places free for a walking body, that lie in that one piece: no pockets shut off by furniture."""

DOORSTEP_M: Final = 0.35
"""How far inside a door somebody who came in stands."""

UNDER_CEILING_M: Final = 0.005

SILL_M: Final = 0.06
"""Of a window's sill below its hole."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A placement with the space that it takes up."""

    placement: Placement
    body: Body
    layer: Layer

    @property
    def role(self) -> str:
        """What it is for."""
        return self.placement.model.role

    @property
    def model(self) -> FurnitureModel:
        """Its model."""
        return self.placement.model

    @property
    def degrees(self) -> float:
        """Its turn."""
        return self.placement.degrees


@dataclass(frozen=True, eq=False)
class Zone:
    """Space that the named layers keep out of."""

    body: Body
    bars: frozenset[Layer]


@dataclass(frozen=True)
class Mark:
    """A state of the layout to go back to."""

    pieces: int
    zones: int
    tables: int


@dataclass(eq=False)
class Layout:
    """Pieces put so far. `clutter` from 0 (bare) to 1 (crowded) scales how many small things are put."""

    shell: Shell
    catalogue: Chooser
    rng: np.random.Generator
    split: Split
    clutter: float = 0.5
    pieces: list[Piece] = field(default_factory=list[Piece])
    zones: list[Zone] = field(default_factory=list[Zone])
    tables: list[Piece] = field(default_factory=list[Piece])
    """Tables that people sit at: lamps may hang low over them."""

    def __post_init__(self) -> None:
        """Measures the empty room."""
        polygon = self.shell.polygon
        self.outline: list[Segment] = [
            (float(x0), float(z0), float(x1), float(z1))
            for (x0, z0), (x1, z1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True)
        ]
        self.area_m2 = abs(sum(x0 * z1 - x1 * z0 for x0, z0, x1, z1 in self.outline)) / 2
        self.fixed: list[Body] = shell_bodies(self.shell)
        self.floor = bare_floor(self.shell, radius_m=BODY_RADIUS_M)
        self._taken = np.zeros(self.floor.free.shape, np.int16)
        for body in filter(in_the_way, self.fixed):
            self._count(body, 1)
        self._disc = disc(BODY_RADIUS_M / self.floor.cell_m)
        self._doorsteps: list[tuple[int, int]] = []
        self._mark_gaps()
        self._doorsteps = self._open_doorsteps()
        free = replace(self.floor, free=self.free())
        # An open door's leaf may shut off a part of the empty room already.
        # Under low slopes nobody walks: such a room keeps most of what it has.
        self._free_m2 = min(FREE_SHARE * self.area_m2, 0.7 * free.largest().swept_m2(BODY_RADIUS_M))
        self._reached_share = min(REACHED_SHARE, 0.9 * free.largest().area_m2() / max(free.area_m2(), 1e-9))

    # Chance

    def chance(self, probability: float) -> bool:
        """Whether something of that probability happens."""
        return bool(self.rng.random() < probability)

    def between(self, low: Number, high: Number) -> float:
        """A number of that range, evenly; `low` where the range is empty."""
        return float(self.rng.uniform(low, high)) if high > low else float(low)

    def wobble(self, degrees: Number) -> float:
        """A small turn, normally distributed, cut off at twice its deviation."""
        return float(np.clip(self.rng.normal(0.0, degrees), -2 * degrees, 2 * degrees))

    def count(self, mean: float) -> int:
        """A whole number around that mean."""
        return int(self.rng.poisson(max(mean, 0.0)))

    def shuffled(self, things: Sequence[Thing]) -> list[Thing]:
        """The same things in another order."""
        return [things[int(place)] for place in self.rng.permutation(len(things))]

    # Choosing

    def pick(
        self,
        role: str,
        *,
        width: tuple[float, float] = (0.0, 99.0),
        height: tuple[float, float] = (0.0, 99.0),
        depth: tuple[float, float] = (0.0, 99.0),
        also: Callable[[FurnitureModel], bool] | None = None,
    ) -> FurnitureModel | None:
        """A model of that role whose sizes lie in the ranges (metres); None where there is none."""

        def fits(model: FurnitureModel) -> bool:
            return (
                width[0] <= model.width_m <= width[1]
                and height[0] <= model.height_m <= height[1]
                and depth[0] <= model.depth_m <= depth[1]
                and (also is None or also(model))
            )

        return self.catalogue.choose(role, self.split, self.rng, fits=fits)

    # Putting

    def inside(self, body: Body) -> bool:
        """Whether the body is within the room's walls and under its ceiling."""
        if not within(body.x, body.z, self.outline) or body.crosses(self.outline):
            return False
        if body.high > self.shell.height_m + 0.001:
            return False
        return not self.shell.slopes or all(body.high <= self.shell.ceiling_at(x, z) + 0.001 for x, z in body.corners())

    def admits(self, body: Body, layer: Layer, *, ignore: Iterable[Body] = ()) -> bool:
        """Whether a body of that layer may be there: inside, clear of all others (but those ignored) and of zones."""
        for zone in self.zones:
            if layer in zone.bars and body.overlaps(zone.body):
                return False
        skip = {id(one) for one in ignore}
        for piece in self.pieces:
            if (
                (piece.layer == "flat") == (layer == "flat")
                and id(piece.body) not in skip
                and body.overlaps(piece.body)
            ):
                return False
        return not any(body.overlaps(one) for one in self.fixed) and self.inside(body)

    def put(
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
        """Puts a model there if the place admits it and people can still walk; None where not (or without a model)."""
        if model is None:
            return None
        placement = Placement(model=model, x=float(x), y=float(y), z=float(z), degrees=float(degrees))
        body = Body.placed(placement)
        if not self.admits(body, layer, ignore=ignore):
            return None
        if layer in COUNTED and in_the_way(body):
            self._count(body, 1)
            if not self.walkable():
                self._count(body, -1)
                return None
        piece = Piece(placement, body, layer)
        self.pieces.append(piece)
        return piece

    def keep_free(self, body: Body, bars: frozenset[Layer] = STANDING) -> bool:
        """Keeps the named layers out of a space from now on, unless something stands there already or a wall does."""
        if body.crosses(self.outline) or any(one.overlaps(body) for one in self.fixed):
            return False
        if any(piece.layer in bars and piece.body.overlaps(body) for piece in self.pieces):
            return False
        self.zones.append(Zone(body, bars))
        return True

    def mark(self) -> Mark:
        """The state now."""
        return Mark(len(self.pieces), len(self.zones), len(self.tables))

    def back_to(self, mark: Mark) -> None:
        """Takes away whatever was put since."""
        for piece in self.pieces[mark.pieces :]:
            if piece.layer in COUNTED and in_the_way(piece.body):
                self._count(piece.body, -1)
        del self.pieces[mark.pieces :], self.zones[mark.zones :], self.tables[mark.tables :]

    def having(self, *roles: str) -> list[Piece]:
        """The pieces of those roles."""
        return [piece for piece in self.pieces if piece.role in roles]

    # Walking

    def free(self) -> np.ndarray:
        """Which cells of `floor` a walking body's middle may be in now."""
        return self.floor.free & (self._taken == 0)

    def walkable(self) -> bool:
        """Whether enough floor is free in one piece, and every door opens on it."""
        free = self.free().astype(np.uint8)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(free, connectivity=4)
        if count < 2:
            return False
        sizes = stats[1:, cv2.CC_STAT_AREA]
        main = 1 + int(sizes.argmax())
        if sizes.max() < self._reached_share * sizes.sum():
            return False
        region = (labels == main).astype(np.uint8)
        if any(not region[row, column] for row, column in self._doorsteps):
            return False
        swept = cv2.dilate(np.pad(region, 3), self._disc).sum() * self.floor.cell_m**2
        return bool(swept >= self._free_m2)

    def _count(self, body: Body, by: int) -> None:
        rows, columns, near = shadow(self.floor, body, BODY_RADIUS_M)
        self._taken[rows, columns] += np.int16(by) * near

    def _open_doorsteps(self) -> list[tuple[int, int]]:
        """IrradianceCache just inside the doors, of those that the empty room leaves free."""
        steps: list[tuple[int, int]] = []
        region = replace(self.floor, free=self.free()).largest().free
        for wall in self.shell.walls:
            for gap in wall.gaps:
                if gap.kind not in ("door", "passage"):
                    continue
                x, z = wall.at((gap.start_m + gap.end_m) / 2, DOORSTEP_M)
                row = round((float(z) - self.floor.origin[1]) / self.floor.cell_m)
                column = round((float(x) - self.floor.origin[0]) / self.floor.cell_m)
                if 0 <= row < region.shape[0] and 0 <= column < region.shape[1] and region[row, column]:
                    steps.append((row, column))
        return steps

    def _mark_gaps(self) -> None:
        for wall in self.shell.walls:
            for gap in wall.gaps:
                if gap.kind in ("door", "passage"):
                    depth = max(gap.keep_clear_m, 0.6)
                    self.zones.append(Zone(_before(wall, gap, depth, low=0.0, grow=0.1), EVERYTHING))
                elif gap.covered:
                    self.zones.append(Zone(_before(wall, gap, 0.3, low=gap.bottom_m, grow=0.1), EVERYTHING))
                else:
                    self.zones.append(Zone(_before(wall, gap, 0.4, low=gap.bottom_m - SILL_M), LEANING))
                if gap.kind in ("window", "niche") and gap.keep_clear_m > 0:
                    self.zones.append(Zone(_before(wall, gap, gap.keep_clear_m, low=0.0), EVERYTHING))


def _before(wall: Wall, gap: Gap, depth: float, *, low: float, grow: float = 0.0) -> Body:
    """The space before a gap in a wall."""
    x, z = wall.at((gap.start_m + gap.end_m) / 2, depth / 2)
    width = gap.end_m - gap.start_m + grow
    return Body.of(float(x), float(z), wall.facing_degrees(), width=width, depth=depth, low=low, high=gap.top_m)


def turn_toward(x0: float, z0: float, x1: float, z1: float) -> float:
    """The turn in degrees that makes something at the first plan point face the second."""
    return math.degrees(math.atan2(x1 - x0, z1 - z0))
