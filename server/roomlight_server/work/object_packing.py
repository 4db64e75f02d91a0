"""Virtual objects as plain numbers, between a decoding process and the server."""

from dataclasses import asdict, fields
from typing import Any, Final

import numpy as np

from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.textures import Texture
from roomlight.compositing.objects.virtual_object import TriangleMesh, VirtualObject
from roomlight.notes import Note

_TEXTURES: Final = tuple(field.name for field in fields(Material) if field.name.endswith("_texture"))
_MESH: Final = (("vertices", "<f4", 3), ("normals", "<f4", 3), ("uvs", "<f4", 2), ("faces", "<i4", 3))


def pack_object(body: bytes, kind: str | None, limits: dict[str, int]) -> tuple[dict[str, Any], bytes]:
    """Load an object; return it as JSON values and the bytes of its arrays.

    Raises:
        ObjectError: The file is refused.
    """
    from roomlight.compositing.loading import load_object  # the server itself loads none

    virtual = load_object(body, kind, ObjectLimits(**limits))  # pyright: ignore[reportArgumentType]  (it checks the kind)
    textures: dict[Texture, int] = {}
    parts: list[dict[str, Any]] = []
    arrays: list[np.ndarray] = []
    for mesh, material in virtual.parts:
        arrays += [np.ascontiguousarray(getattr(mesh, name), kind) for name, kind, _ in _MESH]
        if mesh.tangents is not None:
            arrays.append(np.ascontiguousarray(mesh.tangents, "<f4"))
        values = {field.name: getattr(material, field.name) for field in fields(Material)}
        for name in _TEXTURES:
            if values[name] is not None:
                values[name] = textures.setdefault(values[name], len(textures))
        counts = [len(mesh.vertices), len(mesh.faces)]
        parts.append({"counts": counts, "tangents": mesh.tangents is not None, "material": values})
    arrays += [np.ascontiguousarray(texture.texels, "<u2") for texture in textures]
    sizes = [(*texture.texels.shape[:2], texture.clamped, texture.by_triangle) for texture in textures]
    notes = [asdict(note) for note in virtual.notes]
    return {"parts": parts, "textures": sizes, "notes": notes}, b"".join(array.tobytes() for array in arrays)


def unpack_object(text: dict[str, Any], data: bytes | memoryview) -> VirtualObject:
    """Return the object of `pack_object` with arrays of its own; indices and coordinates are checked again.

    Raises:
        ObjectError: A mesh is damaged.
        ValueError: The sizes do not fit the data.
    """
    at = 0

    def take(kind: str, *shape: int) -> np.ndarray:
        nonlocal at
        count = int(np.prod(shape))
        array = np.frombuffer(data, kind, count, at).reshape(shape).copy()
        at += array.nbytes
        return array

    meshes: list[TriangleMesh] = []
    for part in text["parts"]:
        vertices, faces = part["counts"]
        virtual = {name: take(kind, faces if name == "faces" else vertices, width) for name, kind, width in _MESH}
        tangents = take("<f4", vertices, 4) if part["tangents"] else None
        meshes.append(TriangleMesh(**virtual, tangents=tangents))
    textures = [Texture(take("<u2", *size, 4), (across, down), own) for *size, (across, down), own in text["textures"]]
    materials = [_material(part["material"], textures) for part in text["parts"]]
    notes = tuple(Note(**note) for note in text["notes"])
    return VirtualObject("object", tuple(zip(meshes, materials, strict=True)), notes)


def _material(values: dict[str, Any], textures: list[Texture]) -> Material:
    made: dict[str, Any] = dict(values)
    for name in ("base_colour", "emissive", "sheen"):
        made[name] = tuple(values[name])
    for name in _TEXTURES:
        if made[name] is not None:
            made[name] = textures[made[name]]
    return Material(**made)


def object_bytes(virtual: VirtualObject) -> int:
    """Return the memory of an object's arrays."""
    total = 0
    seen: set[int] = set()
    for mesh, material in virtual.parts:
        arrays = [mesh.vertices, mesh.normals, mesh.uvs, mesh.faces, mesh.tangents]
        total += sum(array.nbytes for array in arrays if array is not None)
        for name in _TEXTURES:
            texture = getattr(material, name)
            if texture is not None and id(texture) not in seen:
                seen.add(id(texture))
                total += texture.texels.nbytes
    return total
