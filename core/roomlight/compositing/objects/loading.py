"""Read virtual objects from GLB, glTF, OBJ and PLY files.

Files may come from strangers: what they declare is checked against `ObjectLimits` before memory is spent, and every
failure is an `ObjectError`. Nothing outside the file is read: glTF's buffers and images must be inside it.

| kind | read | not read |
| --- | --- | --- |
| GLB, glTF | triangles, node transforms, metallic-roughness materials with textures and normal maps, \
KHR_materials_emissive_strength, _ior, _specular and _transmission (factors) | skins, animations, morph targets, \
vertex colours, sparse accessors, Draco, texture transforms, samplers (textures repeat) |
| OBJ | vertices, normals, texture coordinates, polygons | materials, groups, relative (negative) indices |
| PLY | vertices, normals, faces; text and binary | colours |

OBJ and PLY objects are grey and diffuse until `VirtualObject.with_material` gives them a material.
"""

from pathlib import Path
from typing import Literal, get_args

from roomlight.compositing.objects.gltf import read_gltf
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.compositing.objects.mesh_files import read_obj, read_ply
from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.errors import ObjectError

ObjectKind = Literal["glb", "gltf", "obj", "ply"]
DEFAULT_LIMITS = ObjectLimits()


def load_object(
    source: str | Path | bytes,
    kind: ObjectKind | None = None,
    limits: ObjectLimits = DEFAULT_LIMITS,
    *,
    name: str | None = None,
) -> VirtualObject:
    """Read an object from a file or from its bytes.

    Args:
        source: A path, or the file's content.
        kind: The format; None: known from the content, or from the path's ending.
        limits: What is refused.
        name: The object's name; None: the file's name without its ending, or "object".

    Raises:
        ObjectError: The file cannot be read, is damaged, passes a limit or has no surface; names file and rule.
    """
    if isinstance(source, bytes):
        data, label, ending = source, name or "object", ""
    else:
        path = Path(source)
        data, label, ending = _read(path, limits), str(path), path.suffix.lower().lstrip(".")
        name = name or path.stem
    limits.check("file_bytes", len(data), label)
    found = kind or _kind(data, ending, label)
    if found not in get_args(ObjectKind):
        raise ObjectError(f"{label}: kind must be {', '.join(get_args(ObjectKind))}, got {found!r}")
    if found in ("glb", "gltf"):
        parts = read_gltf(data, label, limits)
    else:
        parts = (read_obj if found == "obj" else read_ply)(data, label, limits)
    return VirtualObject(name or "object", parts)


def _read(path: Path, limits: ObjectLimits) -> bytes:
    try:
        size = path.stat().st_size
        limits.check("file_bytes", size, str(path))
        return path.read_bytes()
    except OSError as error:
        raise ObjectError(f"{path}: cannot be read ({error.strerror or error})") from error


def _kind(data: bytes, ending: str, label: str) -> str:
    if data[:4] == b"glTF":
        return "glb"
    if data[:4].rstrip() == b"ply":
        return "ply"
    if data.lstrip()[:1] == b"{":
        return "gltf"
    if ending in get_args(ObjectKind):
        return ending
    raise ObjectError(f"{label}: neither GLB, glTF nor PLY by its content; give kind='obj' if it is an OBJ file")
