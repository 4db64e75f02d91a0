"""A window's geometry: reveal, sill, frame with sashes and glazing bars, panes, handles, and its `Opening`.

Everything is in the plane of the wall or slope: depth 0 is the wall's inner face, `depth_m` the outer one.
"""

from itertools import pairwise
from typing import Final

import numpy as np

from roomlight_generator.rooms.scene import Item, Material, Opening
from roomlight_generator.rooms.shell.covers import cover_items, seal_material
from roomlight_generator.rooms.shell.holes import Window, WindowLook
from roomlight_generator.rooms.shell.sheets import OVERLAP, Plane, Rect, Sheets, rect
from roomlight_generator.rooms.shell_finishes import Finishes

GLASS: Final = Material(name="glass", albedo=(0.9, 0.9, 0.9), glass=True)


def window_items(
    window: Window, plane: Plane, finishes: Finishes, reveal: Material, rng: np.random.Generator, *, name: str
) -> tuple[list[Item], Opening | None]:
    """The items of one window, and its opening (None where it is covered whole and glows instead)."""
    s0, s1, h0, h1 = window.rect
    look, depth = window.look, window.depth_m
    sealed = seal_material(window.cover, finishes)
    sides = Sheets()
    far = depth + (OVERLAP if sealed is not None else 0.0)
    sides.tube(plane, rect(*window.rect), (-OVERLAP, far), reveal)
    items = [Item(f"reveal of {name}", "wall", sides.mesh())]
    # The frame stands behind the inner part of the reveal, wholly within the wall.
    thick = min(look.thickness_m, depth - 0.02)
    near = min(max(look.inset * depth, 0.025), depth - thick - 0.004)
    frame, panes = _frame(look, plane, window.rect, (near, near + thick), finishes)
    items.append(Item(f"frame of {name}", "frame", frame.mesh()))
    items.append(Item(f"pane of {name}", "pane", panes.mesh()))
    if look.sill_m > 0 and not window.in_slope:
        sill = Sheets()
        board = (s0 - 0.03, s1 + 0.03, h0 - 0.025, h0 + 0.004)
        sill.bar(plane, board, (-look.sill_m, -OVERLAP / 2), finishes.frame, back=False)
        sill.bar(plane, (s0, s1, h0 - OVERLAP, h0 + 0.004), (-OVERLAP, near + 0.01), finishes.frame, back=False)
        items.append(Item(f"sill of {name}", "sill", sill.mesh()))
    items += cover_items(window, plane, finishes, rng, near_m=near, sealed=sealed, name=name)
    if sealed is not None:
        return items, None
    corner, across, up = plane.at(s0, h0, depth), (s1 - s0) * plane.u, (h1 - h0) * plane.v
    opening = Opening(corner.astype(np.float32), across.astype(np.float32), up.astype(np.float32))
    return items, opening


def _frame(
    look: WindowLook, plane: Plane, hole: Rect, depths: tuple[float, float], finishes: Finishes
) -> tuple[Sheets, Sheets]:
    """Frame and panes: a fixed outer frame, in it the sashes side by side (or one over the other)."""
    s0, s1, h0, h1 = hole
    frame, panes = Sheets(), Sheets()
    near, far = depths
    fixed = 0.6 * look.frame_m
    boxes = _ring(hole, fixed, depths)
    inner = (s0 + fixed, s1 - fixed, h0 + fixed, h1 - fixed)
    lights: list[tuple[Rect, tuple[float, float]]] = []
    top = inner[3]
    if look.transom > 0:
        split = inner[3] - look.transom * (h1 - h0)
        boxes.append((inner[0], inner[1], split - fixed / 2, split + fixed / 2, near, far))
        lights.append(((inner[0], inner[1], split + fixed / 2, inner[3]), depths))
        top = split - fixed / 2
    if look.kind == "sash":
        middle, half = (inner[2] + top) / 2, (near + far) / 2
        lights.append(((inner[0], inner[1], inner[2], middle + 0.02), (near, half)))
        lights.append(((inner[0], inner[1], middle - 0.02, top), (half, far)))
    else:
        stops = np.linspace(inner[0], inner[1], look.columns + 1)
        lights += [((float(a), float(b), inner[2], top), depths) for a, b in pairwise(stops)]
    for k, (light, span) in enumerate(lights):
        bar = look.frame_m if look.kind != "picture" else 0.5 * look.frame_m
        span = (span[0] - 0.008, span[1] - 0.012) if look.kind not in ("picture", "sash") else span
        boxes += _ring(light, bar, span, foot=0.16 if look.kind == "french" else bar)
        glass = (light[0] + bar, light[1] - bar, light[2] + bar, light[3] - bar)
        at = (span[0] + span[1]) / 2
        pane = rect(*glass)
        panes.panel(plane, pane, GLASS, depth=at)
        rows, columns = look.bars if k or look.transom == 0 else (1, 1)
        for n in range(1, rows):
            middle = glass[2] + n * (glass[3] - glass[2]) / rows
            boxes.append((glass[0], glass[1], middle - 0.011, middle + 0.011, at - 0.014, at + 0.014))
        for n in range(1, columns):
            middle = glass[0] + n * (glass[1] - glass[0]) / columns
            boxes.append((middle - 0.011, middle + 0.011, glass[2], glass[3], at - 0.014, at + 0.014))
    frame.bars(plane, np.array(boxes), finishes.frame)
    if look.kind in ("casement", "french"):
        _handles(look, plane, inner, near, finishes.handle, frame)
    return frame, panes


def _ring(
    hole: Rect, wide: float, depths: tuple[float, float], *, foot: float | None = None
) -> list[tuple[float, float, float, float, float, float]]:
    """Four bars around the inside of a rectangle, its lower one `foot` tall."""
    s0, s1, h0, h1 = hole
    foot = wide if foot is None else foot
    return [
        (s0, s0 + wide, h0, h1, *depths),
        (s1 - wide, s1, h0, h1, *depths),
        (s0 + wide, s1 - wide, h0, h0 + foot, *depths),
        (s0 + wide, s1 - wide, h1 - wide, h1, *depths),
    ]


def _handles(look: WindowLook, plane: Plane, inner: Rect, near: float, metal: Material, frame: Sheets) -> None:
    """One lever for each pair of sashes, on the bar between them."""
    width = (inner[1] - inner[0]) / look.columns
    low, high = inner[2], inner[3]
    at = low + min(1.05, 0.5 * (high - low))
    for k in range(0, look.columns, 2):
        s = inner[0] + (k + 1) * width + (-0.5 * look.frame_m if k + 1 < look.columns or look.columns == 1 else 0.0)
        s = s if k + 1 < look.columns or look.columns == 1 else inner[0] + k * width + 0.5 * look.frame_m
        plate = [s - 0.012, s + 0.012, at - 0.035, at + 0.035, near - 0.018, near - 0.007]
        lever = [s - 0.009, s + 0.009, at - 0.11, at + 0.012, near - 0.045, near - 0.031]
        neck = [s - 0.009, s + 0.009, at - 0.009, at + 0.009, near - 0.034, near - 0.01]
        frame.bars(plane, np.array([plate, lever, neck]), metal)
