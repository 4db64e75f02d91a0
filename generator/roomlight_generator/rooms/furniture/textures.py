"""Texture images of furniture libraries: decoded with their size checked first, and made small."""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from roomlight.errors import FurnitureError, ImageError
from roomlight.images import peek_size
from roomlight_generator.rooms.furniture.archive import Archive

MAX_SIDE: Final = 256
"""Pixels of a stored texture's longer side: a sofa fills about as many of a 240 x 320 frame."""

_MAX_PIXELS: Final = 40_000_000
_MAX_BYTES: Final = 48 << 20


@dataclass(frozen=True, eq=False)
class Picture:
    """An sRGB image, row 0 at the top, and its coverage 0 to 1 where it has holes."""

    image: UInt8[np.ndarray, "h w 3"]
    coverage: Float[np.ndarray, "h w"] | None = None


def read_picture(archive: Archive, member: str, *, side: int = MAX_SIDE) -> Picture:
    """A PNG or JPEG of the archive, no larger than `side`. FurnitureError when it does not decode or is too large."""
    where = f"{archive.path}: texture {member}"
    return decode_picture(archive.read(member, limit=_MAX_BYTES), where, side=side)


def decode_picture(data: bytes, where: str, *, side: int = MAX_SIDE) -> Picture:
    """The same from bytes. Colours where nothing covers are the mean of the rest, for they are arbitrary in files."""
    try:
        width, height = peek_size(data, where)
    except ImageError as error:
        raise FurnitureError(str(error)) from error
    if not 0 < width * height <= _MAX_PIXELS:
        raise FurnitureError(f"{where} has {width} x {height} pixels; {_MAX_PIXELS} are the most that is read")
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
    return _shrunk(Picture(np.ascontiguousarray(colour), coverage), side)


def _shrunk(picture: Picture, side: int) -> Picture:
    height, width = picture.image.shape[:2]
    scale = side / max(height, width)
    if scale >= 1:
        return picture
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    coverage = picture.coverage
    return Picture(
        image=np.asarray(cv2.resize(picture.image, size, interpolation=cv2.INTER_AREA), np.uint8),
        coverage=None
        if coverage is None
        else np.asarray(cv2.resize(coverage, size, interpolation=cv2.INTER_AREA), np.float32),
    )
