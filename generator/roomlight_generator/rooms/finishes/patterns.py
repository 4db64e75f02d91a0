"""All texture families by use, and the families reserved for test rooms.

The functions take the split and a generator; their results depend on a seed of the split's own (`split_rng`), so
train and test rooms share no texture, and the families in `RESERVED` appear only in test rooms.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final, Literal

import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.finishes import cloth, prints, rugs, screens, stone, tiles, wallpaper, wood
from roomlight_generator.rooms.finishes.noise import split_rng
from roomlight_generator.rooms.scene import Rgb, Texture

TextureGroup = Literal[
    "wood_floor", "board", "floor_tile", "wall_tile", "stone", "carpet", "wallpaper", "brick", "panelling", "fabric",
    "leather", "rug", "books", "screen",
]  # fmt: skip
"""Use of a texture."""

TextureMaker = Callable[[np.random.Generator], Texture]

RESERVED: Final = frozenset({"hexagon", "damask"})
"""Families that no train room shows."""

FAMILIES: Final[Mapping[TextureGroup, Mapping[str, tuple[float, TextureMaker]]]] = {
    "wood_floor": {
        "strip": (2.5, wood.strip_floor),
        "planks": (3.0, wood.wide_planks),
        "laminate": (2.0, wood.laminate),
        "herringbone": (1.4, wood.herringbone),
        "parquet": (1.0, wood.parquet),
    },
    "board": {"board": (1.0, wood.board)},
    "floor_tile": {
        "square": (5.0, tiles.square),
        "oblong": (1.2, partial(tiles.subway, floor=True)),
        "hexagon": (1.5, tiles.hexagon),
        "checkerboard": (1.0, tiles.checkerboard),
        "mosaic": (0.8, tiles.mosaic),
        "ornament": (0.8, tiles.ornament),
    },
    "wall_tile": {
        "square": (3.0, partial(tiles.square, floor=False)),
        "subway": (3.0, tiles.subway),
        "hexagon": (1.0, partial(tiles.hexagon, floor=False)),
        "checkerboard": (0.4, partial(tiles.checkerboard, floor=False)),
        "mosaic": (1.5, partial(tiles.mosaic, floor=False)),
        "ornament": (0.5, tiles.ornament),
    },
    "stone": {
        "marble": (1.0, stone.marble),
        "concrete": (1.5, stone.concrete),
        "terrazzo": (1.0, tiles.terrazzo),
        "cork": (0.7, stone.cork),
    },
    "carpet": {
        "loop": (2.0, cloth.loop_carpet),
        "shag": (1.5, cloth.shag_carpet),
        "patterned": (1.0, cloth.patterned_carpet),
    },
    "wallpaper": {
        "stripes": (1.2, wallpaper.stripes),
        "damask": (1.0, wallpaper.damask),
        "floral": (1.2, wallpaper.floral),
        "geometric": (1.3, wallpaper.geometric),
        "grasscloth": (0.8, wallpaper.grasscloth),
    },
    "brick": {"brick": (1.0, tiles.brick)},
    "panelling": {"panelling": (1.0, wood.panelling)},
    "fabric": {
        "plain": (2.5, cloth.plain),
        "velvet": (1.5, cloth.velvet),
        "tweed": (1.0, cloth.tweed),
        "plaid": (0.6, cloth.plaid),
        "striped": (0.9, cloth.striped),
        "printed": (0.9, cloth.printed),
    },
    "leather": {"leather": (1.0, cloth.leather)},
    "rug": {"oriental": (1.0, rugs.oriental), "modern": (1.0, rugs.modern), "plain": (0.6, rugs.plain)},
    "books": {"books": (1.0, prints.book_spines)},
    "screen": {
        "film": (2.0, screens.film),
        "news": (0.7, screens.news),
        "sport": (0.6, screens.sport),
        "desktop": (1.2, screens.desktop),
        "document": (1.0, screens.document),
        "menu": (0.8, screens.menu),
    },
}

_PRINTS: Final = (prints.landscape, prints.abstract, prints.typographic, prints.botanical, prints.portrait)


def families(group: TextureGroup, split: Split) -> tuple[str, ...]:
    """Return the names of a group's families that rooms of this split may show."""
    return tuple(name for name in FAMILIES[group] if split == "test" or name not in RESERVED)


def make_texture(group: TextureGroup, split: Split, rng: np.random.Generator, *, family: str | None = None) -> Texture:
    """Make a texture of the group, of the given family or of a random one.

    Raises:
        KeyError: rooms of this split may not show the family, or there is no such family.
    """
    own_rng = split_rng(split, rng)
    names = families(group, split)
    if family is None:
        weights = np.array([FAMILIES[group][name][0] for name in names])
        family = names[int(own_rng.choice(len(names), p=weights / weights.sum()))]
    elif family not in names:
        raise KeyError(f"the {split} split has no {group} texture {family!r}: choose one of {', '.join(names)}")
    return FAMILIES[group][family][1](own_rng)


def fabric_texture(split: Split, rng: np.random.Generator, *, colour: Rgb | None = None) -> Texture:
    """Make upholstery or curtain cloth of a mean colour (None: random); stripes run along u."""
    own_rng = split_rng(split, rng)
    kinds = (cloth.plain, cloth.velvet, cloth.tweed, cloth.plaid, cloth.striped, cloth.printed)
    return kinds[int(own_rng.choice(len(kinds), p=(0.36, 0.2, 0.14, 0.07, 0.12, 0.11)))](own_rng, colour)


def wood_texture(split: Split, rng: np.random.Generator, *, colour: Rgb | None = None) -> Texture:
    """Make furniture wood without joints, grain along u."""
    return wood.board(split_rng(split, rng), colour)


def picture_texture(split: Split, rng: np.random.Generator, *, aspect: float | int = 1.0) -> Texture:
    """Make a picture for a wall, for coordinates 0 to 1; aspect is width over height (0.3 to 3)."""
    own_rng = split_rng(split, rng)
    kind = _PRINTS[int(own_rng.choice(len(_PRINTS), p=(0.3, 0.3, 0.12, 0.12, 0.16)))]
    return kind(own_rng, float(np.clip(aspect, 0.3, 3.0)))


def rug_texture(split: Split, rng: np.random.Generator) -> Texture:
    """Make a whole rug for coordinates 0 to 1, u along its length; `size_m` is the size of such a rug."""
    return make_texture("rug", split, rng)


def book_texture(split: Split, rng: np.random.Generator) -> Texture:
    """Make a row of upright book spines for coordinates 0 to 1; `size_m` is the row's length and height."""
    return make_texture("books", split, rng)


def screen_picture(split: Split, rng: np.random.Generator) -> Texture:
    """Make the image of a television or a computer, relative to its white, for coordinates 0 to 1."""
    return make_texture("screen", split, rng)
