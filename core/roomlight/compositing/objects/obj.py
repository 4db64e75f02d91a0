"""Read OBJ files: polygons, smoothing groups, negative indices, vertex colours, and materials that lie beside them.

Colours at vertices are sRGB.
"""

from dataclasses import dataclass, field
from itertools import chain
from typing import Final

import numpy as np
from jaxtyping import Float, Int32, Int64

from roomlight.compositing.objects.beside import FilesBeside
from roomlight.compositing.objects.limits import NAN, ObjectLimits, plain_text, statement
from roomlight.compositing.objects.materials import TEXTURES, Material, diffuse
from roomlight.compositing.objects.mtl import MtlReader
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

_MAX_CORNERS: Final = 4096
"""Corners of one polygon: clipping ears takes their square."""
_MAX_INDEX: Final = 2**40
"""Of a corner, either way: what is beyond does not fit an array."""
_VALUES: Final = {b"v": 3, b"vt": 1, b"vn": 3}
_LEFT_OUT: Final = {
    **dict.fromkeys((b"curv", b"curv2", b"surf", b"parm", b"cstype"), b"free-form curves and surfaces"),
    **dict.fromkeys((b"l", b"p"), b"lines and points"),
    **dict.fromkeys((b"call", b"csh"), b"files that it calls"),
}


@dataclass
class ObjContent:
    """What the lines hold beside the corners of their polygons: values, and of each polygon its smoothing group and
    the number of its material (-1: none)."""

    values: dict[bytes, list[list[float]]] = field(default_factory=lambda: {key: [] for key in _VALUES})
    groups: list[int] = field(default_factory=list)
    states_groups: bool = False
    libraries: list[str] = field(default_factory=list)
    materials: dict[str, int] = field(default_factory=dict)
    used: list[int] = field(default_factory=list)
    left_out: set[bytes] = field(default_factory=set)
    notes: list[Note] = field(default_factory=list[Note])


@dataclass
class _Lines:
    """Lines as they are read: the corners that differ, where each spelling is among them, and polygons of them."""

    content: ObjContent = field(default_factory=ObjContent)
    different: list[tuple[int, int, int]] = field(default_factory=list)
    spelled: dict[bytes, int] = field(default_factory=dict)
    corners: list[int] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class ObjPolygons:
    """Polygons of a file: corners of all, as rows of a point, a texture coordinate and a normal (-1: none), and their
    sizes. Points of no face may be 0 instead of what is stated."""

    content: ObjContent
    points: Float[np.ndarray, "n 3"]
    texture: Float[np.ndarray, "t 2"]
    normals: Float[np.ndarray, "m 3"]
    corners: Int64[np.ndarray, "c 3"]
    sizes: Int64[np.ndarray, " p"]


def obj_polygons(data: bytes, name: str, limits: ObjectLimits) -> ObjPolygons:
    """Read the polygons of an OBJ file. Raises ObjectError, whose message begins with `name`."""
    lines = _lines(plain_text(data), name, limits)
    content, sizes = lines.content, np.array(lines.sizes, np.int64)
    if not len(sizes):
        raise ObjectError(f"{name}: has no face; a point cloud has no surface to light")
    limits.check("triangles", int(sizes.sum()) - 2 * len(sizes), name)
    points, texture, given = (
        np.fromiter(chain.from_iterable([*row, 0.0][:width] for row in content.values[key]), np.float64).reshape(
            -1, width
        )
        for key, width in ((b"v", 3), (b"vt", 2), (b"vn", 3))
    )
    corners = np.array(lines.different, np.int64)[lines.corners]
    del lines
    stated_values = (points, "v"), (texture, "texture coordinates"), (given, "normals")
    for column, (values, what) in enumerate(stated_values):
        absent = (corners[:, column] < -1) | (corners[:, column] >= len(values))
        if absent.any() and column == 0:
            raise ObjectError(f"{name}: faces point at v {int(corners[:, 0].max()) + 1} of {len(points)}")
        if absent.any():  # exporters and editors lose them
            content.left_out.add(f"{what} {int(corners[absent, column].max()) + 1} of {len(values)}".encode())
            corners[absent, column] = -1
        odd = np.append(~np.isfinite(values).all(axis=1), False)[corners[:, column]]
        if odd.any() and column == 0:
            number = int(corners[odd, 0][0])
            raise ObjectError(f"{name}: v {number + 1} is {points[number].tolist()}: a face needs finite numbers")
        if odd.any():
            content.left_out.add(f"{what} that are not finite numbers".encode())
            corners[odd, column] = -1
    points[~np.isfinite(points).all(axis=1)] = 0  # of no face
    return ObjPolygons(content, points, texture, given, corners, sizes)


def read_obj(
    data: bytes, name: str, limits: ObjectLimits, beside: FilesBeside
) -> tuple[tuple[tuple[TriangleMesh, Material], ...], tuple[Note, ...]]:
    """Read an OBJ file; see `roomlight.compositing.loading`. Raises ObjectError."""
    file = obj_polygons(data, name, limits)
    content, corners, sizes = file.content, file.corners, file.sizes
    points, moved = near_origin(file.points, corners[:, 0], name)
    try:
        triangles = triangles_of(sizes, corners[:, 0], points)
    except ObjectError as error:
        raise ObjectError(f"{name}: {error}") from error
    owner = np.repeat(np.arange(len(sizes)), sizes)[triangles[:, 0]]
    at = triangles.reshape(-1)
    faces = corners[at, 0].reshape(-1, 3)
    groups = np.array(content.groups, np.int32)[owner] if content.states_groups else None
    normals = _normals(file.normals, points, faces, corners[at, 2], groups)
    order, normals, turned = agreeing_corners(points[corners[at, 0]], normals, name)
    at = at[order]
    uvs = np.zeros((len(at), 2), np.float32)
    stated = corners[at, 1] >= 0
    if stated.any():
        uvs[stated] = file.texture[corners[at, 1][stated]] * [1, -1] + [0, 1]  # v grows downward here
    colours = _colours(content, name)
    materials, notes = _materials(content, beside, limits, name)
    parts: list[tuple[TriangleMesh, Material]] = []
    lost = Note(f"{name}: vertex colours beside a texture", "the texture alone is shown", "bake them into it")
    # one part if no material was read
    used = np.array(content.used, np.int64)[owner] if materials else np.full(len(owner), -1)
    for number in np.unique(used).tolist():
        part = np.repeat(used == number, 3)
        tints = None if colours is None else colours[corners[at[part], 0]]
        with np.errstate(over="ignore"):
            try:
                mesh, kept = joined_corners(points[corners[at[part], 0]], uvs[part], normals[part], tints)
            except ObjectError as error:
                raise ObjectError(f"{name}: {error}") from error
        material = materials.get(number, diffuse() if kept is None else diffuse((1.0, 1.0, 1.0)))
        if kept is not None and any(getattr(material, f"{key}_texture") is not None for key in TEXTURES):
            notes = notes if (kept == 1).all() or lost in notes else (*notes, lost)
        elif kept is not None:
            mesh, material, _ = with_vertex_colours(mesh, kept, material)
        parts.append((mesh, material))
    limits.check("parts", len(parts), name)
    return tuple(parts), (*notes, *moved, *turned)


def _materials(
    content: ObjContent, beside: FilesBeside, limits: ObjectLimits, name: str
) -> tuple[dict[int, Material], tuple[Note, ...]]:
    """Return the materials that faces use, by number, and what was left out."""
    reader, read, notes = MtlReader(beside, limits, name), dict[str, Material](), list[Note]()
    if beside.exists:
        for library in content.libraries:
            pieces = library.split() if beside.near(library) is None else []
            limits.check("materials", len(pieces), name)
            for piece in pieces if any(map(beside.near, pieces)) else [library]:
                read |= reader.materials(piece)
        notes.extend(reader.notes)
        unread = reader.missing
    elif unread := bool(content.libraries):
        place = f"{name}: its materials in {content.libraries[0][:60]}"
        notes.append(Note(place, "the object is grey", "export as GLB, or state a material"))
    used = set(content.used)
    missing = sorted(key for key, number in content.materials.items() if key not in read and number in used)
    if missing and not unread:
        notes.append(Note(f"{name}: materials {', '.join(missing)[:60]}", "these parts are grey", "export as GLB"))
    clear = [key for key, number in content.materials.items() if number in used and key in read]
    if clear := sorted(key for key in clear if read[key].opacity == 0):
        place = f"{name}: the opacity of 0 (d, Tr) of {', '.join(clear)[:60]}"
        notes.append(Note(place, "these parts are invisible", "write d 1 if they are not"))
    notes.extend(content.notes)
    notes.extend(
        Note(f"{name}: {kind.decode()}", "they are missing", "export polygons, with materials as GLB")
        for kind in sorted(content.left_out)
    )
    return {number: read[key] for key, number in content.materials.items() if key in read}, distinct(notes)


def _lines(data: bytes, name: str, limits: ObjectLimits) -> _Lines:
    lines, group, material = _Lines(), 0, -1
    content = lines.content
    for number, raw in enumerate(data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines(), 1):
        words = raw.split(b"#", 1)[0].split()
        if not words:
            if raw.startswith(b"#MRGB"):
                content.left_out.add(b"colours of its vertices in ZBrush's comments (#MRGB)")
            continue
        keyword = words[0].lower()
        if keyword in _VALUES:
            content.values[keyword].append(_numbers(words, keyword, name, number))
            if len(content.values[keyword]) > limits.vertices:
                limits.check("vertices", len(content.values[keyword]), name)
        elif keyword == b"f":
            _add_face(lines, words[1:], group, material, name, number)
        elif keyword == b"s":
            group = int(words[1]) if len(words) > 1 and words[1].isdigit() and len(words[1]) < 9 else 0
            content.states_groups = True
        elif keyword == b"mtllib" and (library := statement(raw)[1]):
            content.libraries.append(library.strip('"'))
            limits.check("materials", len(content.libraries), name)
        elif keyword == b"usemtl":
            material = content.materials.setdefault(statement(raw)[1], len(content.materials))
        elif keyword in _LEFT_OUT:
            content.left_out.add(_LEFT_OUT[keyword])
    return lines


def _numbers(words: list[bytes], keyword: bytes, name: str, number: int) -> list[float]:
    try:
        values = list(map(float, words[1:8]))
    except ValueError:
        line = b" ".join(words)
        if (mended := NAN.sub(b"nan", line.replace(b",", b"."))) != line:
            return _numbers(mended.split(), keyword, name, number)
        values = []
    if len(values) < 3 and keyword == b"vn":  # normals can be computed
        return [np.nan] * 3
    if len(values) < _VALUES[keyword]:
        text = b" ".join(words)[:60].decode("utf-8", "replace")
        raise ObjectError(
            f"{name}: line {number} is not {_VALUES[keyword]} numbers after {words[0].decode()}: {text!r}"
        )
    return values


def _add_face(lines: _Lines, words: list[bytes], group: int, material: int, name: str, number: int) -> None:
    face: list[int] = []
    for word in words:
        at = lines.spelled.get(word)
        if at is None:
            at = len(lines.different)
            lines.different.append(_corner(lines.content, word, name, number))
            if b"-" not in word:
                lines.spelled[word] = at
        face.append(at)
    if len(face) > _MAX_CORNERS:
        raise ObjectError(f"{name}: line {number} is a face of {len(face)} corners; up to {_MAX_CORNERS} are read")
    if len(face) < 3:
        lines.content.left_out.add(b"faces of less than three corners")
        return
    lines.corners.extend(face)
    lines.sizes.append(len(face))
    lines.content.groups.append(group)
    lines.content.used.append(material)


def _corner(content: ObjContent, word: bytes, name: str, number: int) -> tuple[int, int, int]:
    parts = [*word.split(b"/"), b"", b""][:3]
    try:
        stated = [int(part) if part else 0 for part in parts]
    except ValueError:
        stated = [0, 0, 0]
    # negative indices count back from the line; later vertices may still follow for positive ones
    a, b, c = (
        count + index if -count <= index < 0 else index - 1
        for index, count in zip(stated, map(len, content.values.values()), strict=True)
    )
    if a < 0 or max(map(abs, stated)) > _MAX_INDEX:
        raise ObjectError(f"{name}: line {number} has the corner {word[:40].decode('utf-8', 'replace')!r}")
    return a, b, c


def _normals(
    given: Float[np.ndarray, "m 3"],
    points: Float[np.ndarray, "n 3"],
    faces: Int64[np.ndarray, "f 3"],
    stated: Int64[np.ndarray, " c"],
    groups: Int32[np.ndarray, " f"] | None,
) -> Float[np.ndarray, "c 3"]:
    """Return a normal for each corner: as stated, else by smoothing groups, else by creases."""
    has = stated >= 0
    if has.all():
        return given[stated]
    normals = corner_normals(points, faces, groups=groups)
    if has.any():
        normals[has] = given[stated[has]]
    return normals


def _colours(content: ObjContent, name: str) -> Float[np.ndarray, "n 4"] | None:
    """Return linear colours of the vertices if each line has six numbers."""
    rows = content.values[b"v"]
    coloured = sum(len(row) >= 6 and bool(np.isfinite(row[3:6]).all()) for row in rows)
    if coloured < len(rows):
        if coloured:
            content.left_out.add(b"colours of %d of %d vertices" % (coloured, len(rows)))
        return None
    encoded = np.array([row[3:6] for row in rows], np.float64)
    encoded, notes = colours_in_range(encoded, name)
    content.notes.extend(notes)
    return np.concatenate([srgb_to_linear(encoded), np.ones((len(rows), 1))], axis=1)
