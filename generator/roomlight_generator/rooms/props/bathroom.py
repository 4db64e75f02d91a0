"""Bathtubs, showers, toilets, washbasins, towel rails, washing machines, radiators."""

from functools import partial

import numpy as np

from roomlight_generator.rooms.props import palette
from roomlight_generator.rooms.props.draft import Draft, Parts, uniform
from roomlight_generator.rooms.props.storage import FrontGrid, FrontMaterials, add_fronts
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, double_sided_sheet, loft, rod, tube


def bathtub(rng: np.random.Generator) -> Draft:
    """Make a bathtub, freestanding and rounded, or boxed in."""
    width, depth, height = uniform(rng, 1.5, 1.85), uniform(rng, 0.68, 0.85), uniform(rng, 0.5, 0.62)
    free = rng.random() < 0.4

    def build() -> Mesh:
        parts = Parts()
        white = palette.sanitary(rng)
        x, z = width / 2, depth / 2
        rim, floor = uniform(rng, 0.03, 0.08), uniform(rng, 0.1, 0.16)
        outer = palette.sanitary(rng) if rng.random() < 0.75 else palette.paint(rng)
        exponent = uniform(rng, 2.4, 4.5) if free else 40.0
        bottom = 0.86 if free else 1.0
        inner = uniform(rng, 2.4, exponent) if free else uniform(rng, 2.6, 6)
        sides = [
            (x * bottom * 0.96, z * bottom * 0.92, 0.0),
            (x * (bottom + 1) / 2, z * (bottom + 1) / 2, height * 0.6),
            (x, z, height),
        ]
        if not free:
            sides = [(x, z, 0.0), (x, z, height)]
        parts.add(loft([[(1e-3, 1e-3, 0.0), sides[0]], sides], exponent=exponent, segments=40), outer)
        ring = loft(
            [
                [
                    (x - rim, z - rim, height),
                    (x - rim - 0.03, z - rim - 0.02, height * 0.7),
                    ((x - rim) * 0.85, (z - rim) * 0.8, floor + 0.05),
                ],
                [
                    ((x - rim) * 0.85, (z - rim) * 0.8, floor + 0.05),
                    ((x - rim) * 0.7, (z - rim) * 0.6, floor),
                    (1e-3, 1e-3, floor),
                ],
            ],
            exponent=inner,
            segments=40,
        )
        parts.add(ring, white)
        parts.add(_rim(x, z, x - rim, z - rim, height, exponent, inner), white)
        metal = palette.chrome(rng)
        parts.bar(metal, (x - rim / 2, height - 0.01, 0), (x - rim / 2, height + 0.036, 0), 0.013)
        parts.bar(metal, (x - rim / 2, height + 0.026, 0), (x - rim - 0.1, height + 0.02, 0), 0.01)
        return parts.mesh()

    return Draft("bathtub", (width, height + 0.036, depth), build)


def _rim(x: Number, z: Number, inner_x: Number, inner_z: Number, height: Number, outer: Number, inner: Number) -> Mesh:
    """Make the flat ring between two superellipses of different exponents, facing up."""
    angle = np.linspace(0, 2 * np.pi, 41)
    rings: list[np.ndarray] = []
    for a, b, exponent in ((x, z, outer), (inner_x, inner_z, inner)):
        c, s = np.cos(angle), -np.sin(angle)
        stretch = (np.abs(c) ** exponent + np.abs(s) ** exponent) ** (-1 / exponent)
        rings.append(np.stack([a * c * stretch, np.full(41, height), b * s * stretch], 1))
    return double_sided_sheet(np.array(rings, np.float32), thickness=0.004)


def shower(rng: np.random.Generator) -> Draft:
    """Make a shower tray in a corner (walls behind and to its left) with glass on the other two sides, head and tap."""
    width, depth = uniform(rng, 0.8, 1.2), uniform(rng, 0.78, 1.0)
    height = uniform(rng, 1.9, 2.05)

    def build() -> Mesh:
        parts = Parts()
        white, metal = palette.sanitary(rng), palette.chrome(rng)
        frame = metal if rng.random() < 0.7 else palette.black(rng)
        parts.slab(white, (width, uniform(rng, 0.03, 0.12), depth), radius=0.012)
        bar = 0.025
        pane = palette.glass()
        parts.slab(pane, (width - 2 * bar, height - 0.2, 0.006), (0, 0.13, depth / 2 - bar / 2), radius=0)
        parts.slab(pane, (0.006, height - 0.2, depth - 2 * bar), (width / 2 - bar / 2, 0.13, 0), radius=0)
        posts = [(width / 2 - bar / 2, depth / 2 - bar / 2), (-width / 2 + bar / 2, depth / 2 - bar / 2),
                 (width / 2 - bar / 2, -depth / 2 + bar / 2), (0.0, depth / 2 - bar / 2)]  # fmt: skip
        parts.blocks(frame, [(bar, height, bar, x, 0, z) for x, z in posts])
        parts.blocks(frame, [(width, bar, bar, 0, y, depth / 2 - bar / 2) for y in (0.1, height - bar)])
        parts.blocks(frame, [(bar, bar, depth, width / 2 - bar / 2, y, 0) for y in (0.1, height - bar)])
        back = -depth / 2 + 0.03
        parts.add(
            tube(
                [
                    (0, 1.0, back),
                    (0, height - 0.06, back),
                    (0, height - 0.02, back + 0.05),
                    (0, height - 0.02, back + 0.3),
                ],
                0.01,
            ),
            metal,
        )
        parts.bar(
            metal,
            (0, height - 0.05, back + 0.3),
            (0, height - 0.02, back + 0.3),
            uniform(rng, 0.05, 0.13),
            0.02,
            segments=16,
        )
        parts.slab(metal, (0.26, 0.04, 0.05), (0, 1.0, back), radius=0.01)
        return parts.mesh()

    return Draft("shower", (width, height, depth), build)


def toilet(rng: np.random.Generator) -> Draft:
    """Make a toilet with a cistern, or wall-hung on a boxed wall."""
    width, depth = uniform(rng, 0.36, 0.4), uniform(rng, 0.62, 0.74)
    height = uniform(rng, 0.74, 0.86)

    def build() -> Mesh:
        parts = Parts()
        white = palette.sanitary(rng)
        seat = uniform(rng, 0.4, 0.44)
        tank = uniform(rng, 0.16, 0.2)
        front = depth / 2
        half_z = (depth - tank) / 2 * 1.0
        middle = front - half_z
        half_x = width / 2
        parts.add(
            loft(
                [
                    [(1e-3, 1e-3, 0.0, 0, middle), (half_x * 0.6, half_z * 0.62, 0.0, 0, middle - 0.06)],
                    [
                        (half_x * 0.6, half_z * 0.62, 0.0, 0, middle - 0.06),
                        (half_x * 0.58, half_z * 0.6, 0.12, 0, middle - 0.05),
                        (half_x * 0.85, half_z * 0.85, 0.28, 0, middle - 0.02),
                        (half_x, half_z, seat - 0.02, 0, middle),
                    ],
                    [(half_x, half_z, seat - 0.02, 0, middle), (1e-3, 1e-3, seat - 0.02, 0, middle)],
                ],
                exponent=2.3,
                segments=26,
            ),
            white,
        )
        lid = white if rng.random() < 0.8 else palette.paint(rng)
        parts.add(
            loft(
                [
                    [(1e-3, 1e-3, 0), (half_x, half_z, 0)],
                    [(half_x, half_z, 0), (half_x * 1.01, half_z * 1.01, 0.02), (half_x * 0.95, half_z * 0.95, 0.035)],
                    [(half_x * 0.95, half_z * 0.95, 0.035), (1e-3, 1e-3, 0.04)],
                ],
                exponent=2.3,
                segments=26,
            ),
            lid,
            (0, seat - 0.015, middle),
        )
        boxed = rng.random() < 0.3
        body = palette.paint(rng, palette.neutral(rng, 200, 240)) if boxed else white
        across = width * (1.0 if boxed else 0.95)
        start = 0.0 if boxed else seat - 0.05
        parts.slab(body, (across, height - start - 0.03, tank), (0, start, -depth / 2 + tank / 2), radius=0.025, arcs=2)
        parts.slab(white, (across, 0.03, tank), (0, height - 0.035, -depth / 2 + tank / 2), radius=0.01)
        parts.bar(
            palette.chrome(rng),
            (0, height - 0.006, -depth / 2 + tank / 2),
            (0, height, -depth / 2 + tank / 2),
            0.025,
            segments=12,
        )
        parts.slab(white, (width * 0.6, seat - 0.04, 0.2), (0, 0, -depth / 2 + 0.1), radius=0.02)
        return parts.mesh()

    return Draft("toilet", (width, height, depth), build)


def washbasin(rng: np.random.Generator) -> Draft:
    """Make a washbasin on a pedestal or on a cabinet, or a bowl on a board."""
    kind = int(rng.integers(3))
    width = uniform(rng, 0.45, 0.62) if kind == 0 else uniform(rng, 0.55, 1.2)
    depth, height = uniform(rng, 0.4, 0.52), uniform(rng, 0.82, 0.9)
    return Draft("washbasin", (width, height + 0.16, depth), partial(_washbasin, rng, kind, width, depth, height))


def _washbasin(rng: np.random.Generator, kind: int, width: Number, depth: Number, height: Number) -> Mesh:
    parts = Parts()
    white, metal = palette.sanitary(rng), palette.chrome(rng)
    exponent = uniform(rng, 2.0, 7.0)
    x, z = (width / 2, depth / 2) if kind == 0 else (min(width / 2 - 0.02, 0.3), depth / 2 - 0.06)
    low = height - (0.17 if kind == 0 else 0.13)
    inner = 0.03
    outside = [(x * 0.72, z * 0.7, low), (x * 0.95, z * 0.95, low + 0.05), (x, z, height)]
    inside = [
        (x - inner, z - inner, height),
        (x * 0.8, z * 0.8, low + 0.06),
        (x * 0.3, z * 0.3, low + 0.025),
        (1e-3, 1e-3, low + 0.02),
    ]
    parts.add(
        loft(
            [[(1e-3, 1e-3, low), outside[0]], outside, [outside[-1], inside[0]], inside], exponent=exponent, segments=32
        ),
        white,
    )
    if kind == 0:
        base = [(x * 0.36, z * 0.4, 0.0), (x * 0.28, z * 0.32, low * 0.5), (x * 0.42, z * 0.5, low + 0.01)]
        parts.add(loft([[(1e-3, 1e-3, 0.0), base[0]], base], exponent=3, segments=18), white, (0, 0, -z * 0.3))
    else:
        body = palette.wood_or_paint(rng, 0.5)
        face = body if rng.random() < 0.7 else palette.paint(rng)
        board = palette.worktop(rng) if kind == 2 else body
        start = 0.0 if rng.random() < 0.5 else 0.12
        size, place = (width - 0.004, low - start - 0.03, depth - 0.04), (0.0, start, -0.015)
        parts.slab(body, size, place, radius=0)
        columns = 2 if width > 0.6 else 1
        drawers = rng.random() < 0.5
        add_fronts(
            parts,
            rng,
            FrontMaterials(body, face, palette.metal(rng)),
            place,
            size,
            FrontGrid(1 if drawers else columns, 2 if drawers else 1, doors=not drawers),
        )
        parts.slab(board, (width, 0.03, depth), (0, low - 0.03, 0), radius=0)
        if start:
            parts.slab(palette.black(rng), (width - 0.1, start, depth - 0.12), (0, 0, -0.03), radius=0)
    tap_z = -z + inner * 0.9
    height_m = uniform(rng, 0.1, 0.155)
    parts.add(
        tube(
            [
                (0, height - 0.01, tap_z),
                (0, height + height_m * 0.8, tap_z),
                (0, height + height_m, tap_z + 0.02),
                (0, height + height_m, tap_z + 0.07),
                (0, height + height_m * 0.8, tap_z + 0.11),
            ],
            0.011,
        ),
        metal,
    )
    parts.bar(metal, (0, height, tap_z), (0, height + 0.16, tap_z), 0.014, 0.008)
    return parts.mesh()


def washing_machine(rng: np.random.Generator) -> Draft:
    """Make a front-loading washing machine with a round door, or a dryer."""
    width, height, depth = uniform(rng, 0.59, 0.605), uniform(rng, 0.84, 0.87), uniform(rng, 0.5, 0.64)

    def build() -> Mesh:
        parts = Parts()
        white = palette.sanitary(rng) if rng.random() < 0.75 else palette.metal(rng)
        dark = palette.black(rng)
        parts.slab(white, (width, height - 0.02, depth - 0.05), (0, 0.02, -0.025), radius=0.012)
        parts.blocks(dark, [(0.05, 0.02, 0.05, x * 0.24, 0, z * 0.18) for x in (-1, 1) for z in (-1, 1)])
        z = depth / 2 - 0.05
        middle = height * 0.46
        door = dark if rng.random() < 0.4 else palette.chrome(rng)
        parts.bar(door, (0, middle, z - 0.01), (0, middle, z + 0.035), 0.2, 0.18, segments=26)
        parts.bar(dark, (0, middle, z + 0.03), (0, middle, z + 0.05), 0.14, 0.12, segments=24)
        panel = white if rng.random() < 0.6 else dark
        parts.slab(panel, (width - 0.01, 0.11, 0.012), (0, height - 0.135, z), radius=0)
        parts.bar(palette.chrome(rng), (0, height - 0.08, z), (0, height - 0.08, z + 0.03), 0.025, segments=14)
        parts.slab(white, (0.16, 0.08, 0.008), (-0.19, height - 0.12, z + 0.01), radius=0)
        parts.slab(dark, (0.11, 0.04, 0.006), (0.16, height - 0.1, z + 0.01), radius=0)
        return parts.mesh()

    return Draft("washing machine", (width, height, depth), build, top_m=height)


def towel_rack(rng: np.random.Generator) -> Draft:
    """Make a ladder of heated bars or a single rail, with towels over it."""
    ladder = rng.random() < 0.5
    width = uniform(rng, 0.45, 0.62)
    height = uniform(rng, 0.8, 1.5) if ladder else uniform(rng, 0.45, 0.62)
    depth = uniform(rng, 0.08, 0.12)
    return Draft("towel rail", (width, height, depth), partial(_towels, rng, ladder, width, height, depth),
                 elevation_m=uniform(rng, 0.35, 0.55) if ladder else uniform(rng, 0.75, 0.95))  # fmt: skip


def _add_towel(
    parts: Parts, cloth: Material, x: Number, width: Number, top: Number, drop: tuple[Number, Number], z: Number
) -> None:
    """Add a towel over a bar at height `top`: a drop in front of it and one behind."""
    path = [
        (top - drop[0], z + 0.02),
        (top - 0.02, z + 0.02),
        (top + 0.014, z),
        (top - 0.02, z - 0.018),
        (top - drop[1], z - 0.018),
    ]
    grid = np.array([[[x - width / 2, y, d], [x, y, d], [x + width / 2, y, d]] for y, d in path], np.float32)
    parts.add(double_sided_sheet(grid, thickness=0.012), cloth)


def _towels(rng: np.random.Generator, ladder: bool, width: Number, height: Number, depth: Number) -> Mesh:
    parts = Parts()
    metal = palette.metal(rng) if rng.random() < 0.6 else palette.sanitary(rng)
    z = depth / 2 - (0.02 if ladder else 0.024)
    if not ladder:
        top = height - 0.025
        parts.bar(metal, (-width / 2, top, z), (width / 2, top, z), 0.009)
        for x in (-1, 1):
            parts.bar(metal, (x * (width / 2 - 0.02), top, -depth / 2), (x * (width / 2 - 0.02), top, z + 0.008), 0.011)
        _add_towel(
            parts,
            palette.cloth(rng),
            uniform(rng, -0.04, 0.04),
            width * uniform(rng, 0.5, 0.8),
            top,
            (top, top * 0.7),
            z - 0.002,
        )
        return parts.mesh()
    for x in (-1, 1):
        parts.bar(metal, (x * (width / 2 - 0.015), 0, z), (x * (width / 2 - 0.015), height, z), 0.015)
        parts.blocks(
            metal,
            [
                (0.02, 0.02, depth / 2 + z, x * (width / 2 - 0.015), y, (z - depth / 2) / 2)
                for y in (0.08, height - 0.1)
            ],
        )
    for y in np.linspace(0.06, height - 0.06, max(6, int(height / 0.09))):
        parts.add(rod((-width / 2 + 0.015, y, z), (width / 2 - 0.015, y, z), 0.01, segments=6, step=99), metal)
    for k in range(int(rng.integers(0, 3))):
        top = height - 0.06 - k * height * 0.45
        _add_towel(
            parts, palette.cloth(rng), uniform(rng, -0.05, 0.05), width * 0.7, top, (height * 0.34, height * 0.26), z
        )
    return parts.mesh()


def radiator(rng: np.random.Generator) -> Draft:
    """Make a panel or column radiator, on feet or pipes to the floor."""
    width, height, depth = uniform(rng, 0.5, 1.6), uniform(rng, 0.5, 0.85), uniform(rng, 0.1, 0.15)

    def build() -> Mesh:
        parts = Parts()
        white = palette.paint(rng, palette.neutral(rng, 215, 240)) if rng.random() < 0.8 else palette.metal(rng)
        low = uniform(rng, 0.1, 0.16)
        if rng.random() < 0.55:
            parts.slab(white, (width, height - low, depth * 0.55), (0, low, depth * 0.2), radius=0.008)
            count = int(width / 0.07)
            parts.blocks(
                white,
                [
                    (0.035, height - low - 0.08, 0.012, float(x), low + 0.04, depth / 2 - 0.008)
                    for x in np.linspace(-width / 2 + 0.05, width / 2 - 0.05, count)
                ],
            )
            parts.slab(white, (width, 0.012, depth), (0, height - 0.012, 0), radius=0)
        else:
            count = int(width / 0.062)
            for x in np.linspace(-width / 2 + 0.024, width / 2 - 0.024, min(count, 20)):
                parts.slab(white, (0.044, height - low, depth), (float(x), low, 0), radius=0.02)
            for y in (low + 0.05, height - 0.07):
                parts.bar(white, (-width / 2, y, 0), (width / 2, y, 0), 0.018)
        for x in (-1, 1):
            parts.bar(white, (x * (width / 2 - 0.05), 0, 0), (x * (width / 2 - 0.05), low + 0.03, 0), 0.011)
        parts.bar(
            palette.plastic(rng, palette.neutral(rng, 200, 240)),
            (width / 2 - 0.05, height - 0.06, depth * 0.2),
            (width / 2, height - 0.06, depth * 0.2),
            0.018,
            segments=10,
        )
        return parts.mesh()

    return Draft("radiator", (width, height, depth), build)
