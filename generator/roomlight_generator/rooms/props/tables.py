"""Dining, coffee and side tables, desks, nightstands."""

from itertools import pairwise

import numpy as np

from roomlight_generator.rooms.props import palette
from roomlight_generator.rooms.props.draft import Draft, Parts, circle_points, uniform
from roomlight_generator.rooms.props.seating import add_legs
from roomlight_generator.rooms.props.storage import FrontGrid, FrontMaterials, add_fronts
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, loft


def add_round_top(
    parts: Parts, material: Material, half_x: Number, half_z: Number, thickness: Number, y: Number
) -> None:
    """Add a round or oval board with its underside at y."""
    edge = min(0.008, thickness * 0.4)
    parts.add(
        loft(
            [
                [(1e-3, 1e-3, 0.0), (half_x - edge, half_z - edge, 0.0)],
                [
                    (half_x - edge, half_z - edge, 0.0),
                    (half_x, half_z, thickness / 2),
                    (half_x - edge, half_z - edge, thickness),
                ],
                [
                    (half_x - edge, half_z - edge, thickness),
                    (half_x / 2, half_z / 2, thickness),
                    (1e-3, 1e-3, thickness),
                ],
            ],
            segments=36,
        ),
        material,
        (0, y, 0),
    )


def _add_supports(
    parts: Parts, rng: np.random.Generator, material: Material, width: Number, depth: Number, height: Number
) -> None:
    """Add the supports of a table top of this size whose underside is at `height`."""
    kind = int(rng.integers(6))
    thickness = float(np.clip(height * 0.045, 0.014, 0.036)) * uniform(rng, 0.8, 1.3)
    inset = uniform(rng, 0.03, 0.1)
    if kind <= 2:
        # Square and straight, round and tapering, or splayed.
        splay = 0.0 if kind < 2 else min(0.06, inset)
        size = (width - 2 * inset - 2 * thickness, depth - 2 * inset - 2 * thickness)
        add_legs(parts, material, size, height, thickness=thickness, square=kind == 0, splay=splay)
        if kind < 2:
            apron = min(0.09, height * 0.14)
            for x in (-1, 1):
                parts.slab(material, (0.02, apron, size[1]), (x * size[0] / 2, height - apron, 0), radius=0)
            for z in (-1, 1):
                parts.slab(material, (size[0], apron, 0.02), (0, height - apron, z * size[1] / 2), radius=0)
    elif kind == 3:
        for x in (-1, 1):
            edge = x * (width / 2 - inset - 0.03)
            path = [(edge, height, -depth * 0.4), (edge, 0.01, -depth * 0.4), (edge, 0.01, depth * 0.4),
                    (edge, height, depth * 0.4)]  # fmt: skip
            for start, end in pairwise(path):
                parts.bar(material, start, end, 0.018 if height > 0.6 else 0.01, segments=6)
    elif kind == 4:
        for x in (-1, 1):
            for z in (-1, 1):
                corner = np.array([x * (width / 2 - inset - 0.05), 0, z * (depth / 2 - inset - 0.05)])
                foot = corner + np.array([x * 0.03, 0, z * 0.03])
                for shift in (-0.035, 0.035):
                    parts.bar(material, foot, corner + np.array([shift, height, -shift * z * x]), 0.006, segments=6)
    else:
        for x in (-1, 1):
            edge = x * (width / 2 - inset - 0.06)
            parts.slab(material, (0.07, height, 0.05), (edge, 0, 0), radius=0)
            parts.slab(material, (0.08, 0.04, depth * 0.8), (edge, 0, 0), radius=0)
        parts.slab(material, (width - 2 * inset - 0.12, 0.06, 0.03), (0, height * 0.3, 0), radius=0)


def _add_pedestal(parts: Parts, rng: np.random.Generator, material: Material, reach: Number, height: Number) -> None:
    """Add a central column on a disc or on feet."""
    column = uniform(rng, 0.02, 0.06)
    parts.bar(material, (0, 0.015, 0), (0, height, 0), column * 1.3, column, segments=14)
    if rng.random() < 0.5:
        add_round_top(parts, material, reach, reach, 0.02, 0)
    else:
        for x, z in circle_points(int(rng.choice([3, 4])), reach, 0.5):
            parts.bar(material, (0, height * 0.25, 0), (x, 0.02, z), column * 0.7, 0.016)


def _table(rng: np.random.Generator, name: str, width: Number, depth: Number, height: Number, round_one: bool) -> Draft:
    def build() -> Mesh:
        parts = Parts()
        material = palette.wood_or_paint(rng, 0.75)
        thickness = uniform(rng, 0.018, 0.045)
        top = material
        if rng.random() < 0.12:
            top, thickness = palette.glass(), 0.01
        elif rng.random() < 0.15:
            top = palette.worktop(rng)
        under = material if rng.random() < 0.55 else (palette.metal(rng) if rng.random() < 0.6 else palette.paint(rng))
        if round_one:
            add_round_top(parts, top, width / 2, depth / 2, thickness, height - thickness)
            if rng.random() < 0.5:
                _add_pedestal(parts, rng, under, min(width, depth) * 0.32, height - thickness)
            else:
                add_legs(
                    parts,
                    under,
                    (width * 0.5, depth * 0.5),
                    height - thickness,
                    thickness=0.022 if height > 0.6 else 0.016,
                    splay=width * 0.07,
                )
        else:
            parts.slab(top, (width, thickness, depth), (0, height - thickness, 0), radius=min(0.006, thickness / 3))
            _add_supports(parts, rng, under, width, depth, height - thickness)
        return parts.mesh()

    return Draft(name, (width, height, depth), build, top_m=height)


def dining_table(rng: np.random.Generator) -> Draft:
    """Make a dining table for four to ten, rectangular, round or oval."""
    if rng.random() < 0.35:
        width = uniform(rng, 0.85, 1.4)
        depth = width if rng.random() < 0.7 else width * uniform(rng, 0.65, 0.9)
        return _table(rng, "round dining table", width, depth, uniform(rng, 0.72, 0.77), True)
    return _table(
        rng, "dining table", uniform(rng, 1.2, 2.3), uniform(rng, 0.75, 1.02), uniform(rng, 0.72, 0.77), False
    )


def side_table(rng: np.random.Generator) -> Draft:
    """Make a small table for the side of a sofa."""
    width = uniform(rng, 0.34, 0.6)
    if rng.random() < 0.5:
        return _table(rng, "round side table", width, width, uniform(rng, 0.42, 0.62), True)
    return _table(rng, "side table", width, uniform(rng, 0.3, 0.55), uniform(rng, 0.42, 0.62), False)


def coffee_table(rng: np.random.Generator) -> Draft:
    """Make a coffee table on legs, a chest or box, with or without a shelf."""
    height = uniform(rng, 0.34, 0.48)
    kind = rng.random()
    if kind < 0.3:
        width = uniform(rng, 0.6, 1.05)
        return _table(rng, "round coffee table", width, width * uniform(rng, 0.7, 1.0), height, True)
    width, depth = uniform(rng, 0.8, 1.35), uniform(rng, 0.45, 0.75)
    if kind < 0.7:
        return _table(rng, "coffee table", width, depth, height, False)

    def build() -> Mesh:
        parts = Parts()
        body = palette.wood_or_paint(rng, 0.7)
        parts.slab(body, (width, 0.04, depth), (0, height - 0.04, 0))
        if rng.random() < 0.5:
            for x in (-1, 1):
                parts.slab(body, (0.04, height - 0.04, depth), (x * (width / 2 - 0.02), 0, 0))
            parts.slab(body, (width - 0.06, 0.025, depth - 0.03), (0, uniform(rng, 0.04, 0.16), 0), radius=0)
        else:
            parts.slab(body, (width - 0.04, height - 0.1, depth - 0.04), (0, 0.06, 0))
            parts.slab(palette.black(rng), (width - 0.14, 0.06, depth - 0.14), (0, 0, 0), radius=0)
            handle = palette.metal(rng)
            for x in (-1, 1):
                parts.slab(handle, (0.1, 0.012, 0.02), (x * width / 4, height * 0.55, depth / 2 - 0.012), radius=0)
                parts.blocks(
                    palette.black(rng), [(0.004, height - 0.14, 0.004, x * width / 700, 0.08, depth / 2 - 0.02)]
                )
        return parts.mesh()

    return Draft("box coffee table", (width, height, depth), build, top_m=height)


def desk(rng: np.random.Generator) -> Draft:
    """Make a desk on four legs, on trestles, on a block of drawers, or L-shaped."""
    width, depth, height = uniform(rng, 0.95, 1.8), uniform(rng, 0.5, 0.8), uniform(rng, 0.71, 0.77)
    kind = int(rng.integers(4))
    wing = uniform(rng, 0.4, 0.7) if kind == 3 and width > 1.3 else 0.0

    def build() -> Mesh:
        parts = Parts()
        top = palette.wood_or_paint(rng, 0.65)
        under = top if rng.random() < 0.5 else palette.metal(rng)
        thickness = uniform(rng, 0.018, 0.04)
        below = height - thickness
        back = -(depth + wing) / 2
        parts.slab(top, (width, thickness, depth), (0, below, back + depth / 2))
        middle = (0.0, back + depth / 2)
        if kind == 1:
            for x in (-1, 1):
                for z in (-1, 1):
                    for lean in (-1, 1):
                        edge = x * (width / 2 - 0.25)
                        z0 = middle[1] + z * depth * 0.36
                        parts.bar(
                            under, (edge + lean * 0.17, 0, z0), (edge + lean * 0.03, below, z0), 0.015, segments=6
                        )
        elif kind == 2:
            block = uniform(rng, 0.36, 0.46)
            body = (block, below - 0.04, depth - 0.06)
            place = (width / 2 - block / 2 - 0.02, 0.04, middle[1])
            parts.slab(top, body, place)
            add_fronts(
                parts,
                rng,
                FrontMaterials(top, top, palette.metal(rng)),
                place,
                body,
                FrontGrid(1, int(rng.integers(3, 5))),
            )
            parts.slab(under, (0.04, below, depth - 0.06), (-width / 2 + 0.04, 0, middle[1]), radius=0)
        else:
            add_legs(
                parts,
                under,
                (width - 0.1, depth - 0.1),
                below,
                thickness=0.022,
                square=rng.random() < 0.6,
                middle=middle,
            )
        if wing:
            side = 1 if rng.random() < 0.5 else -1
            x = side * (width / 2 - 0.25)
            parts.slab(top, (0.5, thickness, wing), (x, below, depth / 2), radius=0)
            add_legs(parts, under, (0.4, wing - 0.1), below, thickness=0.02, middle=(x, depth / 2))
        elif rng.random() < 0.4:
            parts.slab(top, (width - 0.2, uniform(rng, 0.2, 0.4), 0.016), (0, below - 0.42, back + 0.08), radius=0)
        return parts.mesh()

    return Draft("desk", (width, height, depth + wing), build, top_m=height)


def nightstand(rng: np.random.Generator) -> Draft:
    """Make a nightstand with drawers, or an open cube."""
    width, depth, height = uniform(rng, 0.36, 0.58), uniform(rng, 0.32, 0.45), uniform(rng, 0.4, 0.65)

    def build() -> Mesh:
        parts = Parts()
        body = palette.wood_or_paint(rng, 0.6)
        leg = uniform(rng, 0.0, 0.2)
        thickness = 0.02
        if rng.random() < 0.35:
            parts.blocks(body, [(thickness, height - leg, depth, x * (width - thickness) / 2, leg, 0) for x in (-1, 1)])
            levels = (leg, leg + (height - leg) * uniform(rng, 0.35, 0.6), height - thickness)
            parts.blocks(body, [(width - thickness, thickness, depth - 0.002, 0, y, 0) for y in levels])
            parts.slab(body, (width - thickness, height - leg, 0.01), (0, leg, -depth / 2 + 0.006), radius=0)
        else:
            size, place = (width, height - leg, depth - 0.02), (0.0, leg, -0.01)
            parts.slab(body, size, place)
            face = body if rng.random() < 0.7 else palette.paint(rng)
            add_fronts(
                parts,
                rng,
                FrontMaterials(body, face, palette.metal(rng)),
                place,
                size,
                FrontGrid(1, int(rng.integers(1, 4))),
            )
        if leg > 0.02:
            under = body if rng.random() < 0.6 else palette.metal(rng)
            add_legs(parts, under, (width - 0.07, depth - 0.07), leg + 0.005, thickness=0.014)
        return parts.mesh()

    return Draft("nightstand", (width, height, depth), build, top_m=height)
