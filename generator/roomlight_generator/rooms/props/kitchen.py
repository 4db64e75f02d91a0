"""Kitchens: base and wall units of one style, and the appliances between them.

Members of a family share their first random draws (`KitchenStyle`), so that units of the same number match: same
fronts, same worktop, same depth.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from roomlight_generator.rooms.props import palette
from roomlight_generator.rooms.props.draft import Draft, Parts, uniform
from roomlight_generator.rooms.props.storage import FrontGrid, FrontMaterials, add_fronts
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, box, loft, rectangle, tube

HEIGHT_M = 0.9
_TOP_M = 0.038


@dataclass(frozen=True, eq=False)
class KitchenStyle:
    """Properties shared by all units of one kitchen."""

    front: FrontMaterials
    top: Material
    depth_m: float
    handle: int
    white: Material
    steel: Material


def draw_kitchen_style(rng: np.random.Generator) -> KitchenStyle:
    """Draw the style, from the family's first random numbers."""
    face = palette.wood(rng) if rng.random() < 0.35 else palette.paint(rng)
    if face.name == "paint":
        face = replace(face, roughness=uniform(rng, 0.08, 0.35))
    body = face if rng.random() < 0.5 else palette.paint(rng, palette.neutral(rng, 200, 240))
    steel = Material("steel", albedo=palette.neutral(rng, 130, 205), roughness=uniform(rng, 0.15, 0.35))
    white = Material("enamel", albedo=palette.neutral(rng, 222, 240), roughness=uniform(rng, 0.08, 0.25))
    return KitchenStyle(
        front=FrontMaterials(body, face, palette.metal(rng)),
        top=palette.worktop(rng),
        depth_m=uniform(rng, 0.6, 0.65),
        handle=int(rng.integers(5)),
        white=white,
        steel=steel,
    )


def _add_base(
    parts: Parts, rng: np.random.Generator, style: KitchenStyle, width: Number, *, hole: bool = False
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Add plinth, carcass and worktop; return the carcass's position and size."""
    depth = style.depth_m
    parts.slab(palette.black(rng), (width, 0.1, depth - 0.08), (0, 0, -0.03), radius=0)
    size = (width, HEIGHT_M - _TOP_M - 0.1, depth - 0.04)
    place = (0.0, 0.1, -0.02)
    body = style.front.body
    if hole:
        board, height_m = 0.016, size[1]
        parts.blocks(body, [(board, height_m, size[2], x * (width - board) / 2, 0.1, -0.02) for x in (-1, 1)])
        parts.blocks(
            body, [(width, height_m, board, 0, 0.1, z) for z in (-depth / 2 + board / 2, depth / 2 - 0.04 - board / 2)]
        )
        parts.blocks(body, [(width, board, size[2], 0, 0.1, -0.02)])
    else:
        parts.slab(body, size, place, radius=0)
        parts.slab(style.top, (width, _TOP_M, depth), (0, HEIGHT_M - _TOP_M, 0), radius=0)
    return place, size


def kitchen_unit(width: Number, kind: str, rng: np.random.Generator) -> Draft:
    """Make a base unit: `drawers`, `doors`, or `sink` with its tap."""
    style = draw_kitchen_style(rng)
    depth = style.depth_m
    if kind == "sink":
        return Draft("kitchen sink", (width, HEIGHT_M + 0.25, depth), partial(_sink, rng, style, width))

    def build() -> Mesh:
        parts = Parts()
        place, size = _add_base(parts, rng, style, width)
        rows = int(rng.integers(2, 5)) if kind == "drawers" else 1
        columns = 1 if kind == "drawers" or width < 0.7 else 2
        add_fronts(parts, rng, style.front, place, size, FrontGrid(columns, rows, kind == "doors", style.handle))
        return parts.mesh()

    return Draft(f"kitchen {kind}", (width, HEIGHT_M, depth), build, top_m=HEIGHT_M)


def _sink(rng: np.random.Generator, style: KitchenStyle, width: Number) -> Mesh:
    parts = Parts()
    depth = style.depth_m
    place, size = _add_base(parts, rng, style, width, hole=True)
    add_fronts(parts, rng, style.front, place, size, FrontGrid(2 if width > 0.7 else 1, 1, True, style.handle))
    width_m, depth_m = width - 0.14, 0.4
    x0, z0 = (width - width_m) / 2, (depth - depth_m) / 2 + 0.03
    for y, sign in ((HEIGHT_M, 1), (HEIGHT_M - _TOP_M, -1)):
        hole = (
            (x0, x0 + width_m, z0, z0 + depth_m) if sign < 0 else (x0, x0 + width_m, depth - z0 - depth_m, depth - z0)
        )
        near, edge = (depth / 2, -depth) if sign > 0 else (-depth / 2, depth)
        parts.add(rectangle((-width / 2, y, near), (width, 0, 0), (0, 0, edge), step=9, hole=hole), style.top)
    parts.blocks(style.top, [(width, _TOP_M, 0.004, 0, HEIGHT_M - _TOP_M, z * (depth / 2 - 0.002)) for z in (-1, 1)])
    parts.blocks(style.top, [(0.004, _TOP_M, depth, x * (width / 2 - 0.002), HEIGHT_M - _TOP_M, 0) for x in (-1, 1)])
    bowl = style.steel if rng.random() < 0.75 else palette.sanitary(rng)
    middle_z = -depth / 2 + z0 + depth_m / 2
    half_x, half_z = width_m / 2, depth_m / 2
    low = HEIGHT_M - 0.18
    parts.add(
        loft(
            [
                [
                    (half_x + 0.012, half_z + 0.012, HEIGHT_M + 0.003),
                    (half_x - 0.012, half_z - 0.012, HEIGHT_M + 0.003),
                ],
                [(half_x - 0.012, half_z - 0.012, HEIGHT_M + 0.003), (half_x - 0.02, half_z - 0.02, low + 0.02)],
                [(half_x - 0.02, half_z - 0.02, low + 0.02), (1e-3, 1e-3, low)],
            ],
            exponent=8,
            segments=32,
        ),
        bowl,
        (0, 0, middle_z),
    )
    _add_tap(parts, palette.chrome(rng), (0, HEIGHT_M, middle_z - half_z - 0.05), 0.25, 0.2)
    return parts.mesh()


def _add_tap(parts: Parts, metal: Material, at: tuple[Number, Number, Number], height_m: Number, reach: Number) -> None:
    """Add a bent spout with a lever."""
    x, y, z = at
    arc = [
        (x, y + height_m * 0.7 + 0.3 * height_m * np.sin(t), z + reach / 2 * (1 - np.cos(t)))
        for t in np.linspace(0, 2.6, 7)
    ]
    parts.add(tube([(x, y, z), (x, y + height_m * 0.35, z), *arc], 0.011, segments=8), metal)
    parts.bar(metal, (x, y, z), (x, y + 0.06, z), 0.02)
    parts.bar(metal, (x, y + 0.05, z), (x + 0.08, y + 0.075, z), 0.007, segments=6)


def wall_unit(width: Number, kind: str, rng: np.random.Generator) -> Draft:
    """Make a cabinet above the worktop: `doors`, `glass` or `open`."""
    style = draw_kitchen_style(rng)
    height = uniform(rng, 0.55, 0.9)
    depth = uniform(rng, 0.32, 0.37)

    def build() -> Mesh:
        parts = Parts()
        body = style.front.body
        if kind == "doors":
            place, size = (0.0, 0.0, -0.01), (width, height, depth - 0.04)
            parts.slab(body, size, place, radius=0)
            columns = 2 if width > 0.7 else 1
            add_fronts(parts, rng, style.front, place, size, FrontGrid(columns, 1, True, style.handle))
            return parts.mesh()
        board = 0.018
        depth_m = depth - (0.02 if kind == "glass" else 0.0)
        parts.blocks(
            body, [(board, height, depth_m, s * (width - board) / 2, 0, (depth_m - depth) / 2) for s in (-1, 1)]
        )
        parts.blocks(
            body,
            [(width - 2 * board, board, depth_m, 0, y, (depth_m - depth) / 2) for y in (0, height / 2, height - board)],
        )
        parts.slab(body, (width, height, 0.008), (0, 0, -depth / 2 + 0.004), radius=0)
        for y in (board, height / 2 + board):
            for x in np.linspace(-width / 2 + 0.09, width / 2 - 0.09, 4):
                r, height_m = uniform(rng, 0.03, 0.05), uniform(rng, 0.06, min(0.2, height * 0.36))
                parts.bar(palette.ceramic(rng), (x, y, -0.02), (x, y + height_m, -0.02), r * 0.8, r, segments=10)
        if kind == "glass":
            for s in (-1, 1):
                parts.add(
                    box(width / 2 - 0.03, height - 0.06, 0.004, radius=0.001, step=9, arcs=1),
                    palette.glass(),
                    (s * width / 4, 0.03, depth / 2 - 0.012),
                )
            parts.blocks(
                style.front.face,
                [(0.035, height, 0.02, x, 0, depth / 2 - 0.01) for x in (-width / 2 + 0.018, 0, width / 2 - 0.018)],
            )
            parts.blocks(style.front.face, [(width, 0.035, 0.02, 0, y, depth / 2 - 0.01) for y in (0, height - 0.035)])
        return parts.mesh()

    return Draft(f"wall unit, {kind}", (width, height, depth), build, elevation_m=uniform(rng, 1.4, 1.5))


def _add_oven_door(
    parts: Parts, rng: np.random.Generator, style: KitchenStyle, low: Number, high: Number, z: Number
) -> None:
    """Add a dark pane with a handle below a panel with knobs."""
    panel = style.steel if rng.random() < 0.6 else (palette.black(rng) if rng.random() < 0.5 else style.white)
    dark = replace(palette.black(rng), roughness=0.06)
    knobs = high - 0.1
    parts.slab(panel, (0.595, 0.1, 0.02), (0, knobs, z - 0.01), radius=0)
    parts.slab(panel, (0.595, knobs - low - 0.005, 0.02), (0, low, z - 0.01), radius=0)
    parts.slab(dark, (0.5, (knobs - low) * 0.62, 0.004), (0, low + (knobs - low) * 0.12, z + 0.001), radius=0)
    parts.bar(palette.chrome(rng), (-0.24, knobs - 0.05, z + 0.024), (0.24, knobs - 0.05, z + 0.024), 0.008)
    for x in np.linspace(-0.22, 0.22, int(rng.integers(3, 7))):
        parts.bar(palette.black(rng), (x, knobs + 0.05, z), (x, knobs + 0.05, z + 0.022), 0.018, segments=10)


def _add_hob(parts: Parts, rng: np.random.Generator, y: Number) -> None:
    """Add four rings on black glass, or a gas hob."""
    dark = replace(palette.black(rng), roughness=0.05)
    parts.slab(dark, (0.56, 0.006, 0.5), (0, y, 0), radius=0)
    ring = palette.metal(rng)
    gas = rng.random() < 0.4
    for x in (-0.14, 0.14):
        for z in (-0.12, 0.12):
            r = uniform(rng, 0.06, 0.1)
            if gas:
                parts.bar(palette.black(rng), (x, y, z), (x, y + 0.02, z), 0.035, segments=12)
                parts.blocks(dark, [(0.2, 0.01, 0.01, x, y + 0.025, z), (0.01, 0.01, 0.2, x, y + 0.025, z)])
            else:
                parts.bar(ring, (x, y + 0.004, z), (x, y + 0.007, z), r, segments=18)


def oven(rng: np.random.Generator) -> Draft:
    """Make a cooker between base units, with a hob on top."""
    style = draw_kitchen_style(rng)
    depth = style.depth_m

    def build() -> Mesh:
        parts = Parts()
        parts.slab(palette.black(rng), (0.6, 0.1, depth - 0.08), (0, 0, -0.03), radius=0)
        parts.slab(style.steel, (0.6, HEIGHT_M - _TOP_M - 0.11, depth - 0.06), (0, 0.1, -0.03), radius=0)
        _add_oven_door(parts, rng, style, 0.18, HEIGHT_M - _TOP_M, depth / 2 - 0.03)
        parts.slab(style.front.face, (0.595, 0.075, 0.02), (0, 0.1, depth / 2 - 0.035), radius=0)
        parts.slab(style.top, (0.6, _TOP_M, depth), (0, HEIGHT_M - _TOP_M, 0), radius=0)
        _add_hob(parts, rng, HEIGHT_M)
        return parts.mesh()

    return Draft("oven", (0.6, HEIGHT_M + 0.03, depth), build)


def dishwasher(rng: np.random.Generator) -> Draft:
    """Make a dishwasher with a front that matches its neighbours, or white or steel."""
    style = draw_kitchen_style(rng)
    depth = style.depth_m

    def build() -> Mesh:
        parts = Parts()
        _add_base(parts, rng, style, 0.6)
        kind = int(rng.integers(3))
        face = (style.front.face, style.white, style.steel)[kind]
        top = HEIGHT_M - _TOP_M
        parts.slab(face, (0.594, top - 0.24, 0.022), (0, 0.1, depth / 2 - 0.03), radius=0.003)
        parts.slab(face, (0.594, 0.12, 0.022), (0, top - 0.13, depth / 2 - 0.03), radius=0)
        if kind:
            parts.slab(palette.black(rng), (0.14, 0.05, 0.004), (0.12, top - 0.09, depth / 2 - 0.006), radius=0)
        parts.slab(palette.chrome(rng), (0.3, 0.02, 0.02), (0, top - 0.155, depth / 2 - 0.008), radius=0)
        return parts.mesh()

    return Draft("dishwasher", (0.6, HEIGHT_M, depth), build, top_m=HEIGHT_M)


def fridge(rng: np.random.Generator) -> Draft:
    """Make a fridge: tall, with a freezer, double-doored, or low; white, steel, or coloured."""
    style = draw_kitchen_style(rng)
    kind = int(rng.integers(4))
    width = uniform(rng, 0.84, 0.92) if kind == 3 else uniform(rng, 0.54, 0.66)
    height = uniform(rng, 0.84, 0.88) if kind == 0 else uniform(rng, 1.6, 2.0)
    depth = uniform(rng, 0.58, 0.7)

    def build() -> Mesh:
        parts = Parts()
        body = (style.white, style.steel, style.steel, style.front.face)[int(rng.integers(4))]
        radius = uniform(rng, 0.004, 0.05)
        parts.slab(palette.black(rng), (width - 0.04, 0.05, depth - 0.1), (0, 0, -0.03), radius=0)
        parts.slab(body, (width, height - 0.04, depth - 0.09), (0, 0.04, -0.045), radius=min(radius, 0.03), arcs=2)
        cut = height * (0.36 if kind == 1 else 0.7)
        spans = [(0.06, height - 0.004)] if kind in (0, 3) else [(0.06, cut - 0.005), (cut + 0.005, height - 0.004)]
        metal = palette.chrome(rng)
        columns = 2 if kind == 3 else 1
        for low, high in spans:
            for column in range(columns):
                part_width = width / columns
                x = -width / 2 + part_width * (column + 0.5)
                parts.slab(
                    body, (part_width - 0.006, high - low, 0.07), (x, low, depth / 2 - 0.065), radius=radius, arcs=2
                )
                edge = x + (part_width / 2 - 0.04) * (1 if column == 0 else -1)
                if columns == 1:
                    edge = x - (part_width / 2 - 0.045)
                height_m = min(0.4, (high - low) * 0.6)
                parts.slab(
                    metal, (0.02, height_m, 0.03), (edge, (low + high - height_m) / 2, depth / 2 - 0.015), radius=0
                )
        return parts.mesh()

    return Draft("fridge", (width, height, depth), build, top_m=height if kind == 0 else None)


def hood(rng: np.random.Generator) -> Draft:
    """Make a hood over the hob: a chimney, a slanted pane or a flat box."""
    style = draw_kitchen_style(rng)
    kind = int(rng.integers(3))
    width, depth = uniform(rng, 0.58, 0.9), uniform(rng, 0.4, 0.5)
    height = uniform(rng, 0.12, 0.2) if kind == 2 else uniform(rng, 0.6, 0.8)

    def build() -> Mesh:
        parts = Parts()
        steel = style.steel if rng.random() < 0.7 else palette.black(rng)
        if kind == 2:
            parts.slab(steel, (width, height, depth), radius=0.01)
        else:
            duct = 0.26
            parts.slab(steel, (duct, height - 0.06, duct), (0, 0.06, -depth / 2 + duct / 2), radius=0)
            if kind == 0:
                low, high = (width / 2, depth / 2, 0.05), (duct / 2, duct / 2, 0.28, 0, -depth / 2 + duct / 2)
                parts.add(
                    loft(
                        [[(1e-3, 1e-3, 0.05), low], [low, high], [high, (1e-3, 1e-3, 0.28, 0, -depth / 2 + duct / 2)]],
                        exponent=12,
                        segments=32,
                    ),
                    steel,
                )
                parts.slab(steel, (width, 0.06, depth), radius=0)
            else:
                parts.slab(steel, (width, 0.05, depth), (0, 0, 0), radius=0.01)
        parts.slab(palette.black(rng), (width * 0.3, 0.02, 0.004), (0, 0.015, depth / 2 + 0.001), radius=0)
        return parts.mesh()

    return Draft("extractor hood", (width, height, depth), build, elevation_m=uniform(rng, 1.5, 1.65))
