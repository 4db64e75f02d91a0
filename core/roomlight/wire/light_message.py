"""Light as bytes: the JSON of a `LightResponse`, then the data of its forms, without base64.

offset  bytes  content
0       4      "RLL1"
4       4      length n of the JSON, unsigned, little-endian
8       n      the JSON; each form without `values` has `bytes`, the length of its part
8 + n   ...    the parts, in the order of `results` and of their `forms`
"""

import base64
import struct
from collections.abc import Sequence
from typing import Any, Final, TypeVar

from roomlight.errors import WireError
from roomlight.wire.messages import EncodedLight, LightResponse

MAGIC: Final = b"RLL1"
MEDIA_TYPE: Final = "application/vnd.roomlight.light"
_PREFIX: Final = struct.Struct("<4sI")
_Response = TypeVar("_Response", bound=LightResponse)


def pack_light(response: LightResponse, parts: Sequence[bytes]) -> bytes:
    """Build the bytes of a message. `parts` are the data of the forms that state `bytes`, in order."""
    return b"".join([light_head(response), *parts])


def light_head(response: LightResponse) -> bytes:
    """Build the beginning of a message, up to its parts."""
    text = response.model_dump_json(exclude_none=True).encode()
    return _PREFIX.pack(MAGIC, len(text)) + text


def parse_light(body: bytes, model: type[_Response]) -> tuple[_Response, list[list[bytes | None]]]:
    """Parse a message into the response and, for each result, the data of each form (None for forms with values).

    `model` is LightResponse for HTTP, LightAnswer or LightingUpdate for messages of a WebSocket.

    Raises:
        WireError: The message is malformed.
    """
    if len(body) < _PREFIX.size or body[:4] != MAGIC:
        raise WireError("bad-light", field="magic", value=body[:4].hex(), rule=f"must be {MAGIC.hex()} (RLL1)")
    length = _PREFIX.unpack_from(body)[1]
    at = _PREFIX.size + length
    try:
        if at > len(body):
            raise ValueError("the JSON is truncated")
        response = model.model_validate_json(body[_PREFIX.size : at])
        parts: list[list[bytes | None]] = []
        for result in response.results:
            parts.append([])
            for form in result.forms:
                stop = at + (form.bytes or 0)
                parts[-1].append(None if form.bytes is None else body[at:stop])
                at = stop
        if at != len(body):
            raise ValueError(f"the parts must end at byte {at}, but the message has {len(body)} bytes")
    except ValueError as error:
        raise WireError("bad-light", field="", value=f"{len(body)} bytes", rule=str(error)) from error
    return response, parts


def with_data(form: EncodedLight, data: bytes) -> EncodedLight:
    """Return the form as plain JSON carries it: with its data in base64 instead of its length."""
    replaced: dict[str, Any] = {"bytes": None, "data": base64.b64encode(data).decode()}
    return form.model_copy(update=replaced)
