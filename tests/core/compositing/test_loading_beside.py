"""Objects whose files lie beside them: glTF folders, and OBJ with materials."""

import json
from pathlib import Path

import numpy as np
import pytest
from gltf_files import left_out, png, shows, textured_quad
from PIL import Image

from colour_profiles import matrix_profile
from present import present
from roomlight.compositing.loading import load_object
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.compositing.objects.textures import Texture
from roomlight.errors import ObjectError

RED = np.full((4, 4, 3), (200, 10, 20), np.uint8)
OBJ = "mtllib my room.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
OBJ += "usemtl Dark wood\nf 1/1 2/2 3/3\nusemtl steel\nf 1/1 3/3 4/4\n"
MTL = "newmtl Dark wood\nKd 1 1 1\nmap_Kd -s 1 1 1 maps\\wood red.png\nnewmtl steel\nKd 0.5 0.5 0.5\n"
MTL += "Ks 0.5 0.5 0.5\nNs 250\nNi 1.0\nPm 1\nd 0.25\nmap_Bump bump.png\n"


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
    "uri", ["../secret.bin", "textures/../../secret.bin", "linked.bin", "missing.bin", "a\0b", "textures"]
)
def test_nothing_outside_the_folder_is_read(tmp_path: Path, uri: str) -> None:
    path = gltf_folder(tmp_path / "model", buffer=uri)
    (tmp_path / "secret.bin").write_bytes((path.parent / "scene.bin").read_bytes())
    (path.parent / "linked.bin").symlink_to(tmp_path / "secret.bin")
    with pytest.raises(ObjectError, match=r"buffer 0: .*; put it into the object's folder"):
        load_object(path)
    absolute = gltf_folder(tmp_path / "absolute", buffer=str(tmp_path / "secret.bin"))
    with pytest.raises(ObjectError, match="not a path inside the folder"):
        load_object(absolute)


def test_files_beside_count_together(tmp_path: Path) -> None:
    path = gltf_folder(tmp_path)
    with pytest.raises(ObjectError, match="file bytes are limited to"):
        load_object(path, limits=ObjectLimits(file_bytes=path.stat().st_size + 10))


def obj_folder(folder: Path, materials: str = MTL) -> Path:
    (folder / "maps").mkdir()
    (folder / "maps" / "wood red.png").write_bytes(png(RED))
    (folder / "my room.mtl").write_text(materials)
    (folder / "chair.obj").write_text(OBJ)
    return folder / "chair.obj"


def test_obj_reads_its_materials_and_their_textures(tmp_path: Path) -> None:
    chair = load_object(obj_folder(tmp_path))
    (_, wood), (_, steel) = chair.parts
    assert chair.triangles == 2
    assert shows(wood.base_colour_texture, RED)
    assert (wood.specular, wood.roughness, wood.opacity) == (0, 1, 1)
    assert steel.base_colour == pytest.approx((0.214, 0.214, 0.214), abs=1e-3)
    assert (steel.metallic, steel.specular, steel.opacity, steel.ior) == (1, 1, 0.25, 1.5)
    assert steel.roughness == pytest.approx(0.5)  # Ns 250 of 1000
    assert [note.rpartition(": ")[2] for note in left_out(chair)] == ["relief"]


def test_what_lies_not_beside_an_obj_is_noted(tmp_path: Path) -> None:
    path = obj_folder(tmp_path)
    (tmp_path / "maps" / "wood red.png").unlink()
    assert any("map_kd" in note.left_out and "object's folder" in note.left_out for note in load_object(path).notes)
    (tmp_path / "my room.mtl").unlink()
    (note,) = load_object(path).notes
    assert "my room.mtl" in note.left_out
    assert note.effect == "the object is grey"
    (note,) = load_object(path.read_bytes(), "obj").notes
    assert "export as GLB" in note.advice


@pytest.mark.parametrize("kind", ["bmp", "gif", "tga", "tif", "txt", "deep.tif"])
def test_pictures_of_an_obj_are_read_in_older_formats_or_noted(tmp_path: Path, kind: str) -> None:
    path = obj_folder(tmp_path, f"newmtl Dark wood\nmap_Kd wood.{kind}\n")
    if kind == "txt":
        (tmp_path / "wood.txt").write_text("wood")
    else:
        Image.fromarray(RED[..., 0].astype(np.uint16) if kind == "deep.tif" else RED).save(tmp_path / f"wood.{kind}")
    found = load_object(path)
    texture = found.parts[0][1].base_colour_texture
    if kind in ("txt", "deep.tif"):
        assert texture is None
        assert ("is neither PNG" if kind == "txt" else "8 bits are read") in found.notes[0].left_out
    else:
        assert shows(texture, RED)


def test_odd_numbers_in_materials_keep_their_defaults(tmp_path: Path) -> None:
    path = obj_folder(tmp_path, "newmtl Dark wood\nKd nan 1 1\nNs -4\nTr 0,5\nKe 9\nPr 2\nnewmtl steel\nKd 0.2\n")
    (_, wood), (_, steel) = load_object(path).parts
    assert wood.base_colour == pytest.approx((0.604,) * 3, abs=1e-3)  # 0.8 in sRGB
    assert (wood.roughness, wood.opacity, wood.emissive) == (1, 0.5, (9, 9, 9))
    assert steel.base_colour == pytest.approx((0.0331,) * 3, abs=1e-4)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("Kd 128 0 0", "Kd of 128"),
        ("Kd spectral metal.rfl", "Kd spectral"),
        ("Ps 1", "sheen"),
        ("Pc 0\nPs 0.0\nPcr 0.03\naniso 0\nanisor 0", ""),
        ("Tf 1.0000 1.0000 1.0000", ""),
        ("Tf 1 0.5 1", "coloured glass"),
        ("Tf spectral glass.rfl", "coloured glass"),
        ("map_Kd -s 2 2 1 maps/wood red.png", "scale, offset"),
        ("map_Kd -o 0 0.5 maps/wood red.png", "scale, offset"),
        ("map_Kd -s 1 1.0 1 -o 0 0 0 maps/wood red.png", ""),
        ('map_Kd "maps/wood red.png"', ""),
        ("map_Kd -mm 0 0.5 maps/wood red.png", "-mm"),
        ("map_Kd -mm 0 1 maps/wood red.png", ""),
        ("map_Ka maps/wood red.png\nmap_Kd maps/wood red.png", ""),
        ("map_Ka maps/wood red.png", "map_ka"),
        ("map_ORM maps/wood red.png", "map_orm"),
        ("illum 0", "illum 0"),
        ("Kd 0.5 0 0\nd -halo 0.5", ""),
    ],
)
def test_what_a_material_states_is_read_or_noted(tmp_path: Path, line: str, says: str) -> None:
    chair = load_object(obj_folder(tmp_path, f"newmtl Dark wood\n{line}\nnewmtl steel\n"))
    assert [says in note for note in left_out(chair)] == [True] * bool(says)
    wood = chair.parts[0][1]
    assert (wood.base_colour_texture is not None) == ("map_Kd" in line)
    assert wood.opacity == (0.5 if "halo" in line else 1)
    if "128" in line:
        assert wood.base_colour == pytest.approx((0.2158605, 0, 0), abs=1e-5)


def test_textures_of_an_obj_have_a_colour_profile(tmp_path: Path) -> None:
    path = obj_folder(tmp_path)
    profile = matrix_profile((0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329))
    Image.fromarray(RED).save(tmp_path / "maps" / "wood red.png", icc_profile=profile)
    texture = present(load_object(path).parts[0][1].base_colour_texture)
    assert texture.texels[0, 0, 0] > 1.15 * Texture.from_srgb8(RED).texels[0, 0, 0]  # P3's red is redder
