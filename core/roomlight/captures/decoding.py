"""Depth, confidence and pinhole parameters as the phone and robot formats store them. Metres and pixels."""

import io
import re
from dataclasses import replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Shaped, UInt8
from PIL import Image, UnidentifiedImageError

from roomlight.camera import Intrinsics
from roomlight.captures.source import Source
from roomlight.depth import clean_depth
from roomlight.errors import ImageError
from roomlight.files import FolderSource
from roomlight.images import MAX_PIXELS, MIN_ALPHA, ColourImage, decode_depth, decode_grey8, decode_picture, peek_size
from roomlight.imaging.other_formats import as_png
from roomlight.notes import Note

DEPTH_SUFFIXES: Final = (".png", ".exr", ".npy", ".tif", ".tiff")
_TIFF: Final = (b"II*\0", b"MM\0*")
_NPZ: Final = b"PK\x03\x04"
_COLMAP: Final = re.compile(rb"(\d{1,5})&(\d{1,5})&1&")
"""Width, height and channels at the start of a COLMAP map; rows of float32 follow."""
_GAP: Final = rb"(?:\s|#[^\n]*\n)+"
_PGM: Final = re.compile(_GAP.join([b"P5", *[rb"(\d{1,5})"] * 3]) + rb"[ \t\n]")
"""Width, height and largest value at the start of a PGM; of 16 bits, rows with the high byte first follow."""


def read_rgbd(
    source: FolderSource,
    colour_name: str,
    depth_name: str | None,
    *,
    unit_m: float | None,
    integer_m: float = 0.001,
    pictures: FolderSource | None = None,
) -> tuple[ColourImage, Float[np.ndarray, "dh dw"]]:
    """Read one record's picture, as stored, and its depth in metres; units as `decode_depth_map` takes them.

    Without a file of depth (None) no pixel's depth is known. Pictures may have a folder of their own.
    """
    picture = read_picture(pictures or source, colour_name)
    if depth_name is None:
        if picture.own_depth is not None:
            left_out = f"{(pictures or source).label(colour_name)}: the depth that the picture holds"
            advice = "name an EXR as the frame's depth file too, save a HEIC's depth as a file"
            note = Note(left_out, "it is not read", advice)
            picture = replace(picture, notes=(*picture.notes, note))
        return picture, np.zeros(picture.image.shape[:2], np.float32)
    depth = source.read(depth_name)
    return picture, decode_depth_map(depth, source.label(depth_name), unit_m=unit_m, integer_m=integer_m)


def read_picture(source: Source, name: str) -> ColourImage:
    """Read a picture with its pixels as stored: intrinsics, depth and masks refer to them."""
    data = as_png(source.read(name), source.label(name), max_pixels=MAX_PIXELS)
    return decode_picture(data, source.label(name), as_stored=True)


def read_mask(source: Source, name: str) -> Bool[np.ndarray, "h w"]:
    """Read a mask: pixels of 0, or transparent ones where alpha varies, are not seen. Raises FrameError, ImageError."""
    data = source.read(name)
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if peek_size(data, name) else None
    if decoded is None:
        raise ImageError(f"{source.label(name)}: the mask does not decode")
    mask = np.asarray(decoded)
    if mask.ndim == 2:
        return mask > 0
    shown = mask[..., :3].max(axis=-1) > 0
    if mask.shape[2] < 4 or mask[..., 3].min() == mask[..., 3].max():
        return shown
    opaque = mask[..., 3] >= int(mask[..., 3].max()) * MIN_ALPHA
    return opaque & shown if shown[opaque].any() else opaque


def with_mask(picture: ColourImage, mask: Bool[np.ndarray, "mh mw"]) -> ColourImage:
    """Return the picture without the pixels where a mask of any size is False."""
    height, width = picture.image.shape[:2]
    seen = cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST_EXACT) > 0
    return replace(picture, seen=seen if picture.seen is None else seen & picture.seen)


def decode_depth_map(
    data: bytes, label: str, *, unit_m: float | None, integer_m: float = 0.001
) -> Float[np.ndarray, "h w"]:
    """Decode depth in metres (0 = unknown) from a 16-bit PNG or PGM, a grey TIFF, .npy, EXR or map of COLMAP.

    Args:
        data: The file.
        label: The file in messages.
        unit_m: Metres of one stored unit in files of every kind, as the user or the index states it; None: integers
            are in `integer_m`, floats in metres.
        integer_m: Metres of one unit of integers that nobody states.

    Raises:
        ImageError: The data is damaged, too large or no depth map; the message begins with `label`.
    """
    if match := _COLMAP.match(data):
        depth = _raw_values(data, label, match, "<f4")
    elif match := _PGM.match(data):
        if not 256 <= int(match[3]) <= 65535:
            text = f"depth of a PGM needs 16 bits, a largest value of 256 to 65535; this has {int(match[3])}"
            raise ImageError(f"{label}: {text}; save it as a 16-bit PNG")
        depth = _raw_values(data, label, match, ">u2")
    elif data[:4] in _TIFF:
        depth = _tiff_values(data, label)
    elif data[:6] == b"\x93NUMPY":
        depth = _npy_values(data, label)
    elif data[:4] == _NPZ:
        raise ImageError(f"{label}: an .npz holds several arrays; save the depth alone as .npy")
    else:
        return decode_depth(data, label, unit_m=unit_m, integer_m=integer_m)
    default_m = 1.0 if depth.dtype.kind == "f" else integer_m
    with np.errstate(over="ignore", invalid="ignore"):
        metres = (depth.astype(np.float64) * (default_m if unit_m is None else unit_m)).astype(np.float32)
    if depth.dtype.kind != "f":
        metres[depth == 65535] = 0.0
    return clean_depth(metres)


def _raw_values(data: bytes, label: str, header: re.Match[bytes], kind: str) -> Shaped[np.ndarray, "h w"]:
    """Return the values behind a header of width and height; a line's end may follow them. Raises ImageError."""
    width, height = int(header[1]), int(header[2])
    end = header.end() + int(kind[2]) * width * height
    if not 0 < width * height <= MAX_PIXELS or len(data) < end or data[end:].strip():
        raise ImageError(f"{label}: a map of {width} x {height} does not have {len(data)} bytes")
    return np.frombuffer(data, kind, width * height, header.end()).reshape(height, width)


def _tiff_values(data: bytes, label: str) -> Shaped[np.ndarray, "h w"]:
    """Return the stored values of a TIFF of one channel. Raises ImageError."""
    try:
        with Image.open(io.BytesIO(data), formats=("TIFF",)) as image:
            pictures = getattr(image, "n_frames", 1)
            if image.mode in ("I;16", "I;16B", "F") and image.width * image.height <= MAX_PIXELS and pictures == 1:
                return np.asarray(image)
            what = f"is {image.width} x {image.height} of the kind {image.mode}"
            what = f"holds {pictures} pictures" if pictures != 1 else what
    except Exception as error:  # Pillow raises whatever the damaged bytes lead to
        what = f"does not decode ({'of an unknown layout' if isinstance(error, UnidentifiedImageError) else error})"
    kinds = "16 bits or floats of 32 bits"
    raise ImageError(f"{label}: depth must be a grey TIFF of {kinds}, this {what}; convert it to .npy or EXR")


def _npy_values(data: bytes, label: str) -> Shaped[np.ndarray, "h w"]:
    """Return the stored values of a .npy. Raises ImageError."""
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream, max_header_size=4096)
        size = [length for length in shape if length != 1] if len(shape) > 2 else list(shape)
        if len(size) != 2 or dtype.kind not in "uif" or not 0 < size[0] * size[1] <= MAX_PIXELS:
            raise ImageError(f"{label}: depth must be an array [h, w] of numbers, this is {dtype} {shape}")
        stream.seek(0)
        return np.load(stream, allow_pickle=False).reshape(size)
    except (ValueError, EOFError, SyntaxError, OSError, TypeError) as error:
        raise ImageError(f"{label}: the .npy file is damaged ({error})") from error


def decode_confidence(data: bytes, label: str) -> UInt8[np.ndarray, "h w"]:
    """Decode confidence levels from an 8-bit grey PNG; 0, 54 or 127, and 255 become 0, 1 and 2. Raises ImageError.

    54 is 127 in linear light, as Polycam stores it.
    """
    levels = decode_grey8(data, label)
    spread = levels.max(initial=0) > 2 and bool(np.isin(levels, (0, 54, 55, 127, 128, 254, 255)).all())
    return np.digitize(levels, [1, 200]).astype(np.uint8) if spread else levels


def intrinsics_without_size(
    matrix: Float[np.ndarray, "3 3"], *, width: int, height: int, shift: float = 0.0
) -> Intrinsics:
    """Build intrinsics from a K that is stored without an image size, for an image of this size.

    Args:
        matrix: K, in pixels.
        width: The image's width in pixels.
        height: The image's height in pixels.
        shift: Added to the principal point: 0.5 for a K with pixel centres at whole numbers (OpenCV).

    Raises:
        ValueError: The principal point is far from the image's centre, so K is for another size.
    """
    cx, cy = float(matrix[0, 2]) + shift, float(matrix[1, 2]) + shift
    if not (width <= 3 * cx <= 2 * width and height <= 3 * cy <= 2 * height):
        raise ValueError(
            f"the image is {width} x {height} but its principal point would be ({cx:g}, {cy:g}): "
            "the intrinsics are for another size; scale fx and cx with the width, fy and cy with the height, "
            "or give the pictures that they are for"
        )
    return Intrinsics(float(matrix[0, 0]), float(matrix[1, 1]), cx, cy, width, height)


def registered(
    depth_m: Float[np.ndarray, "h w"],
    depth_camera: Intrinsics,
    colour_camera: Intrinsics,
    depth_to_colour: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "dh dw"]:
    """Project depth into the colour camera's view; both cameras have OpenCV axes.

    The result has four fifths of the depth map's resolution, so that few pixels stay empty; of several points in a
    pixel the nearest is kept.
    """
    height, width = depth_m.shape
    near = depth_camera.resized(width, height)
    columns = max(2, round(0.8 * colour_camera.width * near.fx / colour_camera.fx))
    size = columns, max(2, round(columns * colour_camera.height / colour_camera.width))
    camera = colour_camera.resized(*size)
    flip = np.array([1.0, -1.0, -1.0])
    points = (near.rays() * flip * depth_m[..., None])[depth_m > 0] @ depth_to_colour[:3, :3].T + depth_to_colour[:3, 3]
    xy, z = camera.project(points * flip)
    inside = (z > 0) & (xy >= 0).all(axis=-1) & (xy < size).all(axis=-1)
    column, row = np.floor(xy[inside]).astype(np.int64).T
    result = np.full((size[1], size[0]), np.inf, np.float32)
    np.minimum.at(result, (row, column), z[inside].astype(np.float32))
    return np.where(np.isfinite(result), result, np.float32(0))
