"""Frame messages: the shared example bytes, round trips, rejected messages. Run as a script, it writes the vector."""

import json
import math
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import DTypeLike
from pydantic import ValidationError

from roomlight.errors import WireError
from roomlight.wire.frame_header import FrameHeader
from roomlight.wire.frame_message import FrameLimits, FrameMessage, column_major, pack, parse, stated_index

VECTOR = Path(__file__).parent / "wire_vector.json"
BYTES = VECTOR.with_suffix(".bin")
POSE = np.array([[0.6, 0.0, 0.8, 1.5], [0.0, 1.0, 0.0, -0.25], [-0.8, 0.0, 0.6, 2.0], [0.0, 0.0, 0.0, 1.0]])


def header_dict(width=4, height=3, **changes):
    whole = {
        "version": 1,
        "colour": {"encoding": "rgb8", "bytes": 3 * width * height},
        "depth": {
            "format": "uint16_mm", "encoding": "raw", "width": width, "height": height, "bytes": 2 * width * height,
        },
        "intrinsics": {"fx": 3.5, "fy": 3.5, "cx": 2.0, "cy": 1.5, "width": width, "height": height},
        "camera_to_world": column_major(POSE),
        "timestamp_s": 12.125,
        "exposure": 1.0,
        "tracking_state": "normal",
    }  # fmt: skip
    return whole | changes


def parts_of(header):
    """Return parts of the lengths that the header states, filled with a pattern."""
    sizes = [header[name]["bytes"] for name in ("colour", "depth", "confidence") if name in header]
    return [bytes((7 * at + number) % 251 for at in range(size)) for number, size in enumerate(sizes)]


def build(header, *parts):
    """Build a message without checks."""
    text = json.dumps(header).encode()
    return b"RLF1" + struct.pack("<I", len(text)) + text + b"".join(parts)


def message(**changes):
    header = header_dict(**changes)
    return build(header, *parts_of(header))


def edited(path, value):
    """Return a valid message except for one value of its header."""
    header = header_dict()
    *way, last = path.split(".")
    place = header
    for name in way:
        place = place[name]
    place[last] = value
    return build(header, *parts_of(header_dict()))


def error_of(body, limits=None):
    with pytest.raises(WireError) as caught:
        parse(body, limits)
    return caught.value


def vectors():
    """Yield the messages that every client must pack identically: all fields, few fields, no depth."""
    full = header_dict(
        index=7,
        exposure=0.5,
        tracking_state="limited",
        confidence={"format": "uint8", "encoding": "raw", "width": 4, "height": 3, "bytes": 12},
    )
    full["depth"]["estimated"] = True
    few = header_dict()
    del few["timestamp_s"]
    few["depth"] |= {"format": "float16_m", "encoding": "zstd"}
    packed = zstandard.ZstdCompressor().compress(np.full((3, 4), 1.5, "<f2").tobytes())
    few["depth"]["bytes"] = len(packed)
    yield "every field", full, parts_of(full)
    yield "few fields", few, [parts_of(few)[0], packed]
    bare = header_dict()
    del bare["depth"]
    yield "no depth", bare, [parts_of(bare)[0]]


def write_vector():
    listed, whole = [], b""
    for name, header, parts in vectors():
        body = pack(FrameHeader.model_validate_json(json.dumps(header)), *parts)
        hexed = dict(zip(("colour", "depth", "confidence"), (part.hex() for part in parts), strict=False))
        listed.append({"name": name, "header": header, "parts": hexed, "offset": len(whole), "length": len(body)})
        whole += body
    VECTOR.write_text(json.dumps({"file": BYTES.name, "vectors": listed}, indent=1) + "\n")
    BYTES.write_bytes(whole)


@pytest.mark.parametrize("which", [0, 1])
def test_the_shared_vector_is_packed_and_parsed_exactly(which):
    vector = json.loads(VECTOR.read_text())["vectors"][which]
    body = BYTES.read_bytes()[vector["offset"] : vector["offset"] + vector["length"]]
    header = FrameHeader.model_validate_json(json.dumps(vector["header"]))
    parts = [bytes.fromhex(part) for part in vector["parts"].values()]
    assert pack(header, *parts) == body
    parsed = parse(body)
    assert parsed.header == header
    found = [parsed.colour, parsed.depth, *([] if parsed.confidence is None else [parsed.confidence])]
    assert [bytes(part) for part in found] == parts


def test_a_pose_is_written_column_by_column():
    assert column_major(POSE)[12:15] == [1.5, -0.25, 2.0]
    np.testing.assert_allclose(parse(message()).camera_to_world, POSE, atol=1e-15)


def test_a_rigid_pose_is_transmitted_bit_exactly():
    turned = parse(message()).camera_to_world
    again = parse(message(camera_to_world=column_major(turned))).camera_to_world
    assert turned.tobytes() == again.tobytes()


def test_optional_fields_have_defaults():
    header = header_dict()
    for name in ("timestamp_s", "exposure", "tracking_state"):
        del header[name]
    parsed = parse(build(header, *parts_of(header)))
    assert (parsed.header.timestamp_s, parsed.header.exposure, parsed.header.tracking_state) == (None, 1.0, "normal")
    assert parsed.header.index is None
    assert parsed.confidence is None


@settings(max_examples=50, deadline=None)
@given(st.floats(-100, 100), st.floats(1e-3, 1e3), st.integers(0, 2**53 - 1), st.integers(2, 40), st.integers(2, 40))
def test_every_number_is_transmitted_exactly(position, exposure, index, width, height):
    pose = POSE.copy()
    pose[0, 3] = position
    whole = header_dict(width, height, exposure=exposure, index=index, camera_to_world=column_major(pose))
    whole["intrinsics"] |= {"fx": float(width), "fy": float(height), "cx": width / 3, "cy": height / 3}
    header = FrameHeader.model_validate_json(json.dumps(whole))
    parsed = parse(pack(header, *parts_of(whole)))
    assert parsed.header == header
    assert parsed.camera_to_world[0, 3] == position


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        ("version", 2, "version"),
        ("index", -1, "index"),
        ("index", True, "index"),
        ("colour.encoding", "gif", "colour.encoding"),
        ("colour.bytes", 0, "colour.bytes"),
        ("colour.bytes", 35, ""),
        ("colour.bytes", 10**12, "colour.bytes"),
        ("depth.format", "uint8", "depth.format"),
        ("depth.encoding", "gzip", "depth.encoding"),
        ("depth.width", 0, "depth.width"),
        ("depth.width", 10**9, "depth.width"),
        ("depth.width", 4.5, "depth.width"),
        ("depth.width", "4", "depth.width"),
        ("depth.width", 2, "depth"),
        ("depth.height", 1, "depth"),
        ("intrinsics.fx", 0.0, "intrinsics"),
        ("intrinsics.fy", -3.0, "intrinsics"),
        ("intrinsics.fx", math.nan, "intrinsics.fx"),
        ("intrinsics.cx", math.inf, "intrinsics.cx"),
        ("intrinsics.cy", 1e9, "intrinsics"),
        ("camera_to_world", [0.0] * 16, "camera_to_world"),
        ("camera_to_world", [1.0] * 15, "camera_to_world"),
        ("camera_to_world", column_major(np.diag([2.0, 2, 2, 1])), "camera_to_world"),
        ("camera_to_world", column_major(np.diag([-1.0, 1, 1, 1])), "camera_to_world"),
        ("camera_to_world", POSE.reshape(-1).tolist(), "camera_to_world"),
        ("camera_to_world", [math.nan, *column_major(POSE)[1:]], "camera_to_world.0"),
        ("camera_to_world", [1e308, *column_major(POSE)[1:]], "camera_to_world"),
        ("camera_to_world", [*column_major(POSE)[:12], 1e6, 0, 0, 1], "camera_to_world"),
        ("timestamp_s", math.nan, "timestamp_s"),
        ("exposure", 0.0, "exposure"),
        ("exposure", -1.0, "exposure"),
        ("tracking_state", "lost", "tracking_state"),
        ("colour", None, "colour"),
        ("surprise", 1, "surprise"),
    ],
)
def test_an_invalid_field_is_rejected_by_name(path, value, field):
    error = error_of(edited(path, value))
    assert error.field == field
    assert error.rule
    assert error.value
    assert error.kind in ("bad-frame", "too-large")


def test_a_damaged_message_is_rejected():
    body = message()
    for damaged, field in (
        (b"", ""),
        (body[:7], ""),
        (b"RLF2" + body[4:], "magic"),
        (body[:4] + struct.pack("<I", 2**32 - 1) + body[8:], "header length"),
        (body[:4] + struct.pack("<I", 0) + body[8:], "header length"),
        (body[:4] + struct.pack("<I", len(body)) + body[8:], "header length"),
        (body[:-1], ""),
        (body + b"x", ""),
        (body[:8] + b"[" + body[9:], ""),
        (build([], b""), ""),
        (build("x", b""), ""),
        (b"RLF1" + struct.pack("<I", 12_000) + b"[" * 12_000, ""),
        (b"RLF1" + struct.pack("<I", 4) + b"\xff\xfe{}", ""),
    ):
        assert error_of(damaged).field == field


def test_limits_are_checked_before_decoding():
    small = FrameLimits(max_body_bytes=100)
    assert error_of(message(), small).kind == "too-large"
    assert error_of(message(), FrameLimits(max_colour_pixels=11)).field == "intrinsics"
    assert error_of(message(), FrameLimits(max_depth_pixels=11)).field == "depth"
    line = header_dict(4, 1)
    line["intrinsics"]["cy"] = 0.5
    assert error_of(build(line, *parts_of(line))).rule == "at least 2 x 2 pixels"


def test_a_raw_part_must_match_its_size_in_pixels():
    whole = header_dict()
    whole["depth"]["bytes"] = 23
    assert error_of(build(whole, *parts_of(whole))).field == "depth.bytes"
    whole = header_dict(colour={"encoding": "rgb8", "bytes": 37})
    assert error_of(build(whole, *parts_of(whole))).field == "colour.bytes"
    whole = header_dict(confidence={"width": 4, "height": 3, "bytes": 11})
    assert error_of(build(whole, *parts_of(whole))).field == "confidence.bytes"
    whole = header_dict(confidence={"width": 8, "height": 6, "bytes": 48})
    assert error_of(build(whole, *parts_of(whole))).field == "confidence"


def with_colour(encoding, data):
    whole = header_dict(colour={"encoding": encoding, "bytes": len(data)})
    return build(whole, data, parts_of(whole)[1])


def with_depth(format_, encoding, data):
    whole = header_dict()
    whole["depth"] |= {"format": format_, "encoding": encoding, "bytes": len(data)}
    return build(whole, parts_of(whole)[0], data)


def encoded(suffix, width=4, height=3, dtype: DTypeLike = np.uint8, channels: tuple[int, ...] = (3,)):
    return cv2.imencode(suffix, np.zeros((height, width, *channels), dtype))[1].tobytes()


def test_an_image_must_have_the_stated_size_and_encoding():
    for encoding, suffix in (("jpeg", ".jpg"), ("png", ".png")):
        assert isinstance(parse(with_colour(encoding, encoded(suffix))), FrameMessage)
        assert error_of(with_colour(encoding, encoded(suffix, 40, 30))).value == "40 x 30"
        if encoding == "png":  # whether a JPEG is whole shows when it is decoded
            assert error_of(with_colour(encoding, encoded(suffix)[:-20])).field == "colour"
        assert error_of(with_colour(encoding, b"\x76\x2f\x31\x01" + bytes(50))).field == "colour"
    assert error_of(with_colour("jpeg", encoded(".png"))).field == "colour"
    assert error_of(with_colour("heic", encoded(".png"))).field == "colour"
    grey = encoded(".png", dtype=np.uint16, channels=())
    assert isinstance(parse(with_depth("uint16_mm", "png", grey)), FrameMessage)
    assert error_of(with_depth("float32_m", "png", grey)).field == "depth.encoding"
    big = encoded(".png", 4000, 3000, np.uint16, ())
    assert error_of(with_depth("uint16_mm", "png", big)).field == "depth"


def test_a_png_bomb_is_rejected_by_its_header():
    bomb = bytearray(encoded(".png"))
    bomb[16:24] = struct.pack(">II", 60_000, 60_000)
    assert error_of(with_colour("png", bytes(bomb))).value == "60000 x 60000"


def test_zstd_must_state_the_right_size_or_no_size():
    compress = zstandard.ZstdCompressor().compress
    assert isinstance(parse(with_depth("uint16_mm", "zstd", compress(bytes(24)))), FrameMessage)
    assert error_of(with_depth("uint16_mm", "zstd", compress(bytes(10**7)))).field == "depth"
    assert error_of(with_depth("uint16_mm", "zstd", b"not zstd at all")).field == "depth"
    streamed = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(24))
    assert isinstance(parse(with_depth("uint16_mm", "zstd", streamed)), FrameMessage)


def test_pack_checks_the_lengths_of_the_parts():
    header = FrameHeader.model_validate_json(json.dumps(header_dict()))
    with pytest.raises(WireError, match=r"depth\.bytes"):
        pack(header, bytes(36), bytes(5))
    with pytest.raises(WireError, match=r"confidence\.bytes"):
        pack(header, bytes(36), bytes(24), bytes(3))


def test_an_integer_may_be_written_with_a_decimal_point():
    plain = json.dumps(header_dict(index=7), separators=(",", ":"))
    pointed = plain
    for name, value in (("version", 1), ("index", 7), ("width", 4), ("height", 3)):
        pointed = pointed.replace(f'"{name}":{value}', f'"{name}":{value}.0')
    assert pointed.count(".0") >= plain.count(".0") + 6
    assert FrameHeader.model_validate_json(pointed) == FrameHeader.model_validate_json(plain)
    for wrong in ("7.5", "1e999", "true", '"7"'):
        with pytest.raises(ValidationError, match="index"):
            FrameHeader.model_validate_json(plain.replace('"index":7', f'"index":{wrong}'))


@pytest.mark.parametrize(
    ("header", "index"),
    [
        ('{"index":7}', 7),
        ('{"index":7,"colour":"not even an object"}', 7),
        ('{"index":true}', None),
        ('{"index":7.0}', 7),
        ('{"index":7.5}', None),
        ('{"index":1e999}', None),
        ('{"index":-1}', None),
        (f'{{"index":{2**53}}}', None),
        (f'{{"index":{"9" * 5000}}}', None),
        ("[7]", None),
        ("[" * 16_000, None),
        ('{"index":7', None),
        ('{"index":"\udc80"}', None),
    ],
)
def test_the_index_of_an_invalid_message_is_read(header, index):
    text = header.encode(errors="surrogateescape")
    assert stated_index(struct.pack("<4sI", b"RLF1", len(text)) + text) == index
    assert stated_index(struct.pack("<4sI", b"RLF2", len(text)) + text) is None
    assert stated_index(struct.pack("<4sI", b"RLF1", 2**31) + text) is None
    assert stated_index(text[:7]) is None


if __name__ == "__main__":
    write_vector()
