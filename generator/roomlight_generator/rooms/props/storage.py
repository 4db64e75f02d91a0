"""Wardrobes, dressers, bookcases with contents, sideboards, television stands."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomlight_generator.rooms.props import palette
from roomlight_generator.rooms.props.draft import Draft, Parts, uniform
from roomlight_generator.rooms.props.seating import add_legs
from roomlight_generator.rooms.props.small_objects import vessel
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, sphere


@dataclass(frozen=True, eq=False)
class FrontMaterials:
    """Carcass, door and handle materials of a cabinet."""

    body: Material
    face: Material
    handle: Material


@dataclass(frozen=True)
class FrontGrid:
    """A grid of doors or drawers. handle_style: 0 knob, 1 bar, 2 wide bar, 3 edge grip, 4 none; None: random."""

    columns: int
    rows: int
    doors: bool = False
    handle_style: int | None = None


@dataclass(frozen=True)
class _Panel:
    """One door or drawer front: centre of its bottom edge, size, and the side of a door's handle (-1 left, 1 right)."""

    x: Number
    y: Number
    z: Number
    width: Number
    height: Number
    door: bool
    handle_side: int


def add_fronts(
    parts: Parts,
    rng: np.random.Generator,
    front: FrontMaterials,
    place: Sequence[Number],
    size: Sequence[Number],
    grid: FrontGrid,
) -> None:
    """Add doors or drawers with handles in front of a carcass of `size` whose bottom centre is at `place`."""
    x0, y0, z0 = place
    width, height, depth = size
    part_width, height_m = (width - 0.012) / grid.columns, (height - 0.012) / grid.rows
    z = z0 + depth / 2 - 0.002
    style = int(rng.integers(5)) if grid.handle_style is None else grid.handle_style
    framed = rng.random() < 0.25 and grid.doors
    for column in range(grid.columns):
        for row in range(grid.rows):
            x, y = x0 - width / 2 + 0.006 + part_width * (column + 0.5), y0 + 0.006 + height_m * row
            parts.slab(front.face, (part_width - 0.006, height_m - 0.006, 0.02), (x, y + 0.003, z + 0.01), radius=0)
            if framed and part_width > 0.25 and height_m > 0.3:
                edge = 0.07
                bars = [
                    (edge, height_m - 0.006, 0.008, x + s * (part_width - edge - 0.006) / 2, y + 0.003, z + 0.024)
                    for s in (-1, 1)
                ]
                bars += [
                    (part_width - 2 * edge - 0.006, edge, 0.008, x, at, z + 0.024)
                    for at in (y + 0.003, y + height_m - edge - 0.003)
                ]
                parts.blocks(front.face, bars)
            panel = _Panel(x, y, z + 0.02, part_width, height_m, grid.doors, 1 if column % 2 == 0 else -1)
            _add_handle(parts, front.handle, style, panel)


def _add_handle(parts: Parts, metal: Material, style: int, panel: _Panel) -> None:
    """Add a knob, bar, wide bar, edge grip, or nothing."""
    if style == 4:
        return
    x, y, z, height_m = panel.x, panel.y, panel.z, panel.height
    if panel.door:
        middle = (x + panel.handle_side * (panel.width / 2 - 0.045), y + height_m * (0.5 if height_m < 1.2 else 0.45))
        size = ((0.028, 0.028), (0.012, 0.14), (0.012, min(0.4, height_m * 0.6)), (0.02, 0.05))[style]
    else:
        middle = (x, y + height_m * (0.5 if style != 3 else 0.9))
        size = ((0.028, 0.028), (0.13, 0.012), (panel.width * 0.6, 0.012), (0.06, 0.018))[style]
    if style == 0:
        parts.slab(metal, (0.028, 0.028, 0.026), (middle[0], middle[1] - 0.014, z + 0.011), radius=0.01)
    else:
        parts.blocks(metal, [(size[0], size[1], 0.02, middle[0], middle[1] - size[1] / 2, z + 0.008)])


def _cupboard(
    rng: np.random.Generator,
    name: str,
    size: tuple[Number, Number, Number],
    grid: FrontGrid,
    *,
    leg: tuple[Number, Number] = (0.0, 0.16),
    wooden: Number = 0.55,
    top_m: Number | None = None,
) -> Draft:
    width, height, depth = size

    def build() -> Mesh:
        parts = Parts()
        body = palette.wood_or_paint(rng, wooden)
        face = body if rng.random() < 0.65 else palette.wood_or_paint(rng, 0.3)
        front = FrontMaterials(body, face, palette.metal(rng) if rng.random() < 0.7 else palette.wood(rng))
        raised = uniform(rng, *leg)
        place, carcass = (0.0, raised, -0.016), (width, height - raised, depth - 0.032)
        parts.slab(body, carcass, place, radius=0.004)
        if raised > 0.03:
            add_legs(
                parts,
                front.handle if rng.random() < 0.5 else body,
                (width - 0.1, depth - 0.12),
                raised + 0.005,
                thickness=uniform(rng, 0.012, 0.026),
                square=rng.random() < 0.4,
            )
        add_fronts(parts, rng, front, place, carcass, grid)
        return parts.mesh()

    return Draft(name, size, build, top_m=top_m)


def wardrobe(rng: np.random.Generator) -> Draft:
    """Make two to four tall doors, hinged or sliding, some with a mirror."""
    doors = int(rng.choice([2, 2, 3, 4]))
    width, height, depth = doors * uniform(rng, 0.42, 0.58), uniform(rng, 1.85, 2.35), uniform(rng, 0.52, 0.66)
    if rng.random() < 0.65:
        return _cupboard(rng, "wardrobe", (width, height, depth), FrontGrid(doors, 1, doors=True), leg=(0.0, 0.08))

    def build() -> Mesh:
        parts = Parts()
        body, face = palette.wood_or_paint(rng), palette.wood_or_paint(rng, 0.4)
        parts.slab(body, (width, height, depth - 0.06), (0, 0, -0.03), radius=0.004)
        part_width = width / 2
        mirrored = int(rng.integers(3))
        for k in range(2):
            material = face
            if k < mirrored:
                material = Material("mirror", mirror=uniform(rng, 0.82, 0.9))
            x, z = (k - 0.5) * part_width, depth / 2 - (0.045 if k else 0.015)
            parts.slab(material, (part_width - 0.04, height - 0.1, 0.03), (x, 0.05, z), radius=0)
            parts.blocks(
                body,
                [(0.025, height - 0.06, 0.034, x + s * (part_width / 2 - 0.012), 0.03, z - 0.004) for s in (-1, 1)],
            )
            parts.blocks(body, [(part_width - 0.04, 0.03, 0.034, x, y, z - 0.004) for y in (0.03, height - 0.06)])
        return parts.mesh()

    return Draft("sliding wardrobe", (width, height, depth), build)


def dresser(rng: np.random.Generator) -> Draft:
    """Make a chest of drawers."""
    width_m = rng.random() < 0.5
    size = (
        uniform(rng, 1.1, 1.6) if width_m else uniform(rng, 0.6, 0.95),
        uniform(rng, 0.72, 1.2),
        uniform(rng, 0.4, 0.52),
    )
    rows = int(rng.integers(3, 6))
    return _cupboard(rng, "dresser", size, FrontGrid(2 if width_m else 1, rows), top_m=size[1])


def sideboard(rng: np.random.Generator) -> Draft:
    """Make a long low cabinet with doors."""
    size = (uniform(rng, 1.1, 2.0), uniform(rng, 0.6, 0.9), uniform(rng, 0.38, 0.5))
    columns = int(rng.integers(2, 5))
    return _cupboard(rng, "sideboard", size, FrontGrid(columns, 1, doors=True), leg=(0.0, 0.2), top_m=size[1])


def tv_stand(rng: np.random.Generator) -> Draft:
    """Make a low stand with open compartments between doors or drawers."""
    width, height, depth = uniform(rng, 1.1, 2.1), uniform(rng, 0.34, 0.58), uniform(rng, 0.36, 0.46)

    def build() -> Mesh:
        parts = Parts()
        body = palette.wood_or_paint(rng, 0.55)
        face = body if rng.random() < 0.5 else palette.wood_or_paint(rng, 0.3)
        leg = uniform(rng, 0.0, 0.16)
        board = uniform(rng, 0.016, 0.03)
        if leg > 0.03:
            add_legs(parts, palette.metal(rng), (width - 0.12, depth - 0.1), leg + 0.004, thickness=0.014)
        else:
            leg = 0.0
        parts.blocks(body, [(width, board, depth, 0, y, 0) for y in (leg, height - board)])
        columns = int(rng.integers(2, 5))
        edges = np.linspace(-(width - board) / 2, (width - board) / 2, columns + 1)
        parts.blocks(body, [(board, height - leg - 2 * board, depth - 0.004, x, leg + board, 0) for x in edges])
        parts.blocks(body, [(width - 0.01, height - leg - 0.01, 0.008, 0, leg + 0.005, -depth / 2 + 0.008)])
        front = FrontMaterials(body, face, palette.metal(rng))
        for k in range(columns):
            x, part_width = float(edges[k] + edges[k + 1]) / 2, float(edges[1] - edges[0]) - board
            if rng.random() < 0.5:
                place, size = (x, leg + board, -0.02), (part_width, height - leg - 2 * board, depth - 0.04)
                add_fronts(parts, rng, front, place, size, FrontGrid(1, int(rng.integers(1, 3))))
            else:
                parts.slab(body, (part_width, 0.015, depth - 0.05), (x, (leg + height) / 2, -0.01), radius=0)
                if rng.random() < 0.6:
                    box = (part_width * uniform(rng, 0.4, 0.8), 0.05, depth * 0.6)
                    parts.slab(palette.black(rng), box, (x, leg + board, 0), radius=0)
        return parts.mesh()

    return Draft("television stand", (width, height, depth), build, top_m=height)


def fill_shelf(
    parts: Parts,
    rng: np.random.Generator,
    low: Number,
    high: Number,
    floor: Number,
    gap: Number,
    depth: Number,
    z: Number,
) -> None:
    """Fill one shelf from x = low to high with books (60 % of shelves are full of them), boxes, vases and spheres.

    z is the shelf's middle; book spines face +z.
    """
    covers = [palette.book_cover(rng) for _ in range(7)]
    piles: list[list[tuple[float, ...]]] = [[] for _ in covers]
    pages: list[tuple[float, ...]] = []
    page = palette.paper(rng)
    x = low + 0.01
    full = rng.random() < 0.6
    while x < high - 0.06:
        kind = rng.random()
        if kind < (0.8 if full else 0.35):
            for _ in range(int(rng.integers(4, 16))):
                thickness = uniform(rng, 0.015, 0.05)
                height_m = min(uniform(rng, 0.17, 0.31), gap * 0.95)
                depth_m = min(uniform(rng, 0.13, 0.23), depth * 0.9)
                if x + thickness > high - 0.01:
                    break
                front = z + depth / 2 - 0.015 - depth_m / 2
                k = int(rng.integers(len(covers)))
                piles[k].append((thickness - 0.001, height_m, depth_m, x + thickness / 2, floor, front))
                x += thickness
        elif kind < 0.88 and high - x > 0.24:
            y, across = floor, uniform(rng, 0.17, 0.23)
            for _ in range(int(rng.integers(2, 5))):
                thickness = uniform(rng, 0.015, 0.04)
                if y + thickness > floor + gap * 0.9:
                    break
                k = int(rng.integers(len(covers)))
                depth_m = min(uniform(rng, 0.14, 0.2), depth * 0.9)
                piles[k].append((across, 0.003, depth_m, x + across / 2, y, z))
                piles[k].append((across, 0.003, depth_m, x + across / 2, y + thickness - 0.003, z))
                pages.append((across - 0.01, thickness - 0.006, depth_m - 0.012, x + across / 2, y + 0.003, z))
                y += thickness
            x += across + 0.02
        elif kind < 0.94 and high - x > 0.2:
            side = min(uniform(rng, 0.12, 0.3), gap * 0.85, high - x - 0.02)
            box = palette.cardboard(rng) if rng.random() < 0.4 else palette.cloth(rng)
            parts.slab(box, (side, side * 0.8, min(side, depth * 0.9)), (x + side / 2, floor, z), radius=0.006)
            x += side + 0.03
        elif rng.random() < 0.7:
            height_m = min(uniform(rng, 0.1, 0.28), gap * 0.85)
            across = min(height_m * 0.6, depth * 0.8, 0.18)
            if high - x < across + 0.02:
                break
            parts.add_mesh(vessel(rng, height_m, across, segments=12), (x + across / 2, floor, z))
            x += across + uniform(rng, 0.02, 0.12)
        else:
            radius = min(uniform(rng, 0.03, 0.06), gap * 0.4)
            parts.add(sphere(radius, rings=7, segments=12), palette.paint(rng), (x + radius, floor + radius, z))
            x += 2 * radius + 0.05
        x += uniform(rng, 0.0, 0.03 if full else 0.2)
    for cover, pile in zip(covers, piles, strict=True):
        parts.blocks(cover, pile)
    parts.blocks(page, pages)


def bookcase(rng: np.random.Generator) -> Draft:
    """Make open shelves with books and objects; narrow, wide, low, or a grid of cubes."""
    kind = int(rng.integers(4))
    depth = uniform(rng, 0.24, 0.38)
    width, height = (
        (uniform(rng, 0.4, 0.6), uniform(rng, 1.7, 2.2)),
        (uniform(rng, 0.75, 1.25), uniform(rng, 1.7, 2.2)),
        (uniform(rng, 0.8, 1.5), uniform(rng, 0.75, 1.15)),
        (uniform(rng, 1.1, 1.55), uniform(rng, 1.1, 1.55)),
    )[kind]

    def build() -> Mesh:
        parts = Parts()
        body = palette.wood_or_paint(rng, 0.6)
        board = uniform(rng, 0.016, 0.035)
        columns = 1 if kind in (0, 2) else (int(rng.choice([1, 2])) if kind == 1 else 4 if width > 1.3 else 3)
        gap = uniform(rng, 0.28, 0.4)
        shelves = max(2, round((height - 0.04) / gap))
        foot = uniform(rng, 0.0, 0.08)
        gap = (height - foot - board) / shelves
        levels = [foot + gap * k for k in range(shelves + 1)]
        parts.blocks(body, [(width - 2 * board, board, depth - 0.004, 0, y, 0) for y in levels])
        edges = np.linspace(-(width - board) / 2, (width - board) / 2, columns + 1)
        parts.blocks(
            body,
            [(board, height - (0 if k in (0, columns) else board), depth, float(x), 0, 0) for k, x in enumerate(edges)],
        )
        if rng.random() < 0.75:
            back = body if rng.random() < 0.7 else palette.paint(rng)
            parts.slab(
                back, (width - 0.01, height - 0.02 - foot, 0.008), (0, foot + 0.01, -depth / 2 + 0.006), radius=0
            )
        for k in range(columns):
            for y in levels[:-1]:
                if rng.random() < 0.12:
                    continue
                fill_shelf(
                    parts, rng, float(edges[k]) + board / 2, float(edges[k + 1]) - board / 2, y + board, gap - board,
                    depth - 0.04, 0.01,
                )  # fmt: skip
        return parts.mesh()

    return Draft("bookcase", (width, height, depth), build, top_m=height if height < 1.3 else None)
