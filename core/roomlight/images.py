"""Image files in and out: JPEG, PNG, EXR and Radiance HDR, with sizes checked before pixels are decoded.

Colour comes in as linear RGB; depth as metres. Every failure is an `ImageError` that names the file.
"""

import os
import struct
import tempfile
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
from jaxtyping import Bool, Float, Shaped, UInt8

from roomlight.conventions import linear_to_srgb8, srgb8_to_linear
from roomlight.depth import clean_depth
from roomlight.errors import ImageError, OutputError
from roomlight.files import write_atomic
from roomlight.frame import CLIPPED_SRGB8

MAX_PIXELS = 64_000_000
"""Largest image decoded (8192 x 7812): phones give up to 48 megapixels; a header beyond this is a bomb."""


def read_bytes(path: Path) -> bytes:
    """The file's bytes; a missing, unreadable or empty file is an ImageError with its name."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ImageError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not data:
        raise ImageError(f"{path}: the file is empty")
    return data


def decode_colour(data: bytes, name: str) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Linear RGB float32 and the mask of clipped pixels, from the bytes of a JPEG, PNG, EXR or HDR file.

    8-bit files are sRGB-encoded and clip at `CLIPPED_SRGB8`; EXR and HDR are linear already and never clip.
    """
    if data[:4] == b"\x76\x2f\x31\x01":
        image = _decode_exr(data, name)
        return image, np.zeros(image.shape[:2], bool)
    if data[:2] == b"#?":
        encoded = _decode_with_opencv(data, name, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
        image = _finite(np.ascontiguousarray(encoded[..., ::-1], np.float32), name)
        return image, np.zeros(image.shape[:2], bool)
    encoded = _decode_with_opencv(data, name, cv2.IMREAD_COLOR)
    rgb = np.ascontiguousarray(encoded[..., ::-1])
    return srgb8_to_linear(rgb), np.max(rgb, axis=-1) >= CLIPPED_SRGB8


def read_colour(path: Path) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """`decode_colour` of a file."""
    return decode_colour(read_bytes(path), str(path))


def decode_depth(data: bytes, name: str, *, unit_m: float) -> Float[np.ndarray, "h w"]:
    """Depth in metres (0 = unknown) from a 16-bit PNG in units of `unit_m`, or a float EXR in metres."""
    if data[:4] == b"\x76\x2f\x31\x01":
        depth = _decode_exr(data, name)[..., 0]
        depth[depth >= 65504] = 0.0  # half's largest value and infinity both stand for "nothing hit"
    else:
        raw = _decode_with_opencv(data, name, cv2.IMREAD_UNCHANGED)
        if raw.ndim != 2 or raw.dtype != np.uint16:
            raise ImageError(f"{name}: depth must be a 16-bit grey PNG, this is {raw.dtype} with shape {raw.shape}")
        depth = raw.astype(np.float32) * np.float32(unit_m)
        depth[raw == 65535] = 0.0
    return clean_depth(depth)


def decode_grey8(data: bytes, name: str) -> UInt8[np.ndarray, "h w"]:
    """An 8-bit grey image as it is stored: masks and confidence levels."""
    raw = _decode_with_opencv(data, name, cv2.IMREAD_UNCHANGED)
    if raw.ndim != 2 or raw.dtype != np.uint8:
        raise ImageError(f"{name}: must be an 8-bit grey image, this is {raw.dtype} with shape {raw.shape}")
    return raw


def read_panorama(path: Path) -> Float[np.ndarray, "h w 3"]:
    """An equirectangular HDR panorama (EXR or HDR), float32 linear RGB, W = 2H."""
    image, _ = read_colour(path)
    if image.shape[1] != 2 * image.shape[0]:
        raise ImageError(f"{path}: a panorama is twice as wide as high, this is {image.shape[1]} x {image.shape[0]}")
    return image


def encode_exr(image: Float[np.ndarray, "h w 3"], *, metadata: dict[str, str] | None = None) -> bytes:
    """Linear RGB as the bytes of a half-float, ZIP-compressed EXR; the same image and metadata, the same bytes.

    Values beyond half's range are clipped to 65504, the largest half, so that no infinity reaches a renderer.
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
    """Write `encode_exr`'s bytes; whole or not at all (as `write_atomic`)."""
    write_atomic(path, encode_exr(image, metadata=metadata))


def encode_png(image: Shaped[np.ndarray, "h w *c"]) -> bytes:
    """The bytes of a PNG: uint8/uint16 as it is, or linear float RGB encoded as sRGB."""
    pixels = linear_to_srgb8(image) if np.issubdtype(image.dtype, np.floating) else image
    if pixels.ndim == 3:
        pixels = pixels[..., ::-1]
    ok, data = cv2.imencode(".png", np.ascontiguousarray(pixels))
    if not ok:
        raise OutputError(f"PNG encoding of {pixels.shape} {pixels.dtype} failed")
    return data.tobytes()


def write_png(path: Path, image: Shaped[np.ndarray, "h w *c"]) -> None:
    """Write `encode_png`'s bytes; whole or not at all."""
    write_atomic(path, encode_png(image))


def _decode_with_opencv(data: bytes, name: str, flags: int) -> Shaped[np.ndarray, "h w *c"]:
    width, height = peek_size(data, name)
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ImageError(f"{name}: its header says {width} x {height} pixels; up to {MAX_PIXELS} in all are read")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise ImageError(f"{name}: does not decode ({error.err})") from error
    if image is None:  # pyright: ignore[reportUnnecessaryComparison]  (OpenCV's own stub leaves the None out)
        raise ImageError(f"{name}: does not decode; the file is truncated or damaged")
    if image.shape[:2] not in ((height, width), (width, height)):  # EXIF may turn a JPEG
        raise ImageError(f"{name}: its header says {width} x {height} but {image.shape[1]} x {image.shape[0]} decoded")
    return image


def peek_size(data: bytes, name: str) -> tuple[int, int]:
    """(width, height) from the header of a PNG, JPEG or HDR, without decoding a pixel."""
    try:
        if data[:8] == b"\x89PNG\r\n\x1a\n":
            width, height = struct.unpack(">II", data[16:24])
            if data[-12:-4] != b"\x00\x00\x00\x00IEND":
                raise ImageError(f"{name}: the PNG ends before its end mark; the file is truncated")
            return width, height
        if data[:2] == b"\xff\xd8":
            if b"\xff\xd9" not in data[-64:]:
                raise ImageError(f"{name}: the JPEG ends before its end mark; the file is truncated")
            return _jpeg_size(data)
        if data[:2] == b"#?":
            line = data[data.index(b"\n\n") + 2 :].split(b"\n", 1)[0].split()
            return int(line[3]), int(line[1])
    except (struct.error, ValueError, IndexError) as error:
        raise ImageError(f"{name}: its header is damaged") from error
    raise ImageError(f"{name}: neither PNG, JPEG, EXR nor HDR (it starts with {data[:4].hex()})")


def _jpeg_size(data: bytes) -> tuple[int, int]:
    offset = 2
    while True:
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


def _exr_size(data: bytes, name: str) -> tuple[int, int]:
    at = data.find(b"dataWindow\x00box2i\x00", 0, 65536)
    if at < 0 or len(data) < at + 17 + 20:
        raise ImageError(f"{name}: the EXR header has no data window; the file is truncated or damaged")
    x0, y0, x1, y1 = struct.unpack("<iiii", data[at + 21 : at + 37])
    return x1 - x0 + 1, y1 - y0 + 1


def _decode_exr(data: bytes, name: str) -> Float[np.ndarray, "h w 3"]:
    """RGB (or a single channel thrice) of an EXR's bytes, float32, NaN and negative values set to 0."""
    width, height = _exr_size(data, name)
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ImageError(f"{name}: its header says {width} x {height} pixels; up to {MAX_PIXELS} in all are read")
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
