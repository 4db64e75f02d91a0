"""Wavefront OBJ and MTL text as arrays, with a material for each face.

trimesh is not used: it merges parts by material, drops groups it does not know and takes four times as long. The parser
reads `v`, `vt`, `f`, `usemtl`, `mtllib`; normals are recomputed later, since they are often missing in these files.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from roomlight.compositing.objects.mtl import file_of_map
from roomlight.compositing.objects.polygons import triangles_of
from roomlight.errors import FurnitureError

MAX_TRIANGLES: Final = 3_000_000
"""The largest of Debian's 820 models has 198,396."""


@dataclass(frozen=True, eq=False)
class Obj:
    """A parsed OBJ file; v points up.

    Attributes:
        uv_faces: Texture coordinates of the faces' corners, -1 for corners without.
    """

    positions: Float[np.ndarray, "v 3"]
    uvs: Float[np.ndarray, "t 2"]
    faces: Int[np.ndarray, "f 3"]
    uv_faces: Int[np.ndarray, "f 3"]
    face_materials: Int[np.ndarray, " f"]
    material_names: tuple[str, ...]
    libraries: tuple[str, ...]


@dataclass(frozen=True)
class MtlMaterial:
    """A material of an MTL file, unconverted: colours as displayed (sRGB), opacity 1 = opaque."""

    name: str
    diffuse: tuple[float, float, float] = (0.8, 0.8, 0.8)
    specular: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shininess: float = 0.0
    opacity: float = 1.0
    texture: str | None = None


def parse_obj(data: bytes, name: str) -> Obj:
    """Parse the triangles of an OBJ file; polygons are triangulated.

    Raises:
        FurnitureError: the file is damaged; the message starts with `name`.
    """
    positions: list[bytes] = []
    uvs: list[bytes] = []
    corners: list[bytes] = []
    sizes: list[int] = []
    face_materials: list[int] = []
    materials: dict[str, int] = {}
    libraries: list[str] = []
    current = -1
    for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        if line.startswith(b"v "):
            positions.append(line[2:])
        elif line.startswith(b"vt "):
            uvs.append(line[3:])
        elif line.startswith(b"f "):
            tokens = line.split()[1:]
            if b"-" in line:
                tokens = _absolute(tokens, len(positions), len(uvs), name)
            if len(tokens) < 3:
                continue
            corners += tokens
            sizes.append(len(tokens))
            if current < 0:
                current = materials.setdefault("", len(materials))
            face_materials.append(current)
        elif line.startswith(b"usemtl"):
            current = materials.setdefault(_text(line[6:]), len(materials))
        elif line.startswith(b"mtllib"):
            libraries.append(_text(line[6:]))
    triangles = sum(sizes) - 2 * len(sizes)
    if not triangles:
        raise FurnitureError(f"{name}: has no faces")
    if triangles > MAX_TRIANGLES:
        raise FurnitureError(f"{name}: has {triangles} triangles; the maximum is {MAX_TRIANGLES}")
    points = _numbers(positions, 3, name)
    coordinates = _numbers(uvs, 2, name)
    corner_points, corner_uvs = _corners(corners, len(points), len(coordinates), name)
    index = triangles_of(np.array(sizes), corner_points, points)
    face_of = np.repeat(np.arange(len(sizes)), sizes)[index[:, 0]]
    order = np.argsort(face_of, kind="stable")
    index, face_of = index[order], face_of[order]
    return Obj(
        positions=points,
        uvs=coordinates,
        faces=corner_points[index],
        uv_faces=corner_uvs[index],
        face_materials=np.array(face_materials, np.int32)[face_of],
        material_names=tuple(materials),
        libraries=tuple(libraries),
    )


def parse_mtl(data: bytes) -> dict[str, MtlMaterial]:
    """Parse the materials of an MTL file by name. Malformed lines are skipped: a model
    with a wrong colour is still usable."""
    materials: dict[str, dict[str, object]] = {}
    current: dict[str, object] = {}
    for line in data.decode("utf-8", "replace").splitlines():
        key, *others = line.split(maxsplit=1)[:2] or [""]
        rest = others[0] if others else ""
        words = rest.split()
        if key == "newmtl":
            current = materials.setdefault(rest.strip(), {})
        elif key == "map_Kd" and words:
            current["texture"] = file_of_map(rest)
        elif key in ("Kd", "Ks", "Ns", "d", "Tr"):
            numbers = [_number(word) for word in words[:3]]
            if not numbers or None in numbers:
                continue
            values = [min(max(value, 0.0), 1.0) for value in numbers if value is not None]
            if key in ("Kd", "Ks"):
                colour = tuple(values) if len(values) == 3 else (values[0],) * 3
                current["diffuse" if key == "Kd" else "specular"] = colour
            elif key == "Ns":
                current["shininess"] = max(float(numbers[0] or 0.0), 0.0)
            else:
                current["opacity"] = values[0] if key == "d" else 1 - values[0]
    return {name: MtlMaterial(name, **values) for name, values in materials.items()}  # pyright: ignore[reportArgumentType]


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", "replace").strip()


def _number(word: str) -> float | None:
    try:
        value = float(word)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _numbers(lines: list[bytes], count: int, name: str) -> Float[np.ndarray, "n count"]:
    """Parse the first `count` numbers of each line."""
    try:
        flat = np.array(b" ".join(lines).split(), np.float64)
        if flat.size != count * len(lines):
            rows = [(line.split() + [b"0"] * count)[:count] for line in lines]
            flat = np.array([word for row in rows for word in row], np.float64)
    except ValueError as error:
        raise FurnitureError(f"{name}: has coordinates that are not numbers ({error})") from error
    if not np.isfinite(flat).all():
        raise FurnitureError(f"{name}: has coordinates that are not finite")
    return flat.reshape(-1, count)


def _absolute(tokens: list[bytes], points: int, uvs: int, name: str) -> list[bytes]:
    """Convert indices relative to the latest line (negative) to absolute ones."""
    try:
        out: list[bytes] = []
        for token in tokens:
            parts = token.split(b"/")
            for place, total in ((0, points), (1, uvs)):
                if place < len(parts) and parts[place] and int(parts[place]) < 0:
                    parts[place] = b"%d" % (total + 1 + int(parts[place]))
            out.append(b"/".join(parts[:2]))
        return out
    except ValueError as error:
        raise FurnitureError(f"{name}: has a malformed face ({error})") from error


def _corners(
    tokens: list[bytes], points: int, uvs: int, name: str
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return point and texture indices of corner tokens `p`, `p/t`, `p/t/n`, `p//n`, each parsed once."""
    spellings: dict[bytes, int] = {}
    which = np.array([spellings.setdefault(token, len(spellings)) for token in tokens], np.int64)
    table = np.empty((len(spellings), 2), np.int64)
    try:
        for row, token in enumerate(spellings):
            parts = token.split(b"/")
            table[row] = int(parts[0]) - 1, int(parts[1]) - 1 if len(parts) > 1 and parts[1] else -1
    except (ValueError, OverflowError) as error:
        raise FurnitureError(f"{name}: has a malformed face ({error})") from error
    if table[:, 0].min() < 0 or table[:, 0].max() >= points:
        raise FurnitureError(f"{name}: has faces with vertices that are not in the file (it has {points})")
    table[(table[:, 1] < 0) | (table[:, 1] >= uvs), 1] = -1
    return table[which, 0], table[which, 1]
