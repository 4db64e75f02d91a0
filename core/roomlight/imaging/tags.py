"""Colour tags of JPEG and PNG files: ICC profiles, PNG's cICP, gAMA and cHRM, EXIF, gain maps, alpha.

The first of these that a file has decides: cICP, ICC profile, PNG's sRGB, gAMA with cHRM, EXIF's Adobe RGB; a file
without any is sRGB. ICC profiles of other than three primaries and a usual curve are applied by LittleCMS (Pillow).
"""

import io
import re
import struct
import warnings
import zlib
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageCms

from roomlight.conventions import linear_to_srgb8
from roomlight.errors import ImageError
from roomlight.imaging.colour_spaces import ADOBE_RGB, REC709, Chromaticities, ColourSpace
from roomlight.imaging.exif import ExifCamera, read_exif
from roomlight.notes import Note, oblong_pixels

PNG: Final = b"\x89PNG\r\n\x1a\n"
_MAX_PROFILE_BYTES: Final = 4_000_000
_ICC_SEGMENT: Final = b"ICC_PROFILE\0"
_GAIN_MAPS: Final = (b"hdrgm:Version", b"http://ns.apple.com/HDRGainMap/", b"urn:iso:std:iso:ts:21496:-1")


_DEPTH_MAPS: Final = (
    *(f"http://ns.google.com/photos/{version}1.0/depthmap/".encode() for version in ("", "dd/")),
    *(b'Item:Semantic="Depth"', b"Device:DepthMap"),
)
_INSIDE: Final = (
    (_GAIN_MAPS, "HDR gain map", "highlights end at the photo's white", "give a linear EXR for the full range"),
    (_DEPTH_MAPS, "depth map", "it is not read", "extract it, and give it as the depth"),
)
_PANORAMA: Final = re.compile(rb"GPano:ProjectionType\W{1,12}(?:equirectangular|cylindrical)", re.IGNORECASE)
_TURNED: Final = b"tiff:Orientation"
"""XMP's orientation, which Pillow takes where EXIF states none."""
_EXIF_AS_TEXT: Final = b"Raw profile type exif"
_MP_ENTRIES: Final = 0xB002
_SRGB: Final = ColourSpace()
_GAMMAS: Final = (None, 563 / 256, 1.8, 1.0)
"""Curves of ICC profiles that are recognised: sRGB's, Adobe RGB's, ProPhoto's, and linear."""
_D50: Final = (0.3457, 0.3585)
"""The white to which ICC profiles are adapted."""
_NO_EXIF: Final = ExifCamera()
_PROBE: Final = np.stack(np.meshgrid(*3 * [np.arange(0, 256, 51).astype(np.uint8)]), axis=-1).reshape(36, 6, 3)
"""Colours all over the cube, on which profiles are compared."""


@dataclass(frozen=True)
class ImageTags:
    """What a file states about its pixels.

    Attributes:
        space: The colour space, unless a profile decides.
        profile: The ICC profile; None without one, and where `space` is the profile's.
        exif: Camera and orientation.
        alpha: Whether the file has alpha.
        notes: What is stated and not used.
    """

    space: ColourSpace = _SRGB
    profile: bytes | None = None
    exif: ExifCamera = _NO_EXIF
    alpha: bool = False
    notes: tuple[Note, ...] = ()


def read_tags(data: bytes, name: str) -> ImageTags:
    """Read the tags of a JPEG or PNG whose structure `limits` has checked.

    Raises:
        ValueError: The file states a colour space that is not read.
    """
    return _png_tags(data, name) if data[:8] == PNG else _jpeg_tags(data, name)


def _jpeg_tags(data: bytes, name: str) -> ImageTags:
    pieces: dict[int, bytes] = {}
    exif, notes = ExifCamera(), list[Note]()
    offset, is_cmyk = 2, False
    while offset + 4 <= len(data) and data[offset] == 0xFF and data[offset + 1] not in (0xDA, 0xD9):
        marker, (length,) = data[offset + 1], struct.unpack_from(">H", data, offset + 2)
        body = data[offset + 4 : offset + 2 + length]
        if marker == 0xE2 and body.startswith(_ICC_SEGMENT) and len(body) > 14:
            pieces[body[12]] = body[14:]
        elif marker == 0xE1 and (body.startswith(b"Exif\0\0") or _TURNED in body):
            exif = read_exif(data)
        elif marker == 0xE2 and body.startswith(b"MPF\0"):
            notes += _other_pictures(data, name)
        if marker == 0xE1:
            check_pinhole(body, name)
        is_cmyk |= marker in (0xC0, 0xC1, 0xC2) and body[5:6] == b"\4"
        kept = {note.left_out for note in notes} if marker in (0xE1, 0xE2) else set[str]()
        for marks, what, effect, advice in _INSIDE if marker in (0xE1, 0xE2) else ():
            if any(mark in body for mark in marks) and f"{name}: its {what}" not in kept:
                notes.append(Note(f"{name}: its {what}", effect, advice))
        offset += 2 + length if marker != 0xFF else 1
    profile = b"".join(pieces[key] for key in sorted(pieces)) or None
    space, colours = _colours_of(exif, name) if profile is None else (ColourSpace(), [])
    notes += colours
    if is_cmyk and profile is None:
        stated = f"{name}: its pixels are CMYK, and no profile says what ink they are of"
        notes.append(Note(stated, "they are converted by a plain formula", "save it as sRGB, or with its profile"))
    elif profile is not None and not is_cmyk:
        space, profile = space_of_profile(profile)
    return ImageTags(space, profile, exif, notes=tuple(notes))


def _colours_of(exif: ExifCamera, name: str) -> tuple[ColourSpace, list[Note]]:
    """Return the colour space by EXIF, of a picture in which nothing else states one."""
    if exif.adobe_rgb:
        return ColourSpace(ADOBE_RGB, gamma=563 / 256), []
    stated = f"{name}: its EXIF says that its colours are not sRGB, and no profile says what they are"
    note = Note(stated, "they are read as sRGB", "save it as sRGB, or with its profile")
    return ColourSpace(), [note] if exif.uncalibrated else []


def _png_tags(data: bytes, name: str) -> ImageTags:
    chunks: dict[bytes, bytes] = {}
    offset, has_exif = 8, False
    while offset + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, offset)
        if kind == b"IEND":
            break
        if kind in (b"iTXt", b"zTXt", b"tEXt"):
            text = data[offset + 8 : offset + 8 + length]
            check_pinhole(text, name)
            has_exif |= _TURNED in text or text.startswith(_EXIF_AS_TEXT)
        if kind in (b"IHDR", b"cICP", b"iCCP", b"sRGB", b"gAMA", b"cHRM", b"tRNS", b"eXIf", b"acTL", b"pHYs"):
            chunks.setdefault(kind, data[offset + 8 : offset + 8 + length])
        offset += 12 + length
    alpha = b"tRNS" in chunks or (len(chunks.get(b"IHDR", b"")) >= 10 and chunks[b"IHDR"][9] in (4, 6))
    exif = read_exif(data) if has_exif or b"eXIf" in chunks else ExifCamera()
    notes: list[Note] = []
    if b"acTL" in chunks:
        notes.append(Note(f"{name}: the frames of an animated PNG", "the first is read", "give one file a frame"))
    if len(chunks.get(b"pHYs", b"")) == 9:
        across, down, _ = struct.unpack(">IIB", chunks[b"pHYs"])
        if min(across, down) > 0:
            notes += oblong_pixels(name, down / across)
    space, profile = ColourSpace(), None
    if len(chunks.get(b"cICP", b"")) == 4:
        if chunks[b"cICP"][3] != 1:
            raise ValueError("states values of narrow range (cICP), which are not read; save it with full range")
        space = ColourSpace.of_codes(chunks[b"cICP"][0], chunks[b"cICP"][1])
    elif b"iCCP" in chunks:
        profile = _inflated(chunks[b"iCCP"].partition(b"\0")[2][1:])
        space, profile = (space, None) if profile is None else space_of_profile(profile)
    elif b"sRGB" not in chunks and (len(chunks.get(b"gAMA", b"")) == 4 or b"cHRM" in chunks):
        space = _measured(chunks.get(b"gAMA", struct.pack(">I", 45455)), chunks.get(b"cHRM", b""))
    elif b"sRGB" not in chunks:
        space, colours = _colours_of(exif, name)
        notes += colours
    return ImageTags(space, profile, exif, alpha, tuple(notes))


def check_pinhole(data: bytes, name: str) -> None:
    """Raise ImageError where XMP says that the picture is a panorama."""
    if _PANORAMA.search(data):
        raise ImageError(f"{name}: is a panorama (GPano), not the picture of a pinhole camera; cut a view out of it")


def _other_pictures(data: bytes, name: str) -> list[Note]:
    """Note the other pictures of a multi-picture JPEG; thumbnails show the same."""
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data), formats=("MPO",)) as image:
            listed: Any = getattr(image, "mpinfo", {}).get(_MP_ENTRIES, [])
            kinds = [str(entry["Attribute"]["MPType"]) for entry in listed[1:]]
    except Exception:  # Pillow raises whatever the damaged bytes lead to
        kinds = ["Undefined"]
    others = sum("Thumbnail" not in kind for kind in kinds)
    text, effect = f"{name}: further pictures (MPF): {others}", "the first picture alone is read"
    return [Note(text, effect, "save them apart if one is depth")] if others else []


def _inflated(data: bytes) -> bytes | None:
    try:
        return zlib.decompressobj().decompress(data, _MAX_PROFILE_BYTES) or None
    except zlib.error:
        return None


def _measured(gamma_chunk: bytes, chromaticity_chunk: bytes) -> ColourSpace:
    """Return the colour space of PNG's gAMA and cHRM; values near sRGB's are sRGB."""
    (gamma,) = struct.unpack(">I", gamma_chunk)
    primaries: Chromaticities = REC709
    if len(chromaticity_chunk) == 32:
        white_x, white_y, *rest = (value / 100_000 for value in struct.unpack(">8I", chromaticity_chunk))
        stated: Any = (*rest, white_x, white_y)
        if max(abs(a - b) for a, b in zip(stated, REC709, strict=True)) > 0.005:
            primaries = stated
    if gamma == 0 or abs(gamma - 45455) < 1500:
        return ColourSpace(primaries)
    return ColourSpace(primaries, gamma=min(max(100_000 / gamma, 0.2), 5.0))


@lru_cache(maxsize=8)
def space_of_profile(profile: bytes) -> tuple[ColourSpace, bytes | None]:
    """Return the colour space of an ICC profile of three primaries and a usual curve, and None; else sRGB and it.

    A colour space keeps colours beyond sRGB, and 16 bits; LittleCMS through Pillow does not.
    """
    converted, notes = profile_to_srgb8(_PROBE, profile, "")
    if converted is None:
        return _SRGB, profile if notes else None
    read: Any = ImageCms.ImageCmsProfile(io.BytesIO(profile)).profile
    if read.is_matrix_shaper:
        colours = (read.red_colorant, read.green_colorant, read.blue_colorant)
        primaries: Any = (*(part for _, xyz in colours for part in xyz[:2]), *_D50)
        for gamma in _GAMMAS:
            space = ColourSpace(primaries, gamma=gamma)
            with suppress(ValueError):  # impossible primaries
                if np.abs(linear_to_srgb8(space.to_linear(_PROBE)).astype(int) - converted).max() <= 1:
                    return space, None
    return _SRGB, profile


def profile_to_srgb8(
    image: Image.Image | UInt8[np.ndarray, "h w 3"], profile: bytes, name: str
) -> tuple[UInt8[np.ndarray, "h w 3"] | None, tuple[Note, ...]]:
    """Convert pixels by their ICC profile to 8-bit sRGB; None if the profile is sRGB or of no use."""
    try:
        space, transform = _transform(profile)
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError) as error:
        note = Note(f"{name}: its colour profile", f"it is damaged ({error}); sRGB is assumed", "save it as sRGB")
        return None, (note,)
    if transform is None:
        return None, ()
    picture = Image.fromarray(image) if isinstance(image, np.ndarray) else image
    modes = {"RGB": "RGB", "GRAY": "L", "CMYK": "CMYK"}
    coloured = space == "GRAY" and np.ptp(np.asarray(picture.convert("RGB")), axis=-1).any()
    if coloured or (space == "CMYK" and picture.mode != "CMYK"):
        stated = f"{name}: its colour profile is for {space}, which its pixels are not"
        return None, (Note(stated, "sRGB is assumed", "save it as sRGB"),)
    converted = ImageCms.applyTransform(picture.convert(modes[space]), transform)
    return (None, ()) if converted is None else (np.asarray(converted), ())


@lru_cache(maxsize=8)
def _transform(profile: bytes) -> tuple[str, ImageCms.ImageCmsTransform | None]:
    """Return the profile's space and its transform to sRGB; None where it changes no 8-bit colour by more than 1."""
    read: Any = ImageCms.ImageCmsProfile(io.BytesIO(profile))
    space = str(read.profile.xcolor_space).strip()
    mode = {"RGB": "RGB", "GRAY": "L", "CMYK": "CMYK"}.get(space)
    if mode is None:
        raise ValueError(f"it is for {space}")
    transform = ImageCms.buildTransform(
        read, ImageCms.createProfile("sRGB"), mode, "RGB", ImageCms.Intent.RELATIVE_COLORIMETRIC
    )
    if mode == "RGB":
        result = ImageCms.applyTransform(Image.fromarray(_PROBE), transform)
        if result is not None and np.abs(np.asarray(result).astype(int) - _PROBE).max() <= 1:
            return space, None
    return space, transform
