"""EXT_ and KHR_meshopt_compression: streams that the encoder wrote of the values that are computed here."""

import base64
import random
from typing import Any

import numpy as np
import pytest
from gltf_files import GltfFile

from roomlight.compositing.loading import load_object
from roomlight.compositing.objects.gltf.meshopt import Compressed, decode_view
from roomlight.compositing.objects.gltf.schema import BufferView
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.errors import ObjectError

TRIANGLES = "4f4eEA4QDo4eFA4TDo4eEw4TDv///w8IpwBaHe+IDoUOAHaHVmd4qYZliWiYAWkAAA=="
INDICES = "0QAcHDQEHOEGOByFEDgcnR+yAhy9Mzgcu084HJVrOBwAAAAA"
ATTRIBUTES = (
    "oAYCRlMQJP///8poaFfol/8AAACXqNfXBQAAD/8xjGp0frD/AAAAkJjOqgYGUxAkZf/3/4mHuHh4/wAAAEf4h4cFAAAP/xBkbHas"
    "iP8AAACSmtCuBgMQJGUx////gzf3SMjI/wAAAAiIiDcFAAAP/yhmcHisjP8AAACUyKawAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA"
    "AAAAAAMAAwAAAA=="
)
OCTAHEDRAL_8 = "oAE//wAADBDwHmR+ZAE//wAAvbVk09e64wAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAACcuf38="
OCTAHEDRAL_16 = (
    "oAE//wAAzO7uF04hWgELvwAAEQYIBgEd/wAA0OpkQ2EBP/8AAAsWGRINDA0AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAcgLoAv8H/38="
)
QUATERNION = (
    "oAE//wAAg1GUIz5wuwE0fwAAFQ4KEwE//wAAyd92ENRhOQIGdpX/AAAAABATAT//AADHQK3514o7AT8/AAAVDgoZFhMBAvsAAAME"
    "BQAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAeBqIDqQX9Bw=="
)
EXPONENTIAL = (
    "oAE//wAAu5FUpVy8XgE//wAAlzPqhCEDHwIAOJzfAAAAABAAAT//AABss5NSp7hXAT3/AAAEIlvsYGoCD+unQQAAAAAPAAE//wAA"
    "pWW7Ed5SiAE//wAArYMcGXy+aAE//wAAERIREhESEQAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAPAVNQTw54sE8A=="
)

NEWER = (
    "oR9drygAAOY3UnqX5xPlhFmEBhFKFAmJN7mN2iL6HlZsOG+rnVn7mUENAzm1AAAJopg3ruCeCcU+4BuUz0IfWY/A7ua/mXdWNxoBGzRM"
    "YniNobTG1ysAAGpQRh4aGhgWFBQSEhIQ9oiGhmhmZmYSZGZkZAAAAAABAgB/GgATFxMfExcTDx8TFxMfExcTHw93dwAAPwMHAwBLZ48T"
    "49/Xm3v3P0Oz74frq0cv8wP/NzvbF58j088niwunT1OjH5cOABNj1PWvn48cPhs4Ch8KNxw0DBcyHzETMBMxHv8ANRMtNB0qNhoKD+9q"
    "+m/vavr6Gj4aeh5v72r6b+9q+joa/ho6Hv8ABnoOGgYKPgoA66+HSxkYSoau4OOxiU0bFkiErN7ls4tPHRRGgqrc57+DUR8SRHayAD4+"
    "PoM+PoM+PoM+PoM+PoM+PoM+PoM+Pj6DPj6DPj6DPj6DPj6DPgQgAAQsAAANMfExcTEf3d0AAA8DBwMAAAAAAAAAAAAAAAAAAAAAAAAA"
    "AAFiAEI="
)
COLOURS_8 = "of8ADg4OcQ4ODgAbGxvkGxsZAFVXUyhVVVUAfn1+fX59fgAAAAAAAAAAAAAAAAAAAAAAAAB/AH/AAA=="
COLOURS_16 = (
    "oXffANzc3CXc3NwAEAAHALW3tUi3tbUBFdUAAA4AkpSUkJSSlAADBQUEBQUDARmZAAAABgUGBQYFBgAAAAAAAAAAAAAAAAAA/wcAAP8HAAwBAA=="
)


def decoded(text: str, count: int, stride: int, mode: Any, filtered: Any = "NONE") -> bytes:
    content = memoryview(base64.b64decode(text))
    stated = Compressed(buffer=0, byteLength=len(content), byteStride=stride, count=count, mode=mode, filter=filtered)
    return bytes(decode_view(stated, BufferView(buffer=0, byteLength=count * stride), content, "a view"))


def grid() -> np.ndarray:
    """Triangles of a grid of 4 x 4 vertices, and three that share nothing with those before them."""
    faces = [[a, a + 1, a + 4, a + 1, a + 5, a + 4] for a in (0, 1, 2, 4, 5, 6, 8, 9, 10)]
    return np.array([*np.ravel(faces), 15, 3, 9, 0, 12, 7, 900, 2, 1]).reshape(-1, 3)


@pytest.mark.parametrize("stride", [2, 4])
def test_triangles_keep_their_corners_in_order(stride: int) -> None:
    faces = np.frombuffer(decoded(TRIANGLES, 63, stride, "TRIANGLES"), f"<u{stride}").reshape(-1, 3)
    first = [np.roll(face, -face.argmin()).tolist() for face in faces]
    assert first == [np.roll(face, -face.argmin()).tolist() for face in grid()]


def test_indices_are_exact() -> None:
    expected = [k * 7 % 91 if k % 3 else k**3 % 5000 for k in range(24)]
    assert np.frombuffer(decoded(INDICES, 24, 4, "INDICES"), "<u4").tolist() == expected


def test_attributes_are_exact() -> None:
    expected = [0 if k % 4 == 3 else (k * k * 37 + k) % (7 if k < 40 else 60000) for k in range(80)]
    assert np.frombuffer(decoded(ATTRIBUTES, 20, 8, "ATTRIBUTES"), "<u2").tolist() == expected


def newer() -> bytes:
    """Floats, numbers of 16 and 32 bits, and zeros that end: every mode of version 1 for 4 bytes and their bits."""
    k = np.arange(40)
    columns = [
        np.sqrt(k).astype("<f4").view("<u4"),
        k * k * 300 % 65536 | k * 1000 % 65536 << 16,
        k * k * 7919 % 251 + 256 * (k * 31 % 97),
        np.where(k > 20, 0x3F800000 + (k << 20), 0),
    ]
    return np.stack(columns, axis=1).astype("<u4").tobytes()


def test_attributes_of_the_newer_version_are_exact() -> None:
    assert decoded(NEWER, 40, 16, "ATTRIBUTES") == newer()


@pytest.mark.parametrize(("text", "dtype", "bits"), [(COLOURS_8, "<u1", 8), (COLOURS_16, "<u2", 12)])
def test_colours(text: str, dtype: str, bits: int) -> None:
    size = np.dtype(dtype).itemsize
    values = np.frombuffer(decoded(text, 8, 4 * size, "ATTRIBUTES", "COLOR"), dtype).reshape(8, 4)
    k = np.arange(8)
    expected = np.stack([k / 7, 1 - k / 7, k % 4 / 4, np.where(k % 2, 1, 0.5)], axis=1)
    np.testing.assert_allclose(values / np.iinfo(values.dtype).max, expected, atol=4 / 2**bits)


def unit(*components: np.ndarray) -> np.ndarray:
    vectors = np.stack(components, axis=1)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize(("text", "dtype", "error"), [(OCTAHEDRAL_8, "<i1", 0.013), (OCTAHEDRAL_16, "<i2", 0.001)])
def test_octahedral_normals(text: str, dtype: str, error: float) -> None:
    size = np.dtype(dtype).itemsize
    values = np.frombuffer(decoded(text, 8, 4 * size, "ATTRIBUTES", "OCTAHEDRAL"), dtype).reshape(8, 4)
    k = np.arange(8.0)
    expected = unit(np.sin(k + 1), np.cos(3 * k), np.sin(5 * k + 2))
    np.testing.assert_allclose(values[:, :3] / np.iinfo(values.dtype).max, expected, atol=error)
    assert (values[:, 3] == np.iinfo(values.dtype).max).all()


def test_quaternions_and_exponents() -> None:
    turned = np.frombuffer(decoded(QUATERNION, 8, 8, "ATTRIBUTES", "QUATERNION"), "<i2").reshape(8, 4) / 32767
    k = np.arange(8.0)
    expected = unit(np.sin(k + 1), np.cos(3 * k), np.sin(5 * k + 2), np.cos(2 * k + 1))
    np.testing.assert_allclose(np.abs((turned * expected).sum(axis=1)), 1, atol=1e-4)  # q and -q are one rotation
    floats = np.frombuffer(decoded(EXPONENTIAL, 8, 12, "ATTRIBUTES", "EXPONENTIAL"), "<f4")
    np.testing.assert_allclose(floats, 5 * np.sin(np.arange(24)), atol=1e-4)


def compressed_grid(name: str = "EXT_meshopt_compression") -> GltfFile:
    """A GLB as gltfpack packs it: the indices compressed, their plain buffer left out."""
    file = GltfFile()
    points = np.stack([np.arange(901) % 4, np.arange(901) // 4, np.zeros(901)], axis=1)
    file.node(mesh=file.mesh(points, grid()))
    at = file.tree["accessors"][1]["bufferView"]
    content = base64.b64decode(TRIANGLES)
    packed = file.tree["bufferViews"][file.view(content)]
    stated = {"buffer": 0, "byteOffset": packed["byteOffset"], "byteLength": len(content)}
    stated |= {"byteStride": 2, "count": 63, "mode": "TRIANGLES"}
    extensions = {name: stated}
    file.tree["bufferViews"][at] = {"buffer": 1, "byteLength": 126, "extensions": extensions}
    file.tree["extensionsRequired"] = [name]
    file.tree["buffers"] = [
        {"byteLength": len(file.content)},
        {"byteLength": 126} | ({"extensions": {name: {"fallback": True}}} if name.startswith("EXT") else {}),
    ]
    return file


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
def test_a_compressed_glb_is_read(name: str) -> None:
    found = load_object(compressed_grid(name).glb())
    assert found.triangles == 21
    assert "its size of 225 m" in found.notes[0].left_out
    assert found.scaled_to(1.0).notes == ()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"count": 60}, "60 values of 2 bytes are not the 126 of the view"),
        ({"mode": "INDICES"}, r"compressed indices have the header \[225\]"),
        ({"byteLength": 30}, "damaged or end early"),
        ({"byteOffset": 100_000}, "ends at byte"),
        ({"buffer": 7}, "names buffer 7 of 2"),
        ({"mode": "POINTS"}, "EXT_meshopt_compression mode is 'POINTS'"),
        ({"byteStride": 3, "count": 42}, "42 compressed indices of 3 bytes"),
    ],
)
def test_damaged_compression_is_refused(change: dict[str, Any], message: str) -> None:
    file = compressed_grid()
    at = file.tree["accessors"][1]["bufferView"]
    file.tree["bufferViews"][at]["extensions"]["EXT_meshopt_compression"].update(change)
    with pytest.raises(ObjectError, match=message):
        load_object(file.glb())


def test_decompressed_bytes_count_toward_the_limit() -> None:
    with pytest.raises(ObjectError, match="decompressed: file bytes are limited to"):
        load_object(bomb := _bomb(), limits=ObjectLimits(file_bytes=len(bomb)))


def _bomb() -> bytes:
    """Zeros compress to a byte for 64."""
    file = GltfFile()
    file.node(mesh=file.mesh(np.zeros((3, 3)), [[0, 1, 2]]))
    count = 4096
    content = b"\xa0" + bytes(count // 256 * 4 * 4) + bytes(32)
    packed = file.tree["bufferViews"][file.view(content)]
    stated = {**packed, "byteStride": 4, "count": count, "mode": "ATTRIBUTES"}
    view = {"buffer": 0, "byteLength": 4 * count, "extensions": {"EXT_meshopt_compression": stated}}
    file.tree["bufferViews"].append(view)
    return file.glb()


@pytest.mark.parametrize(
    ("text", "count", "stride", "mode"),
    [
        *[(TRIANGLES, 63, 2, "TRIANGLES"), (INDICES, 24, 4, "INDICES")],
        *[(ATTRIBUTES, 20, 8, "ATTRIBUTES"), (NEWER, 40, 16, "ATTRIBUTES")],
    ],
)
def test_changed_bytes_are_decoded_or_refused(text: str, count: int, stride: int, mode: str) -> None:
    rng, whole = random.Random(3), base64.b64decode(text)
    for _ in range(400):
        data = bytearray(whole[: rng.randrange(len(whole) + 1)] if rng.random() < 0.5 else whole)
        for _ in range(rng.randrange(4)):
            if data:
                data[rng.randrange(len(data))] = rng.randrange(256)
        try:
            assert len(decoded(base64.b64encode(data).decode(), count, stride, mode)) == count * stride
        except ObjectError:
            continue
