"""Objects on kitchen worktops and dining tables."""

import numpy as np

from roomlight_generator.rooms.props import palette
from roomlight_generator.rooms.props.draft import Draft, Parts, uniform
from roomlight_generator.rooms.props.plants import add_fruit
from roomlight_generator.rooms.props.small_objects import solid_of_revolution
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, lathe, tube


def bowl(radius: Number, height: Number, *, segments: int = 20) -> Mesh:
    """Make an open bowl with a wall."""
    r, h = radius, height
    return lathe(
        [
            [(1e-3, 0.0), (r * 0.5, 0.0)],
            [(r * 0.5, 0.0), (r * 0.85, h * 0.45), (r, h)],
            [(r, h), (r * 0.94, h)],
            [(r * 0.94, h), (r * 0.79, h * 0.45), (1e-3, h * 0.12)],
        ],
        segments=segments,
    )


def plate(radius: Number, height: Number, *, segments: int = 22) -> Mesh:
    """Make a flat dish."""
    r, h = radius, height
    return lathe([[(1e-3, 0.0), (r * 0.6, 0.0)], [(r * 0.6, 0.0), (r, h * 0.85)], [(r, h * 0.85), (r * 0.98, h)],
                  [(r * 0.98, h), (r * 0.62, h * 0.4), (1e-3, h * 0.4)]], segments=segments)  # fmt: skip


def add_cup(
    parts: Parts, material: Material, at: tuple[Number, Number, Number], radius: Number, height: Number
) -> None:
    """Add a cup with a handle."""
    r, h = radius, height
    x, y, z = at
    parts.add(
        lathe(
            [
                [(1e-3, 0.0), (r * 0.8, 0.0)],
                [(r * 0.8, 0.0), (r, h)],
                [(r, h), (r * 0.92, h)],
                [(r * 0.92, h), (r * 0.74, 0.01)],
                [(r * 0.74, 0.01), (1e-3, 0.01)],
            ],
            segments=14,
        ),
        material,
        at,
    )
    arc = [(x + r * (0.85 + 0.55 * np.sin(t)), y + h * (0.5 - 0.32 * np.cos(t)), z) for t in np.linspace(0.2, 2.9, 6)]
    parts.add(tube(arc, 0.005, segments=5), material)


def tableware(rng: np.random.Generator) -> Draft:
    """Make a place setting with plate, glass and cutlery; cups; a jug; stacked plates; or a bottle with glasses."""
    kind = int(rng.integers(5))
    size = (
        (uniform(rng, 0.38, 0.46), uniform(rng, 0.1, 0.2), uniform(rng, 0.24, 0.3)),
        (uniform(rng, 0.16, 0.34), uniform(rng, 0.08, 0.11), 0.14),
        (uniform(rng, 0.14, 0.2), uniform(rng, 0.18, 0.28), uniform(rng, 0.11, 0.14)),
        (uniform(rng, 0.22, 0.28), uniform(rng, 0.06, 0.16), 0.0),
        (uniform(rng, 0.24, 0.34), uniform(rng, 0.28, 0.33), 0.12),
    )[kind]
    width, height, depth = size[0], size[1], size[2] or size[0]

    def build() -> Mesh:
        parts = Parts()
        material, clear = palette.ceramic(rng), palette.glass()
        if kind == 0:
            r = depth * 0.46
            parts.add(plate(r, 0.02), material)
            steel = palette.chrome(rng)
            parts.blocks(steel, [(0.016, 0.004, 0.2, x, 0, 0) for x in (-width / 2 + 0.02, -width / 2 + 0.045)])
            parts.blocks(steel, [(0.018, 0.004, 0.21, r + 0.025, 0, 0)])
            parts.slab(palette.cloth(rng), (0.09, 0.004, depth), (-width / 2 + 0.045, 0, 0), radius=0)
            x = width / 2 - 0.04
            parts.add(
                solid_of_revolution([(0.03, 0.0), (0.036, height)], segments=14),
                clear if rng.random() < 0.7 else material,
                (x, 0, -depth * 0.32),
            )
        elif kind == 1:
            count = 2 if width > 0.22 else 1
            for k in range(count):
                x = (k - (count - 1) / 2) * width * 0.5 - 0.01
                parts.add(plate(0.07, 0.014, segments=16), material, (x, 0, 0))
                add_cup(parts, material, (x, 0.012, 0), 0.04, height - 0.012)
        elif kind == 2:
            r = depth / 2
            parts.add(
                solid_of_revolution(
                    [(r * 0.7, 0.0), (r, height * 0.35), (r * 0.6, height * 0.8), (r * 0.7, height)], segments=18
                ),
                material,
            )
            arc = [
                (r * 0.6 + (width - 2 * r) * np.sin(t) * 1.1, height * (0.55 - 0.3 * np.cos(t)), 0.0)
                for t in np.linspace(0.1, 3.0, 7)
            ]
            parts.add(tube(arc, 0.008, segments=6), material)
        elif kind == 3:
            r, count = width / 2, max(2, int(height / 0.022))
            for k in range(min(count, 6)):
                y = k * height / min(count, 6)
                parts.add(plate(r, height / min(count, 6)), material, (0, y, 0))
        else:
            bottle = Material("bottle", albedo=palette.hue(rng, (0.5, 1), (0.08, 0.35)), roughness=0.06)
            x = -width / 2 + 0.045
            parts.add(
                solid_of_revolution(
                    [(0.038, 0.0), (0.038, height * 0.55), (0.014, height * 0.72), (0.014, height)], segments=16
                ),
                bottle,
                (x, 0, 0),
            )
            parts.add(
                solid_of_revolution([(0.0385, height * 0.15), (0.0385, height * 0.45)], segments=16),
                palette.paper(rng),
                (x, 0, 0),
            )
            for dx, dz in ((0.0, 0.02), (-0.09, -0.02)):
                parts.add(
                    solid_of_revolution(
                        [(0.032, 0.0), (0.004, 0.006), (0.004, 0.07), (0.036, 0.11), (0.03, 0.16)], segments=14
                    ),
                    clear,
                    (width / 2 - 0.04 + dx, 0, dz),
                )
        return parts.mesh()

    return Draft("tableware", (width, height, depth), build)


def food(rng: np.random.Generator) -> Draft:
    """Make a bowl of fruit, a loaf on a board, a cake, jars, or packets."""
    kind = int(rng.integers(5))
    size = (
        (uniform(rng, 0.22, 0.34), uniform(rng, 0.1, 0.15), 0.0),
        (uniform(rng, 0.3, 0.42), uniform(rng, 0.09, 0.13), uniform(rng, 0.18, 0.26)),
        (uniform(rng, 0.22, 0.3), uniform(rng, 0.1, 0.16), 0.0),
        (uniform(rng, 0.2, 0.36), uniform(rng, 0.1, 0.22), uniform(rng, 0.08, 0.11)),
        (uniform(rng, 0.2, 0.3), uniform(rng, 0.2, 0.3), uniform(rng, 0.07, 0.1)),
    )[kind]
    width, height, depth = size[0], size[1], size[2] or size[0]

    def build() -> Mesh:
        parts = Parts()
        if kind == 0:
            material = palette.ceramic(rng) if rng.random() < 0.6 else palette.wood(rng)
            parts.add(bowl(width / 2, height * 0.62), material)
            fruit = ((216, 40, 30), (236, 140, 30), (236, 210, 60), (120, 170, 50))
            for part in range(2):
                colour = palette.srgb(*fruit[int(rng.integers(4))])
                peel = Material("fruit", albedo=colour, roughness=uniform(rng, 0.2, 0.4))
                add_fruit(parts, rng, peel, 5, height * 0.27, width * 0.26, height * (0.22 + 0.18 * part))
        elif kind == 1:
            parts.slab(palette.wood(rng), (width, 0.018, depth), radius=0.005)
            crust = Material("crust", albedo=palette.srgb(*(np.array([176, 112, 54]) * uniform(rng, 0.8, 1.15))))
            parts.slab(crust, (width * 0.7, height - 0.018, depth * 0.5), (0, 0.018, 0), radius=0.05, arcs=2)
        elif kind == 2:
            r = width / 2
            icing = Material("icing", albedo=palette.hue(rng, (0.05, 0.6), (0.4, 0.95)), roughness=0.3)
            parts.add(
                solid_of_revolution(
                    [(r * 0.45, 0.0), (r * 0.12, height * 0.15), (r * 0.2, height * 0.3), (r, height * 0.38)],
                    segments=22,
                ),
                palette.ceramic(rng),
            )
            parts.add(
                solid_of_revolution(
                    [(r * 0.8, height * 0.38), (r * 0.82, height * 0.8), (r * 0.74, height * 0.9)], segments=20
                ),
                icing,
            )
            for k in range(5):
                angle = k * 1.2566
                parts.bar(
                    palette.bright_plastic(rng),
                    (r * 0.5 * np.cos(angle), height * 0.88, r * 0.5 * np.sin(angle)),
                    (r * 0.5 * np.cos(angle), height, r * 0.5 * np.sin(angle)),
                    0.008,
                    segments=6,
                )
        elif kind == 3:
            count = max(2, int(width / 0.1))
            for k in range(count):
                r = min(width / count, depth) * 0.48
                x = (k / (count - 1) - 0.5) * (width - 2 * r)
                height_m = height * (1.0 if k == 0 else uniform(rng, 0.6, 1))
                filling = palette.paint(rng, palette.hue(rng, (0.2, 0.8), (0.3, 0.9)))
                parts.add(
                    solid_of_revolution(
                        [(r * 0.97, 0.0), (r * 0.97, height_m * 0.86), (r * 0.8, height_m * 0.9)], segments=14
                    ),
                    filling,
                    (x, 0, 0),
                )
                parts.bar(palette.metal(rng), (x, height_m * 0.88, 0), (x, height_m, 0), r, segments=14)
        else:
            count = int(rng.integers(2, 4))
            for k in range(count):
                x, height_m = (k + 0.5) / count * width - width / 2, height * (1.0 if k == 0 else uniform(rng, 0.6, 1))
                packet = Material("packet", albedo=palette.hue(rng, (0.4, 1), (0.4, 1)), roughness=0.3)
                parts.slab(packet, (width / count * 0.94, height_m, depth), (x, 0, 0), radius=0)
                parts.slab(
                    palette.paper(rng),
                    (width / count * 0.6, height_m * 0.3, 0.002),
                    (x, height_m * 0.4, depth / 2),
                    radius=0,
                )
        return parts.mesh()

    return Draft("food", (width, height, depth), build)


def kitchen_appliance(rng: np.random.Generator) -> Draft:
    """Make a kettle, toaster, microwave oven, coffee machine, mixer, or pot."""
    kind = int(rng.integers(6))
    size = (
        (uniform(rng, 0.19, 0.24), uniform(rng, 0.2, 0.26), uniform(rng, 0.15, 0.18)),
        (uniform(rng, 0.26, 0.34), uniform(rng, 0.17, 0.21), uniform(rng, 0.15, 0.2)),
        (uniform(rng, 0.44, 0.52), uniform(rng, 0.25, 0.31), uniform(rng, 0.32, 0.4)),
        (uniform(rng, 0.18, 0.3), uniform(rng, 0.3, 0.4), uniform(rng, 0.26, 0.36)),
        (uniform(rng, 0.15, 0.18), uniform(rng, 0.36, 0.44), 0.0),
        (uniform(rng, 0.28, 0.36), uniform(rng, 0.14, 0.24), uniform(rng, 0.2, 0.26)),
    )[kind]
    width, height, depth = size[0], size[1], size[2] or size[0]

    def build() -> Mesh:
        parts = Parts()
        skin = (palette.metal, palette.plastic, palette.chrome)[int(rng.integers(3))](rng)
        dark = palette.black(rng)
        z = depth / 2
        if kind == 0:
            r = depth / 2
            x = -(width - depth) / 2
            parts.add(
                solid_of_revolution(
                    [(r, 0.0), (r, 0.02), (r * 0.95, 0.03), (r * 0.7, height * 0.9), (r * 0.3, height)], segments=18
                ),
                skin,
                (x, 0, 0),
            )
            arc = [
                (x + r * 0.7 + (width - depth + r * 0.25) * np.sin(t), height * (0.52 - 0.34 * np.cos(t)), 0.0)
                for t in np.linspace(0.15, 2.9, 6)
            ]
            parts.add(tube(arc, 0.011, segments=6), dark)
        elif kind == 1:
            parts.slab(skin, (width, height - 0.012, depth), (0, 0.012, 0), radius=0.035, arcs=2)
            parts.blocks(dark, [(width * 0.7, 0.004, 0.028, 0, height - 0.003, s * depth * 0.18) for s in (-1, 1)])
            parts.blocks(
                dark, [(0.03, 0.02, 0.03, x * width * 0.35, 0, s * depth * 0.3) for x in (-1, 1) for s in (-1, 1)]
            )
        elif kind == 2:
            parts.slab(skin, (width, height - 0.012, depth - 0.03), (0, 0.012, -0.015), radius=0.006)
            parts.slab(dark, (width * 0.72, height - 0.04, 0.014), (-width * 0.12, 0.026, z - 0.03), radius=0)
            parts.bar(skin, (width * 0.22, 0.06, z - 0.006), (width * 0.22, height - 0.06, z - 0.006), 0.006)
            parts.blocks(dark, [(width * 0.14, 0.03, 0.004, width * 0.39, height * 0.75, z - 0.03)])
            parts.bar(
                dark,
                (width * 0.39, height * 0.35, z - 0.03),
                (width * 0.39, height * 0.35, z - 0.008),
                0.025,
                segments=14,
            )
            parts.blocks(
                dark, [(0.03, 0.014, 0.03, x * width * 0.4, 0, s * depth * 0.3) for x in (-1, 1) for s in (-1, 1)]
            )
        elif kind == 3:
            parts.slab(skin, (width, height, depth * 0.45), (0, 0, -depth * 0.275), radius=0.012)
            parts.slab(skin, (width, height * 0.3, depth), (0, height * 0.7, 0), radius=0.012)
            parts.slab(dark, (width, 0.04, depth), (0, 0, 0), radius=0)
            parts.add(
                solid_of_revolution([(0.045, 0.0), (0.06, 0.05), (0.045, 0.12)], segments=16),
                palette.black(rng),
                (0, 0.04, depth * 0.2),
            )
        elif kind == 4:
            r = width / 2
            parts.add(
                solid_of_revolution([(r, 0.0), (r * 0.85, height * 0.3), (r * 0.7, height * 0.36)], segments=18), skin
            )
            jar = palette.glass() if rng.random() < 0.6 else palette.plastic(rng)
            parts.add(solid_of_revolution([(r * 0.6, height * 0.36), (r * 0.9, height * 0.88)], segments=18), jar)
            parts.add(solid_of_revolution([(r * 0.92, height * 0.88), (r * 0.5, height)], segments=18), dark)
        else:
            r = depth / 2
            parts.add(
                solid_of_revolution(
                    [(r * 0.96, 0.0), (r, height * 0.75), (r * 1.0, height * 0.78), (r * 0.5, height * 0.88)],
                    segments=22,
                ),
                skin,
            )
            parts.bar(dark, (0, height * 0.85, 0), (0, height, 0), 0.018)
            for x in (-1, 1):
                parts.slab(
                    dark,
                    (width / 2 - r + 0.02, 0.02, 0.07),
                    (x * (width / 2 + r - 0.02) / 2, height * 0.55, 0),
                    radius=0,
                )
        return parts.mesh()

    return Draft("kitchen appliance", (width, height, depth), build)
