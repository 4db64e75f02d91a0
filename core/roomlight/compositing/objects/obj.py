"""Read OBJ files: polygons, smoothing groups, negative indices and vertex colours.

Nothing outside the file is read, so that materials (`mtllib`) are noted. Colours at vertices are sRGB.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import Float, Int64

from roomlight.compositing.objects.limits import ObjectLimits, plain_text
from roomlight.compositing.objects.materials import Material, diffuse
from roomlight.compositing.objects.polygons import corner_normals, triangles_of
from roomlight.compositing.objects.shading import joined_corners, with_vertex_colours
from roomlight.compositing.objects.virtual_object import TriangleMesh
from roomlight.conventions import srgb_to_linear
from roomlight.errors import ObjectError
from roomlight.notes import Note

_MAX_CORNERS: Final = 4096
"""Corners of one polygon: clipping ears takes their square."""
_VALUES: Final = {b"v": 3, b"vt": 1, b"vn": 3}
_LEFT_OUT: Final = {
    **dict.fromkeys((b"curv", b"curv2", b"surf", b"parm", b"cstype"), b"free-form curves and surfaces"),
    **dict.fromkeys((b"l", b"p"), b"lines and points"),
    b"usemtl": b"materials",
}


@dataclass
class _Content:
    """What the lines hold: values with their lines, and corners with their polygons."""

    values: dict[bytes, list[list[float]]] = field(default_factory=lambda: {key: [] for key in _VALUES})
    corners: list[tuple[int, int, int]] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    groups: list[int] = field(default_factory=list)
    states_groups: bool = False
    library: str = ""
    left_out: set[bytes] = field(default_factory=set)


def read_obj(
    data: bytes, name: str, limits: ObjectLimits
) -> tuple[tuple[tuple[TriangleMesh, Material], ...], tuple[Note, ...]]:
    """Read an OBJ file; see `roomlight.compositing.loading`. Raises ObjectError."""
    content = _content(plain_text(data), name, limits)
    if not content.sizes:
        raise ObjectError(f"{name}: has no face; a point cloud has no surface to light")
    limits.check("triangles", sum(content.sizes) - 2 * len(content.sizes), name)
    points = np.array([row[:3] for row in content.values[b"v"]], np.float64).reshape(-1, 3)
    corners = np.array(content.corners, np.int64)
    sizes = np.array(content.sizes, np.int64)
    for column, key in enumerate(_VALUES):
        if int(corners[:, column].max()) >= len(content.values[key]):
            highest, count = int(corners[:, column].max()) + 1, len(content.values[key])
            raise ObjectError(f"{name}: faces point at {key.decode()} {highest} of {count}")
    triangles = triangles_of(sizes, corners[:, 0], points)
    owner = np.repeat(np.arange(len(sizes)), sizes)[triangles[:, 0]]
    at = triangles.reshape(-1)
    faces = corners[at, 0].reshape(-1, 3)
    normals = _normals(content, points, faces, corners[at, 2], np.array(content.groups, np.int32)[owner])
    uvs = np.zeros((len(at), 2), np.float32)
    stated = corners[at, 1] >= 0
    if stated.any():
        texture = np.array([[*row, 0.0][:2] for row in content.values[b"vt"]], np.float64)
        uvs[stated] = texture[corners[at, 1][stated]] * [1, -1] + [0, 1]  # v grows downward here
    colours = _colours(content, name)
    with np.errstate(over="ignore"):
        try:
            mesh, kept = joined_corners(
                points[corners[at, 0]], uvs, normals, None if colours is None else colours[corners[at, 0]]
            )
        except ObjectError as error:
            raise ObjectError(f"{name}: {error}") from error
    material = diffuse()
    if kept is not None:
        mesh, material, _ = with_vertex_colours(mesh, kept, diffuse((1.0, 1.0, 1.0)))
    return ((mesh, material),), _notes(content, name)


def _notes(content: _Content, name: str) -> tuple[Note, ...]:
    notes: list[Note] = []
    if content.library:
        notes.append(
            Note(
                f"{name}: its materials in {content.library}",
                "the object is grey",
                "export as GLB, or state a material",
            )
        )
    for kind in sorted(content.left_out - ({b"materials"} if content.library else set())):
        effect = "the object is grey" if kind == b"materials" else "they are missing"
        notes.append(Note(f"{name}: {kind.decode()}", effect, "export polygons, with materials as GLB"))
    return tuple(notes)


def _content(data: bytes, name: str, limits: ObjectLimits) -> _Content:
    content, group = _Content(), 0
    for number, raw in enumerate(data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines(), 1):
        words = raw.split(b"#", 1)[0].split()
        if not words:
            continue
        keyword = words[0].lower()
        if keyword in _VALUES:
            content.values[keyword].append(_numbers(words, keyword, name, number))
            if len(content.values[keyword]) > limits.vertices:
                limits.check("vertices", len(content.values[keyword]), name)
        elif keyword == b"f":
            _add_face(content, words[1:], group, name, number)
        elif keyword == b"s":
            group = int(words[1]) if len(words) > 1 and words[1].isdigit() and len(words[1]) < 9 else 0
            content.states_groups = True
        elif keyword == b"mtllib" and len(words) > 1:
            content.library = words[1].decode("utf-8", "replace")[:60]
        elif keyword in _LEFT_OUT:
            content.left_out.add(_LEFT_OUT[keyword])
    return content


def _numbers(words: list[bytes], keyword: bytes, name: str, number: int) -> list[float]:
    try:
        values = [float(word.replace(b",", b".")) for word in words[1:8]]
    except ValueError:
        values = []
    if len(values) < _VALUES[keyword]:
        text = b" ".join(words)[:60].decode("utf-8", "replace")
        raise ObjectError(
            f"{name}: line {number} is not {_VALUES[keyword]} numbers after {words[0].decode()}: {text!r}"
        )
    if not all(abs(value) < np.inf for value in values):
        raise ObjectError(f"{name}: line {number}: every coordinate must be a finite number")
    return values


def _add_face(content: _Content, words: list[bytes], group: int, name: str, number: int) -> None:
    counts = [len(content.values[key]) for key in (b"v", b"vt", b"vn")]
    face: list[tuple[int, int, int]] = []
    for word in words:
        parts = [*word.split(b"/"), b"", b""][:3]
        try:
            stated = [int(part) if part else 0 for part in parts]
        except ValueError:
            stated = [0, 0, 0]
        # negative indices count back from the line; later vertices may still follow for positive ones
        a, b, c = (
            index - 1 if index > 0 else count + index if index else -1
            for index, count in zip(stated, counts, strict=True)
        )
        if a < 0 or stated[0] == 0 or min(b, c) < -1:
            raise ObjectError(f"{name}: line {number} has the corner {word[:40].decode('utf-8', 'replace')!r}")
        face.append((a, b, c))
    if len(face) > _MAX_CORNERS:
        raise ObjectError(f"{name}: line {number} is a face of {len(face)} corners; up to {_MAX_CORNERS} are read")
    if len(face) < 3:
        content.left_out.add(b"faces of less than three corners")
        return
    content.corners.extend(face)
    content.sizes.append(len(face))
    content.groups.append(group)


def _normals(
    content: _Content,
    points: Float[np.ndarray, "n 3"],
    faces: Int64[np.ndarray, "f 3"],
    stated: Int64[np.ndarray, " c"],
    groups: np.ndarray,
) -> Float[np.ndarray, "c 3"]:
    """Return a normal for each corner: as stated, else by smoothing groups, else by creases."""
    given = np.array([row[:3] for row in content.values[b"vn"]], np.float64).reshape(-1, 3)
    has = stated >= 0
    if has.all():
        return given[stated]
    normals = corner_normals(points, faces, groups=groups if content.states_groups else None)
    if has.any():
        normals[has] = given[stated[has]]
    return normals


def _colours(content: _Content, name: str) -> Float[np.ndarray, "n 4"] | None:
    """Return linear colours of the vertices if each line has six numbers."""
    rows = content.values[b"v"]
    if not all(len(row) >= 6 for row in rows):
        return None
    encoded = np.array([row[3:6] for row in rows], np.float64)
    if encoded.max(initial=0) > 1:
        encoded = encoded / 255
    if encoded.min(initial=0) < 0 or encoded.max(initial=0) > 1:
        raise ObjectError(f"{name}: a vertex colour is outside 0 to 255")
    return np.concatenate([srgb_to_linear(encoded), np.ones((len(rows), 1))], axis=1)
