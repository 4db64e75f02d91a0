"""TypeScript's types are made of the server's models, and Swift's source has the same names, choices and order.

`python -m roomlight_client.wire_types` writes the TypeScript anew. No compiler is needed here, and none of Swift
was at hand: its source is read as text.
"""

import json
import re
from pathlib import Path
from types import UnionType
from typing import Literal, Union, get_args, get_origin

import pytest
from pydantic import BaseModel

from roomlight.wire import frame_header, frame_message
from roomlight.wire.frame_header import ConfidencePart, DepthPart, FrameHeader, WireIntrinsics
from roomlight_client import wire_types

ROOT = Path(__file__).parents[2]
TYPES = (ROOT / "client/js/src/wire.ts").read_text()
SWIFT = (ROOT / "client/swift/RoomLightFrame.swift").read_text()
VECTORS = json.loads((ROOT / "tests/core/wire_vector.json").read_text())["vectors"]


def test_the_types_are_those_of_the_models():
    assert wire_types.generate() == TYPES, "run python -m roomlight_client.wire_types"


@pytest.mark.parametrize("model", [FrameHeader, DepthPart, ConfidencePart, WireIntrinsics])
def test_every_field_of_a_header_has_its_type(model):
    body = re.search(rf"export interface {model.__name__} {{\n(.*?)\n}}", TYPES, re.S)[1]
    fields = re.findall(r"^  (\w+)(\??): ", body, re.M)
    assert [name for name, _ in fields] == list(model.model_fields)
    assert {name for name, mark in fields if not mark} == {k for k, v in model.model_fields.items() if v.is_required()}


def swift_object(name):
    """The keys of `let NAME: [String: WireJSON?] = [...]`."""
    body = re.search(rf"let {name}: \[String: WireJSON\?\] = \[\n(.*?)\n +\]", SWIFT, re.S)[1]
    return re.findall(r'"(\w+)":', body)


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
def test_swift_writes_every_field_and_no_other(name, field):
    model = FrameHeader if field is None else model_of(FrameHeader.model_fields[field].annotation)
    assert sorted(swift_object(name)) == sorted(model.model_fields)


def model_of(annotation):
    if get_origin(annotation) in (Union, UnionType):
        return next(item for item in get_args(annotation) if isinstance(item, type) and issubclass(item, BaseModel))
    return annotation


@pytest.mark.parametrize(
    ("enum", "words"),
    [
        ("ColourEncoding", frame_header.ColourEncoding),
        ("DepthFormat", frame_header.DepthFormat),
        ("PlaneEncoding", frame_header.PlaneEncoding),
        ("TrackingState", frame_header.TrackingState),
    ],
)
def test_swift_has_the_choices_of_the_wire(enum, words):
    body = re.search(rf"public enum {enum}: String {{\n(.*?)\n    }}", SWIFT, re.S)[1]
    assert get_origin(words) is Literal
    assert sorted(re.findall(r'case \w+ = "(\w+)"', body)) == sorted(get_args(words))


def test_swift_has_the_constants_and_the_order_of_the_parts():
    assert re.search(r'static let magic = "(\w+)"', SWIFT)[1].encode() == frame_message.MAGIC
    assert int(re.search(r"static let version = (\d+)", SWIFT)[1]) == frame_header.VERSION
    limit = re.search(r"static let maxHeaderBytes = ([\d_]+)", SWIFT)[1]
    assert int(limit.replace("_", "")) == frame_message.MAX_HEADER_BYTES
    assert '"format": .word("uint8")' in SWIFT
    packed = re.search(r"public func packed\(\).*?return message", SWIFT, re.S)[0]
    assert re.search(r"UInt32\(text\.count\)\.littleEndian", packed)
    assert re.findall(r"message = Data\((\S+?)\.utf8\)|message\.append\((.+?)\)", packed) == [
        ("RoomLightFrame.magic", ""), ("", "contentsOf: $0"), ("", "text"), ("", "colour"), ("", "depth.data"),
        ("", "confidence.data"),
    ]  # fmt: skip


def swift_text(value):
    """What `WireJSON.written` writes, by its rules."""
    if isinstance(value, dict):
        return "{" + ",".join(f'"{key}":{swift_text(value[key])}' for key in sorted(value)) + "}"
    if isinstance(value, list):
        return "[" + ",".join(map(swift_text, value)) + "]"
    if isinstance(value, str):
        return f'"{value}"'
    return str(int(value)) if float(value).is_integer() else repr(value)  # Swift's description of a Double is Python's


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_the_rules_that_swift_writes_by_give_the_shared_vector(vector):
    text = swift_text(vector["header"]).encode()
    parts = b"".join(
        bytes.fromhex(vector["parts"][name]) for name in ("colour", "depth", "confidence") if name in vector["parts"]
    )
    body = frame_message.MAGIC + len(text).to_bytes(4, "little") + text + parts
    whole = (ROOT / "tests/core/wire_vector.bin").read_bytes()
    assert whole[vector["offset"] : vector["offset"] + vector["length"]] == body
