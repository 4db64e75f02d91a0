import itertools
import struct

import numpy as np
import pytest
from light_rooms import room

from roomlight import __version__
from roomlight.light.cube import CubeMap
from roomlight.light.ktx2 import encode_ktx2
from roomlight.light.prefilter import prefilter


def read(data):
    """A reader written from the KTX 2.0 specification: header fields, levels, descriptor, keys."""
    assert data[:12] == bytes([0xAB, 0x4B, 0x54, 0x58, 0x20, 0x32, 0x30, 0xBB, 0x0D, 0x0A, 0x1A, 0x0A])
    names = ["format", "type_size", "width", "height", "depth", "layers", "faces", "levels", "scheme"]
    header = dict(zip(names, struct.unpack_from("<9I", data, 12), strict=True))
    dfd_at, dfd_length, keys_at, keys_length, globals_at, globals_length = struct.unpack_from("<4I2Q", data, 48)
    assert (globals_at, globals_length) == (0, 0)
    index = [struct.unpack_from("<3Q", data, 80 + 24 * level) for level in range(header["levels"])]
    assert dfd_at == 80 + 24 * header["levels"]
    assert keys_at == dfd_at + dfd_length
    keys, at = {}, keys_at
    while at < keys_at + keys_length:
        (length,) = struct.unpack_from("<I", data, at)
        key, value = data[at + 4 : at + 4 + length].split(b"\0", 1)
        keys[key.decode()] = value
        at += 4 + length + -length % 4
    assert at == keys_at + keys_length
    assert list(keys) == sorted(keys)
    levels = []
    for number, (start, length, unpacked) in enumerate(index):
        assert start % 8 == 0
        assert start >= at
        assert length == unpacked
        size = max(1, header["width"] >> number)
        levels.append(np.frombuffer(data[start : start + length], "<f2").reshape(6, size, size, 4))
    assert index[0][0] + index[0][1] == len(data)  # the largest level is the last
    assert all(a[0] >= b[0] + b[1] for a, b in itertools.pairwise(index))
    return header, data[dfd_at : dfd_at + dfd_length], keys, levels


def test_header_and_levels() -> None:
    cube = CubeMap.from_panorama(room(60), size=32)
    header, _, keys, levels = read(cube.to_ktx2())
    assert header == {
        "format": 97,  # VK_FORMAT_R16G16B16A16_SFLOAT
        "type_size": 2,
        "width": 32,
        "height": 32,
        "depth": 0,
        "layers": 0,
        "faces": 6,
        "levels": 1,
        "scheme": 0,
    }
    assert keys == {"KTXorientation": b"rd\0", "KTXwriter": f"RoomLight {__version__}\0".encode()}
    np.testing.assert_array_equal(levels[0], cube.rgba16f())
    assert levels[0].tobytes() == cube.to_bytes()


def test_data_format_descriptor_is_that_of_rgba16f() -> None:
    """Field by field from the Khronos data format specification, basic block, version 2."""
    _, descriptor, _, _ = read(CubeMap.from_panorama(room(16), size=16).to_ktx2())
    total, vendor, version, size = struct.unpack_from("<IIHH", descriptor)
    assert (total, vendor, version, size) == (92, 0, 2, 88)
    assert len(descriptor) == total
    model, primaries, transfer, flags = descriptor[12:16]
    assert (model, primaries, transfer, flags) == (1, 1, 1, 0)  # RGBSDA, BT.709, linear, straight alpha
    assert descriptor[16:28] == bytes([0, 0, 0, 0, 8, 0, 0, 0, 0, 0, 0, 0])
    for place, channel in enumerate((0, 1, 2, 15)):
        offset, bits, kind, position, lower, upper = struct.unpack_from("<HBBI4s4s", descriptor, 28 + 16 * place)
        assert (offset, bits + 1, kind & 15, kind >> 4, position) == (16 * place, 16, channel, 0b1100, 0)
        assert (lower, upper) == (struct.pack("<f", -1), struct.pack("<f", 1))


def test_specular_levels_say_their_roughness() -> None:
    mips = prefilter(CubeMap.from_panorama(room(60), size=32))
    header, _, keys, levels = read(mips.to_ktx2())
    assert header["levels"] == 4
    assert keys["roomlight.roughness"] == b"0 0.333333 0.666667 1\0"
    assert b"".join(level.tobytes() for level in levels) == mips.to_bytes()


def test_keys_are_padded_and_sorted() -> None:
    level = np.ones((6, 1, 1, 4), np.float16)
    for text in ("", "a", "ab", "abc", "größe"):
        _, _, keys, levels = read(encode_ktx2([level], metadata={"zz": text, "Aa": "x"}))
        assert keys["zz"] == text.encode() + b"\0"
        np.testing.assert_array_equal(levels[0], level)


@pytest.mark.parametrize("sizes", [[], [4, 4], [4, 1], [8, 4, 3], [1, 1]])
def test_levels_that_do_not_halve(sizes: list[int]) -> None:
    with pytest.raises(ValueError, match="each half as wide"):
        encode_ktx2([np.zeros((6, size, size, 4), np.float16) for size in sizes])
    with pytest.raises(ValueError, match=r"\(6, 4, 8, 4\)"):
        encode_ktx2([np.zeros((6, 4, 8, 4), np.float16)])
