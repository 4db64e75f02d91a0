"""Wavefront OBJ and MTL text as arrays, with a material for each face.

Normals are recomputed later, since they are often missing in these files.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from roomlight.compositing.objects.limits import ObjectLimits, statement
from roomlight.compositing.objects.mtl import file_of_map, finite_numbers
from roomlight.compositing.objects.obj import obj_polygons
from roomlight.compositing.objects.polygons import triangles_of
from roomlight.errors import FurnitureError, ObjectError

_LIMITS: Final = ObjectLimits(triangles=3_000_000, vertices=9_000_000)
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
    try:
        file = obj_polygons(data, name, _LIMITS)
        index = triangles_of(file.sizes, file.corners[:, 0], file.points)
    except ObjectError as error:
        raise FurnitureError(str(error)) from error
    face_of = np.repeat(np.arange(len(file.sizes)), file.sizes)[index[:, 0]]
    order = np.argsort(face_of, kind="stable")
    corners = file.corners[index[order]]
    used = np.array(file.content.used, np.int32)[face_of[order]]
    names = tuple(file.content.materials)
    return Obj(
        positions=file.points,
        uvs=file.texture,
        faces=corners[..., 0],
        uv_faces=corners[..., 1],
        face_materials=np.where(used < 0, len(names), used),
        material_names=(*names, "") if (used < 0).any() else names,
        libraries=tuple(file.content.libraries),
    )


def parse_mtl(data: bytes) -> dict[str, MtlMaterial]:
    """Parse the materials of an MTL file by name. Malformed lines are skipped: a model
    with a wrong colour is still usable."""
    materials: dict[str, dict[str, object]] = {}
    current: dict[str, object] = {}
    for line in data.splitlines():
        key, *others = line.decode("utf-8", "replace").split(maxsplit=1)[:2] or [""]
        rest = others[0] if others else ""
        words = rest.split()
        if key == "newmtl":
            current = materials.setdefault(statement(line)[1], {})
        elif key == "map_Kd" and words:
            current["texture"] = file_of_map(rest)
        elif key in ("Kd", "Ks", "Ns", "d", "Tr"):
            numbers = finite_numbers(words[:3])
            if not numbers:
                continue
            values = [min(max(value, 0.0), 1.0) for value in numbers]
            if key in ("Kd", "Ks"):
                colour = tuple(values) if len(values) == 3 else (values[0],) * 3
                current["diffuse" if key == "Kd" else "specular"] = colour
            elif key == "Ns":
                current["shininess"] = max(numbers[0], 0.0)
            else:
                current["opacity"] = values[0] if key == "d" else 1 - values[0]
    return {name: MtlMaterial(name, **values) for name, values in materials.items()}  # pyright: ignore[reportArgumentType]
