"""A window's geometry: reveal, sill, frame with sashes and glazing bars, panes, handles, and its `Opening`.

All coordinates are in the plane of the wall or slope: depth 0 is the wall's inner face, `depth_m` the outer one.
"""

from itertools import pairwise
from typing import Final

import numpy as np

from roomlight_generator.rooms.finishes import Finishes
from roomlight_generator.rooms.scene import Item, Material, Opening
from roomlight_generator.rooms.shell.covers import cover_items, seal_material
from roomlight_generator.rooms.shell.holes import Window, WindowDesign
from roomlight_generator.rooms.shell.mesh_builder import MeshBuilder, Plane
from roomlight_generator.rooms.shell.polygons import OVERLAP, Rect, rect

GLASS: Final = Material(name="glass", albedo=(0.9, 0.9, 0.9), glass=True)


def window_items(
    window: Window, plane: Plane, finishes: Finishes, reveal: Material, rng: np.random.Generator, *, name: str
) -> tuple[list[Item], Opening | None]:
    """Build the items of one window, and its opening (None if it is fully covered and the cloth emits instead)."""
    s0, s1, h0, h1 = window.rect
    design, depth = window.design, window.depth_m
    sealed = seal_material(window.cover, finishes)
    sides = MeshBuilder()
    far = depth + (OVERLAP if sealed is not None else 0.0)
    sides.tube(plane, rect(*window.rect), (-OVERLAP, far), reveal)
    items = [Item(f"reveal of {name}", "wall", sides.mesh())]
    # The frame stands behind the inner part of the reveal, entirely within the wall.
    thickness_m = min(design.thickness_m, depth - 0.02)
    near = min(max(design.inset * depth, 0.025), depth - thickness_m - 0.004)
    frame, panes = _frame(design, plane, window.rect, (near, near + thickness_m), finishes)
    items.append(Item(f"frame of {name}", "frame", frame.mesh()))
    items.append(Item(f"pane of {name}", "pane", panes.mesh()))
    if design.sill_m > 0 and not window.in_slope:
        sill = MeshBuilder()
        board = (s0 - 0.03, s1 + 0.03, h0 - 0.025, h0 + 0.004)
        sill.bar(plane, board, (-design.sill_m, -OVERLAP / 2), finishes.frame, back=False)
        sill.bar(plane, (s0, s1, h0 - OVERLAP, h0 + 0.004), (-OVERLAP, near + 0.01), finishes.frame, back=False)
        items.append(Item(f"sill of {name}", "sill", sill.mesh()))
    items += cover_items(window, plane, finishes, rng, near_m=near, sealed=sealed, name=name)
    if sealed is not None:
        return items, None
    corner, across, up = plane.at(s0, h0, depth), (s1 - s0) * plane.u, (h1 - h0) * plane.v
    opening = Opening(corner.astype(np.float32), across.astype(np.float32), up.astype(np.float32))
    return items, opening


def _frame(
    design: WindowDesign, plane: Plane, hole: Rect, depths: tuple[float, float], finishes: Finishes
) -> tuple[MeshBuilder, MeshBuilder]:
    """Build frame and panes: a fixed outer frame that holds the sashes side by side (or one over the other)."""
    s0, s1, h0, h1 = hole
    frame, panes = MeshBuilder(), MeshBuilder()
    near, far = depths
    fixed = 0.6 * design.frame_m
    boxes = _ring(hole, fixed, depths)
    inner = (s0 + fixed, s1 - fixed, h0 + fixed, h1 - fixed)
    lights: list[tuple[Rect, tuple[float, float]]] = []
    top = inner[3]
    if design.transom > 0:
        split = inner[3] - design.transom * (h1 - h0)
        boxes.append((inner[0], inner[1], split - fixed / 2, split + fixed / 2, near, far))
        lights.append(((inner[0], inner[1], split + fixed / 2, inner[3]), depths))
        top = split - fixed / 2
    if design.kind == "sash":
        middle, half = (inner[2] + top) / 2, (near + far) / 2
        lights.append(((inner[0], inner[1], inner[2], middle + 0.02), (near, half)))
        lights.append(((inner[0], inner[1], middle - 0.02, top), (half, far)))
    else:
        stops = np.linspace(inner[0], inner[1], design.columns + 1)
        lights += [((float(a), float(b), inner[2], top), depths) for a, b in pairwise(stops)]
    for k, (light, span) in enumerate(lights):
        bar = design.frame_m if design.kind != "picture" else 0.5 * design.frame_m
        span = (span[0] - 0.008, span[1] - 0.012) if design.kind not in ("picture", "sash") else span
        boxes += _ring(light, bar, span, foot=0.16 if design.kind == "french" else bar)
        glass = (light[0] + bar, light[1] - bar, light[2] + bar, light[3] - bar)
        at = (span[0] + span[1]) / 2
        pane = rect(*glass)
        panes.panel(plane, pane, GLASS, depth=at)
        rows, columns = design.bars if k or design.transom == 0 else (1, 1)
        for n in range(1, rows):
            middle = glass[2] + n * (glass[3] - glass[2]) / rows
            boxes.append((glass[0], glass[1], middle - 0.011, middle + 0.011, at - 0.014, at + 0.014))
        for n in range(1, columns):
            middle = glass[0] + n * (glass[1] - glass[0]) / columns
            boxes.append((middle - 0.011, middle + 0.011, glass[2], glass[3], at - 0.014, at + 0.014))
    frame.bars(plane, np.array(boxes), finishes.frame)
    if design.kind in ("casement", "french"):
        _handles(design, plane, inner, near, finishes.handle, frame)
    return frame, panes


def _ring(
    hole: Rect, width_m: float, depths: tuple[float, float], *, foot: float | None = None
) -> list[tuple[float, float, float, float, float, float]]:
    """Return four bars around the inside of a rectangle, the lowest one `foot` tall."""
    s0, s1, h0, h1 = hole
    foot = width_m if foot is None else foot
    return [
        (s0, s0 + width_m, h0, h1, *depths),
        (s1 - width_m, s1, h0, h1, *depths),
        (s0 + width_m, s1 - width_m, h0, h0 + foot, *depths),
        (s0 + width_m, s1 - width_m, h1 - width_m, h1, *depths),
    ]


def _handles(design: WindowDesign, plane: Plane, inner: Rect, near: float, metal: Material, frame: MeshBuilder) -> None:
    """Build one lever for each pair of sashes, on the bar between them."""
    width = (inner[1] - inner[0]) / design.columns
    low, high = inner[2], inner[3]
    at = low + min(1.05, 0.5 * (high - low))
    for k in range(0, design.columns, 2):
        s = (
            inner[0]
            + (k + 1) * width
            + (-0.5 * design.frame_m if k + 1 < design.columns or design.columns == 1 else 0.0)
        )
        s = s if k + 1 < design.columns or design.columns == 1 else inner[0] + k * width + 0.5 * design.frame_m
        plate = [s - 0.012, s + 0.012, at - 0.035, at + 0.035, near - 0.018, near - 0.007]
        lever = [s - 0.009, s + 0.009, at - 0.11, at + 0.012, near - 0.045, near - 0.031]
        neck = [s - 0.009, s + 0.009, at - 0.009, at + 0.009, near - 0.034, near - 0.01]
        frame.bars(plane, np.array([plate, lever, neck]), metal)
