"""Objects and composites of the server: requests, and how their responses are parsed."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
from pydantic import ValidationError

from roomlight.errors import ObjectError, OptionError
from roomlight.files import write_atomic
from roomlight.wire.compositing import CompositeObject, CompositeRequest
from roomlight.wire.frame_message import to_wire_error
from roomlight_client.errors import BadReplyError

POSES_HEADER = "roomlight-poses"
VISIBLE_HEADER = "roomlight-visible"
FRAME_HEADER = "roomlight-frame"


@dataclass(frozen=True)
class CompositeFile:
    """A frame with objects in it, as the server sends it.

    Attributes:
        data: The picture, or the zip of the layers.
        media_type: image/png, image/jpeg, image/x-exr or application/zip.
        frame: Index of the frame.
        poses: Pose of each object by name, 16 numbers column by column. Given as `pose` with the anchor `origin`, the
            object stays where it is.
        visible: Share of each object by name that nothing real hides, 0 to 1.
    """

    data: bytes
    media_type: str
    frame: int
    poses: dict[str, list[float]]
    visible: dict[str, float]

    def save(self, path: str | Path) -> None:
        """Write the file. Raises OutputError."""
        write_atomic(Path(path), self.data)


def composite_request(
    objects: Sequence[CompositeObject | dict[str, Any]], *, quality: str, picture_format: str
) -> CompositeRequest:
    """Return the request for a composite. Raises WireError if a field is invalid; with field, value and rule."""
    listed = [item.model_dump(exclude_none=True) if isinstance(item, CompositeObject) else item for item in objects]
    try:
        text = json.dumps({"objects": listed, "quality": quality, "format": picture_format})
        return CompositeRequest.model_validate_json(text)  # JSON, so that tuples may stand for lists
    except TypeError as error:
        raise OptionError(f"objects must hold plain numbers, text and lists ({error})") from error
    except ValidationError as error:
        raise to_wire_error(error, kind="invalid") from error


def parse_composite(reply: httpx.Response) -> CompositeFile:
    """Return the composite of a response. Raises BadReplyError if the headers are malformed."""
    try:
        frame, poses = int(reply.headers[FRAME_HEADER]), json.loads(reply.headers[POSES_HEADER])
        visible = json.loads(reply.headers.get(VISIBLE_HEADER, "{}"))
    except (KeyError, ValueError) as error:
        raise BadReplyError(f"the headers of the composite cannot be read: {error}") from error
    return CompositeFile(reply.content, reply.headers.get("content-type", ""), frame, poses, visible)


def object_file(source: str | Path | bytes, kind: str | None) -> tuple[bytes, str | None]:
    """Return the bytes of an object's file and its kind, by the path's ending if none is given.

    Raises:
        ObjectError: The file cannot be read.
    """
    if isinstance(source, bytes):
        return source, kind
    path = Path(source)
    ending = path.suffix.lower().lstrip(".")
    try:
        return path.read_bytes(), kind or (ending if ending in ("glb", "gltf", "obj", "ply") else None)
    except OSError as error:
        raise ObjectError(f"{path}: cannot be read ({error.strerror or error})") from error
