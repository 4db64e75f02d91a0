"""Materials of furniture: woods, paints, cloths, leathers, metals, plastics, ceramics.

Colours cover the whole range found in rooms: about a third of painted objects are white, a tenth black, a third
saturated; half of the cloth is neutral. Linear RGB; varnished or smooth materials have a coat (roughness 0.05 to 0.4).
"""

import colorsys
from dataclasses import replace
from typing import Final

import numpy as np

from roomlight_generator.rooms.props import textures
from roomlight_generator.rooms.props.draft import uniform
from roomlight_generator.rooms.props.textures import from_srgb
from roomlight_generator.rooms.scene import Material, Rgb
from roomlight_generator.rooms.shapes import Number

WHITEST: Final = 0.86
"""Maximum albedo of paint, in any channel."""

_WOODS: Final = (
    (214, 178, 130), (196, 152, 102), (226, 200, 160), (164, 112, 66), (128, 82, 50), (96, 62, 42),
    (150, 78, 48), (66, 46, 36), (232, 218, 194), (186, 136, 84), (38, 32, 30), (176, 166, 152),
)  # fmt: skip
"""sRGB of oak, golden oak, birch, cherry, walnut, dark walnut, mahogany, wenge, bleached, pine, black stain, grey."""


def srgb(red: Number, green: Number, blue: Number) -> Rgb:
    """Return the linear RGB of an sRGB colour given in 0 to 255."""
    values = np.minimum(from_srgb(np.array([red, green, blue], np.float64) / 255), WHITEST)
    return (float(values[0]), float(values[1]), float(values[2]))


def hue(rng: np.random.Generator, saturation: tuple[Number, Number], value: tuple[Number, Number]) -> Rgb:
    """Choose a colour of any hue within ranges of saturation and value (of sRGB)."""
    # Warm hues are more frequent in homes than green and purple ones.
    turn = float(rng.choice([uniform(rng, 0, 0.16), uniform(rng, 0.5, 0.68), uniform(rng, 0, 1)], p=[0.45, 0.25, 0.3]))
    r, g, b = colorsys.hsv_to_rgb(turn, uniform(rng, *saturation), uniform(rng, *value))
    return srgb(255 * r, 255 * g, 255 * b)


def neutral(rng: np.random.Generator, low: Number, high: Number) -> Rgb:
    """Choose a slightly warm or cool grey of sRGB value low to high (0 to 255)."""
    level, warm = uniform(rng, low, high), uniform(rng, -0.02, 0.06)
    return srgb(min(level * (1 + warm), 240), min(level * (1 + warm / 3), 240), level * (1 - warm))


def paint_colour(rng: np.random.Generator) -> Rgb:
    """Choose white, grey, black or a colour."""
    kind = rng.random()
    if kind < 0.36:
        return neutral(rng, 218, 240)
    if kind < 0.52:
        return neutral(rng, 70, 205)
    if kind < 0.63:
        return neutral(rng, 24, 50)
    return hue(rng, (0.12, 0.5), (0.25, 0.9)) if kind < 0.85 else hue(rng, (0.45, 0.9), (0.25, 0.88))


def cloth_colour(rng: np.random.Generator) -> Rgb:
    """Choose a cloth colour: half light or medium neutrals, else dark neutrals, muted and strong colours."""
    kind = rng.random()
    if kind < 0.24:
        return neutral(rng, 180, 236)
    if kind < 0.46:
        return neutral(rng, 80, 180)
    if kind < 0.58:
        return neutral(rng, 26, 66)
    if kind < 0.8:
        return hue(rng, (0.2, 0.5), (0.35, 0.85))
    return hue(rng, (0.5, 0.88), (0.3, 0.85))


def wood(rng: np.random.Generator) -> Material:
    """Choose grained wood, varnished more often than oiled."""
    base = np.array(_WOODS[int(rng.integers(len(_WOODS)))], np.float64) * uniform(rng, 0.86, 1.08)
    colour = srgb(*np.minimum(base + rng.uniform(-8, 8, 3), 236))
    roughness = None if rng.random() < 0.3 else uniform(rng, 0.12, 0.4)
    return Material("wood", albedo=(0.95, 0.95, 0.95), texture=textures.grain(rng, colour), roughness=roughness)


def paint(rng: np.random.Generator, colour: Rgb | None = None) -> Material:
    """Choose a painted or lacquered surface."""
    roughness = None if rng.random() < 0.2 else uniform(rng, 0.06, 0.4)
    return Material("paint", albedo=colour or paint_colour(rng), roughness=roughness)


def wood_or_paint(rng: np.random.Generator, wooden: Number = 0.6) -> Material:
    """Choose the material of a cabinet: wood with probability `wooden`, else paint."""
    return wood(rng) if rng.random() < wooden else paint(rng)


def cloth(rng: np.random.Generator, *, patterned: Number = 0.15) -> Material:
    """Choose woven cloth, plain or, with probability `patterned`, striped, checked or printed."""
    colour = cloth_colour(rng)
    if rng.random() < patterned:
        texture = textures.pattern(rng, colour, cloth_colour(rng))
    elif rng.random() < 0.7:
        texture = textures.weave(rng, colour)
    else:
        return Material("cloth", albedo=colour)
    return Material("cloth", albedo=(0.95, 0.95, 0.95), texture=texture)


def book_cover(rng: np.random.Generator) -> Material:
    """Choose a book's cover, usually coloured."""
    kind = rng.random()
    colour = (
        neutral(rng, 190, 238)
        if kind < 0.22
        else neutral(rng, 22, 90)
        if kind < 0.4
        else hue(rng, (0.2, 0.9), (0.25, 0.9))
    )
    return Material("cover", albedo=colour, roughness=uniform(rng, 0.12, 0.4) if rng.random() < 0.5 else None)


def fur(rng: np.random.Generator) -> Material:
    """Choose a toy animal's fur: brown, or any soft colour."""
    colour = hue(rng, (0.1, 0.5), (0.4, 0.95))
    if rng.random() < 0.6:
        colour = srgb(*(np.array([170, 116, 70]) * uniform(rng, 0.6, 1.35)))
    return Material("fur", albedo=(0.95, 0.95, 0.95), texture=textures.weave(rng, colour))


def leather(rng: np.random.Generator) -> Material:
    """Choose brown, black, cream or red leather."""
    base = ((92, 56, 34), (150, 90, 48), (34, 28, 26), (226, 214, 196), (120, 30, 28), (70, 74, 80))
    colour = np.array(base[int(rng.integers(len(base)))]) * uniform(rng, 0.85, 1.1)
    return Material("leather", albedo=srgb(*np.minimum(colour, 238)), roughness=uniform(rng, 0.22, 0.4))


def upholstery(rng: np.random.Generator) -> Material:
    """Choose cloth, or leather one time in five."""
    return leather(rng) if rng.random() < 0.2 else cloth(rng)


def metal(rng: np.random.Generator) -> Material:
    """Choose steel, brass, black or white metal: a rough dielectric coat approximates a conductor's reflection."""
    base = (
        (170, 172, 176),
        (200, 200, 204),
        (30, 30, 32),
        (24, 24, 24),
        (196, 152, 84),
        (168, 110, 78),
        (228, 228, 226),
    )
    colour = np.array(base[int(rng.integers(len(base)))]) * uniform(rng, 0.85, 1.08)
    return Material("metal", albedo=srgb(*np.minimum(colour, 236)), roughness=uniform(rng, 0.08, 0.35))


def chrome(rng: np.random.Generator) -> Material:
    """Choose the bright steel of taps and handles."""
    level = uniform(rng, 150, 215)
    return Material("chrome", albedo=srgb(level, level, level * 1.02), roughness=uniform(rng, 0.05, 0.15))


def plastic(rng: np.random.Generator, colour: Rgb | None = None) -> Material:
    """Choose smooth plastic."""
    return Material("plastic", albedo=colour or paint_colour(rng), roughness=uniform(rng, 0.1, 0.4))


def bright_plastic(rng: np.random.Generator) -> Material:
    """Choose the colour of a toy."""
    return plastic(rng, hue(rng, (0.7, 1.0), (0.7, 1.0)))


def black(rng: np.random.Generator) -> Material:
    """Choose the black plastic of electronics."""
    level = uniform(rng, 14, 40)
    return Material("black", albedo=srgb(level, level, level * 1.04), roughness=uniform(rng, 0.08, 0.35))


def ceramic(rng: np.random.Generator) -> Material:
    """Choose glazed ceramic: white or any colour."""
    colour = neutral(rng, 220, 240) if rng.random() < 0.4 else hue(rng, (0.15, 0.85), (0.25, 0.9))
    return Material("ceramic", albedo=colour, roughness=uniform(rng, 0.05, 0.25))


def sanitary(rng: np.random.Generator) -> Material:
    """Choose the white glazed ceramic or enamel of bathrooms."""
    return Material("sanitary", albedo=neutral(rng, 226, 240), roughness=uniform(rng, 0.05, 0.15))


def paper(rng: np.random.Generator) -> Material:
    """Choose white to yellowed paper."""
    return Material("paper", albedo=neutral(rng, 205, 238))


def cardboard(rng: np.random.Generator) -> Material:
    """Choose brown cardboard."""
    return Material("cardboard", albedo=srgb(*(np.array([184, 146, 100]) * uniform(rng, 0.85, 1.1))))


def glass() -> Material:
    """Return a thin clear pane."""
    return Material("glass", albedo=(0.9, 0.9, 0.9), glass=True)


def leaf(rng: np.random.Generator) -> Material:
    """Choose a green leaf, sometimes reddish or yellow."""
    turn = uniform(rng, 0.2, 0.38) if rng.random() < 0.9 else uniform(rng, 0.0, 0.14)
    r, g, b = colorsys.hsv_to_rgb(turn, uniform(rng, 0.35, 0.75), uniform(rng, 0.25, 0.62))
    roughness = uniform(rng, 0.25, 0.4) if rng.random() < 0.5 else None
    return Material("leaf", albedo=srgb(255 * r, 255 * g, 255 * b), roughness=roughness)


def soil(rng: np.random.Generator) -> Material:
    """Choose dark earth."""
    return Material("soil", albedo=srgb(*(np.array([64, 48, 38]) * uniform(rng, 0.7, 1.2))))


def shade(rng: np.random.Generator) -> Material:
    """Choose a lampshade: opal glass, paper or cloth; white, cream, sometimes coloured."""
    colour = neutral(rng, 205, 240)
    if rng.random() < 0.3:
        colour = hue(rng, (0.15, 0.6), (0.6, 0.92))
    return Material("shade", albedo=colour, roughness=uniform(rng, 0.1, 0.3) if rng.random() < 0.4 else None)


def opal(rng: np.random.Generator) -> Material:
    """Choose white glass or acrylic in front of a light source."""
    return Material("shade", albedo=neutral(rng, 225, 240), roughness=uniform(rng, 0.1, 0.4))


def worktop(rng: np.random.Generator) -> Material:
    """Choose granite, wood, white composite or steel."""
    kind = rng.random()
    if kind < 0.25:
        return replace(wood(rng), roughness=uniform(rng, 0.2, 0.4))
    colour = neutral(rng, 28, 70) if kind < 0.5 else neutral(rng, 120, 238)
    texture = textures.speckle(rng, colour)
    return Material("stone", albedo=(0.95, 0.95, 0.95), texture=texture, roughness=uniform(rng, 0.06, 0.3))
