"""Packed meshes and cache files: round trips, and detection of damage."""

import pickle

import numpy as np
import pytest

from roomlight.errors import FurnitureError, OutputError
from roomlight_generator.rooms.furniture.cache import Cache, CacheWriter, is_cache
from roomlight_generator.rooms.furniture.files.packing import pack_mesh, unpack_mesh
from roomlight_generator.rooms.furniture.files.surfaces import SurfaceTexture
from roomlight_generator.rooms.furniture_model import FurnitureModel, LightSource
from roomlight_generator.rooms.scene import Material, Mesh, Texture
from roomlight_generator.rooms.shapes import box, sphere, with_material


def picture(seed=0, side=16):
    coarse = np.random.default_rng(seed).integers(40, 200, (side // 8, side // 8, 3)).astype(np.uint8)
    return Texture(coarse.repeat(8, 0).repeat(8, 1))


def lamp(texture):
    shade = Material(name="shade cloth", albedo=(0.5, 0.4, 0.3), texture=texture)
    foot = Material(name="foot", albedo=(0.2, 0.2, 0.2), roughness=0.2)
    glass, mirror = Material(name="pane", glass=True), Material(name="mirror", mirror=0.88)
    parts = [(sphere(0.2), shade), (box(0.3, 0.05, 0.3), foot), (box(0.1, 0.3, 0.1), glass), (box(1, 1, 0.1), mirror)]
    return Mesh.joined([with_material(mesh, material) for mesh, material in parts])


def model(identity="l", mesh=None, **more):
    values = {"role": "table_lamp", "split": "train", "width_m": 1.0, "height_m": 1.2, "depth_m": 0.4, **more}
    return FurnitureModel(id=identity, name="Lamp", load=lambda: mesh or lamp(None), **values)


def corners(mesh):
    """Return every triangle's positions, normals and texture coordinates, independent of the vertex order."""
    return mesh.vertices[mesh.faces], mesh.normals[mesh.faces], mesh.uvs[mesh.faces]


def test_packing_preserves_a_mesh_to_its_precision():
    mesh = lamp(picture())
    textures: list[Texture] = []
    data = pack_mesh(mesh, lambda texture: textures.append(texture) or len(textures) - 1)
    back = unpack_mesh(data, dict(enumerate(textures)), "lamp")
    order = np.argsort(mesh.face_materials, kind="stable")
    for original, restored, tolerance in zip(corners(mesh), corners(back), (2e-5, 0.02, 1e-4), strict=True):
        np.testing.assert_allclose(restored, original[order], atol=tolerance)
    np.testing.assert_array_equal(back.face_materials, mesh.face_materials[order])
    assert back.materials == tuple(m for m in back.materials)
    for original, restored in zip(mesh.materials, back.materials, strict=True):
        assert (original.name, original.texture, original.roughness, original.mirror, original.glass) == (
            restored.name,
            restored.texture,
            restored.roughness,
            restored.mirror,
            restored.glass,
        )
        assert restored.albedo == pytest.approx(original.albedo)
    np.testing.assert_allclose(np.linalg.norm(back.normals, axis=1), 1, atol=1e-5)
    assert len(data) < 0.35 * sum(part.nbytes for part in (mesh.vertices, mesh.normals, mesh.uvs, mesh.faces))


def test_a_mesh_too_large_for_its_indices_is_refused():
    huge = sphere(1, rings=300, segments=300)
    with pytest.raises(ValueError, match="does not fit"):
        pack_mesh(huge, lambda _: 0)


@pytest.mark.parametrize("damage", ["cut", "empty", "head", "body"])
def test_a_damaged_packed_mesh_is_reported_by_name(damage):
    data = bytearray(pack_mesh(with_material(sphere(0.2), Material()), lambda _: 0))
    if damage == "cut":
        data = data[:-40]
    elif damage == "empty":
        data = bytearray()
    elif damage == "head":
        data[10] ^= 0xFF
    else:
        data[-200:] = bytes(200)
    with pytest.raises(FurnitureError, match="sofa is damaged"):
        unpack_mesh(bytes(data), {}, "sofa")


def written(path, count=3):
    writer = CacheWriter()
    shared = picture(1)
    for k in range(count):
        mesh = lamp(shared)
        lights = (LightSource(np.array([0.1, 0.5, k], np.float32), 0.06, (1.0, 0.5, 0.25)),)
        stored = model(f"m{k}", mesh, lights=lights, elevation_m=0.5, top_m=0.7 if k else None, attribution="Ann, CC0")
        writer.add(stored, mesh, (f"geometry {k}", "picture"))
    writer.add_surface(SurfaceTexture("oak", "floor", Texture(picture(2).image, (0.4, 0.3)), "Oak: Bob"))
    writer.write(path)
    return path


def test_a_cache_returns_what_was_stored(tmp_path):
    path = written(tmp_path / "deep" / "f.rlf")
    cache = Cache(path)
    stored = cache.models()
    assert [entry.model.id for entry in stored] == ["m0", "m1", "m2"]
    table_lamp = stored[1].model
    assert stored[1].shared == ("geometry 1", "picture")
    assert (table_lamp.name, table_lamp.role, table_lamp.width_m, table_lamp.height_m, table_lamp.depth_m) == (
        "Lamp",
        "table_lamp",
        1.0,
        1.2,
        0.4,
    )
    assert (table_lamp.elevation_m, table_lamp.top_m, table_lamp.attribution) == (0.5, 0.7, "Ann, CC0")
    assert stored[0].model.top_m is None
    np.testing.assert_allclose(table_lamp.lights[0].position, [0.1, 0.5, 1])
    assert table_lamp.lights[0].colour == (1.0, 0.5, 0.25)
    np.testing.assert_allclose(table_lamp.mesh.bounds(), lamp(picture()).bounds(), atol=2e-5)
    (surface,) = cache.surfaces()
    assert (surface.id, surface.kind, surface.texture.size_m, surface.attribution) == (
        "oak",
        "floor",
        (0.4, 0.3),
        "Oak: Bob",
    )
    # JPEG, with colour at half the resolution: the mean error is a few levels.
    assert abs(surface.texture.image.astype(int) - picture(2).image).mean() < 6
    assert not list(path.parent.glob(".*"))


def test_models_of_a_cache_can_be_pickled(tmp_path):
    cache = Cache(written(tmp_path / "f.rlf"))
    cache.surfaces()
    copy = pickle.loads(pickle.dumps(cache.models()[0].model))
    np.testing.assert_array_equal(copy.mesh.vertices, cache.models()[0].model.mesh.vertices)


def test_a_damaged_cache_header_is_detected(tmp_path):
    path = written(tmp_path / "f.rlf", 1)
    whole = path.read_bytes()

    def check(data, said):
        path.write_bytes(data)
        with pytest.raises(FurnitureError, match=said) as caught:
            Cache(path)
        assert str(path) in str(caught.value)

    check(b"", "not a furniture cache")
    check(b"PK\x03\x04 something", "not a furniture cache")
    check(b"RLFURN99" + whole[8:], "version 99")
    check(whole[:20], "truncated")
    check(whole[:60], "damaged")
    check(whole[:-1], "truncated")
    check(whole + b"x", "truncated")
    for place in (9, 20, 60, 100):
        check(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :], "damaged")
    path.unlink()
    with pytest.raises(FurnitureError, match="cannot be read"):
        Cache(path)


def test_a_flipped_byte_in_a_blob_is_detected_on_reading(tmp_path):
    path = written(tmp_path / "f.rlf", 1)
    cache = Cache(path)
    data = bytearray(path.read_bytes())
    for place in range(len(data) - 3000, len(data), 7):
        data[place] ^= 1
    path.write_bytes(data)
    with pytest.raises(FurnitureError, match=r"f\.rlf: blob \d+ of the furniture cache is damaged"):
        _ = [entry.model.load() for entry in cache.models()] + cache.surfaces()
    path.unlink()
    with pytest.raises(FurnitureError, match="cannot be read"):
        cache.models()[0].model.load()


def test_an_unwritable_path_raises_output_error(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="cannot be written"):
        written(tmp_path / "file" / "f.rlf")


def test_a_cache_is_recognised_by_its_first_bytes(tmp_path):
    assert is_cache(written(tmp_path / "f.rlf"))
    (tmp_path / "zip").write_bytes(b"PK")
    assert not is_cache(tmp_path / "zip")
    assert not is_cache(tmp_path)
    assert not is_cache(tmp_path / "gone")
