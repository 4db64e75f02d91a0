"""Colour distributions of paints, woods, stones and cloths."""

from typing import Final

import numpy as np

from roomlight_generator.rooms.colour import paint
from roomlight_generator.rooms.scene import Rgb

_HUES: Final = (12, 25, 25, 45, 45, 62, 62, 85, 85, 100, 118, 145, 145, 165, 190, 215, 240, 240, 255, 255, 266, 300,
    348)  # fmt: skip
"""Common hues of paint and cloth, the frequent ones twice; degrees in OKLab."""

_WALL_HUES: Final = (
    # hue, spread, weight
    (150, 14, 2.2), (120, 10, 1.2), (240, 12, 2.2), (262, 8, 1.0), (200, 12, 1.1), (45, 8, 1.6), (30, 8, 0.6),
    (88, 8, 1.5), (68, 8, 0.8), (12, 10, 1.0), (350, 10, 0.6), (310, 12, 0.5),
)  # fmt: skip

_SPECIES: Final = (
    # reflectance from, to, chroma from, to, hue from, to, weight
    (0.34, 0.52, 0.035, 0.065, 70, 82, 3.0),  # pale oak, ash, birch
    (0.22, 0.36, 0.055, 0.085, 64, 76, 3.5),  # oak
    (0.20, 0.34, 0.075, 0.110, 58, 70, 1.5),  # pine, honey, beech
    (0.10, 0.20, 0.060, 0.090, 48, 62, 2.0),  # teak, cherry, smoked oak
    (0.05, 0.10, 0.030, 0.060, 42, 62, 1.5),  # walnut, wenge
    (0.07, 0.14, 0.060, 0.090, 32, 46, 0.7),  # mahogany, merbau
    (0.25, 0.45, 0.006, 0.020, 65, 90, 1.3),  # greyed
    (0.50, 0.66, 0.010, 0.030, 75, 90, 0.8),  # whitewashed
    (0.04, 0.07, 0.004, 0.015, 40, 90, 0.4),  # blackened
)


def hue(rng: np.random.Generator) -> float:
    """Choose one of the common hues."""
    return float((rng.choice(_HUES) + rng.normal(0, 6)) % 360)


def white(rng: np.random.Generator) -> Rgb:
    """Choose a white paint, fresh (reflectance .84) to old (.62), slightly warm, sometimes slightly cool."""
    warm = rng.random() < 0.75
    return paint(
        rng.uniform(0.62, 0.84), rng.uniform(0, 0.014), rng.uniform(70, 105) if warm else rng.uniform(200, 260)
    )


def off_white(rng: np.random.Generator) -> Rgb:
    """Choose cream, ivory or pale greige."""
    return paint(rng.uniform(0.5, 0.74), rng.uniform(0.01, 0.04), rng.uniform(68, 102))


def beige(rng: np.random.Generator) -> Rgb:
    """Choose beige, sand or taupe."""
    return paint(rng.uniform(0.35, 0.62), rng.uniform(0.012, 0.045), rng.uniform(55, 90))


def grey(rng: np.random.Generator) -> Rgb:
    """Choose a pale to medium grey."""
    return paint(rng.uniform(0.22, 0.68), rng.uniform(0, 0.012), rng.uniform(0, 360))


def neutral_wall(rng: np.random.Generator) -> Rgb:
    """Choose a neutral wall colour, the most frequent kind."""
    kinds = (white, off_white, beige, grey)
    return kinds[int(rng.choice(4, p=(0.38, 0.25, 0.18, 0.19)))](rng)


def wall_colour(rng: np.random.Generator) -> Rgb:
    """Choose a saturated wall colour: pastel, muted, strong or dark."""
    weights = np.array([entry[2] for entry in _WALL_HUES])
    middle, spread, _ = _WALL_HUES[int(rng.choice(len(_WALL_HUES), p=weights / weights.sum()))]
    angle = (middle + rng.normal(0, spread)) % 360
    kind = int(rng.choice(4, p=(0.28, 0.36, 0.2, 0.16)))
    if kind == 0:
        return paint(rng.uniform(0.48, 0.72), rng.uniform(0.03, 0.07), angle)
    if kind == 1:
        return paint(rng.uniform(0.2, 0.5), rng.uniform(0.03, 0.08), angle)
    if kind == 2:
        # Yellows and oranges are saturated only when light, blues and greens also when dark.
        low, high = (0.3, 0.55) if 50 < angle < 115 else (0.12, 0.4)
        return paint(rng.uniform(low, high), rng.uniform(0.08, 0.17), angle)
    return dark_wall(rng)


def dark_wall(rng: np.random.Generator) -> Rgb:
    """Choose navy, bottle green, charcoal, aubergine or chocolate."""
    middle, low, high = ((258, 0.03, 0.09), (160, 0.02, 0.06), (0, 0.0, 0.008), (335, 0.02, 0.06), (48, 0.02, 0.05))[
        int(rng.choice(5, p=(0.3, 0.25, 0.25, 0.1, 0.1)))
    ]
    return paint(rng.uniform(0.045, 0.14), rng.uniform(low, high), middle + rng.normal(0, 6))


def glaze(rng: np.random.Generator) -> Rgb:
    """Choose a wall tile colour: mostly white and pale, some strong colours, some black."""
    pick = rng.random()
    if pick < 0.45:
        return paint(rng.uniform(0.65, 0.85), rng.uniform(0, 0.015), rng.uniform(0, 360))
    if pick < 0.65:
        return paint(rng.uniform(0.4, 0.7), rng.uniform(0.01, 0.06), hue(rng))
    if pick < 0.9:
        return paint(rng.uniform(0.08, 0.4), rng.uniform(0.05, 0.13), hue(rng))
    return paint(rng.uniform(0.02, 0.08), rng.uniform(0, 0.02), hue(rng))


def stone_colour(rng: np.random.Generator) -> Rgb:
    """Choose a colour of floor tiles and slabs: beige, grey, terracotta, slate, near-white."""
    pick = rng.random()
    if pick < 0.35:
        return paint(rng.uniform(0.3, 0.6), rng.uniform(0.012, 0.05), rng.uniform(60, 90))
    if pick < 0.65:
        return paint(rng.uniform(0.15, 0.55), rng.uniform(0, 0.012), rng.uniform(0, 360))
    if pick < 0.78:
        return paint(rng.uniform(0.14, 0.3), rng.uniform(0.06, 0.1), rng.uniform(38, 55))
    if pick < 0.9:
        return paint(rng.uniform(0.04, 0.14), rng.uniform(0, 0.02), rng.uniform(150, 270))
    return paint(rng.uniform(0.6, 0.78), rng.uniform(0, 0.012), rng.uniform(60, 110))


def cloth_colour(rng: np.random.Generator) -> Rgb:
    """Choose a colour of upholstery, curtains or carpets: half neutral, half saturated."""
    pick = rng.random()
    if pick < 0.2:
        return paint(rng.uniform(0.4, 0.68), rng.uniform(0.005, 0.035), rng.uniform(60, 95))
    if pick < 0.42:
        return paint(rng.uniform(0.06, 0.45), rng.uniform(0, 0.015), rng.uniform(0, 360))
    if pick < 0.55:
        return paint(rng.uniform(0.06, 0.3), rng.uniform(0.02, 0.06), rng.uniform(40, 75))
    if pick < 0.8:
        return paint(rng.uniform(0.1, 0.45), rng.uniform(0.03, 0.08), hue(rng))
    if pick < 0.93:
        return paint(rng.uniform(0.06, 0.35), rng.uniform(0.08, 0.16), hue(rng))
    return paint(rng.uniform(0.02, 0.05), rng.uniform(0, 0.03), hue(rng))


def pale_cloth(rng: np.random.Generator) -> Rgb:
    """Choose a white, cream or grey cloth colour, sometimes a saturated one."""
    if rng.random() < 0.12:
        return paint(rng.uniform(0.35, 0.6), rng.uniform(0.04, 0.1), rng.uniform(0, 360))
    return (white, off_white, beige)[int(rng.choice(3, p=(0.4, 0.4, 0.2)))](rng)


def wood_colour(rng: np.random.Generator) -> Rgb:
    """Choose the colour of a wood, as stained or bleached as floors and furniture are."""
    weights = np.array([species[6] for species in _SPECIES])
    low, high, dull, rich, warm, cool, _ = _SPECIES[int(rng.choice(len(_SPECIES), p=weights / weights.sum()))]
    return paint(rng.uniform(low, high), rng.uniform(dull, rich), rng.uniform(warm, cool))
