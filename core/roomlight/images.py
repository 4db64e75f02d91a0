"""Read and write image files: JPEG, PNG, EXR and Radiance HDR. Sizes are checked before pixels are decoded.

Colour is decoded to linear RGB, depth to metres. Every failure is an `ImageError` that names the file.

Sizes are read by hand and EXIF by Pillow. Pillow reads no HDR and no EXR; of PNG and JPEG it reads the size, but takes
16 and 34 us instead of 0.4 and 10, on every frame of a stream, and keeps each segment of a JPEG in memory: 8 MB of
empty segments take 4 s and 270 MB, where `peek_size` stops at the limit of `image_limits`. EXIF is read from a user's
own photos only.
"""

import io
import math
import os
import struct
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import OpenEXR
from jaxtyping import Bool, Float, Shaped, UInt8
from PIL import ExifTags, Image

from roomlight.conventions import linear_to_srgb8, srgb8_to_linear
from roomlight.depth import clean_depth
from roomlight.errors import ImageError, OutputError
from roomlight.files import write_atomic
from roomlight.frame import CLIPPED_SRGB8
from roomlight.image_limits import MAX_JPEG_SEGMENTS, check_jpeg, check_png

MAX_PIXELS: Final = 64_000_000
"""Largest image decoded (8192 x 7812). Phones take up to 48 megapixels; a larger header is a decompression bomb."""

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8"
_HDR: Final = b"#?"
_EXR: Final = b"\x76\x2f\x31\x01"
_FILM_DIAGONAL_MM: Final = math.hypot(36, 24)


@dataclass(frozen=True)
class ExifCamera:
    """What a photo's EXIF states about its camera.

    Attributes:
        focal_35mm: Focal length in millimetres, equivalent on 36 x 24 mm film; None if not stated.
        orientation: EXIF's orientation tag, 1 to 8. 1 is upright, 3 upside down; the stored pixels must be rotated
            by 90 degrees clockwise for 6 and counter-clockwise for 8; 2, 4, 5 and 7 are mirrored.
    """

    focal_35mm: float | None = None
    orientation: int = 1

    def fov_deg(self, width: int, height: int) -> float | None:
        """Return the horizontal field of view in degrees of an image of this size in pixels; None if not stated.

        The equivalence is by the diagonal, as the camera industry's CIPA DCG-001 defines it.
        """
        if self.focal_35mm is None:
            return None
        focal_px = self.focal_35mm * math.hypot(width, height) / _FILM_DIAGONAL_MM
        return math.degrees(2 * math.atan(width / (2 * focal_px)))


def exif_camera(data: bytes, name: str) -> ExifCamera:
    """Read the focal length and the orientation from a photo's EXIF.

    Missing or damaged EXIF gives the defaults: it describes the photo and is not needed to decode it.

    Raises:
        ImageError: The header is damaged, or declares more than `MAX_PIXELS`.
    """
    if data[:8] != _PNG and data[:2] != _JPEG:
        return ExifCamera()
    _check_size(data, name)
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as image:
            exif = image.getexif()
            orientation = exif.get(ExifTags.Base.Orientation)
            focal = exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLengthIn35mmFilm)
    except Exception:  # Pillow raises whatever the damaged bytes lead to: SyntaxError, struct.error, KeyError, ...
        return ExifCamera()
    return ExifCamera(
        focal_35mm=float(focal) if isinstance(focal, int) and focal > 0 else None,  # 0 is EXIF's "unknown"
        orientation=orientation if isinstance(orientation, int) and 1 <= orientation <= 8 else 1,
    )


def read_bytes(path: Path) -> bytes:
    """Read a file. Raises ImageError if it is missing, unreadable or empty."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ImageError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not data:
        raise ImageError(f"{path}: the file is empty")
    return data


def decode_colour(
    data: bytes, name: str, *, as_stored: bool = False
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Decode a JPEG, PNG, EXR or HDR file to linear RGB float32 and the mask of clipped pixels.

    8-bit files are sRGB-encoded, clip at `CLIPPED_SRGB8`, and are rotated by their EXIF orientation unless `as_stored`;
    EXR and HDR are linear and never clip.

    Raises:
        ImageError: The data does not decode, or its header declares more than `MAX_PIXELS`; begins with `name`.
    """
    if data[:4] == _EXR:
        image = _decode_exr(data, name)
        return image, np.zeros(image.shape[:2], bool)
    if data[:2] == _HDR:
        encoded = _decode_with_opencv(data, name, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
        image = _finite(np.ascontiguousarray(encoded[..., ::-1], np.float32), name)
        return image, np.zeros(image.shape[:2], bool)
    orientation = cv2.IMREAD_IGNORE_ORIENTATION if as_stored else 0
    encoded = _decode_with_opencv(data, name, cv2.IMREAD_COLOR | orientation)
    rgb = np.ascontiguousarray(encoded[..., ::-1])
    return srgb8_to_linear(rgb), np.max(rgb, axis=-1) >= CLIPPED_SRGB8


def read_colour(path: Path) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Read a file and decode it with `decode_colour`. Raises ImageError."""
    return decode_colour(read_bytes(path), str(path))


def decode_depth(data: bytes, name: str, *, unit_m: float) -> Float[np.ndarray, "h w"]:
    """Decode depth in metres (0 = unknown) from a 16-bit PNG in units of `unit_m`, or a float EXR in metres.

    Raises:
        ImageError: The data does not decode or is not a depth map; the message begins with `name`.
    """
    if data[:4] == _EXR:
        depth = _decode_exr(data, name)[..., 0]
        depth[depth >= 65504] = 0.0  # half's largest value and infinity both mean that nothing was hit
    else:
        raw = _decode_with_opencv(data, name, cv2.IMREAD_UNCHANGED)
        if raw.ndim != 2 or raw.dtype != np.uint16:
            raise ImageError(f"{name}: depth must be a 16-bit grey PNG, this is {raw.dtype} with shape {raw.shape}")
        depth = raw.astype(np.float32) * np.float32(unit_m)
        depth[raw == 65535] = 0.0
    return clean_depth(depth)


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


def encode_exr(image: Float[np.ndarray, "h w 3"], *, metadata: dict[str, str] | None = None) -> bytes:
    """Encode linear RGB as a half-float, ZIP-compressed EXR; the same image and metadata give the same bytes.

    Values beyond half's range are clipped to 65504, the largest half, so that no infinity reaches a renderer.

    Raises:
        OutputError: The image cannot be encoded.
    """
    half = np.clip(image, -65504, 65504).astype(np.float16)
    header: dict[str, object] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header.update(metadata or {})
    try:
        with tempfile.TemporaryDirectory() as folder:  # the library writes into memory from 3.5 on only
            path = Path(folder) / "image.exr"
            OpenEXR.File(header, {"RGB": np.ascontiguousarray(half)}).write(str(path))
            return path.read_bytes()
    except (OSError, RuntimeError) as error:
        raise OutputError(f"an EXR of {image.shape[1]} x {image.shape[0]} cannot be encoded ({error})") from error


def write_exr(path: Path, image: Float[np.ndarray, "h w 3"], *, metadata: dict[str, str] | None = None) -> None:
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
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise ImageError(f"{name}: does not decode ({error.err})") from error
    if image is None:  # pyright: ignore[reportUnnecessaryComparison]  (OpenCV's own stub leaves the None out)
        raise ImageError(f"{name}: does not decode; the file is truncated or damaged")
    if image.shape[:2] not in ((height, width), (width, height)):  # EXIF may rotate it by 90 degrees
        raise ImageError(f"{name}: its header says {width} x {height} but {image.shape[1]} x {image.shape[0]} decoded")
    return image


def _check_size(data: bytes, name: str) -> tuple[int, int]:
    """Read (width, height) from the header. Raises ImageError above `MAX_PIXELS` and beyond `image_limits`."""
    if data[:8] == _PNG:
        check_png(data, name)
    elif data[:2] == _JPEG:
        check_jpeg(data, name)
    width, height = _exr_size(data, name) if data[:4] == _EXR else peek_size(data, name)
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
            if data[-12:-4] != b"\x00\x00\x00\x00IEND":
                raise ImageError(f"{name}: the PNG ends before its end mark; the file is truncated")
            return width, height
        if data[:2] == _JPEG:
            if b"\xff\xd9" not in data[-64:]:
                raise ImageError(f"{name}: the JPEG ends before its end mark; the file is truncated")
            return _jpeg_size(data, name)
        if data[:2] == _HDR:
            line = data[data.index(b"\n\n") + 2 :].split(b"\n", 1)[0].split()
            return int(line[3]), int(line[1])
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


def _exr_size(data: bytes, name: str) -> tuple[int, int]:
    at = data.find(b"dataWindow\x00box2i\x00", 0, 65536)
    if at < 0 or len(data) < at + 17 + 20:
        raise ImageError(f"{name}: the EXR header has no data window; the file is truncated or damaged")
    x0, y0, x1, y1 = struct.unpack("<iiii", data[at + 21 : at + 37])
    return x1 - x0 + 1, y1 - y0 + 1


def _decode_exr(data: bytes, name: str) -> Float[np.ndarray, "h w 3"]:
    """Decode an EXR to RGB float32 (a single channel is repeated); NaN and negative values become 0."""
    width, height = _check_size(data, name)
    path = Path(name)
    own_copy = None
    if not path.is_file() or path.stat().st_size != len(data):  # bytes from an archive or the network
        handle, own_name = tempfile.mkstemp(suffix=".exr")
        os.close(handle)
        own_copy = path = Path(own_name)
        own_copy.write_bytes(data)
    try:
        with OpenEXR.File(str(path)) as file:
            channels = {key: np.asarray(channel.pixels) for key, channel in file.channels().items()}
    except Exception as error:  # the binding raises bare RuntimeError, ValueError or Iex's own by version
        raise ImageError(f"{name}: the EXR does not decode ({error})") from error
    finally:
        if own_copy is not None:
            own_copy.unlink(missing_ok=True)
    if any(pixels.shape[:2] != (height, width) or pixels.dtype.kind not in "fu" for pixels in channels.values()):
        raise ImageError(f"{name}: the EXR is deep, subsampled or damaged; plain half or float channels are read")
    for key in ("RGB", "RGBA"):
        if key in channels:
            return _finite(np.ascontiguousarray(channels[key][..., :3], np.float32), name)
    if {"R", "G", "B"} <= channels.keys():
        return _finite(np.stack([channels[key] for key in "RGB"], axis=-1).astype(np.float32), name)
    if len(channels) >= 1:
        only = channels.get("Y", channels.get("Z", channels.get("R", next(iter(channels.values())))))
        return _finite(np.repeat(only[..., None], 3, axis=-1).astype(np.float32), name)
    raise ImageError(f"{name}: the EXR has no channel")


def _finite(image: Float[np.ndarray, "h w 3"], name: str) -> Float[np.ndarray, "h w 3"]:
    if image.size == 0:
        raise ImageError(f"{name}: the image has no pixels")
    return np.maximum(np.nan_to_num(image, copy=False, nan=0.0, posinf=65504.0, neginf=0.0), 0.0)
