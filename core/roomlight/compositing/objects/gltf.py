"""Read GLB and glTF files: JSON and accessors are checked here, and trimesh decodes the checked accessors.

What trimesh is given holds primitives alone, one a mesh, with attributes by neutral names: nodes, materials and images
are read here, so that no declaration reaches it unchecked.
"""

import json
import struct
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from pydantic import ValidationError

from roomlight.compositing.objects.gltf_materials import data_uri, read_materials
from roomlight.compositing.objects.gltf_schema import Accessor, Gltf, Node, Primitive
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.mesh_files import Parts, decode_with_trimesh
from roomlight.compositing.objects.virtual_object import TriangleMesh
from roomlight.errors import ObjectError

SUPPORTED_EXTENSIONS: Final = frozenset(
    {
        "KHR_materials_transmission",
        "KHR_materials_ior",
        "KHR_materials_specular",
        "KHR_materials_emissive_strength",
    }
)
_BYTES: Final = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_FLOAT: Final = 5126
_ATTRIBUTES: Final = {
    "POSITION": ("VEC3", {_FLOAT}),
    "NORMAL": ("VEC3", {_FLOAT}),
    "TANGENT": ("VEC4", {_FLOAT}),
    "TEXCOORD_0": ("VEC2", {_FLOAT, 5121, 5123}),
}
_TRIANGLES: Final = 4
_INT_SCALE: Final = {5121: 255.0, 5123: 65535.0, _FLOAT: 1.0}


def read_gltf(data: bytes, name: str, limits: ObjectLimits) -> Parts:
    """Read a GLB or glTF file; see `roomlight.compositing.objects.loading`. Raises ObjectError."""
    text, binary = _split(data, name)
    limits.check("json_bytes", _json_size(text), name)
    gltf = _parsed(text, name)
    views = _views(gltf, binary, name)
    placed = _placed_meshes(gltf, name, limits)
    used = sorted({(mesh, part) for mesh, _ in placed for part in _drawn(gltf, mesh)})
    if not used:
        raise ObjectError(f"{name}: no node of the scene has a mesh of triangles; there is no surface to light")
    _check_amount(gltf, placed, name, limits)
    for mesh, part in used:
        _check_primitive(gltf, gltf.meshes[mesh].primitives[part], f"{name}: mesh {mesh}, primitive {part}")
    materials = read_materials(gltf, views, name, limits)
    meshes = _decoded(gltf, used, views, name)
    parts: list[tuple[TriangleMesh, Material]] = []
    for mesh, transform in placed:
        for part in _drawn(gltf, mesh):
            index = gltf.meshes[mesh].primitives[part].material
            material = Material(base_colour=(1.0, 1.0, 1.0), metallic=1.0) if index is None else materials[index]
            try:
                parts.append((meshes[mesh, part].transformed(transform), material))
            except ObjectError as error:
                raise ObjectError(f"{name}: mesh {mesh}: {error}") from error
    return tuple(parts)


def _split(data: bytes, name: str) -> tuple[bytes, bytes | None]:
    """Return the JSON and the binary chunk of a GLB, or a glTF file's JSON."""
    if data[:4] != b"glTF":
        return data, None
    if len(data) < 20:
        raise ObjectError(f"{name}: a GLB has 20 bytes of header, this file has {len(data)}")
    version, length, size, kind = struct.unpack_from("<III4s", data, 4)
    if version != 2:
        raise ObjectError(f"{name}: GLB version 2 is read, this is {version}")
    if length != len(data):
        raise ObjectError(f"{name}: the GLB declares {length} bytes, {len(data)} are there: it is truncated")
    if kind != b"JSON" or 20 + size > len(data):
        raise ObjectError(f"{name}: the GLB's first chunk is not JSON of {size} bytes")
    text, offset = data[20 : 20 + size], 20 + size
    if offset + 8 > len(data):
        return text, None
    size, kind = struct.unpack_from("<I4s", data, offset)
    if kind != b"BIN\x00" or offset + 8 + size > len(data):
        raise ObjectError(f"{name}: the GLB's second chunk is not binary data of {size} bytes")
    return text, data[offset + 8 : offset + 8 + size]


def _json_size(text: bytes) -> int:
    """Return the bytes of the JSON without embedded data URIs, which are long by nature."""
    return len(text) - sum(len(piece) for piece in text.split(b'"') if piece[:5] == b"data:")


def _parsed(text: bytes, name: str) -> Gltf:
    try:
        gltf = Gltf.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(str(step) for step in first["loc"][:8])
        raise ObjectError(f"{name}: glTF {where or 'JSON'}: {first['msg'][:160]}") from None
    if not gltf.asset.version.startswith("2."):
        raise ObjectError(f"{name}: glTF 2 is read, this is version {gltf.asset.version[:20]!r}")
    unknown = sorted(set(gltf.extensionsRequired) - SUPPORTED_EXTENSIONS)
    if unknown:
        raise ObjectError(f"{name}: needs the extension {unknown[0][:60]!r}, which is not read; export without it")
    return gltf


def _views(gltf: Gltf, binary: bytes | None, name: str) -> list[memoryview]:
    """Return the bytes of each buffer view."""
    buffers: list[memoryview] = []
    for index, buffer in enumerate(gltf.buffers):
        if buffer.uri is not None:
            content = data_uri(buffer.uri, f"{name}: buffer {index}")
        elif index == 0 and binary is not None:
            content = binary
        else:
            raise ObjectError(f"{name}: buffer {index} is not in the file; export as one GLB file")
        if buffer.byteLength > len(content):
            raise ObjectError(f"{name}: buffer {index} declares {buffer.byteLength} bytes, {len(content)} are there")
        buffers.append(memoryview(content))
    views: list[memoryview] = []
    for index, view in enumerate(gltf.bufferViews):
        if view.buffer >= len(buffers):
            raise ObjectError(f"{name}: bufferViews.{index} names buffer {view.buffer} of {len(buffers)}")
        end = view.byteOffset + view.byteLength
        if end > len(buffers[view.buffer]):
            raise ObjectError(f"{name}: bufferViews.{index} ends at byte {end} of {len(buffers[view.buffer])}")
        views.append(buffers[view.buffer][view.byteOffset : end])
    return views


def _placed_meshes(gltf: Gltf, name: str, limits: ObjectLimits) -> list[tuple[int, Float[np.ndarray, "4 4"]]]:
    """Walk the scene's nodes; returns each placed mesh with its transform to the root."""
    limits.check("nodes", len(gltf.nodes), name)
    if gltf.scenes and gltf.scene >= len(gltf.scenes):
        raise ObjectError(f"{name}: scene {gltf.scene} of {len(gltf.scenes)} does not exist")
    children = {child for node in gltf.nodes for child in node.children}
    roots = gltf.scenes[gltf.scene].nodes if gltf.scenes else sorted(set(range(len(gltf.nodes))) - children)
    queue = [(root, np.eye(4), 1) for root in reversed(roots)]
    seen: set[int] = set()
    placed: list[tuple[int, Float[np.ndarray, "4 4"]]] = []
    while queue:
        index, above, depth = queue.pop()
        if index >= len(gltf.nodes):
            raise ObjectError(f"{name}: node {index} of {len(gltf.nodes)} does not exist")
        if index in seen:
            raise ObjectError(f"{name}: node {index} has two parents or is its own; nodes must form trees")
        seen.add(index)
        limits.check("node_depth", depth, name)
        node = gltf.nodes[index]
        transform = above @ _local(node)
        if node.mesh is not None:
            if node.mesh >= len(gltf.meshes):
                raise ObjectError(f"{name}: node {index} names mesh {node.mesh} of {len(gltf.meshes)}")
            placed.append((node.mesh, transform))
        queue.extend((child, transform, depth + 1) for child in reversed(node.children))
    return placed


def _local(node: Node) -> Float[np.ndarray, "4 4"]:
    if node.matrix is not None:
        return np.array(node.matrix, np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.rotation) / max(float(np.linalg.norm(node.rotation)), 1e-12)
    transform = np.eye(4)
    transform[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    transform[:3, :3] *= np.array(node.scale)
    transform[:3, 3] = node.translation
    return transform


def _drawn(gltf: Gltf, mesh: int) -> list[int]:
    """Return the primitives of a mesh that have a surface; points and lines have none."""
    return [index for index, one in enumerate(gltf.meshes[mesh].primitives) if one.mode >= _TRIANGLES]


def _check_amount(
    gltf: Gltf, placed: list[tuple[int, Float[np.ndarray, "4 4"]]], name: str, limits: ObjectLimits
) -> None:
    amounts: dict[int, tuple[int, int, int]] = {}
    for mesh in {mesh for mesh, _ in placed}:
        parts = vertices = corners = 0
        for index in _drawn(gltf, mesh):
            one = gltf.meshes[mesh].primitives[index]
            positions = _accessor(gltf, one.attributes.get("POSITION"), f"{name}: mesh {mesh}, POSITION").count
            indices = one.indices
            vertices += positions
            corners += positions if indices is None else _accessor(gltf, indices, f"{name}: mesh {mesh}, indices").count
            parts += 1
        amounts[mesh] = parts, vertices, corners // 3
    for place, field in enumerate(("parts", "vertices", "triangles")):
        limits.check(field, sum(amounts[mesh][place] for mesh, _ in placed), name)


def _accessor(gltf: Gltf, index: int | None, label: str) -> Accessor:
    if index is None or index >= len(gltf.accessors):
        raise ObjectError(f"{label}: accessor {index} of {len(gltf.accessors)} does not exist")
    return gltf.accessors[index]


def _check_primitive(gltf: Gltf, one: Primitive, label: str) -> None:
    """Check that each accessor that is read lies in its view and has a type that glTF allows."""
    if one.mode != _TRIANGLES:
        raise ObjectError(f"{label}: mode {one.mode} (strips, fans) is not read; export plain triangles")
    count = _accessor(gltf, one.attributes.get("POSITION"), f"{label}: POSITION").count
    for key, (shape, components) in _ATTRIBUTES.items():
        if key not in one.attributes:
            continue
        accessor = _accessor(gltf, one.attributes[key], f"{label}: {key}")
        if accessor.type != shape or accessor.componentType not in components:
            raise ObjectError(f"{label}: {key} is {accessor.type} of {accessor.componentType}, not a {shape} of floats")
        if accessor.count != count:
            raise ObjectError(f"{label}: {key} has {accessor.count} values for {count} vertices")
        _check_span(gltf, accessor, f"{label}: {key}")
    corners = count
    if one.indices is not None:
        accessor = _accessor(gltf, one.indices, f"{label}: indices")
        if accessor.type != "SCALAR" or accessor.componentType not in (5121, 5123, 5125):
            raise ObjectError(
                f"{label}: indices are {accessor.type} of {accessor.componentType}, not unsigned integers"
            )
        _check_span(gltf, accessor, f"{label}: indices")
        corners = accessor.count
    if corners % 3:
        raise ObjectError(f"{label}: {corners} corners do not make whole triangles")
    if one.material is not None and one.material >= len(gltf.materials):
        raise ObjectError(f"{label}: material {one.material} of {len(gltf.materials)} does not exist")


def _check_span(gltf: Gltf, accessor: Accessor, label: str) -> None:
    if accessor.sparse is not None or accessor.bufferView is None:
        raise ObjectError(f"{label}: sparse accessors and accessors without a buffer view are not read")
    if accessor.bufferView >= len(gltf.bufferViews):
        raise ObjectError(f"{label}: bufferViews.{accessor.bufferView} of {len(gltf.bufferViews)} does not exist")
    view = gltf.bufferViews[accessor.bufferView]
    item = _BYTES[accessor.componentType] * _COMPONENTS[accessor.type]
    stride = view.byteStride or item
    if stride < item:
        raise ObjectError(f"{label}: byteStride {stride} is less than the {item} bytes of a value")
    end = accessor.byteOffset + stride * (accessor.count - 1) + item
    if end > view.byteLength:
        raise ObjectError(f"{label}: {accessor.count} values end at byte {end} of a view of {view.byteLength}")


def _decoded(
    gltf: Gltf, used: list[tuple[int, int]], views: list[memoryview], name: str
) -> dict[tuple[int, int], TriangleMesh]:
    """Let trimesh decode the primitives, from a GLB that holds nothing else."""
    tree: dict[str, Any] = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "meshes": []}
    content = bytearray()
    places: dict[int, int] = {}

    def copied(index: int) -> int:
        if index not in places:
            accessor = gltf.accessors[index]
            source = accessor.bufferView or 0
            item = _BYTES[accessor.componentType] * _COMPONENTS[accessor.type]
            stride = gltf.bufferViews[source].byteStride or item
            view: dict[str, int] = {"buffer": 0, "byteOffset": len(content), "byteLength": item * accessor.count}
            # without what is between the values: accessors that share a view would copy all of it each
            values = np.ndarray((accessor.count, item), np.uint8, views[source], accessor.byteOffset, (stride, 1))
            content.extend(values.tobytes())
            content.extend(b"\0" * (-len(content) % 4))
            places[index] = len(tree["accessors"])
            tree["accessors"].append(
                {
                    "bufferView": len(tree["bufferViews"]),
                    "componentType": accessor.componentType,
                    "count": accessor.count,
                    "type": accessor.type,
                }
            )
            tree["bufferViews"].append(view)
        return places[index]

    for mesh, part in used:
        one = gltf.meshes[mesh].primitives[part]
        attributes = {
            "POSITION" if key == "POSITION" else f"_{key}": copied(one.attributes[key])
            for key in _ATTRIBUTES
            if key in one.attributes
        }
        primitive: dict[str, Any] = {"attributes": attributes, "mode": _TRIANGLES}
        if one.indices is not None:
            primitive["indices"] = copied(one.indices)
        tree["meshes"].append({"name": f"{mesh}-{part}", "primitives": [primitive]})
    tree["buffers"] = [{"byteLength": len(content)}]
    decoded = decode_with_trimesh(_packed(tree, bytes(content)), "glb", name)
    found: dict[tuple[int, int], TriangleMesh] = {}
    for mesh, part in used:
        label = f"{name}: mesh {mesh}, primitive {part}"
        geometry = decoded["geometry"].get(f"{mesh}-{part}")
        if geometry is None:
            raise ObjectError(f"{label}: could not be decoded")
        found[mesh, part] = _mesh(gltf, gltf.meshes[mesh].primitives[part], geometry, label)
    return found


def _packed(tree: dict[str, Any], content: bytes) -> bytes:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    length = 28 + len(text) + len(content)
    head = struct.pack("<4sIII4s", b"glTF", 2, length, len(text), b"JSON")
    return b"".join([head, text, struct.pack("<I4s", len(content), b"BIN\0"), content])


def _mesh(gltf: Gltf, one: Primitive, geometry: dict[str, Any], label: str) -> TriangleMesh:
    extra = geometry.get("vertex_attributes", {})
    vertices, faces = np.asarray(geometry["vertices"]), np.asarray(geometry["faces"])
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise ObjectError(f"{label}: an index points at vertex {faces.max()} of {len(vertices)}")
    uvs = None
    if "_TEXCOORD_0" in extra:
        scale = _INT_SCALE[gltf.accessors[one.attributes["TEXCOORD_0"]].componentType]
        uvs = np.asarray(extra["_TEXCOORD_0"], np.float32) / np.float32(scale)
    normals = np.asarray(extra["_NORMAL"], np.float32) if "_NORMAL" in extra else None
    if normals is not None and not np.isfinite(normals).all():
        raise ObjectError(f"{label}: a normal is not a finite number")
    try:
        with np.errstate(over="ignore"):
            mesh = TriangleMesh.build(vertices.astype(np.float32), faces, normals=normals, uvs=uvs)
        if "_TANGENT" in extra:
            tangents = np.asarray(extra["_TANGENT"], np.float32)
            return TriangleMesh(mesh.vertices, mesh.normals, mesh.uvs, mesh.faces, np.clip(tangents, -1, 1))
        return mesh
    except ObjectError as error:
        raise ObjectError(f"{label}: {error}") from error
