"""A canvas for pictures of results: tone-mapped panoramas, spheres, lines and labels on dark grey.

Tone mapping: radiance clipped to [0, 1], sRGB-encoded. Frames are encoded the same way, so a panorama looks as the room
does in them. Positions are (column, row) from the top left, in pixels. Text is set in Inter (data/fonts, SIL Open Font
License).
"""

import unicodedata
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Final, Literal

import cv2
import numpy as np
from jaxtyping import Float, Shaped, UInt8
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

Weight = Literal["regular", "semibold"]
_FONTS: Final[dict[Weight, str]] = {"regular": "Inter-Regular.otf", "semibold": "Inter-SemiBold.otf"}

Colour = float | tuple[float, float, float]
"""A grey or a colour, sRGB-encoded, 0 to 1."""

_GLYPHS: Final = ((0x20, 0x7E), (0xA0, 0x17F), (0x2010, 0x2015), (0x2018, 0x201E), (0x2190, 0x2193))
_OTHER_GLYPHS: Final = "\u2022\u2026\u2032\u2033\u2212\u2264\u2265"
"""Code points of the bundled font that labels use; Latin letters with accents are among them."""
_SUBPIXEL_BITS: Final = 4
"""Lines are placed to a sixteenth of a pixel."""


class Canvas:
    """An sRGB-encoded picture [height, width, 3]; sizes are rounded up to even numbers, which video needs."""

    def __init__(self, width: int, height: int) -> None:
        self._pixels = np.full((height + height % 2, width + width % 2, 3), BACKGROUND, np.float32)

    @property
    def image(self) -> UInt8[np.ndarray, "h w 3"]:
        """The picture as 8-bit sRGB."""
        return np.rint(self._pixels * 255).astype(np.uint8)

    def picture(self, at: tuple[int, int], image: Float[np.ndarray, "h w 3"], *, size: tuple[int, int]) -> None:
        """Draw a linear picture resampled to `size` (columns, rows).

        Raises:
            ValueError: It does not fit the canvas.
        """
        width, height = size
        if image.shape[:2] != (height, width):
            # clipped before it is shrunk: one lamp pixel must not whiten all of its neighbours
            image = _resampled(np.clip(image, 0, 1).astype(np.float32), size)
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
        lit = linear_to_srgb(spheres.render(panorama, material))
        share = spheres.coverage[..., None]
        part[:] = share * lit + (1 - share) * part

    def text(
        self,
        at: tuple[int, int],
        text: str,
        *,
        size: int = LABEL_SIZE,
        grey: Colour = LABEL,
        width: int | None = None,
        weight: Weight = "regular",
    ) -> None:
        """Draw a line of text whose top left corner is `at`; shortened with an ellipsis to fit `width`.

        Characters that the font lacks are drawn without their accent, or as "?". What falls off the canvas is cut.
        """
        text = _drawable(text)
        if width is not None:
            text = fitted(text, width, size=size, weight=weight)
        if not text:
            return
        font = _font(size, weight)
        ascent, descent = font.getmetrics()
        mask = Image.new("L", (int(font.getlength(text)) + 2, ascent + descent))
        ImageDraw.Draw(mask).text((0, 0), text, fill=255, font=font)
        left, top = (max(start, 0) for start in at)
        ink = np.asarray(mask, np.float32)[top - at[1] :, left - at[0] :] / 255
        part = self._pixels[top : top + ink.shape[0], left : left + ink.shape[1]]
        ink = ink[: part.shape[0], : part.shape[1], None]
        part[:] = ink * np.asarray(grey, np.float32) + (1 - ink) * part

    def encoded(self, at: tuple[int, int], image: UInt8[np.ndarray, "h w 3"], *, size: tuple[int, int]) -> None:
        """Draw an 8-bit sRGB picture resampled to `size` (columns, rows), without exposure.

        Raises:
            ValueError: It does not fit the canvas.
        """
        if image.shape[:2] != size[::-1]:
            image = _resampled(image, size)
        self._part(at, size)[:] = image.astype(np.float32) / 255

    def line(self, points: Sequence[tuple[float, float]], colour: Colour, *, width: int = 1) -> None:
        """Draw a polyline with smooth edges through pixel positions."""
        corners = np.rint(np.asarray(points, np.float64).reshape(-1, 1, 2) * 2**_SUBPIXEL_BITS).astype(np.int32)
        mask = np.zeros(self._pixels.shape[:2], np.uint8)
        cv2.polylines(mask, [corners], False, 255, width, cv2.LINE_AA, _SUBPIXEL_BITS)
        self._blend(mask, colour, 1.0)

    def area(self, points: Sequence[tuple[float, float]], colour: Colour, *, opacity: float = 1.0) -> None:
        """Fill a polygon with smooth edges."""
        corners = np.rint(np.asarray(points, np.float64).reshape(-1, 1, 2) * 2**_SUBPIXEL_BITS).astype(np.int32)
        mask = np.zeros(self._pixels.shape[:2], np.uint8)
        cv2.fillPoly(mask, [corners], 255, cv2.LINE_AA, _SUBPIXEL_BITS)
        self._blend(mask, colour, opacity)

    def disc(self, centre: tuple[float, float], radius: float, colour: Colour) -> None:
        """Fill a circle with smooth edges."""
        angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        x, y = centre
        self.area([(x + radius * np.cos(a), y + radius * np.sin(a)) for a in angles.tolist()], colour)

    def box(self, at: tuple[int, int], size: tuple[int, int], colour: Colour, *, opacity: float = 1.0) -> None:
        """Fill a rectangle. Raises ValueError if it does not fit the canvas."""
        part = self._part(at, size)
        part[:] = opacity * np.asarray(colour, np.float32) + (1 - opacity) * part

    def tint(
        self, at: tuple[int, int], share: Float[np.ndarray, "h w"], colour: Colour, *, size: tuple[int, int]
    ) -> None:
        """Mix a colour into a rectangle; `share`, 0 to 1, is resampled to `size` (columns, rows).

        Raises:
            ValueError: It does not fit the canvas.
        """
        part = self._part(at, size)
        if share.shape != size[::-1]:
            share = cv2.resize(share.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
        mixed = np.clip(share, 0, 1)[..., None].astype(np.float32)
        part[:] = mixed * np.asarray(colour, np.float32) + (1 - mixed) * part

    def _blend(self, mask: UInt8[np.ndarray, "h w"], colour: Colour, opacity: float) -> None:
        left, top, width, height = cv2.boundingRect(mask)
        part = self._pixels[top : top + height, left : left + width]
        ink = mask[top : top + height, left : left + width, None].astype(np.float32) * np.float32(opacity / 255)
        part[:] = ink * np.asarray(colour, np.float32) + (1 - ink) * part

    def _part(self, at: tuple[int, int], size: tuple[int, int]) -> Float[np.ndarray, "h w 3"]:
        (left, top), (width, height) = at, size
        part = self._pixels[top : top + height, left : left + width]
        if left < 0 or top < 0 or part.shape[:2] != (height, width):
            raise ValueError(f"{width} x {height} pixels at {at} do not fit a canvas of {self._pixels.shape[1::-1]}")
        return part


def _resampled(image: Shaped[np.ndarray, "h w 3"], size: tuple[int, int]) -> Shaped[np.ndarray, "sh sw 3"]:
    shrinks = size[1] < image.shape[0]
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)


def text_width(text: str, *, size: int = LABEL_SIZE, weight: Weight = "regular") -> int:
    """Return the width of a line of text in pixels."""
    return round(_font(size, weight).getlength(_drawable(text)))


def fitted(text: str, width: int, *, size: int = LABEL_SIZE, weight: Weight = "regular") -> str:
    """Return the text, or as much of its start as fits `width` pixels with an ellipsis behind."""
    length = _font(size, weight).getlength
    if length(text) <= width:
        return text
    kept = len(text)
    while kept > 0 and length(text[:kept].rstrip() + "\u2026") > width:
        kept -= 1
    return text[:kept].rstrip() + "\u2026" if kept else ""


def _drawable(text: str) -> str:
    return "".join(_drawable_character(c) for c in unicodedata.normalize("NFC", text) if not unicodedata.combining(c))


def _drawable_character(character: str) -> str:
    if character in _OTHER_GLYPHS or any(first <= ord(character) <= last for first, last in _GLYPHS):
        return character
    plain = unicodedata.normalize("NFD", character)[0]
    return plain if plain.isascii() and plain.isprintable() else "?"


@lru_cache(maxsize=16)
def _font(size: int, weight: Weight) -> ImageFont.FreeTypeFont:
    path = files("roomlight") / "data" / "fonts" / _FONTS[weight]
    # the basic layout is the same on all systems; Raqm needs a library that some lack
    return ImageFont.truetype(str(path), size, layout_engine=ImageFont.Layout.BASIC)
