"""Surface finishes: procedural textures, colour schemes for shells, recolouring of furniture.

Every function takes the split and a generator; the same generator state gives the same bytes. Textures hold the whole
colour (sRGB) under an albedo of 0.95, except for `plaster`, a relief around white tinted by the albedo.
"""

from roomlight_generator.rooms.finishes.patterns import (
    RESERVED,
    book_texture,
    fabric_texture,
    families,
    make_texture,
    picture_texture,
    rug_texture,
    screen_picture,
    wood_texture,
)
from roomlight_generator.rooms.finishes.recolour import RECOLOURABLE_ROLES, recolour, recoloured
from roomlight_generator.rooms.finishes.schemes import shell_finishes

__all__ = [
    "RECOLOURABLE_ROLES",
    "RESERVED",
    "book_texture",
    "fabric_texture",
    "families",
    "make_texture",
    "picture_texture",
    "recolour",
    "recoloured",
    "rug_texture",
    "screen_picture",
    "shell_finishes",
    "wood_texture",
]
