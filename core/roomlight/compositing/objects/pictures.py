"""Decode the pictures of an object's textures: PNG, JPEG, WebP, AVIF and what OBJ files name, within the limits."""

import io

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.errors import ImageError, ObjectError
from roomlight.images import peek_size
from roomlight.imaging.limits import check_png, png_of_pixels

_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
_OTHERS = ("WebP", "AVIF")


class PictureReader:
    """Decodes the pictures of one object; together they have at most `total_pixels`."""

    def __init__(self, limits: ObjectLimits) -> None:
        self._limits, self._pixels = limits, 0

    def read(self, data: bytes, label: str, *, more: tuple[str, ...] = ()) -> UInt8[np.ndarray, "h w c"]:
        """Return 8-bit RGB or RGBA; `label` begins every message, `more` are further formats. Raises ObjectError."""
        formats = (*_OTHERS, *more)
        try:
            if data[:8] == _PNG:
                check_png(data, label)
            width, height = (
                peek_size(data, label) if data[:8] == _PNG or data[:3] == _JPEG else _other_size(data, label, formats)
            )
        except ImageError as error:
            raise ObjectError(str(error)) from error
        self.count(width, height, label)
        return _decode(data, label, (height, width), formats)

    def count(self, width: int, height: int, label: str) -> None:
        """Count a picture's pixels before it is decoded. Raises ObjectError beyond the limits."""
        if width < 1 or height < 1:
            raise ObjectError(f"{label} has no pixels")
        self._limits.check("image_pixels", width * height, label)
        self._pixels += width * height
        self._limits.check("total_pixels", self._pixels, label)


def _other_size(data: bytes, label: str, formats: tuple[str, ...]) -> tuple[int, int]:
    """Read (width, height) of a picture in one of Pillow's formats. Raises ObjectError for other files."""
    try:
        with Image.open(io.BytesIO(data), formats=formats) as image:
            return image.size
    except Exception as error:  # Pillow raises whatever the damaged bytes lead to
        known = f"PNG, JPEG, {', '.join(formats[:-1])} nor {formats[-1]}"
        raise ObjectError(f"{label} is neither {known} (it starts with {data[:4].hex()})") from error


def _clear_grey(data: bytes) -> int | None:
    """Return the decoded value that a grey PNG declares transparent (tRNS), which OpenCV does not say."""
    at = data.find(b"\0\0\0\2tRNS", 0, data.find(b"IDAT"))
    if data[:8] != _PNG or at < 0:
        return None
    depth, stated = data[24], int.from_bytes(data[at + 8 : at + 10], "big")
    return stated * 255 // (2**depth - 1) if depth < 8 else stated


def _decode(data: bytes, label: str, size: tuple[int, int], formats: tuple[str, ...]) -> UInt8[np.ndarray, "h w c"]:
    if data[:8] != _PNG and data[:3] != _JPEG:
        try:
            with Image.open(io.BytesIO(data), formats=formats) as picture:
                if picture.mode[0] in "IF":  # more than 8 bits, which Pillow would clip
                    raise ValueError(f"its values are {picture.mode}; 8 bits are read")
                return np.asarray(picture.convert("RGBA" if picture.has_transparency_data else "RGB"))
        except Exception as error:  # as above
            raise ObjectError(f"{label} does not decode ({error})") from error
    try:
        image = cv2.imdecode(np.frombuffer(png_of_pixels(data), np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise ObjectError(f"{label} does not decode ({error.err})") from error
    if image is None or image.shape[:2] != size:  # pyright: ignore[reportUnnecessaryComparison]  (the stub lacks None)
        raise ObjectError(f"{label} does not decode; the file is truncated or damaged")
    clear = _clear_grey(data)
    alpha = None if clear is None or image.ndim > 2 else np.where(image == clear, 0, 255).astype(np.uint8)
    if image.dtype == np.uint16:
        image = np.right_shift(image.astype(np.uint16), 8).astype(np.uint8)
    if image.dtype != np.uint8:
        raise ObjectError(f"{label} has values of {image.dtype}; 8 or 16 bits are read")
    if image.ndim == 2:
        image = image[..., None] if alpha is None else np.stack([image, alpha], axis=-1)
    channels = image.shape[2]
    if channels <= 2:
        grey = np.repeat(image[..., :1], 3, axis=2)
        return grey if channels == 1 else np.concatenate([grey, image[..., 1:]], axis=2)
    order = [2, 1, 0, 3] if channels == 4 else [2, 1, 0]
    return np.ascontiguousarray(image[..., order])
