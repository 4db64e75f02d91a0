"""HEIC photos (libheif, the extra `heic`): pixels with their colour, EXIF, and the depth of portraits; AVIF is refused.

libheif turns colour and depth upright by the file's own rotation, so that the EXIF orientation is not applied again.

iPhones store disparity, 1 / metres, in 8 bits between two floats, which the SEI of the auxiliary image states
(ISO/IEC 23008-2, depth representation information) or Apple's XMP (`apdi:FloatMinValue`, `FloatMaxValue`). Depth of two
lenses is exact up to a factor (`depthData:Accuracy` relative); that of LiDAR and TrueDepth is in metres (absolute).
"""

import importlib
import importlib.util
import math
import re
import struct
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Shaped
from PIL import Image

from roomlight.depth import clean_depth
from roomlight.errors import ImageError
from roomlight.imaging.colour_spaces import ColourSpace
from roomlight.imaging.exif import ExifCamera, exif_camera_of
from roomlight.imaging.tags import space_of_profile
from roomlight.notes import Note

_LIBRARY: Final = "pillow_heif"
_BRANDS: Final = (b"heic", b"heix", b"hevc", b"hevx", b"heim", b"heis", b"mif1", b"msf1", b"avif", b"avis")
_INVERSE_Z, _DISPARITY = 0, 1
_FARTHEST_M: Final = 100.0
_GAIN_MAP: Final = "hdrgainmap"
_TONE_MAP: Final = re.compile(rb"infe[\x02\x03].{3}(?:.{4}|.{6})tmap", re.DOTALL)
"""The entry of a gain map among the items: version, flags, number and protection precede its type."""
_IROT: Final = re.compile(rb"\0\0\0\x09irot([\0-\3])")
_IMIR: Final = re.compile(rb"\0\0\0\x09imir([\0\1])")
_ORIENTATIONS: Final = {None: (1, 8, 3, 6), 0: (4, 5, 2, 7), 1: (2, 7, 4, 5)}
"""EXIF's orientation by the axis of imir, if any, and the quarter turns of irot, counter-clockwise and first."""
_HEAD: Final = 65536
"""Bytes that may name the item of ISO 21496-1's gain map; pixels further on may look like its name."""


@dataclass(frozen=True)
class HeicPhoto:
    """A decoded file.

    Attributes:
        pixels: Encoded colour, uint8 or uint16 [h, w, 3 or 4], upright.
        space: The colour space, unless a profile decides.
        profile: The ICC profile; None without one, and where `space` is the profile's.
        depth_m: The depth map in metres, upright, 0 = unknown; None without one.
        focal: Focal length relative to the longer side, by the depth's calibration; None without one.
        depth_notes: What is uncertain about the depth.
        notes: What else the file states and was not used.
    """

    pixels: Shaped[np.ndarray, "h w c"]
    space: ColourSpace
    profile: bytes | None
    depth_m: Float[np.ndarray, "dh dw"] | None
    focal: float | None
    depth_notes: tuple[Note, ...]
    notes: tuple[Note, ...]


def is_heic(data: bytes) -> bool:
    """Whether a file begins as HEIC does, or as AVIF, which the functions below refuse."""
    return data[4:8] == b"ftyp" and any(data[at : at + 4] in _BRANDS for at in range(8, min(len(data), 40), 4))


def heic_available() -> bool:
    """Return whether HEIC can be decoded (the extra `heic` is installed)."""
    return importlib.util.find_spec(_LIBRARY) is not None


def heic_size(data: bytes, name: str) -> tuple[int, int]:
    """Read (width, height) of the upright picture without decoding pixels. Raises ImageError."""
    return _opened(data, name).size


def heic_exif(data: bytes, name: str) -> ExifCamera:
    """Read the EXIF without decoding pixels; its orientation is the rotation that libheif applies, not EXIF's own."""
    turn, mirror = _IROT.search(data), _IMIR.search(data)
    orientation = _ORIENTATIONS[mirror and mirror[1][0]][turn[1][0] if turn else 0]
    return replace(exif_camera_of(_exif(_opened(data, name))), orientation=orientation)


def _exif(photo: Any) -> Image.Exif:
    """Return the EXIF; an empty one if it is missing or damaged."""
    exif = Image.Exif()
    try:
        exif.load(bytes(photo.info.get("exif") or b""))
    except (SyntaxError, ValueError, KeyError, struct.error):
        return Image.Exif()
    return exif


def read_heic(data: bytes, name: str) -> HeicPhoto:
    """Decode a file whose size has been checked.

    Raises:
        ImageError: The extra is not installed, the file is damaged, or its colour space is not read.
    """
    photo = _opened(data, name)
    try:
        pixels = np.array(photo)
        info = dict(photo.info)
        depth, depth_notes = _depth(info.get("depth_images") or [], data, name)
        codes = info.get("nclx_profile") or {}
        primaries, transfer = int(codes.get("color_primaries", 2)), int(codes.get("transfer_characteristics", 2))
        space = ColourSpace.of_codes(primaries, transfer)
        if profile := info.get("icc_profile") or None:
            space, profile = space_of_profile(profile)
    except ImageError:
        raise
    except Exception as error:  # libheif raises whatever the damaged bytes lead to
        raise ImageError(f"{name}: the HEIC does not decode ({error})") from error
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[..., None], 3, axis=-1)
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or pixels.dtype.name not in ("uint8", "uint16"):
        raise ImageError(f"{name}: the HEIC holds {pixels.dtype} of shape {pixels.shape}; RGB of 8 or 16 bits is read")
    notes = depth_notes if depth is None else ()
    aux = info.get("aux") or {}
    brands = {data[at : at + 4] for at in range(8, min(int.from_bytes(data[:4]), _HEAD), 4)}
    has_gain_map = b"tmap" in brands or _TONE_MAP.search(data[:_HEAD]) is not None
    if has_gain_map or any(_GAIN_MAP in str(kind) or "21496" in str(kind) for kind in aux):
        text = "highlights end at the photo's white"
        notes = (*notes, Note(f"{name}: its HDR gain map", text, "give a linear EXR for the full range"))
    if (others := len(photo) - 1) > 0:
        text = f"{name}: further pictures: {others}"
        notes = (*notes, Note(text, "the primary picture alone is read", "save them apart if one is depth"))
    turn = exif_camera_of(_exif(photo)).orientation
    if turn != 1 and not any(box in data for box in (b"irot", b"imir")):
        text = f"{name}: EXIF orientation {turn}, and the HEIC itself is not rotated"
        notes = (*notes, Note(text, "pixels are read as stored", "rotate the picture if it is not upright"))
    return HeicPhoto(
        pixels=pixels,
        space=space,
        profile=profile,
        depth_m=depth,
        focal=_focal(data),
        depth_notes=depth_notes,
        notes=notes,
    )


def _opened(data: bytes, name: str) -> Any:
    if any(brand in data[:40] for brand in (b"avif", b"avis")):
        raise ImageError(f"{name}: AVIF is not read, because its HDR would be lost; save it as HEIC, JPEG or PNG")
    if not heic_available():
        raise ImageError(f"{name}: is HEIC, which needs pip install 'roomlight[heic]'; or convert it to JPEG or PNG")
    heif: Any = importlib.import_module(_LIBRARY)
    try:
        return heif.open_heif(data, convert_hdr_to_8bit=False)
    except Exception as error:  # as above: IndexError without a primary image, ...
        raise ImageError(f"{name}: the HEIC does not decode ({error})") from error


def _depth(images: list[Any], data: bytes, name: str) -> tuple[Float[np.ndarray, "h w"] | None, tuple[Note, ...]]:
    """Return the first depth map in metres, and what is uncertain about it. Raises ImageError for unknown kinds."""
    if not images:
        return None, ()
    stored = np.array(images[0])
    share = stored.astype(np.float64) / float(np.iinfo(stored.dtype).max)
    stated = images[0].info.get("metadata") or {}
    low, high = stated.get("d_min"), stated.get("d_max")
    near, far = stated.get("z_near"), stated.get("z_far")
    is_depth = re.search(rb'apdi:AuxiliaryImageType(?:>|=")\s*depth\b', data) is not None  # other images have types too
    if low is None or high is None:
        low, high = _xmp_number(data, "apdi:FloatMinValue"), _xmp_number(data, "apdi:FloatMaxValue")
    form = int(stated.get("representation_type", _DISPARITY))
    if form == _INVERSE_Z and near and far:
        low, high = 1 / far, 1 / near
    elif form not in (_INVERSE_Z, _DISPARITY):
        raise ImageError(f"{name}: its depth map has the representation {form}; inverse depth and disparity are read")
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high) and low < high):
        note = Note(f"{name}: its depth map", "it states no range, so that it is not used", "give the depth as a file")
        return None, (note,)
    values = low + share * (high - low)
    metres = values if is_depth else 1 / np.where(values > 1 / _FARTHEST_M, values, np.inf)
    notes: tuple[Note, ...] = ()
    if _xmp(data, "depthData:Accuracy") == "relative":
        text = "distances may be off by a factor, and the light of near lamps with them"
        notes = (Note(f"{name}: its depth is of two lenses, of relative accuracy", text, "state depth_unit_m"),)
    return clean_depth(metres.astype(np.float32)), notes


def _focal(data: bytes) -> float | None:
    """Return the focal length of the depth's calibration, relative to the longer side of its reference size."""
    width = _xmp_number(data, "depthData:IntrinsicMatrixReferenceWidth")
    height = _xmp_number(data, "depthData:IntrinsicMatrixReferenceHeight")
    match = re.search(rb"depthData:IntrinsicMatrix>.{0,200}?<rdf:li>([\d.eE+-]{1,30})</rdf:li>", data, re.DOTALL)
    if not (width and height and match):
        return None
    try:
        focal = float(match[1]) / max(width, height)
    except ValueError:
        return None
    return focal if 0.1 < focal < 50 else None


def _xmp(data: bytes, key: str) -> str | None:
    """Return the value of an XMP property, written as an element or an attribute."""
    match = re.search(key.encode() + rb'(?:>|=")([^<"]{1,40})', data)
    return match[1].decode("ascii", "replace").strip() if match else None


def _xmp_number(data: bytes, key: str) -> float | None:
    try:
        value = float(_xmp(data, key) or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None
