"""Values of glTF's accessors as arrays: strided, normalised, quantised and sparse."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float32, Shaped

from roomlight.compositing.objects.gltf.schema import Accessor, Gltf
from roomlight.errors import ObjectError

_TYPES: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COMPONENTS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def as_floats(values: Shaped[np.ndarray, "n c"], accessor: Accessor) -> Float32[np.ndarray, "n c"]:
    """Return values of an accessor; integers are scaled to [-1, 1] or [0, 1] if it states that they are normalised."""
    if accessor.componentType == 5126 or not accessor.normalized:
        return values.astype(np.float32)
    whole = np.iinfo(_TYPES[accessor.componentType]).max
    return np.maximum(values.astype(np.float32) / np.float32(whole), np.float32(-1))


class Accessors:
    """Decodes the accessors of a file; what they declare is checked against the bytes that are there."""

    def __init__(self, gltf: Gltf, views: Sequence[memoryview]) -> None:
        self._gltf, self._views = gltf, views

    def declared(self, index: int | None, label: str) -> Accessor:
        """Return an accessor's declaration. Raises ObjectError if there is none."""
        if index is None or index >= len(self._gltf.accessors):
            raise ObjectError(f"{label}: accessor {index} of {len(self._gltf.accessors)} does not exist")
        return self._gltf.accessors[index]

    def floats(self, index: int, kind: str | tuple[str, ...], count: int, label: str) -> Float32[np.ndarray, "n c"]:
        """Return `count` vectors or matrices; integers are scaled to [-1, 1] or [0, 1] if they are normalised.

        Raises:
            ObjectError: The accessor is of another kind or count, or passes its bytes.
        """
        accessor = self.declared(index, label)
        kinds = (kind,) if isinstance(kind, str) else kind
        if accessor.type not in kinds:
            raise ObjectError(f"{label} is {accessor.type}, not {' or '.join(kinds)}")
        if accessor.count != count:
            raise ObjectError(f"{label} has {accessor.count} values for {count} vertices")
        return as_floats(self._values(accessor, label), accessor)

    def integers(self, index: int, kind: str, label: str) -> Shaped[np.ndarray, "n c"]:
        """Return unsigned integers, such as indices and joints. Raises ObjectError."""
        accessor = self.declared(index, label)
        if accessor.type != kind or accessor.componentType not in (5121, 5123, 5125):
            raise ObjectError(f"{label}: {accessor.type} of {accessor.componentType} are not unsigned integers")
        return self._values(accessor, label)

    def _values(self, accessor: Accessor, label: str) -> Shaped[np.ndarray, "n c"]:
        width = _COMPONENTS[accessor.type]
        dtype = np.dtype(_TYPES[accessor.componentType])
        if accessor.bufferView is None:
            values = np.zeros((accessor.count, width), dtype)
        else:
            values = self._strided(accessor.bufferView, accessor.byteOffset, accessor.count, width, dtype, label)
        if accessor.sparse is None:
            return values
        part, values = accessor.sparse, values.copy()
        if part.count > accessor.count:
            raise ObjectError(f"{label}: {part.count} sparse values of {accessor.count}")
        index_type = np.dtype(_TYPES[part.indices.componentType])
        where = self._strided(part.indices.bufferView, part.indices.byteOffset, part.count, 1, index_type, label)[:, 0]
        if part.count and int(where.max()) >= accessor.count:
            raise ObjectError(f"{label}: a sparse index points at value {int(where.max())} of {accessor.count}")
        values[where] = self._strided(part.values.bufferView, part.values.byteOffset, part.count, width, dtype, label)
        return values

    def _strided(
        self, view: int, offset: int, count: int, width: int, dtype: np.dtype, label: str
    ) -> Shaped[np.ndarray, "n c"]:
        if view >= len(self._views):
            raise ObjectError(f"{label}: bufferViews.{view} of {len(self._views)} does not exist")
        content, item = self._views[view], width * dtype.itemsize
        stride = self._gltf.bufferViews[view].byteStride or item
        if stride < item:
            raise ObjectError(f"{label}: byteStride {stride} is less than the {item} bytes of a value")
        end = offset + stride * (count - 1) + item if count else offset
        if end > len(content):
            raise ObjectError(f"{label}: {count} values end at byte {end} of a view of {len(content)}")
        if count == 0:
            return np.zeros((0, width), dtype)
        return np.ndarray((count, width), dtype, content, offset, (stride, dtype.itemsize))
