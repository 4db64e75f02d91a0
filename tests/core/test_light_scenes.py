"""Light in files of other tools, read back: a lamp lies where it is, and surfaces get as much light."""

import io
import json
import struct
import zipfile
from dataclasses import replace

import cv2
import numpy as np
import OpenEXR
import pytest
from light_rooms import lit, mean_light, room, unit

from roomlight.conventions import panorama_directions, panorama_solid_angles
from roomlight.images import decode_colour
from roomlight.light.glb import to_glb
from roomlight.light.light import Light
from roomlight.light.main_light import without_lights
from roomlight.light.spherical_harmonics import SphericalHarmonics

LAMPS = [(0.6, 0.3, 0.742), (-0.5, 0.7, -0.51), (-0.9, -0.1, 0.3), (0.1, 0.2, -0.95)]
NORMALS = np.array([unit(*normal) for normal in ((1, 0, 0), (0, 1, 0), (0, 0, -1), (-1, 2, 3), (2, -1, -1))])


def lamp_light(direction, rows=64):
    return Light((1.0, 0.5, -2.0), lit(rows, [(direction, 5, (90.0, 60.0, 30.0))], level=0.2))


def two_lamps(direction):
    """A lamp, and a weaker one opposite."""
    opposite = tuple(-part for part in direction)
    light = Light((1.0, 0.5, -2.0), lit(64, [(direction, 5, (90.0, 60.0, 30.0)), (opposite, 4, 45.0)], level=0.2))
    assert len(light.lights) == 2
    return light


def irradiance(panorama, normals=NORMALS):
    """Irradiance RGB of surfaces with these normals, summed over the panorama's pixels."""
    rows = len(panorama)
    facing = np.maximum(panorama_directions(rows) @ normals.T.astype(np.float32), 0)
    return np.einsum("hwn,hwc->nc", facing * panorama_solid_angles(rows)[..., None], panorama)


def peak(image, uv_of, candidates):
    """Direction among candidates in which a tool that looks up `uv_of` sees the most light."""
    rows, columns = image.shape[:2]
    u, v = uv_of(candidates).T
    row = np.clip((v * rows).astype(int), 0, rows - 1)
    return candidates[np.argmax(image[row, (u * columns).astype(int) % columns].sum(axis=-1))]


SPHERE = panorama_directions(90).reshape(-1, 3)


def assert_lamp_at(direction, found):
    """The two directions differ by less than 6 degrees."""
    assert np.degrees(np.arccos(min(float(unit(*direction) @ found), 1.0))) < 6  # its radius, and a pixel


@pytest.mark.parametrize("scale", [1.0, 0.4])
def test_a_room_without_its_lights_and_the_lights_shed_as_much_as_before(scale):
    panorama = room(64)
    lights = Light((0.0, 0.0, 0.0), panorama).lights
    assert len(lights) > 1
    faded = [replace(light, intensity=light.intensity * scale) for light in lights]
    rest, taken = without_lights(panorama, faded)
    np.testing.assert_allclose([light.intensity for light in taken], [light.intensity for light in faded], rtol=1e-4)
    assert rest.min() >= 0
    assert (rest <= panorama * 1.00001).all()
    total = sum(light.intensity for light in taken)
    np.testing.assert_allclose((mean_light(panorama) - mean_light(rest)) * 4 * np.pi, total, rtol=1e-4)
    rays = panorama_directions(64)
    far = np.all([rays @ light.direction.astype(np.float32) < np.cos(np.radians(31)) for light in lights], axis=0)
    assert (rest[far] == panorama[far]).all()


def test_no_more_light_is_taken_than_is_there():
    panorama = lit(64, [(LAMPS[0], 5, 90.0)], level=0.2)
    (lamp,) = Light((0.0, 0.0, 0.0), panorama).lights
    rest, taken = without_lights(panorama, [replace(lamp, intensity=3 * lamp.intensity), lamp])
    (once,) = taken  # nothing is left for the second
    np.testing.assert_allclose(once.intensity, lamp.intensity, rtol=1e-5)
    np.testing.assert_allclose(rest, 0.2, rtol=1e-4)


@pytest.fixture
def usd():
    return pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdLux"), pytest.importorskip("pxr.UsdGeom")


def shown_by_dome(dome, matrix, image):
    """Direction of the most light, by the latitude-longitude map that UsdLux cites from OpenEXR."""
    inverse = np.array(matrix.GetInverse())[:3, :3]  # for row vectors

    def uv(directions):
        x, y, z = (directions @ inverse).T
        return np.stack([0.5 - np.arctan2(x, z) / (2 * np.pi), np.arccos(np.clip(y, -1, 1)) / np.pi], axis=-1)

    assert dome.GetTextureFormatAttr().Get() == "latlong"
    return peak(image, uv, SPHERE)


@pytest.mark.parametrize("direction", LAMPS)
def test_usd_core_reads_the_package(direction, usd, tmp_path):
    Usd, UsdLux, UsdGeom = usd
    light, path = two_lamps(direction), tmp_path / "light.usdz"
    light.save(path)
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    stage.SetEditTarget(stage.GetSessionLayer())
    choice = stage.GetDefaultPrim().GetVariantSet("lights")
    assert (choice.GetVariantSelection(), choice.GetVariantNames()) == ("inDome", ["inDome", "separate"])
    archive = zipfile.ZipFile(path)
    total = {}
    for name in choice.GetVariantNames():
        choice.SetVariantSelection(name)
        dome = UsdLux.DomeLight(stage.GetPrimAtPath("/Light/Room"))
        asset = dome.GetTextureFileAttr().Get()
        assert asset.resolvedPath.endswith(f"light.usdz[{asset.path}]")
        image = decode_colour(archive.read(asset.path), asset.path)[0] * dome.GetIntensityAttr().Get()
        total[name] = irradiance(image)
        matrix = UsdGeom.Xformable(dome).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
        if name == "inDome":
            assert not stage.GetPrimAtPath("/Light/Light0")
            assert_lamp_at(direction, shown_by_dome(dome, matrix, image))
            continue
        for number, expected in enumerate(light.lights):
            source = UsdLux.DistantLight(stage.GetPrimAtPath(f"/Light/Light{number}"))
            turned = np.array(UsdGeom.Xformable(source).ComputeLocalToWorldTransform(Usd.TimeCode.Default()))
            toward = turned[2, :3]  # a distant light shines along its -z
            assert_lamp_at(expected.direction, toward)
            assert source.GetNormalizeAttr().Get() is True
            assert source.GetAngleAttr().Get() == pytest.approx(2 * expected.radius_deg, rel=1e-4)
            sheds = np.array(source.GetColorAttr().Get()) * source.GetIntensityAttr().Get()
            assert sheds == pytest.approx(expected.intensity, rel=1e-5)
            total[name] += np.maximum(NORMALS @ toward, 0)[:, None] * sheds
        assert not stage.GetPrimAtPath(f"/Light/Light{len(light.lights)}")
    np.testing.assert_allclose(total["separate"], total["inDome"], rtol=0.02)  # a lamp of 5 degrees as a point
    np.testing.assert_allclose(total["inDome"], irradiance(light.panorama), rtol=1e-3)  # half floats


def test_even_light_is_a_dome_alone(usd, tmp_path):
    Usd, UsdLux, _ = usd
    Light((0.0, 0.0, 0.0), lit(16, [], level=0.5)).save(tmp_path / "light.usdz")
    stage = Usd.Stage.Open(str(tmp_path / "light.usdz"))
    assert [prim.GetTypeName() for prim in stage.Traverse()] == ["Xform", "DomeLight"]
    assert UsdLux.DomeLight(stage.GetPrimAtPath("/Light/Room")).GetTextureFileAttr().Get().path == "light.exr"


def test_files_of_a_package_are_aligned_and_the_same_for_equal_light():
    light = lamp_light(LAMPS[0])
    data = light.file("usdz")
    archive = zipfile.ZipFile(io.BytesIO(data))
    assert archive.testzip() is None
    assert archive.namelist() == ["light.usda", "light.exr", "ambient.exr"]
    for info in archive.infolist():
        assert info.compress_type == zipfile.ZIP_STORED
        name_bytes, extra_bytes = struct.unpack_from("<HH", data, info.header_offset + 26)
        assert (info.header_offset + 30 + name_bytes + extra_bytes) % 64 == 0
    assert data == light.file("usdz")
    small = zipfile.ZipFile(io.BytesIO(light.file("usdz", size=16))).read("light.exr")
    assert decode_colour(small, "light.exr")[0].shape == (16, 32, 3)


def read_glb(data):
    """Parts of a GLB file by its specification: the JSON and a function that gives the bytes of an image."""
    magic, version, length, text_length, text_kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, text_kind) == (b"glTF", 2, len(data), b"JSON")
    document = json.loads(data[20 : 20 + text_length])
    body_length, body_kind = struct.unpack_from("<I4s", data, 20 + text_length)
    body = data[28 + text_length :]
    assert (len(body), body_kind, text_length % 4, body_length % 4) == (body_length, b"BIN\0", 0, 0)

    def image(number):
        view = document["bufferViews"][document["images"][number]["bufferView"]]
        start = view["byteOffset"]
        return body[start : start + view["byteLength"]]

    return document, image


def decode_rgbd(png):
    stored = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    assert stored is not None
    bgra = stored.astype(np.float64) / 255
    return bgra[..., 2::-1] ** 2.2 / bgra[..., 3:]


def texel_direction(face, row, column, size):
    """Direction of a texel by OpenGL's table, with x mirrored and rows from bottom to top, as Babylon.js shows it."""
    s, t = (2 * column + 1) / size - 1, 1 - (2 * row + 1) / size
    x, y, z = [(1, -t, -s), (-1, -t, s), (s, 1, t), (s, -1, -t), (s, -t, 1), (-s, -t, -1)][face]
    return unit(-x, y, z)


@pytest.mark.parametrize("direction", LAMPS)
def test_gltf_holds_the_room_and_its_lights(direction):
    light = two_lamps(direction)
    document, image = read_glb(light.file("glb", size=16))
    assert document["extensionsUsed"] == ["EXT_lights_image_based", "KHR_lights_punctual"]
    (room_light,) = document["extensions"]["EXT_lights_image_based"]["lights"]
    assert (room_light["specularImageSize"], len(room_light["specularImages"])) == (16, 3)
    rest, _ = without_lights(light.panorama, light.lights)
    levels = [np.stack([decode_rgbd(image(number)) for number in level]) for level in room_light["specularImages"]]
    assert [level.shape for level in levels] == [(6, size, size, 3) for size in (16, 8, 4)]
    np.testing.assert_allclose(levels[0].mean() * room_light["intensity"], rest.mean(), rtol=0.1)
    coefficients = np.array(room_light["irradianceCoefficients"]) * room_light["intensity"]
    harmonics = SphericalHarmonics(coefficients, quantity="irradiance")
    both = harmonics.evaluate(NORMALS * (-1, 1, 1))
    sources = document["extensions"]["KHR_lights_punctual"]["lights"]
    assert document["scenes"][0]["nodes"] == [0, 1]
    for node, expected in zip(document["nodes"], light.lights, strict=True):
        source = sources[node["extensions"]["KHR_lights_punctual"]["light"]]
        sheds = np.array(source["color"]) * source["intensity"]
        assert sheds == pytest.approx(expected.intensity, rel=1e-5)
        x, y, z, w = node["rotation"]
        toward = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])  # +z, turned
        assert_lamp_at(expected.direction, toward)
        both += np.maximum(NORMALS @ toward, 0)[:, None] * sheds
    np.testing.assert_allclose(both, irradiance(light.panorama), rtol=0.03, atol=0.02)


@pytest.mark.parametrize("direction", LAMPS)
def test_specular_images_of_gltf_show_a_lamp_where_it_is(direction):
    """The strongest lamp is a light and not in the images; another one stays, brighter than RGBD reaches."""
    other = tuple(-part for part in direction)
    panorama = lit(64, [(other, 10, 900.0), (direction, 4, 600.0)], level=0.2)
    document, image = read_glb(to_glb(panorama, Light((0.0, 0.0, 0.0), panorama).lights[:1]))
    (room_light,) = document["extensions"]["EXT_lights_image_based"]["lights"]
    faces = np.stack([decode_rgbd(image(number)) for number in room_light["specularImages"][0]])
    brightest = np.unravel_index(np.argmax(faces.sum(axis=-1)), faces.shape[:3])
    face, row, column = (int(at) for at in brightest)
    assert_lamp_at(direction, texel_direction(face, row, column, faces.shape[1]))
    assert faces.max() == pytest.approx(255, rel=0.01)
    assert faces.max() * room_light["intensity"] == pytest.approx(600.2, rel=0.06)  # texels and pixels cross


def test_pygltflib_reads_the_document(tmp_path):
    pygltflib = pytest.importorskip("pygltflib")
    light = two_lamps(LAMPS[0])
    light.save(tmp_path / "light.glb")
    read = pygltflib.GLTF2().load(str(tmp_path / "light.glb"))
    assert (len(read.images), len(read.nodes), len(read.scenes)) == (24, 2, 1)
    document, image = read_glb(light.file("glb"))
    assert read.extensions == document["extensions"]
    view = read.bufferViews[read.images[5].bufferView]
    assert read.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength] == image(5)


def test_even_light_is_an_image_based_light_alone():
    document, _ = read_glb(Light((0.0, 0.0, 0.0), lit(16, [], level=0.5)).file("glb"))
    assert document["extensionsUsed"] == ["EXT_lights_image_based"]
    assert "nodes" not in document


def unreal(d):
    """`LookupLongLat` of Unreal's texture compressor, in its left-handed world, z up."""
    return np.stack([0.5 + np.arctan2(d[:, 0], -d[:, 1]) / (2 * np.pi), np.arccos(d[:, 2]) / np.pi], axis=-1)


def reality_kit(d):
    """Apple's text: a clockwise scan of the horizon that begins behind, at +z."""
    return np.stack([np.arctan2(-d[:, 0], d[:, 2]) / (2 * np.pi) % 1, np.arccos(d[:, 1]) / np.pi], axis=-1)


def unity(d):
    """`ToRadialCoords` of Skybox/Panoramic; its v counts from the bottom."""
    return np.stack([0.5 - np.arctan2(d[:, 2], d[:, 0]) / (2 * np.pi), np.arccos(d[:, 1]) / np.pi], axis=-1)


def blender(d):
    """`direction_to_equirectangular` of Cycles; its v counts from the bottom."""
    u = 0.5 - np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi)
    return np.stack([u, 0.5 - np.arctan2(d[:, 2], np.hypot(d[:, 0], d[:, 1])) / np.pi], axis=-1)


TOOLS = {
    "Blender": (blender, lambda x, y, z: (x, -z, y), 0),
    "Unity": (unity, lambda x, y, z: (x, y, -z), 0),
    "Unreal, glTF": (unreal, lambda x, y, z: (x, z, y), 1),
    "Unreal, ARKit": (unreal, lambda x, y, z: (-z, x, y), 2),
    "RealityKit": (reality_kit, lambda x, y, z: (x, y, z), 1),
}
"""A tool's mapping, our axes in its world, and the quarter turns of the panorama that docs/conventions.md states."""


def by_openexr(path):
    return OpenEXR.File(str(path)).channels()["RGB"].pixels.astype(np.float32)


def by_openimageio(path):
    buffer = pytest.importorskip("OpenImageIO").ImageBuf(str(path))
    assert list(buffer.spec().channelnames) == ["R", "G", "B"]
    return buffer.get_pixels()


@pytest.mark.parametrize("read", [by_openexr, by_openimageio])
@pytest.mark.parametrize("tool", TOOLS)
@pytest.mark.parametrize("direction", LAMPS)
def test_a_panorama_turned_as_the_docs_say_lies_right_in(tool, direction, read, tmp_path):
    uv, axes, quarters = TOOLS[tool]
    panorama = lamp_light(direction).panorama
    turned = np.roll(panorama, quarters * panorama.shape[1] // 4, axis=1)
    Light((0.0, 0.0, 0.0), turned).save(tmp_path / "light.exr")
    panorama = read(tmp_path / "light.exr")
    assert panorama.shape[1] == 2 * panorama.shape[0]  # what RealityKit and others take for all directions
    np.testing.assert_allclose(irradiance(panorama), irradiance(turned), rtol=1e-3)  # half floats
    found = peak(panorama, lambda d: uv(np.stack(axes(*d.T), axis=-1)), SPHERE)
    assert_lamp_at(direction, found)
