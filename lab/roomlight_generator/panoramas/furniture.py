"""Furniture in a shell: two to eight pieces along the walls and on the floor, and small things on top of them.

World frame: y up, metres, the floor at y = 0.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from roomlight.dataset.recording import Split
from roomlight_generator.panoramas.shell import PanoramaShell, inside_plan
from roomlight_generator.rooms.furniture import Catalogue
from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.scene import Item, Mesh

PIECES: Final = (2, 8)
"""Range of the number of pieces on the floor."""

_AT_WALLS: Final = {
    "sofa": 3.0, "bed": 1.5, "desk": 2.0, "wardrobe": 1.0, "dresser": 1.5, "bookcase": 2.0, "sideboard": 2.0,
    "tv_stand": 1.0, "nightstand": 1.0, "bench": 1.0, "piano": 0.5, "fridge": 0.3, "kitchen_unit": 0.5,
    "side_table": 1.0, "plant": 1.5, "floor_lamp": 1.5, "armchair": 1.5, "chair": 1.0, "floor_clutter": 1.0,
}  # fmt: skip
_IN_THE_ROOM: Final = {
    "armchair": 3.0, "chair": 3.0, "coffee_table": 3.0, "dining_table": 2.0, "office_chair": 1.0, "stool": 1.0,
    "side_table": 1.5, "plant": 1.5, "floor_lamp": 0.7, "floor_clutter": 1.0, "person": 0.7, "pet": 0.3,
    "floor_toy": 0.5, "sofa": 1.0,
}  # fmt: skip
"""Roles, and how often each is drawn."""
_ON_TOP: Final = ("table_lamp", "small_plant", "vase", "book", "tableware", "laptop", "ornament", "food")
_WALL_SHARE: Final = 0.6
_TOP_SHARE: Final = 0.6
"""Share of the pieces with a level top on which something stands."""
_GAP_M: Final = 0.06
"""Least distance between pieces, and to walls."""
_BODY_M: Final = 0.33
"""The camera keeps this far from furniture."""
_LEAST_CELLS: Final = 25
"""Squares of floor that must stay free for the camera."""
_TRIES: Final = 12
"""Places tried for each piece."""
_MIRROR_ALBEDO: Final = (0.25, 0.25, 0.25)
"""Albedo that replaces mirrors: this renderer does not follow reflections."""


@dataclass(frozen=True, eq=False)
class Footprint:
    """A rectangle on the floor: middle (x, z), half sizes along its own axes, and its unit axis to the right."""

    middle: Float[np.ndarray, "2"]
    half: Float[np.ndarray, "2"]
    right: Float[np.ndarray, "2"]

    def distance(self, points: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape"]:
        """Return the distance of points to the rectangle; 0 inside."""
        front = np.array([-self.right[1], self.right[0]])
        local = np.stack([(points - self.middle) @ self.right, (points - self.middle) @ front], axis=-1)
        return np.linalg.norm(np.maximum(np.abs(local) - self.half, 0), axis=-1)

    def grid(self) -> Float[np.ndarray, "n 2"]:
        """Return points of the rectangle, 0.1 m apart or closer, its corners too."""
        front = np.array([-self.right[1], self.right[0]])
        along, across = (np.linspace(-h, h, int(2 * h / 0.1) + 2) for h in self.half)
        a, b = np.meshgrid(along, across)
        return self.middle + a.reshape(-1, 1) * self.right + b.reshape(-1, 1) * front


@dataclass(frozen=True, eq=False)
class Furniture:
    """Furniture of a room: its items, their rectangles on the floor, and the number of items of each role."""

    items: tuple[Item, ...]
    footprints: tuple[Footprint, ...]

    @property
    def roles(self) -> dict[str, int]:
        """Number of items by role."""
        names = [item.role for item in self.items]
        return {role: names.count(role) for role in sorted(set(names))}


def furnish_shell(shell: PanoramaShell, catalogue: Catalogue, rng: np.random.Generator, *, split: Split) -> Furniture:
    """Draw furniture for a shell; the camera keeps room to walk."""
    items: list[Item] = []
    footprints: list[Footprint] = []
    walkable, points = shell.walkable()
    for _ in range(int(rng.integers(PIECES[0], PIECES[1] + 1))):
        at_wall = bool(rng.random() < _WALL_SHARE)
        roles = _AT_WALLS if at_wall else _IN_THE_ROOM
        chances = np.array(list(roles.values()))
        role = str(rng.choice(list(roles), p=chances / chances.sum()))
        model = catalogue.choose(role, split, rng, fits=lambda candidate: candidate.height_m < shell.lowest_m - 0.1)
        if model is None or model.elevation_m > 0:
            continue
        for _ in range(_TRIES):
            footprint = _at_wall(shell, model, rng) if at_wall else _anywhere(shell, model, rng)
            if _fits(shell, footprint, footprints):
                free = still_free(walkable, points, [*footprints, footprint])
                if free.sum() >= _LEAST_CELLS:
                    footprints.append(footprint)
                    items += _items(model, footprint, catalogue, rng, split)
                    break
    return Furniture(tuple(items), tuple(footprints))


def still_free(
    walkable: Bool[np.ndarray, "nz nx"], points: Float[np.ndarray, "nz nx 2"], footprints: Iterable[Footprint]
) -> Bool[np.ndarray, "nz nx"]:
    """Return the walkable squares (at points) that furniture leaves free."""
    free = walkable.copy()
    for footprint in footprints:
        free &= footprint.distance(points) > _BODY_M
    return free


def _at_wall(shell: PanoramaShell, model: FurnitureModel, rng: np.random.Generator) -> Footprint:
    """Draw a place with the model's back at a wall, longer walls more often."""
    following = np.roll(shell.plan, -1, axis=0)
    lengths = np.linalg.norm(following - shell.plan, axis=1)
    wall = int(rng.choice(len(lengths), p=lengths / lengths.sum()))
    along = (following[wall] - shell.plan[wall]) / lengths[wall]
    inward = np.array([-along[1], along[0]])
    if shell.plan[wall] @ inward > 0:  # the origin is inside
        inward = -inward
    half = np.array([model.width_m, model.depth_m]) / 2
    at = shell.plan[wall] + rng.uniform(0, lengths[wall]) * along
    return Footprint(at + (half[1] + _GAP_M + rng.exponential(0.04)) * inward, half, np.array([inward[1], -inward[0]]))


def _anywhere(shell: PanoramaShell, model: FurnitureModel, rng: np.random.Generator) -> Footprint:
    angle = rng.uniform(0, 2 * np.pi) if rng.random() < 0.5 else rng.integers(4) * np.pi / 2
    place = rng.uniform(shell.plan.min(axis=0), shell.plan.max(axis=0))
    half = np.array([model.width_m, model.depth_m]) / 2
    return Footprint(place, half, np.array([np.cos(angle), np.sin(angle)]))


def _fits(shell: PanoramaShell, footprint: Footprint, others: list[Footprint]) -> bool:
    grid = footprint.grid()
    if not inside_plan(grid, shell.plan, 0.8 * _GAP_M).all():
        return False
    return all((other.distance(grid) > _GAP_M).all() and (footprint.distance(other.grid()) > _GAP_M).all()
               for other in others)  # fmt: skip


def _items(
    model: FurnitureModel, footprint: Footprint, catalogue: Catalogue, rng: np.random.Generator, split: Split
) -> list[Item]:
    """Return a piece, and perhaps something on its top."""
    right, (x, z) = footprint.right, footprint.middle
    degrees = float(np.degrees(np.arctan2(-right[1], right[0])))
    items = [_item(model, model.mesh.placed(float(x), 0.0, float(z), degrees=degrees))]
    if model.top_m is not None and rng.random() < _TOP_SHARE:
        small = catalogue.choose(
            str(rng.choice(_ON_TOP)),
            split,
            rng,
            fits=lambda candidate: candidate.width_m < 0.8 * model.width_m and candidate.depth_m < 0.8 * model.depth_m,
        )
        if small is not None:
            spare = (np.array([model.width_m - small.width_m, model.depth_m - small.depth_m]) / 2) * 0.7
            front = np.array([-right[1], right[0]])
            offset = rng.uniform(-1, 1, 2) * spare
            place = footprint.middle + offset[0] * right + offset[1] * front
            turn = float(rng.uniform(0, 360))
            items.append(_item(small, small.mesh.placed(float(place[0]), model.top_m, float(place[1]), degrees=turn)))
    return items


def _item(model: FurnitureModel, mesh: Mesh) -> Item:
    materials = tuple(
        replace(material, mirror=0.0, albedo=_MIRROR_ALBEDO, texture=None) if material.mirror > 0 else material
        for material in mesh.materials
    )
    return Item(model.name, model.role, replace(mesh, materials=materials), model.attribution)
