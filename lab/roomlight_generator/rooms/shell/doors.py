"""Doors, passages and niches: linings, architraves, leaves with panels and handles, thresholds, recesses.

Depth 0 is the main room's wall face; an open doorway runs through to the second room's wall face at `depth_m`.
"""

from typing import Final

import numpy as np

from roomlight_generator.rooms.finishes import Finishes
from roomlight_generator.rooms.scene import Item, Material
from roomlight_generator.rooms.shell.holes import Door, DoorDesign, Niche, Passage
from roomlight_generator.rooms.shell.mesh_builder import MeshBuilder, Plane
from roomlight_generator.rooms.shell.polygons import OVERLAP, Outline, difference, rect
from roomlight_generator.rooms.shell.surfaces import arch_outline

_LEAF_M: Final = 0.04
_ARCHITRAVE_M: Final = 0.014


def door_items(door: Door, plane: Plane, finishes: Finishes, floor: Material, *, name: str) -> list[Item]:
    """Build a door: closed in its recess, or open with a doorway to the second room."""
    s0, s1, h0, h1 = door.rect
    design = door.design
    frame = MeshBuilder()
    others = {0: floor} if door.to_second_room else None
    frame.tube(plane, rect(*door.rect), (-OVERLAP, door.depth_m + OVERLAP), finishes.door_frame, others=others)
    _architrave(door, plane, finishes.door_frame, frame)
    # The closed leaf's front is near the face of the room that it swings into.
    shut = 0.002 if design.swings_in else max(door.depth_m - _LEAF_M - 0.002, 0.002)
    if door.to_second_room:
        _architrave(door, _opposite_face(plane, door.depth_m), finishes.door_frame, frame, flipped=True)
    # Door stops: the closed leaf rests against them.
    stop = (shut + _LEAF_M + 0.002, shut + _LEAF_M + 0.016) if design.swings_in else (shut - 0.016, shut - 0.002)
    if stop[0] > 0 and stop[1] < door.depth_m:
        for where in ((s0, s0 + 0.012, h0, h1), (s1 - 0.012, s1, h0, h1), (s0, s1, h1 - 0.012, h1)):
            frame.bar(plane, where, stop, finishes.door_frame)
    items = [Item(f"lining of {name}", "frame", frame.mesh())]
    width = (s1 - s0) / design.leaves
    for k in range(design.leaves):
        hinge_right = bool(k) if design.leaves == 2 else design.hinge_right
        leaf = MeshBuilder()
        if not door.to_second_room and k == 0:
            leaf.back(plane, door.rect, finishes.door, door.depth_m)
        # Of two leaves the second is rarely opened as far.
        angle = design.open_degrees * (1.0 if k == 0 else 0.85)
        hung = _leaf_plane(plane, door, shut, angle, hinge_right=hinge_right)
        _leaf(hung, width - 0.005, h1 - h0 - 0.01, design, finishes, leaf)
        items.append(Item(f"leaf {k} of {name}", "door_leaf", leaf.mesh()))
    return items


def _opposite_face(plane: Plane, depth: float) -> Plane:
    """Return the opposite face of the same wall, seen from the other side, with s reversed."""
    return Plane(plane.at(0.0, 0.0, depth), -plane.u, plane.v)


def _architrave(door: Door, plane: Plane, material: Material, builder: MeshBuilder, *, flipped: bool = False) -> None:
    s0, s1, h0, h1 = door.rect
    if flipped:
        s0, s1 = -s1, -s0
    width_m, lap = door.design.architrave_m, 0.008
    depths = (-_ARCHITRAVE_M, OVERLAP)
    boxes = [
        [s0 - width_m, s0 - lap, h0, h1 + lap, *depths],
        [s1 + lap, s1 + width_m, h0, h1 + lap, *depths],
        [s0 - width_m, s1 + width_m, h1 + lap, h1 + width_m, *depths],
    ]
    builder.bars(plane, np.array(boxes), material, back=False)


def _leaf_plane(plane: Plane, door: Door, shut: float, degrees: float, *, hinge_right: bool) -> Plane:
    """Return the plane of a leaf: s from the hinge along the leaf, its two faces at depth 0 and `_LEAF_M`.

    For a right-hand hinge s runs leftward, so that its first face points away from the main room; both faces are alike.
    """
    s0, s1, h0, _ = door.rect
    opens_to_room = door.design.swings_in
    # The pivot is at the leaf's face on the side to which it opens.
    pivot = shut if opens_to_room else shut + _LEAF_M
    s = s1 - 0.002 if hinge_right else s0 + 0.002
    origin = plane.at(s, h0 + 0.006, pivot)
    along = -plane.u if hinge_right else plane.u
    swing = plane.normal if opens_to_room else -plane.normal
    turn = np.radians(degrees)
    u = float(np.cos(turn)) * along + float(np.sin(turn)) * swing
    hung = Plane(origin, u, plane.v)
    # The body of the leaf lies on the side of the pivot opposite to its swing.
    body = float(np.cos(turn)) * -swing + float(np.sin(turn)) * along
    if float(body @ -hung.normal) < 0:
        hung = Plane(origin + _LEAF_M * body, u, plane.v)
    return hung


def _leaf(
    plane: Plane, width: float, height: float, design: DoorDesign, finishes: Finishes, builder: MeshBuilder
) -> None:
    """Build a leaf from s = 0 (hinge) to width, with edges, panels on both faces and handles."""
    back = Plane(plane.at(width, 0.0, _LEAF_M), -plane.u, plane.v)
    fields = _panel_rectangles(width, height, design) if design.leaf == "panels" else []
    for face in (plane, back):
        pieces: list[Outline] = [rect(0.0, width, 0.0, height)]
        for field in fields:
            pieces = list(difference(pieces, rect(*field)))
        for piece in pieces:
            builder.panel(face, piece, finishes.door)
        for field in fields:
            _panel(face, field, finishes.door, builder)
        # The handle is far from the hinge: s is measured from the hinge on one face and toward it on the other.
        _handle(face, width - 0.07 if face is plane else 0.07, -1.0 if face is plane else 1.0, finishes.handle, builder)
    box = rect(0.0, width, 0.0, height)
    # Here the box is seen from outside: its sides must face away from its middle.
    builder.tube(plane, list(reversed(box)), (0.0, _LEAF_M), finishes.door)


def _panel_rectangles(width: float, height: float, design: DoorDesign) -> list[tuple[float, float, float, float]]:
    """Return the rectangles of the panels, between stiles and rails."""
    columns, rows = design.panels
    stile, rail, foot = 0.11, 0.1, 0.2
    if width < 0.6:
        columns = 1
    cell = (width - 2 * stile - (columns - 1) * rail) / columns
    # Upper panels are taller, except for the low top row of six-panel doors.
    shares = {1: [1.0], 2: [0.38, 0.62], 3: [0.42, 0.4, 0.18]}.get(rows, [1 / rows] * rows)
    free = height - foot - rail - (rows - 1) * rail
    rectangles: list[tuple[float, float, float, float]] = []
    low = foot
    for share in shares:
        height_m = share * free
        for column in range(columns):
            left = stile + column * (cell + rail)
            rectangles.append((left, left + cell, low, low + height_m))
        low += height_m + rail
    return rectangles


def _panel(face: Plane, field: tuple[float, float, float, float], material: Material, builder: MeshBuilder) -> None:
    """Build a recessed panel with sloping edges."""
    s0, s1, h0, h1 = field
    depth_m, bevel = 0.009, 0.022
    outer, inner = rect(*field), rect(s0 + bevel, s1 - bevel, h0 + bevel, h1 - bevel)
    builder.panel(face, inner, material, depth=depth_m)
    for k in range(4):
        a, b, c, d = outer[k], outer[(k + 1) % 4], inner[(k + 1) % 4], inner[k]
        builder.quad(face, [(*a, 0.0), (*b, 0.0), (*c, depth_m), (*d, depth_m)], material)


def _handle(face: Plane, s: float, toward: float, metal: Material, builder: MeshBuilder) -> None:
    """Build a lever on a plate; `toward` is the direction of the lever along s."""
    h = 1.03
    tip = s + toward * 0.115
    boxes = [
        [s - 0.018, s + 0.018, h - 0.13, h + 0.06, -0.006, OVERLAP],
        [s - 0.009, s + 0.009, h - 0.009, h + 0.009, -0.05, 0.0],
        [min(s - 0.009, tip), max(s + 0.009, tip), h - 0.009, h + 0.009, -0.058, -0.042],
        [s - 0.003, s + 0.003, h - 0.1, h - 0.08, -0.008, 0.0],
    ]
    builder.bars(face, np.array(boxes), metal, back=False)


def passage_items(
    hole: Passage, plane: Plane, finishes: Finishes, wall: Material, floor: Material, *, name: str
) -> list[Item]:
    """Build a doorway without a door, plain or arched, with a board lining or the wall's finish."""
    builder = MeshBuilder()
    material = finishes.door_frame if hole.lined else wall
    builder.tube(plane, arch_outline(hole), (-OVERLAP, hole.depth_m + OVERLAP), material, others={0: floor})
    if hole.lined and hole.arch_m < 0.02:
        design = DoorDesign("flush", architrave_m=0.07)
        door = Door(hole.side, hole.rect, hole.depth_m, design, to_second_room=True)
        _architrave(door, plane, finishes.door_frame, builder)
        _architrave(door, _opposite_face(plane, hole.depth_m), finishes.door_frame, builder, flipped=True)
    return [Item(f"lining of {name}", "frame" if hole.lined else "wall", builder.mesh())]


def niche_items(niche: Niche, plane: Plane, wall: Material, shelf: Material, *, name: str) -> list[Item]:
    """Build a recess with a back and shelves."""
    s0, s1, _, _ = niche.rect
    builder = MeshBuilder()
    builder.tube(plane, rect(*niche.rect), (-OVERLAP, niche.depth_m + OVERLAP), wall)
    builder.back(plane, niche.rect, wall, niche.depth_m)
    items = [Item(name, "wall", builder.mesh())]
    boards = MeshBuilder()
    for h in niche.shelves_m:
        boards.bar(plane, (s0 - OVERLAP, s1 + OVERLAP, h - 0.012, h + 0.012), (0.01, niche.depth_m + OVERLAP), shelf)
    if boards:
        items.append(Item(f"shelves of {name}", "frame", boards.mesh()))
    return items
