"""What files state wrongly or loosely and has one meaning is mended, and said."""

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from gltf_files import GltfFile, face_normals, ply, texels

from roomlight.compositing.loading import load_object
from roomlight.compositing.objects.gltf import materials
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.compositing.objects.pictures import PictureReader
from roomlight.compositing.objects.virtual_object import TriangleMesh
from roomlight.compositing.placement.scene import load_scene
from roomlight.compositing.recordings import scene_of_object
from roomlight.errors import ObjectError

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
