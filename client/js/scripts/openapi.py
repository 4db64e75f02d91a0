"""Print the schemas of the server's messages as an OpenAPI document, for `generate_types.mjs`.

The document is the server's own (`/openapi.json`) without its paths, plus what TypeScript needs:

- the unions of the WebSocket's messages, `ClientMessage` and `ServerMessage`;
- a name for positions, `Position`;
- in messages of the server, every field that is not nullable is required: the server sends all fields except nulls,
  so a default makes a field optional only in messages of clients;
- ranges and lengths in the descriptions, because the type `number` cannot express them.
"""

import json
import sys
from collections.abc import Iterator
from typing import Any, Final, get_args

from roomlight.wire import messages
from roomlight_server.app import create_app
from roomlight_server.base.settings import ServerSettings

_REFERENCE: Final = "#/components/schemas/"
_POSITION: Final[dict[str, Any]] = messages.ProbeBody.model_json_schema()["properties"]["position"]
_POSITION.pop("title")


def document() -> dict[str, Any]:
    """Return the OpenAPI document that the TypeScript types are generated from."""
    full = create_app(ServerSettings()).openapi()
    schemas: dict[str, Any] = full["components"]["schemas"]
    client_messages = [kind.__name__ for kind in get_args(get_args(messages.ClientMessage)[0])]
    server_messages = [kind.__name__ for kind in get_args(messages.ServerMessage)]
    request_bodies = [
        operation["requestBody"] for path in full["paths"].values() for operation in path.values()
        if "requestBody" in operation
    ]  # fmt: skip
    sent_by_client = {"FrameHeader", *client_messages, *_references(request_bodies)}
    for name in tuple(sent_by_client):
        sent_by_client |= _reachable(name, schemas)
    for name, schema in schemas.items():
        if name not in sent_by_client:
            fields = schema["properties"].items()
            never_null = {field for field, kind in fields if {"type": "null"} not in kind.get("anyOf", ())}
            schema["required"] = sorted(never_null.union(schema.get("required", ())))
        for kind in schema["properties"].values():
            _describe(kind)
        schema.pop("title", None)
    schemas = _with_positions(schemas)
    schemas["Position"] = _POSITION | {"description": "World metres: x, y (up), z."}
    for name, members in (("ClientMessage", client_messages), ("ServerMessage", server_messages)):
        schemas[name] = {"oneOf": [{"$ref": _REFERENCE + member} for member in members]}
    components = {"schemas": dict(sorted(schemas.items()))}
    return {"openapi": full["openapi"], "info": full["info"], "paths": {}, "components": components}


def _references(part: Any) -> Iterator[str]:
    """Yield the names of the schemas that a part of the document refers to."""
    if isinstance(part, dict):
        if "$ref" in part:
            yield part["$ref"].removeprefix(_REFERENCE)
        for value in part.values():
            yield from _references(value)
    elif isinstance(part, list):
        for value in part:
            yield from _references(value)


def _reachable(name: str, schemas: dict[str, Any]) -> set[str]:
    reachable = {name}
    for reference in _references(schemas[name]):
        reachable |= _reachable(reference, schemas)
    return reachable


def _with_positions(part: Any) -> Any:
    """Replace every position by a reference to the schema `Position`."""
    if part == _POSITION:
        return {"$ref": _REFERENCE + "Position"}
    if isinstance(part, dict):
        return {name: _with_positions(value) for name, value in part.items()}
    return [_with_positions(value) for value in part] if isinstance(part, list) else part


def _describe(kind: dict[str, Any]) -> None:
    """Replace the title, which repeats the field's name, by the field's range."""
    kind.pop("title", None)
    bounded = next((choice for choice in kind.get("anyOf", (kind,)) if choice.get("type") != "null"), kind)
    if "minimum" in bounded and "maximum" in bounded:
        low, high = bounded["minimum"], bounded["maximum"]
        kind["description"] = f"{low:,.12g} to {high:,.12g}" if high < 2**53 - 1 else f"at least {low:,.12g}"
    elif "pattern" in bounded:
        kind["description"] = bounded["pattern"]
    elif bounded.get("type") == "array" and bounded.get("minItems") != bounded.get("maxItems"):
        kind["description"] = f"{bounded.get('minItems', 0)} to {bounded['maxItems']} items"


if __name__ == "__main__":
    json.dump(document(), sys.stdout)
