"""Every family of textures by what it is for, and which of them only test rooms show.

The functions take the split and a generator; what they return depends on a seed of the split's own (`styled`), so train
and test rooms share no texture, and the families in `RESERVED` appear in test rooms alone.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final, Literal

import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.finishes import cloth, prints, rugs, screens, stone, tiles, wallpaper, wood
from roomlight_generator.rooms.finishes.noise import styled
from roomlight_generator.rooms.scene import Rgb, Texture

Group = Literal[
    "wood_floor", "board", "floor_tile", "wall_tile", "stone", "carpet", "wallpaper", "brick", "panelling", "fabric",
    "leather", "rug", "books", "screen",
]  # fmt: skip
"""What a texture is for."""

Family = Callable[[np.random.Generator], Texture]

RESERVED: Final = frozenset({"hexagon", "damask"})
"""Families that no train room shows."""

FAMILIES: Final[Mapping[Group, Mapping[str, tuple[float, Family]]]] = {
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


def families(group: Group, split: Split) -> tuple[str, ...]:
    """The names of the families of a group that rooms of this split may show."""
    return tuple(name for name in FAMILIES[group] if split == "test" or name not in RESERVED)


def make_texture(group: Group, split: Split, rng: np.random.Generator, *, family: str | None = None) -> Texture:
    """A texture of the group: of the given family, or of any. KeyError for a family that the split may not show."""
    style = styled(split, rng)
    names = families(group, split)
    if family is None:
        weights = np.array([FAMILIES[group][name][0] for name in names])
        family = names[int(style.choice(len(names), p=weights / weights.sum()))]
    elif family not in names:
        raise KeyError(f"{split} rooms show no {group} called {family!r}; there are {', '.join(names)}")
    return FAMILIES[group][family][1](style)


def fabric_texture(split: Split, rng: np.random.Generator, *, colour: Rgb | None = None) -> Texture:
    """Upholstery or curtain cloth of a mean colour (any where None); stripes run along u."""
    style = styled(split, rng)
    kinds = (cloth.plain, cloth.velvet, cloth.tweed, cloth.plaid, cloth.striped, cloth.printed)
    return kinds[int(style.choice(len(kinds), p=(0.36, 0.2, 0.14, 0.07, 0.12, 0.11)))](style, colour)


def wood_texture(split: Split, rng: np.random.Generator, *, colour: Rgb | None = None) -> Texture:
    """Furniture wood without joints, grain along u."""
    return wood.board(styled(split, rng), colour)


def picture_texture(split: Split, rng: np.random.Generator, *, aspect: float | int = 1.0) -> Texture:
    """A picture for a wall, for coordinates 0 to 1; aspect is width over height (0.3 to 3)."""
    style = styled(split, rng)
    kind = _PRINTS[int(style.choice(len(_PRINTS), p=(0.3, 0.3, 0.12, 0.12, 0.16)))]
    return kind(style, float(np.clip(aspect, 0.3, 3.0)))


def rug_texture(split: Split, rng: np.random.Generator) -> Texture:
    """A whole rug for coordinates 0 to 1, u along its length; `size_m` says how large such a rug would be."""
    return make_texture("rug", split, rng)


def book_texture(split: Split, rng: np.random.Generator) -> Texture:
    """A row of book spines, upright, for coordinates 0 to 1; `size_m` is the row's length and height."""
    return make_texture("books", split, rng)


def screen_picture(split: Split, rng: np.random.Generator) -> Texture:
    """What a television or a computer shows, relative to its white, for coordinates 0 to 1."""
    return make_texture("screen", split, rng)
