"""The TypeScript types are generated from the server's OpenAPI document, and the constants equal Python's."""

import re
import sys

import pytest
from js_package import PACKAGE, run

from present import present
from roomlight.wire import frame_header, frame_message, light_message
from roomlight_client.calls import FRAME_MEDIA_TYPE

CONSTANTS = {
    "FRAME_MAGIC": frame_message.MAGIC.decode(),
    "LIGHT_MAGIC": light_message.MAGIC.decode(),
    "FRAME_MEDIA_TYPE": FRAME_MEDIA_TYPE,
    "LIGHT_MEDIA_TYPE": light_message.MEDIA_TYPE,
    "VERSION": str(frame_header.VERSION),
    "MAX_HEADER_BYTES": str(frame_message.MAX_HEADER_BYTES),
}


@pytest.mark.js
def test_the_types_are_generated_from_the_openapi_document():
    document = run([sys.executable, PACKAGE / "scripts/openapi.py"])
    generated = run(["node", "scripts/generate_types.mjs"], text=document)
    assert generated == (PACKAGE / "src/schemas.ts").read_text(), "run `npm run generate` in client/js"


def test_the_constants_equal_pythons():
    source = (PACKAGE / "src/wire.ts").read_text()
    found = dict(re.findall(r'^export const (\w+) = "?([^";]+)"?;$', source, re.M))
    assert found == CONSTANTS
    depth_bytes = present(re.search(r"DEPTH_BYTES.* = \{ (.+) \};", source))
    sizes = {name: int(size) for name, size in re.findall(r"(\w+): (\d)", depth_bytes[1])}
    assert sizes == frame_header.DEPTH_BYTES
