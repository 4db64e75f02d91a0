"""Floods of `bench hostile` below HTTP: bytes that one connection sends, at full speed or at a fixed rate."""

import asyncio
import json
import struct
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np

SLOW_BYTES_PER_S: Final = 200_000
"""A fixed rate: what a phone's uplink sends."""
_TURN_S: Final = 0.02
_BLOCK: Final = 2**16

Connect = Callable[[], Awaitable[tuple[asyncio.StreamReader, asyncio.StreamWriter]]]
"""Opens a connection to the server."""


@dataclass(frozen=True)
class Flood:
    """What a connection sends.

    Attributes:
        head: Sent first; `{token}` is replaced.
        unit: Repeated until the server closes the connection; then a new one begins.
        websocket: The head is a handshake: its answer is read before the units are sent.
    """

    head: bytes
    unit: bytes
    websocket: bool = False


def _frame(opcode: int, data: bytes = b"") -> bytes:
    """Return a WebSocket frame of a client, with a mask of zeros."""
    return bytes([opcode, 0x80 | len(data)]) + bytes(4) + data


_GET: Final = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
_CHUNKED: Final = b"PUT /v1/sessions/a HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
_UPGRADE: Final = (
    b"GET /v1/sessions/flood/stream HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {token}\r\n"
    b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
    b"Sec-WebSocket-Version: 13\r\n\r\n"
)
FLOODS: Final[dict[str, Flood]] = {
    "pipelined-requests": Flood(b"", _GET + b"\r\n"),
    "tiny-headers": Flood(b"", _GET + b"a:\r\n" * 4000 + b"\r\n"),
    "tiny-chunks": Flood(_CHUNKED, b"1\r\nx\r\n"),
    "empty-fragments": Flood(_UPGRADE, _frame(0x00), websocket=True),
    "pings": Flood(_UPGRADE, _frame(0x89, bytes(125)), websocket=True),
}
"""The floods by name. Each is an attack twice: at full speed, and at `SLOW_BYTES_PER_S` with `-slow` at its end."""


async def flood(
    connect: Connect, name: str, *, token: str, bytes_per_s: float | None, count: Callable[[bytes], object]
) -> None:
    """Send a flood until it is cancelled; `count` gets the start of an answer, or nothing.

    Args:
        bytes_per_s: Rate; None: as fast as the server reads.
    """
    kind = FLOODS[name]
    while True:
        head = b""
        with suppress(OSError, asyncio.IncompleteReadError):
            reader, writer = await connect()
            try:
                writer.write(kind.head.replace(b"{token}", token.encode()))
                if kind.websocket:
                    head = await reader.readuntil(b"\r\n\r\n")
                    if kind.unit[0] == 0x00:
                        writer.write(_frame(0x02))
                count(head[:12])
                await _repeat(writer, kind.unit, bytes_per_s)
            finally:
                writer.transport.abort()
        await asyncio.sleep(0.01)


async def _repeat(writer: asyncio.StreamWriter, unit: bytes, bytes_per_s: float | None) -> None:
    """Write the unit until the connection is closed, without reading."""
    size = _BLOCK if bytes_per_s is None else int(bytes_per_s * _TURN_S)
    block = unit * max(1, size // len(unit))
    while not writer.is_closing():
        writer.write(block)
        await writer.drain()
        if bytes_per_s is not None:
            await asyncio.sleep(len(block) / bytes_per_s)


def interleaved_glb() -> bytes:
    """Return a GLB whose accessors, four a mesh, share one view with the largest stride that glTF allows."""
    stride, meshes = 252, 5
    count = 31 * 2**20 // stride // 3 * 3
    kinds = {"POSITION": "VEC3", "NORMAL": "VEC3", "TANGENT": "VEC4", "TEXCOORD_0": "VEC2"}
    view = {"bufferView": 0, "componentType": 5126, "count": count}
    content = np.zeros((count, stride // 4), "<f4")
    content[:] = np.random.default_rng(1).random((count, 1), np.float32)  # a normal must not be zero
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(meshes))}],
        "nodes": [{"mesh": number} for number in range(meshes)],
        "meshes": [
            {"primitives": [{"attributes": {name: 4 * mesh + place for place, name in enumerate(kinds)}}]}
            for mesh in range(meshes)
        ],
        "accessors": [{**view, "byteOffset": 16 * place, "type": kind} for place, kind in enumerate(kinds.values())]
        * meshes,
        "bufferViews": [{"buffer": 0, "byteLength": content.nbytes, "byteStride": stride}],
        "buffers": [{"byteLength": content.nbytes}],
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + content.nbytes
    parts = (b"glTF", struct.pack("<II", 2, total), struct.pack("<I4s", len(text), b"JSON"), text)
    return b"".join((*parts, struct.pack("<I4s", content.nbytes, b"BIN\0"), content.tobytes()))
