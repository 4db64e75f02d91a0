"""OBJ with MTL, and PLY, as programs write them: names, paths, numbers and colours that other readers take."""

import os
import time
from pathlib import Path

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_QUADS, QUAD_FACES, GltfFile, area, face_normals, left_out, ply, png, shows
from gltf_files import QUAD as CORNERS
from PIL import Image

from colour_profiles import matrix_profile
from present import present
from roomlight.compositing.loading import load_object
from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.polygons import corner_normals, ear_clipped
from roomlight.compositing.objects.textures import Texture
from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.errors import ObjectError

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACES = ("f 1/1 2/2 3/3\n", "f 1/1 3/3 4/4\n")
RED = np.full((4, 4, 3), (200, 10, 20), np.uint8)
MTL = "newmtl Dark wood\nKd 1 1 1\nmap_Kd -s 1 1 1 maps\\wood red.png\nnewmtl steel\nKd 0.5 0.5 0.5\n"
MTL += "Ks 0.5 0.5 0.5\nNs 250\nNi 1.0\nPm 1\nd 0.25\nmap_Bump bump.png\n"


def quad_of(
    folder: Path, materials: str, *, names: tuple[str, ...] = ("m",), code: str = "utf-8", library: str = "a.mtl"
) -> Path:
    """Write a quad, each of its triangles with a material of this name, and its library."""
    used = [f"usemtl {name}\n{face}" for name, face in zip(names * 2, FACES, strict=False)]
    (folder / library).write_bytes(materials.encode(code))
    (folder / "a.obj").write_bytes((f"mtllib {library}\n" + QUAD + "".join(used)).encode(code))
    return folder / "a.obj"


def chair_of(folder: Path, materials: str = MTL) -> Path:
    """Write a quad of dark wood and steel, and a texture in a folder beside it."""
    (folder / "maps").mkdir()
    (folder / "maps" / "wood red.png").write_bytes(png(RED))
    return quad_of(folder, materials, names=("Dark wood", "steel"), library="my room.mtl")


def notes_of(found: VirtualObject) -> list[str]:
    return [str(note) for note in found.notes]


def material_of(path: Path) -> Material:
    return load_object(path).parts[0][1]


# Names


@pytest.mark.parametrize(
    ("names", "code"),
    [
        (("Material #25", "Material #26"), "utf-8"),
        (("\u7ea2\u8272", "\u84dd\u8272"), "gbk"),
        (("St\u00fchle", "St\u00e4be"), "latin-1"),
    ],
)
@pytest.mark.parametrize("gap", [" ", "\t", " \t "])
def test_names_of_materials_stay_apart(tmp_path: Path, names: tuple[str, str], code: str, gap: str) -> None:
    text = f"newmtl{gap}{names[0]}\n{gap}Kd{gap}1 0 0 # red\nnewmtl{gap}{names[1]}\nKd{gap}0\t0 1\n"
    path = quad_of(tmp_path, text, names=names, code=code)
    path.write_bytes(path.read_bytes().replace(b"usemtl ", f"usemtl{gap}".encode()))
    found = load_object(path)
    assert [material.base_colour for _, material in found.parts] == [(1, 0, 0), (0, 0, 1)]
    assert not found.notes


def test_a_clear_coat_is_read_and_a_texture_with_a_number_sign_in_its_name(tmp_path: Path) -> None:
    (tmp_path / "red #1.png").write_bytes(png(RED))
    material = material_of(quad_of(tmp_path, "newmtl m\nmap_Kd\tred #1.png\nPc 0.8\nPcr 0.2\n"))
    assert material.base_colour_texture is not None
    assert (material.clearcoat, material.clearcoat_roughness) == (0.8, 0.2)


# Polygons


def test_many_faces_at_one_place_take_little_time() -> None:
    """A cone of 20,000 faces, as many without area at its tip, and a star of 4,000 corners: minutes before."""
    turn = np.arange(20_000) * (2 * np.pi / 20_000)
    ring = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
    faces = np.stack([0 * turn, 1 + np.roll(np.arange(20_000), -1), 1 + np.arange(20_000)], axis=1).astype(np.int64)
    points = np.concatenate([[[0.0, 1.0, 0.0]], ring])
    star = ring[::5] * np.where(np.arange(4_000) % 2, 1.0, 0.7)[:, None]
    ear_clipped(star[:9])  # compiles it
    started = time.process_time()
    normals = corner_normals(points, np.concatenate([faces, np.zeros_like(faces)])).reshape(-1, 3, 3)[:20_000, 0]
    triangles, _ = ear_clipped(star)
    assert time.process_time() - started < 5
    assert np.degrees(np.arccos((normals * np.roll(normals, 1, axis=0)).sum(1).min())) < 0.1  # no streaks
    corners = star[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert areas.sum() == pytest.approx(2000 * 0.7 * np.sin(np.pi / 2000), rel=1e-6)
    with pytest.raises(ObjectError, match="export triangles"):
        ear_clipped(star, 1000)


def test_the_normals_of_many_faces_are_near_those_of_few() -> None:
    """A cone of 65 faces, of which corners that look alike count as one, beside one of 64."""
    tips: list[float] = []
    for count in (64, 65):
        turn = np.arange(count) * (2 * np.pi / count)
        points = np.concatenate([[[0.0, 1.0, 0.0]], np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)])
        faces = np.stack([0 * turn, 1 + np.roll(np.arange(count), -1), 1 + np.arange(count)], axis=1).astype(np.int64)
        tips.append(float(corner_normals(points, faces).reshape(-1, 3, 3)[:, 0, 1].mean()))
    assert tips[1] == pytest.approx(tips[0], abs=0.02)


# Numbers


@pytest.mark.parametrize("line", ["vn nan nan nan", "vn -nan(ind) 0 1", "vt nan nan", "v inf 0 0", "v -nan(ind) 0 0"])
def test_numbers_that_are_not_finite_are_not_stated(line: str) -> None:
    key = line.split()[0]
    face = {"vn": "f 1//1 2//1 3//1 4//1\n", "vt": "f 1/5 2/2 3/3 4/4\n", "v": "f 1 2 3 4\n"}[key]
    found = load_object((QUAD + line + "\n" + face).encode(), "obj")
    ((mesh, _),) = found.parts
    np.testing.assert_array_equal(mesh.normals, [[0, 0, 1]] * 4)
    assert area(found) == pytest.approx(1)
    assert ["not finite" in note for note in notes_of(found)] == [True] * (key != "v")
    with pytest.raises(ObjectError, match=r"v 5 is .* a face needs finite numbers"):
        load_object((QUAD + "v 0 nan 0\nf 1 2 3 5\n").encode(), "obj")


NORMALS = "property float nx\nproperty float ny\nproperty float nz\n"
UVS = "property float s\nproperty float t\n"
COLOURS = "property float red\nproperty float green\nproperty float blue\n"


@pytest.mark.parametrize("odd", ["nan", "-nan(ind)", "inf"])
@pytest.mark.parametrize(("extra", "row"), [(NORMALS, [0, 0, 1]), (UVS, [0.5, 1]), (COLOURS, [0, 0, 0])])
def test_numbers_of_a_ply_that_are_not_finite_are_not_stated(odd: str, extra: str, row: list[int]) -> None:
    points = np.array([*CORNERS, [9, 9, 9]], object)
    points[4] = odd
    found = load_object(ply(points, [[0, 1, 2, 3]], "ascii", extra, [[odd] * len(row), *[row] * 4]), "ply")
    ((mesh, material),) = found.parts
    np.testing.assert_array_equal(mesh.normals, [[0, 0, 1]] * 4)
    assert extra != COLOURS or material.base_colour == (0, 0, 0)
    assert ["not finite" in note for note in notes_of(found)] == [True]
    with pytest.raises(ObjectError, match=r"vertex 4 is .* a face needs finite numbers"):
        load_object(ply(points, [[0, 1, 2, 4]], "ascii"), "ply")


@pytest.mark.parametrize(("key", "kind"), [("NORMAL", "VEC3"), ("TEXCOORD_0", "VEC2"), ("TANGENT", "VEC4")])
def test_numbers_of_a_gltf_that_are_not_finite_are_not_stated(key: str, kind: str) -> None:
    file = GltfFile()
    normals = [[0, 0, 1]] * 4 if key == "TANGENT" else None
    file.node(mesh=file.mesh(CORNERS, QUAD_FACES, normals=normals))
    values = np.array([[0, 0, 1, 1][: int(kind[-1])]] * 4, np.float32)
    values[1, 0] = np.nan
    file.attribute(key, values, kind)
    found = load_object(file.glb())
    np.testing.assert_array_equal(found.parts[0][0].normals, [[0, 0, 1]] * len(found.parts[0][0].normals))
    assert [key in note for note in notes_of(found)] == [True]


def test_normals_of_a_ply_that_are_all_zero_are_not_stated() -> None:
    ((mesh, _),) = load_object(ply(CUBE, CUBE_QUADS, "ascii", NORMALS, [[0, 0, 0]] * 8), "ply").parts
    np.testing.assert_allclose(mesh.normals[mesh.faces[:, 0]], face_normals(mesh), atol=1e-6)


@pytest.mark.parametrize(
    ("colour", "red", "note"),
    [((1.00001, 0, 0), 1, True), ((-0.001, 0, 0), 0, True), ((255, 0, 0), 1, False), ((1, 0, 0), 1, False)],
)
def test_vertex_colours_beside_their_range_are_clipped(colour: tuple[float, ...], red: float, note: bool) -> None:
    words = " ".join(map(str, colour))
    text = "".join(f"v {x} {y} {z} {words}\n" for x, y, z in CORNERS) + "f 1 2 3 4\n"
    for data in (text.encode(), ply(np.array(CORNERS), [[0, 1, 2, 3]], "ascii", COLOURS, [list(colour)] * 4)):
        found = load_object(data, "ply" if data.startswith(b"ply") else "obj")
        assert found.parts[0][1].base_colour == pytest.approx((red, 0, 0))
        assert ["vertex colours from" in line for line in notes_of(found)] == [True] * note


# Materials


@pytest.mark.parametrize(("colours", "noted"), [(("1 1 1",) * 4, 0), (("1 0 0",) * 4, 1), (("1 0 0", "0 1 0") * 2, 1)])
def test_vertex_colours_do_not_darken_a_texture(tmp_path: Path, colours: tuple[str, ...], noted: int) -> None:
    (tmp_path / "red.png").write_bytes(png(RED))
    path = quad_of(tmp_path, "newmtl m\nmap_Kd red.png\nnewmtl n\nmap_Kd red.png\n", names=("m", "n"))
    rows = zip(QUAD.splitlines()[:4], colours, strict=True)
    coloured = "".join(f"{row} {colour}\n" for row, colour in rows)
    path.write_text(path.read_text().replace("".join(QUAD.splitlines(keepends=True)[:4]), coloured))
    found = load_object(path)
    assert [material.base_colour for _, material in found.parts] == [(1, 1, 1)] * 2
    assert ["vertex colours" in note for note in notes_of(found)] == [True] * noted


def test_missing_materials_are_noted_beside_other_notes(tmp_path: Path) -> None:
    path = quad_of(tmp_path, "newmtl m\nmap_Bump a.png\n", names=("m", "lost"))
    assert ["materials lost" in note for note in notes_of(load_object(path))] == [False, True]
    (tmp_path / "a.mtl").unlink()
    assert ["materials lost" in note for note in notes_of(load_object(path))] == [False]


@pytest.mark.parametrize("line", ["d 0", "Tr 1\nd 0"])
def test_invisible_parts_are_noted(tmp_path: Path, line: str) -> None:
    (note,) = notes_of(load_object(quad_of(tmp_path, f"newmtl m\n{line}\nnewmtl unused\nd 0\n")))
    assert "of m: these parts are invisible" in note


# Files beside


@pytest.mark.parametrize(
    "stated",
    [
        "C:\\\\Users\\me\\01 red.png",
        "/home/me/01 red.png",
        "..\\textures\\01 red.png",
        "-imfchan m -type sphere 01 red.png",
        "-s 1 1 1 01 red.png",
        "-clamp off -bm 0.5 01 red.png",
        "01 red.png # of wood",
        '-blendu on "01 red.png"',
    ],
)
def test_textures_are_found_under_the_addresses_of_other_computers(tmp_path: Path, stated: str) -> None:
    (tmp_path / "01 red.png").write_bytes(png(RED))
    found = load_object(quad_of(tmp_path, f"newmtl m\nmap_Kd {stated}\n"))
    assert found.parts[0][1].base_colour_texture is not None
    says = "beside it is read" if "me" in stated or ".." in stated else "-imfchan"
    assert [says in note for note in notes_of(found)] == [True] * (says != "-imfchan" or says in stated)


@pytest.mark.parametrize(
    "stated", ['"a.mtl"', "C:\\me\\a.mtl", "a.mtl b.mtl", "b.mtl a.mtl", "a.mtl # made", "../a.mtl"]
)
def test_libraries_are_found_as_programs_name_them(tmp_path: Path, stated: str) -> None:
    path = quad_of(tmp_path, "newmtl m\nKd 1 0 0\n")
    (tmp_path / "b.mtl").write_text("newmtl n\nKd 0 0 1\n")
    path.write_text(path.read_text().replace("mtllib a.mtl", f"mtllib {stated}"))
    found = load_object(path)
    assert found.parts[0][1].base_colour == (1, 0, 0)
    assert ["beside it is read" in note for note in notes_of(found)] == [True] * ("me" in stated or ".." in stated)


@pytest.mark.parametrize("stored", ["\u7ea2.png", b"\xba\xec.png"], ids=["as UTF-8", "as bytes"])
def test_a_texture_is_found_under_a_name_of_another_code_page(tmp_path: Path, stored: str | bytes) -> None:
    target = os.path.join(os.fsencode(tmp_path), os.fsencode(stored))  # noqa: PTH118  (bytes)
    with open(target, "wb") as file:  # noqa: PTH123
        file.write(png(RED))
    path = quad_of(tmp_path, "newmtl m\nmap_Kd \u7ea2.png\n", code="gbk")
    assert material_of(path).base_colour_texture is not None


@pytest.mark.parametrize(("materials", "libraries"), [(300, 0), (1, 300)])
def test_materials_and_libraries_on_a_line_are_limited(tmp_path: Path, materials: int, libraries: int) -> None:
    path = quad_of(tmp_path, "".join(f"newmtl m{number}\n" for number in range(materials)))
    path.write_text(path.read_text().replace("mtllib a.mtl", "mtllib a.mtl" + " b" * libraries))
    with pytest.raises(ObjectError, match="materials are limited to 256"):
        load_object(path)


# What materials state


def test_obj_reads_its_materials_and_their_textures(tmp_path: Path) -> None:
    chair = load_object(chair_of(tmp_path))
    (_, wood), (_, steel) = chair.parts
    assert chair.triangles == 2
    assert shows(wood.base_colour_texture, RED)
    assert (wood.specular, wood.roughness, wood.opacity) == (0, 1, 1)
    assert steel.base_colour == pytest.approx((0.214, 0.214, 0.214), abs=1e-3)
    assert (steel.metallic, steel.specular, steel.opacity, steel.ior) == (1, 1, 0.25, 1.5)
    assert steel.roughness == pytest.approx(0.5)  # Ns 250 of 1000
    assert [note.rpartition(": ")[2] for note in left_out(chair)] == ["relief"]


def test_what_lies_not_beside_an_obj_is_noted(tmp_path: Path) -> None:
    path = chair_of(tmp_path)
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
    path = chair_of(tmp_path, f"newmtl Dark wood\nmap_Kd wood.{kind}\n")
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


def test_colours_and_metals_of_blender_are_read_as_it_writes_them(tmp_path: Path) -> None:
    picture = "Kd 0.8 0.8 0.8\nKe 0 0 0\nmap_Kd maps/wood red.png\nmap_Ke maps/wood red.png\nKa 1 1 1\nillum 2\n"
    metal = "Ka 0.75 0.75 0.75\nKd 0.2 0.05 0.02\nKe 4 0.5 0\nillum 3\n"
    stated = f"newmtl Dark wood\n{picture}newmtl steel\n{metal}"
    path = chair_of(tmp_path, f"# Blender 4.2.0 MTL File: 'a.blend'\n\n{stated}")
    (_, wood), (_, steel) = load_object(path).parts
    assert (wood.base_colour, wood.emissive, wood.metallic) == ((1, 1, 1), (1, 1, 1), 0)
    assert (steel.base_colour, steel.emissive, steel.metallic) == ((0.2, 0.05, 0.02), (4, 0.5, 0), 0.75)
    (tmp_path / "my room.mtl").write_text(stated)
    (_, wood), (_, steel) = load_object(path).parts
    assert wood.base_colour == pytest.approx((0.604,) * 3, abs=1e-3)
    assert (wood.emissive, steel.metallic) == ((0, 0, 0), 0)


def test_odd_numbers_in_materials_keep_their_defaults(tmp_path: Path) -> None:
    path = chair_of(tmp_path, "newmtl Dark wood\nKd nan 1 1\nNs -4\nTr 0,5\nKe 9\nPr 2\nnewmtl steel\nKd 0.2\n")
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
        ("Tr 1.000000", "Tr of 1"),
        ("Tr 1\nd 1", ""),
    ],
)
def test_what_a_material_states_is_read_or_noted(tmp_path: Path, line: str, says: str) -> None:
    chair = load_object(chair_of(tmp_path, f"newmtl Dark wood\n{line}\nnewmtl steel\n"))
    assert [says in note for note in left_out(chair)] == [True] * bool(says)
    wood = chair.parts[0][1]
    assert (wood.base_colour_texture is not None) == ("map_Kd" in line)
    assert wood.opacity == (0.5 if "halo" in line else 1)
    if "128" in line:
        assert wood.base_colour == pytest.approx((0.2158605, 0, 0), abs=1e-5)


def test_textures_of_an_obj_have_a_colour_profile(tmp_path: Path) -> None:
    path = chair_of(tmp_path)
    profile = matrix_profile((0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329))
    Image.fromarray(RED).save(tmp_path / "maps" / "wood red.png", icc_profile=profile)
    texture = present(load_object(path).parts[0][1].base_colour_texture)
    assert texture.texels[0, 0, 0] > 1.15 * Texture.from_srgb8(RED).texels[0, 0, 0]  # P3's red is redder
