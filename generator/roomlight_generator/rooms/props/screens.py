"""Televisions, computers and other electronics. Screens that can be switched on are materials named `screen`."""

import numpy as np

from roomlight_generator.rooms.props import palette, textures
from roomlight_generator.rooms.props.draft import Draft, Parts, uniform
from roomlight_generator.rooms.props.pictures import print_texture
from roomlight_generator.rooms.props.small_objects import add_ring
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, Vector, rectangle, tube


def screen(rng: np.random.Generator, aspect: Number = 1.78) -> Material:
    """Make a dark glossy material with a picture that appears when the screen is on."""
    level = uniform(rng, 0.015, 0.04)
    return Material(
        "screen", albedo=(level, level, level), texture=print_texture(rng, aspect), roughness=uniform(rng, 0.05, 0.25)
    )


def _add_picture(
    parts: Parts,
    material: Material,
    width: Number,
    height: Number,
    at: Vector,
    *,
    pitch: Number = 0.0,
    yaw: Number = 0.0,
) -> None:
    """Add a picture facing +z with its bottom centre at `at`."""
    parts.add(
        rectangle((-width / 2, 0, 0), (width, 0, 0), (0, height, 0), step=9, unit_uv=True),
        material,
        at,
        pitch=pitch,
        yaw=yaw,
    )


def television(rng: np.random.Generator) -> Draft:
    """Make a television on one or two feet."""
    width = uniform(rng, 0.7, 1.5)
    high = width * 9 / 16 + 0.02
    foot = uniform(rng, 0.04, 0.09)
    depth = uniform(rng, 0.18, 0.28)

    def build() -> Mesh:
        parts = Parts()
        dark = palette.black(rng) if rng.random() < 0.8 else palette.metal(rng)
        edge = uniform(rng, 0.006, 0.02)
        parts.slab(dark, (width, high, 0.03), (0, foot, 0), radius=0.004)
        _add_picture(parts, screen(rng), width - 2 * edge, high - 2 * edge, (0, foot + edge, 0.0158))
        parts.slab(dark, (width * 0.6, high * 0.5, 0.03), (0, foot + 0.06, -0.025), radius=0.01)
        if rng.random() < 0.5:
            parts.slab(dark, (width * 0.35, 0.014, depth), (0, 0, 0), radius=0.004)
            parts.slab(dark, (0.08, foot + 0.05, 0.02), (0, 0.005, -0.02), radius=0)
        else:
            for x in (-1, 1):
                parts.slab(dark, (0.03, 0.012, depth), (x * width * 0.36, 0, 0), radius=0)
                parts.slab(dark, (0.025, foot + 0.01, 0.02), (x * width * 0.36, 0, 0), radius=0)
        return parts.mesh()

    return Draft("television", (width, high + foot, depth), build)


def wall_television(rng: np.random.Generator) -> Draft:
    """Make a wall-mounted television."""
    width = uniform(rng, 0.8, 1.6)
    height, depth = width * 9 / 16 + 0.02, uniform(rng, 0.05, 0.09)

    def build() -> Mesh:
        parts = Parts()
        dark = palette.black(rng)
        edge = uniform(rng, 0.005, 0.018)
        parts.slab(dark, (width, height, 0.03), (0, 0, depth / 2 - 0.0165), radius=0.004)
        _add_picture(parts, screen(rng), width - 2 * edge, height - 2 * edge, (0, edge, depth / 2 - 0.0004))
        parts.slab(dark, (width * 0.4, height * 0.5, depth - 0.03), (0, height * 0.25, -0.015), radius=0)
        return parts.mesh()

    return Draft("wall television", (width, height, depth), build, elevation_m=uniform(rng, 0.9, 1.2))


def computer(rng: np.random.Generator) -> Draft:
    """Make one or two monitors with keyboard and mouse in front."""
    two = rng.random() < 0.2
    part_width = uniform(rng, 0.48, 0.7)
    width = part_width * (2.05 if two else 1.0)
    width, depth = max(width, 0.56), uniform(rng, 0.42, 0.52)
    high = part_width * uniform(rng, 0.5, 0.62)
    lift = uniform(rng, 0.1, 0.16)

    def build() -> Mesh:
        parts = Parts()
        dark = palette.black(rng) if rng.random() < 0.7 else palette.metal(rng)
        back = -depth / 2 + 0.12
        for x in (-part_width * 0.525, part_width * 0.525) if two else (0.0,):
            parts.slab(dark, (part_width, high, 0.03), (x, lift, back), radius=0.004)
            _add_picture(parts, screen(rng), part_width - 0.024, high - 0.024, (x, lift + 0.012, back + 0.0158))
            parts.slab(dark, (0.05, lift + 0.1, 0.02), (x, 0, back - 0.024), radius=0)
            parts.slab(dark, (0.24, 0.012, 0.2), (x, 0, back - 0.02), radius=0.003)
        front = depth / 2 - 0.075
        deck = Material(
            "keys",
            albedo=(0.9, 0.9, 0.9),
            texture=textures.keys(16, 5, base=uniform(rng, 0.05, 0.8), cap=uniform(rng, 0.1, 0.9)),
        )
        parts.slab(dark, (0.42, 0.016, 0.14), (-0.06, 0, front), radius=0.003)
        parts.add(rectangle((-0.265, 0.0166, front + 0.065), (0.41, 0, 0), (0, 0, -0.13), step=9, unit_uv=True), deck)
        parts.slab(dark, (0.06, 0.03, 0.1), (0.22, 0, front), radius=0.012)
        return parts.mesh()

    return Draft("computer", (width, high + lift, depth), build)


def laptop(rng: np.random.Generator) -> Draft:
    """Make an open laptop, its screen leaning back."""
    width, depth_m, lean = uniform(rng, 0.3, 0.38), uniform(rng, 0.21, 0.26), uniform(rng, 8, 25)
    height = depth_m * float(np.cos(np.radians(lean))) + 0.012
    depth = depth_m + depth_m * float(np.sin(np.radians(lean)))

    def build() -> Mesh:
        parts = Parts()
        skin = palette.metal(rng) if rng.random() < 0.6 else palette.plastic(rng)
        hinge = depth / 2 - depth_m
        parts.slab(skin, (width, 0.014, depth_m), (0, 0, hinge + depth_m / 2), radius=0.003)
        deck = Material(
            "keys", albedo=(0.9, 0.9, 0.9), texture=textures.keys(14, 5, base=0.5, cap=uniform(rng, 0.08, 0.3))
        )
        parts.add(
            rectangle(
                (-width * 0.44, 0.0146, hinge + depth_m * 0.6),
                (width * 0.88, 0, 0),
                (0, 0, -depth_m * 0.5),
                step=9,
                unit_uv=True,
            ),
            deck,
        )
        parts.slab(palette.black(rng), (0.1, 0.0006, 0.065), (0, 0.0142, hinge + depth_m * 0.78), radius=0)
        parts.slab(skin, (width, depth_m, 0.008), (0, 0.01, hinge), radius=0, pitch=-lean)
        _add_picture(parts, screen(rng, 1.6), width - 0.02, depth_m - 0.025, (0, 0.022, hinge + 0.002), pitch=-lean)
        return parts.mesh()

    return Draft("laptop", (width, height, depth), build)


def electronics(rng: np.random.Generator) -> Draft:
    """Make a loudspeaker, an amplifier, a router, a game console, a radio, a printer, or a telephone."""
    kind = int(rng.integers(6))
    size = (
        (uniform(rng, 0.14, 0.24), uniform(rng, 0.24, 0.42), uniform(rng, 0.18, 0.28)),
        (uniform(rng, 0.35, 0.44), uniform(rng, 0.07, 0.14), uniform(rng, 0.26, 0.34)),
        (uniform(rng, 0.16, 0.26), uniform(rng, 0.14, 0.22), uniform(rng, 0.1, 0.16)),
        (uniform(rng, 0.24, 0.34), uniform(rng, 0.05, 0.1), uniform(rng, 0.2, 0.3)),
        (uniform(rng, 0.2, 0.34), uniform(rng, 0.13, 0.2), uniform(rng, 0.08, 0.14)),
        (uniform(rng, 0.38, 0.48), uniform(rng, 0.16, 0.26), uniform(rng, 0.3, 0.4)),
    )[kind]
    width, height, depth = size

    def build() -> Mesh:
        parts = Parts()
        dark = palette.black(rng) if rng.random() < 0.7 else palette.metal(rng)
        z = depth / 2
        if kind == 0:
            case = palette.wood_or_paint(rng, 0.5) if rng.random() < 0.6 else dark
            parts.slab(case, (width, height, depth - 0.012), (0, 0, -0.006))
            cone = palette.black(rng)
            for y, r in ((0.3, 0.36), (0.74, 0.18)):
                parts.bar(cone, (0, height * y, z - 0.014), (0, height * y, z), width * r, width * r * 0.8, segments=18)
        elif kind == 1:
            parts.slab(dark, (width, height - 0.012, depth - 0.024), (0, 0.012, -0.012), radius=0.004)
            parts.blocks(dark, [(0.04, 0.012, 0.04, x * width * 0.4, 0, 0) for x in (-1, 1)])
            for x, r in ((-0.36, 0.018), (0.3, 0.026), (0.0, 0.012)):
                parts.bar(
                    palette.chrome(rng),
                    (x * width, height * 0.5, z - 0.024),
                    (x * width, height * 0.5, z),
                    min(r, height * 0.3),
                    segments=12,
                )
        elif kind == 2:
            parts.slab(dark, (width, 0.035, depth), (0, 0, 0), radius=0.01)
            for x in (-0.42, 0.0, 0.42):
                parts.slab(dark, (0.014, height - 0.02, 0.008), (x * width, 0.02, -depth * 0.4), radius=0)
        elif kind == 3:
            parts.slab(palette.plastic(rng), (width, height, depth), radius=0.012)
            parts.slab(dark, (width * 0.5, 0.008, 0.003), (0, height * 0.5, z), radius=0)
        elif kind == 4:
            case = palette.wood_or_paint(rng, 0.6)
            parts.slab(case, (width, height - 0.02, depth - 0.016), (0, 0, -0.008), radius=0.015)
            parts.slab(
                palette.cloth(rng, patterned=0),
                (width * 0.55, height * 0.65, 0.01),
                (-width * 0.16, height * 0.1, z - 0.02),
                radius=0,
            )
            parts.bar(
                palette.chrome(rng),
                (width * 0.32, height * 0.5, z - 0.02),
                (width * 0.32, height * 0.5, z),
                height * 0.14,
                segments=14,
            )
            parts.add(
                tube(
                    [
                        (-width * 0.35, height - 0.03, 0),
                        (-width * 0.33, height - 0.006, 0),
                        (width * 0.33, height - 0.006, 0),
                        (width * 0.35, height - 0.03, 0),
                    ],
                    0.006,
                    segments=6,
                ),
                palette.chrome(rng),
            )
        else:
            skin = palette.plastic(rng, palette.neutral(rng, 30, 240))
            parts.slab(skin, (width, height * 0.8, depth * 0.86), (0, 0, -depth * 0.07), radius=0.02)
            parts.slab(dark, (width * 0.7, 0.03, depth * 0.3), (0, height * 0.18, z - depth * 0.15), radius=0)
            parts.slab(
                palette.paper(rng), (0.21, height * 0.45, 0.012), (0, height * 0.55, -depth * 0.36), radius=0, pitch=-18
            )
        if kind in (2, 3) and rng.random() < 0.3:
            add_ring(parts, palette.black(rng), (0, 0.0, 0.0), min(width, depth) * 0.3, 0.004)
        return parts.mesh()

    return Draft("electronics", size, build)
