"""Wood: boards, floors of strips and planks, herringbone, parquet, laminate, panelling. Grain runs along u."""

from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.colour import paint, to_srgb
from roomlight_generator.rooms.finishes.noise import (
    Blocks,
    basket_weave_blocks,
    fbm,
    grid_uv,
    herringbone_blocks,
    row_blocks,
    shaded,
    speckle,
    to_texture,
)
from roomlight_generator.rooms.scene import Rgb, Texture

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

_LAID: Final = (384, 384)
"""Pixels of a floor whose boards all run one way."""


def wood_colour(rng: np.random.Generator) -> Rgb:
    """Choose the mean colour of a wood, as stained or bleached as floors and furniture are."""
    weights = np.array([species[6] for species in _SPECIES])
    low, high, dull, rich, warm, cool, _ = _SPECIES[int(rng.choice(len(_SPECIES), p=weights / weights.sum()))]
    return paint(rng.uniform(low, high), rng.uniform(dull, rich), rng.uniform(warm, cool))


def _grain(rng: np.random.Generator, shape: tuple[int, int], *, boards: int) -> Float[np.ndarray, "h w"]:
    """Return a tileable field of grain around 0 (standard deviation about 1), as if sawn into `boards` rows of
    boards."""
    broad = fbm(rng, shape, (2 * boards, 2), octaves=3)
    _, v = grid_uv(shape)
    # Year rings are an integer number of cycles around the torus, bent by the broad noise.
    cycles = boards * int(rng.integers(4, 9))
    rings = np.sin(2 * np.pi * (cycles * v + rng.uniform(0.8, 2.2) * broad)).astype(np.float32)
    fibres = speckle(rng, shape, (0.5, shape[1] / 40))
    pores = np.minimum(speckle(rng, shape, (0.35, shape[1] / 110)), 0)
    weights = rng.uniform((0.15, 0.25, 0.2, 0.4), (0.7, 0.6, 0.6, 1.2)).astype(np.float32)
    return weights[0] * rings + weights[1] * fibres + weights[2] * pores + weights[3] * 1.8 * broad


def _stained(rng: np.random.Generator, colour: Rgb, grain: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """Apply grain to a colour: dark lines are redder than the ground, as they are in wood."""
    contrast = np.float32(rng.uniform(0.03, 0.095))
    shade = np.clip(1 + contrast * grain, 0.55, 1.3)
    return (to_srgb(colour) * (1 + (shade - 1)[..., None] * np.array([0.9, 1.08, 1.26], np.float32))).astype(np.float32)


def board(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make furniture wood without joints: veneer, a door, a beam, a shelf."""
    shape = (256, 512)
    image = _stained(rng, colour or wood_colour(rng), _grain(rng, shape, boards=2))
    return to_texture(image, (float(rng.uniform(1.0, 1.6)), float(rng.uniform(0.3, 0.6))))


def _floor(
    rng: np.random.Generator,
    blocks: Blocks,
    *,
    boards: int,
    spread: float,
    joint_px: float,
    colour: Rgb | None,
) -> Float[np.ndarray, "h w 3"]:
    colour = colour or wood_colour(rng)
    grain = blocks.sample(rng, _grain(rng, blocks.index.shape, boards=boards))
    image = _stained(rng, colour, grain) * blocks.tones(rng, spread, spread / 6)
    return blocks.grout(image, to_srgb(colour) * np.float32(rng.uniform(0.35, 0.7)), joint_px)


def strip_floor(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make narrow strips with random ends."""
    rows = int(rng.integers(8, 15))
    blocks = row_blocks(rng, _LAID, rows=rows, columns=int(rng.integers(1, 4)))
    image = _floor(
        rng, blocks, boards=rows, spread=rng.uniform(0.05, 0.22), joint_px=rng.uniform(0.8, 2), colour=colour
    )
    strip = rng.uniform(0.055, 0.09)
    return to_texture(image, (float(rng.uniform(1.4, 2.2)), float(rows * strip)))


def wide_planks(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make broad boards with a dark bevel between them."""
    rows = int(rng.integers(4, 9))
    blocks = row_blocks(rng, _LAID, rows=rows, columns=1)
    image = _floor(
        rng, blocks, boards=rows, spread=rng.uniform(0.03, 0.15), joint_px=rng.uniform(1.5, 4), colour=colour
    )
    return to_texture(image, (float(rng.uniform(1.8, 2.6)), float(rows * rng.uniform(0.12, 0.22))))


def laminate(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make printed planks: even tone, fine joints, each plank two or three strips wide."""
    rows = int(rng.integers(4, 7))
    blocks = row_blocks(rng, _LAID, rows=rows, columns=1, shift=None)
    strips = row_blocks(rng, _LAID, rows=rows * int(rng.integers(1, 4)), columns=int(rng.integers(2, 4)))
    colour = colour or wood_colour(rng)
    image = _stained(rng, colour, strips.sample(rng, _grain(rng, _LAID, boards=rows)))
    image = image * strips.tones(rng, float(rng.uniform(0.02, 0.09)))
    image = blocks.grout(image, to_srgb(colour) * np.float32(0.6), 1.2)
    return to_texture(image, (1.3, float(rows * 0.19)))


def herringbone(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make short blocks at right angles."""
    length = int(rng.integers(4, 7))
    blocks = herringbone_blocks((384, 384), length=length)
    image = _floor(rng, blocks, boards=6, spread=rng.uniform(0.04, 0.16), joint_px=rng.uniform(1, 2.5), colour=colour)
    side = float(2 * length * rng.uniform(0.06, 0.11))
    return to_texture(image, (side, side))


def parquet(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make squares of about five strips, alternating in direction."""
    blocks = basket_weave_blocks((384, 384), squares=4, strips=int(rng.integers(4, 8)))
    image = _floor(rng, blocks, boards=12, spread=rng.uniform(0.05, 0.18), joint_px=rng.uniform(0.8, 2), colour=colour)
    side = float(4 * rng.uniform(0.12, 0.3))
    return to_texture(image, (side, side))


def panelling(rng: np.random.Generator, colour: Rgb | None = None, *, painted: bool = False) -> Texture:
    """Make vertical boards with grooves for walls (grain down v): bare wood, or painted in a colour."""
    columns = int(rng.integers(5, 11))
    shape = (256, 512)
    grain = _grain(rng, (shape[1], shape[0]), boards=columns)
    blocks = row_blocks(rng, (shape[1], shape[0]), rows=columns, columns=1, shift=0.0)
    ground = colour or wood_colour(rng)
    if painted:
        image = shaded(ground, 1 + np.float32(0.006) * grain)
    else:
        image = _stained(rng, ground, blocks.sample(rng, grain)) * blocks.tones(rng, float(rng.uniform(0.02, 0.12)))
    # Only the long joints: the boards run from floor to ceiling.
    v = grid_uv(blocks.index.shape)[1] * columns
    groove = np.minimum(v % 1, 1 - v % 1) * shape[1] / columns
    width = float(rng.uniform(2, 5))
    depth = np.float32(rng.uniform(0.3, 0.75))
    shade = 1 - depth * np.clip(1 - (groove - width / 2 + 0.5) / 1.5, 0, 1)
    image = np.ascontiguousarray((image * shade[..., None]).transpose(1, 0, 2))
    return to_texture(image, (float(columns * rng.uniform(0.08, 0.16)), 1.2))
