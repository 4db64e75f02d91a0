"""GLB and PLY files for tests: built by hand, so that any part can be wrong."""

import json
import struct
from typing import Any

import cv2
import numpy as np
import pytest

from present import present
from roomlight.compositing.objects.textures import Texture
from roomlight.compositing.objects.virtual_object import TriangleMesh, VirtualObject


def png(image: np.ndarray) -> bytes:
    """Encode RGB or RGBA as PNG."""
    order = [2, 1, 0, 3][: image.shape[2]]
    return cv2.imencode(".png", image[..., order])[1].tobytes()


class GltfFile:
    """A glTF tree with one buffer; change `tree` and `content` at will before `glb()`."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.tree: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            **{key: [] for key in ("nodes", "meshes", "accessors", "bufferViews", "buffers")},
        }

    def view(self, data: bytes, **extra: int) -> int:
        self.content += b"\0" * (-len(self.content) % 4)
        self.tree["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.content), "byteLength": len(data), **extra}
        )
        self.content += data
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, values: np.ndarray, kind: str, component: int) -> int:
        self.tree["accessors"].append(
            {"bufferView": self.view(values.tobytes()), "componentType": component, "count": len(values), "type": kind}
        )
        return len(self.tree["accessors"]) - 1

    def image(self, pixels: np.ndarray) -> int:
        """Add an image and its texture; returns the texture's index."""
        images, textures = self.tree.setdefault("images", []), self.tree.setdefault("textures", [])
        images.append({"bufferView": self.view(png(pixels)), "mimeType": "image/png"})
        textures.append({"source": len(images) - 1})
        return len(textures) - 1

    @property
    def primitive(self) -> dict[str, Any]:
        """The first primitive of the first mesh."""
        return self.tree["meshes"][0]["primitives"][0]

    def attribute(self, name: str, values: np.ndarray, kind: str, component: int = 5126) -> None:
        """State an attribute of the first primitive; the values are of the component's type."""
        self.primitive["attributes"][name] = self.accessor(values, kind, component)

    def material(self, **values: Any) -> int:
        self.tree.setdefault("materials", []).append(values)
        return len(self.tree["materials"]) - 1

    def mesh(self, vertices, faces, *, uvs=None, normals=None, material: int | None = None) -> int:
        attributes = {"POSITION": self.accessor(np.asarray(vertices, np.float32), "VEC3", 5126)}
        if uvs is not None:
            attributes["TEXCOORD_0"] = self.accessor(np.asarray(uvs, np.float32), "VEC2", 5126)
        if normals is not None:
            attributes["NORMAL"] = self.accessor(np.asarray(normals, np.float32), "VEC3", 5126)
        primitive: dict[str, Any] = {"attributes": attributes}
        primitive["indices"] = self.accessor(np.asarray(faces, np.uint16).reshape(-1), "SCALAR", 5123)
        if material is not None:
            primitive["material"] = material
        self.tree["meshes"].append({"primitives": [primitive]})
        return len(self.tree["meshes"]) - 1

    def quad(self, **material: Any) -> "GltfFile":
        """Add `QUAD` with coordinates and a material."""
        self.node(mesh=self.mesh(QUAD, QUAD_FACES, uvs=QUAD_UVS, material=self.material(**material)))
        return self

    def draco(self, points, faces, joints: tuple[np.ndarray, np.ndarray] | None = None, **primitive: Any) -> int:
        """Add a mesh that Draco compresses, with joints and weights [n, 4] or none; skips without the package."""
        library = pytest.importorskip("DracoPy")
        extra = {} if joints is None else {"generic_attributes": {7: joints[0], 8: joints[1]}}
        arrays = np.asarray(points, np.float64), np.asarray(faces, np.uint32)
        data = library.encode(*arrays, quantization_bits=14, **extra)
        decoded = library.decode(data)
        position = next(one for one in decoded.attributes if one["num_components"] == 3)
        ids = {"POSITION": position["unique_id"]} | ({} if joints is None else {"JOINTS_0": 7, "WEIGHTS_0": 8})
        first, attributes = len(self.tree["accessors"]), {}
        for key, (component, kind) in zip(ids, ((5126, "VEC3"), (5121, "VEC4"), (5126, "VEC4")), strict=False):
            attributes[key] = len(self.tree["accessors"])
            self.tree["accessors"].append({"componentType": component, "count": len(decoded.points), "type": kind})
        self.tree["accessors"].append({"componentType": 5125, "count": arrays[1].size, "type": "SCALAR"})
        stated = {"bufferView": self.view(data), "attributes": ids}
        extensions = {"KHR_draco_mesh_compression": stated}
        whole = {"attributes": attributes, "indices": first + len(ids), "extensions": extensions, **primitive}
        self.tree["meshes"].append({"primitives": [whole]})
        self.tree["extensionsRequired"] = self.tree["extensionsUsed"] = list(extensions)
        return len(self.tree["meshes"]) - 1

    def node(self, *, root: bool = True, **values: Any) -> int:
        self.tree["nodes"].append(values)
        if root:
            self.tree["scenes"][0]["nodes"].append(len(self.tree["nodes"]) - 1)
        return len(self.tree["nodes"]) - 1

    def glb(self) -> bytes:
        if self.tree["buffers"] == []:
            self.tree["buffers"] = [{"byteLength": len(self.content)}]
        return packed(json.dumps(self.tree).encode(), bytes(self.content))


def packed(text: bytes, content: bytes) -> bytes:
    """Make a GLB of JSON and a binary chunk."""
    text += b" " * (-len(text) % 4)
    content += b"\0" * (-len(content) % 4)
    head = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(content), len(text), b"JSON")
    return head + text + struct.pack("<I4s", len(content), b"BIN\0") + content


def ply(vertices: np.ndarray, polygons: list[list[int]], kind: str, extra: str = "", rows: list | None = None) -> bytes:
    """A PLY of polygons; `extra` is a property line of the vertices with `rows` of its values."""
    endings = {"ascii": "ascii 1.0", "<": "binary_little_endian 1.0", ">": "binary_big_endian 1.0"}
    head = f"ply\nformat {endings[kind]}\ncomment made\nelement vertex {len(vertices)}\n"
    head += "property float x\nproperty float y\nproperty float z\n" + extra
    head += f"element face {len(polygons)}\nproperty list uchar uint vertex_indices\nend_header\n"
    if kind == "ascii":
        lines = [" ".join(map(str, [*v.tolist(), *(rows[i] if rows else [])])) for i, v in enumerate(vertices)]
        lines += [" ".join(map(str, [len(one), *one])) for one in polygons]
        return (head + "\n".join(lines) + "\n").encode()
    body = b"".join(
        np.asarray(v, kind + "f4").tobytes() + (bytes(rows[i]) if rows else b"") for i, v in enumerate(vertices)
    )
    body += b"".join(bytes([len(one)]) + np.array(one, kind + "u4").tobytes() for one in polygons)
    return head.encode() + body


def face_normals(mesh: TriangleMesh) -> np.ndarray:
    """Return twice the area of each triangle along its normal."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]].astype(np.float64) for corner in range(3))
    return np.cross(b - a, c - a)


def texels(texture: Texture | None) -> np.ndarray:
    """Return the picture of a texture that is there, RGBA from 0 to 1."""
    return present(texture).texels / 65535


def shows(texture: Texture | None, pixels: np.ndarray) -> bool:
    """Whether a texture has the sRGB pixels."""
    return texture is not None and np.array_equal(texture.texels, Texture.from_srgb8(pixels).texels)


def left_out(found: VirtualObject) -> list[str]:
    """Return what the notes of an object say that was left out."""
    return [note.left_out for note in found.notes]


def area(found: VirtualObject) -> float:
    return sum(0.5 * float(np.linalg.norm(face_normals(mesh), axis=1).sum()) for mesh, _ in found.parts)


QUAD = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
QUAD_UVS = [[0, 1], [1, 1], [1, 0], [0, 0]]
QUAD_FACES = [[0, 1, 2], [0, 2, 3]]
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
CUBE_QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CUBE_FACES = [corner for a, b, c, d in CUBE_QUADS for corner in ([a, b, c], [a, c, d])]


def textured_quad() -> GltfFile:
    """A quad in z = 0 that faces +z, with every texture, under a node that moves it by (1, 2, 3)."""
    file = GltfFile()
    rng = np.random.default_rng(1)
    colour, values, normal = (rng.integers(0, 256, (8, 8, 3)).astype(np.uint8) for _ in range(3))
    normal[...] = (128, 128, 255)
    material = file.material(
        pbrMetallicRoughness={
            "baseColorFactor": [1, 0.5, 0.25, 1],
            "metallicFactor": 0.75,
            "roughnessFactor": 0.5,
            "baseColorTexture": {"index": file.image(colour)},
            "metallicRoughnessTexture": {"index": file.image(values)},
        },
        normalTexture={"index": file.image(normal), "scale": 0.5},
        emissiveTexture={"index": file.image(colour)},
        emissiveFactor=[0.5, 0, 0],
        extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 4}, "KHR_materials_ior": {"ior": 1.4}},
    )
    mesh = file.mesh(QUAD, QUAD_FACES, uvs=QUAD_UVS, normals=[[0, 0, 1]] * 4, material=material)
    file.node(mesh=mesh, translation=[1, 2, 3])
    return file
