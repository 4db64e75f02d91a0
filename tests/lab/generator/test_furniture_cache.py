"""Cache files: round trips, and detection of damage."""

import zipfile
from dataclasses import replace

import numpy as np
import pytest

from roomlight.errors import FurnitureError, OutputError
from roomlight_generator.rooms.furniture.cache import Cache, CacheWriter, is_cache
from roomlight_generator.rooms.furniture_model import FurnitureModel, LightSource
from roomlight_generator.rooms.scene import Material, Mesh, Texture
from roomlight_generator.rooms.shapes import block, sphere, with_material


def picture(seed=0, side=16):
    coarse = np.random.default_rng(seed).integers(40, 200, (side // 8, side // 8, 3)).astype(np.uint8)
    return Texture(coarse.repeat(8, 0).repeat(8, 1))


def lamp(texture):
    shade = Material(name="shade cloth", albedo=(0.5, 0.4, 0.3), texture=texture)
    foot = Material(name="foot", albedo=(0.2, 0.2, 0.2), roughness=0.2)
    glass, mirror = Material(name="pane", glass=True), Material(name="mirror", mirror=0.88)
    parts = [
        (sphere(0.2), shade),
        (block(0.3, 0.05, 0.3), foot),
        (block(0.1, 0.3, 0.1), glass),
        (block(1, 1, 0.1), mirror),
    ]
    return Mesh.joined([with_material(mesh, material) for mesh, material in parts])


def model(identity="l", mesh=None, **more):
    values = {"role": "table_lamp", "split": "train", "width_m": 1.0, "height_m": 1.2, "depth_m": 0.4, **more}
    return FurnitureModel(id=identity, name="Lamp", load=lambda: mesh or lamp(None), **values)


def corners(mesh):
    """Return every triangle's positions, normals and texture coordinates, independent of the vertex order."""
    return mesh.vertices[mesh.faces], mesh.normals[mesh.faces], mesh.uvs[mesh.faces]


def test_a_mesh_is_kept_to_its_precision(tmp_path):
    mesh, writer = lamp(picture()), CacheWriter()
    writer.add(model(mesh=mesh), mesh, ())
    writer.write(tmp_path / "f.rlf")
    back = Cache(tmp_path / "f.rlf").mesh(0)
    for original, restored, tolerance in zip(corners(mesh), corners(back), (2e-5, 0.01, 1e-4), strict=True):
        np.testing.assert_allclose(restored, original, atol=tolerance)
    np.testing.assert_array_equal(back.face_materials, mesh.face_materials)
    for original, restored in zip(mesh.materials, back.materials, strict=True):
        assert vars(replace(restored, texture=original.texture)) == vars(original)
    texture, stored = mesh.materials[0].texture, back.materials[0].texture
    assert texture is not None
    assert stored is not None
    # JPEG, with colour at half the resolution: the mean error is a few levels.
    assert abs(stored.image.astype(int) - texture.image).mean() < 6
    np.testing.assert_allclose(np.linalg.norm(back.normals, axis=1), 1, atol=1e-5)


def written(path, count=3):
    writer = CacheWriter()
    shared = picture(1)
    for k in range(count):
        mesh = lamp(shared)
        lights = (LightSource(np.array([0.1, 0.5, k], np.float32), 0.06, (1.0, 0.5, 0.25)),)
        stored = model(f"m{k}", mesh, lights=lights, elevation_m=0.5, top_m=0.7 if k else None, attribution="Ann, CC0")
        writer.add(stored, mesh, (f"geometry {k}", "picture"))
    writer.write(path)
    return path


def test_a_cache_returns_what_was_stored(tmp_path):
    path = written(tmp_path / "deep" / "f.rlf")
    cache = Cache(path)
    stored = cache.models()
    assert [kept.id for kept, _ in stored] == ["m0", "m1", "m2"]
    table_lamp, shared = stored[1]
    assert shared == ("geometry 1", "picture")
    assert (table_lamp.name, table_lamp.role) == ("Lamp", "table_lamp")
    assert (table_lamp.width_m, table_lamp.height_m, table_lamp.depth_m) == (1.0, 1.2, 0.4)
    assert (table_lamp.elevation_m, table_lamp.top_m, table_lamp.attribution) == (0.5, 0.7, "Ann, CC0")
    assert stored[0][0].top_m is None
    np.testing.assert_allclose(table_lamp.lights[0].position, [0.1, 0.5, 1])
    assert table_lamp.lights[0].colour == (1.0, 0.5, 0.25)
    np.testing.assert_allclose(table_lamp.mesh.bounds(), lamp(picture()).bounds(), atol=2e-5)
    assert not list(path.parent.glob(".*"))


def test_a_damaged_cache_is_refused(tmp_path, monkeypatch):
    path = written(tmp_path / "f.rlf", 1)
    whole = path.read_bytes()
    for data in (b"", b"PK\x03\x04 something", whole[:60], whole[:-100], whole[:60] + bytes(40) + whole[100:]):
        path.write_bytes(data)
        with pytest.raises(FurnitureError, match=r"f\.rlf: is not a furniture cache, or is damaged"):
            Cache(path)
    path.unlink()
    with pytest.raises(FurnitureError, match="No such file"):
        Cache(path)
    monkeypatch.setattr("roomlight_generator.rooms.furniture.cache.VERSION", 99)
    written(path, 1)
    monkeypatch.undo()
    with pytest.raises(FurnitureError, match="version 99"):
        Cache(path)


def test_damage_to_a_mesh_is_detected_on_reading(tmp_path):
    path = written(tmp_path / "f.rlf", 1)
    with zipfile.ZipFile(path) as archive:
        start = archive.getinfo("0/vertices.npy").header_offset
    data = bytearray(path.read_bytes())
    for place in range(start + 60, start + 160, 7):
        data[place] ^= 1
    path.write_bytes(data)
    stored, _ = Cache(path).models()[0]
    with pytest.raises(FurnitureError, match=r"f\.rlf: 0/vertices of the furniture cache is damaged"):
        stored.load()


def test_an_unwritable_path_raises_output_error(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="cannot be written"):
        written(tmp_path / "file" / "f.rlf")


def test_a_cache_is_recognised_by_its_index(tmp_path):
    assert is_cache(written(tmp_path / "f.rlf"))
    (tmp_path / "zip").write_bytes(b"PK")
    assert not is_cache(tmp_path / "zip")
    assert not is_cache(tmp_path)
    assert not is_cache(tmp_path / "gone")
