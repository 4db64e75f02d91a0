"""Reading GLB, glTF, OBJ and PLY: geometry, transforms, materials, and every limit."""

import base64
import json
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_files import QUAD, QUAD_FACES, QUAD_UVS, GltfFile, packed, ply, png, shows, textured_quad

from present import present
from roomlight.compositing.loading import load_object
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.errors import ObjectError
from roomlight.light.usd import to_usdz

OBJ = b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n"
OBJ_FACE = b"usemtl a\nf 1/1/1 2/2/1 3/3/1 4/4/1\n"
PLY = ply(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]], "ascii")


def test_glb_keeps_geometry_and_applies_the_node() -> None:
    ((mesh, _),) = load_object(textured_quad().glb()).parts
    np.testing.assert_allclose(mesh.vertices - [1, 2, 3], QUAD, atol=1e-6)
    np.testing.assert_allclose(mesh.uvs, QUAD_UVS)
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 4)
    assert mesh.faces.tolist() == QUAD_FACES


def test_glb_material_keeps_factors_and_textures() -> None:
    ((_, material),) = load_object(textured_quad().glb()).parts
    assert material.base_colour == (1, 0.5, 0.25)
    assert (material.metallic, material.roughness, material.ior) == (0.75, 0.5, 1.4)
    assert material.emissive == (2, 0, 0)
    assert material.normal_scale == 0.5
    colour = np.random.default_rng(1).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    assert shows(material.base_colour_texture, colour)
    assert shows(material.emissive_texture, colour)
    assert material.metallic_roughness_texture is not None
    assert present(material.normal_texture).texels[0, 0, :3].tolist() == [32896, 32896, 65535]


def test_nested_nodes_multiply_their_transforms() -> None:
    file = GltfFile()
    mesh = file.mesh(QUAD, QUAD_FACES)
    file.node(mesh=mesh, scale=[2, 2, 2], root=False)
    half = float(np.sqrt(0.5))
    file.node(children=[0], rotation=[0, half, 0, half], translation=[0, 5, 0])  # 90 degrees about y
    file.node(mesh=mesh, matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 7, 8, 9, 1])  # column-major
    (placed, _), (moved, _) = load_object(file.glb()).parts
    np.testing.assert_allclose(placed.vertices[1], [0, 5, -2], atol=1e-6)
    np.testing.assert_allclose(placed.normals[0], [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(moved.vertices[0], [7, 8, 9])


def test_long_chains_of_bones_are_read() -> None:
    file = GltfFile()
    mesh = file.mesh(QUAD, QUAD_FACES)
    file.node(translation=[0, 0, 0.5], children=[1])
    for number in range(1, 998):
        file.node(root=False, translation=[0, 0, 0.5], children=[number + 1])
    file.node(root=False, mesh=mesh)
    np.testing.assert_allclose(load_object(file.glb()).bounds(), [[0, 0, 499], [1, 1, 499]])
    file.tree["nodes"][-1]["children"] = [500]
    with pytest.raises(ObjectError, match="must form trees"):
        load_object(file.glb())


def test_gltf_with_data_uris_reads_as_its_glb() -> None:
    file = textured_quad()
    glb = file.glb()
    uri = "data:application/octet-stream;base64," + base64.b64encode(bytes(file.content)).decode()
    file.tree["buffers"] = [{"byteLength": len(file.content), "uri": uri}]
    one, other = load_object(json.dumps(file.tree).encode()), load_object(glb)
    np.testing.assert_array_equal(one.parts[0][0].vertices, other.parts[0][0].vertices)


def test_interleaved_vertices_are_read() -> None:
    file = GltfFile().quad()
    rows = np.zeros((4, 8), np.float32)
    rows[:, :3], rows[:, 3:6], rows[:, 6:] = QUAD, [0, 0, 1], QUAD_UVS
    view = file.view(rows.tobytes(), byteStride=32)
    for key, offset, kind in (("POSITION", 0, "VEC3"), ("NORMAL", 12, "VEC3"), ("TEXCOORD_0", 24, "VEC2")):
        file.primitive["attributes"][key] = len(file.tree["accessors"])
        stated = {"bufferView": view, "byteOffset": offset, "componentType": 5126, "count": 4, "type": kind}
        file.tree["accessors"].append(stated)
    ((mesh, _),) = load_object(file.glb()).parts
    np.testing.assert_allclose(mesh.vertices, QUAD)
    np.testing.assert_allclose(mesh.uvs, QUAD_UVS)


@pytest.mark.slow
def test_accessors_that_share_a_view_copy_only_their_values() -> None:
    """A file of 31 MiB, whose 25 accessors shared one view with a stride of 252 bytes, took 3.3 GB."""

    def peak_bytes(count: int) -> int:
        file = GltfFile()
        indices = file.accessor(np.arange(1023, dtype=np.uint16), "SCALAR", 5123)
        view = file.view(bytes(252 * 1024), byteStride=252)
        for number in range(count):
            place = {"bufferView": view, "byteOffset": 12 * (number % 20)}
            file.tree["accessors"].append({**place, "componentType": 5126, "count": 1024, "type": "VEC3"})
            file.tree["meshes"].append({"primitives": [{"attributes": {"POSITION": number + 1}, "indices": indices}]})
            file.node(mesh=number)
        data = file.glb()
        tracemalloc.start()
        load_object(data)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return peak

    peak_bytes(1)  # imports
    each_accessor = (peak_bytes(40) - peak_bytes(8)) / 32
    assert each_accessor < 0.8 * 252 * 1024  # a copy of the view's 252 kB for each of them would be above


def test_alpha_modes_become_opacity_and_cutoff() -> None:
    image = np.full((2, 2, 4), 255, np.uint8)
    image[..., 3] = 51
    for mode, alpha, cutoff in (("OPAQUE", 65535, None), ("BLEND", 13107, None), ("MASK", 13107, 0.5)):
        file = GltfFile()
        surface = {"baseColorTexture": {"index": file.image(image)}, "baseColorFactor": [1, 1, 1, 0.5]}
        ((_, found),) = load_object(file.quad(pbrMetallicRoughness=surface, alphaMode=mode).glb()).parts
        assert present(found.base_colour_texture).texels[0, 0, 3] == alpha
        assert found.alpha_cutoff == cutoff
        assert found.opacity == (1 if mode == "OPAQUE" else 0.5)


def test_obj_polygons_become_triangles_with_upright_uvs() -> None:
    ((mesh, _),) = load_object(OBJ + OBJ_FACE, "obj").parts
    assert len(mesh.faces) == 2
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 4)
    corner = np.flatnonzero((mesh.vertices == [0, 1, 0]).all(axis=1))[0]
    np.testing.assert_allclose(mesh.uvs[corner], [0, 0])  # OBJ's v = 1 is the image's top


def test_kind_and_name_come_from_the_file(tmp_path: Path) -> None:
    for name, data in (("a.glb", textured_quad().glb()), ("b.obj", OBJ + OBJ_FACE), ("c.ply", PLY)):
        (tmp_path / name).write_bytes(data)
        assert load_object(tmp_path / name).name == name[0]


def test_unreadable_paths_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ObjectError, match="cannot be read"):
        load_object(tmp_path / "missing.glb")
    with pytest.raises(ObjectError, match="neither GLB, glTF nor PLY"):
        load_object(b"hello")
    with pytest.raises(ObjectError, match="chair: is empty"):
        load_object(b"", name="chair")
    (tmp_path / "chair.stl").write_text("solid chair")
    with pytest.raises(ObjectError, match=r"nor PLY by its content; export the \.stl as GLB"):
        load_object(tmp_path / "chair.stl")
    (tmp_path / "chair.zip").write_bytes(b"PK\3\4")
    with pytest.raises(ObjectError, match=r"by its content; unpack the \.zip, and open the model in it"):
        load_object(tmp_path / "chair.zip")


@pytest.mark.parametrize(
    ("data", "ending"),
    [
        (to_usdz((0.0, 0.0, 0.0), np.ones((8, 16, 3), np.float32), []), "usdz"),
        (b"solid chair\nfacet normal 0 0 1\n", "stl"),
        (bytes(80) + (2).to_bytes(4, "little") + bytes(100), "stl"),
    ],
)
def test_formats_that_are_not_read_are_told_by_their_content(tmp_path: Path, data: bytes, ending: str) -> None:
    (tmp_path / "chair.obj").write_bytes(data)
    for source in (tmp_path / "chair.obj", data):
        with pytest.raises(ObjectError, match=rf"nor PLY by its content; export the \.{ending} as GLB"):
            load_object(source)


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"\xff\xd8\xff\xe0JFIF", "a JPEG"),
        (b"PK\3\4", "a ZIP"),
        (b"<!DOCTYPE html>", "HTML"),
        (b"v 0 0 0\n", "b'v 0 0 0"),
    ],
)
def test_a_file_that_is_no_glb_is_not_called_damaged(data: bytes, kind: str) -> None:
    with pytest.raises(ObjectError, match=f"is no GLB or glTF file; it starts like {kind}"):
        load_object(data, "glb")


@pytest.mark.parametrize(
    ("limits", "field"),
    [
        (ObjectLimits(file_bytes=100), "file bytes"),
        (ObjectLimits(json_bytes=100), "json bytes"),
        (ObjectLimits(triangles=1), "triangles"),
        (ObjectLimits(vertices=3), "vertices"),
        (ObjectLimits(nodes=0), "nodes"),
        (ObjectLimits(node_depth=0), "node depth"),
        (ObjectLimits(parts=0), "parts"),
        (ObjectLimits(materials=0), "materials"),
        (ObjectLimits(images=3), "images"),
        (ObjectLimits(image_pixels=63), "image pixels"),
        (ObjectLimits(total_pixels=100), "total pixels"),
    ],
)
def test_each_limit_is_kept(limits: ObjectLimits, field: str) -> None:
    with pytest.raises(ObjectError, match=f"{field} {'is' if field == 'node depth' else 'are'} limited to"):
        load_object(textured_quad().glb(), limits=limits)


@pytest.mark.parametrize(
    ("field", "data"), [("triangles", OBJ + OBJ_FACE), ("vertices", OBJ + OBJ_FACE), ("vertices", PLY)]
)
def test_text_formats_keep_the_limits(field: str, data: bytes) -> None:
    with pytest.raises(ObjectError, match=f"{field} are limited to"):
        load_object(data, "ply" if data is PLY else "obj", ObjectLimits(**{field: 1}))


SMALL = png(np.zeros((4, 4, 3), np.uint8))
BOMB = SMALL[:16] + (50_000).to_bytes(4, "big") * 2 + SMALL[24:]  # the width and the height that its header declares


RED = np.full((4, 4, 3), (200, 10, 20), np.uint8)
POSITIONS = -140
"""Where they begin in the content: 48 bytes, then 32 of coordinates, 48 of normals and 12 of indices."""


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("buffers", [{"byteLength": 10, "uri": "http://example.org/a.bin"}], "outside the file"),
        ("buffers", [{"byteLength": 10, "uri": "../../etc/passwd"}], "outside the file"),
        ("buffers", [{"byteLength": 10_000}], "buffer 0 declares 10000 bytes, "),
        ("accessors.0.count", 2_000_000_000, "limited"),
        ("accessors.0.count", 5, "values|end at byte"),
        ("accessors.0.count", "four", "count is 'four'; it must be a whole number"),
        ("accessors.0.byteOffset", -4, "byteOffset is -4; it must be at least 0"),
        ("accessors.0.sparse", {"count": 1}, "sparse.indices is missing"),
        ("bufferViews.0.byteOffset", 10**9, "ends at byte"),
        ("bufferViews.4.byteStride", 4, "byteStride"),
        ("nodes.0.children", [0], "two parents"),
        ("nodes.0.scale", [0, 0, 0], "flattens"),
        ("nodes.0.scale", [1, 1, 0], r"flattens it: scales \[1\.0, 1\.0, 0\.0\]"),
        ("nodes.0.matrix", [0] * 16, "flattens|last row"),
        ("nodes", [{}] * 1_000_000, "limited"),
        ("nodes", [{"scale": [1e9] * 3, "children": [at + 1]} for at in range(50)], r"down to node 3 pass 1e\+30"),
        ("nodes.0.mesh", 9, "mesh 9"),
        ("nodes.0.extensions", {"EXT_mesh_gpu_instancing": 5}, "node 0: EXT_mesh_gpu_instancing JSON is 5"),
        (
            "nodes.0.extensions",
            {"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": -9}}},
            "attributes.SCALE is -9; it must be at least 0",
        ),
        ("meshes.0.primitives.0.material", 9, "material 9"),
        ("meshes.0.primitives.0.mode", 0, "no surface"),  # points alone
        ("scene", 4, "scene 4"),
        ("extensionsRequired", ["KHR_gaussian_splatting"], "splatting"),
        ("materials.0.pbrMetallicRoughness.roughnessFactor", [1], r"roughnessFactor is \[1\]; it must be a number"),
        ("asset", {"version": "1.0"}, "glTF 2"),
    ],
)
def test_hostile_declarations_are_refused(place: str, value: object, message: str) -> None:
    file = textured_quad()
    at: Any = file.tree
    *above, last = [int(key) if key.isdigit() else key for key in place.split(".")]
    for key in above:
        at = at[key]
    at[last] = value
    with pytest.raises(ObjectError, match=message):
        load_object(file.glb())


@pytest.mark.parametrize(
    ("offset", "content", "message"),
    [
        (-12, b"\4\0", "an index points at vertex 4 of 4"),
        *((POSITIONS, np.float32(value).tobytes(), "finite") for value in (np.nan, np.inf)),
        (POSITIONS, np.float32(1e30).tobytes(), "at most"),
    ],
)
def test_hostile_values_are_refused(offset: int, content: bytes, message: str) -> None:
    file = textured_quad()
    file.content[offset : offset + len(content) or None] = content
    with pytest.raises(ObjectError, match=message):
        load_object(file.glb())


def test_an_image_larger_than_it_may_be_is_refused_by_its_header() -> None:
    file = textured_quad()
    file.tree["images"][0]["bufferView"] = file.view(BOMB)
    with pytest.raises(ObjectError, match="image pixels are limited"):
        load_object(file.glb())


def test_instances_are_counted_before_they_are_made() -> None:
    file = GltfFile()
    mesh = file.mesh(QUAD, QUAD_FACES)
    for _ in range(1_000):
        file.node(mesh=mesh)
    with pytest.raises(ObjectError, match="triangles are limited to 1500, the file has 2000"):
        load_object(file.glb(), limits=ObjectLimits(triangles=1500))


@pytest.mark.parametrize(
    "text", [b"{", b"{}", b"[" * 100_000, b'{"asset":{"version":"2.0"},"nodes":NaN}', b"{}" * 9, b'{"asset":' * 90_000]
)
def test_damaged_json_is_refused(text: bytes) -> None:
    with pytest.raises(ObjectError):
        load_object(packed(text, b""))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"v 0 0 0\n", "has no face"),
        (OBJ + b"f 1 2 9\n", "damaged|point at"),
        (OBJ + b"f 1 2 999999999\n", "damaged|point at"),
        (OBJ + b"f 1 2 99999999999999999999999\n", "line 11 has the corner"),
        (OBJ + b"f 0 1 2\n", "line 11"),
        (OBJ + b"f -1 -2 -9\n", "line 11"),
        (OBJ + b"f 1 2\n", "has no face"),
        (b"v 0 nan 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "v 1 is"),
        (b"v 1e999 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "finite"),
        (PLY.replace(b"vertex 3", b"vertex 999999999"), "limited|declares"),
        (PLY.replace(b"vertex 3", b"vertex 1400000"), "truncated"),
        (PLY.replace(b"face 1", b"face 0"), "no face"),
        (PLY.replace(b"3 0 1 2", b"3 0 1 7"), "point at"),
        (PLY.replace(b"float x", b"list uchar float x"), "vertices"),
        (PLY.replace(b"end_header", b"end"), "header"),
        (PLY.replace(b"1 0 0\n", b"nan 0 0\n"), "finite"),
        (PLY.replace(b"float y", b"quad y"), "not understood"),
    ],
)
def test_hostile_obj_and_ply_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(ObjectError, match=message):
        load_object(data, "ply" if data.startswith(b"ply") else "obj")


# Files beside a glTF


def gltf_folder(folder: Path, *, buffer: str = "scene.bin", picture: str = "textures/red.png") -> Path:
    """Write a glTF whose buffer and picture are files, as Sketchfab and Blender export it."""
    file = textured_quad()
    file.glb()
    file.tree["buffers"] = [{"byteLength": len(file.content), "uri": buffer}]
    file.tree["images"] = [{"uri": picture}] * len(file.tree["images"])
    (folder / "textures").mkdir(parents=True, exist_ok=True)
    (folder / "scene.bin").write_bytes(bytes(file.content))
    (folder / "textures" / "red.png").write_bytes(png(RED))
    path = folder / "scene.gltf"
    path.write_text(json.dumps(file.tree))
    return path


@pytest.mark.parametrize(
    "picture", ["textures/red.png", "./Textures/RED.png", "textures\\red.png", "textures/r%65d.png"]
)
def test_gltf_reads_the_files_of_its_folder(tmp_path: Path, picture: str) -> None:
    path = gltf_folder(tmp_path, picture=picture)
    ((mesh, material),) = load_object(path).parts
    ((expected, _),) = load_object(textured_quad().glb()).parts
    np.testing.assert_array_equal(mesh.vertices, expected.vertices)
    assert shows(material.base_colour_texture, RED)
    with pytest.raises(ObjectError, match="outside the file; export as one GLB file"):
        load_object(path.read_bytes(), "gltf")


@pytest.mark.parametrize(
    "uri",
    ["../secret.bin", "textures/../../secret.bin", "linked.bin", "link/secret.bin", "missing.bin", "a\0b", "textures"],
)
def test_nothing_outside_the_folder_is_read(tmp_path: Path, uri: str) -> None:
    path = gltf_folder(tmp_path / "model", buffer=uri)
    (tmp_path / "secret.bin").write_bytes((path.parent / "scene.bin").read_bytes())
    (path.parent / "linked.bin").symlink_to(tmp_path / "secret.bin")
    (path.parent / "link").symlink_to(tmp_path)
    with pytest.raises(ObjectError, match=r"buffer 0: .*; put it into the object's folder"):
        load_object(path)
    absolute = gltf_folder(tmp_path / "absolute", buffer=str(tmp_path / "secret.bin"))
    with pytest.raises(ObjectError, match="not a path inside the folder"):
        load_object(absolute)


def test_files_beside_count_together(tmp_path: Path) -> None:
    path = gltf_folder(tmp_path)
    with pytest.raises(ObjectError, match="file bytes are limited to"):
        load_object(path, limits=ObjectLimits(file_bytes=path.stat().st_size + 10))
