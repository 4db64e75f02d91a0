"""Texture images of furniture libraries: their size is checked before decoding, then they are scaled down."""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.errors import FurnitureError, ImageError
from roomlight.images import peek_size
from roomlight_generator.rooms.scene import Texture

MAX_SIDE: Final = 256
"""Maximum side of a stored texture in pixels: a sofa covers about as many of a 240 x 320 frame."""

MAX_IMAGE_BYTES: Final = 48 << 20
_MAX_PIXELS: Final = 40_000_000


def decode_image(data: bytes, where: str, *, side: int = MAX_SIDE) -> tuple[Texture, Float[np.ndarray, "h w"] | None]:
    """Decode a PNG or JPEG, scaled down to at most `side` pixels; also return its coverage 0 to 1 if it has holes.

    Uncovered pixels get the mean of the others: their colour is arbitrary.

    Raises:
        FurnitureError: the image does not decode or is too large; the message starts with `where`.
    """
    try:
        width, height = peek_size(data, where)
    except ImageError as error:
        raise FurnitureError(str(error)) from error
    if not 0 < width * height <= _MAX_PIXELS:
        raise FurnitureError(f"{where} has {width} x {height} pixels; the maximum is {_MAX_PIXELS}")
    try:
        raw = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise FurnitureError(f"{where} does not decode ({error.err})") from error
    if raw is None:
        raise FurnitureError(f"{where} does not decode; the file is damaged")
    pixels = np.asarray(raw)
    if pixels.dtype == np.uint16:
        pixels = (pixels // 256).astype(np.uint8)
    if pixels.dtype != np.uint8:
        raise FurnitureError(f"{where} has pixels of type {pixels.dtype}; 8 or 16 bits are read")
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    channels = pixels.shape[2]
    coverage = pixels[..., -1].astype(np.float32) / 255 if channels in (2, 4) else None
    colour = pixels[..., 2::-1] if channels >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    if coverage is not None and coverage.min() > 0.5:
        coverage = None
    if coverage is not None and coverage.max() > 0.5:
        mean = np.average(colour.reshape(-1, 3), axis=0, weights=coverage.ravel())
        colour = np.where(coverage[..., None] > 0.1, colour, np.rint(mean)).astype(np.uint8)
    colour = np.ascontiguousarray(colour)
    height, width = colour.shape[:2]
    scale = side / max(height, width)
    if scale < 1:
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        colour = np.asarray(cv2.resize(colour, size, interpolation=cv2.INTER_AREA))
        if coverage is not None:
            coverage = np.asarray(cv2.resize(coverage, size, interpolation=cv2.INTER_AREA))
    return Texture(colour), coverage
