"""Read and write image files: JPEG, PNG, EXR and Radiance HDR. Sizes are checked before pixels are decoded.

Colour is decoded to linear RGB, depth to metres. Every failure is an `ImageError` that names the file. The rules for
orientation, colour space, alpha and end marks are in docs/reading-rules.md; `roomlight.imaging` reads what they need.

Sizes are read by hand. Pillow reads no HDR and no EXR; of PNG and JPEG it reads the size, but takes 16 and 34 us
instead of 0.4 and 10, on every frame of a stream, and keeps each segment of a JPEG in memory: 8 MB of empty segments
take 4 s and 270 MB, where `peek_size` stops at the limit of `roomlight.imaging.limits`.
"""

import io
import struct
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import OpenEXR
from jaxtyping import Bool, Float, Shaped, UInt8, UInt16
from PIL import Image

from roomlight.conventions import linear_to_srgb8, srgb8_to_linear
from roomlight.depth import clean_depth
from roomlight.errors import ImageError, OutputError
from roomlight.files import write_atomic
from roomlight.frame import clipped_pixels
from roomlight.imaging.colour_spaces import REC709, ColourSpace
from roomlight.imaging.exif import ExifCamera, oriented, read_exif
from roomlight.imaging.exr import exr_size, read_exr
from roomlight.imaging.heic import heic_exif, heic_size, is_heic, read_heic
from roomlight.imaging.limits import MAX_JPEG_SEGMENTS, check_jpeg, check_png, png_of_pixels
from roomlight.imaging.radiance import read_header
from roomlight.imaging.tags import ImageTags, profile_to_srgb8, read_tags
from roomlight.notes import Note, oblong_pixels

MAX_PIXELS: Final = 64_000_000
"""Largest image decoded (8192 x 7812). Phones take up to 48 megapixels; a larger header is a decompression bomb."""
MIN_ALPHA: Final = 0.5
"""Pixels of less alpha show nothing."""

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8"
_HDR: Final = b"#?"
_EXR: Final = b"\x76\x2f\x31\x01"


@dataclass(frozen=True)
class OwnDepth:
    """The depth map that a picture holds: a portrait's (HEIC), or the channel of an EXR.

    Attributes:
        depth_m: Depth in metres, float32 [dh, dw], 0 = unknown; turned like the picture.
        focal: Focal length relative to the photo's longer side; None if not stated.
        notes: What is uncertain about the depth.
    """

    depth_m: Float[np.ndarray, "dh dw"]
    focal: float | None
    notes: tuple[Note, ...]


@dataclass(frozen=True)
class ColourImage:
    """A decoded picture.

    Attributes:
        image: Linear RGB (Rec. 709), float32 [h, w, 3].
        clipped: Pixels whose stored value saturated.
        seen: Pixels that show something; None if all do. The others are transparent, or outside an EXR's data window.
        notes: What the file states and was not used.
        own_depth: The depth map in the same file; None without one.
    """

    image: Float[np.ndarray, "h w 3"]
    clipped: Bool[np.ndarray, "h w"]
    seen: Bool[np.ndarray, "h w"] | None = None
    notes: tuple[Note, ...] = ()
    own_depth: OwnDepth | None = None


def exif_camera(data: bytes, name: str) -> ExifCamera:
    """Read the focal length and the orientation from a photo's EXIF.

    Missing or damaged EXIF gives the defaults: it describes the photo and is not needed to decode it.

    Raises:
        ImageError: The header is damaged, or declares more than `MAX_PIXELS`.
    """
    if is_heic(data):
        return heic_exif(data, name)
    if data[:8] != _PNG and data[:2] != _JPEG:
        return ExifCamera()
    _check_size(data, name)
    return read_exif(data)


def read_bytes(path: Path) -> bytes:
    """Read a file. Raises ImageError if it is missing, unreadable or empty."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ImageError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not data:
        raise ImageError(f"{path}: the file is empty")
    return data


def decode_picture(data: bytes, name: str, *, as_stored: bool = False) -> ColourImage:
    """Decode a JPEG, PNG, HEIC, EXR or HDR file to linear RGB by the file's colour space.

    Files of 8 and 16 bits clip at `roomlight.frame.CLIPPED_SRGB8`, and are rotated by their EXIF orientation unless
    `as_stored`. EXR and HDR are linear and never clip.

    Raises:
        ImageError: The data does not decode, its header declares more than `MAX_PIXELS`, or its colour space is not
            read; begins with `name`.
    """
    if data[:4] == _EXR:
        _check_size(data, name)
        exr = read_exr(data, name)
        stored, alpha = exr.colour(), exr.alpha()
        seen = np.logical_not(np.isnan(stored).any(axis=-1))
        for shown in (exr.seen(), None if alpha is None else alpha >= MIN_ALPHA):
            seen = seen if shown is None else np.logical_and(seen, shown)
        image = _finite(stored, name)
        depth = exr.depth_of_colour()
        own = None if depth is None or not depth.any() else OwnDepth(clean_depth(depth), None, ())
        return ColourImage(image, np.zeros(image.shape[:2], bool), _unless_all(seen), exr.notes, own)
    if is_heic(data):
        return _decode_heic(data, name)
    if data[:2] == _HDR:
        _check_size(data, name)
        header = read_header(data, name)
        encoded = _decode_with_opencv(header.standard_file(data), name, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
        image = _finite(header.picture(encoded[..., ::-1].astype(np.float32)), name)
        return ColourImage(image, np.zeros(image.shape[:2], bool), notes=tuple(oblong_pixels(name, header.aspect)))
    return _decode_encoded(data, name, as_stored=as_stored)


def _decode_heic(data: bytes, name: str) -> ColourImage:
    _check_size(data, name)
    photo = read_heic(data, name)
    rgb, notes = np.ascontiguousarray(photo.pixels[..., :3]), photo.notes
    top = int(np.iinfo(rgb.dtype).max)
    clipped = clipped_pixels(rgb)
    seen = photo.pixels[..., 3] >= top * MIN_ALPHA if photo.pixels.shape[2] == 4 else None
    space = photo.space
    if photo.profile is not None:
        rgb8 = (rgb >> 8).astype(np.uint8) if rgb.dtype == np.uint16 else rgb
        converted, more = profile_to_srgb8(rgb8, photo.profile, name)
        rgb, notes = rgb8 if converted is None else converted, notes + more
        space = ColourSpace()
    image = srgb8_to_linear(rgb) if space.is_srgb and rgb.dtype == np.uint8 else space.to_linear(rgb)
    depth_m = photo.depth_m
    depth = None if depth_m is None else OwnDepth(depth_m, photo.focal, photo.depth_notes)
    return ColourImage(image, clipped, _unless_all(seen), notes, depth)


def _decode_encoded(data: bytes, name: str, *, as_stored: bool) -> ColourImage:
    _check_size(data, name)
    try:
        tags = read_tags(data, name)
    except (ValueError, struct.error) as error:
        raise ImageError(f"{name}: {error}") from error
    depth = 0 if tags.profile is not None else cv2.IMREAD_ANYDEPTH  # profiles are applied to 8 bits
    encoded = _decode_with_opencv(data, name, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION | depth)
    rgb = np.asarray(cv2.cvtColor(encoded, cv2.COLOR_BGR2RGB))
    clipped = clipped_pixels(rgb)
    notes = tags.notes
    if data[:8] == _PNG and data[24] == 16 and rgb.max() < 256**rgb.itemsize // 16:
        stated = f"{name}: its values use at most 12 of its 16 bits"
        notes = (*notes, Note(stated, "it is read as nearly black", "scale them to 16 bits, unless it was dark"))
    if tags.profile is not None:
        source = Image.open(io.BytesIO(data)) if _is_cmyk(data) else rgb
        converted, more = profile_to_srgb8(source, tags.profile, name)
        rgb, notes = rgb if converted is None else converted, notes + more
    image = srgb8_to_linear(rgb) if tags.space.is_srgb and rgb.dtype == np.uint8 else tags.space.to_linear(rgb)
    seen = _opaque(data, name) if tags.alpha else None
    turn = 1 if as_stored else tags.exif.orientation
    if turn != 1:
        image, clipped = oriented(image, turn), oriented(clipped, turn)
        seen = None if seen is None else oriented(seen, turn)
    elif tags.exif.orientation != 1:
        notes = (*notes, _unturned(tags, name))
    if tags.exif.no_orientation is not None:
        stated = f"{name}: EXIF orientation {tags.exif.no_orientation}, which does not exist (1 to 8)"
        notes = (*notes, Note(stated, "pixels are read as stored", "rotate the picture if it is not upright"))
    return ColourImage(image, clipped, _unless_all(seen), notes)


def decode_colour(data: bytes, name: str) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Decode a file to linear RGB float32 and the mask of clipped pixels; see `decode_picture`. Raises ImageError."""
    picture = decode_picture(data, name)
    return picture.image, picture.clipped


def read_colour(path: Path) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Read a file and decode it with `decode_colour`. Raises ImageError."""
    return decode_colour(read_bytes(path), str(path))


def decode_depth(
    data: bytes, name: str, *, unit_m: float | None = None, integer_m: float = 0.001
) -> Float[np.ndarray, "h w"]:
    """Decode depth in metres (0 = unknown) from a 16-bit PNG or a float EXR.

    Args:
        data: The file.
        name: The file in messages.
        unit_m: Metres of one stored unit, of integers and floats alike; None if nobody states it.
        integer_m: Metres of one integer unit if `unit_m` is None; floats are metres then.

    Raises:
        ImageError: The data does not decode or is not a depth map; the message begins with `name`.
    """
    if data[:4] == _EXR:
        _check_size(data, name)
        with np.errstate(over="ignore", invalid="ignore"):
            return clean_depth(read_exr(data, name).depth() * np.float32(1.0 if unit_m is None else unit_m))
    if data[:8] != _PNG and data[:2] not in (_JPEG, _HDR):
        what = f"this starts with {data[:4].hex()}"
        raise ImageError(f"{name}: depth must be a 16-bit grey PNG or PGM, a TIFF, an EXR or a .npy; {what}")
    raw = decode_grey16(data, name)
    depth = raw.astype(np.float32) * np.float32(integer_m if unit_m is None else unit_m)
    depth[raw == 65535] = 0.0
    return clean_depth(depth)


def decode_grey16(data: bytes, name: str) -> UInt16[np.ndarray, "h w"]:
    """Decode a 16-bit grey image of depth, in stored units. Raises ImageError."""
    raw = _decode_with_opencv(data, name, cv2.IMREAD_UNCHANGED)
    if raw.ndim != 2 or raw.dtype != np.uint16:
        raise ImageError(f"{name}: depth must be a 16-bit grey PNG, this is {raw.dtype} with shape {raw.shape}")
    return raw


def decode_grey8(data: bytes, name: str) -> UInt8[np.ndarray, "h w"]:
    """Decode an 8-bit grey image, such as a mask or confidence levels, without conversion. Raises ImageError."""
    raw = _decode_with_opencv(data, name, cv2.IMREAD_UNCHANGED)
    if raw.ndim != 2 or raw.dtype != np.uint8:
        raise ImageError(f"{name}: must be an 8-bit grey image, this is {raw.dtype} with shape {raw.shape}")
    return raw


def read_panorama(path: Path) -> Float[np.ndarray, "h w 3"]:
    """Read an equirectangular panorama as float32 linear RGB, W = 2H. Raises ImageError."""
    image, _ = read_colour(path)
    if image.shape[1] != 2 * image.shape[0]:
        raise ImageError(f"{path}: a panorama is twice as wide as high, this is {image.shape[1]} x {image.shape[0]}")
    return image


def encode_exr(
    image: Float[np.ndarray, "h w c"], *, metadata: Mapping[str, object] | None = None, half: bool = True
) -> bytes:
    """Encode linear RGB, or RGB times alpha with alpha, as a ZIP-compressed EXR with Rec. 709's primaries.

    The same image and metadata give the same bytes. Half floats are clipped to 65504, the largest, so that no infinity
    reaches a renderer; without `half` the file holds 32-bit floats.

    Raises:
        OutputError: The image cannot be encoded.
    """
    pixels = np.clip(image, -65504, 65504).astype(np.float16) if half else image.astype(np.float32)
    return _encode_exr("RGBA"[: image.shape[2]], pixels, metadata)


def encode_channel_exr(
    name: str, values: Shaped[np.ndarray, "h w"], *, metadata: Mapping[str, object] | None = None
) -> bytes:
    """Encode one channel in floats; compositing programs look for depth in Z.

    Raises:
        OutputError: The channel cannot be encoded.
    """
    return _encode_exr(name, values.astype(np.float32), metadata)


def _encode_exr(channels: str, pixels: Float[np.ndarray, "h w *c"], metadata: Mapping[str, object] | None) -> bytes:
    header: dict[str, object] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= {"chromaticities": REC709, **(metadata or {})}
    try:
        with tempfile.TemporaryDirectory() as folder:  # the library writes into memory from 3.5 on only
            path = Path(folder) / "image.exr"
            OpenEXR.File(header, {channels: np.ascontiguousarray(pixels)}).write(str(path))
            return path.read_bytes()
    except (OSError, RuntimeError) as error:
        raise OutputError(f"an EXR of {pixels.shape[1]} x {pixels.shape[0]} cannot be encoded ({error})") from error


def write_exr(path: Path, image: Float[np.ndarray, "h w 3"], *, metadata: Mapping[str, object] | None = None) -> None:
    """Write an EXR with `encode_exr`, atomically. Raises OutputError."""
    write_atomic(path, encode_exr(image, metadata=metadata))


def encode_png(image: Shaped[np.ndarray, "h w *c"]) -> bytes:
    """Encode a PNG: uint8 and uint16 unchanged, linear float RGB as sRGB. Raises OutputError."""
    pixels = linear_to_srgb8(image) if np.issubdtype(image.dtype, np.floating) else image
    if pixels.ndim == 3:
        pixels = pixels[..., ::-1]
    ok, data = cv2.imencode(".png", np.ascontiguousarray(pixels))
    if not ok:
        raise OutputError(f"PNG encoding of {pixels.shape} {pixels.dtype} failed")
    return data.tobytes()


def write_png(path: Path, image: Shaped[np.ndarray, "h w *c"]) -> None:
    """Write a PNG with `encode_png`, atomically. Raises OutputError."""
    write_atomic(path, encode_png(image))


def _decode_with_opencv(data: bytes, name: str, flags: int) -> Shaped[np.ndarray, "h w *c"]:
    width, height = _check_size(data, name)
    if data[:2] == _JPEG and check_jpeg(data, name) is None:
        data = _ended(data, name)
    try:
        image = cv2.imdecode(np.frombuffer(png_of_pixels(data), np.uint8), flags)
    except cv2.error as error:
        raise ImageError(f"{name}: does not decode ({error.err})") from error
    if image is None:  # pyright: ignore[reportUnnecessaryComparison]  (OpenCV's own stub leaves the None out)
        raise ImageError(f"{name}: does not decode; the file is truncated or damaged")
    if image.shape[:2] != (height, width):
        raise ImageError(f"{name}: its header says {width} x {height} but {image.shape[1]} x {image.shape[0]} decoded")
    return image


def _ended(data: bytes, name: str) -> bytes:
    """Add the end mark to a JPEG that lacks it.

    Where scan data is missing, the decoder consumes what is put in its place and the last pixels depend on it.

    Raises:
        ImageError: Scan data is missing too: the file is truncated.
    """
    pictures: list[bytes] = []
    for filler in (b"\x00", b"\x5b"):
        try:
            with Image.open(io.BytesIO(data + filler * 4096 + b"\xff\xd9"), formats=("JPEG",)) as image:
                pictures.append(image.tobytes())
        except Exception as error:  # as of damaged EXIF, whatever the bytes lead to
            raise ImageError(f"{name}: the JPEG ends before its end mark; the file is truncated") from error
    if pictures[0] != pictures[1]:
        raise ImageError(f"{name}: the JPEG ends before its end mark; the file is truncated")
    return data + b"\xff\xd9"


def _opaque(data: bytes, name: str) -> Bool[np.ndarray, "h w"]:
    """Return where a PNG is opaque, for every way in which PNG stores alpha."""
    try:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            alpha = np.asarray(image.convert("RGBA").getchannel("A"))
    except Exception as error:  # Pillow raises whatever the damaged bytes lead to
        raise ImageError(f"{name}: its alpha does not decode ({error})") from error
    return alpha >= 255 * MIN_ALPHA


def _unless_all(seen: Bool[np.ndarray, "h w"] | None) -> Bool[np.ndarray, "h w"] | None:
    return None if seen is None or seen.all() else seen


def _is_cmyk(data: bytes) -> bool:
    if data[:2] != _JPEG:
        return False
    with Image.open(io.BytesIO(data), formats=("JPEG",)) as image:
        return image.mode == "CMYK"


def _unturned(tags: ImageTags, name: str) -> Note:
    return Note(
        f"{name}: EXIF orientation {tags.exif.orientation}",
        "pixels are read as stored, which is what intrinsics and depth refer to",
        "rotate the images, and their intrinsics and poses, if the poses are for upright images",
    )


def _check_size(data: bytes, name: str) -> tuple[int, int]:
    """Read (width, height) from the header. Raises ImageError above `MAX_PIXELS` and the limits of JPEG and PNG."""
    read_size = exr_size if data[:4] == _EXR else heic_size if is_heic(data) else peek_size
    width, height = read_size(data, name)
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ImageError(f"{name}: its header says {width} x {height} pixels; up to {MAX_PIXELS} in all are read")
    return width, height


def peek_size(data: bytes, name: str) -> tuple[int, int]:
    """Read (width, height) from the header of a PNG, JPEG or HDR, without decoding pixels.

    Raises:
        ImageError: The header is damaged, the file is truncated, or it is of another format.
    """
    try:
        if data[:8] == _PNG:
            width, height = struct.unpack(">II", data[16:24])
            if check_png(data, name) is None:
                raise ImageError(f"{name}: the PNG ends before its end mark; the file is truncated")
            return width, height
        if data[:2] == _JPEG:
            check_jpeg(data, name)
            return _jpeg_size(data, name)
        if data[:2] == _HDR:
            return read_header(data, name).size
    except (struct.error, ValueError, IndexError) as error:
        raise ImageError(f"{name}: its header is damaged") from error
    raise ImageError(f"{name}: neither PNG, JPEG, EXR nor HDR (it starts with {data[:4].hex()})")


def _jpeg_size(data: bytes, name: str) -> tuple[int, int]:
    offset = 2
    for _ in range(MAX_JPEG_SEGMENTS):
        if data[offset] != 0xFF:
            raise ValueError("no marker")
        marker = data[offset + 1]
        if marker == 0xFF or 0xD0 <= marker <= 0xD8 or marker == 0x01:
            offset += 1 if marker == 0xFF else 2
            continue
        (length,) = struct.unpack(">H", data[offset + 2 : offset + 4])
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", data[offset + 5 : offset + 9])
            return width, height
        offset += 2 + length
    raise ImageError(f"{name}: the JPEG has more than {MAX_JPEG_SEGMENTS} segments before its size")


def _finite(image: Float[np.ndarray, "h w 3"], name: str) -> Float[np.ndarray, "h w 3"]:
    if image.size == 0:
        raise ImageError(f"{name}: the image has no pixels")
    return np.maximum(np.nan_to_num(image, copy=False, nan=0.0, posinf=65504.0, neginf=0.0), 0.0)
