"""Build a complete shell from a style: envelope, floor plan, items, openings, plan for the furniture planner."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from roomlight_generator.rooms.finishes import Finishes, RoomFinishes
from roomlight_generator.rooms.plan import Gap, Shell, Wall
from roomlight_generator.rooms.scene import Item, Material, Opening
from roomlight_generator.rooms.shell.doors import door_items, niche_items, passage_items
from roomlight_generator.rooms.shell.floor_plan import FloorPlan, choose_floor_plan
from roomlight_generator.rooms.shell.holes import AnyHole, Door, Niche, Passage, Window, leads_to_second_room
from roomlight_generator.rooms.shell.mesh_builder import Plane
from roomlight_generator.rooms.shell.outline import Envelope, choose_envelope
from roomlight_generator.rooms.shell.polygons import Outline
from roomlight_generator.rooms.shell.style import ShellStyle, uniform
from roomlight_generator.rooms.shell.surfaces import (
    Trim,
    beam_items,
    build_ceiling,
    build_floor,
    build_wall,
    hole_outline,
    trim_items,
)
from roomlight_generator.rooms.shell.windows import window_items

_ENTRY_SIDE: Final = 3
"""Side of the second room next to the main room."""


def build_shell(style: ShellStyle, finishes: Finishes, rng: np.random.Generator) -> Shell:
    """Build a random room without furniture; the same generator state gives the same shell.

    Items have the roles wall (one for each side, named "wall 0" in the order of `Shell.walls`; "wall 2, backsplash"
    where kitchen units are expected; reveals and niches are walls too), floor, ceiling, frame, sill, pane, door_leaf,
    skirting, beam, curtain, blind, moulding and second_room (every part of a second room and of its doors).
    """
    room = choose_envelope(style, rng)
    depth_m = uniform(rng, (0.1, 0.22)) if rng.random() < style.beams and room.height_m >= 2.35 else 0.0
    floor_plan = choose_floor_plan(room, style, rng, beams_m=0.0 if room.slopes else depth_m)
    trim, band = _choose_trim(room, floor_plan, style, finishes, depth_m, rng)
    items, openings = _room_items(room, floor_plan.holes, finishes, finishes.room, trim, rng, band=band)
    for k, light in enumerate(floor_plan.skylights):
        plane = room.slopes[light.side].plane
        made, opening = window_items(light, plane, finishes, finishes.room.ceiling, rng, name=f"skylight {k}")
        items += made
        openings += [opening] if opening is not None else []
    items.append(Item("ceiling", "ceiling", build_ceiling(room, finishes.room.ceiling, floor_plan.skylights).mesh()))
    items.append(Item("floor", "floor", build_floor(room, finishes.room.floor).mesh()))
    if depth_m:
        items += beam_items(room, floor_plan.skylights, finishes.beam, depth_m, rng)
    spots: list[tuple[float, float, float]] = []
    if floor_plan.second is not None:
        entry = next(hole for hole in floor_plan.holes if leads_to_second_room(hole))
        made, second_openings = _second_room_items(room, floor_plan, floor_plan.second, entry, finishes, trim, rng)
        items += made
        openings += second_openings
        spots = _spots(room, floor_plan, floor_plan.second, entry, rng)
    return Shell(
        items=tuple(items),
        openings=tuple(openings),
        polygon=np.array(room.corners, np.float64),
        walls=_walls(room, floor_plan.holes),
        height_m=room.height_m,
        slopes=tuple((slope.normal, slope.offset) for slope in room.slopes),
        spots=tuple(spots),
    )


def _choose_trim(
    room: Envelope,
    floor_plan: FloorPlan,
    style: ShellStyle,
    finishes: Finishes,
    depth_m: float,
    rng: np.random.Generator,
) -> tuple[Trim, int | None]:
    """Choose the trim; also return the side that has the backsplash, if any."""
    skirting = uniform(rng, (0.05, 0.15)) if rng.random() < style.skirting else 0.0
    accent = bool(rng.random() < style.accent_wall)
    crown = uniform(rng, (0.03, 0.11)) if rng.random() < style.crown_moulding and not depth_m else 0.0
    if style.lower_wall == "none" or finishes.room.lower_wall is None or rng.random() >= style.lower_wall_chance:
        return Trim(skirting_m=skirting, crown_m=crown, accent=accent), None
    top = min(uniform(rng, style.lower_wall_m), room.height_m - 0.05)
    if style.lower_wall == "backsplash":
        free = [side.length_m for side in room.sides]
        for hole in floor_plan.holes:
            free[hole.side] -= hole.rect[1] - hole.rect[0]
        band = int(np.argmax(free))
        return Trim((0.85, max(top, 1.2)), frozenset([band]), False, skirting, crown, accent), band
    if style.lower_wall == "tiles":
        skirting = 0.0
    everywhere = frozenset(range(len(room.sides)))
    return Trim((0.0, top), everywhere, style.lower_wall == "wainscot", skirting, crown, accent), None


def _room_items(
    room: Envelope,
    holes: Sequence[AnyHole],
    finishes: Finishes,
    room_finishes: RoomFinishes,
    trim: Trim,
    rng: np.random.Generator,
    *,
    band: int | None = None,
    doorway: Outline | None = None,
) -> tuple[list[Item], list[Opening]]:
    """Build walls, the windows and doors in them and the trim along them, and a doorway in the second room's wall."""
    items: list[Item] = []
    openings: list[Opening] = []
    accent = _accent_side(room, holes) if room_finishes.accent_wall is not None and trim.accent else None
    for i, side in enumerate(room.sides):
        side_holes = [hole for hole in holes if hole.side == i]
        outlines: list[Outline] = [hole_outline(hole) for hole in side_holes]
        trim_stops = list(side_holes)
        if doorway is not None and i == _ENTRY_SIDE:
            outlines.append(doorway)
            # To the trim it is a plain doorway with an architrave's margin.
            s, h = [p[0] for p in doorway], [p[1] for p in doorway]
            trim_stops.append(Passage(i, (min(s), max(s), min(h), max(h)), 0.1, 0.0, lined=True))
        builder = build_wall(room, i, outlines, room_finishes, trim, accent=i == accent)
        items.append(Item(f"wall {i}, backsplash" if i == band else f"wall {i}", "wall", builder.mesh()))
        wall_finish = (room_finishes.accent_wall if i == accent else None) or room_finishes.wall
        for k, hole in enumerate(side_holes):
            made, opening = _hole_items(hole, side.plane, finishes, room_finishes, wall_finish, rng, name=f"{i}.{k}")
            items += made
            openings += [opening] if opening is not None else []
        items += trim_items(room, i, trim_stops, room_finishes, finishes.moulding, trim)
    return items, openings


def _accent_side(room: Envelope, holes: Sequence[AnyHole]) -> int | None:
    """Return the longest side without a window."""
    glazed = {hole.side for hole in holes if isinstance(hole, Window)}
    plain = [i for i in range(len(room.sides)) if i not in glazed]
    return max(plain, key=lambda i: room.sides[i].length_m) if plain else None


def _hole_items(
    hole: AnyHole,
    plane: Plane,
    finishes: Finishes,
    room_finishes: RoomFinishes,
    wall_finish: Material,
    rng: np.random.Generator,
    *,
    name: str,
) -> tuple[list[Item], Opening | None]:
    if isinstance(hole, Window):
        return window_items(hole, plane, finishes, wall_finish, rng, name=f"window {name}")
    if isinstance(hole, Door):
        return door_items(hole, plane, finishes, room_finishes.floor, name=f"door {name}"), None
    if isinstance(hole, Niche):
        return niche_items(hole, plane, wall_finish, finishes.frame, name=f"niche {name}"), None
    return passage_items(hole, plane, finishes, wall_finish, room_finishes.floor, name=f"passage {name}"), None


def _second_room_items(
    room: Envelope,
    floor_plan: FloorPlan,
    second: Envelope,
    hole: AnyHole,
    finishes: Finishes,
    trim: Trim,
    rng: np.random.Generator,
) -> tuple[list[Item], list[Opening]]:
    """Build the second room, closed except for the hole that leads to it and its window."""
    plane = room.sides[hole.side].plane
    near = second.sides[_ENTRY_SIDE].plane
    cut = [(float((plane.at(s, h, hole.depth_m) - near.origin) @ near.u), h) for s, h in hole_outline(hole)]
    cut.reverse()
    room_finishes = finishes.second
    plain = Trim(skirting_m=trim.skirting_m or 0.08)
    if room_finishes.lower_wall is not None:
        plain = Trim((0.0, 1.1), frozenset(range(4)), skirting_m=plain.skirting_m)
    items, openings = _room_items(second, floor_plan.second_holes, finishes, room_finishes, plain, rng, doorway=cut)
    items.append(Item("floor", "floor", build_floor(second, room_finishes.floor).mesh()))
    items.append(Item("ceiling", "ceiling", build_ceiling(second, room_finishes.ceiling, []).mesh()))
    return [Item(f"second room: {item.name}", "second_room", item.mesh) for item in items], openings


def _spots(
    room: Envelope, floor_plan: FloorPlan, second: Envelope, hole: AnyHole, rng: np.random.Generator
) -> list[tuple[float, float, float]]:
    """Choose up to two places along the far wall of the second room, the first opposite the doorway."""
    far = second.sides[1]
    depth_m = second.sides[0].length_m
    # A leaf that swings into the second room needs clear floor.
    leaf = 0.0
    if isinstance(hole, Door) and not hole.design.swings_in:
        leaf = (hole.rect[1] - hole.rect[0]) / hole.design.leaves
    radius = min(0.5, (depth_m - leaf) / 2 - 0.05, far.length_m / 2 - 0.05)
    if radius < 0.15:
        return []
    side = room.sides[hole.side].plane
    middle = side.at((hole.rect[0] + hole.rect[1]) / 2, 0.0, hole.depth_m)
    along = float((middle - far.plane.origin) @ far.plane.u)
    taken = [(hole.rect[0] - 0.1, hole.rect[1] + 0.1) for hole in floor_plan.second_holes if isinstance(hole, Door)]
    places = [along + float(rng.uniform(-0.3, 0.3))]
    places += [places[0] + step for step in (-2.1 * radius, 2.1 * radius)]
    spots: list[tuple[float, float, float]] = []
    for place in places:
        place = float(np.clip(place, radius + 0.03, far.length_m - radius - 0.03))
        if any(low - radius < place < high + radius for low, high in taken):
            continue
        x, _, z = far.plane.at(place, 0.0, -(radius + 0.03))
        if all(np.hypot(x - a, z - b) > radius + r for a, b, r in spots):
            spots.append((float(x), float(z), radius))
    return spots[:2]


def _walls(room: Envelope, holes: Sequence[AnyHole]) -> tuple[Wall, ...]:
    """Convert the sides to the walls that the furniture planner uses."""
    walls: list[Wall] = []
    for i, side in enumerate(room.sides):
        start = side.plane.origin[[0, 2]]
        gaps: list[Gap] = sorted(
            (gap for hole in holes if hole.side == i for gap in hole.gaps()), key=lambda gap: gap.start_m
        )
        walls.append(
            Wall(
                start=start,
                end=start + side.length_m * side.plane.u[[0, 2]],
                inward=side.plane.normal[[0, 2]],
                height_m=side.least_height_m,
                gaps=tuple(gaps),
            )
        )
    return tuple(walls)
