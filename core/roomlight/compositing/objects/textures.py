"""Textures of virtual objects: 16-bit linear RGBA texels, repeated outside [0, 1]; row 0 is v = 0, as in glTF."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int32, Int64, UInt8, UInt16

from roomlight.conventions import srgb8_to_linear
from roomlight.errors import ObjectError

MAX_TEXTURE_SIZE: Final = 2048
"""Wider or higher textures are reduced to this by area: an object rarely covers more pixels of a frame."""

LEVELS: Final = 8
"""Of a texture: the largest has 16 texels across in the last."""

_ROWS: Final = 128


@dataclass(frozen=True, eq=False)
class Texture:
    """An image on a surface.

    Attributes:
        texels: Linear RGBA times 65535 in 16 bits.
        clamped: Whether its edges go on outside [0, 1], across and down; else it repeats.
        by_triangle: Whether each triangle has a square of its own: it has no coarser levels, which would mix them.

    Raises:
        ObjectError: The texture has no texel.
    """

    texels: UInt16[np.ndarray, "h w 4"]
    clamped: tuple[bool, bool] = (False, False)
    by_triangle: bool = False

    def __post_init__(self) -> None:
        if self.texels.size == 0:
            raise ObjectError(f"a texture needs one texel at least, got shape {self.texels.shape}")

    @cached_property
    def levels(self) -> tuple[UInt16[np.ndarray, "h2 w2 4"], ...]:
        """The texels, and those halved by area again and again, down to one or up to `LEVELS`."""
        images = [self.texels]
        while len(images) < LEVELS and max(images[-1].shape[:2]) > 1 and not self.by_triangle:
            height, width = images[-1].shape[:2]
            size = max(width // 2, 1), max(height // 2, 1)
            images.append(_reduced(images[-1], size))
        return tuple(images)

    @classmethod
    def from_srgb8(cls, image: UInt8[np.ndarray, "h w c"]) -> "Texture":
        """Make a texture from 8-bit sRGB (c = 3) or sRGB with linear alpha (c = 4): base colour, emission."""
        return cls.from_linear(_rgba(image, srgb8_to_linear))

    @classmethod
    def from_linear8(cls, image: UInt8[np.ndarray, "h w c"]) -> "Texture":
        """Make a texture from 8-bit linear values (c = 3 or 4): metallic-roughness and normal maps."""
        return cls.from_linear(_rgba(image, _linear))

    @classmethod
    def from_linear(cls, image: Float[np.ndarray, "h w c"]) -> "Texture":
        """Make a texture from linear values in [0, 1] (c = 3 or 4; values outside are clipped)."""
        if image.shape[2] == 3:
            image = np.concatenate([image, np.ones((*image.shape[:2], 1), image.dtype)], axis=-1)
        height, width = image.shape[:2]
        if max(height, width) > MAX_TEXTURE_SIZE:
            scale = MAX_TEXTURE_SIZE / max(height, width)
            size = max(1, round(width * scale)), max(1, round(height * scale))
            image = cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        return cls(np.rint(np.clip(image, 0, 1) * 65535).astype(np.uint16))


def _reduced(texels: UInt16[np.ndarray, "h w 4"], size: tuple[int, int]) -> UInt16[np.ndarray, "h2 w2 4"]:
    """Reduce RGBA by area to (width, height); texels count by their alpha, as what is hidden may have any colour."""
    if texels[..., 3].min() == 65535:
        return cv2.resize(texels, size, interpolation=cv2.INTER_AREA)
    weighted = texels.astype(np.float32)
    weighted[..., :3] *= weighted[..., 3:]
    reduced = cv2.resize(weighted, size, interpolation=cv2.INTER_AREA)
    alpha, plain = reduced[..., 3:], cv2.resize(texels, size, interpolation=cv2.INTER_AREA).reshape(reduced.shape)
    plain[..., :3] = np.where(alpha > 0, np.rint(reduced[..., :3] / np.maximum(alpha, 1e-6)), plain[..., :3])
    return plain


class TextureArrays(NamedTuple):
    """All textures of a scene in one array, as the kernels read them.

    Row k t + i of the tables is level k of texture i of t; it is empty where the texture has fewer.
    """

    texels: UInt16[np.ndarray, "n 4"]
    first: Int64[np.ndarray, " levels*t"]
    width: Int32[np.ndarray, " levels*t"]
    height: Int32[np.ndarray, " levels*t"]
    clamped: Bool[np.ndarray, "levels*t 2"]


def texture_arrays(textures: Sequence[Texture]) -> TextureArrays:
    """Concatenate textures; without any, one white texel stands in, because kernels take no empty array."""
    textures = textures or [Texture(np.full((1, 1, 4), 65535, np.uint16))]
    none = np.zeros((0, 0, 4), np.uint16)
    images = [texture.levels[k] if k < len(texture.levels) else none for k in range(LEVELS) for texture in textures]
    sizes = np.array([image.shape[0] * image.shape[1] for image in images], np.int64)
    return TextureArrays(
        np.concatenate([image.reshape(-1, 4) for image in images]),
        np.cumsum(sizes) - sizes,
        np.array([image.shape[1] for image in images], np.int32),
        np.array([image.shape[0] for image in images], np.int32),
        np.array([texture.clamped for texture in textures] * LEVELS, bool),
    )


def _linear(image: UInt8[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    return image.astype(np.float32) / np.float32(255)


def _rgba(image: UInt8[np.ndarray, "h w c"], to_linear: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Return linear RGBA (h, w, 4); alpha is 1 without an alpha channel. A block of rows at a time saves memory."""
    rgba = np.ones((*image.shape[:2], 4), np.float32)
    for start in range(0, len(image), _ROWS):
        rows, block = image[start : start + _ROWS], rgba[start : start + _ROWS]
        block[..., :3] = to_linear(rows[..., :3])
        if image.shape[2] == 4:
            block[..., 3] = _linear(rows[..., 3])
    return rgba
