"""Materials of furniture: woods, paints, cloths, leathers, metals, plastics, ceramics.

Colours are drawn over the whole range that rooms have: about a third of painted things are white, a tenth black, a
third saturated; cloth is half neutral. Linear RGB; a coat (roughness 0.05 to 0.4) on what is varnished or smooth.
"""

import colorsys
from dataclasses import replace
from typing import Final

import numpy as np

from roomlight_generator.rooms.props import textures
from roomlight_generator.rooms.props.draft import between
from roomlight_generator.rooms.props.textures import from_srgb
from roomlight_generator.rooms.scene import Material, Rgb
from roomlight_generator.rooms.shapes import Number

WHITEST: Final = 0.86
"""No paint is whiter, in any channel."""

_WOODS: Final = (
    (214, 178, 130), (196, 152, 102), (226, 200, 160), (164, 112, 66), (128, 82, 50), (96, 62, 42),
    (150, 78, 48), (66, 46, 36), (232, 218, 194), (186, 136, 84), (38, 32, 30), (176, 166, 152),
)  # fmt: skip
"""sRGB of oak, golden oak, birch, cherry, walnut, dark walnut, mahogany, wenge, bleached, pine, black stain, grey."""


def srgb(red: Number, green: Number, blue: Number) -> Rgb:
    """Linear RGB of an sRGB colour given in 0 to 255."""
    values = np.minimum(from_srgb(np.array([red, green, blue], np.float64) / 255), WHITEST)
    return (float(values[0]), float(values[1]), float(values[2]))


def hue(rng: np.random.Generator, saturation: tuple[Number, Number], value: tuple[Number, Number]) -> Rgb:
    """Any hue within ranges of saturation and value (of sRGB)."""
    # Warm hues are commoner in homes than green and purple ones.
    turn = float(rng.choice([between(rng, 0, 0.16), between(rng, 0.5, 0.68), between(rng, 0, 1)], p=[0.45, 0.25, 0.3]))
    r, g, b = colorsys.hsv_to_rgb(turn, between(rng, *saturation), between(rng, *value))
    return srgb(255 * r, 255 * g, 255 * b)


def neutral(rng: np.random.Generator, low: Number, high: Number) -> Rgb:
    """A grey, a little warm or cool, of sRGB value low to high (0 to 255)."""
    level, warm = between(rng, low, high), between(rng, -0.02, 0.06)
    return srgb(min(level * (1 + warm), 240), min(level * (1 + warm / 3), 240), level * (1 - warm))


def paint_colour(rng: np.random.Generator) -> Rgb:
    """White, grey, black or a colour."""
    kind = rng.random()
    if kind < 0.36:
        return neutral(rng, 218, 240)
    if kind < 0.52:
        return neutral(rng, 70, 205)
    if kind < 0.63:
        return neutral(rng, 24, 50)
    return hue(rng, (0.12, 0.5), (0.25, 0.9)) if kind < 0.85 else hue(rng, (0.45, 0.9), (0.25, 0.88))


def cloth_colour(rng: np.random.Generator) -> Rgb:
    """Light or middling neutrals half of the time, dark ones, muted and strong colours."""
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
    """Grained wood, varnished more often than oiled."""
    base = np.array(_WOODS[int(rng.integers(len(_WOODS)))], np.float64) * between(rng, 0.86, 1.08)
    colour = srgb(*np.minimum(base + rng.uniform(-8, 8, 3), 236))
    roughness = None if rng.random() < 0.3 else between(rng, 0.12, 0.4)
    return Material("wood", albedo=(0.95, 0.95, 0.95), texture=textures.grain(rng, colour), roughness=roughness)


def paint(rng: np.random.Generator, colour: Rgb | None = None) -> Material:
    """Painted or lacquered."""
    roughness = None if rng.random() < 0.2 else between(rng, 0.06, 0.4)
    return Material("paint", albedo=colour or paint_colour(rng), roughness=roughness)


def wood_or_paint(rng: np.random.Generator, wooden: Number = 0.6) -> Material:
    """What cupboards are made of."""
    return wood(rng) if rng.random() < wooden else paint(rng)


def cloth(rng: np.random.Generator, *, patterned: Number = 0.15) -> Material:
    """Woven cloth, plain or, with the chance `patterned`, striped, checked or printed."""
    colour = cloth_colour(rng)
    if rng.random() < patterned:
        texture = textures.pattern(rng, colour, cloth_colour(rng))
    elif rng.random() < 0.7:
        texture = textures.weave(rng, colour)
    else:
        return Material("cloth", albedo=colour)
    return Material("cloth", albedo=(0.95, 0.95, 0.95), texture=texture)


def cover(rng: np.random.Generator) -> Material:
    """Of a book: coloured more often than not."""
    kind = rng.random()
    colour = (
        neutral(rng, 190, 238)
        if kind < 0.22
        else neutral(rng, 22, 90)
        if kind < 0.4
        else hue(rng, (0.2, 0.9), (0.25, 0.9))
    )
    return Material("cover", albedo=colour, roughness=between(rng, 0.12, 0.4) if rng.random() < 0.5 else None)


def fur(rng: np.random.Generator) -> Material:
    """Of a toy animal: brown, or any soft colour."""
    colour = hue(rng, (0.1, 0.5), (0.4, 0.95))
    if rng.random() < 0.6:
        colour = srgb(*(np.array([170, 116, 70]) * between(rng, 0.6, 1.35)))
    return Material("fur", albedo=(0.95, 0.95, 0.95), texture=textures.weave(rng, colour))


def leather(rng: np.random.Generator) -> Material:
    """Brown, black, cream or red."""
    base = ((92, 56, 34), (150, 90, 48), (34, 28, 26), (226, 214, 196), (120, 30, 28), (70, 74, 80))
    colour = np.array(base[int(rng.integers(len(base)))]) * between(rng, 0.85, 1.1)
    return Material("leather", albedo=srgb(*np.minimum(colour, 238)), roughness=between(rng, 0.22, 0.4))


def upholstery(rng: np.random.Generator) -> Material:
    """Cloth, or leather one time in five."""
    return leather(rng) if rng.random() < 0.2 else cloth(rng)


def metal(rng: np.random.Generator) -> Material:
    """Steel, brass, black or white: a rough dielectric stands for the reflex of a conductor."""
    base = (
        (170, 172, 176),
        (200, 200, 204),
        (30, 30, 32),
        (24, 24, 24),
        (196, 152, 84),
        (168, 110, 78),
        (228, 228, 226),
    )
    colour = np.array(base[int(rng.integers(len(base)))]) * between(rng, 0.85, 1.08)
    return Material("metal", albedo=srgb(*np.minimum(colour, 236)), roughness=between(rng, 0.08, 0.35))


def chrome(rng: np.random.Generator) -> Material:
    """Bright steel of taps and handles."""
    level = between(rng, 150, 215)
    return Material("chrome", albedo=srgb(level, level, level * 1.02), roughness=between(rng, 0.05, 0.15))


def plastic(rng: np.random.Generator, colour: Rgb | None = None) -> Material:
    """Smooth plastic."""
    return Material("plastic", albedo=colour or paint_colour(rng), roughness=between(rng, 0.1, 0.4))


def bright_plastic(rng: np.random.Generator) -> Material:
    """A toy's colour."""
    return plastic(rng, hue(rng, (0.7, 1.0), (0.7, 1.0)))


def black(rng: np.random.Generator) -> Material:
    """Black plastic of electric things."""
    level = between(rng, 14, 40)
    return Material("black", albedo=srgb(level, level, level * 1.04), roughness=between(rng, 0.08, 0.35))


def ceramic(rng: np.random.Generator) -> Material:
    """Glazed: white or any colour."""
    colour = neutral(rng, 220, 240) if rng.random() < 0.4 else hue(rng, (0.15, 0.85), (0.25, 0.9))
    return Material("ceramic", albedo=colour, roughness=between(rng, 0.05, 0.25))


def sanitary(rng: np.random.Generator) -> Material:
    """White glazed ceramic or enamel of bathrooms."""
    return Material("sanitary", albedo=neutral(rng, 226, 240), roughness=between(rng, 0.05, 0.15))


def paper(rng: np.random.Generator) -> Material:
    """White to yellowed paper."""
    return Material("paper", albedo=neutral(rng, 205, 238))


def cardboard(rng: np.random.Generator) -> Material:
    """Brown card."""
    return Material("cardboard", albedo=srgb(*(np.array([184, 146, 100]) * between(rng, 0.85, 1.1))))


def glass() -> Material:
    """A thin clear pane."""
    return Material("glass", albedo=(0.9, 0.9, 0.9), glass=True)


def leaf(rng: np.random.Generator) -> Material:
    """Some green, now and then reddish or yellow."""
    turn = between(rng, 0.2, 0.38) if rng.random() < 0.9 else between(rng, 0.0, 0.14)
    r, g, b = colorsys.hsv_to_rgb(turn, between(rng, 0.35, 0.75), between(rng, 0.25, 0.62))
    roughness = between(rng, 0.25, 0.4) if rng.random() < 0.5 else None
    return Material("leaf", albedo=srgb(255 * r, 255 * g, 255 * b), roughness=roughness)


def soil(rng: np.random.Generator) -> Material:
    """Dark earth."""
    return Material("soil", albedo=srgb(*(np.array([64, 48, 38]) * between(rng, 0.7, 1.2))))


def shade(rng: np.random.Generator) -> Material:
    """What glows when the lamp is on: opal glass, paper or cloth; white, cream, now and then a colour."""
    colour = neutral(rng, 205, 240)
    if rng.random() < 0.3:
        colour = hue(rng, (0.15, 0.6), (0.6, 0.92))
    return Material("shade", albedo=colour, roughness=between(rng, 0.1, 0.3) if rng.random() < 0.4 else None)


def opal(rng: np.random.Generator) -> Material:
    """White glass or acrylic before a source."""
    return Material("shade", albedo=neutral(rng, 225, 240), roughness=between(rng, 0.1, 0.4))


def worktop(rng: np.random.Generator) -> Material:
    """Granite, wood, white composite or steel."""
    kind = rng.random()
    if kind < 0.25:
        return replace(wood(rng), roughness=between(rng, 0.2, 0.4))
    colour = neutral(rng, 28, 70) if kind < 0.5 else neutral(rng, 120, 238)
    texture = textures.speckle(rng, colour)
    return Material("stone", albedo=(0.95, 0.95, 0.95), texture=texture, roughness=between(rng, 0.06, 0.3))
