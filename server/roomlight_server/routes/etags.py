"""ETags: a client that has an answer already gets 304 instead."""

import hashlib
from typing import Any, Final

from fastapi import Request, Response
from pydantic import BaseModel

UNCHANGED: Final[dict[int | str, dict[str, Any]]] = {304: {"description": "Unchanged: `If-None-Match` names its ETag"}}


def etag_of(data: bytes) -> str:
    """Return an ETag of bytes."""
    return f'"{hashlib.sha256(data).hexdigest()[:24]}"'


def matches(header: str, etag: str) -> bool:
    """Return whether `If-Match` or `If-None-Match` names an ETag, also the weak one of a compressing proxy."""
    known = [tag.strip().removeprefix("W/") for tag in header.split(",")]
    return etag in known or "*" in known


def unchanged(request: Request, headers: dict[str, str]) -> Response | None:
    """Return the answer 304 if the client has what the ETag in `headers` names; private unless they say otherwise."""
    headers.setdefault("Cache-Control", "private, no-cache")
    has_it = matches(request.headers.get("if-none-match", ""), headers["ETag"])
    return Response(status_code=304, headers=headers) if has_it else None


def data_answer(request: Request, data: bytes, media_type: str) -> Response:
    """Return bytes with an ETag of them, or 304."""
    headers = {"ETag": etag_of(data)}
    return unchanged(request, headers) or Response(data, media_type=media_type, headers=headers)


def json_answer(request: Request, model: BaseModel) -> Response:
    """Return JSON with an ETag of its content, or 304."""
    return data_answer(request, model.model_dump_json().encode(), "application/json")
