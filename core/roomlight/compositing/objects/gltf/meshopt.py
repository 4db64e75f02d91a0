"""Decode buffer views of EXT_meshopt_compression and KHR_meshopt_compression, as gltfpack writes them."""

from typing import Annotated, Final, Literal

import numpy as np
from jaxtyping import UInt8
from pydantic import BaseModel, ConfigDict, Field

from roomlight.compositing.objects.gltf.kernels.meshopt import attributes, indices, triangles
from roomlight.compositing.objects.gltf.schema import BufferView
from roomlight.errors import ObjectError

MESHOPT: Final = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_HEADERS: Final = {"ATTRIBUTES": (0xA0, 0xA1), "TRIANGLES": (0xE1,), "INDICES": (0xD1,)}
_Index = Annotated[int, Field(ge=0)]


class Compressed(BaseModel):
    """The extension of a buffer view."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    buffer: _Index
    byteOffset: _Index = 0  # noqa: N815
    byteLength: _Index  # noqa: N815
    byteStride: Annotated[int, Field(ge=1, le=256)]  # noqa: N815
    count: _Index
    mode: Literal["ATTRIBUTES", "TRIANGLES", "INDICES"]
    filter: Literal["NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"] = "NONE"


def decode_view(stated: Compressed, view: BufferView, content: memoryview, label: str) -> memoryview:
    """Return a buffer view's bytes.

    Args:
        stated: The extension.
        view: The view, of as many bytes as the values have.

    Raises:
        ObjectError: The bytes are damaged, or the extension contradicts the view.
    """
    data = np.frombuffer(content, np.uint8)
    stride, count = stated.byteStride, stated.count
    if count * stride != view.byteLength:
        raise ObjectError(f"{label}: {count} values of {stride} bytes are not the {view.byteLength} of the view")
    if count == 0:
        return memoryview(b"")
    if len(data) == 0 or data[0] not in _HEADERS[stated.mode]:
        raise ObjectError(f"{label}: its compressed {stated.mode.lower()} have the header {data[:1].tolist()}")
    out = np.zeros((count, stride), np.uint8)
    if stated.mode == "ATTRIBUTES":
        if stride % 4:
            raise ObjectError(f"{label}: a byteStride of {stride}; compressed attributes have a multiple of 4")
        read = attributes(data, out)
    else:
        if stride not in (2, 4) or (stated.mode == "TRIANGLES" and count % 3):
            raise ObjectError(f"{label}: {count} compressed indices of {stride} bytes")
        values = np.zeros(count, np.uint32)
        read = triangles(data, values) if stated.mode == "TRIANGLES" else indices(data, values)
        out = values.astype("<u2" if stride == 2 else "<u4").view(np.uint8).reshape(count, stride)
    if read < 0:
        raise ObjectError(f"{label}: its compressed {stated.mode.lower()} are damaged or end early")
    return memoryview(_filtered(out, stated, label).tobytes())


def _filtered(values: UInt8[np.ndarray, "n b"], stated: Compressed, label: str) -> np.ndarray:
    """Undo the filter that made the values small."""
    stride, name = stated.byteStride, stated.filter
    if name == "NONE" or stated.mode != "ATTRIBUTES":
        return values
    if name == "EXPONENTIAL":
        words = values.view("<i4")
        with np.errstate(over="ignore"):
            return np.ldexp(((words << 8) >> 8).astype(np.float32), words >> 24).astype("<f4")
    if stride != 8 and (name == "QUATERNION" or stride != 4):
        raise ObjectError(f"{label}: the filter {name} of values of {stride} bytes")
    if name == "COLOR":
        return _colours(values.view("<u2" if stride == 8 else "<u1"))
    whole = values.view("<i2" if stride == 8 else "<i1")
    most = np.iinfo(whole.dtype).max
    v = whole.astype(np.float64)
    if name == "OCTAHEDRAL":
        xy = v[:, :2] / np.maximum(v[:, 2:3], 1)
        z = 1 - np.abs(xy).sum(axis=1, keepdims=True)
        xy += np.where(xy >= 0, 1, -1) * np.minimum(z, 0)
        n = np.concatenate([xy, z], axis=1)
        n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
        return np.concatenate([np.rint(n * most).astype(whole.dtype), whole[:, 3:]], axis=1)
    xyz = v[:, :3] / ((whole[:, 3:] | 3) * np.sqrt(2.0))
    w = np.sqrt(np.maximum(1 - (xyz**2).sum(axis=1), 0))
    out, first = np.empty_like(whole), whole[:, 3] & 3
    for step, component in enumerate((w, *xyz.T)):
        out[np.arange(len(v)), (first + step) % 4] = np.rint(component * most)
    return out


def _colours(values: np.ndarray) -> np.ndarray:
    """Return RGBA of luma, two differences of colour and alpha; alpha's highest bit says how many bits they have."""
    luma, alpha = values[:, 0].astype(np.int64), values[:, 3].astype(np.int64)
    orange, green = values.view("<i2" if values.itemsize == 2 else "<i1")[:, 1:3].astype(np.int64).T
    most = (1 << np.frexp(np.maximum(alpha, 1).astype(np.float64))[1]) - 1
    low = alpha & (most >> 1)
    rgba = np.stack([luma + orange - green, luma + green, luma - orange - green, 2 * low | (low & 1)], axis=1)
    scaled = np.rint(rgba * (np.iinfo(values.dtype).max / most)[:, None])
    return np.clip(scaled, 0, np.iinfo(values.dtype).max).astype(values.dtype)
