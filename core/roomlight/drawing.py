"""A picture to compose results on: tone-mapped panoramas, spheres and small labels on dark grey.

Tone mapping, stated once: radiance x 2^exposure_ev, clipped to [0, 1], sRGB-encoded. That is how the frames
were shown too, so a panorama at exposure 0 looks as the room does in them, and what is brighter than white
is white.
"""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from roomlight.conventions import linear_to_srgb
from roomlight.spheres import Material, SphereRenderer

BACKGROUND: Final = 0.11
LABEL: Final = 0.72
HEADING: Final = 0.92
_TEXT_OVERSAMPLING: Final = 4  # OpenCV's stroke fonts are crude at label size and clean when drawn large
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_CAP_HEIGHT: Final = 21.0  # pixels of a capital letter of that font at scale 1


class Canvas:
    """An sRGB-encoded float picture [height, width, 3]; positions are (column, row) from the top left."""

    def __init__(self, width: int, height: int, *, exposure_ev: float = 0.0) -> None:
        """Sizes are rounded up to even numbers, which video needs."""
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
        """A linear picture resampled to `size` (columns, rows); `exposed=False` leaves the exposure out."""
        width, height = size
        if image.shape[:2] != (height, width):
            shrinks = height < image.shape[0]
            # shrunk after clipping: one lamp pixel must not whiten all of its neighbours
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
        """A sphere lit by the panorama, its rim blended into the background."""
        part = self._part(at, (spheres.size, spheres.size))
        lit = linear_to_srgb(spheres.render(panorama, material) * self._gain)
        share = spheres.coverage[..., None]
        part[:] = share * lit + (1 - share) * part

    def text(
        self,
        at: tuple[int, int],
        text: str,
        *,
        cap_height: int = 9,
        grey: float = LABEL,
        width: int | None = None,
    ) -> None:
        """Text whose capitals stand on row `at[1] + cap_height`; cut with dots where it would pass `width`.

        OpenCV's font has ASCII only: other characters are shown as "?".
        """
        text = text.encode("ascii", "replace").decode()
        if width is not None:
            text = fitted(text, width, cap_height=cap_height)
        if not text:
            return
        scale = cap_height / _CAP_HEIGHT * _TEXT_OVERSAMPLING
        stroke = max(1, round(scale * 1.1))
        (wide, tall), below = cv2.getTextSize(text, _FONT, scale, stroke)
        many = _TEXT_OVERSAMPLING
        rows, columns = -(-(tall + below + stroke) // many) + 1, -(-(wide + stroke) // many) + 1
        large = np.zeros((rows * many, columns * many), np.uint8)
        cv2.putText(large, text, (0, cap_height * many), _FONT, scale, 255, stroke, cv2.LINE_AA)
        ink = cv2.resize(large, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float32) / 255
        left, top = at
        part = self._pixels[top : top + rows, left : left + columns]
        ink = ink[: part.shape[0], : part.shape[1], None]
        part[:] = ink * grey + (1 - ink) * part

    def _part(self, at: tuple[int, int], size: tuple[int, int]) -> Float[np.ndarray, "h w 3"]:
        (left, top), (width, height) = at, size
        part = self._pixels[top : top + height, left : left + width]
        if left < 0 or top < 0 or part.shape[:2] != (height, width):
            raise ValueError(f"{width} x {height} pixels at {at} do not fit a canvas of {self._pixels.shape[1::-1]}")
        return part


def fitted(text: str, width: int, *, cap_height: int) -> str:
    """The text, or as much of its start as fits `width` pixels, with ".." behind."""
    scale = cap_height / _CAP_HEIGHT

    def fits(candidate: str) -> bool:
        return cv2.getTextSize(candidate, _FONT, scale, 1)[0][0] <= width

    if fits(text):
        return text
    kept = len(text)
    while kept > 0 and not fits(text[:kept] + ".."):
        kept -= 1
    return text[:kept] + ".." if kept else ""
