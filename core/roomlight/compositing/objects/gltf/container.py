"""The container of a glTF: the chunks of a GLB, its JSON, and the bytes of buffer views."""

import base64
import binascii
import re
import struct
import urllib.parse
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from roomlight.compositing.objects.beside import FilesBeside
from roomlight.compositing.objects.gltf.meshopt import MESHOPT, Compressed, decode_view
from roomlight.compositing.objects.gltf.schema import BufferView, Gltf
from roomlight.compositing.objects.limits import ObjectLimits, plain_text
from roomlight.errors import ObjectError

Model = TypeVar("Model", bound=BaseModel)

_CHUNKS = (b"JSON", b"BIN\0")
_OTHERS = {b"\xff\xd8\xff": "a JPEG", b"\x89PNG": "a PNG", b"PK\x03\x04": "a ZIP", b"<": "HTML or XML"}
_VERSION_1 = re.compile(rb'"asset"\s*:\s*\{[^{}]*"version"\s*:\s*"?1\b|"techniques"\s*:\s*\{')


def split(data: bytes, name: str) -> tuple[bytes, bytes | None]:
    """Return the JSON and the binary chunk of a GLB, or a glTF file's JSON. Bytes after the GLB's length are ignored.

    Raises:
        ObjectError: The GLB is truncated or of another version, or the file is of another kind.
    """
    if data[:4] != b"glTF":
        text = plain_text(data)
        if text[:1000].lstrip()[:1] not in (b"{", b""):
            other = next((kind for magic, kind in _OTHERS.items() if text.startswith(magic)), repr(text[:12]))
            raise ObjectError(f"{name}: is no GLB or glTF file; it starts like {other}; export the object as GLB")
        return text, None
    if len(data) < 20:
        raise ObjectError(f"{name}: a GLB has 20 bytes of header, this file has {len(data)}")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise ObjectError(f"{name}: GLB version 2 is read, this is {version}")
    chunks: dict[bytes, bytes] = {}
    offset = 12
    while offset + 8 <= min(length, len(data)):
        size, kind = struct.unpack_from("<I4s", data, offset)
        if offset + 8 + size > len(data):
            raise ObjectError(f"{name}: the GLB's {kind!r} chunk declares {size} bytes and is truncated")
        chunks.setdefault(kind, data[offset + 8 : offset + 8 + size])
        offset += 8 + size
        if data[offset + 4 : offset + 8] not in _CHUNKS:  # some writers pad a chunk and do not count it
            offset += -size % 4
    if b"JSON" not in chunks:
        raise ObjectError(f"{name}: the GLB has no JSON chunk")
    return plain_text(chunks[b"JSON"]).rstrip(b"\0 "), chunks.get(b"BIN\0")


def json_size(text: bytes) -> int:
    """Return the bytes of the JSON without embedded data URIs, which are long by nature."""
    return len(text) - sum(len(piece) for piece in text.split(b'"') if piece[:5] == b"data:")


def parsed(text: bytes, name: str, clamped: list[str]) -> Gltf:
    """Parse and check the JSON; names of clamped values are added to `clamped`. Raises ObjectError."""
    text = text.decode("utf-8", "replace").encode()  # names may be in another encoding
    try:
        gltf = Gltf.model_validate_json(text, context=clamped)
    except ValidationError as error:
        if _VERSION_1.search(text):
            raise ObjectError(f"{name}: glTF 2 is read, this is version 1; convert it") from None
        raise ObjectError(f"{name}: {explained(error, 'glTF')}") from None
    if gltf.asset.version.partition(".")[0] != "2":
        raise ObjectError(f"{name}: glTF 2 is read, this is version {gltf.asset.version[:20]!r}")
    return gltf


def extension(model: type[Model], owner: Any, key: str, label: str, clamped: list[str]) -> Model | None:
    """Read an extension of an object; None if it has none of this name. Raises ObjectError."""
    values = owner.extensions.get(key)
    if values is None:
        return None
    try:
        return model.model_validate(values, context=clamped)
    except ValidationError as error:
        raise ObjectError(f"{label}: {explained(error, key)}") from None


def explained(error: ValidationError, what: str) -> str:
    """Say in our words which value is not allowed."""
    first = error.errors(include_url=False)[0]
    where = ".".join(str(step) for step in first["loc"][:8])
    kind, bounds = first["type"], first.get("ctx", {})
    if kind in ("json_invalid", "recursion_loop"):
        return f"its JSON is damaged ({str(bounds.get('error', ''))[:80]})"
    if kind == "missing":
        return f"{what} {where} is missing"
    value = repr(first.get("input"))
    text = value if len(value) <= 60 else value[:57] + "..."
    rules = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below", "expected": "one of"}
    allowed = [f"{word} {bounds[key]}" for key, word in rules.items() if key in bounds]
    types = {"int": "a whole number", "float": "a number", "string": "a text", "list": "a list", "dict": "an object"}
    if kind in ("too_short", "too_long", "tuple_type"):
        allowed = [f"{bounds.get('max_length', bounds.get('min_length', 'several'))} numbers"]
    expected = allowed or [word for key, word in types.items() if kind.startswith(key)] or ["another value"]
    return f"{what} {where or 'JSON'} is {text}; it must be {' and '.join(expected)}"


def resource(uri: str, beside: FilesBeside, label: str) -> bytes:
    """Decode a data URI, or read a file beside the glTF. Raises ObjectError."""
    head, comma, body = uri.partition(",")
    if not head.startswith("data:"):
        return beside.read(uri, label)
    if not comma:
        raise ObjectError(f"{label}: its data URI {uri[:60]!r} has no comma before the data")
    if not head.endswith(";base64"):
        return urllib.parse.unquote_to_bytes(body)
    try:
        return base64.b64decode("".join(body.split()) + "=" * (-len(body) % 4), validate=True)
    except (binascii.Error, ValueError) as error:
        raise ObjectError(f"{label}: its base64 is damaged") from error


def buffer_views(
    gltf: Gltf, binary: bytes | None, beside: FilesBeside, limits: ObjectLimits, name: str
) -> list[memoryview]:
    """Return the bytes of each buffer view, decompressed. Raises ObjectError."""
    buffers: list[memoryview] = []
    for index, buffer in enumerate(gltf.buffers):
        if buffer.uri is not None:
            content = resource(buffer.uri, beside, f"{name}: buffer {index}")
        elif index == 0 and binary is not None:
            content = binary
        elif any(key in buffer.extensions or key in gltf.extensionsRequired for key in MESHOPT):
            buffers.append(memoryview(b""))  # stands for what the views decompress to
            continue
        else:
            raise ObjectError(f"{name}: buffer {index} is not in the file; export as one GLB file")
        if buffer.byteLength > len(content) + 3:  # some exporters count the padding
            raise ObjectError(f"{name}: buffer {index} declares {buffer.byteLength} bytes, {len(content)} are there")
        buffers.append(memoryview(content))

    def span(owner: BufferView | Compressed, label: str) -> memoryview:
        if owner.buffer >= len(buffers):
            raise ObjectError(f"{label} names buffer {owner.buffer} of {len(buffers)}")
        end = owner.byteOffset + owner.byteLength
        if end > len(buffers[owner.buffer]):
            raise ObjectError(f"{label} ends at byte {end} of {len(buffers[owner.buffer])}")
        return buffers[owner.buffer][owner.byteOffset : end]

    views: list[memoryview] = []
    decoded = 0
    for index, view in enumerate(gltf.bufferViews):
        label = f"{name}: bufferViews.{index}"
        named = next((key for key in MESHOPT if key in view.extensions), MESHOPT[0])
        compressed = extension(Compressed, view, named, label, [])
        if compressed is None:
            views.append(span(view, label))
            continue
        decoded += view.byteLength
        limits.check("file_bytes", decoded, f"{label}, decompressed")
        views.append(decode_view(compressed, view, span(compressed, label), label))
    return views
