"""Meshes that Draco has compressed (KHR_draco_mesh_compression), by the extra `draco`."""

import importlib
import importlib.util
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from roomlight.compositing.objects.gltf.accessors import Accessors, as_floats
from roomlight.compositing.objects.gltf.schema import Primitive
from roomlight.errors import ObjectError

DRACO: Final = "KHR_draco_mesh_compression"
_MODULE: Final = "DracoPy"


def draco_available() -> bool:
    """Return whether Draco can be decoded (the extra `draco` is installed)."""
    return importlib.util.find_spec(_MODULE) is not None


def decode_draco(
    primitive: Primitive, views: Sequence[memoryview], accessors: Accessors, count: int, label: str
) -> dict[str, np.ndarray] | None:
    """Return the attributes and `faces` of a compressed primitive; None if it is not compressed.

    Raises:
        ObjectError: It does not decode, has another number of vertices than declared, or the extra is missing.
    """
    stated = primitive.extensions.get(DRACO)
    if not isinstance(stated, dict):
        return None
    view, attributes = stated.get("bufferView"), stated.get("attributes")
    if not isinstance(view, int) or not 0 <= view < len(views) or not isinstance(attributes, dict):
        raise ObjectError(f"{label}: its Draco data is in bufferViews.{view} of {len(views)}")
    if not draco_available():
        raise ObjectError(f"{label}: is compressed by Draco: pip install 'roomlight[draco]', or export uncompressed")
    library: Any = importlib.import_module(_MODULE)
    try:
        mesh = library.decode(bytes(views[view]))
        arrays = {"faces": np.asarray(mesh.faces).reshape(-1, 3)}
        for key in attributes.keys() & primitive.attributes.keys():
            values = np.asarray(mesh.get_attribute_by_unique_id(attributes[key])["data"])
            values = values.reshape(len(values), -1)
            stated_as = accessors.declared(primitive.attributes[key], f"{label}: {key}")
            arrays[key] = values.astype(np.int64) if key.startswith("JOINTS_") else as_floats(values, stated_as)
    except ObjectError:  # of an accessor
        raise
    except Exception as error:  # the binding raises whatever damaged bytes lead to
        raise ObjectError(f"{label}: its Draco data is damaged ({str(error)[:80]})") from error
    points, lengths = arrays.get("POSITION"), {len(values) for key, values in arrays.items() if key != "faces"}
    if points is None or points.shape[1] != 3 or lengths != {count}:
        raise ObjectError(f"{label}: its Draco data does not have the {count} vertices that are declared")
    return arrays
