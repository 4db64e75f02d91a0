"""Read PLY files of Blender, MeshLab and scanners: text and binary, polygons of any size, colours and coordinates of
texture at vertices or corners. Colours are sRGB.
"""

import re
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int64

from roomlight.compositing.objects.limits import NAN, ObjectLimits
from roomlight.compositing.objects.materials import Material, diffuse
from roomlight.compositing.objects.polygons import corner_normals, triangles_of
from roomlight.compositing.objects.shading import (
    agreeing_corners,
    colours_in_range,
    joined_corners,
    near_origin,
    with_vertex_colours,
)
from roomlight.compositing.objects.virtual_object import TriangleMesh
from roomlight.conventions import srgb_to_linear
from roomlight.errors import ObjectError
from roomlight.notes import Note, distinct

_HEADER_BYTES: Final = 65_536
_TYPES: Final = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}
_INDICES: Final = ("vertex_indices", "vertex_index")
_UVS: Final = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_COLOURS: Final = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_MAX_CORNERS: Final = 4096
_LOOKS: Final = re.compile(r"red|green|blue|colou?r|gr[ae]y|intensity|f_dc|^tex|^[uvst]\d$|opacity|metal|rough")
_READ: Final = frozenset(name for names in (*_UVS, *_COLOURS) for name in names) | {"texcoord"}
_ELEMENTS: Final = ("vertex", "face", "edge", "camera")


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str
    count_kind: str | None = None


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]


@dataclass(frozen=True, eq=False)
class _Rows:
    """The values of an element: single ones by name, and lists as their lengths and all values in order."""

    scalars: dict[str, np.ndarray]
    lists: dict[str, tuple[Int64[np.ndarray, " n"], np.ndarray]]


def read_ply(
    data: bytes, name: str, limits: ObjectLimits
) -> tuple[tuple[tuple[TriangleMesh, Material], ...], tuple[Note, ...]]:
    """Read a PLY file; see `roomlight.compositing.loading`. Raises ObjectError."""
    data = data.removeprefix(b"\xef\xbb\xbf")
    match = re.search(rb"\nend_header[ \t]*(\r\n|\n|\r)|\rend_header[ \t]*\r", data[:_HEADER_BYTES])
    if match is None:
        raise ObjectError(f"{name}: the PLY header does not end within {_HEADER_BYTES} bytes")
    order, elements, notes = _header(data[: match.start()].decode("latin-1"), name)
    counts = {element.name: element.count for element in elements}
    limits.check("vertices", counts.get("vertex", 0), name)
    limits.check("triangles", counts.get("face", 0), name)
    if "tristrips" in counts:
        raise ObjectError(f"{name}: triangle strips of PLY are not read; export faces")
    if counts.get("face", 0) == 0:
        raise ObjectError(f"{name}: has no face; a point cloud has no surface to light")
    try:
        rows = _rows(data[match.end() :], order, elements, name)
        alpha = rows["vertex"].scalars.get("alpha") if "vertex" in rows else None
        if alpha is not None and len(alpha) and alpha.min() < _largest(alpha):
            notes = (*notes, Note(f"{name}: its alpha", "the surface is opaque", "export as GLB"))
        more = list(notes)
        return _object(rows, name, limits, more), (*distinct(more), *_unread(elements, name))
    except ObjectError as error:
        message = str(error)
        raise ObjectError(message if message.startswith(name) else f"{name}: {message}") from error


def _unread(elements: list[_Element], name: str) -> list[Note]:
    """Note values that bear on looks under names that are not read, and elements beside vertices and faces."""
    unread = {
        f"{element.name}.{p.name}"
        for element in elements
        for p in (element.properties if element.name in ("vertex", "face") else ())
        if _LOOKS.search(p.name) and p.name not in _READ
    }
    unread |= {f"element {entry.name}" for entry in elements if entry.count and entry.name not in _ELEMENTS}
    listed = ", ".join(sorted(unread)[:8])[:200]
    return [Note(f"{name}: {listed}", "they are not read", "export as GLB if they matter")] if unread else []


def _header(text: str, name: str) -> tuple[str, list[_Element], tuple[Note, ...]]:
    """Return the byte order ("" for text), the elements in order, and notes."""
    order, elements, notes = "", list[_Element](), list[Note]()
    for line in re.split(r"\r\n|\n|\r", text):
        words = line.split()
        if not words or words[0] == "ply":
            continue
        if words[0] in ("comment", "obj_info"):
            if len(words) > 2 and words[1].lower().replace("_", "") in ("texturefile", "texture"):
                picture = " ".join(words[2:])[:60]
                notes.append(Note(f"{name}: its texture {picture}", "it is not read", "export as GLB"))
        elif words[0] == "format" and len(words) > 1:
            orders = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
            if words[1] not in orders:
                raise ObjectError(f"{name}: the PLY header has a format that is not understood: {words[1][:40]!r}")
            order = orders[words[1]]
        elif words[0] == "element" and len(words) == 3 and re.fullmatch(r"\d{1,9}", words[2]) and len(elements) < 16:
            if any(element.name == words[1] for element in elements):
                raise ObjectError(f"{name}: the PLY declares the element {words[1]!r} twice")
            elements.append(_Element(words[1], int(words[2]), ()))
        elif words[0] == "property" and elements and len(elements[-1].properties) < 256:
            last = elements[-1]
            elements[-1] = _Element(last.name, last.count, (*last.properties, _property(words, line, last.name, name)))
        elif words[0] in ("format", "element", "property"):
            raise ObjectError(f"{name}: the PLY header has a line that is not understood: {line[:60]!r}")
        else:
            notes.append(Note(f"{name}: the line {line[:60]!r} of its header", "it is not read", "nothing to do"))
    return order, elements, tuple(notes)


def _property(words: list[str], line: str, element: str, name: str) -> _Property:
    listed = len(words) == 5 and words[1] == "list"
    types = words[2:4] if listed else words[1:2]
    if (not listed and len(words) != 3) or any(kind not in _TYPES for kind in types):
        raise ObjectError(f"{name}: the PLY header has a property that is not understood: {line[:60]!r}")
    if listed and (element == "vertex" or _TYPES[types[0]][0] == "f"):
        raise ObjectError(f"{name}: a PLY with lists in its vertices is not read")
    return _Property(words[-1].lower(), _TYPES[types[-1]], _TYPES[types[0]] if listed else None)


def _rows(body: bytes, order: str, elements: list[_Element], name: str) -> dict[str, _Rows]:
    """Decode the elements in order. Raises ObjectError if they take more than is there."""
    least = sum(
        element.count * sum(2 if not order else np.dtype(p.count_kind or p.kind).itemsize for p in element.properties)
        for element in elements
    )
    if least > len(body) + 1:
        raise ObjectError(
            f"{name}: the PLY declares {least} bytes of elements or more, {len(body)} are there: it is truncated"
        )
    source = _TextSource(body, name) if not order else _BinarySource(body, order, name)
    rows: dict[str, _Rows] = {}
    for element in elements:
        rows[element.name] = source.element(element)
        if {"vertex", "face"} <= rows.keys():
            break  # edges and materials that follow are not needed
    return rows


class _TextSource:
    """Values of a text PLY, in order."""

    def __init__(self, body: bytes, name: str) -> None:
        try:
            self._values = np.array(NAN.sub(b"nan", body).split(), np.float64)
        except ValueError as error:
            raise ObjectError(f"{name}: the PLY is damaged ({str(error)[:80]})") from error
        self._at, self._name = 0, name

    def element(self, element: _Element) -> _Rows:
        """Decode one element's rows."""
        if not any(p.count_kind for p in element.properties):
            width = len(element.properties)
            block = self._take(element.count * width).reshape(element.count, width)
            return _Rows({p.name: _typed(block[:, at], p.kind) for at, p in enumerate(element.properties)}, {})
        scalars: dict[str, list[float]] = {p.name: [] for p in element.properties if not p.count_kind}
        sizes: dict[str, list[int]] = {p.name: [] for p in element.properties if p.count_kind}
        items: dict[str, list[np.ndarray]] = {key: [] for key in sizes}
        for _ in range(element.count):
            for p in element.properties:
                value = float(self._take(1)[0])
                if p.count_kind is None:
                    scalars[p.name].append(value)
                    continue
                if not 0 <= value <= _MAX_CORNERS:
                    raise ObjectError(f"{self._name}: the PLY is damaged: a list has {value:g} values")
                sizes[p.name].append(int(value))
                items[p.name].append(self._take(int(value)))
        lists = {key: (np.array(sizes[key], np.int64), np.concatenate([*items[key], np.zeros(0)])) for key in sizes}
        kinds = {p.name: p.kind for p in element.properties}
        return _Rows({key: _typed(np.array(values), kinds[key]) for key, values in scalars.items()}, lists)

    def _take(self, count: int) -> Float[np.ndarray, " n"]:
        end = self._at + count
        if end > len(self._values):
            raise ObjectError(f"{self._name}: the PLY ends after {len(self._values)} values: it is truncated")
        values, self._at = self._values[self._at : end], end
        return values


def _typed(values: Float[np.ndarray, " n"], kind: str) -> np.ndarray:
    """Return numbers of a text as their property's type."""
    if kind[0] == "f":
        return values
    limits = np.iinfo(kind)
    return np.clip(np.nan_to_num(values), limits.min, limits.max).astype(kind)


class _BinarySource:
    """Values of a binary PLY, in order."""

    def __init__(self, body: bytes, order: str, name: str) -> None:
        self._body, self._order, self._name, self._at = body, order, name, 0

    def element(self, element: _Element) -> _Rows:
        """Decode one element's rows: all at once where they have one shape, else by shape."""
        if element.count == 0:
            return _Rows({p.name: np.zeros(0) for p in element.properties if not p.count_kind}, {})
        shape, _ = self._shape(element, self._at)
        dtype = self._dtype(element, shape)
        if self._at + element.count * dtype.itemsize <= len(self._body):
            block = np.frombuffer(self._body, dtype, element.count, self._at)
            lengths = dict(zip(self._lists(element), shape, strict=True))
            if all((block[f"#{key}"] == length).all() for key, length in lengths.items()):
                self._at += element.count * dtype.itemsize
                lists = {
                    key: (np.full(element.count, length, np.int64), block[key].reshape(-1))
                    for key, length in lengths.items()
                }
                return _Rows({p.name: block[p.name] for p in element.properties if not p.count_kind}, lists)
        return self._by_shape(element)

    def _by_shape(self, element: _Element) -> _Rows:
        rows: dict[tuple[int, ...], tuple[list[int], list[int]]] = {}
        for row in range(element.count):
            shape, end = self._shape(element, self._at)
            indices, offsets = rows.setdefault(shape, ([], []))
            indices.append(row)
            offsets.append(self._at)
            self._at = end
        names = self._lists(element)
        sizes = {key: np.zeros(element.count, np.int64) for key in names}
        for shape, (indices, _) in rows.items():
            for key, length in zip(names, shape, strict=True):
                sizes[key][indices] = length
        starts = {key: np.cumsum(lengths) - lengths for key, lengths in sizes.items()}
        values = {
            p.name: np.zeros(int(sizes[p.name].sum()) if p.count_kind else element.count, self._order + p.kind)
            for p in element.properties
        }
        body = np.frombuffer(self._body, np.uint8)
        for shape, (indices, offsets) in rows.items():
            dtype = self._dtype(element, shape)
            block = body[np.array(offsets)[:, None] + np.arange(dtype.itemsize)].view(dtype).reshape(-1)
            for p in element.properties:
                if p.count_kind is None:
                    values[p.name][indices] = block[p.name]
                else:
                    width = np.arange(shape[names.index(p.name)])
                    values[p.name][starts[p.name][indices][:, None] + width] = block[p.name]
        return _Rows(
            {p.name: values[p.name] for p in element.properties if not p.count_kind},
            {key: (sizes[key], values[key]) for key in names},
        )

    def _lists(self, element: _Element) -> list[str]:
        return [p.name for p in element.properties if p.count_kind]

    def _shape(self, element: _Element, at: int) -> tuple[tuple[int, ...], int]:
        """Return the lengths of the lists of the row at this byte, and where it ends."""
        lengths: list[int] = []
        for p in element.properties:
            item = int(p.kind[1])
            if p.count_kind is None:
                at += item
                continue
            size = int(p.count_kind[1])
            raw = self._body[at : at + size]
            length = int.from_bytes(raw, "little" if self._order == "<" else "big", signed=p.count_kind[0] == "i")
            if not 0 <= length <= _MAX_CORNERS:
                raise ObjectError(f"{self._name}: the PLY is damaged: a list has {length} values")
            lengths.append(length)
            at += size + length * item
        if at > len(self._body):
            raise ObjectError(f"{self._name}: the PLY ends within its element {element.name!r}: it is truncated")
        return tuple(lengths), at

    def _dtype(self, element: _Element, shape: tuple[int, ...]) -> np.dtype:
        lengths = dict(zip(self._lists(element), shape, strict=True))
        fields: list[Any] = []
        for p in element.properties:
            if p.count_kind is not None:
                fields.append((f"#{p.name}", self._order + p.count_kind))
            fields.append((p.name, self._order + p.kind, (lengths[p.name],) if p.count_kind else ()))
        try:
            return np.dtype(fields)
        except ValueError as error:
            raise ObjectError(f"{self._name}: the PLY header is damaged ({str(error)[:80]})") from error


def _object(
    rows: dict[str, _Rows], name: str, limits: ObjectLimits, notes: list[Note]
) -> tuple[tuple[TriangleMesh, Material], ...]:
    """Make the mesh; what is changed is added to `notes`."""
    vertex, face = rows.get("vertex"), rows["face"]
    listed = next((face.lists[key] for key in _INDICES if key in face.lists), None)
    if vertex is None or listed is None or not {"x", "y", "z"} <= vertex.scalars.keys():
        raise ObjectError(f"{name}: the PLY has no x, y, z or no vertex_indices")
    points = np.stack([vertex.scalars[key].astype(np.float64) for key in "xyz"], axis=1)
    sizes, corners = listed[0], listed[1].astype(np.int64)
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise ObjectError(
            f"{name}: faces point at vertices {corners.min()} to {corners.max()}, there are {len(points)}"
        )
    odd = np.asarray(~np.isfinite(points).all(axis=1))
    if odd[corners].any():
        number = int(corners[odd[corners]][0])
        raise ObjectError(f"{name}: vertex {number} is {points[number].tolist()}: a face needs finite numbers")
    points[odd] = 0
    limits.check("triangles", int(np.maximum(sizes - 2, 0).sum()), name)
    if not (sizes >= 3).any():
        raise ObjectError(f"{name}: has no face of three corners or more; there is no surface to light")
    points, moved = near_origin(points, corners, name)
    triangles = triangles_of(sizes, corners, points)
    at = triangles.reshape(-1)
    faces = corners[at].reshape(-1, 3)
    normals = _columns(vertex, ("nx", "ny", "nz"), name, notes)
    shading = np.zeros((len(at), 3)) if normals is None else normals[corners[at]]
    stated = shading.any(axis=1, keepdims=True)
    shading = shading if stated.all() else np.where(stated, shading, corner_normals(points, faces))
    order, shading, turned = agreeing_corners(points[corners[at]], shading, name)
    notes += [*moved, *turned]
    at = at[order]
    polygon = np.repeat(np.arange(len(sizes)), sizes)[at]
    uvs = _corner_uvs((vertex, face), (sizes, corners, at), name, notes)
    colours = _corner_colours((vertex, face), (corners[at], polygon), name, notes)
    with np.errstate(over="ignore"):
        mesh, kept = joined_corners(points[corners[at]], uvs, shading, colours)
    material = diffuse()
    if kept is not None:
        mesh, material, _ = with_vertex_colours(mesh, kept, diffuse((1.0, 1.0, 1.0)))
    return ((mesh, material),)


def _columns(rows: _Rows, names: tuple[str, ...], name: str, notes: list[Note]) -> Float[np.ndarray, "n c"] | None:
    """Return columns of these names, None if one is missing; rows that are not finite are 0."""
    if not all(key in rows.scalars for key in names):
        return None
    return _finite(np.stack([rows.scalars[key].astype(np.float64) for key in names], axis=1), name, notes)


def _finite(rows: Float[np.ndarray, "n c"], name: str, notes: list[Note]) -> Float[np.ndarray, "n c"]:
    odd = ~np.isfinite(rows).all(axis=1, keepdims=True)
    if not odd.any():
        return rows
    left_out = f"{name}: normals, texture coordinates or colours that are not finite numbers"
    notes.append(Note(left_out, "normals are made from the faces, others are 0", "export it anew"))
    return np.where(odd, 0.0, rows)


def _corner_uvs(
    rows: tuple[_Rows, _Rows], polygons: tuple[np.ndarray, np.ndarray, np.ndarray], name: str, notes: list[Note]
) -> Float[np.ndarray, "t 2"]:
    """Return coordinates of the triangles' corners, v downward: the faces' own (MeshLab), else the vertices'."""
    vertex, face = rows
    sizes, corners, at = polygons
    lengths, values = face.lists.get("texcoord", (np.zeros(0), np.zeros(0)))
    if len(lengths) == len(sizes) and (lengths == 2 * sizes).all():
        uvs = _finite(values.astype(np.float64).reshape(-1, 2), name, notes)[at]
    else:
        stated = (_columns(vertex, names, name, notes) for names in _UVS)
        vertex_uvs = next((uvs for uvs in stated if uvs is not None), None)
        if vertex_uvs is None:
            return np.zeros((len(at), 2))
        uvs = vertex_uvs[corners[at]]
    return np.stack([uvs[:, 0], 1 - uvs[:, 1]], axis=1)


def _largest(values: np.ndarray) -> float:
    """Return what stands for 1: the largest integer of a type, 255 of 32 bits that hold no more, or 1 of floats."""
    if values.dtype.kind not in "ui":
        return 1.0
    return 255.0 if values.dtype.itemsize == 4 and values.max() <= 255 else float(np.iinfo(values.dtype.name).max)


def _corner_colours(
    elements: tuple[_Rows, _Rows], corners: tuple[np.ndarray, np.ndarray], name: str, notes: list[Note]
) -> Float[np.ndarray, "t 4"] | None:
    """Return linear colours of the triangles' corners: of their vertices, or of their faces where those of the vertices
    are missing or all alike (CAD); None without any."""
    colours: Float[np.ndarray, "t 4"] | None = None
    for rows, which in zip(elements, corners, strict=True):
        for names in _COLOURS:
            encoded = _columns(rows, names, name, notes)
            if encoded is None or len(encoded) == 0:
                continue
            largest = _largest(rows.scalars[names[0]])
            if largest != 1:
                encoded = encoded / largest
            else:
                encoded, clipped = colours_in_range(encoded, name)
                notes.extend(clipped)
            linear = srgb_to_linear(np.clip(encoded, 0, 1))
            colours = np.concatenate([linear, np.ones((len(linear), 1))], axis=1)[which]
            if (encoded != encoded[0]).any():
                return colours
    return colours
