"""Pictures of other formats as PNG, which `roomlight.images` reads: WebP, TIFF, BMP, with profile and EXIF."""

import io
from typing import Final

import cv2
import numpy as np
from jaxtyping import UInt16
from PIL import ExifTags, Image, UnidentifiedImageError
from PIL.TiffImagePlugin import TiffImageFile

from roomlight.errors import ImageError
from roomlight.imaging.exif import ADOBE_RGB, UNCALIBRATED, exif_camera_of, oriented
from roomlight.imaging.tags import check_pinhole, profile_to_srgb8

_STARTS: Final = {b"RIFF": "WebP", b"II*\0": "TIFF", b"MM\0*": "TIFF", b"BM": "BMP"}
_NOT_READ: Final = {
    **{b"\xff\x0a": "JPEG XL", b"\0\0\0\x0cJXL ": "JPEG XL", b"\0\0\0\x0cjP  ": "JPEG 2000", b"GIF8": "GIF"},
    **{b"8BPS": "a Photoshop file", b"II+\0": "BigTIFF", b"MM\0+": "BigTIFF", b"\0\0\0\x18ftypcrx ": "a raw photo"},
}
_MODES: Final = {"1": "L", "P": "RGBA", "PA": "RGBA", "CMYK": "RGB", "YCbCr": "RGB", "RGBX": "RGB"}
_KEPT: Final = ("L", "LA", "RGB", "RGBA", "I;16")

_DNG, _SUBFILE = 50706, 254
"""TIFF's tags of a DNG's version, and of what a picture is: 1 of a smaller copy."""
_BITS, _PLANES, _ALPHA = 258, 284, 338
"""TIFF's tags of the bits of a value, of where channels are (2: apart), and of what alpha is (1: multiplied in)."""
_BACK: Final = {2: 2, 3: 3, 4: 4, 5: 5, 6: 8, 7: 7, 8: 6}
"""The orientation that turns upright pixels to those stored in another."""


def as_png(data: bytes, name: str, *, max_pixels: int) -> bytes:
    """Return a WebP, TIFF or BMP as PNG of the same pixels; other files unchanged.

    Raises:
        ImageError: It does not decode, has more than `max_pixels`, several pictures, or values of another kind.
    """
    kind = next((kind for start, kind in _STARTS.items() if data.startswith(start)), None)
    for start, what in _NOT_READ.items():
        if data.startswith(start):
            raise ImageError(f"{name}: is {what}, which is not read; save it as JPEG, PNG or EXR")
    if kind is None or (kind == "WebP" and data[8:12] != b"WEBP"):
        return data
    try:
        with Image.open(io.BytesIO(data), formats=(kind.upper(),)) as image:
            size, mode, pictures = image.size, image.mode, getattr(image, "n_frames", 1)
            if size[0] * size[1] > max_pixels:
                raise ImageError(f"{name}: its header says {size[0]} x {size[1]} pixels; up to {max_pixels} are read")
            if kind == "TIFF" and (
                _DNG in image.getexif() or image.getexif().get(_SUBFILE, 0) & 1 or data[8:10] == b"CR"
            ):
                raise ImageError(f"{name}: is a raw photo, of which only a preview is here; develop it to TIFF or PNG")
            if pictures != 1:
                raise ImageError(f"{name}: the {kind} holds {pictures} pictures; save one of them")
            if mode not in _KEPT and mode not in _MODES:
                raise ImageError(f"{name}: the {kind} has values of the kind {mode}; save it as EXR, or with 8 bits")
            check_pinhole(data, name)
            tags, profile = _photo_tags(image.getexif()), image.info.get("icc_profile")
            if isinstance(image, TiffImageFile) and mode in ("RGB", "RGBA") and 16 in image.tag_v2.get(_BITS, ()):
                return _with_pixels(_png(Image.new("L", (1, 1)), tags, profile), _bgr16(data, image))
            picture = image.convert(mode if mode in _KEPT else _MODES[mode])
            if mode == "CMYK":
                converted = profile_to_srgb8(image, profile, name)[0] if profile else None
                picture, profile = picture if converted is None else Image.fromarray(converted), None
                if converted is None:  # by a plain formula
                    tags.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.ColorSpace] = UNCALIBRATED
            if kind == "TIFF" and (back := _BACK.get(tags[ExifTags.Base.Orientation])) is not None:
                picture = Image.fromarray(oriented(np.asarray(picture), back))  # Pillow turned it as it decoded it
            return _png(picture, tags, profile)
    except ImageError:
        raise
    except Exception as error:  # Pillow raises whatever the damaged bytes lead to
        hint = "; TIFF is read with 8 or 16 bits" if kind == "TIFF" else ""
        why = "of an unknown layout" if isinstance(error, UnidentifiedImageError) else error
        raise ImageError(f"{name}: the {kind} does not decode ({why}){hint}; save it as PNG or EXR") from error


def _png(picture: Image.Image, tags: Image.Exif, profile: bytes | None) -> bytes:
    out = io.BytesIO()
    picture.save(out, "PNG", compress_level=1, exif=tags, **({"icc_profile": profile} if profile else {}))
    return out.getvalue()


def _with_pixels(png: bytes, bgr: UInt16[np.ndarray, "h w c"]) -> bytes:
    """Return a PNG of these pixels with the tags of `png`: what is between its header (33 bytes) and its pixels."""
    encoded = cv2.imencode(".png", bgr, (cv2.IMWRITE_PNG_COMPRESSION, 1))[1].tobytes()
    return encoded[:33] + png[33 : png.rindex(b"IDAT") - 4] + encoded[33:]


def _bgr16(data: bytes, image: TiffImageFile) -> UInt16[np.ndarray, "h w c"]:
    """Decode a TIFF of 16 bits in its mode RGB or RGBA to BGR or BGRA as stored: Pillow keeps 8 bits.

    Raises:
        ValueError: It does not decode, or has its channels apart.
    """
    if image.tag_v2.get(_PLANES) == 2:  # which OpenCV and Pillow misread
        raise ValueError("16 bits with channels apart, not interleaved")
    upright = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if upright is None or upright.dtype != np.uint16:  # pyright: ignore[reportUnnecessaryComparison]  (as in images)
        raise ValueError("16 bits, truncated or damaged")
    bgr = oriented(upright, _BACK.get(image.tag_v2.get(ExifTags.Base.Orientation, 1), 1))
    if image.mode == "RGB":
        return np.ascontiguousarray(bgr[..., :3])
    if image.tag_v2.get(_ALPHA) == (1,):
        alpha = np.maximum(bgr[..., 3:], 1).astype(np.float32)
        bgr[..., :3] = np.rint(np.minimum(bgr[..., :3] * (65535 / alpha), 65535))
    return bgr


def _photo_tags(stated: Image.Exif) -> Image.Exif:
    """Return the orientation and the camera's tags, without those of the file's own layout."""
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = stated.get(ExifTags.Base.Orientation, 1)
    details = exif.get_ifd(ExifTags.IFD.Exif)
    details.update(stated.get_ifd(ExifTags.IFD.Exif))
    if exif_camera_of(stated).adobe_rgb:  # by the interoperability index, which PNG's writer leaves out
        details[ExifTags.Base.ColorSpace] = ADOBE_RGB
    return exif
