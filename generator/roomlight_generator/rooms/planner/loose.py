"""What stands about: wall furniture, plants, lamps, rugs, clutter, toys, people, pets, and the second room."""

import math

import numpy as np

from roomlight_generator.rooms.plan import Placement
from roomlight_generator.rooms.planner.arrangement import Layout, Piece, turn_toward
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.wall_space import Where, stand

_CLEAR_M = {
    "wardrobe": 0.6, "dresser": 0.55, "bookcase": 0.45, "sideboard": 0.45, "fireplace": 0.7, "piano": 0.6,
    "fridge": 0.6, "washing_machine": 0.5, "bench": 0.35, "sofa": 0.5, "armchair": 0.4,
}  # fmt: skip

_ONE_ONLY = frozenset({"fridge", "piano", "fireplace", "washing_machine"})

_LIGHT = frozenset(
    {"chair", "office_chair", "armchair", "stool", "floor_toy", "coffee_table", "side_table", "person", "pet"}
)
"""What may stand with a part of it on a rug."""


def by_wall(
    layout: Layout,
    *,
    roles: tuple[str, ...],
    number: tuple[int, int] = (1, 1),
    where: Where = "any",
    depth: float = 1.2,
    height: tuple[float, float] = (0.0, 3.0),
) -> int:
    """So many pieces of these roles with their backs to walls; how many were put."""
    widest = 0.7 * max(wall.length_m for wall in layout.shell.walls)
    done = 0
    for _ in range(int(layout.rng.integers(number[0], number[1] + 1))):
        role = roles[int(layout.rng.integers(len(roles)))]
        if role in _ONE_ONLY and layout.having(role):
            continue
        for highest in (height[1], height[1], 1.15):
            model = layout.pick(role, width=(0.0, widest), depth=(0.0, depth), height=(height[0], highest))
            if stand(layout, model, where=where, clear_m=_CLEAR_M.get(role, 0.3)) is not None:
                done += 1
                break
    return done


def fill(
    layout: Layout, *, roles: tuple[str, ...], share: tuple[float, float] = (0.16, 0.36), depth: float = 0.75
) -> int:
    """Goes on with pieces of these roles by the walls until so much of the floor is taken; how many were put."""
    wanted = layout.between(share[0], share[1]) * layout.area_m2
    done = missed = 0
    while missed < 4:
        taken = sum(4 * p.body.half_width * p.body.half_depth for p in layout.pieces if p.layer == "floor")
        if taken >= wanted:
            break
        put = by_wall(layout, roles=roles, depth=depth)
        done, missed = done + put, missed + (put == 0)
    return done


def in_corner(layout: Layout, *, role: str, number: float = 1.0, widest: float = 0.9) -> int:
    """About so many floor lamps or plants in corners and beside furniture; how many were put."""
    done = 0
    for _ in range(layout.count(number)):
        model = layout.pick(role, width=(0.0, widest), depth=(0.0, widest + 0.2))
        done += stand(layout, model, where="corner" if layout.chance(0.75) else "any") is not None
    return done


def free_points(layout: Layout, number: int) -> list[tuple[float, float]]:
    """Plan points on free floor."""
    free = layout.free()
    rows, columns = np.nonzero(free)
    if not len(rows):
        return []
    chosen = layout.rng.integers(len(rows), size=number)
    cell, (x0, z0) = layout.floor.cell_m, layout.floor.origin
    return [(x0 + cell * float(columns[k]) + layout.between(-0.05, 0.05), z0 + cell * float(rows[k])) for k in chosen]


def on_floor(layout: Layout, *, role: str, number: float, by_walls: float = 0.5, tallest: float = 1.2) -> int:
    """About so many small things lying about, some of them by the walls; how many were put."""
    done = 0
    for _ in range(layout.count(number)):
        model = layout.pick(role, width=(0.0, 0.9), depth=(0.0, 0.9), height=(0.0, tallest))
        if model is None:
            return done
        if layout.chance(by_walls):
            done += stand(layout, model) is not None
            continue
        for x, z in free_points(layout, 4):
            if layout.put(model, x, z, layout.between(0, 360)) is not None:
                done += 1
                break
    return done


def person(layout: Layout, probability: float) -> Piece | None:
    """Now and then somebody stands about."""
    if not layout.chance(probability):
        return None
    model = layout.pick("person", height=(1.35, 2.05), width=(0.0, 1.1), depth=(0.0, 1.1))
    for x, z in free_points(layout, 8):
        placed = layout.put(model, x, z, layout.between(0, 360))
        if placed is not None:
            return placed
    return None


def pet(layout: Layout, probability: float) -> Piece | None:
    """Rarely an animal on the floor."""
    if layout.chance(probability):
        model = layout.pick("pet", width=(0.0, 1.2), depth=(0.0, 1.2), height=(0.0, 0.9))
        for x, z in free_points(layout, 6):
            placed = layout.put(model, x, z, layout.between(0, 360))
            if placed is not None:
                return placed
    return None


def rug(layout: Layout, *, probability: float, narrow: bool = False, small: bool = False) -> Piece | None:
    """A rug on free floor, along the room; `narrow` wants a runner, `small` a mat."""
    if not layout.chance(probability):
        return None
    longest = max(layout.shell.walls, key=lambda wall: wall.length_m)
    largest = 1.1 if small else (1.2 if narrow else 3.0)
    for _ in range(3):
        model = layout.pick("rug", depth=(0.3, largest), width=(0.3, 1.3 if small else 4.5), height=(0.0, 0.05))
        for x, z in free_points(layout, 5):
            turn = longest.facing_degrees() + layout.wobble(3.0) + (90 if layout.chance(0.3) and not narrow else 0)
            placed = layout.put(model, x, z, turn, layer="flat")
            if placed is None:
                continue
            if not any(_pins(piece, placed) for piece in layout.pieces):
                return placed
            layout.pieces.remove(placed)
    return None


def _pins(piece: Piece, carpet: Piece) -> bool:
    """Whether something heavy stands on a part of the rug: it was not laid there then."""
    return piece.layer == "floor" and piece.role not in _LIGHT and piece.body.overlaps(carpet.body)


def second_room(layout: Layout) -> list[Placement]:
    """A piece or two on the spots seen through an open door; these stand outside of the room's polygon."""
    placed: list[Placement] = []
    bodies: list[Body] = []
    middle = layout.shell.polygon.mean(0)
    for x, z, radius in layout.shell.spots:
        if layout.chance(0.25):
            continue
        role = layout.shuffled(("bookcase", "plant", "floor_lamp", "sideboard", "side_table", "armchair", "dresser"))[0]
        model = layout.pick(
            role, height=(0.2, 2.05), also=lambda one, r=radius: math.hypot(one.width_m, one.depth_m) / 2 <= r
        ) or layout.pick("plant", height=(0.2, 2.05), width=(0.0, 1.3 * radius), depth=(0.0, 1.3 * radius))
        if model is None:
            continue
        # Facing the room that it is seen from, along one of its walls' directions.
        toward = turn_toward(x, z, float(middle[0]), float(middle[1]))
        walls = [wall.facing_degrees() for wall in layout.shell.walls]
        turn = min(walls, key=lambda facing: abs((facing - toward + 180) % 360 - 180))
        placement = Placement(model=model, x=float(x), y=0.0, z=float(z), degrees=turn + layout.wobble(3))
        body = Body.placed(placement)
        if not any(body.overlaps(other) for other in bodies):
            bodies.append(body)
            placed.append(placement)
    return placed
