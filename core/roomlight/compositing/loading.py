"""Read virtual objects from GLB, glTF, OBJ and PLY files.

Files may come from strangers: what they declare is checked against `ObjectLimits` before memory is spent, and every
failure is an `ObjectError`. Of the files that one names (glTF's buffers and images, OBJ's materials) those in its own
folder and inside that are read; an object that comes as bytes has none.

| kind | read | noted and not read |
| --- | --- | --- |
| GLB, glTF | triangles, strips and fans; node transforms and instances; skins and morph targets in their pose at \
rest; normals, else flat; vertex colours; metallic-roughness and specular-glossiness materials with textures, texture \
transforms and normal maps; KHR_materials_emissive_strength, _ior, _specular, _transmission, _unlit, \
_clearcoat and _sheen; quantised, sparse, meshopt-packed and (extra `draco`) Draco-packed meshes; PNG, JPEG, WebP, \
AVIF and (extra `ktx2`) KTX2 of Basis Universal | animations, lamps, occlusion textures, other layers |
| OBJ | polygons, normals or smoothing groups, texture coordinates, vertex colours, materials with textures, clear \
coats | relief, textures of gloss, curves |
| PLY | polygons, normals, texture coordinates, colours; text and binary | texture files |

Surfaces show from both sides, whatever glTF's `doubleSided` says, but those that it blends and thin glass. glTF's glass
is tinted by its stated thickness; without one it is thin and does not bend light. Faces of OBJ and PLY files without
normals shade smoothly where they meet at less than 40 degrees. Objects without colours are grey and diffuse until
`VirtualObject.with_material` gives them a material.
"""

from dataclasses import replace
from pathlib import Path
from typing import Literal, get_args

from roomlight.compositing.objects.beside import FilesBeside
from roomlight.compositing.objects.gltf.reader import read_gltf
from roomlight.compositing.objects.limits import ObjectLimits, plain_text
from roomlight.compositing.objects.obj import read_obj
from roomlight.compositing.objects.ply import read_ply
from roomlight.compositing.objects.virtual_object import SIZE_ADVICE, VirtualObject
from roomlight.errors import ObjectError
from roomlight.notes import Note

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
        name: The object's name; None: the file's name without its ending, or "object".

    Raises:
        ObjectError: The file cannot be read, is damaged, passes a limit or has no surface; names file and rule.
    """
    if isinstance(source, bytes):
        data, label, ending, folder = source, name or "object", "", None
    else:
        path = Path(source)
        data, label, ending, folder = _read(path, limits), str(path), path.suffix.lower().lstrip("."), path.parent
        name = name or path.stem
    limits.check("file_bytes", len(data), label)
    if not data:
        raise ObjectError(f"{label}: is empty; export it again")
    file_kind = kind or _kind(data, ending, label)
    if file_kind not in get_args(ObjectKind):
        raise ObjectError(f"{label}: kind must be {', '.join(get_args(ObjectKind))}, got {file_kind!r}")
    if file_kind == "ply":
        parts, notes = read_ply(data, label, limits)
    else:
        read = read_obj if file_kind == "obj" else read_gltf
        parts, notes = read(data, label, limits, FilesBeside(folder, limits, len(data)))
    return _with_size_note(VirtualObject(name or "object", parts, notes), label)


def _with_size_note(loaded: VirtualObject, label: str) -> VirtualObject:
    """Note a size that nothing in a room has: the file counts in another unit than metres."""
    low, high = loaded.bounds()
    extent = float((high - low).max())
    if 0.005 <= extent <= 30:
        return loaded
    effect, advice = "its numbers are taken for metres", f"{SIZE_ADVICE} of its longest side in metres"
    return replace(loaded, notes=(*loaded.notes, Note(f"{label}: its size of {extent:.3g} m", effect, advice)))


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
    head = plain_text(data[:64])
    if head[:4].rstrip() == b"ply":
        return "ply"
    if head.lstrip()[:1] == b"{":
        return "gltf"
    ending = _other(data) or ending
    if ending in get_args(ObjectKind):
        return ending
    advice = f"export the .{ending} as GLB" if ending else "give kind='obj' if it is an OBJ file"
    if ending in ("zip", "7z", "rar", "tar", "gz", "tgz"):
        advice = f"unpack the .{ending}, and open the model in it"
    raise ObjectError(f"{label}: neither GLB, glTF nor PLY by its content; {advice}")


def _other(data: bytes) -> str | None:
    """Return the ending of a known format that is not read, whatever the file is called."""
    if data[:4] == b"PK\x03\x04":
        first_name = data[30 : 30 + int.from_bytes(data[26:28], "little")]
        return "usdz" if b".usd" in first_name else "zip"
    text = data[:5] == b"solid" and b"facet" in data[:1000]
    return "stl" if text or len(data) == 84 + 50 * int.from_bytes(data[80:84], "little") else None
