"""All textures of a room in one array, each with its pyramid of halved sizes, for the kernels to read.

Texels are linear reflectance (or relative emission) times 65535 in 16 bits; row 0 is the top, as in `Texture`.
"""

from typing import Final, NamedTuple
from weakref import WeakKeyDictionary

import cv2
import numpy as np
from jaxtyping import Int, UInt16

from roomlight.conventions import srgb8_to_linear
from roomlight_generator.rooms.scene import Texture

LEVELS: Final = 11
"""Pyramid levels kept: 1024 texels down to 1."""

LARGEST: Final = 1024
"""Wider or higher images are halved to this: a 320-pixel frame sees no finer."""

_LINEAR16: Final = np.rint(srgb8_to_linear(np.arange(256, dtype=np.uint8)) * 65535).astype(np.uint16)

_pyramids: "WeakKeyDictionary[Texture, tuple[np.ndarray, ...]]" = WeakKeyDictionary()


class Atlas(NamedTuple):
    """Texels of all textures and levels end to end; level l of texture t starts at start[t, l]."""

    texels: UInt16[np.ndarray, "n 3"]
    start: Int[np.ndarray, "t levels"]
    width: Int[np.ndarray, "t levels"]
    height: Int[np.ndarray, "t levels"]


def pyramid(texture: Texture) -> tuple[UInt16[np.ndarray, "_ _ 3"], ...]:
    """Return the texture's levels, linear, finest first; kept with the texture, since rooms share furniture."""
    known = _pyramids.get(texture)
    if known is not None:
        return known
    level = _LINEAR16[texture.image]
    while max(level.shape[:2]) > LARGEST:
        level = _halved(level)
    levels = [level]
    while max(level.shape[:2]) > 1 and len(levels) < LEVELS:
        level = _halved(level)
        levels.append(level)
    _pyramids[texture] = tuple(levels)
    return tuple(levels)


def _halved(level: UInt16[np.ndarray, "h w 3"]) -> UInt16[np.ndarray, "h2 w2 3"]:
    height, width = level.shape[:2]
    size = max(1, width // 2), max(1, height // 2)
    return np.ascontiguousarray(cv2.resize(level, size, interpolation=cv2.INTER_AREA))


def build_atlas(textures: list[Texture]) -> Atlas:
    """Join the textures to one atlas, in their order; levels past a texture's own last repeat the last."""
    count = max(1, len(textures))
    start, width, height = (np.zeros((count, LEVELS), np.int64) for _ in range(3))
    parts: list[np.ndarray] = [np.full((1, 3), 65535, np.uint16)]
    width[:], height[:] = 1, 1
    at = 1
    for which, texture in enumerate(textures):
        levels = pyramid(texture)
        for index in range(LEVELS):
            if index < len(levels):
                level = levels[index]
                start[which, index], (height[which, index], width[which, index]) = at, level.shape[:2]
                parts.append(level.reshape(-1, 3))
                at += level.shape[0] * level.shape[1]
            else:
                start[which, index] = start[which, index - 1]
                height[which, index], width[which, index] = height[which, index - 1], width[which, index - 1]
    return Atlas(np.concatenate(parts), start, width, height)
