"""OBJ with MTL, and PLY, as programs write them: names, paths, numbers and colours that other readers take."""

import time
from pathlib import Path

import numpy as np
import pytest
from gltf_files import png

from roomlight.compositing.loading import load_object
from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.polygons import corner_normals, ear_clipped
from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.errors import ObjectError

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
