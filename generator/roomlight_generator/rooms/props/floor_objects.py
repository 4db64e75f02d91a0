"""Boxes, baskets, bins and bags; large toys; exercise machines."""

from functools import partial

import numpy as np

from roomlight_generator.rooms.props import palette, textures
from roomlight_generator.rooms.props.draft import Draft, Parts, uniform
from roomlight_generator.rooms.props.seating import add_cushion, add_legs
from roomlight_generator.rooms.props.small_objects import add_teddy_bear, ellipsoid
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, double_sided_sheet, lathe, loft, sphere, tube


def _basketry(rng: np.random.Generator) -> Material:
    colour = palette.srgb(*(np.array([192, 152, 102]) * uniform(rng, 0.5, 1.15)))
    return Material("wicker", albedo=(0.95, 0.95, 0.95), texture=textures.wicker(rng, colour))


def floor_clutter(rng: np.random.Generator) -> Draft:
    """Make a cardboard box, a basket, a bin, a bag, a suitcase, shoes, a pile of magazines, or a cloth pouffe."""
    kind = int(rng.integers(8))
    size = (
        (uniform(rng, 0.3, 0.6), uniform(rng, 0.22, 0.45), uniform(rng, 0.25, 0.45)),
        (uniform(rng, 0.3, 0.5), uniform(rng, 0.25, 0.5), 0.0),
        (uniform(rng, 0.2, 0.34), uniform(rng, 0.26, 0.6), 0.0),
        (uniform(rng, 0.28, 0.42), uniform(rng, 0.34, 0.5), uniform(rng, 0.16, 0.26)),
        (uniform(rng, 0.38, 0.5), uniform(rng, 0.55, 0.75), uniform(rng, 0.22, 0.28)),
        (uniform(rng, 0.2, 0.24), uniform(rng, 0.1, 0.13), uniform(rng, 0.26, 0.31)),
        (uniform(rng, 0.26, 0.34), uniform(rng, 0.08, 0.3), uniform(rng, 0.22, 0.3)),
        (uniform(rng, 0.3, 0.42), uniform(rng, 0.5, 0.65), uniform(rng, 0.24, 0.34)),
    )[kind]
    name = ("box", "basket", "bin", "bag", "suitcase", "shoes", "magazines", "laundry basket")[kind]
    full = (size[0], size[1], size[2] or size[0])
    return Draft(name, full, partial(_clutter, rng, kind, full))


def _clutter(rng: np.random.Generator, kind: int, size: tuple[Number, Number, Number]) -> Mesh:
    parts = Parts()
    width, height, depth = size
    if kind == 0:
        card = palette.cardboard(rng) if rng.random() < 0.7 else palette.plastic(rng)
        if rng.random() < 0.5:
            parts.slab(card, size, radius=0.004)
            tape = Material("tape", albedo=palette.neutral(rng, 150, 220), roughness=0.2)
            parts.slab(tape, (width, 0.001, 0.05), (0, height - 0.0002, 0), radius=0)
        else:
            t, height_m = 0.006, height * 0.86
            parts.blocks(card, [(width, t, depth, 0, 0, 0)])
            parts.blocks(card, [(t, height_m, depth, x * (width - t) / 2, 0, 0) for x in (-1, 1)])
            parts.blocks(card, [(width, height_m, t, 0, 0, z * (depth - t) / 2) for z in (-1, 1)])
            for _ in range(int(rng.integers(1, 5))):
                material = palette.cloth(rng) if rng.random() < 0.5 else palette.paint(rng)
                parts.slab(
                    material,
                    (width * 0.36, height * uniform(rng, 0.6, 0.95), depth * 0.36),
                    (uniform(rng, -0.26, 0.26) * width, 0.01, uniform(rng, -0.26, 0.26) * depth),
                    radius=0.01,
                )
            parts.slab(card, (width * 0.9, 0.004, depth * 0.25), (0, height - 0.004, depth * 0.37), radius=0)
    elif kind in (1, 2):
        r = width / 2
        foot = r * uniform(rng, 0.7, 0.98)
        material = _basketry(rng) if kind == 1 else (palette.metal(rng) if rng.random() < 0.5 else palette.plastic(rng))
        wall = lathe(
            [
                [(1e-3, 0), (foot, 0)],
                [(foot, 0), ((foot + r) / 2 * 1.04, height * 0.5), (r, height)],
                [(r, height), (r * 0.94, height)],
                [(r * 0.94, height), (foot * 0.94, 0.012)],
                [(foot * 0.94, 0.012), (1e-3, 0.012)],
            ],
            segments=24,
        )
        parts.add(wall, material)
        if kind == 1 and rng.random() < 0.7:
            for _ in range(3):
                cover = palette.cloth(rng)
                parts.add(
                    ellipsoid(r * 0.5, height * 0.18, r * 0.45),
                    cover,
                    (uniform(rng, -0.3, 0.3) * r, height * 0.8, uniform(rng, -0.3, 0.3) * r),
                    yaw=uniform(rng, 0, 180),
                )
    elif kind == 3:
        cloth = palette.upholstery(rng)
        x, z = width / 2, depth / 2
        body = height * 0.7
        side = [(x, z * 0.9, 0.0), (x * 0.98, z, body * 0.3), (x * 0.9, z * 0.5, body)]
        parts.add(
            loft([[(1e-3, 1e-3, 0.0), side[0]], side, [side[-1], (1e-3, 1e-3, body)]], exponent=5, segments=24), cloth
        )
        for s in (-1, 1):
            arc = [
                (x * 0.5 * np.cos(t), body * 0.95 + (height - body * 0.95) * np.sin(t), s * z * 0.3)
                for t in np.linspace(0, np.pi, 9)
            ]
            parts.add(tube(arc, 0.008, segments=5), cloth)
    elif kind == 4:
        shell = palette.plastic(rng)
        parts.slab(shell, (width, height * 0.82, depth), (0, 0.045, 0), radius=0.04, arcs=2)
        parts.blocks(shell, [(0.02, height * 0.78, depth * 1.0, x * width * 0.2, 0.06, 0) for x in (-1, 1)])
        dark = palette.black(rng)
        parts.blocks(
            dark, [(0.035, 0.05, 0.05, x * width * 0.4, 0, z * depth * 0.34) for x in (-1, 1) for z in (-1, 1)]
        )
        z = -depth * 0.4
        parts.add(
            tube(
                [
                    (-0.09, height * 0.8, z),
                    (-0.09, height - 0.01, z),
                    (0.09, height - 0.01, z),
                    (0.09, height * 0.8, z),
                ],
                0.009,
                segments=6,
            ),
            dark,
        )
    elif kind == 5:
        material = palette.leather(rng) if rng.random() < 0.5 else palette.cloth(rng)
        sole = palette.black(rng)
        for s in (-1, 1):
            x = s * width * 0.27
            half_x, half_z = width * 0.21, depth / 2
            parts.add(
                loft(
                    [
                        [(1e-3, 1e-3, 0.0, x), (half_x, half_z, 0.0, x)],
                        [(half_x, half_z, 0.0, x), (half_x, half_z, 0.02, x)],
                        [(half_x, half_z, 0.02, x), (1e-3, 1e-3, 0.02, x)],
                    ],
                    exponent=2.6,
                    segments=18,
                ),
                sole,
            )
            top = [
                (half_x * 0.95, half_z * 0.95, 0.02, x),
                (half_x * 0.85, half_z * 0.75, height * 0.55, x, -depth * 0.1),
                (half_x * 0.6, half_z * 0.35, height, x, -depth * 0.27),
            ]
            parts.add(
                loft([top, [top[-1], (1e-3, 1e-3, height * 0.9, x, -depth * 0.27)]], exponent=2.4, segments=18),
                material,
            )
    elif kind == 6:
        y, page = 0.0, palette.paper(rng)
        while y < height - 0.004:
            thickness = min(uniform(rng, 0.006, 0.03), height - y)
            cover = palette.paint(rng) if rng.random() < 0.6 else page
            share = 1.0 if y == 0 else uniform(rng, 0.75, 0.95)
            parts.slab(
                cover,
                (width * share, thickness, depth * share),
                (0, y, 0),
                radius=0,
                yaw=0 if y == 0 else uniform(rng, -5, 5),
            )
            y += thickness
    else:
        x, z = width / 2, depth / 2
        material = _basketry(rng) if rng.random() < 0.6 else palette.cloth(rng)
        side = [(x * 0.86, z * 0.86, 0.0), (x, z, height)]
        parts.add(
            loft(
                [
                    [(1e-3, 1e-3, 0.0), side[0]],
                    side,
                    [side[-1], (x * 0.94, z * 0.94, height)],
                    [(x * 0.94, z * 0.94, height), (x * 0.9, z * 0.9, height * 0.7)],
                ],
                exponent=6,
                segments=28,
            ),
            material,
        )
        heap = palette.cloth(rng)
        parts.add(
            loft(
                [[(x * 0.92, z * 0.92, height * 0.72), (x * 0.6, z * 0.6, height * 0.9), (1e-3, 1e-3, height * 0.98)]],
                exponent=4,
                segments=28,
            ),
            heap,
        )
    return parts.mesh()


def floor_toy(rng: np.random.Generator) -> Draft:
    """Make a play tent, a rocking horse, a toy kitchen, a big bear, a pile of blocks, or a tricycle."""
    kind = int(rng.integers(5))
    size = (
        (uniform(rng, 0.95, 1.2), uniform(rng, 1.2, 1.5), 0.0),
        (uniform(rng, 0.3, 0.36), uniform(rng, 0.6, 0.75), uniform(rng, 0.75, 0.95)),
        (uniform(rng, 0.5, 0.7), uniform(rng, 0.75, 0.95), uniform(rng, 0.28, 0.36)),
        (uniform(rng, 0.4, 0.6), 0.0, 0.0),
        (uniform(rng, 0.5, 0.8), uniform(rng, 0.12, 0.35), uniform(rng, 0.4, 0.7)),
    )[kind]
    width, height, depth = size
    if kind == 0:
        depth = width
    if kind == 3:
        height, depth = width * 1.4, width * 0.95
    name = ("play tent", "rocking horse", "toy kitchen", "big bear", "building blocks")[kind]
    return Draft(name, (width, height, depth), partial(_floor_toy, rng, kind, (width, height, depth)))


def _floor_toy(rng: np.random.Generator, kind: int, size: tuple[Number, Number, Number]) -> Mesh:
    parts = Parts()
    width, height, depth = size
    if kind == 0:
        cloth, pole = palette.cloth(rng, patterned=0.6), palette.wood(rng)
        feet = [
            (x * (width / 2 - 0.012), 0.0, z * (depth / 2 - 0.012)) for x, z in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
        top = height * 0.86
        for x, _, z in feet:
            parts.bar(pole, (x, 0, z), (-x * 0.1, height, -z * 0.1), 0.012, segments=6)
        apex = np.array([0.0, top, 0.0])
        for k in range(1, 4):
            a, b = (np.array(feet[k]) * 0.97, np.array(feet[(k + 1) % 4]) * 0.97)
            parts.add(
                double_sided_sheet(
                    np.array([[a, b], [apex + (a - b) * 0.02, apex - (a - b) * 0.02]], np.float32), thickness=0.004
                ),
                cloth,
            )
        for s in (-1, 1):
            corner = np.array(feet[0 if s > 0 else 1]) * 0.97
            inner = np.array([s * width * 0.26, 0.0, depth / 2 * 0.97])
            pair = [corner, inner] if s < 0 else [inner, corner]
            parts.add(
                double_sided_sheet(
                    np.array([pair, [apex - np.array([0.01, 0, 0]), apex + np.array([0.01, 0, 0])]], np.float32),
                    thickness=0.004,
                ),
                cloth,
            )
    elif kind == 1:
        wood, seat = palette.wood_or_paint(rng, 0.6), palette.cloth(rng)
        for x in (-1, 1):
            curve = [
                (x * width * 0.4, 0.02 + 0.12 * (z / depth * 2) ** 2, z) for z in np.linspace(-depth / 2, depth / 2, 9)
            ]
            parts.add(tube(curve, 0.02, segments=6), wood)
            for z in (-0.25, 0.22):
                parts.bar(
                    wood,
                    (x * width * 0.4, 0.06, z * depth),
                    (x * width * 0.18, height * 0.5, z * depth * 0.7),
                    0.018,
                    segments=6,
                )
        parts.add(ellipsoid(width * 0.26, height * 0.13, depth * 0.26), wood, (0, height * 0.52, -0.02))
        parts.slab(seat, (width * 0.42, 0.03, 0.2), (0, height * 0.62, -0.05), radius=0.012)
        parts.bar(wood, (0, height * 0.55, depth * 0.16), (0, height * 0.86, depth * 0.28), 0.06, 0.045)
        parts.add(ellipsoid(0.05, 0.06, 0.13), wood, (0, height * 0.88, depth * 0.33))
        for x in (-1, 1):
            parts.bar(
                wood,
                (x * 0.025, height * 0.92, depth * 0.25),
                (x * 0.03, height, depth * 0.24),
                0.016,
                0.004,
                segments=6,
            )
        parts.bar(wood, (-width / 2, height * 0.78, depth * 0.24), (width / 2, height * 0.78, depth * 0.24), 0.012)
    elif kind == 2:
        body, top = palette.paint(rng), palette.paint(rng)
        mid = height * 0.52
        parts.slab(body, (width, mid, depth - 0.02), (0, 0, -0.01), radius=0.01)
        parts.slab(top, (width, 0.03, depth), (0, mid, 0), radius=0.008)
        parts.slab(body, (width, height - mid, 0.03), (0, mid, -depth / 2 + 0.015), radius=0)
        parts.slab(top, (width * 0.9, 0.02, depth * 0.45), (0, height * 0.84, -depth * 0.26), radius=0)
        parts.slab(
            palette.black(rng),
            (width * 0.36, mid * 0.5, 0.012),
            (-width * 0.22, mid * 0.3, depth / 2 - 0.018),
            radius=0,
        )
        parts.slab(top, (width * 0.36, mid * 0.6, 0.012), (width * 0.22, mid * 0.2, depth / 2 - 0.018), radius=0)
        for x in (-0.3, -0.1):
            parts.bar(palette.black(rng), (x * width, mid + 0.028, 0), (x * width, mid + 0.034, 0), 0.05, segments=14)
        for x in (-0.3, 0.0, 0.3):
            parts.bar(
                palette.bright_plastic(rng),
                (x * width, height * 0.86, -depth * 0.26),
                (x * width, height * 0.96, -depth * 0.26),
                0.035,
                segments=10,
            )
    elif kind == 3:
        add_teddy_bear(parts, palette.fur(rng), palette.black(rng), height)
    else:
        for k in range(int(rng.integers(10, 22))):
            side = uniform(rng, 0.05, 0.12)
            level = 0.0 if k < 8 else uniform(rng, 0, height - side)
            if k == 0:
                side, level = 0.1, height - 0.1
            place = (uniform(rng, -0.38, 0.38) * width, max(level, 0.0), uniform(rng, -0.38, 0.38) * depth)
            parts.slab(
                palette.bright_plastic(rng),
                (side, side, side * uniform(rng, 1, 2)),
                place,
                radius=0,
                yaw=uniform(rng, 0, 180),
            )
        r = 0.06
        parts.add(sphere(r, rings=7, segments=12), palette.bright_plastic(rng), (width / 2 - r, r, depth / 2 - r))
        parts.add(sphere(r, rings=7, segments=12), palette.bright_plastic(rng), (-width / 2 + r, r, -depth / 2 + r))
    return parts.mesh()


def exercise(rng: np.random.Generator) -> Draft:
    """Make an exercise bike, a treadmill, a weight rack, or a table for table tennis or football."""
    kind = int(rng.integers(5))
    size = (
        (uniform(rng, 0.5, 0.58), uniform(rng, 1.1, 1.35), uniform(rng, 0.95, 1.15)),
        (uniform(rng, 0.7, 0.85), uniform(rng, 1.25, 1.4), uniform(rng, 1.5, 1.8)),
        (uniform(rng, 0.9, 1.3), uniform(rng, 0.6, 0.85), uniform(rng, 0.45, 0.6)),
        (2.74, uniform(rng, 0.88, 0.93), 1.525),
        (uniform(rng, 1.3, 1.5), uniform(rng, 0.86, 0.95), uniform(rng, 0.72, 0.8)),
    )[kind]
    name = ("exercise bicycle", "treadmill", "weights", "table tennis", "table football")[kind]
    return Draft(name, size, partial(_exercise, rng, kind, size))


def _exercise(rng: np.random.Generator, kind: int, size: tuple[Number, Number, Number]) -> Mesh:
    parts = Parts()
    width, height, depth = size
    metal, dark = palette.metal(rng), palette.black(rng)
    if kind == 0:
        for z in (-1, 1):
            parts.bar(
                metal, (-width / 2, 0.03, z * (depth / 2 - 0.03)), (width / 2, 0.03, z * (depth / 2 - 0.03)), 0.03
            )
        parts.bar(metal, (0, 0.04, -depth / 2 + 0.03), (0, 0.04, depth / 2 - 0.03), 0.03)
        parts.bar(metal, (0, 0.05, -0.05), (0, height * 0.68, -depth * 0.3), 0.03)
        add_cushion(parts, dark, (0.24, 0.07, 0.26), (0, height * 0.67, -depth * 0.3), plump=0.3)
        parts.bar(metal, (0, 0.05, depth * 0.2), (0, height * 0.9, depth * 0.36), 0.03)
        wheel = palette.paint(rng)
        parts.bar(wheel, (-0.05, 0.3, depth * 0.22), (0.05, 0.3, depth * 0.22), 0.22, segments=22)
        parts.bar(dark, (-0.14, 0.3, 0.02), (0.14, 0.3, 0.02), 0.016)
        for x in (-1, 1):
            parts.slab(dark, (0.09, 0.025, 0.2), (x * 0.18, 0.29 + 0.12 * x, 0.04), radius=0)
            parts.bar(dark, (x * 0.02, height * 0.86, depth * 0.35), (x * 0.24, height * 0.93, depth * 0.2), 0.016)
        parts.slab(dark, (0.2, 0.14, 0.04), (0, height - 0.14, depth * 0.37), radius=0.01, pitch=-24)
    elif kind == 1:
        parts.slab(dark, (width * 0.7, 0.14, depth * 0.94), (0, 0, -depth * 0.03), radius=0.02)
        parts.blocks(metal, [(width * 0.12, 0.16, depth * 0.94, x * width * 0.36, 0, -depth * 0.03) for x in (-1, 1)])
        parts.slab(dark, (width, 0.2, depth * 0.2), (0, 0, depth * 0.4), radius=0.03)
        for x in (-1, 1):
            parts.bar(
                metal, (x * width * 0.44, 0.1, depth * 0.36), (x * width * 0.44, height * 0.88, depth * 0.27), 0.03
            )
            parts.bar(
                dark,
                (x * width * 0.44, height * 0.7, depth * 0.28),
                (x * width * 0.44, height * 0.68, -depth * 0.02),
                0.022,
            )
        parts.slab(dark, (width * 0.9, 0.24, 0.06), (0, height - 0.24, depth * 0.26), radius=0.02, pitch=-16)
    elif kind == 2:
        for x in (-1, 1):
            parts.slab(metal, (0.05, height - 0.06, 0.05), (x * (width / 2 - 0.03), 0, -depth * 0.3), radius=0)
            parts.slab(metal, (0.05, 0.05, depth), (x * (width / 2 - 0.03), 0, 0), radius=0)
        for level in (0.3, 0.75):
            y = height * level
            parts.slab(metal, (width - 0.08, 0.03, depth * 0.5), (0, y, -depth * 0.1), radius=0)
            count = int(width / 0.2)
            for k in range(count):
                x, r = (k + 0.5) / count * (width - 0.16) - (width - 0.16) / 2, uniform(rng, 0.045, 0.075)
                y0 = y + 0.03 + r
                paint = dark if rng.random() < 0.6 else palette.bright_plastic(rng)
                parts.bar(metal, (x, y0, -depth * 0.3), (x, y0, depth * 0.12), 0.015, segments=6)
                for z in (-0.3, 0.05):
                    parts.bar(paint, (x, y0, z * depth), (x, y0, (z + 0.12) * depth), r, segments=10)
        parts.slab(dark, (0.02, 0.02, 0.02), (0, height - 0.02, -depth * 0.3), radius=0)
    elif kind == 3:
        green = Material(
            "table top", albedo=palette.srgb(*((30, 92, 62) if rng.random() < 0.5 else (34, 74, 130))), roughness=0.3
        )
        line = Material("line", albedo=palette.neutral(rng, 225, 240))
        y = 0.76
        parts.slab(green, (width, 0.025, depth), (0, y - 0.025, 0), radius=0)
        parts.blocks(line, [(width, 0.001, 0.02, 0, y, z) for z in (-depth / 2 + 0.01, 0, depth / 2 - 0.01)])
        parts.blocks(line, [(0.02, 0.001, depth, x, y, 0) for x in (-width / 2 + 0.01, width / 2 - 0.01)])
        parts.slab(line, (0.004, height - y, depth), (0, y, 0), radius=0)
        add_legs(parts, metal, (width * 0.7, depth * 0.7), y - 0.02, thickness=0.025, square=True)
    else:
        body, field = palette.wood_or_paint(rng), Material("field", albedo=palette.srgb(40, 120, 60), roughness=0.3)
        low, top = height * 0.62, height - 0.03
        parts.blocks(body, [(width, top - low, 0.03, 0, low, z * (depth / 2 - 0.06)) for z in (-1, 1)])
        parts.blocks(body, [(0.03, top - low, depth - 0.12, x * (width / 2 - 0.015), low, 0) for x in (-1, 1)])
        parts.slab(field, (width - 0.04, 0.02, depth - 0.14), (0, low + 0.06, 0), radius=0)
        add_legs(parts, body, (width - 0.12, depth - 0.24), low + 0.05, thickness=0.04, square=True)
        for k, x in enumerate(np.linspace(-0.4, 0.4, 8) * width):
            shift = 0.06 if k % 2 else -0.06
            parts.bar(
                metal,
                (x, top - 0.03, -depth / 2 + 0.06 + shift),
                (x, top - 0.03, depth / 2 - 0.06 + shift),
                0.008,
                segments=6,
            )
            player = palette.srgb(190, 40, 40) if k % 2 else palette.srgb(40, 60, 170)
            men = Material("player", albedo=player, roughness=0.3)
            parts.blocks(men, [(0.02, 0.1, 0.025, x, top - 0.11, z * depth) for z in (-0.2, 0.0, 0.2)])
        parts.blocks(dark, [(0.06, 0.03, 0.12, width * 0.3, top, z * (depth / 2 - 0.06)) for z in (-1, 1)])
    return parts.mesh()
