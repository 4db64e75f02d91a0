"""OBJ, MTL and property files: parsing, and rejection of malformed files."""

import cv2
import numpy as np
import pytest
from furniture_files import box_obj, png
from plain_shapes import volume_m3

from roomlight.errors import FurnitureError
from roomlight_generator.rooms.furniture.files.obj import parse_mtl, parse_obj
from roomlight_generator.rooms.furniture.files.properties import numbered_entries, parse_properties
from roomlight_generator.rooms.furniture.files.textures import decode_image


def test_a_box_has_twelve_outward_facing_triangles():
    obj = parse_obj(box_obj().encode(), "box")
    assert obj.faces.shape == (12, 3)
    assert volume_m3(obj.positions, obj.faces) == pytest.approx(1.0)
    assert obj.material_names == ("wood",)
    assert obj.libraries == ("m.mtl",)


def test_indices_may_be_negative_corner_parts_missing_normals_unreadable_and_lines_continued():
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0.5 0.25\nvn 0 0 one\nf -3//1 \\\n -2/-1 -1/1/1\nf 1/-9 2/1 3/1\n"
    obj = parse_obj(text.encode(), "t")
    assert obj.faces.tolist() == [[0, 1, 2]] * 2
    assert obj.uv_faces.tolist() == [[-1, 0, 0]] * 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("v 0 0 0\n", "no face"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 3\n", "v 3 of 2"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf -1 -x 2\n", "line 4 has the corner '-x'"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 99999999999999999999999\n", "line 4 has the corner '9"),
        ("v 0 nan 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n", "finite"),
    ],
)
def test_damaged_models_are_refused_by_name(text, said):
    with pytest.raises(FurnitureError, match=f"library: sofa.obj.*{said}"):
        parse_obj(text.encode(), "library: sofa.obj")


def test_materials_are_read_and_malformed_lines_skipped():
    text = (
        "newmtl red paint\nKd 1 0 0\nKs 0.5\nNs 96\nTr 0.25\nmap_Kd -s 1 1 1 my wood.png\nKd x y z\nnewmtl b\nd 0.4\n\n"
    )
    materials = parse_mtl(text.encode())
    red = materials["red paint"]
    assert red.diffuse == (1, 0, 0)
    assert red.specular == (0.5, 0.5, 0.5)
    assert red.shininess == 96
    assert red.opacity == 0.75
    assert red.texture == "my wood.png"
    assert materials["b"].opacity == 0.4


def test_java_properties_are_parsed():
    data = "# c\n! c\nname#2=Caf\\u00e9 \\\n   table\nid = x\\:y\nname#10 : z\nempty#2=\nwidth#2\t60\n".encode(
        "latin-1"
    )
    general, entries = numbered_entries(parse_properties(data))
    assert general == {"id": "x:y"}
    assert list(entries) == [2, 10]
    assert entries[2] == {"name": "Café table", "empty": "", "width": "60"}
    assert entries[10] == {"name": "z"}


def test_uncovered_pixels_get_the_mean_colour():
    image = np.zeros((8, 8, 4), np.uint8)
    image[:, :4] = (40, 160, 20, 255)
    image[:, 4:] = (255, 255, 255, 0)
    texture, coverage = decode_image(png(image), "leaf")
    assert coverage is not None
    assert coverage[0].tolist() == [1, 1, 1, 1, 0, 0, 0, 0]
    assert (texture.image == (40, 160, 20)).all()


def test_images_are_scaled_down_and_keep_their_aspect():
    texture, coverage = decode_image(png(np.full((100, 400, 3), 90, np.uint8)), "wide", side=64)
    assert texture.image.shape == (16, 64, 3)
    assert coverage is None


def test_sixteen_bit_and_grey_images_are_read():
    data = cv2.imencode(".png", np.full((4, 4), 0x8000, np.uint16))[1].tobytes()
    assert (decode_image(data, "grey")[0].image == 128).all()


@pytest.mark.parametrize("damage", ["text", "cut", "body", "huge"])
def test_bad_images_are_refused_by_name(damage):
    data = bytearray(png(np.random.default_rng(1).integers(0, 255, (32, 32, 3)).astype(np.uint8)))
    if damage == "text":
        data = bytearray(b"no picture")
    elif damage == "cut":
        data = data[:60]
    elif damage == "body":
        data[40:-16] = bytes(len(data) - 56)
    else:
        data[16:24] = (60_000).to_bytes(4, "big") * 2
    with pytest.raises(FurnitureError, match=r"wood\.png"):
        decode_image(bytes(data), "wood.png")
