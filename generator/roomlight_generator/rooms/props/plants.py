"""Plants in pots: floor plants and small ones. Leaves are thin sheets with two sides."""

from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.props import palette, textures
from roomlight_generator.rooms.props.draft import Draft, Kit, between
from roomlight_generator.rooms.props.smalls import turned_solid
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, double_sided_sheet, lathe, sphere, with_material

_GOLDEN_TURN: Final = 2.399963

_SPREAD: Final = (1.0, 1.0, 1.0, 1.0, 0.6, 0.55)
"""How wide each kind of greenery grows: grass, broad leaves, palm, bush, cactus, swords."""


def pot(rng: np.random.Generator, height: Number, across: Number) -> tuple[Mesh, float]:
    """A pot with earth in it, and the earth's height."""
    half = across / 2
    kind = int(rng.integers(3))
    stuff = (palette.ceramic, palette.paint, _wicker)[kind](rng)
    foot = half * between(rng, 0.65, 1.0)
    earth = height * 0.9
    wall = lathe(
        [
            [(1e-3, 0.0), (foot, 0.0)],
            [(foot, 0.0), ((foot + half) / 2 * 1.03, height / 2), (half, height)],
            [(half, height), (half * 0.9, height)],
            [(half * 0.9, height), (half * 0.88, earth)],
        ],
        segments=20,
    )
    ground = lathe([[(half * 0.89, 0.0), (half * 0.5, 0.004), (1e-3, 0.006)]], segments=20)
    kit = Kit()
    kit.add(wall, stuff)
    kit.add(ground, palette.soil(rng), (0, earth, 0))
    return kit.mesh(), earth


def _wicker(rng: np.random.Generator) -> Material:
    colour = palette.srgb(*(np.array([190, 150, 100]) * between(rng, 0.7, 1.15)))
    return Material("wicker", albedo=(0.95, 0.95, 0.95), texture=textures.wicker(rng, colour))


def blade(
    base: Float[np.ndarray, "3"],
    azimuth: Number,
    *,
    reach: Number,
    rise: Number,
    droop: Number,
    half_width: Number,
    rows: int = 6,
) -> Mesh:
    """One leaf from its base outward and up, bending over at its end, folded along its rib."""
    t = np.linspace(0, 1, rows)
    outward = np.array([np.cos(azimuth), 0, np.sin(azimuth)])
    sideways = np.array([-np.sin(azimuth), 0, np.cos(azimuth)])
    rib = (
        base
        + outward * (reach * t**1.4)[:, None]
        + np.array([0, 1, 0]) * (rise * np.sin(t * np.pi / 2) - droop * t**2.5)[:, None]
    )
    wide = half_width * (np.sin(np.pi * np.clip(t * 0.94 + 0.05, 0, 1)) ** 0.7)
    across = np.array([-1.0, 0.0, 1.0])
    fold = np.array([0, 1, 0]) * 0.35
    points = rib[:, None] + wide[:, None, None] * (across[:, None] * sideways + np.abs(across)[:, None] * fold)
    return double_sided_sheet(points[::-1].astype(np.float32), thickness=min(0.002, half_width * 0.05))


def _crown(
    kit: Kit, rng: np.random.Generator, material: Material, base: np.ndarray, count: int, *,
    reach: Number, rise: Number, droop: Number, half_width: Number, rows: int = 6,
) -> None:  # fmt: skip
    """Leaves all round, the outer ones lower."""
    for k in range(count):
        inner = k / max(count - 1, 1)
        kit.add(
            blade(
                base,
                _GOLDEN_TURN * k + between(rng, -0.3, 0.3),
                reach=reach * (1 - 0.55 * inner) * between(rng, 0.85, 1.1),
                rise=rise * (0.35 + 0.65 * inner) * between(rng, 0.88, 1.05),
                droop=droop * (1 - 0.7 * inner),
                half_width=half_width * between(rng, 0.8, 1.15),
                rows=rows,
            ),
            material,
        )


def _greenery(kit: Kit, rng: np.random.Generator, kind: int, earth: Number, height: Number, half: Number) -> None:
    """Above a pot: grass-like leaves, broad leaves, a palm on a stem, a bush, a cactus, swords."""
    green = palette.leaf(rng)
    up = height - earth
    ground = np.array([0.0, earth, 0.0])
    if kind == 0:
        _crown(
            kit,
            rng,
            green,
            ground,
            int(rng.integers(18, 30)),
            reach=half,
            rise=up,
            droop=up * 0.35,
            half_width=up * 0.045,
        )
    elif kind == 1:
        _crown(
            kit,
            rng,
            green,
            ground,
            int(rng.integers(9, 16)),
            reach=half * 0.9,
            rise=up,
            droop=up * 0.15,
            half_width=half * 0.32,
        )
    elif kind == 2:
        trunk = palette.cardboard(rng)
        stem = earth + up * between(rng, 0.4, 0.6)
        kit.bar(trunk, (0, earth - 0.01, 0), (0, stem, 0), half * 0.09, half * 0.06)
        _crown(kit, rng, green, np.array([0.0, stem, 0.0]), int(rng.integers(12, 22)), reach=half, rise=height - stem,
               droop=up * 0.3, half_width=half * 0.1)  # fmt: skip
    elif kind == 3:
        trunk = palette.cardboard(rng)
        kit.bar(trunk, (0, earth - 0.01, 0), (0, earth + up * 0.6, 0), half * 0.06, half * 0.04)
        for _ in range(int(rng.integers(40, 60))):
            direction = rng.standard_normal(3)
            direction /= np.linalg.norm(direction)
            place = (
                ground
                + (0, up * 0.62, 0)
                + direction * np.array([half * 0.75, up * 0.3, half * 0.75]) * between(rng, 0.5, 1)
            )
            azimuth = float(np.arctan2(direction[2], direction[0]))
            size = min(half, up) * between(rng, 0.25, 0.42)
            kit.add(blade(place, azimuth, reach=size, rise=size * between(rng, -0.3, 0.6), droop=size * 0.4,
                          half_width=size * 0.32, rows=4), green)  # fmt: skip
    elif kind == 4:
        r = min(half * 0.55, up * 0.22)
        side = [(r * 0.7, earth), (r, earth + up * 0.4), (r * 0.9, earth + up * 0.8), (r * 0.4, earth + up)]
        kit.add(turned_solid(side, segments=14), green)
        for k in range(int(rng.integers(0, 4))):
            angle, level = _GOLDEN_TURN * k, earth + up * between(rng, 0.3, 0.6)
            x, z = r * 1.35 * np.cos(angle), r * 1.35 * np.sin(angle)
            kit.add(
                turned_solid([(r * 0.3, 0.0), (r * 0.42, up * 0.15), (r * 0.2, up * 0.3)], segments=10),
                green,
                (x, level, z),
            )
            kit.bar(green, (0, level - r * 0.2, 0), (x, level + 0.02, z), r * 0.25)
    else:
        _crown(kit, rng, green, ground, int(rng.integers(8, 16)), reach=half, rise=up, droop=0.0, half_width=half * 0.2)


def plant(rng: np.random.Generator) -> Draft:
    """Standing on the floor, 0.5 to 2 m."""
    height = between(rng, 0.5, 2.0)
    kind = int(rng.integers(6))
    across = between(rng, 0.35, 0.6) * (0.7 + 0.4 * height) * _SPREAD[kind]
    return Draft("plant", (across, height, across), lambda: _potted(rng, kind, height, across, between(rng, 0.18, 0.4)))


def small_plant(rng: np.random.Generator) -> Draft:
    """Standing on a board or a table."""
    height = between(rng, 0.12, 0.5)
    kind = int(rng.integers(6))
    across = (between(rng, 0.5, 1.0) * height + 0.05) * _SPREAD[kind]
    return Draft(
        "small plant",
        (across, height, across),
        lambda: _potted(rng, kind, height, across, height * between(rng, 0.25, 0.45)),
    )


def _potted(rng: np.random.Generator, kind: int, height: Number, across: Number, tall: Number) -> Mesh:
    kit = Kit()
    made, earth = pot(rng, tall, across if kind in (4, 5) else min(across * 0.7, tall * between(rng, 0.8, 1.2)))
    kit.put(made)
    _greenery(kit, rng, kind, earth, height, across / 2)
    return kit.mesh()


def bunch(
    kit: Kit, rng: np.random.Generator, stuff: Material, count: int, radius: Number, spread: Number, floor: Number
) -> None:
    """Round things heaped in a bowl: fruit."""
    ball = with_material(sphere(radius, rings=6, segments=10), stuff)
    for k in range(count):
        angle = _GOLDEN_TURN * k
        away = spread * np.sqrt((k + 0.5) / count)
        kit.put(ball, (away * np.cos(angle), floor + radius * (1.6 if k < count // 3 else 1.0), away * np.sin(angle)),
                yaw=between(rng, 0, 360))  # fmt: skip
