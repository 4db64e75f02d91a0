"""A canvas for pictures of results: tone-mapped panoramas, spheres and labels on dark grey.

Tone mapping: radiance x 2^exposure_ev, clipped to [0, 1], sRGB-encoded. Frames are encoded the same way, so a panorama
at exposure 0 looks as the room does in them. Positions are (column, row) from the top left, in pixels.
"""

import unicodedata
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from roomlight.conventions import linear_to_srgb
from roomlight.spheres import Material, SphereRenderer

BACKGROUND: Final = 0.11
LABEL: Final = 0.75
"""Grey of labels, sRGB-encoded."""
HEADING: Final = 0.95
"""Grey of headings, sRGB-encoded."""
LABEL_SIZE: Final = 14
"""Font size of labels in pixels."""
LABEL_ROWS: Final = 22
"""Rows that a line of labels takes, with the gap to the picture below."""

_OTHER_GLYPHS: Final = "\u2026\u00b0\u00b7\u00b1"
"""Ellipsis, degree, middle dot, plus-minus: all that Pillow's built-in font has beyond ASCII."""


class Canvas:
    """An sRGB-encoded picture [height, width, 3]; sizes are rounded up to even numbers, which video needs."""

    def __init__(self, width: int, height: int, *, exposure_ev: float = 0.0) -> None:
        self._pixels = np.full((height + height % 2, width + width % 2, 3), BACKGROUND, np.float32)
        self._gain = np.float32(2.0**exposure_ev)

    @property
    def image(self) -> UInt8[np.ndarray, "h w 3"]:
        """The picture as 8-bit sRGB."""
        return np.rint(self._pixels * 255).astype(np.uint8)

    def picture(
        self,
        at: tuple[int, int],
        image: Float[np.ndarray, "h w 3"],
        *,
        size: tuple[int, int],
        exposed: bool = True,
    ) -> None:
        """Draw a linear picture resampled to `size` (columns, rows); `exposed=False` leaves the exposure out.

        Raises:
            ValueError: It does not fit the canvas.
        """
        width, height = size
        if image.shape[:2] != (height, width):
            shrinks = height < image.shape[0]
            # clipped before it is shrunk: one lamp pixel must not whiten all of its neighbours
            image = np.clip(image * (self._gain if exposed else 1), 0, 1).astype(np.float32)
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)
        elif exposed:
            image = image * self._gain
        self._part(at, size)[:] = linear_to_srgb(image.astype(np.float32))

    def sphere(
        self,
        at: tuple[int, int],
        panorama: Float[np.ndarray, "h w 3"],
        spheres: SphereRenderer,
        material: Material,
    ) -> None:
        """Draw a sphere lit by the panorama, its rim blended into the background.

        Raises:
            ValueError: It does not fit the canvas.
        """
        part = self._part(at, (spheres.size, spheres.size))
        lit = linear_to_srgb(spheres.render(panorama, material) * self._gain)
        share = spheres.coverage[..., None]
        part[:] = share * lit + (1 - share) * part

    def text(
        self,
        at: tuple[int, int],
        text: str,
        *,
        size: int = LABEL_SIZE,
        grey: float = LABEL,
        width: int | None = None,
    ) -> None:
        """Draw a line of text whose top left corner is `at`; shortened with an ellipsis to fit `width`.

        Accents are dropped and other characters that the font lacks are drawn as "?". What falls off the canvas is cut.
        """
        text = _drawable(text)
        if width is not None:
            text = fitted(text, width, size=size)
        if not text:
            return
        font = _font(size)
        ascent, descent = font.getmetrics()
        mask = Image.new("L", (int(font.getlength(text)) + 2, ascent + descent))
        ImageDraw.Draw(mask).text((0, 0), text, fill=255, font=font)
        left, top = at
        ink = np.asarray(mask, np.float32) / 255
        part = self._pixels[top : top + ink.shape[0], left : left + ink.shape[1]]
        ink = ink[: part.shape[0], : part.shape[1], None]
        part[:] = ink * grey + (1 - ink) * part

    def _part(self, at: tuple[int, int], size: tuple[int, int]) -> Float[np.ndarray, "h w 3"]:
        (left, top), (width, height) = at, size
        part = self._pixels[top : top + height, left : left + width]
        if left < 0 or top < 0 or part.shape[:2] != (height, width):
            raise ValueError(f"{width} x {height} pixels at {at} do not fit a canvas of {self._pixels.shape[1::-1]}")
        return part


def fitted(text: str, width: int, *, size: int = LABEL_SIZE) -> str:
    """Return the text, or as much of its start as fits `width` pixels with an ellipsis behind."""
    length = _font(size).getlength
    if length(text) <= width:
        return text
    kept = len(text)
    while kept > 0 and length(text[:kept].rstrip() + "\u2026") > width:
        kept -= 1
    return text[:kept].rstrip() + "\u2026" if kept else ""


def _drawable(text: str) -> str:
    """Return the text without what the font cannot draw."""
    plain = (c for c in unicodedata.normalize("NFD", text) if not unicodedata.combining(c))
    return "".join(c if (c.isascii() and c.isprintable()) or c in _OTHER_GLYPHS else "?" for c in plain)


@lru_cache(maxsize=8)
def _font(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    assert isinstance(font, ImageFont.FreeTypeFont)  # Pillow's wheels all have FreeType
    return font
