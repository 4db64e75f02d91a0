"""ScanNet++'s `depth.bin`: depth maps of 256 x 192 in one file.

It is one deflate stream of float32 metres, or a map after the other, each after its length (uint32): an LZ4 block of
uint16 millimetres, or deflate of float32 metres.
"""

import struct
import zlib
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

SHAPE: Final = (192, 256)
_VALUES: Final = SHAPE[0] * SHAPE[1]


class DepthMaps:
    """The maps of `depth.bin` by number."""

    def __init__(self, path: Path) -> None:
        """Find where each map lies. Raises OSError."""
        self._path = path
        self._spans = _spans(path)
        self._stream: _Stream | None = None

    def read(self, number: int) -> tuple[Float[np.ndarray, " n"], float]:
        """Return a map as stored, 0 where unknown, and the metres of its unit. Raises ValueError and OSError."""
        if self._spans:
            if number >= len(self._spans):
                raise ValueError(f"there are {len(self._spans)} maps")
            at, length = self._spans[number]
            with self._path.open("rb") as file:
                file.seek(at)
                return _map_of(file.read(length))
        if self._stream is None or self._stream.next > number:
            self._stream = _Stream(self._path.read_bytes())
        while self._stream.next < number:
            self._stream.read()
        return self._stream.read(), 1.0


class _Stream:
    """Maps of one deflate stream, in order."""

    def __init__(self, data: bytes) -> None:
        self._unpacking, self._rest = zlib.decompressobj(-zlib.MAX_WBITS), data
        self.next = 0

    def read(self) -> Float[np.ndarray, " n"]:
        values = b""
        try:
            while len(values) < 4 * _VALUES:
                piece = self._unpacking.decompress(self._rest, 4 * _VALUES - len(values))
                self._rest = self._unpacking.unconsumed_tail
                if not piece:
                    raise ValueError(f"the depth ends before map {self.next}")
                values += piece
        except zlib.error as error:
            raise ValueError(f"the depth does not unpack ({error})") from error
        self.next += 1
        return np.frombuffer(values, "<f4").astype(np.float32)


def _spans(path: Path) -> list[tuple[int, int]]:
    """Return where each whole map lies; none if the file is one stream, whose first bytes are no such length."""
    spans: list[tuple[int, int]] = []
    at, size = 0, path.stat().st_size
    with path.open("rb") as file:
        while at + 4 <= size:
            file.seek(at)
            (length,) = struct.unpack("<I", file.read(4))
            if not 0 < length <= 8 * _VALUES or at + 4 + length > size:
                break
            spans.append((at + 4, length))
            at += 4 + length
    return spans


def _map_of(data: bytes) -> tuple[Float[np.ndarray, " n"], float]:
    try:
        stored = np.frombuffer(lz4_block(data, 2 * _VALUES), "<u2")
    except (ValueError, IndexError):
        return _Stream(data).read(), 1.0
    return np.where(stored == 65535, 0, stored).astype(np.float32), 0.001


def lz4_block(data: bytes, size: int) -> bytes:
    """Decompress an LZ4 block of a known size (the LZ4 block format, version 1.6).

    Raises:
        ValueError: The data is damaged, or of another size.
        IndexError: The data ends early.
    """
    out, at = bytearray(), 0

    def length_of(nibble: int) -> int:
        nonlocal at
        if nibble == 15:
            while True:
                nibble += data[at]
                at += 1
                if data[at - 1] != 255:
                    break
        return nibble

    while at < len(data) and len(out) <= size:
        token = data[at]
        at += 1
        literals = length_of(token >> 4)
        out += data[at : at + literals]
        at += literals
        if at >= len(data):
            break
        back = data[at] | data[at + 1] << 8
        at += 2
        length = length_of(token & 15) + 4
        if not 0 < back <= len(out) or len(out) + length > size:
            raise ValueError("the LZ4 block points outside its values")
        tail = bytes(out[len(out) - back :])
        out += (tail * (length // back + 1))[:length]
    if len(out) != size:
        raise ValueError(f"the LZ4 block holds another size than {size} bytes")
    return bytes(out)
