"""Limits on the structure of JPEG and PNG files, and the place of their end marks.

A decoder takes time for each scan of a progressive JPEG and each compressed text of a PNG, however small the file:
scans of 12 megapixels take 8 ms each, texts that expand to 8 MB 34 ms each. Phones append videos, depth maps and
private data to their photos; decoders ignore what follows the end mark, and so does RoomLight.
"""

import re
import struct
from typing import Final

from roomlight.errors import ImageError

MAX_JPEG_SCANS: Final = 64
"""Progressive files of cameras and editors have about 10."""
MAX_JPEG_SEGMENTS: Final = 4096
"""Metadata of 16 MB in segments of 64 kB takes 256."""
MAX_PNG_CHUNKS: Final = 20_000
"""libpng splits 16 MB of pixels into 2,000 chunks."""
MAX_PNG_COMPRESSED_CHUNKS: Final = 8
"""Chunks of compressed text or colour profiles."""

_MARKER: Final = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")
_START_OF_SCAN, _END = 0xDA, 0xD9
_COMPRESSED: Final = (b"zTXt", b"iTXt", b"iCCP")
_PIXELS: Final = (b"IHDR", b"PLTE", b"tRNS", b"acTL", b"fcTL", b"IDAT", b"fdAT", b"IEND")


def check_jpeg(data: bytes, name: str) -> int | None:
    """Check the number of segments and scans of a JPEG; returns the offset after its end mark, None without one.

    Raises:
        ImageError: There are too many; begins with `name`.
    """
    offset, segments, scans = 2, 0, 0
    while (match := _MARKER.search(data, offset)) is not None:
        marker, offset = data[match.start() + 1], match.end()
        if marker == _END:
            return offset
        segments += 1
        scans += marker == _START_OF_SCAN
        if scans > MAX_JPEG_SCANS:
            raise ImageError(f"{name}: the JPEG has more than {MAX_JPEG_SCANS} scans")
        if segments > MAX_JPEG_SEGMENTS:
            raise ImageError(f"{name}: the JPEG has more than {MAX_JPEG_SEGMENTS} segments")
        if marker not in (0x01, 0xD8) and offset + 2 <= len(data):
            offset += struct.unpack_from(">H", data, offset)[0]
    return None


def check_png(data: bytes, name: str) -> int | None:
    """Check the number of chunks of a PNG; returns the offset after its end mark, None without one.

    Raises:
        ImageError: There are too many; begins with `name`.
    """
    offset, chunks, compressed = 8, 0, 0
    while offset + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, offset)
        chunks += 1
        compressed += kind in _COMPRESSED
        if chunks > MAX_PNG_CHUNKS:
            raise ImageError(f"{name}: the PNG has more than {MAX_PNG_CHUNKS} chunks")
        if compressed > MAX_PNG_COMPRESSED_CHUNKS:
            raise ImageError(f"{name}: the PNG has more than {MAX_PNG_COMPRESSED_CHUNKS} compressed texts and profiles")
        offset += 12 + length
        if kind == b"IEND":
            return offset if offset <= len(data) else None
    return None


def png_of_pixels(data: bytes) -> bytes:
    """Return a PNG without the chunks that hold no pixels; other files, and PNGs without an end, as they are.

    libpng prints what is wrong with such chunks on standard error, without the file's name.
    """
    offset, parts = 8, [data[:8]]
    while data[:4] == b"\x89PNG" and offset + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, offset)
        if kind in _PIXELS:
            parts.append(data[offset : offset + 12 + length])
        offset += 12 + length
        if kind == b"IEND":
            return b"".join(parts)
    return data
