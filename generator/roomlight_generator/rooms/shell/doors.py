"""Doors, passages and niches: linings, architraves, leaves with panels and handles, thresholds, recesses.

Depth 0 is the main room's wall face; an open doorway runs through to the second room's wall face at `depth_m`.
"""

from typing import Final

import numpy as np

from roomlight_generator.rooms.scene import Item, Material
from roomlight_generator.rooms.shell.holes import Door, DoorLook, Niche, Passage
from roomlight_generator.rooms.shell.sheets import OVERLAP, Outline, Plane, Sheets, rect, without
from roomlight_generator.rooms.shell.surfaces import arch_outline
from roomlight_generator.rooms.shell_finishes import Finishes

_LEAF_M: Final = 0.04
_ARCHITRAVE_M: Final = 0.014


def door_items(door: Door, plane: Plane, finishes: Finishes, floor: Material, *, name: str) -> list[Item]:
    """A door in its recess, or open with the way through."""
    s0, s1, h0, h1 = door.rect
    look = door.look
    hole = rect(*door.rect)
    frame = Sheets()
    frame.tube(
        plane,
        hole,
        (-OVERLAP, door.depth_m + OVERLAP),
        finishes.door_frame,
        others={0: floor} if door.through else None,
    )
    _architrave(door, plane, finishes.door_frame, frame)
    shut = _leaf_depth(door)
    if door.through:
        _architrave(door, _behind(plane, door.depth_m), finishes.door_frame, frame, flipped=True)
    # Stops that the leaf shuts against.
    stop = (shut + _LEAF_M + 0.002, shut + _LEAF_M + 0.016) if look.swings_in else (shut - 0.016, shut - 0.002)
    if stop[0] > 0 and stop[1] < door.depth_m:
        for where in ((s0, s0 + 0.012, h0, h1), (s1 - 0.012, s1, h0, h1), (s0, s1, h1 - 0.012, h1)):
            frame.bar(plane, where, stop, finishes.door_frame)
    items = [Item(f"lining of {name}", "frame", frame.mesh())]
    width = (s1 - s0) / look.leaves
    for k in range(look.leaves):
        hinge_right = bool(k) if look.leaves == 2 else look.hinge_right
        leaf = Sheets()
        if not door.through and k == 0:
            edge = 2 * OVERLAP
            back = rect(s0 - edge, s1 + edge, h0 - edge, h1 + edge)
            leaf.panel(plane, back, finishes.door, depth=door.depth_m, grain_up=True)
        # Of two leaves the second is seldom opened as far.
        angle = look.open_degrees * (1.0 if k == 0 else 0.85)
        hung = _hung(plane, door, shut, angle, hinge_right=hinge_right)
        _leaf(hung, width - 0.005, h1 - h0 - 0.01, look, finishes, leaf)
        items.append(Item(f"leaf {k} of {name}", "door_leaf", leaf.mesh()))
    return items


def _leaf_depth(door: Door) -> float:
    """Where the front of the shut leaf is: near the face of the room that it swings into."""
    if door.look.swings_in:
        return 0.002
    return max(door.depth_m - _LEAF_M - 0.002, 0.002)


def _behind(plane: Plane, depth: float) -> Plane:
    """The same wall's other face, seen from the other side, with s running the other way."""
    return Plane(plane.at(0.0, 0.0, depth), -plane.u, plane.v)


def _architrave(door: Door, plane: Plane, material: Material, sheets: Sheets, *, flipped: bool = False) -> None:
    s0, s1, h0, h1 = door.rect
    if flipped:
        s0, s1 = -s1, -s0
    wide, lap = door.look.architrave_m, 0.008
    depths = (-_ARCHITRAVE_M, OVERLAP)
    boxes = [
        [s0 - wide, s0 - lap, h0, h1 + lap, *depths],
        [s1 + lap, s1 + wide, h0, h1 + lap, *depths],
        [s0 - wide, s1 + wide, h1 + lap, h1 + wide, *depths],
    ]
    sheets.bars(plane, np.array(boxes), material, back=False)


def _hung(plane: Plane, door: Door, shut: float, degrees: float, *, hinge_right: bool) -> Plane:
    """The leaf's own plane: s from the hinge along the leaf, depth 0 to `_LEAF_M` its two faces.

    For a right-hand hinge s runs leftward, so that its first face looks away from the main room; both faces are alike.
    """
    s0, s1, h0, _ = door.rect
    opens_to_room = door.look.swings_in
    # The pivot is at the leaf's face on the side that it opens to.
    pivot = shut if opens_to_room else shut + _LEAF_M
    s = s1 - 0.002 if hinge_right else s0 + 0.002
    origin = plane.at(s, h0 + 0.006, pivot)
    along = -plane.u if hinge_right else plane.u
    swing = plane.normal if opens_to_room else -plane.normal
    turn = np.radians(degrees)
    u = float(np.cos(turn)) * along + float(np.sin(turn)) * swing
    hung = Plane(origin, u, plane.v)
    # The body of the leaf lies on the far side of the pivot from where it swings to.
    body = float(np.cos(turn)) * -swing + float(np.sin(turn)) * along
    if float(body @ -hung.normal) < 0:
        hung = Plane(origin + _LEAF_M * body, u, plane.v)
    return hung


def _leaf(plane: Plane, width: float, height: float, look: DoorLook, finishes: Finishes, sheets: Sheets) -> None:
    """A leaf from s = 0 (hinge) to width, with edges, panels on both faces and handles."""
    back = Plane(plane.at(width, 0.0, _LEAF_M), -plane.u, plane.v)
    fields = _fields(width, height, look) if look.leaf == "panels" else []
    for face in (plane, back):
        pieces: list[Outline] = [rect(0.0, width, 0.0, height)]
        for field in fields:
            pieces = list(without(pieces, rect(*field)))
        for piece in pieces:
            sheets.panel(face, piece, finishes.door, grain_up=True)
        for field in fields:
            _field(face, field, finishes.door, sheets)
        # The handle is far from the hinge: s is measured from it on one face and toward it on the other.
        _handle(face, width - 0.07 if face is plane else 0.07, -1.0 if face is plane else 1.0, finishes.handle, sheets)
    box = rect(0.0, width, 0.0, height)
    # A tube from outside: its sides must face away from the middle.
    sheets.tube(plane, list(reversed(box)), (0.0, _LEAF_M), finishes.door)


def _fields(width: float, height: float, look: DoorLook) -> list[tuple[float, float, float, float]]:
    """Rectangles of the panels, between stiles and rails."""
    columns, rows = look.panels
    stile, rail, foot = 0.11, 0.1, 0.2
    if width < 0.6:
        columns = 1
    cell = (width - 2 * stile - (columns - 1) * rail) / columns
    # Upper panels are taller, but for a squat top row of six-panel doors.
    shares = {1: [1.0], 2: [0.38, 0.62], 3: [0.42, 0.4, 0.18]}.get(rows, [1 / rows] * rows)
    free = height - foot - rail - (rows - 1) * rail
    found: list[tuple[float, float, float, float]] = []
    low = foot
    for share in shares:
        tall = share * free
        for column in range(columns):
            left = stile + column * (cell + rail)
            found.append((left, left + cell, low, low + tall))
        low += tall + rail
    return found


def _field(face: Plane, field: tuple[float, float, float, float], material: Material, sheets: Sheets) -> None:
    """A sunk panel with sloping edges."""
    s0, s1, h0, h1 = field
    deep, bevel = 0.009, 0.022
    outer = [(s0, h0), (s1, h0), (s1, h1), (s0, h1)]
    inner = [(s0 + bevel, h0 + bevel), (s1 - bevel, h0 + bevel), (s1 - bevel, h1 - bevel), (s0 + bevel, h1 - bevel)]
    sheets.panel(face, inner, material, depth=deep, grain_up=True)
    for k in range(4):
        a, b, c, d = outer[k], outer[(k + 1) % 4], inner[(k + 1) % 4], inner[k]
        sheets.quad(face, [(*a, 0.0), (*b, 0.0), (*c, deep), (*d, deep)], material)


def _handle(face: Plane, s: float, toward: float, metal: Material, sheets: Sheets) -> None:
    """A lever on a plate; `toward` is the direction of the lever along s."""
    h = 1.03
    tip = s + toward * 0.115
    boxes = [
        [s - 0.018, s + 0.018, h - 0.13, h + 0.06, -0.006, OVERLAP],
        [s - 0.009, s + 0.009, h - 0.009, h + 0.009, -0.05, 0.0],
        [min(s - 0.009, tip), max(s + 0.009, tip), h - 0.009, h + 0.009, -0.058, -0.042],
        [s - 0.003, s + 0.003, h - 0.1, h - 0.08, -0.008, 0.0],
    ]
    sheets.bars(face, np.array(boxes), metal, back=False)


def passage_items(
    hole: Passage, plane: Plane, finishes: Finishes, wall: Material, floor: Material, *, name: str
) -> list[Item]:
    """A way through without a door, as an arch or plain, lined with boards or papered like the wall."""
    sheets = Sheets()
    material = finishes.door_frame if hole.lined else wall
    sheets.tube(plane, arch_outline(hole), (-OVERLAP, hole.depth_m + OVERLAP), material, others={0: floor})
    if hole.lined and hole.arch_m < 0.02:
        look = DoorLook("flush", architrave_m=0.07)
        door = Door(hole.side, hole.rect, hole.depth_m, look, through=True)
        _architrave(door, plane, finishes.door_frame, sheets)
        _architrave(door, _behind(plane, hole.depth_m), finishes.door_frame, sheets, flipped=True)
    return [Item(f"lining of {name}", "frame" if hole.lined else "wall", sheets.mesh())]


def niche_items(niche: Niche, plane: Plane, wall: Material, shelf: Material, *, name: str) -> list[Item]:
    """A recess with a back, and boards in it."""
    s0, s1, h0, h1 = niche.rect
    sheets = Sheets()
    sheets.tube(plane, rect(*niche.rect), (-OVERLAP, niche.depth_m + OVERLAP), wall)
    edge = 2 * OVERLAP
    sheets.panel(plane, rect(s0 - edge, s1 + edge, h0 - edge, h1 + edge), wall, depth=niche.depth_m)
    items = [Item(name, "wall", sheets.mesh())]
    boards = Sheets()
    for h in niche.shelves_m:
        boards.bar(plane, (s0 - OVERLAP, s1 + OVERLAP, h - 0.012, h + 0.012), (0.01, niche.depth_m + OVERLAP), shelf)
    if boards:
        items.append(Item(f"shelves of {name}", "frame", boards.mesh()))
    return items
