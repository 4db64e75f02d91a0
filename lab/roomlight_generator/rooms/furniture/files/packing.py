"""Compact encoding of meshes: positions and texture coordinates in 16 bits, normals in 2 x 8, LZMA compressed.

Positions are quantised over the bounding box (a 2 m sofa to 0.03 mm), texture coordinates over their range. Normals are
octahedral (Cigolle et al. 2014), to 1 degree. Texture images are stored elsewhere and referred to by number.
"""

import json
import lzma
import struct
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int, Shaped, UInt8

from roomlight.errors import FurnitureError
from roomlight_generator.rooms.scene import Material, Mesh, Texture

_FILTERS: Final = [{"id": lzma.FILTER_LZMA2, "preset": 6, "lc": 1, "pb": 1}]
_MAX_CODE: Final = 65535


def pack_mesh(mesh: Mesh, texture_number: Callable[[Texture], int]) -> bytes:
    """Encode a mesh.

    Raises:
        ValueError: the mesh has more vertices than 16 bits can index.
    """
    if len(mesh.vertices) > _MAX_CODE:
        raise ValueError(f"a mesh of {len(mesh.vertices)} vertices does not fit 16 bits")
    order, faces = _in_order_of_use(mesh.faces[np.argsort(mesh.face_materials, kind="stable")])
    vertices, uvs, normals = mesh.vertices[order], mesh.uvs[order], mesh.normals[order]
    head = {
        "v": len(vertices),
        "counts": np.bincount(mesh.face_materials, minlength=len(mesh.materials)).tolist(),
        "box": [vertices.min(0).tolist(), vertices.max(0).tolist()],
        "uv": [uvs.min(0).tolist(), uvs.max(0).tolist()],
        "materials": [_material_record(material, texture_number) for material in mesh.materials],
    }
    text = json.dumps(head, separators=(",", ":")).encode()
    # Each index is stored as its distance from the newest one so far: mostly 0, 1 and small numbers.
    flat = faces.ravel().astype(np.int64)
    newest = np.maximum.accumulate(np.concatenate([[-1], flat]))[:-1]
    body = [
        _byte_planes(_delta(_quantised(vertices))),
        _byte_planes(_delta(_quantised(uvs))),
        _octahedral(normals).T.tobytes(),
        _byte_planes((newest + 1 - flat).astype(np.uint16)[:, None]),
    ]
    packed = lzma.compress(b"".join(body), format=lzma.FORMAT_RAW, filters=_FILTERS)
    return struct.pack("<II", len(text), sum(map(len, body))) + text + packed


def unpack_mesh(data: bytes, textures: Mapping[int, Texture] | Callable[[int], Texture], where: str) -> Mesh:
    """Decode the bytes of `pack_mesh`.

    Raises:
        FurnitureError: the bytes are damaged; the message starts with `where`.
    """
    fetch = textures if callable(textures) else textures.__getitem__
    try:
        length, size = struct.unpack_from("<II", data)
        head = json.loads(data[8 : 8 + length])
        body = lzma.decompress(data[8 + length :], format=lzma.FORMAT_RAW, filters=_FILTERS)
        if len(body) != size:
            raise ValueError(f"{len(body)} bytes instead of {size}")
        count, triangles = int(head["v"]), sum(head["counts"])
        at = np.cumsum([0, 6 * count, 4 * count, 2 * count, 6 * triangles])
        parts = [body[start:end] for start, end in pairwise(at)]
        deltas = _from_byte_planes(parts[3], 1)[:, 0].astype(np.int64)
        # A distance of 0 is a new vertex: the newest index counts them.
        faces = np.cumsum(deltas == 0) - deltas
        faces -= np.where(deltas == 0, 1, 0)
        if faces.min() < 0 or faces.max() >= count:
            raise ValueError("a face refers to a missing vertex")
        materials = tuple(_material(record, fetch) for record in head["materials"])
        face_materials = np.repeat(np.arange(len(materials), dtype=np.int32), head["counts"])
        return Mesh(
            vertices=_restored(np.cumsum(_from_byte_planes(parts[0], 3), axis=0, dtype=np.uint16), head["box"]),
            normals=_from_octahedral(np.frombuffer(parts[2], np.uint8).reshape(2, -1).T),
            uvs=_restored(np.cumsum(_from_byte_planes(parts[1], 2), axis=0, dtype=np.uint16), head["uv"]),
            faces=faces.reshape(-1, 3).astype(np.int32),
            face_materials=face_materials,
            materials=materials,
        )
    except (ValueError, KeyError, IndexError, TypeError, struct.error, lzma.LZMAError) as error:
        raise FurnitureError(f"{where} is damaged ({error})") from error


def _in_order_of_use(faces: Int[np.ndarray, "f 3"]) -> tuple[Int[np.ndarray, " v"], Int[np.ndarray, "f 3"]]:
    """Return the old indices of the used vertices, in the order in which faces first use them; and faces by new
    indices."""
    used, first, index = np.unique(faces.ravel(), return_index=True, return_inverse=True)
    rank = np.empty(len(used), np.int64)
    order = np.argsort(first)
    rank[order] = np.arange(len(used))
    return used[order], rank[index].reshape(-1, 3)


def _quantised(values: Float[np.ndarray, "n c"]) -> Shaped[np.ndarray, "n c"]:
    low, high = values.min(0).astype(np.float64), values.max(0).astype(np.float64)
    return np.rint((values - low) / np.maximum(high - low, 1e-12) * _MAX_CODE).astype(np.uint16)


def _restored(steps: Shaped[np.ndarray, "n c"], box: list[list[float]]) -> Float[np.ndarray, "n c"]:
    low, high = np.array(box[0]), np.array(box[1])
    return (low + steps * ((high - low) / _MAX_CODE)).astype(np.float32)


def _delta(values: Shaped[np.ndarray, "n c"]) -> Shaped[np.ndarray, "n c"]:
    return np.diff(values, axis=0, prepend=np.zeros((1, values.shape[1]), np.uint16))


def _byte_planes(values: Shaped[np.ndarray, "n c"]) -> bytes:
    """Return all low bytes column by column, then all high bytes: similar bytes compress better together."""
    data = np.ascontiguousarray(values.T.astype("<u2"))
    return data.view(np.uint8).reshape(*data.shape, 2).transpose(2, 0, 1).tobytes()


def _from_byte_planes(data: bytes, columns: int) -> Shaped[np.ndarray, "n columns"]:
    planes = np.frombuffer(data, np.uint8).reshape(2, columns, -1)
    return (planes[0].astype(np.uint16) | planes[1].astype(np.uint16) << 8).T


def _octahedral(normals: Float[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "n 2"]:
    flat = normals / np.maximum(np.abs(normals).sum(1, keepdims=True), 1e-12)
    folded = (1 - np.abs(flat[:, [2, 0]])) * np.where(flat[:, [0, 2]] >= 0, 1, -1)
    plane = np.where(flat[:, 1:2] >= 0, flat[:, [0, 2]], folded)
    return np.rint((plane + 1) * 127).astype(np.uint8)


def _from_octahedral(codes: UInt8[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    plane = codes.astype(np.float32) / 127 - 1
    y = 1 - np.abs(plane).sum(1)
    folded = (1 - np.abs(plane[:, ::-1])) * np.where(plane >= 0, 1, -1)
    plane = np.where(y[:, None] >= 0, plane, folded)
    normals = np.stack([plane[:, 0], y, plane[:, 1]], 1)
    return (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)


def _material_record(material: Material, number: Callable[[Texture], int]) -> list[Any]:
    return [
        material.name[:40],
        [round(value, 4) for value in material.albedo],
        None if material.texture is None else number(material.texture),
        None if material.roughness is None else round(material.roughness, 3),
        round(material.mirror, 3),
        material.glass,
    ]


def _material(record: list[Any], fetch: Callable[[int], Texture]) -> Material:
    name, albedo, texture, roughness, mirror, glass = record
    return Material(
        name=str(name),
        albedo=(float(albedo[0]), float(albedo[1]), float(albedo[2])),
        texture=None if texture is None else fetch(int(texture)),
        roughness=None if roughness is None else float(roughness),
        mirror=float(mirror),
        glass=bool(glass),
    )
