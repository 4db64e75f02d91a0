"""Cube maps and panoramas of half floats as KTX 2.0 files: VK_FORMAT_R16G16B16A16_SFLOAT, levels uncompressed.

Layout (KTX 2.0 specification, little endian): identifier, header, index, level index (largest level first), data
format descriptor, key/value data, then the levels, the smallest first, each at a multiple of 8 bytes. Orientation is
`rd`: rows go down, as in OpenGL's cube table.

three.js: `KTX2Loader` (to r187) supports cubes of compressed formats only and reads this file as a flat texture.
`parseCube` (`client/js/src/cube.ts`) reads it, and `environmentTexture` (`three.ts`) makes a `CubeTexture` of it.
"""

import struct
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float, Float16

from roomlight import __version__

LARGEST_HALF: Final = 65504.0
_IDENTIFIER: Final = b"\xabKTX 20\xbb\r\n\x1a\n"
_R16G16B16A16_SFLOAT: Final = 97
_HEADER_BYTES: Final = 80
_TEXEL_BYTES: Final = 8


def encode_ktx2(
    levels: Sequence[Float16[np.ndarray, "6 _ _ 4"]], *, metadata: Mapping[str, str] | None = None
) -> bytes:
    """Encode RGBA levels [6, s, s, 4], each half as wide as the one before it: linear BT.709, straight alpha.

    `metadata`: further keys and texts (keys that begin with KTX are reserved by the standard).

    Raises:
        ValueError: there is no level, or the widths do not halve.
    """
    sizes = [level.shape[1] for level in levels]
    if not levels or any(b != max(1, a // 2) or a == 1 for a, b in pairwise(sizes)):
        raise ValueError(f"a KTX2 file holds one level or more, each half as wide as the last, got widths {sizes}")
    if any(level.shape != (6, size, size, 4) for level, size in zip(levels, sizes, strict=True)):
        raise ValueError(f"a level has shape (6, s, s, 4), got {[level.shape for level in levels]}")
    return _encode(levels, {**(metadata or {}), "KTXorientation": "rd"})


def panorama_ktx2(panorama: Float[np.ndarray, "h w 3"]) -> bytes:
    """Encode a panorama, linear RGB [H, 2H, 3], its lowest row first; alpha is 1, radiance is clipped to 65504."""
    image = np.ones((1, *panorama.shape[:2], 4), np.float16)
    image[0, ..., :3] = np.clip(panorama[::-1], -LARGEST_HALF, LARGEST_HALF)
    return _encode([image], {"KTXorientation": "ru"})


def _encode(levels: Sequence[Float16[np.ndarray, "f _ _ 4"]], texts: dict[str, str]) -> bytes:
    """Return the file of levels [faces, rows, columns, 4]."""
    faces, rows, columns, _ = levels[0].shape
    descriptor = _descriptor()
    pairs = _key_values({**texts, "KTXwriter": f"RoomLight {__version__}"})
    descriptor_at = _HEADER_BYTES + 24 * len(levels)
    pairs_at = descriptor_at + len(descriptor)
    at = pairs_at + len(pairs)
    body = b""
    index: list[bytes] = []
    for level in reversed(levels):
        data = level.astype("<f2").tobytes()
        body += bytes(-(at + len(body)) % _TEXEL_BYTES)
        index.insert(0, struct.pack("<QQQ", at + len(body), len(data), len(data)))
        body += data
    header = struct.pack(
        "<12s9I4I2Q",
        _IDENTIFIER,
        _R16G16B16A16_SFLOAT,
        2,  # bytes of a channel, for byte swapping
        columns,
        rows,
        0,  # depth: not a volume
        0,  # layers: not an array
        faces,
        len(levels),
        0,  # no supercompression
        descriptor_at,
        len(descriptor),
        pairs_at,
        len(pairs),
        0,
        0,
    )
    return header + b"".join(index) + descriptor + pairs + body


def _descriptor() -> bytes:
    """Return the Khronos data format descriptor: linear BT.709 RGBA, signed 16-bit floats."""
    block = struct.pack(
        "<IHH4B4B8B",
        0,  # Khronos, basic format
        2,  # version 1.3 of the descriptor
        24 + 4 * 16,
        *(1, 1, 1, 0),  # RGB samples, BT.709 primaries, linear, straight alpha
        *(0, 0, 0, 0),  # blocks of one texel
        *(_TEXEL_BYTES, 0, 0, 0, 0, 0, 0, 0),
    )
    for place, channel in enumerate((0, 1, 2, 15)):  # R, G, B, alpha
        signed_float = 0x80 | 0x40
        block += struct.pack("<HBBIff", 16 * place, 15, signed_float | channel, 0, -1.0, 1.0)
    return struct.pack("<I", 4 + len(block)) + block


def _key_values(pairs: Mapping[str, str]) -> bytes:
    data = b""
    for key in sorted(pairs, key=str.encode):
        entry = key.encode() + b"\0" + pairs[key].encode() + b"\0"
        data += struct.pack("<I", len(entry)) + entry + bytes(-len(entry) % 4)
    return data
