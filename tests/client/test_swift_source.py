"""The Swift source has the fields, choices, constants and part order of the wire format.

No Swift compiler is needed: the source is read as text.
"""

import json
import re
from pathlib import Path
from typing import Literal, get_args, get_origin

import numpy as np
import pytest
from pydantic import BaseModel

from roomlight.light.spherical_harmonics import SphericalHarmonics
from roomlight.wire import frame_header, frame_message
from roomlight.wire.frame_header import FrameHeader

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "client/swift"
SOURCES = {path.name: path.read_text() for path in sorted(PACKAGE.rglob("*.swift"))}
SWIFT = SOURCES["RoomLightFrame.swift"] + SOURCES["WireJSON.swift"]
VECTORS = json.loads((ROOT / "tests/core/wire_vector.json").read_text())["vectors"]


def find(pattern: str, text: str = SWIFT, flags: int = 0) -> str:
    match = re.search(pattern, text, flags)
    assert match is not None, f"the source has no {pattern}"
    return match[1] if match.lastindex else match[0]


def swift_keys(name: str) -> list[str]:
    """The keys of `let NAME: [String: WireJSON?] = [...]`."""
    return re.findall(r'"(\w+)":', find(rf"let {name}: \[String: WireJSON\?\] = \[\n(.*?)\n +\]", flags=re.S))


def model_of(field: str) -> type[BaseModel]:
    """The model of a field of the header, which may be optional."""
    annotation = FrameHeader.model_fields[field].annotation
    kinds = get_args(annotation) or (annotation,)
    return next(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel))


@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("whole", None),
        ("colourPart", "colour"),
        ("depthPart", "depth"),
        ("part", "confidence"),
        ("intrinsicsPart", "intrinsics"),
    ],
)
def test_swift_writes_exactly_the_fields_of_the_header(name, field):
    model = FrameHeader if field is None else model_of(field)
    assert sorted(swift_keys(name)) == sorted(model.model_fields)


@pytest.mark.parametrize(
    ("enum", "choices"),
    [
        ("ColourEncoding", frame_header.ColourEncoding),
        ("DepthFormat", frame_header.DepthFormat),
        ("PlaneEncoding", frame_header.PlaneEncoding),
        ("TrackingState", frame_header.TrackingState),
    ],
)
def test_swift_has_the_choices_of_the_wire(enum, choices):
    body = find(rf"public enum {enum}: String {{\n(.*?)\n    }}", flags=re.S)
    assert get_origin(choices) is Literal
    assert sorted(re.findall(r'case \w+ = "(\w+)"', body)) == sorted(get_args(choices))


def test_swift_has_the_constants_and_the_order_of_the_parts():
    assert find(r'static let magic = "(\w+)"').encode() == frame_message.MAGIC
    assert int(find(r"static let version = (\d+)")) == frame_header.VERSION
    limit = find(r"static let maxHeaderBytes = ([\d_]+)")
    assert int(limit.replace("_", "")) == frame_message.MAX_HEADER_BYTES
    assert '"format": .word("uint8")' in SWIFT
    packed = find(r"public func packed\(\).*?return message", flags=re.S)
    assert "UInt32(text.count).littleEndian" in packed
    assert re.findall(r"message = Data\((\S+?)\.utf8\)|message\.append\((.+?)\)", packed) == [
        ("RoomLightFrame.magic", ""), ("", "contentsOf: $0"), ("", "text"), ("", "colour"), ("", "depth.data"),
        ("", "confidence.data"),
    ]  # fmt: skip


def swift_text(value):
    """The text of `WireJSON.written`."""
    if isinstance(value, dict):
        return "{" + ",".join(f'"{key}":{swift_text(value[key])}' for key in sorted(value)) + "}"
    if isinstance(value, list):
        return "[" + ",".join(map(swift_text, value)) + "]"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower()
    return str(int(value)) if float(value).is_integer() else repr(value)  # Swift's description of a Double is Python's


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_swifts_json_rules_give_the_shared_vector(vector):
    text = swift_text(vector["header"]).encode()
    parts = b"".join(
        bytes.fromhex(vector["parts"][name]) for name in ("colour", "depth", "confidence") if name in vector["parts"]
    )
    body = frame_message.MAGIC + len(text).to_bytes(4, "little") + text + parts
    whole = (ROOT / "tests/core/wire_vector.bin").read_bytes()
    assert whole[vector["offset"] : vector["offset"] + vector["length"]] == body


def test_the_wire_part_needs_only_foundation():
    wire = {path.name for path in (PACKAGE / "Sources/RoomLightWire").iterdir()}
    assert wire == {"RoomLightFrame.swift", "WireJSON.swift"}
    for name in wire:
        assert re.findall(r"^\s*import (\w+)", SOURCES[name], re.M) == ["Foundation"]
        assert not re.search(r"simd|CVPixel|ARFrame\(|#if|SIMD\d", re.sub(r"//.*", "", SOURCES[name]))


def test_the_other_parts_use_only_what_is_public():
    public = set(re.findall(r"public (?:struct|enum|var|let|func|static let) (\w+)", SWIFT))
    users = SOURCES["ARFrame.swift"] + SOURCES["WireVectorTests.swift"]
    used = set(re.findall(r"\bRoomLightFrame\.(\w+)", users)) | set(re.findall(r"\bframe\.(\w+) = ", users))
    own = set(re.findall(r"static (?:func|let) (\w+)", SOURCES["ARFrame.swift"]))
    assert {"Plane", "Intrinsics", "ColourEncoding"} <= used
    assert used - own <= public
    assert "public init(field: String, rule: String)" in SWIFT


def test_the_package_has_a_target_for_each_folder():
    manifest = SOURCES["Package.swift"]
    folders = [path.name for parent in ("Sources", "Tests") for path in sorted((PACKAGE / parent).iterdir())]
    assert sorted(re.findall(r'\.(?:target|testTarget)\(name: "(\w+)"', manifest)) == sorted(folders)
    for name, text in SOURCES.items():
        assert text.count("{") == text.count("}"), name
        assert text.count("#if") == text.count("#endif"), name


def test_swift_averages_pixels_when_it_scales_an_image_down():
    assert ".highQualityDownsample: true" in find(r"CIContext\(options: \[.*\]\)", SOURCES["ARFrame.swift"])


def test_swift_decodes_harmonics_with_their_signs():
    body = find(r"struct Harmonics: Decodable \{\n(.*?)\n    \}", SOURCES["RoomLightClient.swift"], re.S)
    sent = SphericalHarmonics(np.zeros((9, 3))).to_json("planar")
    assert {"coefficients", "phase"} <= set(re.findall(r"public let (\w+)", body)) <= {*sent, "coverage"}


def test_swift_names_the_plane_that_it_refuses():
    source = SOURCES["ARFrame.swift"]
    types = dict(re.findall(r'field: "(\w+)", type: kCVPixelFormatType_(\w+)', source))
    assert types == {"depth": "DepthFloat32", "confidence": "OneComponent8"}
    assert "RoomLightRefusal(field: field," in source
