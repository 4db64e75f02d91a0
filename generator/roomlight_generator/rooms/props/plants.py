"""Potted plants, for floors and tables. Leaves are thin double-sided sheets."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from roomlight_generator.rooms.props import palette, textures
from roomlight_generator.rooms.props.draft import Draft, Parts, uniform
from roomlight_generator.rooms.props.small_objects import solid_of_revolution
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, double_sided_sheet, lathe, sphere, with_material

_GOLDEN_ANGLE: Final = 2.399963

_SPREAD: Final = (1.0, 1.0, 1.0, 1.0, 0.6, 0.55)
"""Relative spread of each kind of foliage: grass, broad leaves, palm, bush, cactus, swords."""


def pot(rng: np.random.Generator, height: Number, across: Number) -> tuple[Mesh, float]:
    """Make a pot with soil in it; also return the soil's height."""
    half = across / 2
    kind = int(rng.integers(3))
    material = (palette.ceramic, palette.paint, _wicker)[kind](rng)
    foot = half * uniform(rng, 0.65, 1.0)
    soil_top = height * 0.9
    wall = lathe(
        [
            [(1e-3, 0.0), (foot, 0.0)],
            [(foot, 0.0), ((foot + half) / 2 * 1.03, height / 2), (half, height)],
            [(half, height), (half * 0.9, height)],
            [(half * 0.9, height), (half * 0.88, soil_top)],
        ],
        segments=20,
    )
    ground = lathe([[(half * 0.89, 0.0), (half * 0.5, 0.004), (1e-3, 0.006)]], segments=20)
    parts = Parts()
    parts.add(wall, material)
    parts.add(ground, palette.soil(rng), (0, soil_top, 0))
    return parts.mesh(), soil_top


def _wicker(rng: np.random.Generator) -> Material:
    colour = palette.srgb(*(np.array([190, 150, 100]) * uniform(rng, 0.7, 1.15)))
    return Material("wicker", albedo=(0.95, 0.95, 0.95), texture=textures.wicker(rng, colour))


@dataclass(frozen=True)
class LeafShape:
    """Shape of a leaf, metres: horizontal reach, rise, droop of the tip, half width; `rows` of vertices along it."""

    reach: Number
    rise: Number
    droop: Number
    half_width: Number
    rows: int = 6


def leaf(base: np.ndarray, azimuth: Number, shape: LeafShape) -> Mesh:
    """Make one leaf from its base outward and up, bending over at its end, folded along its rib."""
    t = np.linspace(0, 1, shape.rows)
    outward = np.array([np.cos(azimuth), 0, np.sin(azimuth)])
    sideways = np.array([-np.sin(azimuth), 0, np.cos(azimuth)])
    rib = (
        base
        + outward * (shape.reach * t**1.4)[:, None]
        + np.array([0, 1, 0]) * (shape.rise * np.sin(t * np.pi / 2) - shape.droop * t**2.5)[:, None]
    )
    width_m = shape.half_width * (np.sin(np.pi * np.clip(t * 0.94 + 0.05, 0, 1)) ** 0.7)
    across = np.array([-1.0, 0.0, 1.0])
    fold = np.array([0, 1, 0]) * 0.35
    points = rib[:, None] + width_m[:, None, None] * (across[:, None] * sideways + np.abs(across)[:, None] * fold)
    return double_sided_sheet(points[::-1].astype(np.float32), thickness=min(0.002, shape.half_width * 0.05))


def _add_leaves(
    parts: Parts, rng: np.random.Generator, material: Material, base: np.ndarray, count: int, shape: LeafShape
) -> None:
    """Add leaves all around, the outer ones lower."""
    for k in range(count):
        inner = k / max(count - 1, 1)
        azimuth = _GOLDEN_ANGLE * k + uniform(rng, -0.3, 0.3)
        varied = LeafShape(
            reach=shape.reach * (1 - 0.55 * inner) * uniform(rng, 0.85, 1.1),
            rise=shape.rise * (0.35 + 0.65 * inner) * uniform(rng, 0.88, 1.05),
            droop=shape.droop * (1 - 0.7 * inner),
            half_width=shape.half_width * uniform(rng, 0.8, 1.15),
            rows=shape.rows,
        )
        parts.add(leaf(base, azimuth, varied), material)


def _add_foliage(
    parts: Parts, rng: np.random.Generator, kind: int, soil_top: Number, height: Number, half: Number
) -> None:
    """Add foliage above a pot: grass-like leaves, broad leaves, a palm on a stem, a bush, a cactus, swords."""
    green = palette.leaf(rng)
    up = height - soil_top
    ground = np.array([0.0, soil_top, 0.0])
    if kind == 0:
        blades = LeafShape(reach=half, rise=up, droop=up * 0.35, half_width=up * 0.045)
        _add_leaves(parts, rng, green, ground, int(rng.integers(18, 30)), blades)
    elif kind == 1:
        broad = LeafShape(reach=half * 0.9, rise=up, droop=up * 0.15, half_width=half * 0.32)
        _add_leaves(parts, rng, green, ground, int(rng.integers(9, 16)), broad)
    elif kind == 2:
        trunk = palette.cardboard(rng)
        stem = soil_top + up * uniform(rng, 0.4, 0.6)
        parts.bar(trunk, (0, soil_top - 0.01, 0), (0, stem, 0), half * 0.09, half * 0.06)
        fronds = LeafShape(reach=half, rise=height - stem, droop=up * 0.3, half_width=half * 0.1)
        _add_leaves(parts, rng, green, np.array([0.0, stem, 0.0]), int(rng.integers(12, 22)), fronds)
    elif kind == 3:
        trunk = palette.cardboard(rng)
        parts.bar(trunk, (0, soil_top - 0.01, 0), (0, soil_top + up * 0.6, 0), half * 0.06, half * 0.04)
        for _ in range(int(rng.integers(40, 60))):
            direction = rng.standard_normal(3)
            direction /= np.linalg.norm(direction)
            place = (
                ground
                + (0, up * 0.62, 0)
                + direction * np.array([half * 0.75, up * 0.3, half * 0.75]) * uniform(rng, 0.5, 1)
            )
            azimuth = float(np.arctan2(direction[2], direction[0]))
            size = min(half, up) * uniform(rng, 0.25, 0.42)
            shape = LeafShape(size, size * uniform(rng, -0.3, 0.6), size * 0.4, size * 0.32, rows=4)
            parts.add(leaf(place, azimuth, shape), green)
    elif kind == 4:
        r = min(half * 0.55, up * 0.22)
        side = [(r * 0.7, soil_top), (r, soil_top + up * 0.4), (r * 0.9, soil_top + up * 0.8), (r * 0.4, soil_top + up)]
        parts.add(solid_of_revolution(side, segments=14), green)
        for k in range(int(rng.integers(0, 4))):
            angle, level = _GOLDEN_ANGLE * k, soil_top + up * uniform(rng, 0.3, 0.6)
            x, z = r * 1.35 * np.cos(angle), r * 1.35 * np.sin(angle)
            parts.add(
                solid_of_revolution([(r * 0.3, 0.0), (r * 0.42, up * 0.15), (r * 0.2, up * 0.3)], segments=10),
                green,
                (x, level, z),
            )
            parts.bar(green, (0, level - r * 0.2, 0), (x, level + 0.02, z), r * 0.25)
    else:
        swords = LeafShape(reach=half, rise=up, droop=0.0, half_width=half * 0.2)
        _add_leaves(parts, rng, green, ground, int(rng.integers(8, 16)), swords)


def plant(rng: np.random.Generator) -> Draft:
    """Make a floor plant, 0.5 to 2 m tall."""
    height = uniform(rng, 0.5, 2.0)
    kind = int(rng.integers(6))
    across = uniform(rng, 0.35, 0.6) * (0.7 + 0.4 * height) * _SPREAD[kind]
    return Draft("plant", (across, height, across), lambda: _potted(rng, kind, height, across, uniform(rng, 0.18, 0.4)))


def small_plant(rng: np.random.Generator) -> Draft:
    """Make a plant for a shelf or a table."""
    height = uniform(rng, 0.12, 0.5)
    kind = int(rng.integers(6))
    across = (uniform(rng, 0.5, 1.0) * height + 0.05) * _SPREAD[kind]
    return Draft(
        "small plant",
        (across, height, across),
        lambda: _potted(rng, kind, height, across, height * uniform(rng, 0.25, 0.45)),
    )


def _potted(rng: np.random.Generator, kind: int, height: Number, across: Number, height_m: Number) -> Mesh:
    parts = Parts()
    made, soil_top = pot(
        rng, height_m, across if kind in (4, 5) else min(across * 0.7, height_m * uniform(rng, 0.8, 1.2))
    )
    parts.add_mesh(made)
    _add_foliage(parts, rng, kind, soil_top, height, across / 2)
    return parts.mesh()


def add_fruit(
    parts: Parts,
    rng: np.random.Generator,
    material: Material,
    count: int,
    radius: Number,
    spread: Number,
    floor: Number,
) -> None:
    """Add round fruit heaped in a bowl."""
    fruit = with_material(sphere(radius, rings=6, segments=10), material)
    for k in range(count):
        angle = _GOLDEN_ANGLE * k
        away = spread * np.sqrt((k + 0.5) / count)
        parts.add_mesh(
            fruit,
            (away * np.cos(angle), floor + radius * (1.6 if k < count // 3 else 1.0), away * np.sin(angle)),
            yaw=uniform(rng, 0, 360),
        )
