"""The file of a saved state: records of JSON and bytes, each with a checksum.

    bytes  content
    8      "RLSTATE3", the format and its version
    ...    records
    48     the last record, with the tag "DONE" and no content

A record:

    bytes  content
    4      tag
    8      length n of the content, unsigned, little-endian
    32     SHA-256 of tag, length and content
    n      4 bytes: length m of the JSON; m bytes: the JSON, an object; the data

A file without its last record is truncated. Bytes after it are refused too.
"""

import hashlib
import json
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import zstandard

from roomlight.engine.models.interface import Arrays
from roomlight.errors import StateError

FORMAT: Final = 3
"""Version of the format and of what the records mean. Files of other versions are refused."""
_NAME: Final = b"RLSTATE"
_HEAD: Final = struct.Struct("<4sQ")
_JSON: Final = struct.Struct("<I")
_DIGEST_BYTES: Final = 32
_END: Final = "DONE"
_TYPES: Final = ("float32", "float64", "int64", "bool", "uint8")
_ZSTD_LEVEL: Final = 1
"""Higher levels and byte shuffling make the volume no smaller, and take up to ten times as long."""


@dataclass(frozen=True)
class Record:
    """A record: its tag of 4 letters, JSON values, and bytes."""

    tag: str
    values: dict[str, Any] = field(default_factory=dict[str, Any])
    data: bytes = b""


def pack_records(records: Iterable[Record]) -> bytes:
    """Return the bytes of a file."""
    parts = [_NAME + str(FORMAT).encode()]
    for record in (*records, Record(_END)):
        text = json.dumps(record.values).encode() if record.tag != _END else b""
        content = b"" if record.tag == _END else _JSON.pack(len(text)) + text + record.data
        head = _HEAD.pack(record.tag.encode(), len(content))
        parts += [head, hashlib.sha256(head + content).digest(), content]
    return b"".join(parts)


def unpack_records(file: bytes, source: str) -> list[Record]:
    """Return the records of a file.

    Args:
        file: The bytes of the file.
        source: Name of the file in messages.

    Raises:
        StateError: The file is no saved state, has another version, or is damaged.
    """
    start = len(_NAME) + len(str(FORMAT))
    if file[: len(_NAME)] != _NAME:
        raise StateError(f"{source}: is not a saved state (its first bytes are {file[:8].hex() or 'missing'})")
    version = file[len(_NAME) : start]
    if version != str(FORMAT).encode():
        version_text = version.decode("ascii", "replace")
        raise StateError(f"{source}: is a saved state of version {version_text!r}; this release reads version {FORMAT}")
    records: list[Record] = []
    while True:
        tag, content, stop = _content(file, start, source)
        if tag == _END:
            break
        records.append(_record(tag, content, source))
        start = stop
    if stop != len(file):
        raise StateError(f"{source}: {len(file) - stop} bytes follow the end of the saved state")
    return records


def read_first_records(path: Path, count: int) -> list[Record]:
    """Read and check the first records of a file, without the rest of it.

    Raises:
        OSError: The file cannot be read.
        StateError: The file is no saved state, has another version, or these records are damaged.
    """
    source, name = str(path), _NAME + str(FORMAT).encode()
    records: list[Record] = []
    with path.open("rb") as file:
        if file.read(len(name)) != name:
            raise StateError(f"{source}: is not a saved state of version {FORMAT}")
        for _ in range(count):
            head = file.read(_HEAD.size + _DIGEST_BYTES)
            length = _HEAD.unpack(head[: _HEAD.size])[1] if len(head) == _HEAD.size + _DIGEST_BYTES else 0
            data = head + file.read(min(length, path.stat().st_size))
            tag, content, _ = _content(data, 0, source)
            records.append(_record(tag, content, source))
    return records


def _content(file: bytes, start: int, source: str) -> tuple[str, memoryview, int]:
    """Return tag and checked content of the record at `start`, and where the next one starts."""
    data = start + _HEAD.size + _DIGEST_BYTES
    head = file[start : start + _HEAD.size]
    length = _HEAD.unpack(head)[1] if data <= len(file) else 0
    if data > len(file) or length > len(file) - data:
        raise StateError(f"{source}: is truncated at {len(file)} bytes")
    content = memoryview(file)[data : data + length]
    digest = hashlib.sha256(head)
    digest.update(content)
    if digest.digest() != file[start + _HEAD.size : data]:
        raise StateError(f"{source}: is damaged (the checksum of the record at byte {start} differs)")
    return head[:4].decode("ascii", "replace"), content, data + length


def _record(tag: str, content: memoryview, source: str) -> Record:
    try:
        (length,) = _JSON.unpack(content[: _JSON.size])
        stop = _JSON.size + length
        return Record(tag, json.loads(bytes(content[_JSON.size : stop])), bytes(content[stop:]))
    except (struct.error, ValueError) as error:
        raise StateError(f"{source}: the record {tag} cannot be read ({error})") from error


def array_records(arrays: Arrays) -> list[Record]:
    """Return records of the arrays, compressed."""
    compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
    records: list[Record] = []
    for name, array in arrays.items():
        assert array.dtype.name in _TYPES, name
        values = {"name": name, "type": array.dtype.name, "shape": array.shape}
        records.append(Record("ARRY", values, compressor.compress(np.ascontiguousarray(array).data)))
    return records


def arrays_of(records: Iterable[Record], source: str) -> Arrays:
    """Return the arrays among the records; they can be written to.

    Raises:
        StateError: An array does not have its stated size.
    """
    arrays: Arrays = {}
    for record in records:
        if record.tag == "ARRY":
            name, kind, shape = (record.values.get(key) for key in ("name", "type", "shape"))
            if kind not in _TYPES or not isinstance(name, str) or not isinstance(shape, list):
                raise StateError(f"{source}: the array {name} cannot be read")
            size = int(np.prod(shape, dtype=np.int64)) * np.dtype(kind).itemsize
            arrays[name] = np.frombuffer(_decompressed(record.data, size, name, source), kind).reshape(shape)
    return arrays


def _decompressed(data: bytes, size: int, name: str, source: str) -> bytearray:
    try:
        stated = zstandard.get_frame_parameters(data).content_size
        if stated != size:
            raise StateError(f"{source}: the array {name} has {stated} bytes; its shape needs {size}")
        return bytearray(zstandard.ZstdDecompressor().decompress(data))
    except zstandard.ZstdError as error:
        raise StateError(f"{source}: the array {name} cannot be decompressed ({error})") from error
