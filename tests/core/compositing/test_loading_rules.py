"""Objects are read as viewers read them: shading, polygons, colours, extensions, lenient files; the rest is noted."""

import io
import struct
from typing import Any

import cv2
import numpy as np
import pytest
from gltf_files import (
    CUBE,
    CUBE_FACES,
    CUBE_QUADS,
    QUAD,
    QUAD_FACES,
    QUAD_UVS,
    GltfFile,
    area,
    face_normals,
    ply,
    shows,
    texels,
    textured_quad,
)
from jaxtyping import UInt8
from PIL import Image

from present import present
from roomlight.compositing.loading import load_object
from roomlight.compositing.objects.gltf import ktx2, materials
from roomlight.compositing.objects.gltf.materials import metal_of
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.textures import Texture
from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.compositing.rendering.tracer import TracedObjects
from roomlight.errors import ObjectError

L_SHAPE = [[0, 0, 0], [2, 0, 0], [2, 0, -1], [1, 0, -1], [1, 0, -2], [0, 0, -2]]
ARROW = [[0, 0, 0], [2, 0, 0], [0.5, 0, -0.5], [0, 0, -2]]


def bend_deg(one: VirtualObject) -> float:
    """The largest angle between a corner's normal and its face's."""
    ((mesh, _),) = one.parts
    unit = face_normals(mesh) / np.linalg.norm(face_normals(mesh), axis=1, keepdims=True)
    return float(np.degrees(np.arccos(np.clip((mesh.normals[mesh.faces] * unit[:, None]).sum(-1), -1, 1))).max())


def cube_gltf(material: dict | None = None, **extra: object) -> GltfFile:
    file = GltfFile()
    number = None if material is None else file.material(**material)
    file.node(mesh=file.mesh(CUBE, CUBE_FACES, material=number))
    file.tree.update(extra)
    return file


# Shading and polygons


def test_gltf_without_normals_is_flat() -> None:
    plain, coloured, without_length = cube_gltf(), cube_gltf(), cube_gltf()
    coloured.attribute("COLOR_0", np.linspace(0, 1, 24, dtype=np.float32).reshape(8, 3), "VEC3")
    without_length.attribute("NORMAL", np.zeros((8, 3), np.float32), "VEC3")
    for file in (plain, coloured, without_length):
        assert bend_deg(load_object(file.glb())) < 0.01


def obj_of(vertices: np.ndarray, faces: list[list[int]], before: str = "") -> bytes:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [before]
    return "\n".join([*lines, *("f " + " ".join(str(i + 1) for i in face) for face in faces)]).encode()


def sphere(steps: int) -> tuple[np.ndarray, list[list[int]]]:
    across = 2 * steps
    turns, tilts = np.meshgrid(np.arange(across) * np.pi / steps, np.linspace(0.05, np.pi - 0.05, steps + 1))
    points = np.stack([np.sin(tilts) * np.cos(turns), np.cos(tilts), np.sin(tilts) * np.sin(turns)], axis=-1)
    corner = np.arange(across * (steps + 1)).reshape(steps + 1, across)
    beside = np.roll(corner, -1, axis=1)
    quads = np.stack([corner[:-1], beside[:-1], beside[1:], corner[1:]], axis=-1)
    return points.reshape(-1, 3), quads.reshape(-1, 4).tolist()


@pytest.mark.parametrize("kind", ["obj", "ascii", "<", ">"])
def test_cubes_are_sharp_and_scans_are_smooth(kind: str) -> None:
    for (points, quads), sharp in (((CUBE, CUBE_QUADS), True), (sphere(10), False)):
        data = obj_of(points, quads) if kind == "obj" else ply(np.asarray(points), quads, kind)
        one = load_object(data, "obj" if kind == "obj" else None)
        if sharp:
            assert bend_deg(one) < 0.01
            assert area(one) == pytest.approx(6)
        else:
            ((mesh, _),) = one.parts
            outward = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
            assert np.abs((mesh.normals * outward).sum(1)).min() > np.cos(np.radians(10))  # the open rims


def test_smoothing_groups_decide_in_obj() -> None:
    assert bend_deg(load_object(obj_of(CUBE, CUBE_QUADS, "s 1"), "obj")) == pytest.approx(54.7, abs=12)
    points, quads = sphere(10)
    assert bend_deg(load_object(obj_of(points, quads, "s off"), "obj")) < 2  # quads bend a little


@pytest.mark.parametrize(("shape", "size"), [(L_SHAPE, 3), (ARROW, 1)])
@pytest.mark.parametrize("way", [1, -1])
def test_concave_polygons_are_cut_within_their_outline(shape: list[list[float]], size: float, way: int) -> None:
    for start in range(len(shape)):
        outline = list(np.roll(range(len(shape)), start))[::way]
        one = load_object(obj_of(np.array(shape), [outline]), "obj")
        assert area(one) == pytest.approx(size)
        assert face_normals(one.parts[0][0]).sum(0)[1] * way > 0
        for kind in ("ascii", "<"):
            assert area(load_object(ply(np.array(shape), [outline], kind))) == pytest.approx(size)


@pytest.mark.parametrize("kind", ["ascii", "<", ">"])
def test_ply_of_quads_and_triangles_with_colours(kind: str) -> None:
    points = np.array([*QUAD, [2, 0, 0], [3, 0, 0]])
    extra = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    one = load_object(ply(points, [[0, 1, 2, 3], [1, 4, 2], [4, 5, 2]], kind, extra, [[255, 0, 0]] * 6))
    assert area(one) == pytest.approx(2.0)
    ((_, material),) = one.parts
    assert material.base_colour == pytest.approx((1, 0, 0))


def test_ply_with_windows_line_ends_edges_and_corner_coordinates() -> None:
    head = b"ply\r\nformat ascii 1.0\r\ncomment TextureFile a.png\r\nelement vertex 3\r\n"
    head += b"property double x\r\nproperty double y\r\nproperty double z\r\nelement face 1\r\n"
    head += b"property list uchar int vertex_index\r\nproperty list uchar float texcoord\r\n"
    head += b"element edge 1\r\nproperty int vertex1\r\nproperty int vertex2\r\nend_header\r\n"
    one = load_object(head + b"0 0 0\r\n1 0 0\r\n0 1 0\r\n3 0 1 2 6 0 0 1 0 0 1\r\n0 1\r\n")
    ((mesh, _),) = one.parts
    np.testing.assert_allclose(mesh.uvs, [[0, 1], [1, 1], [0, 0]])
    assert "a.png" in one.notes[0].left_out


@pytest.mark.parametrize("kind", ["ascii", "<"])
def test_ply_headers_of_old_macs_end_lines_by_carriage_returns(kind: str) -> None:
    points = np.array(QUAD, np.float32)
    points[0] = np.frombuffer(b"\x0a\0\0\0" * 3, "<f4")  # binary that begins with a line feed
    head, mark, body = ply(points, QUAD_FACES, kind).partition(b"end_header\n")
    data = (head + mark).replace(b"\n", b"\r") + (body if kind == "<" else body.replace(b"\n", b"\r"))
    assert area(load_object(data)) == pytest.approx(1)


def test_obj_of_spreadsheets_and_scanners() -> None:
    """A byte order mark, Windows line ends, tabs, negative indices, colours and a continued line."""
    text = "\ufeffmtllib a.mtl\r\nv\t0 0 0 1 0 0\r\nv 1 0 0 1 0 0\r\nv 1 1 0 1 0 0\r\nv 0 1 0 1 0 0\r\n"
    text += "f -4 -3 \\\r\n -2 -1\r\n"
    one = load_object(text.encode(), "obj")
    assert area(one) == pytest.approx(1)
    assert one.parts[0][1].base_colour == pytest.approx((1, 0, 0))
    assert "a.mtl" in one.notes[0].left_out


# Vertex colours


def test_vertex_colours_interpolate_as_triangles_do() -> None:
    file = GltfFile().quad()
    colours = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], np.float32)
    file.attribute("COLOR_0", colours, "VEC3")
    ((made, material),) = load_object(file.glb()).parts
    picture = texels(material.base_colour_texture)[..., :3]
    for face, original in zip(made.faces, QUAD_FACES, strict=True):
        for weights in ([1, 0, 0], [0, 0, 1], [0.2, 0.3, 0.5], [0.4, 0.4, 0.2]):
            u, v = np.array(weights) @ made.uvs[face]
            found = bilinear(picture, u, v)
            np.testing.assert_allclose(found, np.array(weights) @ colours[original], atol=0.02)


def bilinear(picture: np.ndarray, u: float, v: float) -> np.ndarray:
    x, y = u * picture.shape[1] - 0.5, v * picture.shape[0] - 0.5
    i, j = int(np.floor(x)), int(np.floor(y))
    p, q = x - i, y - j
    rows, columns = np.array([j, j + 1]) % picture.shape[0], np.array([i, i + 1]) % picture.shape[1]
    return np.einsum("r,c,rck->k", [1 - q, q], [1 - p, p], picture[rows[:, None], columns])


def test_one_vertex_colour_is_a_factor_and_several_on_a_texture_are_noted() -> None:
    for colours, noted in ((np.full((4, 4), 32767, np.uint16), False), (np.eye(4, dtype=np.float32), True)):
        file = textured_quad()
        file.attribute("COLOR_0", colours, "VEC4", 5126 if noted else 5123)
        file.tree["accessors"][-1]["normalized"] = not noted
        one = load_object(file.glb())
        tint = np.eye(3)[[0, 1, 2, 0, 2]].sum(0) / 6 if noted else np.full(3, 0.5)  # corners of two triangles
        assert one.parts[0][1].base_colour == pytest.approx(tint * [1, 0.5, 0.25], abs=1e-3)
        assert any("vertex colours" in note.left_out for note in one.notes) == noted


# Materials


def material_of(material: dict, **extra: object) -> tuple[Material, VirtualObject]:
    one = load_object(cube_gltf(material, **extra).glb())
    return one.parts[0][1], one


def test_specular_glossiness_is_converted() -> None:
    glossy = {"diffuseFactor": [0.1, 0.2, 0.7, 0.5], "specularFactor": [0.04, 0.04, 0.04], "glossinessFactor": 0.3}
    plastic, _ = material_of({"extensions": {"KHR_materials_pbrSpecularGlossiness": glossy}})
    assert plastic.base_colour == pytest.approx((0.1, 0.2, 0.7))
    assert (plastic.metallic, plastic.roughness, plastic.opacity) == (0, pytest.approx(0.7), 1)
    gold = {"diffuseFactor": [0, 0, 0, 1], "specularFactor": [1, 0.77, 0.34], "glossinessFactor": 1}
    metal, _ = material_of({"extensions": {"KHR_materials_pbrSpecularGlossiness": gold}})
    assert metal.metallic == pytest.approx(1, abs=0.01)
    assert metal.base_colour == pytest.approx((1, 0.77, 0.34), abs=0.02)


def test_specular_glossiness_with_textures_is_converted_by_texel() -> None:
    file = GltfFile()
    diffuse = np.zeros((4, 4, 4), np.uint8)
    diffuse[:, :2] = (40, 80, 200, 128)
    specular = np.full((4, 4, 4), 57, np.uint8)  # sRGB of 0.04
    specular[:, 2:, :3], specular[..., 3] = 255, 51
    glossy = {
        "diffuseTexture": {"index": file.image(diffuse)},
        "specularGlossinessTexture": {"index": file.image(specular)},
    }
    file.quad(extensions={"KHR_materials_pbrSpecularGlossiness": glossy})
    ((_, material),) = load_object(file.glb()).parts
    base, values = texels(material.base_colour_texture), texels(material.metallic_roughness_texture)
    np.testing.assert_allclose(base[0, 0, :3], texels(Texture.from_srgb8(diffuse))[0, 0, :3], atol=0.01)
    np.testing.assert_allclose(base[0, 3, :3], 1, atol=0.01)
    np.testing.assert_array_equal(base[..., 3:], 1)  # opaque without an alphaMode
    np.testing.assert_allclose(values[0, [0, 3], 2], [0, 1], atol=0.02)
    np.testing.assert_allclose(values[..., 1], 0.8, atol=0.01)


def test_converted_metals_reflect_what_was_stated() -> None:
    rng = np.random.default_rng(0)
    specular = np.array([[0.9, 0.6, 0.3], [0.5, 0.5, 0.5], [0.04, 0.04, 0.04]])
    base, metallic = metal_of(np.zeros((3, 3)), specular)
    reflected = 0.04 * (1 - metallic[:, None]) + base * metallic[:, None]
    np.testing.assert_allclose(reflected, specular, atol=0.06)
    base, metallic = metal_of(rng.uniform(0, 1, (50, 3)), rng.uniform(0, 1, (50, 3)))
    assert ((base >= 0) & (base <= 1)).all()
    assert ((metallic >= 0) & (metallic <= 1)).all()


@pytest.mark.parametrize(
    ("ior", "colour", "reflectance"),
    [(0, 0.04, 0.04), (1000, 0.04, 0.04), (1000, 1, 0.996), (0, 1, 0.996), (1.5, 1, 0.04), (1.5, 0.25, 0.01),
     (2.4, 1, 0.1696)],
)  # fmt: skip
def test_reflectance_at_normal_incidence(ior: float, colour: float, reflectance: float) -> None:
    specular = {"specularColorFactor": [colour] * 3}
    material, _ = material_of({"extensions": {"KHR_materials_ior": {"ior": ior}, "KHR_materials_specular": specular}})
    assert ((material.ior - 1) / (material.ior + 1)) ** 2 == pytest.approx(reflectance, rel=0.01)


def test_unlit_surfaces_emit_their_colour() -> None:
    file = GltfFile()
    texture = {"index": file.image(np.full((2, 2, 3), 255, np.uint8))}
    surface = {"baseColorFactor": [0.5, 0.25, 1, 1], "baseColorTexture": texture}
    file.quad(pbrMetallicRoughness=surface, extensions={"KHR_materials_unlit": {}})
    ((_, material),) = load_object(file.glb()).parts
    assert material.emissive == (0.5, 0.25, 1)
    assert material.emissive_texture is material.base_colour_texture
    assert material.base_colour == (0, 0, 0)
    assert material.specular == 0


def test_texture_transforms_move_the_coordinates() -> None:
    file = textured_quad()
    material = file.tree["materials"][0]
    moved = {"offset": [0.5, 0.25], "scale": [0.5, 2.0], "rotation": float(np.pi / 2)}
    for owner in (material, material["pbrMetallicRoughness"]):
        for key in owner:
            if key.endswith("Texture"):
                owner[key]["extensions"] = {"KHR_texture_transform": moved}
    one = load_object(file.glb())
    uvs = np.array(QUAD_UVS, np.float64) * [0.5, 2.0]
    np.testing.assert_allclose(one.parts[0][0].uvs, np.stack([uvs[:, 1] + 0.5, -uvs[:, 0] + 0.25], axis=1), atol=1e-6)
    assert one.notes == ()


def test_textures_of_other_coordinates_are_resampled_or_replaced_by_their_mean() -> None:
    rng = np.random.default_rng(3)
    colour, glow = (cv2.resize(rng.integers(0, 255, (3, 3, 3), np.uint8), (16, 16)) for _ in range(2))
    for transform, kept in (({"scale": [2, 3]}, True), ({"scale": [0.5, 0.5]}, False), ({"texCoord": 1}, False)):
        file = GltfFile()
        moved = {"index": file.image(glow), "extensions": {"KHR_texture_transform": transform}}
        base = {"baseColorTexture": {"index": file.image(colour)}}
        one = load_object(file.quad(pbrMetallicRoughness=base, emissiveTexture=moved, emissiveFactor=[1] * 3).glb())
        ((_, material),) = one.parts
        original = texels(Texture.from_srgb8(glow))[..., :3]
        if kept:
            picture = texels(material.emissive_texture)[..., :3]
            for u, v in rng.uniform(0, 1, (20, 2)):
                wanted = bilinear(original, (2 * u) % 1, (3 * v) % 1)
                np.testing.assert_allclose(bilinear(picture, u, v), wanted, atol=0.1)
            assert one.notes == ()
        else:
            assert material.emissive_texture is None
            np.testing.assert_allclose(material.emissive, original.mean(axis=(0, 1)), atol=2e-3)
            assert "emissive texture" in one.notes[0].left_out


def test_textures_that_repeat_often_are_reduced_by_area() -> None:
    file, values = GltfFile(), np.zeros((8, 1024, 3), np.uint8)
    values[:, ::2] = 255
    moved = {"extensions": {"KHR_texture_transform": {"scale": [32, 2]}}}
    base: dict[str, Any] = {"baseColorTexture": {"index": file.image(values)}}
    base["metallicRoughnessTexture"] = {"index": file.image(values), **moved}
    emissive = {"emissiveTexture": {"index": file.image(values), **moved}, "emissiveFactor": [1] * 3}
    material = load_object(file.quad(pbrMetallicRoughness=base, **emissive).glb()).parts[0][1]
    rough, glow = texels(material.metallic_roughness_texture), texels(material.emissive_texture)
    assert rough.shape == glow.shape == (16, 2048, 4)
    np.testing.assert_allclose(rough[..., :3], 0.5, atol=0.01)
    np.testing.assert_allclose(glow[..., :3], 0.5, atol=0.01)  # of the light, not of its code


def test_a_tiled_texture_of_several_materials_is_stored_once(monkeypatch: pytest.MonkeyPatch) -> None:
    file = GltfFile()
    colour, relief = (file.image(np.full((4, 4, 3), value, np.uint8)) for value in (0, 128))
    moved = {"extensions": {"KHR_texture_transform": {"scale": [4, 4]}}}
    for _ in range(2):
        base = {"baseColorTexture": {"index": colour}}
        file.quad(pbrMetallicRoughness=base, normalTexture={"index": relief, **moved})
    (_, first), (_, second) = load_object(file.glb()).parts
    assert first.normal_texture is second.normal_texture is not None
    file.tree["materials"][1]["normalTexture"] = {"index": colour, **moved}
    monkeypatch.setattr(materials, "_REPEATED_TEXELS", 16 * 16)
    one = load_object(file.glb())
    assert [material.normal_texture is None for _, material in one.parts] == [False, True]
    assert [note.effect for note in one.notes] == ["the surface is plain there"]


def quad_of_picture(data: bytes, extension: str) -> bytes:
    file = textured_quad()
    file.tree["images"].append({"bufferView": file.view(data)})
    file.tree["textures"][0] = {"extensions": {extension: {"source": len(file.tree["images"]) - 1}}}
    file.tree["extensionsRequired"] = file.tree["extensionsUsed"] = [extension]
    return file.glb()


def test_webp_is_read() -> None:
    stream = io.BytesIO()
    Image.fromarray(np.full((8, 8, 3), 200, np.uint8)).save(stream, "WEBP", lossless=True)
    one = load_object(quad_of_picture(stream.getvalue(), "EXT_texture_webp"))
    assert shows(one.parts[0][1].base_colour_texture, np.full((8, 8, 3), 200, np.uint8))


def basis_ktx2(colours: UInt8[np.ndarray, "h w 4"]) -> bytes:
    """A KTX2 file of UASTC blocks (4 x 4 pixels) of one colour each: mode 8 of Basis Universal's specification."""
    rows, columns = colours.shape[:2]
    blocks = b"".join(
        (0x17 | int.from_bytes(bytes(colour), "little") << 5).to_bytes(16, "little")
        for colour in colours.reshape(-1, 4)
    )
    sample = struct.pack("<IIII", 127 << 16 | 3 << 24, 0, 0, 0xFFFFFFFF)
    basic = struct.pack("<II", 0, 2 | 40 << 16) + bytes([166, 1, 2, 0, 3, 3, 0, 0, 16, *[0] * 7]) + sample
    described = struct.pack("<I", 4 + len(basic)) + basic
    sizes = struct.pack("<9I", 0, 1, 4 * columns, 4 * rows, 0, 0, 1, 1, 0)
    at = -(-(104 + len(described)) // 16) * 16
    index = struct.pack("<4I2Q3Q", 104, len(described), 0, 0, 0, 0, at, len(blocks), len(blocks))
    return (b"\xabKTX 20\xbb\r\n\x1a\n" + sizes + index + described).ljust(at, b"\0") + blocks


def quad_of_ktx2(data: bytes) -> bytes:
    return quad_of_picture(data, "KHR_texture_basisu")


COLOURS = np.array([[[200, 40, 30, 255], [20, 90, 220, 255]]], np.uint8)


def test_ktx2_of_basis_universal_is_read() -> None:
    pytest.importorskip("opengl_basisu")
    one = load_object(quad_of_ktx2(basis_ktx2(COLOURS)))
    assert shows(one.parts[0][1].base_colour_texture, np.repeat(np.repeat(COLOURS, 4, axis=0), 4, axis=1))
    assert one.notes == ()


def test_damaged_ktx2_is_noted_and_large_one_refused() -> None:
    pytest.importorskip("opengl_basisu")
    data = basis_ktx2(COLOURS)
    for damaged in (data[:-3], data[:100], data[:40] + b"\xff" * 8 + data[48:]):
        noted = load_object(quad_of_ktx2(damaged)).notes
        assert "images.4: its KTX2 data is damaged" in noted[0].left_out
    with pytest.raises(ObjectError, match=r"images\.4.*limited to 20"):
        load_object(quad_of_ktx2(data), limits=ObjectLimits(image_pixels=20))


def test_without_the_extra_and_of_other_data_ktx2_is_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    noted = quad_of_ktx2(basis_ktx2(COLOURS))
    if ktx2.ktx2_available():
        plain = bytearray(basis_ktx2(COLOURS))
        plain[12:16] = struct.pack("<I", 37)  # VK_FORMAT_R8G8B8A8_UNORM
        (note,) = load_object(quad_of_ktx2(bytes(plain))).notes
        assert "KTX2" in note.left_out
        assert note.advice == "export it as PNG, JPEG or WebP"
    monkeypatch.setattr(ktx2, "_MODULE", "no_such_package")
    one = load_object(noted)
    assert one.parts[0][1].base_colour_texture is None
    assert "KTX2" in one.notes[0].left_out
    assert one.notes[0].advice == "pip install 'roomlight[ktx2]', or export it as PNG, JPEG or WebP"


# Pose


def skinned_cube(joints: list[int], bind_scale: float, binds: int, node: dict[str, Any]) -> GltfFile:
    """A cube whose vertices have these joints and the weights 1, 0, 0, 0; joint 0 is node 1."""
    file = GltfFile()
    mesh = file.mesh(CUBE, CUBE_FACES, normals=CUBE - 0.5)
    file.attribute("JOINTS_0", np.tile(np.array(joints, np.uint8), (8, 1)), "VEC4", 5121)
    file.attribute("WEIGHTS_0", np.tile(np.array([1, 0, 0, 0], np.float32), (8, 1)), "VEC4")
    bind = np.tile(np.diag([bind_scale] * 3 + [1]).astype(np.float32).reshape(1, 16), (binds, 1))
    file.tree["skins"] = [{"joints": [1], "inverseBindMatrices": file.accessor(bind, "MAT4", 5126)}]
    file.node(mesh=mesh, skin=0, scale=[7, 7, 7])  # a skinned mesh ignores its own node
    file.node(translation=[0, 5, 0], **node)
    return file


# more bind matrices than joints, and joints of the weight 0 that do not exist, are no fault
@pytest.mark.parametrize(("binds", "unused"), [(1, 0), (3, 0), (1, 255)])
def test_skins_stand_in_the_pose_of_their_joints(binds: int, unused: int) -> None:
    file = skinned_cube([0, unused, 0, unused], 100, binds, {"scale": [0.01] * 3})
    one = load_object(file.glb())
    np.testing.assert_allclose(one.bounds(), [[0, 5, 0], [1, 6, 1]], atol=1e-5)
    unit = (CUBE - 0.5) / np.linalg.norm(CUBE - 0.5, axis=1, keepdims=True)
    np.testing.assert_allclose(one.parts[0][0].normals, unit, atol=1e-5)
    file.tree["skins"][0]["joints"] = [1] * (binds + 1)
    with pytest.raises(ObjectError, match=rf"holds {binds} matrices for {binds + 1} joints"):
        load_object(file.glb())
    with pytest.raises(ObjectError, match="joint 3 of 1"):
        load_object(skinned_cube([3, 0, 0, 0], 1, 1, {}).glb())


def test_stated_tangents_turn_with_their_joints() -> None:
    file = skinned_cube([0, 0, 0, 0], 100, 1, {"scale": [0.01] * 3, "rotation": [0, 0, 0.5**0.5, 0.5**0.5]})
    file.attribute("TANGENT", np.tile(np.array([1, 0, 0, -1], np.float32), (8, 1)), "VEC4")
    tangents = load_object(file.glb()).parts[0][0].tangents
    np.testing.assert_allclose(present(tangents), np.tile([0, 1, 0, -1], (8, 1)), atol=1e-6)


def test_morph_targets_and_instances_and_strips() -> None:
    file = cube_gltf()
    file.primitive["targets"] = [{"POSITION": file.accessor(np.full((8, 3), 2, np.float32), "VEC3", 5126)}]
    file.tree["meshes"][0]["weights"] = [0.5]
    np.testing.assert_allclose(load_object(file.glb()).bounds(), [[1, 1, 1], [2, 2, 2]])
    file = GltfFile()
    mesh = file.mesh(QUAD, [[0, 1, 3], [2, 2, 2]])
    file.primitive["mode"] = 5
    places = file.accessor(np.array([[0, 0, 0], [5, 0, 0]], np.float32), "VEC3", 5126)
    file.node(mesh=mesh, extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}})
    one = load_object(file.glb())
    assert len(one.parts) == 2
    assert area(one) == pytest.approx(2)
    assert face_normals(one.parts[0][0])[:, 2].min() > 0  # every other triangle of a strip turns round
    np.testing.assert_allclose(one.bounds()[1], [6, 1, 0])


def test_sparse_and_quantised_accessors() -> None:
    file = GltfFile()
    mesh = file.mesh(np.zeros((4, 3)), QUAD_FACES)
    where = file.view(np.array([1, 2, 3], np.uint8).tobytes())
    values = file.view(np.array(QUAD[1:], np.float32).tobytes())
    file.tree["accessors"][0].pop("bufferView")
    file.tree["accessors"][0]["sparse"] = {
        "count": 3,
        "indices": {"bufferView": where, "componentType": 5121},
        "values": {"bufferView": values},
    }
    file.node(mesh=mesh)
    assert area(load_object(file.glb())) == pytest.approx(1)
    file.content[file.tree["bufferViews"][where]["byteOffset"] + 2] = 4
    with pytest.raises(ObjectError, match="a sparse index points at value 4 of 4"):
        load_object(file.glb())
    file = GltfFile()
    mesh = file.mesh(QUAD, QUAD_FACES)
    packed_points = np.zeros((4, 4), np.int8)
    packed_points[:, :3] = np.array(QUAD) * 127
    view = file.view(packed_points.tobytes(), byteStride=4)
    file.tree["accessors"][0].update(bufferView=view, componentType=5120, normalized=True)
    file.node(mesh=mesh)
    assert area(load_object(file.glb())) == pytest.approx(1)


def test_clamped_textures_end_in_their_edges() -> None:
    file = textured_quad()
    file.tree["samplers"] = [{"wrapS": 33071}]
    file.tree["textures"][0]["sampler"] = 0
    assert present(load_object(file.glb()).parts[0][1].base_colour_texture).clamped == (True, False)


def test_nearest_texels_keep_their_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    def texture(width: int, sampler: dict) -> np.ndarray:
        file, art = GltfFile(), np.zeros((2, width, 3), np.uint8)
        art[:, ::2] = (255, 0, 0)
        file.quad(pbrMetallicRoughness={"baseColorTexture": {"index": file.image(art)}}, normalTexture={"index": 0})
        file.tree["samplers"], file.tree["textures"][0]["sampler"] = [sampler], 0
        return texels(load_object(file.glb()).parts[0][1].base_colour_texture)[..., 0]

    enlarged = texture(4, {"magFilter": 9728})
    assert enlarged.shape == (32, 64)
    np.testing.assert_array_equal(enlarged, np.tile(np.repeat([1, 0, 1, 0], 16), (32, 1)))
    assert texture(300, {"magFilter": 9728}).shape == (12, 1800)
    assert texture(300, {"magFilter": 9728, "wrapS": 33648}).shape == (6, 1800)
    assert texture(4, {"magFilter": 9729}).shape == (2, 4)
    monkeypatch.setattr(materials, "_ENLARGED_TEXELS", 8 * 9)
    assert texture(4, {"magFilter": 9728}).shape == (6, 12)


def test_textures_that_are_converted_by_texel_are_not_enlarged() -> None:
    file = GltfFile()
    texture = {"index": file.image(np.zeros((4, 4, 3), np.uint8))}
    file.tree["samplers"], file.tree["textures"][0]["sampler"] = [{"magFilter": 9728}], 0
    glossy = {"KHR_materials_pbrSpecularGlossiness": {"diffuseTexture": texture}}
    material = load_object(file.quad(emissiveTexture=texture, extensions=glossy).glb()).parts[0][1]
    textures = material.base_colour_texture, material.metallic_roughness_texture, material.emissive_texture
    assert [texels(made).shape[:2] for made in textures] == [(4, 4), (4, 4), (64, 64)]


def test_draco_skins_stand_in_the_pose_of_their_joints() -> None:
    joints, weights = np.zeros((8, 4), np.uint8), np.zeros((8, 4), np.float32)
    joints[:, 0], weights[:, 0] = 1, 1
    file = GltfFile()
    file.node()
    file.node(scale=[2, 2, 2])
    file.node(mesh=file.draco(CUBE, CUBE_FACES, joints=(joints, weights)), skin=0)
    file.tree["skins"] = [{"joints": [0, 1]}]
    assert area(load_object(file.glb())) == pytest.approx(24, rel=1e-2)
    file.primitive["extensions"]["KHR_draco_mesh_compression"]["attributes"]["POSITION"] = 7
    with pytest.raises(ObjectError, match="Draco"):
        load_object(file.glb())


@pytest.mark.parametrize(
    ("thickness", "distance", "tint"),  # twice the distance: colour ** 2; the last distances stand for infinity
    [
        *((0.2, 0.1, [0.0625, 0.25, 1.0]), (0, 0.1, [1, 1, 1])),
        *((0.2, distance, [1, 1, 1]) for distance in (0, 1e7, 3.4028235e38)),
    ],
)
def test_glass_is_tinted_by_its_stated_thickness(thickness: float, distance: float, tint: list[float]) -> None:
    volume = {"thicknessFactor": thickness, "attenuationDistance": distance, "attenuationColor": [0.25, 0.5, 1.0]}
    clear, shiny = {"transmissionFactor": 0.9}, {"specularFactor": 0.3}
    glass = {"transmission": clear, "specular": shiny, "volume": volume}
    extensions = {f"KHR_materials_{name}": values for name, values in glass.items()}
    stated = {"extensions": extensions, "pbrMetallicRoughness": {"metallicFactor": 0}}
    material, one = material_of(stated, extensionsUsed=list(extensions))
    assert (material.transmission, material.specular) == (0.9, 0.3)
    assert material.is_thin == material.one_sided == (thickness == 0)
    np.testing.assert_allclose(material.base_colour, tint, atol=1e-6)
    assert "thickness" in " ".join(note.effect for note in one.notes)


@pytest.mark.parametrize(
    ("factor", "blues", "transmission", "metallic"),
    [(1, (), 0, 1), (0, (), 1, 0), (0.5, (), 0.5, 1), (1, (255, 255), 0, 1), (1, (0, 0), 1, 1), (1, (0, 255), 0.5, 1)],
)
def test_metals_are_no_glass(factor: float, blues: tuple[int, ...], transmission: float, metallic: float) -> None:
    file = GltfFile()
    base: dict[str, Any] = {"metallicFactor": factor, "roughnessFactor": 0}
    if blues:
        base["metallicRoughnessTexture"] = {"index": file.image(np.array([[[0, 0, blue] for blue in blues]], np.uint8))}
    glass = {"KHR_materials_transmission": {"transmissionFactor": 1}}
    one = load_object(file.quad(pbrMetallicRoughness=base, extensions=glass).glb())
    material = one.parts[0][1]
    assert (material.transmission, material.metallic) == (transmission, metallic)
    assert len(one.notes) == (len(set(blues)) == 2)


def test_a_texture_of_transmission_is_linear() -> None:
    file = GltfFile()
    clear = {"transmissionTexture": {"index": file.image(np.full((2, 2, 3), 51, np.uint8))}, "transmissionFactor": 0.5}
    base, extensions = {"metallicFactor": 0}, {"KHR_materials_transmission": clear}
    one = load_object(file.quad(pbrMetallicRoughness=base, extensions=extensions).glb())
    assert one.parts[0][1].transmission == pytest.approx(0.1)


@pytest.mark.parametrize(("reds", "transmission"), [((255, 0), 0.5), ((255, 255), 0.5), ((51, 51), 0.2)])
def test_a_texture_of_transmission_leaves_metal_out(reds: tuple[int, int], transmission: float) -> None:
    file = GltfFile()
    texture = {"index": file.image(np.array([[[reds[0], 0, 0], [reds[1], 0, 255]]], np.uint8))}  # the second is metal
    base = {"roughnessFactor": 0, "metallicRoughnessTexture": texture}
    glass = {"KHR_materials_transmission": {"transmissionFactor": 1, "transmissionTexture": texture}}
    one = load_object(file.quad(pbrMetallicRoughness=base, extensions=glass).glb())
    assert one.parts[0][1].transmission == pytest.approx(transmission)


def test_the_thickness_of_glass_scales_with_its_node() -> None:
    volume = {"thicknessFactor": 2000, "attenuationDistance": 1, "attenuationColor": [0.25, 0.5, 1.0]}
    glass = {"transmission": {"transmissionFactor": 1}, "volume": volume}
    extensions = {f"KHR_materials_{name}": values for name, values in glass.items()}
    file = GltfFile().quad(extensions=extensions, pbrMetallicRoughness={"metallicFactor": 0})
    file.tree["nodes"][0]["scale"] = [0.001] * 3  # 2 m of what is drawn in millimetres
    np.testing.assert_allclose(load_object(file.glb()).parts[0][1].base_colour, [0.0625, 0.25, 1], atol=1e-6)


def test_occlusion_textures_of_all_materials_have_one_note() -> None:
    file = GltfFile()
    texture = {"index": file.image(np.zeros((2, 2, 3), np.uint8))}
    (note,) = load_object(file.quad(occlusionTexture=texture).quad(occlusionTexture=texture).glb()).notes
    assert note.left_out.endswith("occlusion textures")
    assert note.effect == "objects shade themselves by ray tracing instead"


def test_single_sided_surfaces_among_double_sided_ones_are_said_to_show_from_behind() -> None:
    for sides in ((False, False), (False, True), (True, True)):
        file = GltfFile()
        for double_sided in sides:
            file.quad(doubleSided=double_sided)
        notes = [note.effect for note in load_object(file.glb()).notes]
        assert notes == (["they show from behind as well"] if sides == (False, True) else [])
    assert load_object(cube_gltf({}).quad(doubleSided=True).glb()).notes == ()


@pytest.mark.parametrize("double_sided", [False, True])
def test_closed_surfaces_that_face_inward_are_said_to_show_from_outside(double_sided: bool) -> None:
    file = cube_gltf({"doubleSided": double_sided})
    hull = np.array(CUBE_FACES)[:, ::-1]
    file.node(mesh=file.mesh(CUBE, hull, material=0), scale=[1.1] * 3)
    notes = [note.effect for note in load_object(file.glb()).notes]
    assert notes == ([] if double_sided else ["they show from outside as well"])


@pytest.mark.parametrize("overlap", [0.0, 2e-4])
def test_of_surfaces_back_to_back_the_one_that_faces_the_camera_shows(overlap: float) -> None:
    file = GltfFile()
    for faces, z in ((QUAD_FACES, -overlap), (np.array(QUAD_FACES)[:, ::-1], 0)):
        file.node(mesh=file.mesh(QUAD, faces, material=file.material()), translation=[0, 0, z])
    scene = TracedObjects([load_object(file.glb())])
    x, y = np.random.default_rng(0).uniform(0.1, 0.9, (2, 50)).astype(np.float32)
    for side, part in ((1, 0), (-1, 1)):
        origins = np.stack([x, y, np.full_like(x, 3 * side)], axis=1)
        hits = scene.trace(origins, np.tile(np.float32([0, 0, -side]), (50, 1)))
        assert set(scene.surfaces.material[hits.face]) == {part}


def test_draco_meshes_are_read() -> None:
    file = GltfFile()
    file.node(mesh=file.draco(CUBE, CUBE_FACES))
    one = load_object(file.glb())
    assert area(one) == pytest.approx(6, rel=1e-3)
    assert bend_deg(one) < 0.1
    file.content[8:40] = bytes(32)
    with pytest.raises(ObjectError, match="Draco"):
        load_object(file.glb())


@pytest.mark.parametrize(
    ("component", "normalised", "grey"), [(5121, True, 128 / 255), (5123, True, 128 / 65535), (5123, False, 1.0)]
)
def test_integers_of_draco_are_scaled_as_their_accessors_state(component: int, normalised: bool, grey: float) -> None:
    values = np.full((8, 4), 128, {5121: np.uint8, 5123: np.uint16}[component])
    file = GltfFile()
    file.node(mesh=file.draco(CUBE, CUBE_FACES, joints=(values, np.zeros((8, 4), np.float32))))
    packed_names = file.primitive["extensions"]["KHR_draco_mesh_compression"]["attributes"]
    for names in (file.primitive["attributes"], packed_names):
        names["COLOR_0"] = names.pop("JOINTS_0")
    file.tree["accessors"][1] |= {"componentType": component, "normalized": normalised}
    assert load_object(file.glb()).parts[0][1].base_colour == pytest.approx([grey] * 3)


# Lenient files, and notes


def test_factors_out_of_range_are_clamped_and_said() -> None:
    material, one = material_of({"emissiveFactor": [2, 2, 2], "pbrMetallicRoughness": {"roughnessFactor": 10}})
    assert material.emissive == (2, 2, 2)
    assert material.roughness == 1
    (note,) = one.notes
    assert "roughnessFactor of 10" in note.left_out


def test_clear_coat_and_sheen_are_read_with_their_textures() -> None:
    file = GltfFile()
    picture = np.full((4, 4, 4), (128, 64, 32, 200), np.uint8)
    texture = {"index": file.image(picture)}
    coat = {"clearcoatFactor": 0.8, "clearcoatTexture": texture, "clearcoatRoughnessFactor": 0.5}
    sheen = {"sheenColorFactor": [1, 0.5, 0.25], "sheenRoughnessFactor": 0.6, "sheenColorTexture": texture}
    file.quad(
        extensions={
            "KHR_materials_clearcoat": coat | {"clearcoatRoughnessTexture": texture, "clearcoatNormalTexture": texture},
            "KHR_materials_sheen": sheen | {"sheenRoughnessTexture": texture},
        }
    )
    one = load_object(file.glb())
    material = one.parts[0][1]
    assert (material.clearcoat, material.clearcoat_roughness, material.sheen) == (0.8, 0.5, (1, 0.5, 0.25))
    assert material.sheen_roughness == 0.6
    np.testing.assert_allclose(texels(material.clearcoat_texture)[0, 0], picture[0, 0] / 255, atol=1e-4)
    assert texels(material.sheen_texture)[0, 0, 0] == pytest.approx(0.2159, abs=1e-3)  # sRGB
    assert material.clearcoat_roughness_texture is material.clearcoat_texture
    assert material.sheen_roughness_texture is material.clearcoat_texture
    assert ["clear coat" in note.left_out for note in one.notes] == [True]


@pytest.mark.parametrize(
    ("mode", "double", "one_sided"), [("BLEND", False, True), ("BLEND", True, False), ("MASK", False, False)]
)
def test_backs_of_single_sided_surfaces_are_not_blended(mode: str, double: bool, one_sided: bool) -> None:
    material, one = material_of({"alphaMode": mode, "doubleSided": double})
    assert (material.one_sided, one.notes) == (one_sided, ())


def test_frosted_glass_is_noted() -> None:
    clear = {"KHR_materials_transmission": {"transmissionFactor": 1}}
    for roughness in (0.05, 0.5):
        base = {"metallicFactor": 0, "roughnessFactor": roughness}
        _, one = material_of({"extensions": clear, "pbrMetallicRoughness": base})
        assert ["frosted" in note.effect for note in one.notes] == [True] * (roughness > 0.1)
