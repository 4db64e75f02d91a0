"""Freestanding items: furniture along walls, plants, lamps, rugs, clutter, toys, people, pets, and the second room."""

import math
from typing import Literal

import numpy as np

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.plan import Placement
from roomlight_generator.rooms.planner.arrangement import Arrangement, Piece, yaw_toward
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.wall_space import place_at_wall

_CLEAR_M = {
    "wardrobe": 0.6, "dresser": 0.55, "bookcase": 0.45, "sideboard": 0.45, "fireplace": 0.7, "piano": 0.6,
    "fridge": 0.6, "washing_machine": 0.5, "bench": 0.35, "sofa": 0.5, "armchair": 0.4,
}  # fmt: skip

_UNIQUE_ROLES = frozenset({"fridge", "piano", "fireplace", "washing_machine"})

_LIGHT_ROLES = frozenset(
    {"chair", "office_chair", "armchair", "stool", "floor_toy", "coffee_table", "side_table", "person", "pet"}
)
"""Roles that may stand partly on a rug."""

_BEINGS = {"person": (1.1, (1.35, 2.05), 8), "pet": (1.2, (0.0, 0.9), 6)}
"""Largest width, range of heights and places tried."""


def place_along_walls(
    arrangement: Arrangement,
    *,
    roles: tuple[str, ...],
    number: tuple[int, int] = (1, 1),
    depth: float = 1.2,
    height: tuple[float, float] = (0.0, 3.0),
) -> int:
    """Place a number of pieces of these roles with their backs to walls; return how many were placed."""
    widest = 0.7 * max(wall.length_m for wall in arrangement.shell.walls)
    done = 0
    for _ in range(int(arrangement.rng.integers(number[0], number[1] + 1))):
        role = roles[int(arrangement.rng.integers(len(roles)))]
        if role in _UNIQUE_ROLES and arrangement.with_roles(role):
            continue
        for highest in (height[1], height[1], 1.15):
            model = arrangement.pick(role, width=(0.0, widest), depth=(0.0, depth), height=(height[0], highest))
            if place_at_wall(arrangement, model, clear_m=_CLEAR_M.get(role, 0.3)) is not None:
                done += 1
                break
    return done


def fill_walls(arrangement: Arrangement, *, roles: tuple[str, ...], share: tuple[float, float] = (0.16, 0.36)) -> None:
    """Place pieces of these roles along walls until a share of the floor is covered."""
    wanted = arrangement.uniform(share[0], share[1]) * arrangement.area_m2
    missed = 0
    while missed < 4:
        taken = sum(4 * p.body.half_width * p.body.half_depth for p in arrangement.pieces if p.layer == "floor")
        if taken >= wanted:
            break
        if place_along_walls(arrangement, roles=roles, depth=0.75) == 0:
            missed += 1


def place_in_corners(arrangement: Arrangement, *, role: str, number: float = 1.0, widest: float = 0.9) -> None:
    """Place floor lamps or plants in corners and beside furniture (Poisson mean `number`)."""
    for _ in range(arrangement.poisson(number)):
        model = arrangement.pick(role, width=(0.0, widest), depth=(0.0, widest + 0.2))
        place_at_wall(arrangement, model, where="corner" if arrangement.chance(0.75) else "any")


def free_points(arrangement: Arrangement, number: int) -> list[tuple[float, float]]:
    """Return random plan points on free floor."""
    free = arrangement.free_cells()
    rows, columns = np.nonzero(free)
    if not len(rows):
        return []
    chosen = arrangement.rng.integers(len(rows), size=number)
    cell, (x0, z0) = arrangement.floor.cell_m, arrangement.floor.origin
    return [
        (x0 + cell * float(columns[k]) + arrangement.uniform(-0.05, 0.05), z0 + cell * float(rows[k])) for k in chosen
    ]


def scatter_on_floor(
    arrangement: Arrangement, *, role: str, number: float, by_walls: float = 0.5, tallest: float = 1.2
) -> None:
    """Scatter small objects on the floor, some along walls (Poisson mean `number`)."""
    for _ in range(arrangement.poisson(number)):
        model = arrangement.pick(role, width=(0.0, 0.9), depth=(0.0, 0.9), height=(0.0, tallest))
        if model is None:
            return
        if arrangement.chance(by_walls):
            place_at_wall(arrangement, model)
        else:
            _place_on_free_floor(arrangement, model, 4)


def place_being(arrangement: Arrangement, role: Literal["person", "pet"], probability: float) -> None:
    """Place a standing person or an animal on free floor, with the given probability."""
    if arrangement.chance(probability):
        widest, height, tries = _BEINGS[role]
        model = arrangement.pick(role, width=(0.0, widest), depth=(0.0, widest), height=height)
        _place_on_free_floor(arrangement, model, tries)


def _place_on_free_floor(arrangement: Arrangement, model: FurnitureModel | None, tries: int) -> None:
    for x, z in free_points(arrangement, tries):
        if arrangement.place(model, x, z, arrangement.uniform(0, 360)) is not None:
            return


def place_rug(arrangement: Arrangement, *, probability: float, narrow: bool = False, small: bool = False) -> None:
    """Place a rug on free floor, along the room; `narrow` asks for a runner, `small` for a mat."""
    if not arrangement.chance(probability):
        return
    longest = max(arrangement.shell.walls, key=lambda wall: wall.length_m)
    largest = 1.1 if small else (1.2 if narrow else 3.0)
    for _ in range(3):
        model = arrangement.pick("rug", depth=(0.3, largest), width=(0.3, 1.3 if small else 4.5), height=(0.0, 0.05))
        for x, z in free_points(arrangement, 5):
            yaw = (
                longest.facing_degrees()
                + arrangement.jitter(3.0)
                + (90 if arrangement.chance(0.3) and not narrow else 0)
            )
            placed = arrangement.place(model, x, z, yaw, layer="flat")
            if placed is None:
                continue
            if not any(_blocks_rug(piece, placed) for piece in arrangement.pieces):
                return
            arrangement.pieces.remove(placed)


def _blocks_rug(piece: Piece, carpet: Piece) -> bool:
    """Return whether a heavy piece stands on part of the rug: the rug cannot lie there."""
    return piece.layer == "floor" and piece.role not in _LIGHT_ROLES and piece.body.overlaps(carpet.body)


def furnish_second_room(arrangement: Arrangement) -> list[Placement]:
    """Place one or two pieces on the spots visible through an open door; these stand outside the room's polygon."""
    placed: list[Placement] = []
    bodies: list[Body] = []
    middle = arrangement.shell.polygon.mean(0)
    for x, z, radius in arrangement.shell.spots:
        if arrangement.chance(0.25):
            continue
        role = arrangement.shuffled(
            ("bookcase", "plant", "floor_lamp", "sideboard", "side_table", "armchair", "dresser")
        )[0]
        model = arrangement.pick(
            role,
            height=(0.2, 2.05),
            also=lambda candidate, r=radius: math.hypot(candidate.width_m, candidate.depth_m) / 2 <= r,
        ) or arrangement.pick("plant", height=(0.2, 2.05), width=(0.0, 1.3 * radius), depth=(0.0, 1.3 * radius))
        if model is None:
            continue
        # Face the main room, parallel to one of its walls.
        toward = yaw_toward(x, z, float(middle[0]), float(middle[1]))
        walls = [wall.facing_degrees() for wall in arrangement.shell.walls]
        yaw = min(walls, key=lambda facing: abs((facing - toward + 180) % 360 - 180))
        placement = Placement(model=model, x=float(x), y=0.0, z=float(z), degrees=yaw + arrangement.jitter(3))
        body = Body.placed(placement)
        if not any(body.overlaps(other) for other in bodies):
            bodies.append(body)
            placed.append(placement)
    return placed
