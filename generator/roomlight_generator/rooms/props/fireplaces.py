"""Fireplaces and stoves, lit or cold: the only props that emit light without being switched on."""

import numpy as np

from roomlight_generator.rooms.props import palette, textures
from roomlight_generator.rooms.props.draft import Draft, Parts, uniform
from roomlight_generator.rooms.props.seating import add_legs
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, rectangle


def fireplace(rng: np.random.Generator) -> Draft:
    """Make a mantelpiece around a dark hearth with logs, usually burning; or an iron stove."""
    stove = rng.random() < 0.35
    width, height, depth = (
        (uniform(rng, 0.45, 0.65), uniform(rng, 1.6, 2.1), uniform(rng, 0.4, 0.5))
        if stove
        else (uniform(rng, 1.1, 1.6), uniform(rng, 1.0, 1.3), uniform(rng, 0.3, 0.45))
    )
    lit = rng.random() < 0.6
    # A wood fire has a mean luminance of about 1 to 4 kcd/m2 over its flames.
    level = uniform(rng, 0.4, 2.0) if lit else 0.0

    def build() -> Mesh:
        return (_stove if stove else _mantel)(rng, width, height, depth, level)

    return Draft("stove" if stove else "fireplace", (width, height, depth), build, top_m=None if stove else height)


def _add_fire(
    parts: Parts,
    rng: np.random.Generator,
    width: Number,
    height: Number,
    at: tuple[Number, Number, Number],
    level: Number,
) -> None:
    """Add logs, and flames in front of them if the fire burns."""
    bark = palette.cardboard(rng)
    x, y, z = at
    for k in range(3):
        parts.bar(
            bark,
            (x - width * 0.36, y + 0.04 + 0.05 * k, z + 0.03 * (1 - k)),
            (x + width * 0.36, y + 0.05 + 0.03 * k, z - 0.03 * (1 - k)),
            0.035,
        )
    if level > 0:
        glow = (level, level * 0.38, level * 0.07)
        fire = Material(
            "flame", albedo=(0.1, 0.1, 0.1), texture=textures.flames(rng), emission=glow, textured_emission=True
        )
        parts.add(
            rectangle((x - width * 0.4, y + 0.03, z + 0.05), (width * 0.8, 0, 0), (0, height, 0), step=9, unit_uv=True),
            fire,
        )


def _mantel(rng: np.random.Generator, width: Number, height: Number, depth: Number, level: Number) -> Mesh:
    parts = Parts()
    stone = palette.worktop(rng) if rng.random() < 0.5 else palette.wood_or_paint(rng, 0.4)
    soot = Material("soot", albedo=palette.neutral(rng, 22, 44))
    side, top = width * uniform(rng, 0.16, 0.24), height * uniform(rng, 0.2, 0.3)
    body = depth - 0.06
    hole = (width - 2 * side, height - top - 0.05)
    for x in (-1, 1):
        parts.slab(stone, (side, height - top, body), (x * (width - side - 0.08) / 2, 0.05, -0.03), radius=0.006)
    parts.slab(stone, (width - 0.08, top - 0.05, body), (0, height - top, -0.03), radius=0.006)
    parts.slab(stone, (width, 0.05, depth), (0, height - 0.05, 0), radius=0.01)
    parts.slab(stone, (width, 0.05, depth), (0, 0, 0), radius=0.006)
    parts.slab(soot, (hole[0] + 0.1, hole[1] + 0.05, 0.02), (0, 0.05, -depth / 2 + 0.02), radius=0)
    parts.slab(soot, (hole[0] + 0.02, 0.006, body), (0, 0.05, -0.03), radius=0)
    _add_fire(parts, rng, hole[0] * 0.8, hole[1] * 0.55, (0, 0.06, -0.02), level)
    if rng.random() < 0.4:
        pole = palette.metal(rng)
        parts.blocks(
            pole,
            [
                (0.012, hole[1] * 0.5, 0.012, float(x), 0.05, depth / 2 - 0.07)
                for x in np.linspace(-0.45, 0.45, 9) * hole[0]
            ],
        )
    return parts.mesh()


def _stove(rng: np.random.Generator, width: Number, height: Number, depth: Number, level: Number) -> Mesh:
    parts = Parts()
    iron = palette.black(rng) if rng.random() < 0.7 else palette.metal(rng)
    body = uniform(rng, 0.75, 0.95)
    t = 0.03
    parts.slab(iron, (width, 0.03, depth), (0, body - 0.03, 0), radius=0.006)
    parts.slab(iron, (width, 0.25, depth - 0.02), (0, 0.1, -0.01), radius=0)
    parts.blocks(iron, [(t, body - 0.35, depth - 0.02, x * (width - t) / 2, 0.32, -0.01) for x in (-1, 1)])
    parts.slab(iron, (width, body - 0.35, t), (0, 0.32, -depth / 2 + t / 2), radius=0)
    parts.blocks(iron, [(width, 0.05, t, 0, y, depth / 2 - t / 2 - 0.01) for y in (0.32, body - 0.09)])
    parts.slab(palette.glass(), (width - 2 * t, body - 0.45, 0.004), (0, 0.37, depth / 2 - 0.03), radius=0)
    add_legs(parts, iron, (width - 0.1, depth - 0.1), 0.12, thickness=0.02)
    _add_fire(parts, rng, width * 0.8, (body - 0.45) * 0.7, (0, 0.35, -0.02), level)
    parts.bar(iron, (0, body - 0.01, -depth * 0.2), (0, height, -depth * 0.2), 0.07, segments=14)
    parts.bar(
        palette.chrome(rng), (width * 0.36, 0.5, depth / 2 - 0.005), (width * 0.36, 0.62, depth / 2 - 0.005), 0.008
    )
    return parts.mesh()
