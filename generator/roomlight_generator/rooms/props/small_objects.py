"""Small objects that stand on furniture: vases, books, ornaments, stationery, toys, bathroom objects."""

from collections.abc import Sequence

import numpy as np

from roomlight_generator.rooms.props import palette, textures
from roomlight_generator.rooms.props.draft import Draft, Parts, circle_points, uniform
from roomlight_generator.rooms.props.pictures import print_texture
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, lathe, loft, rectangle, sphere, tube, with_material


def solid_of_revolution(rings: Sequence[tuple[Number, Number]], *, segments: int = 16) -> Mesh:
    """Make a closed solid of revolution: one smooth side of (radius, height), flat at both ends."""
    low, high = rings[0], rings[-1]
    return lathe([[(1e-3, low[1]), low], rings, [high, (1e-3, high[1])]], segments=segments)


def vessel(rng: np.random.Generator, height: Number, across: Number, *, segments: int = 18) -> Mesh:
    """Make a glazed vase or pot with an inside: bottle, belly, cone or cylinder."""
    t = np.linspace(0, 1, 9)
    kind = int(rng.integers(4))
    shape = (
        0.35 + 0.65 * np.sin(np.pi * np.clip(t * 1.15, 0, 1)) ** 1.2 * (1 - 0.3 * t),
        0.25 + 0.75 * np.exp(-(((t - uniform(rng, 0.2, 0.4)) / 0.25) ** 2)),
        0.6 + 0.4 * t,
        0.9 + 0.1 * np.sin(np.pi * t),
    )[kind]
    radius = across / 2 * shape / shape.max()
    outside = [(float(r), float(height * y)) for r, y in zip(radius, t, strict=True)]
    rim = outside[-1][0]
    inner = max(rim * 0.82, 0.004)
    inside = [(inner, height), (inner * 0.98, height * 0.85), (1e-3, height * 0.8)]
    mesh = lathe([[(1e-3, 0.0), outside[0]], outside, [outside[-1], (inner, height)], inside], segments=segments)
    return with_material(mesh, palette.ceramic(rng) if rng.random() < 0.75 else palette.metal(rng))


def vase(rng: np.random.Generator) -> Draft:
    """Make a vase, empty or with twigs or flowers."""
    height = uniform(rng, 0.14, 0.4)
    across = height * uniform(rng, 0.35, 0.75)
    stems = 0 if rng.random() < 0.4 else int(rng.integers(3, 9))
    above = uniform(rng, 0.5, 0.9) * height if stems else 0.0
    width_m = across if not stems else max(across, height * uniform(rng, 0.7, 1.1))

    def build() -> Mesh:
        parts = Parts()
        parts.add_mesh(vessel(rng, height, across, segments=20))
        if not stems:
            return parts.mesh()
        stalk, flower = palette.leaf(rng), palette.paint(rng, palette.hue(rng, (0.3, 0.95), (0.6, 1.0)))
        for x, z in circle_points(stems, width_m / 2 - 0.02, uniform(rng, 0, 3)):
            out = uniform(rng, 0.75, 1)
            tip = (x * out, height + above * uniform(rng, 0.65, 0.95), z * out)
            parts.bar(stalk, (0, height * 0.7, 0), tip, 0.003, 0.002, segments=5)
            size = uniform(rng, 0.012, 0.03)
            head = sphere(size, rings=4, segments=8)
            parts.add(head, flower if rng.random() < 0.7 else stalk, tip)
        return parts.mesh()

    return Draft("vase", (width_m, height + above, width_m), build)


def book(rng: np.random.Generator) -> Draft:
    """Make one to five lying books, the top one with a picture on its cover, or a row between bookends."""
    if rng.random() < 0.3:
        return _book_row(rng)
    count = int(rng.integers(1, 6))
    across, depth_m = uniform(rng, 0.2, 0.32), uniform(rng, 0.15, 0.24)
    thicknesses = [uniform(rng, 0.012, 0.045) for _ in range(count)]

    def build() -> Mesh:
        parts = Parts()
        page, y = palette.paper(rng), 0.0
        for k, height_m in enumerate(thicknesses):
            cover = palette.book_cover(rng)
            share = 1.0 if k == 0 else uniform(rng, 0.72, 0.97)
            width, depth = across * share, depth_m * share
            yaw = 0.0 if k == 0 else uniform(rng, -12, 12) * (1 - share)
            parts.slab(cover, (width, 0.003, depth), (0, y, 0), radius=0, yaw=yaw)
            parts.slab(cover, (width, 0.003, depth), (0, y + height_m - 0.003, 0), radius=0, yaw=yaw)
            parts.slab(cover, (width, height_m - 0.001, 0.005), (0, y, -depth / 2 + 0.003), radius=0, yaw=yaw)
            parts.slab(page, (width - 0.008, height_m - 0.006, depth - 0.008), (0, y + 0.003, 0.0), radius=0, yaw=yaw)
            y += height_m
            if k == count - 1:
                image = Material(
                    "print", albedo=(0.9, 0.9, 0.9), texture=print_texture(rng, width / depth), roughness=0.2
                )
                face = rectangle((-width / 2, 0, depth / 2), (width, 0, 0), (0, 0, -depth), step=9, unit_uv=True)
                parts.add(face, image, (0, y + 0.0006, 0), yaw=yaw)
        return parts.mesh()

    return Draft("books", (across, sum(thicknesses) + 0.0006, depth_m), build)


def _book_row(rng: np.random.Generator) -> Draft:
    count = int(rng.integers(4, 12))
    thicknesses = [uniform(rng, 0.014, 0.045) for _ in range(count)]
    heights_m = [uniform(rng, 0.17, 0.3) for _ in range(count)]
    depth_m = uniform(rng, 0.15, 0.23)
    width = sum(thicknesses) + 0.02

    def build() -> Mesh:
        parts = Parts()
        x = -width / 2 + 0.01
        for width_m, high in zip(thicknesses, heights_m, strict=True):
            parts.slab(
                palette.book_cover(rng),
                (width_m - 0.001, high, depth_m * uniform(rng, 0.85, 1)),
                (x + width_m / 2, 0, 0),
                radius=0,
            )
            x += width_m
        end = palette.metal(rng)
        for side in (-1, 1):
            parts.slab(end, (0.01, 0.15, depth_m), (side * (width / 2 - 0.005), 0, 0), radius=0)
        return parts.mesh()

    return Draft("row of books", (width, max(heights_m), depth_m), build)


def ornament(rng: np.random.Generator) -> Draft:
    """Make a figurine, a sphere, a candlestick, a bowl, a framed photograph, or an hourglass."""
    kind = int(rng.integers(5))
    height = (uniform(rng, 0.14, 0.36), uniform(rng, 0.08, 0.2), uniform(rng, 0.16, 0.34), uniform(rng, 0.06, 0.12),
              uniform(rng, 0.14, 0.28))[kind]  # fmt: skip
    width = (height * uniform(rng, 0.4, 0.8), height, uniform(rng, 0.07, 0.12), uniform(rng, 0.18, 0.36),
             height * uniform(rng, 0.7, 1.4))[kind]  # fmt: skip
    depth = width if kind != 4 else 0.07

    def build() -> Mesh:
        parts = Parts()
        material = (palette.metal, palette.ceramic, palette.wood, palette.paint)[int(rng.integers(4))](rng)
        half = width / 2
        if kind == 0:
            foot = palette.wood(rng) if rng.random() < 0.5 else palette.black(rng)
            parts.slab(foot, (width * 0.8, height * 0.1, width * 0.8), (0, 0, 0), radius=0.003)
            t = np.linspace(0, 1, 9)
            bend = uniform(rng, 0.1, 0.3) * width
            rings = [
                (
                    half * (0.25 + 0.7 * abs(np.sin(2.6 * v + 0.4))) * (1 - 0.5 * v) + 0.003,
                    half * (0.25 + 0.6 * abs(np.cos(2.1 * v))) * (1 - 0.4 * v) + 0.003,
                    height * (0.1 + 0.9 * v),
                    bend * np.sin(3 * v) * 0.4,
                    0.0,
                )
                for v in t
            ]
            lines = [[(1e-3, 1e-3, height * 0.1), rings[0]], rings, [rings[-1], (1e-3, 1e-3, height)]]
            parts.add(loft([[tuple(float(v) for v in ring) for ring in line] for line in lines], segments=14), material)
        elif kind == 1:
            parts.add(sphere(half * 0.98, rings=9, segments=16), material, (0, half, 0))
        elif kind == 2:
            wax = palette.plastic(rng, palette.neutral(rng, 200, 240))
            parts.add(
                solid_of_revolution(
                    [
                        (half, 0.0),
                        (half * 0.9, 0.012),
                        (0.01, 0.02),
                        (0.014, height * 0.5),
                        (half * 0.6, height * 0.52),
                    ],
                    segments=14,
                ),
                material,
            )
            parts.bar(wax, (0, height * 0.5, 0), (0, height, 0), 0.011)
        elif kind == 3:
            parts.add(
                lathe(
                    [
                        [(1e-3, 0), (half * 0.4, 0)],
                        [(half * 0.4, 0), (half * 0.8, height * 0.5), (half, height)],
                        [(half, height), (half * 0.94, height)],
                        [(half * 0.94, height), (half * 0.74, height * 0.5), (1e-3, height * 0.12)],
                    ],
                    segments=24,
                ),
                material,
            )
        else:
            image = Material("print", albedo=(0.9, 0.9, 0.9), texture=print_texture(rng, width / height), roughness=0.1)
            edge = 0.018
            parts.slab(material, (width, height, 0.012), (0, 0, 0), radius=0, pitch=-9)
            face = rectangle((-half + edge, edge, 0.0066), (width - 2 * edge, 0, 0), (0, height - 2 * edge, 0), step=9,
                             unit_uv=True)  # fmt: skip
            parts.add(face, image, pitch=-9)
            parts.slab(material, (0.03, height * 0.8, 0.006), (0, 0, -0.05), radius=0, pitch=14)
        return parts.mesh()

    return Draft("ornament", (width, height, depth), build)


def stationery(rng: np.random.Generator) -> Draft:
    """Make a pot of pens, a letter tray with papers, a notebook, or a desk organiser."""
    kind = int(rng.integers(4))
    size = (
        (0.085, uniform(rng, 0.16, 0.2), 0.085),
        (uniform(rng, 0.24, 0.27), uniform(rng, 0.06, 0.2), uniform(rng, 0.31, 0.35)),
        (uniform(rng, 0.15, 0.23), uniform(rng, 0.02, 0.04), uniform(rng, 0.2, 0.3)),
        (uniform(rng, 0.2, 0.34), uniform(rng, 0.1, 0.16), uniform(rng, 0.12, 0.2)),
    )[kind]
    width, height, depth = size

    def build() -> Mesh:
        parts = Parts()
        material = palette.plastic(rng) if rng.random() < 0.5 else palette.wood_or_paint(rng)
        if kind == 0:
            top, r = height * 0.55, width * 0.42
            parts.add(
                lathe(
                    [
                        [(1e-3, 0), (r, 0)],
                        [(r, 0), (r, top)],
                        [(r, top), (r * 0.9, top)],
                        [(r * 0.9, top), (r * 0.9, 0.01)],
                        [(r * 0.9, 0.01), (1e-3, 0.01)],
                    ],
                    segments=14,
                ),
                material,
            )
            for x, z in circle_points(6, r * 0.8, uniform(rng, 0, 1)):
                pen = palette.bright_plastic(rng) if rng.random() < 0.6 else palette.black(rng)
                parts.bar(
                    pen,
                    (-0.5 * x, 0.01, -0.5 * z),
                    (x * 1.35, height * uniform(rng, 0.85, 1), z * 1.35),
                    0.004,
                    segments=5,
                )
        elif kind == 1:
            levels = max(1, int(height / 0.065))
            for k in range(levels):
                y = k * height / levels
                parts.slab(material, (width, 0.004, depth), (0, y, 0), radius=0)
                parts.blocks(
                    material, [(0.004, height / levels * 0.97, depth, s * (width / 2 - 0.002), y, 0) for s in (-1, 1)]
                )
                parts.slab(palette.paper(rng), (0.21, uniform(rng, 0.004, 0.03), 0.297), (0, y + 0.004, 0), radius=0)
        elif kind == 2:
            parts.slab(material, (width, height - 0.008, depth), radius=0.002)
            pen = palette.bright_plastic(rng)
            parts.bar(
                pen,
                (-width * 0.3, height - 0.004, depth * 0.3),
                (width * 0.2, height - 0.004, -depth * 0.3),
                0.004,
                segments=5,
            )
        else:
            parts.blocks(
                material,
                [
                    (width, 0.006, depth, 0, 0, 0),
                    (width, height, 0.006, 0, 0, -depth / 2 + 0.003),
                    (width, height * 0.5, 0.006, 0, 0, depth / 2 - 0.003),
                ],
            )
            parts.blocks(material, [(0.006, height * 0.9, depth, x * (width / 2 - 0.003), 0, 0) for x in (-1, 0, 1)])
            parts.slab(palette.paper(rng), (width * 0.4, height * 0.9, 0.02), (-width * 0.24, 0.006, -0.01), radius=0)
            parts.slab(
                palette.bright_plastic(rng), (width * 0.3, height * 0.7, 0.03), (width * 0.24, 0.006, 0), radius=0
            )
        return parts.mesh()

    return Draft("stationery", size, build)


def add_teddy_bear(parts: Parts, fur: Material, nose: Material, height: Number) -> None:
    """Add a sitting bear."""
    s = height
    parts.add(ellipsoid(0.25 * s, 0.28 * s, 0.22 * s), fur, (0, 0.28 * s, 0))
    parts.add(sphere(0.2 * s, rings=7, segments=12), fur, (0, 0.7 * s, 0.02 * s))
    parts.add(sphere(0.08 * s, rings=5, segments=9), fur, (0, 0.66 * s, 0.2 * s))
    parts.add(sphere(0.03 * s, rings=4, segments=7), nose, (0, 0.68 * s, 0.275 * s))
    for x in (-1, 1):
        parts.add(sphere(0.085 * s, rings=5, segments=9), fur, (x * 0.17 * s, 0.87 * s, 0))
        parts.add(ellipsoid(0.09 * s, 0.1 * s, 0.2 * s), fur, (x * 0.19 * s, 0.1 * s, 0.24 * s), yaw=x * 18)
        parts.add(ellipsoid(0.08 * s, 0.18 * s, 0.09 * s), fur, (x * 0.28 * s, 0.38 * s, 0.06 * s), roll=x * 30)


def ellipsoid(half_x: Number, half_y: Number, half_z: Number) -> Mesh:
    """Make an ellipsoid about the origin."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 8)
    line = [
        (max(float(half_x * np.cos(t)), 1e-4), max(float(half_z * np.cos(t)), 1e-4), float(half_y * np.sin(t)))
        for t in angle
    ]
    return loft([line], segments=12)


def toy(rng: np.random.Generator) -> Draft:
    """Make a bear, building blocks, a car, a ball, or a ring tower."""
    kind = int(rng.integers(5))
    height = (uniform(rng, 0.18, 0.4), uniform(rng, 0.08, 0.2), uniform(rng, 0.07, 0.11), uniform(rng, 0.1, 0.24),
              uniform(rng, 0.16, 0.26))[kind]  # fmt: skip
    size = ((height * 0.72, height, height * 0.68), (0.26, height, 0.2), (height * 1.2, height, height * 2.2),
            (height, height, height), (height * 0.6, height, height * 0.6))[kind]  # fmt: skip

    def build() -> Mesh:
        parts = Parts()
        if kind == 0:
            add_teddy_bear(parts, palette.fur(rng), palette.black(rng), height)
        elif kind == 1:
            parts.slab(palette.bright_plastic(rng), (0.26, 0.012, 0.2), (0, 0, 0), radius=0)
            levels = max(2, round(height / 0.045))
            side = (height - 0.012) / levels
            for x, z, count in (
                (-0.08, -0.05, levels),
                (0.0, 0.04, 1),
                (0.08, -0.03, levels - 1),
                (-0.07, 0.06, 1),
                (0.08, 0.06, 1),
            ):
                for level in range(count):
                    parts.slab(
                        palette.bright_plastic(rng),
                        (side, side, side),
                        (x, 0.012 + level * side, z),
                        radius=0.003,
                        yaw=uniform(rng, 0, 30),
                    )
        elif kind == 2:
            body, tyre = palette.bright_plastic(rng), palette.black(rng)
            w, h, d = size
            parts.slab(body, (w * 0.9, h * 0.4, d), (0, h * 0.2, 0), radius=h * 0.1)
            parts.slab(
                palette.glass() if rng.random() < 0.1 else tyre,
                (w * 0.7, h * 0.4, d * 0.5),
                (0, h * 0.58, -d * 0.05),
                radius=h * 0.1,
            )
            for x in (-1, 1):
                for z in (-0.3, 0.3):
                    parts.bar(tyre, (x * w * 0.38, h * 0.2, z * d), (x * w * 0.5, h * 0.2, z * d), h * 0.2, segments=12)
        elif kind == 3:
            texture = textures.pattern(rng, palette.hue(rng, (0.6, 1), (0.6, 1)), palette.hue(rng, (0.2, 1), (0.6, 1)))
            material = Material("ball", albedo=(0.9, 0.9, 0.9), texture=texture, roughness=0.3)
            parts.add(sphere(height / 2, rings=10, segments=18), material, (0, height / 2, 0))
        else:
            y, r = 0.0, height * 0.3
            for _ in range(5):
                thickness = height * 0.17
                parts.add(
                    solid_of_revolution([(r * 0.8, y), (r, y + thickness / 2), (r * 0.8, y + thickness)], segments=14),
                    palette.bright_plastic(rng),
                )
                y, r = y + thickness, r * 0.84
            parts.add(sphere(height * 0.08, rings=5, segments=8), palette.bright_plastic(rng), (0, height * 0.92, 0))
        return parts.mesh()

    return Draft("toy", size, build)


def bathroom_thing(rng: np.random.Generator) -> Draft:
    """Make bottles, a cup with toothbrushes, a pile of towels, or paper rolls."""
    kind = int(rng.integers(4))
    size = (
        (uniform(rng, 0.16, 0.26), uniform(rng, 0.16, 0.24), 0.08),
        (0.08, uniform(rng, 0.17, 0.2), 0.08),
        (uniform(rng, 0.28, 0.42), uniform(rng, 0.1, 0.24), uniform(rng, 0.2, 0.3)),
        (0.12, 0.1, 0.11),
    )[kind]
    width, height, depth = size
    bottles = int(rng.integers(2, 5))
    rolls = int(rng.integers(1, 3))
    if kind == 3:
        depth = uniform(rng, 0.1, 0.125)
        size = (width, height, depth) = (1.08 * depth * rolls, 0.1 * int(rng.integers(1, 3)), depth)
    if kind == 0:
        depth = 0.84 * width / bottles
        size = (width, height, depth)

    def build() -> Mesh:
        parts = Parts()
        if kind == 0:
            for k in range(bottles):
                x = (-0.5 + (k + 0.5) / bottles) * width
                r, height_m = width / bottles * 0.42, height * (1.0 if k == 0 else uniform(rng, 0.55, 0.95))
                bottle = palette.plastic(rng)
                parts.add(
                    solid_of_revolution(
                        [(r, 0.0), (r, height_m * 0.7), (r * 0.4, height_m * 0.82), (r * 0.4, height_m)], segments=12
                    ),
                    bottle,
                    (x, 0, 0),
                )
                parts.slab(palette.plastic(rng), (r * 1.2, height_m * 0.1, r * 1.2), (x, height_m * 0.9, 0), radius=0)
        elif kind == 1:
            r, top = 0.035, height * 0.5
            parts.add(
                lathe(
                    [
                        [(1e-3, 0), (r, 0)],
                        [(r, 0), (r, top)],
                        [(r, top), (r * 0.9, top)],
                        [(r * 0.9, top), (1e-3, 0.01)],
                    ],
                    segments=14,
                ),
                palette.ceramic(rng),
            )
            for x, z in circle_points(int(rng.integers(1, 4)), 0.03, uniform(rng, 0, 3)):
                parts.bar(
                    palette.bright_plastic(rng),
                    (-x * 0.6, 0.01, -z * 0.6),
                    (x * 1.2, height, z * 1.2),
                    0.004,
                    segments=5,
                )
        elif kind == 2:
            count = int(rng.integers(2, 5))
            for k in range(count):
                parts.slab(
                    palette.cloth(rng),
                    (width, height / count, depth),
                    (0, k * height / count, 0),
                    radius=height / count * 0.45,
                    arcs=2,
                )
        else:
            roll = palette.paper(rng)
            for k in range(rolls):
                x = (-0.5 + (k + 0.5) / rolls) * width
                parts.add(solid_of_revolution([(depth / 2, 0.0), (depth / 2, 0.1)], segments=16), roll, (x, 0, 0))
            if height > 0.15:
                parts.add(solid_of_revolution([(depth / 2, 0.1), (depth / 2, 0.2)], segments=16), roll)
        return parts.mesh()

    return Draft("bathroom things", size, build)


def add_ring(
    parts: Parts, material: Material, at: tuple[Number, Number, Number], radius: Number, thickness: Number
) -> None:
    """Add a ring lying flat: a cable, a hose, a tyre."""
    ring = [(at[0] + float(x), at[1] + thickness, at[2] + float(z)) for x, z in circle_points(16, radius)]
    parts.add(tube([*ring, ring[0]], thickness, segments=6), material)
