"""Read OBJ and PLY files through trimesh, after their declarations have been checked."""

import io
import re
from itertools import pairwise
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.compositing.objects.materials import Material, diffuse
from roomlight.compositing.objects.virtual_object import TriangleMesh
from roomlight.errors import ObjectError

Parts = tuple[tuple[TriangleMesh, Material], ...]

_NUMBER: Final = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?"
_OBJ_LINE: Final = re.compile(
    rb"^(?:(v|vn)(?:[ \t]+" + _NUMBER + rb"){3,7}|(vt)(?:[ \t]+" + _NUMBER + rb"){1,3}"
    rb"|(f)(?:[ \t]+[1-9]\d{0,8}(?:/(?:[1-9]\d{0,8})?){0,2}){3,255})[ \t]*$"
)
_PLY_HEADER_BYTES: Final = 65_536
_PLY_SIZES: Final = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}


def read_obj(data: bytes, name: str, limits: ObjectLimits) -> Parts:
    """Read an OBJ file; see `roomlight.compositing.objects.loading`. Raises ObjectError."""
    lines: list[bytes] = []
    faces: list[bytes] = []
    for number, raw in enumerate(data.replace(b"\\\n", b" ").splitlines(), 1):
        line = raw.split(b"#", 1)[0].strip()
        keyword = line.split(None, 1)[0] if line else b""
        if keyword not in (b"v", b"vn", b"vt", b"f"):
            continue
        if _OBJ_LINE.match(line) is None:
            shown = line[:60].decode("utf-8", "replace")
            raise ObjectError(f"{name}: line {number} is not a vertex or face of plain positive numbers: {shown!r}")
        if keyword == b"f":
            first, *others = line.split()[1:]
            faces.extend(b" ".join((b"f", first, *pair)) for pair in pairwise(others))  # polygons as fans
        else:
            lines.append(line)
    limits.check("vertices", sum(line[:2] in (b"v ", b"v\t") for line in lines), name)
    limits.check("triangles", len(faces), name)
    if not faces:
        raise ObjectError(f"{name}: has no face; a point cloud has no surface to light")
    return _through_trimesh(b"\n".join([*lines, *faces]), "obj", name, limits)


def read_ply(data: bytes, name: str, limits: ObjectLimits) -> Parts:
    """Read a PLY file; see `roomlight.compositing.objects.loading`. Raises ObjectError."""
    end = data.find(b"end_header", 0, _PLY_HEADER_BYTES)
    if end < 0:
        raise ObjectError(f"{name}: the PLY header does not end within {_PLY_HEADER_BYTES} bytes")
    counts = _ply_elements(data[:end].decode("ascii", "replace"), len(data) - end, name)
    limits.check("vertices", counts.get("vertex", 0), name)
    limits.check("triangles", counts.get("face", 0), name)
    if counts.get("face", 0) == 0:
        raise ObjectError(f"{name}: has no face; a point cloud has no surface to light")
    return _through_trimesh(data, "ply", name, limits)


def _ply_elements(header: str, body: int, name: str) -> dict[str, int]:
    """Return the number of each element; what they take at least must be in the file."""
    counts: dict[str, int] = {}
    least = 0
    text = "format ascii" in header
    element = ""
    for number, line in enumerate(header.splitlines()):
        words = line.split()
        if not words or words[0] in ("ply", "format", "comment", "obj_info"):
            continue
        if words[0] == "element" and len(words) == 3 and re.fullmatch(r"\d{1,9}", words[2]) and len(counts) < 16:
            element = words[1]
            if element in counts:
                raise ObjectError(f"{name}: the PLY declares the element {element!r} twice")
            counts[element] = int(words[2])
        elif words[0] == "property" and element and number < 256:
            listed = len(words) == 5 and words[1] == "list"
            types = words[2:4] if listed else words[1:2]
            if (not listed and len(words) != 3) or any(one not in _PLY_SIZES for one in types):
                raise ObjectError(f"{name}: the PLY header has a property that is not understood: {line[:60]!r}")
            if listed and (element == "vertex" or _PLY_SIZES[types[0]] > 4):
                raise ObjectError(f"{name}: a PLY with lists in its vertices is not read")
            least += counts[element] * (2 if text else _PLY_SIZES[types[0]])
        else:
            raise ObjectError(f"{name}: the PLY header has a line that is not understood: {line[:60]!r}")
    if least > body + 1:
        raise ObjectError(
            f"{name}: the PLY declares {least} bytes of elements or more, {body} are there: it is truncated"
        )
    return counts


def _through_trimesh(data: bytes, kind: str, name: str, limits: ObjectLimits) -> Parts:
    found = decode_with_trimesh(data, kind, name)
    pieces = list(found["geometry"].values()) if "geometry" in found else [found]
    parts: list[tuple[TriangleMesh, Material]] = []
    for piece in pieces:
        faces, vertices = np.asarray(piece.get("faces", ())), np.asarray(piece["vertices"], np.float64)
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu" or vertices.shape[1:] != (3,):
            raise ObjectError(f"{name}: has no triangles; a point cloud has no surface to light")
        limits.check("triangles", len(faces), name)
        limits.check("vertices", len(vertices), name)
        uvs = getattr(piece.get("visual"), "uv", None)
        try:
            mesh = TriangleMesh.build(
                _clipped(vertices),
                faces,
                normals=_values(piece.get("vertex_normals"), (len(vertices), 3)),
                uvs=_upright(_values(uvs, (len(vertices), 2))),
            )
        except ObjectError as error:
            raise ObjectError(f"{name}: {error}") from error
        parts.append((mesh, diffuse()))
    return tuple(parts)


def decode_with_trimesh(data: bytes, kind: str, name: str) -> dict[str, Any]:
    """Return the arrays that trimesh decodes from checked data; no other file is read. Raises ObjectError."""
    from trimesh.exchange.gltf import load_glb
    from trimesh.exchange.obj import load_obj
    from trimesh.exchange.ply import load_ply

    stream = io.BytesIO(data)
    try:
        if kind == "glb":
            return load_glb(stream, skip_materials=True)
        if kind == "obj":
            return load_obj(stream, skip_materials=True, group_material=False)
        return load_ply(stream, skip_materials=True)
    except Exception as error:  # trimesh raises whatever damaged bytes lead to: IndexError, KeyError, ValueError, ...
        raise ObjectError(
            f"{name}: the {kind.upper()} is damaged ({type(error).__name__}: {str(error)[:120]})"
        ) from error


def _values(values: Any, shape: tuple[int, int]) -> Float[np.ndarray, "n c"] | None:
    """Return optional values of a vertex each if they have the shape and are finite, otherwise None."""
    if values is None:
        return None
    array = np.asarray(values)
    if array.shape != shape or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        return None
    return _clipped(array.astype(np.float64))


def _clipped(values: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "n c"]:
    """Convert to float32; what does not fit becomes infinite, and is refused later."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def _upright(uvs: Float[np.ndarray, "n 2"] | None) -> Float[np.ndarray, "n 2"] | None:
    """Turn v from upward to downward."""
    return None if uvs is None else np.stack([uvs[:, 0], 1 - uvs[:, 1]], axis=1)
