"""Writes `src/wire.ts`: the TypeScript of the wire's messages, from the Python models that the server checks with.

`python -m roomlight_client.wire_types` writes the file; `tests/core/test_wire_types_sync.py` holds it to the
models. Nothing is typed by hand there: names, ranges and texts are those of `roomlight.wire`.
"""

import inspect
import json
from pathlib import Path
from types import ModuleType
from typing import Any, Final, get_args

from pydantic.json_schema import models_json_schema

from roomlight.wire import frame_header, frame_message, light_message, messages
from roomlight.wire.frame_header import WireModel

TARGET: Final = Path(__file__).parents[1] / "js" / "src" / "wire.ts"

_WORDS: Final = ("ColourEncoding", "DepthFormat", "PlaneEncoding", "TrackingState")
_MORE_WORDS: Final = ("ModelName", "LightFormat", "HarmonicsKind", "HarmonicsBasis", "FrameStatus")
_FROM_SERVER: Final = (
    *("EncodedLight", "ProbeLight", "LightResponse", "FrameResult", "FrameCounts", "Memory", "Volume", "SessionState"),
    *("Problem", "FrameEvent", "LightAnswer", "LightingUpdate", "ProbesEvent", "ProblemEvent"),
)
"""Messages that the server writes: it sends every field but those that are null, so defaults are no reason for `?`."""

_HEAD: Final = """\
// Made by python -m roomlight_client.wire_types from the server's own models: do not edit.
// Units: world metres (y up), seconds, milliseconds where a name says so; light is linear RGB, 1.0 = what the session's
// reference exposure shows as white. server/WIRE.md tells the whole format.
"""


def generate() -> str:
    """The text of `src/wire.ts`."""
    words = {get_args(alias): name for name, alias in _aliases()}
    models = _models(frame_header) + _models(messages)
    schema: dict[str, dict[str, Any]] = models_json_schema([(model, "validation") for model in models])[1]["$defs"]
    blocks = [_HEAD, _constants()]
    blocks += [f"export type {name} = {' | '.join(_quoted(choices))};" for choices, name in words.items()]
    blocks.append("/** World metres: x, y (up), z. */\nexport type Position = readonly [number, number, number];")
    blocks += [_interface(name, body, words) for name, body in sorted(schema.items())]
    for name, union in (
        ("ClientMessage", get_args(messages.ClientMessage)[0]),
        ("ServerMessage", messages.ServerMessage),
    ):
        blocks.append(f"export type {name} = {' | '.join(member.__name__ for member in get_args(union))};")
    return "\n\n".join(block.strip() for block in blocks) + "\n"


def _aliases() -> list[tuple[str, Any]]:
    header = [(name, getattr(frame_header, name)) for name in _WORDS]
    return header + [(name, getattr(messages, name)) for name in _MORE_WORDS]


def _models(module: ModuleType) -> list[type[WireModel]]:
    found = [item for _, item in inspect.getmembers(module, inspect.isclass) if item.__module__ == module.__name__]
    return [item for item in found if issubclass(item, WireModel) and item is not WireModel]


def _constants() -> str:
    sizes = ", ".join(f"{name}: {size}" for name, size in frame_header.DEPTH_BYTES.items())
    return "\n".join(
        [
            f'export const FRAME_MAGIC = "{frame_message.MAGIC.decode()}";',
            f'export const LIGHT_MAGIC = "{light_message.MAGIC.decode()}";',
            f'export const LIGHT_MEDIA_TYPE = "{light_message.MEDIA_TYPE}";',
            f"export const VERSION = {frame_header.VERSION};",
            f"export const MAX_HEADER_BYTES = {frame_message.MAX_HEADER_BYTES};",
            f"export const MAX_PROBES = {messages.MAX_PROBES};",
            f"export const MAX_FORMS = {messages.MAX_FORMS};",
            "/** Bytes of one depth value, little-endian. */",
            f"export const DEPTH_BYTES = {{ {sizes} }} as const;",
        ]
    )


def _interface(name: str, body: dict[str, Any], words: dict[tuple[str, ...], str]) -> str:
    required = set(body.get("required", ()))
    lines = [_comment(body["description"], ""), f"export interface {name} {{"]
    for field, kind in body["properties"].items():
        nullable = any(choice.get("type") == "null" for choice in kind.get("anyOf", ()))
        sent = field in required or (name in _FROM_SERVER and not nullable) or field == "type"
        note = "" if name in _FROM_SERVER else _range(kind)
        lines.append(f"  {field}{'' if sent else '?'}: {_type(kind, words)};{f' // {note}' if note else ''}")
    return "\n".join([*lines, "}"])


def _comment(text: str, indent: str) -> str:
    lines = text.splitlines()
    if len(lines) == 1:
        return f"{indent}/** {lines[0]} */"
    return "\n".join([f"{indent}/**", *(f"{indent} * {line}".rstrip() for line in lines), f"{indent} */"])


def _type(kind: dict[str, Any], words: dict[tuple[str, ...], str]) -> str:
    if "$ref" in kind:
        return str(kind["$ref"].rsplit("/", 1)[-1])
    if "const" in kind:
        return _quoted([kind["const"]])[0]
    if "enum" in kind:
        return words.get(tuple(kind["enum"])) or " | ".join(_quoted(kind["enum"]))
    if "anyOf" in kind:
        return " | ".join(_type(choice, words) for choice in kind["anyOf"])
    match kind.get("type"):
        case "array" if kind.get("minItems") == kind.get("maxItems") == 3:
            return "Position"
        case "array":
            item = _type(kind["items"], words)
            return f"readonly ({item})[]" if " | " in item else f"readonly {item}[]"
        case "object":
            values = kind.get("additionalProperties")
            return f"{{ readonly [name: string]: {_type(values, words) if isinstance(values, dict) else 'unknown'} }}"
        case "integer" | "number":
            return "number"
        case "string" | "boolean" | "null" as plain:
            return plain
        case other:
            raise ValueError(f"no TypeScript for a schema of type {other!r}: {kind}")


def _quoted(values: Any) -> list[str]:
    return [f'"{value}"' if isinstance(value, str) else str(value) for value in values]


def _range(kind: dict[str, Any]) -> str:
    """What a type cannot say: bounds, lengths, defaults."""
    choices = [choice for choice in kind.get("anyOf", (kind,)) if choice.get("type") != "null"]
    first: dict[str, Any] = choices[0]
    notes: list[str] = []
    if "minimum" in first and "maximum" in first:
        least, most = (f"{first[end]:,.12g}" for end in ("minimum", "maximum"))
        notes.append(f"{least} to {most}" if first["maximum"] < 2**53 - 1 else f"from {least}")
    if "pattern" in first:
        notes.append(first["pattern"])
    if first.get("type") == "array" and "maxItems" in first and first.get("minItems") != 3:
        least, most = first.get("minItems", 0), first["maxItems"]
        notes.append(f"{most} of them" if least == most else f"{least} to {most} of them")
    if kind.get("default") is not None and "const" not in kind:
        default = kind["default"]
        notes.append(f'default "{default}"' if isinstance(default, str) else f"default {json.dumps(default)}")
    return "; ".join(notes)


if __name__ == "__main__":
    TARGET.write_text(generate())
