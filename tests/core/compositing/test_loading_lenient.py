"""What other programs write and read is read, and what of it is left out is noted: variants of one quad."""

import codecs
import json
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_files import (
    QUAD,
    QUAD_FACES,
    QUAD_UVS,
    GltfFile,
    area,
    face_normals,
    left_out,
    packed,
    ply,
    texels,
    textured_quad,
)

from present import present
from roomlight.compositing.loading import load_object
from roomlight.compositing.objects.gltf import materials
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.compositing.objects.pictures import PictureReader
from roomlight.compositing.objects.virtual_object import TriangleMesh
from roomlight.compositing.placement.scene import load_scene
from roomlight.compositing.recordings import scene_of_object
from roomlight.errors import ObjectError

RED = np.array([[1, 0, 0, 0.25]] * 4, np.float32)
MIXED = np.array([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1], [1, 1, 0, 1]], np.float32)
OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"


def coloured(colours: np.ndarray, **material: Any) -> GltfFile:
    file = GltfFile().quad(**material)
    file.attribute("NORMAL", np.array([[0, 0, 1]] * 4, np.float32), "VEC3")
    file.attribute("COLOR_0", colours, "VEC4")
    return file


@pytest.mark.parametrize("colours", [RED, MIXED], ids=["red", "mixed"])
def test_unlit_surfaces_emit_their_vertex_colours(colours: np.ndarray) -> None:
    ((_, material),) = load_object(coloured(colours, extensions={"KHR_materials_unlit": {}}).glb()).parts
    assert material.base_colour == (0, 0, 0)
    assert material.emissive == ((1, 0, 0) if colours is RED else (1, 1, 1))
    assert (material.emissive_texture is None) == (colours is RED)


@pytest.mark.parametrize(("mode", "opacity"), [("OPAQUE", 1.0), ("BLEND", 0.25), ("blend", 0.25)])
def test_alpha_of_vertex_colours_counts_unless_the_material_is_opaque(mode: str, opacity: float) -> None:
    ((_, material),) = load_object(coloured(RED, alphaMode=mode).glb()).parts
    assert material.opacity == opacity


def test_vertex_colours_keep_the_coordinates_of_an_emissive_texture() -> None:
    file = coloured(MIXED, emissiveFactor=[1, 1, 1])
    file.tree["materials"][0]["emissiveTexture"] = {"index": file.image(np.full((2, 2, 3), 90, np.uint8))}
    found = load_object(file.glb())
    ((mesh, _),) = found.parts
    np.testing.assert_array_equal(np.unique(mesh.uvs), [0, 1])
    assert "vertex colours" in "".join(left_out(found))


@pytest.mark.parametrize("coordinates", [0, 1])
def test_textures_without_coordinates_are_noted(coordinates: int) -> None:
    file = GltfFile()
    texture = {"index": file.image(np.zeros((2, 2, 3), np.uint8)), "texCoord": coordinates}
    file.quad(pbrMetallicRoughness={"baseColorTexture": texture})
    if coordinates == 0:
        del file.primitive["attributes"]["TEXCOORD_0"]
    assert f"no TEXCOORD_{coordinates}" in "".join(left_out(load_object(file.glb())))


@pytest.mark.parametrize(
    ("place", "change", "noted"),
    [
        ("materials.0", {"extensions": {"KHR_materials_iridescence": {"iridescenceFactor": 1}}}, "iridescence"),
        ("meshes.0.primitives.0", {"extensions": {"KHR_materials_variants": {"mappings": []}}}, "variants"),
        ("", {"extensionsUsed": ["KHR_materials_made_up", "KHR_xmp_json_ld"]}, "made_up"),
        ("", {"extensionsUsed": ["KHR_materials_variants"]}, "its default materials are shown"),
        ("", {"animations": [{}]}, "animations"),
    ],
)
def test_what_is_not_read_is_noted_once(place: str, change: dict, noted: str) -> None:
    """Extensions that the file does not declare too."""
    file = GltfFile().quad()
    at: Any = file.tree
    for key in filter(None, place.split(".")):
        at = at[int(key) if key.isdigit() else key]
    at.update(change)
    (note,) = load_object(file.glb()).notes
    assert noted in str(note)


def test_hidden_nodes_are_left_out() -> None:
    file = GltfFile().quad()
    file.node(children=[0], root=False)
    file.node(children=[1], root=False, extensions={"KHR_node_visibility": {"visible": False}})
    file.tree["nodes"].append({"mesh": 0, "translation": [5, 0, 0]})
    file.tree["scenes"][0]["nodes"] = [2, 3]
    found = load_object(file.glb())
    assert len(found.parts) == 1
    assert found.bounds()[0, 0] == 5


@pytest.mark.parametrize(
    "change",
    [
        lambda tree: tree["materials"][0].update(pbrMetallicRoughness={"baseColorFactor": [1, 0, 0]}),
        lambda tree: tree["asset"].update(version="2"),
        lambda tree: tree["asset"].update(version=2.0),
        lambda tree: (tree["nodes"].append({"mesh": 0, "scale": [0, 1, 1]}), tree["scenes"][0]["nodes"].append(1)),
        lambda tree: tree.pop("scene"),
        lambda tree: tree["materials"][0].update(alphaMode="opaque", alphaCutoff=None),
        lambda tree: tree["accessors"][-1].update(count=6.0),
        lambda tree: tree["nodes"][0].update(camera=None, skin=None, extras={"a": 1}),
        lambda tree: tree["nodes"][0].update(matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1e-6, 3, 0, 0, 0.99999]),
        lambda tree: (
            tree["accessors"].append({"componentType": 5126, "count": 0, "type": "VEC3"}),
            tree["meshes"][0]["primitives"].append({"attributes": {"POSITION": len(tree["accessors"]) - 1}}),
        ),
    ],
)
def test_gltf_that_others_read(change: Any) -> None:
    file = GltfFile().quad()
    change(file.tree)
    assert area(load_object(file.glb())) == pytest.approx(1)


def test_containers_that_others_read() -> None:
    file = GltfFile().quad()
    file.tree["nodes"][0]["name"] = "Tur"
    plain = file.glb()
    text = json.dumps(file.tree).encode()
    longer = plain[:8] + struct.pack("<I", len(plain) + 4) + plain[12:]
    marked = packed(codecs.BOM_UTF8 + text, bytes(file.content))
    padded = packed(text + bytes(-len(text) % 4 + 4), bytes(file.content))
    odd, rest = text + b" " * (-len(text) % 4 + 1), plain[20 + struct.unpack_from("<I", plain, 12)[0] :]
    lengths = [odd + padding + rest for padding in (b"", b" " * (-len(odd) % 4))]  # padded, but not counted
    heads = [struct.pack("<4sIII4s", b"glTF", 2, 20 + len(both), len(odd), b"JSON") for both in lengths]
    latin = plain.replace(b"Tur", b"T\xfcr")
    for data in (plain, plain + bytes(4), longer, marked, padded, latin, *map(bytes.__add__, heads, lengths)):
        assert area(load_object(data)) == pytest.approx(1)
    with pytest.raises(ObjectError, match="truncated"):
        load_object(plain[:-4])


@pytest.mark.parametrize(
    "data",
    [
        OBJ.encode("utf-16"),
        OBJ.replace("\n", "\r").encode(),
        OBJ.replace("v 1 1 0", "v 1,0 1,0 0,0").encode(),
        OBJ.replace("f 1 2 3 4", "f 1// 2// 3// 4//").encode(),
        (OBJ.replace("f 1", "usemtl dark red\nf 1") + "f 1 2\nl 1 2\n").encode(),
    ],
    ids=["utf-16", "cr", "decimal comma", "slashes", "left out"],
)
def test_obj_that_others_read(data: bytes) -> None:
    found = load_object(data, "obj")
    assert area(found) == pytest.approx(1)
    kinds = {"materials dark red", "faces of less than three corners", "lines and points"}
    assert {note.left_out.partition(": ")[2] for note in found.notes} == (kinds if b"usemtl" in data else set())


@pytest.mark.parametrize(
    ("kind", "values", "red"),
    [
        ("uchar", (255, 0, 0), 1.0),
        ("uchar", (1, 0, 0), 1 / 255 / 12.92),
        ("int", (128, 0, 0), 0.2158605),
        ("ushort", (32896, 0, 0), 0.2158605),
        ("float", (0.5, 1, 0), 0.2140411),  # of 1
        ("float", (127.5, 255, 0), 0.2140411),  # of 255
    ],
)
def test_ply_colours_by_their_type(kind: str, values: tuple[float, ...], red: float) -> None:
    names = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue")) + "property uchar alpha\n"
    data = ply(np.array(QUAD), [[0, 1, 2, 3]], "ascii", names, [[*values, 9]] * 4)
    found = load_object(codecs.BOM_UTF8 + data)
    ((_, material),) = found.parts
    assert material.base_colour[0] == pytest.approx(red, abs=2e-5)
    assert "alpha" in found.notes[0].left_out


def test_mirrored_textures_go_on_mirrored() -> None:
    file = GltfFile()
    pixels = np.zeros((4, 4, 3), np.uint8)
    pixels[:, 0], pixels[:, 3] = (255, 0, 0), (0, 255, 0)
    file.quad(pbrMetallicRoughness={"baseColorTexture": {"index": file.image(pixels)}})
    file.tree["samplers"] = [{"wrapS": 33648}]
    file.tree["textures"][0]["sampler"] = 0
    ((mesh, material),) = load_object(file.glb()).parts
    np.testing.assert_allclose(mesh.uvs[:, 0], np.array(QUAD_UVS)[:, 0] / 2)
    np.testing.assert_allclose(mesh.uvs[:, 1], np.array(QUAD_UVS)[:, 1])
    row = present(material.base_colour_texture).texels[0, :, :3] // 65535
    assert row.argmax(axis=1)[[0, 3, 4, 7]].tolist() == [0, 1, 1, 0]
    assert row.shape == (8, 3)


def test_a_mirrored_texture_of_several_materials_is_stored_once() -> None:
    file = GltfFile()
    base = {"baseColorTexture": {"index": file.image(np.zeros((4, 4, 3), np.uint8))}}
    file.tree["samplers"], file.tree["textures"][0]["sampler"] = [{"wrapS": 33648}], 0
    file.quad(pbrMetallicRoughness=base).quad(pbrMetallicRoughness=base)
    (_, first), (_, second) = load_object(file.glb()).parts
    assert first.base_colour_texture is second.base_colour_texture


@pytest.mark.parametrize(
    "head",
    ['{"asset": {"generator": "x", "version": 1},', '{"asset": {"version": "1.0"},', '{"techniques": {"a": {}},'],
)
def test_files_of_the_first_version_are_refused_by_name(head: str) -> None:
    with pytest.raises(ObjectError, match="glTF 2 is read, this is version"):
        load_object((head + '"scene": "defaultScene", "meshes": {}}').encode(), "gltf")


def test_coordinates_and_colours_that_an_obj_lost_are_noted() -> None:
    lost = load_object(OBJ.replace("f 1 2 3 4", "f 1/1/1 2/2/1 3/3/1 4/4/1").encode(), "obj")
    assert area(lost) == pytest.approx(1)
    np.testing.assert_allclose(np.abs(lost.parts[0][0].normals), [[0, 0, 1]] * 4)
    assert set(left_out(lost)) == {"object: texture coordinates 4 of 0", "object: normals 1 of 0"}
    before = load_object(OBJ.replace("f 1 2 3 4", "f 1/-9 2/-9 3/-9 4/-9").encode(), "obj")
    assert left_out(before) == ["object: texture coordinates -9 of 0"]
    for colour in ("1 0 0", "nan 0 0"):
        text = OBJ.replace("v 0 0 0", f"v 0 0 0 {colour}").replace("v 1 0 0", "v 1 0 0 1 0 0")
        assert ["vertices" in text for text in left_out(load_object(text.encode(), "obj"))] == [True]
    zbrush = load_object(f"#MRGB FFFF0000FF00FF00\n# a chair\n{OBJ}".encode(), "obj")
    assert ["#MRGB" in text for text in left_out(zbrush)] == [True]


def test_both_sides_of_a_sheet_keep_their_normals() -> None:
    mesh = load_object(OBJ.replace("f 1 2 3 4", "s 1\nf 1 2 3 4\nf 4 3 2 1").encode(), "obj").parts[0][0]
    np.testing.assert_allclose(np.abs(mesh.normals[:, 2]), 1)
    assert np.sign(mesh.normals[:, 2]).sum() == 0


PLY = """ply
format ascii 1.0
comment made by a program
element vertex 3
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 1
property list uchar int vertex_indices
property uchar red
property uchar green
property uchar blue
end_header
0 0 0 {vertex}
1 0 0 255 255 255
0 1 0 255 255 255
3 0 1 2 0 0 255
"""


@pytest.mark.parametrize(("vertex", "colour"), [("255 255 255", (0, 0, 1)), ("255 0 0", (1, 1, 1))])
def test_colours_of_faces_count_where_vertices_have_one_colour(vertex: str, colour: tuple[float, ...]) -> None:
    ((_, material),) = load_object(PLY.format(vertex=vertex).encode(), "ply").parts
    assert material.base_colour == pytest.approx(colour)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("red", "ambient_red", "vertex.ambient_red"),
        ("blue", "f_dc_0", "vertex.f_dc_0"),
        ("element face", "element material 0\nelement face", ""),
        ("element face", "element vertex_group 1\nproperty uchar a\nelement face", "element vertex_group"),
        ("format", "comment texture_file a.png\nformat", "texture a.png"),
        ("element vertex", "second line\nelement vertex", "'second line'"),
        ("red", "Red", ""),
    ],
)
def test_looks_of_a_ply_under_other_names_are_noted(old: str, new: str, says: str) -> None:
    text = PLY.format(vertex="255 0 0").replace(old, new, 1)
    if "vertex_group" in new:
        head, _, body = text.partition("end_header\n")
        rows = body.splitlines()
        count = int(head.split("element vertex ")[1].split()[0])
        text = head + "end_header\n" + "\n".join([*rows[:count], "1", *rows[count:]]) + "\n"
    notes = left_out(load_object(text.encode(), "ply"))
    assert [says in note for note in notes] == [True] * bool(says)


def test_points_and_lines_beside_triangles_are_noted() -> None:
    file = textured_quad()
    primitives = file.tree["meshes"][0]["primitives"]
    primitives += [{**primitives[0], "mode": mode} for mode in (0, 1)]
    one = load_object(file.glb())
    assert len(one.parts) == 1
    assert "primitives of points or lines (2)" in "".join(left_out(one))


@pytest.mark.parametrize(("scale", "parts", "noted"), [(0.0, 1, True), (1e-8, 2, False)])
def test_a_mesh_is_missing_where_its_scale_is_nothing_beside_the_others(scale: float, parts: int, noted: bool) -> None:
    file = textured_quad()
    file.tree["nodes"][0]["scale"] = [1e-8] * 3
    file.node(mesh=0, scale=[scale] * 3)
    one = load_object(file.glb())
    assert len(one.parts) == parts
    assert noted == ("a scale of 0 (1)" in "".join(left_out(one)))


# What files state wrongly and has one meaning is mended, and said


OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
OUTWARD = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]


def octahedron(kind: str, order: int, normals: float, flipped: slice = slice(None)) -> bytes:
    """A file of an octahedron with stated normals; `order` -1 turns the faces of `flipped` round."""
    faces = [list(face) for face in OUTWARD]
    faces[flipped] = [face[::order] for face in faces[flipped]]
    if kind == "ply":
        names = "".join(f"property float n{axis}\n" for axis in "xyz")
        return ply(OCTAHEDRON + 2, faces, "ascii", names, (OCTAHEDRON * normals).tolist())
    lines = [f"v {x} {y} {z}" for x, y, z in OCTAHEDRON + 2] + [f"vn {x} {y} {z}" for x, y, z in OCTAHEDRON * normals]
    lines += ["f " + " ".join(f"{index + 1}//{index + 1}" for index in face) for face in faces]
    return "\n".join(lines).encode()


def outward(mesh: TriangleMesh) -> bool:
    """Whether the octahedron's faces and normals all look outward."""
    from_centre = mesh.vertices.astype(float) - 2
    of_faces = from_centre[mesh.faces].mean(axis=1)
    return bool(((face_normals(mesh) * of_faces).sum(1) > 0).all() and ((mesh.normals * from_centre).sum(1) > 0).all())


@pytest.mark.parametrize("kind", ["obj", "ply"])
@pytest.mark.parametrize(("order", "normals", "flipped", "turned"), [
    (-1, 1.0, slice(None), "corners"), (1, -1.0, slice(None), "normals"), (-1, 1.0, slice(0, 2), "corners"),
])  # fmt: skip
def test_normals_that_oppose_the_order_of_corners_are_made_to_agree(
    kind: str, order: int, normals: float, flipped: slice, turned: str
) -> None:
    found = load_object(octahedron(kind, order, normals, flipped), kind)  # pyright: ignore[reportArgumentType]
    assert outward(found.parts[0][0])
    (note,) = found.notes
    assert note.effect == f"their {turned} are turned round"
    assert not load_object(octahedron(kind, 1, 1.0), kind).notes  # pyright: ignore[reportArgumentType]


def skinned_quad(joints: list[int], weights: list[float]) -> GltfFile:
    """A quad whose vertices have these joints and weights; joint 0 moves by 5, joint 1 by 9."""
    file = GltfFile().quad()
    file.attribute("JOINTS_0", np.tile(np.array(joints, np.uint8), (4, 1)), "VEC4", 5121)
    file.attribute("WEIGHTS_0", np.tile(np.array(weights, np.float32), (4, 1)), "VEC4")
    file.tree["nodes"][0] |= {"skin": 0, "translation": [2, 0, 0]}
    file.tree["skins"] = [{"joints": [file.node(translation=[5, 0, 0]), file.node(translation=[9, 0, 0])]}]
    return file


def test_vertices_without_weights_follow_their_first_joint() -> None:
    found = load_object(skinned_quad([1, 0, 0, 0], [0, 0, 0, 0]).glb())
    assert found.bounds()[0, 0] == 9
    assert "4 vertices whose weights are 0" in found.notes[0].left_out
    for weight in (-1, np.nan):
        with pytest.raises(ObjectError, match="negative or not finite"):
            load_object(skinned_quad([1, 0, 0, 0], [weight, 0, 0, 0]).glb())


def test_a_skin_without_joints_of_the_vertices_is_left_out() -> None:
    file = skinned_quad([0, 0, 0, 0], [1, 0, 0, 0])
    del file.primitive["attributes"]["JOINTS_0"]
    found = load_object(file.glb())
    assert found.bounds()[0, 0] == 2
    assert "its skin" in found.notes[0].left_out


def test_an_object_of_a_long_file_name_has_its_beginning_as_name(tmp_path: Path) -> None:
    path = tmp_path / f"{'a' * 120}.glb"
    path.write_bytes(GltfFile().quad().glb())
    assert scene_of_object(path, (1.0, 1.0)).objects[0].name == "a" * 100


def test_scenes_find_files_as_captures_do(tmp_path: Path) -> None:
    scene = tmp_path / "scenes" / "scene.json"
    glb = GltfFile().quad().glb()
    for name in ("scenes/models/My Cup.glb", "beside.glb"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(glb)
    for spelled in (
        r"models\My Cup.glb",
        "Models/my cup.GLB",
        "models/My%20Cup.glb",
        "../beside.glb",
        str(tmp_path / "beside.glb"),
    ):
        scene.write_text(json.dumps({"objects": [{"name": "cup", "file": spelled, "pixel": [1, 1]}]}))
        assert load_scene(scene).objects[0].geometry.triangles == 2
    (tmp_path / "scenes/models/my cup.glb").write_bytes(glb)
    scene.write_text(json.dumps({"objects": [{"name": "cup", "file": "models/MY CUP.glb", "pixel": [1, 1]}]}))
    with pytest.raises(ObjectError, match="rename one"):
        load_scene(scene)


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_georeferenced_objects_are_moved_to_the_origin(kind: str) -> None:
    far = OCTAHEDRON / 4 + [450_000, 5_500_000, 80]
    if kind == "obj":
        faces = ["f " + " ".join(str(index + 1) for index in face) for face in OUTWARD]
        data = "\n".join([f"v {x!r} {y!r} {z!r}" for x, y, z in far.tolist()] + faces).encode()
    else:
        data = ply(far, OUTWARD, "ascii").replace(b"property float", b"property double")
    found = load_object(data, kind)  # pyright: ignore[reportArgumentType]
    np.testing.assert_allclose(found.bounds(), [[-0.25] * 3, [0.25] * 3], atol=1e-7)
    assert found.notes[0].left_out.endswith("its place at 450000, 5500000, 80")
    micrometres = GltfFile()
    micrometres.node(mesh=micrometres.mesh(np.multiply(QUAD, 1e6), QUAD_FACES), scale=[1e-6] * 3)
    size_m = np.ptp(load_object(GltfFile().quad().glb()).bounds(), axis=0)
    np.testing.assert_allclose(np.ptp(load_object(micrometres.glb()).bounds(), axis=0), size_m, rtol=1e-6)
    flat = GltfFile()  # 10 m high
    flat.node(mesh=flat.mesh(np.multiply(QUAD, [1, 1e4, 1]), QUAD_FACES), scale=[1e3, 1e-3, 1])
    assert np.ptp(load_object(flat.glb()).bounds(), axis=0) == pytest.approx(size_m * [1e3, 10, 1], rel=1e-6)
    far_quad = GltfFile().quad()
    far_quad.tree["nodes"][0]["translation"] = [450_000, 5_500_000, 80]
    with pytest.raises(ObjectError, match="georeferenced"):
        load_object(far_quad.glb())


@pytest.mark.parametrize("depth", [2, 8, 16])
def test_the_clear_value_of_a_grey_png_is_transparent(depth: int) -> None:
    rows = {2: b"\0\x1b", 8: b"\0\0\1\2\3", 16: b"\0" + bytes([0, 0, 1, 1, 2, 2, 2, 3])}[depth]  # ends in 2, 3
    stated = {2: 2, 8: 2, 16: 0x202}[depth]
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", 4, 1, depth, 0, 0, 0, 0)), (b"tRNS", struct.pack(">H", stated)),
              (b"IDAT", zlib.compress(rows)), (b"IEND", b""))  # fmt: skip
    data = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )
    pixels = PictureReader(ObjectLimits()).read(data, "grey")
    assert pixels[0, :, 3].tolist() == [255, 255, 0, 255]
    if depth == 2:
        assert pixels[0, :, 0].tolist() == [0, 85, 170, 255]


def test_mirrored_textures_are_reduced_before_they_are_mirrored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(materials, "MAX_TEXTURE_SIZE", 8)
    file = GltfFile()
    pixels = np.zeros((16, 16, 3), np.uint8)
    pixels[::2] = 255
    file.quad(pbrMetallicRoughness={"baseColorTexture": {"index": file.image(pixels)}})
    file.tree["samplers"] = [{"wrapS": 33648, "wrapT": 33648}]
    file.tree["textures"][0]["sampler"] = 0
    picture = texels(load_object(file.glb()).parts[0][1].base_colour_texture)
    assert picture.shape == (8, 8, 4)
    np.testing.assert_allclose(picture[..., 0], 0.5, atol=0.01)  # the mean of light, not of sRGB


def test_joints_may_stand_beside_the_scene() -> None:
    file = skinned_quad([1, 0, 0, 0], [1, 0, 0, 0])
    file.tree["scenes"][0]["nodes"] = [0]
    assert load_object(file.glb()).bounds()[0, 0] == 9
    file.tree["skins"][0]["joints"][1] = 7
    with pytest.raises(ObjectError, match="a joint is not a node of the file"):
        load_object(file.glb())


def test_addresses_are_said_not_to_be_loaded(tmp_path: Path) -> None:
    file = GltfFile().quad(pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    file.tree |= {"images": [{"uri": "https://a.b/x.png"}], "textures": [{"source": 0}]}
    (tmp_path / "a.glb").write_bytes(file.glb())
    (note,) = load_object(tmp_path / "a.glb").notes
    assert "https://a.b/x.png'; addresses are not loaded" in note.left_out
