"""Wardrobes, dressers, bookcases with what stands in them, sideboards, television stands."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomlight_generator.rooms.props import palette
from roomlight_generator.rooms.props.draft import Draft, Kit, between
from roomlight_generator.rooms.props.seating import legs
from roomlight_generator.rooms.props.smalls import vessel
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, sphere


@dataclass(frozen=True, eq=False)
class Front:
    """Carcass, door and handle materials of a cupboard."""

    body: Material
    face: Material
    handle: Material


def fronts(
    kit: Kit,
    rng: np.random.Generator,
    front: Front,
    place: Sequence[Number],
    size: Sequence[Number],
    *,
    columns: int,
    rows: int,
    doors: bool = False,
    style: int | None = None,
) -> None:
    """Doors or drawers with handles before a carcass of `size` standing at `place` (middle of its bottom)."""
    x0, y0, z0 = place
    width, height, depth = size
    each, tall = (width - 0.012) / columns, (height - 0.012) / rows
    z = z0 + depth / 2 - 0.002
    style = int(rng.integers(5)) if style is None else style
    panel = rng.random() < 0.25 and doors
    for column in range(columns):
        for row in range(rows):
            x, y = x0 - width / 2 + 0.006 + each * (column + 0.5), y0 + 0.006 + tall * row
            kit.slab(front.face, (each - 0.006, tall - 0.006, 0.02), (x, y + 0.003, z + 0.01), radius=0)
            if panel and each > 0.25 and tall > 0.3:
                edge = 0.07
                bars = [
                    (edge, tall - 0.006, 0.008, x + s * (each - edge - 0.006) / 2, y + 0.003, z + 0.024)
                    for s in (-1, 1)
                ]
                bars += [
                    (each - 2 * edge - 0.006, edge, 0.008, x, at, z + 0.024)
                    for at in (y + 0.003, y + tall - edge - 0.003)
                ]
                kit.blocks(front.face, bars)
            _handle(kit, front.handle, style, x, y, z + 0.02, each, tall, doors, 1 if column % 2 == 0 else -1)


def _handle(
    kit: Kit,
    metal: Material,
    style: int,
    x: Number,
    y: Number,
    z: Number,
    each: Number,
    tall: Number,
    door: bool,
    side: int,
) -> None:
    """Knob, bar, wide bar, edge grip, or none."""
    if style == 4:
        return
    if door:
        middle = (x + side * (each / 2 - 0.045), y + tall * (0.5 if tall < 1.2 else 0.45))
        size = ((0.028, 0.028), (0.012, 0.14), (0.012, min(0.4, tall * 0.6)), (0.02, 0.05))[style]
    else:
        middle = (x, y + tall * (0.5 if style != 3 else 0.9))
        size = ((0.028, 0.028), (0.13, 0.012), (each * 0.6, 0.012), (0.06, 0.018))[style]
    if style == 0:
        kit.slab(metal, (0.028, 0.028, 0.026), (middle[0], middle[1] - 0.014, z + 0.011), radius=0.01)
    else:
        kit.blocks(metal, [(size[0], size[1], 0.02, middle[0], middle[1] - size[1] / 2, z + 0.008)])


def _cupboard(
    rng: np.random.Generator,
    name: str,
    size: tuple[Number, Number, Number],
    *,
    columns: int,
    rows: int,
    doors: bool,
    leg: tuple[Number, Number] = (0.0, 0.16),
    wooden: Number = 0.55,
    top_m: Number | None = None,
) -> Draft:
    width, height, depth = size

    def build() -> Mesh:
        kit = Kit()
        body = palette.wood_or_paint(rng, wooden)
        face = body if rng.random() < 0.65 else palette.wood_or_paint(rng, 0.3)
        front = Front(body, face, palette.metal(rng) if rng.random() < 0.7 else palette.wood(rng))
        raised = between(rng, *leg)
        place, carcass = (0.0, raised, -0.016), (width, height - raised, depth - 0.032)
        kit.slab(body, carcass, place, radius=0.004)
        if raised > 0.03:
            legs(kit, front.handle if rng.random() < 0.5 else body, (width - 0.1, depth - 0.12), raised + 0.005,
                 thick=between(rng, 0.012, 0.026), square=rng.random() < 0.4)  # fmt: skip
        fronts(kit, rng, front, place, carcass, columns=columns, rows=rows, doors=doors)
        return kit.mesh()

    return Draft(name, size, build, top_m=top_m)


def wardrobe(rng: np.random.Generator) -> Draft:
    """Two to four tall doors, hinged or sliding, some with a mirror."""
    doors = int(rng.choice([2, 2, 3, 4]))
    width, height, depth = doors * between(rng, 0.42, 0.58), between(rng, 1.85, 2.35), between(rng, 0.52, 0.66)
    if rng.random() < 0.65:
        return _cupboard(rng, "wardrobe", (width, height, depth), columns=doors, rows=1, doors=True, leg=(0.0, 0.08))

    def build() -> Mesh:
        kit = Kit()
        body, face = palette.wood_or_paint(rng), palette.wood_or_paint(rng, 0.4)
        kit.slab(body, (width, height, depth - 0.06), (0, 0, -0.03), radius=0.004)
        each = width / 2
        mirrored = int(rng.integers(3))
        for k in range(2):
            material = face
            if k < mirrored:
                material = Material("mirror", mirror=between(rng, 0.82, 0.9))
            x, z = (k - 0.5) * each, depth / 2 - (0.045 if k else 0.015)
            kit.slab(material, (each - 0.04, height - 0.1, 0.03), (x, 0.05, z), radius=0)
            kit.blocks(
                body, [(0.025, height - 0.06, 0.034, x + s * (each / 2 - 0.012), 0.03, z - 0.004) for s in (-1, 1)]
            )
            kit.blocks(body, [(each - 0.04, 0.03, 0.034, x, y, z - 0.004) for y in (0.03, height - 0.06)])
        return kit.mesh()

    return Draft("sliding wardrobe", (width, height, depth), build)


def dresser(rng: np.random.Generator) -> Draft:
    """A chest of drawers."""
    wide = rng.random() < 0.5
    size = (
        between(rng, 1.1, 1.6) if wide else between(rng, 0.6, 0.95),
        between(rng, 0.72, 1.2),
        between(rng, 0.4, 0.52),
    )
    rows = int(rng.integers(3, 6))
    return _cupboard(rng, "dresser", size, columns=2 if wide else 1, rows=rows, doors=False, top_m=size[1])


def sideboard(rng: np.random.Generator) -> Draft:
    """Low and long, with doors."""
    size = (between(rng, 1.1, 2.0), between(rng, 0.6, 0.9), between(rng, 0.38, 0.5))
    columns = int(rng.integers(2, 5))
    return _cupboard(rng, "sideboard", size, columns=columns, rows=1, doors=True, leg=(0.0, 0.2), top_m=size[1])


def tv_stand(rng: np.random.Generator) -> Draft:
    """Lower still, with open compartments between doors or drawers."""
    width, height, depth = between(rng, 1.1, 2.1), between(rng, 0.34, 0.58), between(rng, 0.36, 0.46)

    def build() -> Mesh:
        kit = Kit()
        body = palette.wood_or_paint(rng, 0.55)
        face = body if rng.random() < 0.5 else palette.wood_or_paint(rng, 0.3)
        leg = between(rng, 0.0, 0.16)
        board = between(rng, 0.016, 0.03)
        if leg > 0.03:
            legs(kit, palette.metal(rng), (width - 0.12, depth - 0.1), leg + 0.004, thick=0.014)
        else:
            leg = 0.0
        kit.blocks(body, [(width, board, depth, 0, y, 0) for y in (leg, height - board)])
        columns = int(rng.integers(2, 5))
        edges = np.linspace(-(width - board) / 2, (width - board) / 2, columns + 1)
        kit.blocks(body, [(board, height - leg - 2 * board, depth - 0.004, x, leg + board, 0) for x in edges])
        kit.blocks(body, [(width - 0.01, height - leg - 0.01, 0.008, 0, leg + 0.005, -depth / 2 + 0.008)])
        front = Front(body, face, palette.metal(rng))
        for k in range(columns):
            x, each = float(edges[k] + edges[k + 1]) / 2, float(edges[1] - edges[0]) - board
            if rng.random() < 0.5:
                place, size = (x, leg + board, -0.02), (each, height - leg - 2 * board, depth - 0.04)
                fronts(kit, rng, front, place, size, columns=1, rows=int(rng.integers(1, 3)))
            else:
                kit.slab(body, (each, 0.015, depth - 0.05), (x, (leg + height) / 2, -0.01), radius=0)
                if rng.random() < 0.6:
                    box = (each * between(rng, 0.4, 0.8), 0.05, depth * 0.6)
                    kit.slab(palette.black(rng), box, (x, leg + board, 0), radius=0)
        return kit.mesh()

    return Draft("television stand", (width, height, depth), build, top_m=height)


def shelf_of_things(
    kit: Kit, rng: np.random.Generator, low: Number, high: Number, floor: Number, gap: Number, depth: Number, z: Number
) -> None:
    """Books (sixty in a hundred shelves full of them), boxes, vases and balls from x = low to high on one shelf.

    z is the shelf's middle; books stand with their backs toward +z.
    """
    covers = [palette.cover(rng) for _ in range(7)]
    piles: list[list[tuple[float, ...]]] = [[] for _ in covers]
    pages: list[tuple[float, ...]] = []
    page = palette.paper(rng)
    x = low + 0.01
    full = rng.random() < 0.6
    while x < high - 0.06:
        kind = rng.random()
        if kind < (0.8 if full else 0.35):
            for _ in range(int(rng.integers(4, 16))):
                thick = between(rng, 0.015, 0.05)
                tall = min(between(rng, 0.17, 0.31), gap * 0.95)
                deep = min(between(rng, 0.13, 0.23), depth * 0.9)
                if x + thick > high - 0.01:
                    break
                front = z + depth / 2 - 0.015 - deep / 2
                k = int(rng.integers(len(covers)))
                piles[k].append((thick - 0.001, tall, deep, x + thick / 2, floor, front))
                x += thick
        elif kind < 0.88 and high - x > 0.24:
            y, across = floor, between(rng, 0.17, 0.23)
            for _ in range(int(rng.integers(2, 5))):
                thick = between(rng, 0.015, 0.04)
                if y + thick > floor + gap * 0.9:
                    break
                k = int(rng.integers(len(covers)))
                deep = min(between(rng, 0.14, 0.2), depth * 0.9)
                piles[k].append((across, 0.003, deep, x + across / 2, y, z))
                piles[k].append((across, 0.003, deep, x + across / 2, y + thick - 0.003, z))
                pages.append((across - 0.01, thick - 0.006, deep - 0.012, x + across / 2, y + 0.003, z))
                y += thick
            x += across + 0.02
        elif kind < 0.94 and high - x > 0.2:
            side = min(between(rng, 0.12, 0.3), gap * 0.85, high - x - 0.02)
            box = palette.cardboard(rng) if rng.random() < 0.4 else palette.cloth(rng)
            kit.slab(box, (side, side * 0.8, min(side, depth * 0.9)), (x + side / 2, floor, z), radius=0.006)
            x += side + 0.03
        elif rng.random() < 0.7:
            tall = min(between(rng, 0.1, 0.28), gap * 0.85)
            across = min(tall * 0.6, depth * 0.8, 0.18)
            if high - x < across + 0.02:
                break
            kit.put(vessel(rng, tall, across, segments=12), (x + across / 2, floor, z))
            x += across + between(rng, 0.02, 0.12)
        else:
            radius = min(between(rng, 0.03, 0.06), gap * 0.4)
            kit.add(sphere(radius, rings=7, segments=12), palette.paint(rng), (x + radius, floor + radius, z))
            x += 2 * radius + 0.05
        x += between(rng, 0.0, 0.03 if full else 0.2)
    for cover, pile in zip(covers, piles, strict=True):
        kit.blocks(cover, pile)
    kit.blocks(page, pages)


def bookcase(rng: np.random.Generator) -> Draft:
    """Open shelves with books and things; narrow, wide, low, or a grid of cubes."""
    kind = int(rng.integers(4))
    depth = between(rng, 0.24, 0.38)
    width, height = (
        (between(rng, 0.4, 0.6), between(rng, 1.7, 2.2)),
        (between(rng, 0.75, 1.25), between(rng, 1.7, 2.2)),
        (between(rng, 0.8, 1.5), between(rng, 0.75, 1.15)),
        (between(rng, 1.1, 1.55), between(rng, 1.1, 1.55)),
    )[kind]

    def build() -> Mesh:
        kit = Kit()
        body = palette.wood_or_paint(rng, 0.6)
        board = between(rng, 0.016, 0.035)
        columns = 1 if kind in (0, 2) else (int(rng.choice([1, 2])) if kind == 1 else 4 if width > 1.3 else 3)
        gap = between(rng, 0.28, 0.4)
        shelves = max(2, round((height - 0.04) / gap))
        foot = between(rng, 0.0, 0.08)
        gap = (height - foot - board) / shelves
        levels = [foot + gap * k for k in range(shelves + 1)]
        kit.blocks(body, [(width - 2 * board, board, depth - 0.004, 0, y, 0) for y in levels])
        edges = np.linspace(-(width - board) / 2, (width - board) / 2, columns + 1)
        kit.blocks(body, [(board, height - (0 if k in (0, columns) else board), depth, float(x), 0, 0)
                          for k, x in enumerate(edges)])  # fmt: skip
        if rng.random() < 0.75:
            back = body if rng.random() < 0.7 else palette.paint(rng)
            kit.slab(back, (width - 0.01, height - 0.02 - foot, 0.008), (0, foot + 0.01, -depth / 2 + 0.006), radius=0)
        for k in range(columns):
            for y in levels[:-1]:
                if rng.random() < 0.12:
                    continue
                shelf_of_things(
                    kit, rng, float(edges[k]) + board / 2, float(edges[k + 1]) - board / 2, y + board, gap - board,
                    depth - 0.04, 0.01,
                )  # fmt: skip
        return kit.mesh()

    return Draft("bookcase", (width, height, depth), build, top_m=height if height < 1.3 else None)
