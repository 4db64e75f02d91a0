"""OBJ with MTL, and PLY, as programs write them: names, paths, numbers and colours that other readers take."""

from pathlib import Path

import numpy as np
import pytest
from gltf_files import png

from roomlight.compositing.loading import load_object
from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.virtual_object import VirtualObject

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACES = ("f 1/1 2/2 3/3\n", "f 1/1 3/3 4/4\n")
RED = np.full((4, 4, 3), (200, 10, 20), np.uint8)


def quad_of(folder: Path, materials: str | bytes, *, names: tuple[str, ...] = ("m",), code: str = "utf-8") -> Path:
    """Write a quad, each of its triangles with a material of this name, and its library."""
    used = [f"usemtl {name}\n{face}" for name, face in zip(names * 2, FACES, strict=False)]
    (folder / "a.mtl").write_bytes(materials if isinstance(materials, bytes) else materials.encode(code))
    (folder / "a.obj").write_bytes(("mtllib a.mtl\n" + QUAD + "".join(used)).encode(code))
    return folder / "a.obj"


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


def test_a_texture_has_a_number_sign_in_its_name(tmp_path: Path) -> None:
    (tmp_path / "red #1.png").write_bytes(png(RED))
    assert material_of(quad_of(tmp_path, "newmtl m\nmap_Kd\tred #1.png\n")).base_colour_texture is not None
