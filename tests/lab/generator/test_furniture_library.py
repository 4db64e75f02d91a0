"""Reading a .sh3f file: model frame, sizes, lights, and rejection of malformed files."""

import re
import zipfile

import numpy as np
import pytest
from furniture_files import MTL, box_obj, entry, png, write_library
from plain_shapes import area_m2

from roomlight.errors import FurnitureError
from roomlight_generator.rooms.furniture.assemble import build_mesh
from roomlight_generator.rooms.furniture.files.archive import Archive
from roomlight_generator.rooms.furniture.files.sh3f import read_entries


def load(path, *, role="chair", warn=None):
    warnings = []
    with Archive(path) as archive:
        (library_entry,) = read_entries(archive, warnings.append)
        return library_entry, build_mesh(archive, library_entry, role=role, warn=warn or warnings.append)


def library(tmp_path, obj, *, mtl=MTL, files=None, **properties):
    return write_library(
        tmp_path / "a.sh3f", entry(1, "a", **properties), {"a/a.obj": obj, "a/m.mtl": mtl, **(files or {})}
    )


def two_part_obj():
    """Return a chair whose front is toward +z: a seat 1 x 0.4 x 1 and a back at low z."""
    back = box_obj((0, 0.4, 0), (1, 1, 0.2), material="back", library="", first=9)
    return box_obj((0, 0, 0), (1, 0.4, 1)) + back


def test_models_stand_on_the_floor_in_metres_facing_plus_z(tmp_path):
    library_entry, mesh = load(library(tmp_path, two_part_obj()))
    np.testing.assert_allclose(mesh.bounds(), [[-0.25, 0, -0.3], [0.25, 0.9, 0.3]], atol=1e-6)
    high = mesh.vertices[mesh.vertices[:, 1] > 0.5]
    assert high[:, 2].max() < -0.1
    assert (library_entry.width_m, library_entry.depth_m, library_entry.height_m) == (0.5, 0.6, 0.9)
    assert library_entry.attribution == "Chair: Ann Onymous, CC-BY 3.0"


def test_the_rotation_is_applied_before_the_size(tmp_path):
    """The back at low z moves to low x: a 90 degree rotation that maps z to x and x to -z."""
    _, mesh = load(library(tmp_path, two_part_obj(), modelRotation="0 0 1 0 1 0 -1 0 0"))
    np.testing.assert_allclose(mesh.bounds(), [[-0.25, 0, -0.3], [0.25, 0.9, 0.3]], atol=1e-6)
    assert mesh.vertices[mesh.vertices[:, 1] > 0.5][:, 0].max() < -0.1


def test_lights_are_in_the_model_frame(tmp_path):
    path = library(
        tmp_path,
        box_obj(),
        name="Desk lamp",
        lightSourceX="10 25",
        lightSourceY="20 30",
        lightSourceZ="70 80",
        lightSourceColor="#808080 #ff8000",
        lightSourceDiameter="6 4",
    )
    library_entry, _ = load(path, role="table_lamp")
    first, second = library_entry.lights
    # x from the left, y from the front (20 of 60 cm behind it), z from the floor.
    np.testing.assert_allclose(first.position, [-0.15, 0.7, 0.1], atol=1e-6)
    assert first.diameter_m == pytest.approx(0.06)
    assert first.colour == (1, 1, 1)
    np.testing.assert_allclose(second.position, [0, 0.8, 0], atol=1e-6)
    assert second.colour == pytest.approx((1, 0.2158, 0), abs=1e-3)


def test_lights_around_a_lamp_merge_into_one_inside(tmp_path):
    sides = {
        "lightSourceX": "-10 60",
        "lightSourceY": "30 30",
        "lightSourceZ": "40 40",
        "lightSourceColor": "#fff #fff",
    }
    library_entry, _ = load(library(tmp_path, box_obj(), **sides))
    (light,) = library_entry.lights
    np.testing.assert_allclose(light.position, [0, 0.4, 0], atol=1e-6)


def test_materials_and_texture_orientation_are_read(tmp_path):
    image = np.zeros((4, 4, 3), np.uint8)
    image[:2] = 255
    mtl = "newmtl wood\nKd 0.1 0.1 0.1\nmap_Kd pic.png\n"
    _, mesh = load(library(tmp_path, box_obj(), mtl=mtl, files={"a/pic.png": png(image)}))
    (material,) = mesh.materials
    assert material.texture is not None
    np.testing.assert_array_equal(material.texture.image, image)
    # OBJ's v = 1 is the image's top row, which is v = 0 here; corners 1 and 2 of a face have OBJ's v = 0.
    top = mesh.uvs[:, 1] < 0.5
    assert top.sum() == (~top).sum() == 12
    assert material.albedo == (0.95, 0.95, 0.95)


def test_a_missing_texture_warns_and_uses_the_colour(tmp_path):
    warnings = []
    path = library(tmp_path, box_obj(), mtl="newmtl wood\nKd 0.5 0 0\nmap_Kd C:\\pics\\gone.png\n")
    _, mesh = load(path, warn=warnings.append)
    assert mesh.materials[0].texture is None
    assert mesh.materials[0].albedo[0] > 3 * mesh.materials[0].albedo[1]
    assert len(warnings) == 1
    assert "gone.png" in warnings[0]
    assert "'a'" in warnings[0]


def test_a_model_made_only_of_glass_is_visible(tmp_path):
    _, mesh = load(library(tmp_path, box_obj(), mtl="newmtl wood\nKd 1 1 1\nd 0.1\n"))
    assert not mesh.materials[0].glass
    mtl = "newmtl wood\nKd 1 1 1\nd 0.1\nnewmtl back\nKd 1 1 1\n"
    _, mesh = load(library(tmp_path, two_part_obj(), mtl=mtl))
    assert [material.glass for material in mesh.materials] == [True, False]


def test_leaves_are_cut_out_of_their_rectangles(tmp_path):
    image = np.full((32, 32, 4), 200, np.uint8)
    image[..., 3] = np.where(np.hypot(*np.mgrid[-16:16, -16:16]) < 15, 255, 0)
    mtl = "newmtl wood\nKd 1 1 1\nmap_Kd leaf.png\n"
    path = library(tmp_path, box_obj(), mtl=mtl, files={"a/leaf.png": png(image)})
    _, leafy = load(path, role="plant")
    _, whole = load(path, role="chair")
    cut, uncut = (area_m2(mesh.vertices, mesh.faces).sum() for mesh in (leafy, whole))
    # Each of the box's faces shows the picture once; a chair's triangles are kept or removed whole.
    assert cut == pytest.approx((image[..., 3] > 0).mean() * uncut, rel=0.08)
    assert len(leafy.faces) > 100
    assert len(whole.faces) == 12


@pytest.mark.parametrize(
    ("properties", "said"),
    [
        ({"width": "wide"}, "width is 'wide'"),
        ({"width": None}, "width is ''"),
        ({"height": "1e9"}, "implausible"),
        ({"depth": "0"}, "implausible"),
        ({"height": "nan"}, "height is nan"),
        ({"modelRotation": "1 2 3"}, "not a rotation"),
        ({"modelRotation": "1 0 0 0 1 0 0 0 9"}, "not a rotation"),
        ({"modelRotation": "1 0 0 0 q 0 0 0 1"}, "not a number"),
        ({"model": "/a/gone.obj"}, "gone.obj.*not in the library"),
        ({"model": "/a/a.dae"}, "only OBJ"),
        ({"model": "/../../etc/a.obj"}, "leads out"),
        ({"lightSourceX": "p"}, "lightSourceX is 'p'"),
    ],
)
def test_a_malformed_model_is_left_out_and_named(tmp_path, properties, said):
    catalogue = entry(1, "broken", **{"model": "/a/a.obj", **properties}) + entry(2, "a")
    path = write_library(tmp_path / "l.sh3f", catalogue, {"a/a.obj": box_obj(), "a/m.mtl": MTL})
    warnings = []
    with Archive(path) as archive:
        entries = read_entries(archive, warnings.append)
    assert [kept.id for kept in entries] == ["a"]
    (warning,) = warnings
    assert str(path) in warning
    assert re.search(said, warning), warning


def test_a_library_without_a_usable_model_is_refused(tmp_path):
    path = write_library(tmp_path / "l.sh3f", entry(1, "a", width="x"), {})
    with Archive(path) as archive, pytest.raises(FurnitureError, match="none of the 1 models"):
        read_entries(archive, lambda _: None)


def test_a_flipped_byte_in_a_member_is_detected(tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr("a.obj", "v 1 2 3\n" * 100)
    data = bytearray(path.read_bytes())
    data[200] ^= 1
    path.write_bytes(data)
    with Archive(path) as archive, pytest.raises(FurnitureError, match=r"a\.obj cannot be unpacked"):
        archive.read("a.obj")


def test_a_zip_bomb_is_not_unpacked(tmp_path):
    path = write_library(tmp_path / "a.sh3f", None, {"bomb": b"\0" * 3_000_000})
    with Archive(path) as archive, pytest.raises(FurnitureError, match="bomb is longer than 1 MB"):
        archive.read("bomb", limit=1 << 20)


def test_member_names_ignore_case_and_slash_direction(tmp_path):
    path = write_library(tmp_path / "a.sh3f", None, {"Dir/My File.PNG": b"x", "b.mtl": b"y"})
    with Archive(path) as archive:
        assert archive.find("my%20file.png", relative_to="Dir/a.obj") == "Dir/My File.PNG"
        assert archive.find("..\\B.MTL", relative_to="Dir/a.obj") == "b.mtl"
        assert archive.find("/b.mtl", relative_to="Dir/a.obj") == "b.mtl"
        assert archive.find("c") is None
        with pytest.raises(FurnitureError, match="leads out"):
            archive.find("../../b.mtl", relative_to="Dir/a.obj")


def test_a_model_with_zero_area_is_refused(tmp_path):
    flat = "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"
    with pytest.raises(FurnitureError, match="zero area or are transparent"):
        load(library(tmp_path, flat))
