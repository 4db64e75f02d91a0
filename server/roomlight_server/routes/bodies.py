"""Request bodies: limits on size and time, and frames sent as multipart form data (curl)."""

import asyncio
import json
import re
import time
from typing import Any, Final

from fastapi import Request
from pydantic import ValidationError
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers, UploadFile
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from roomlight.errors import WireError
from roomlight.wire.frame_header import FrameHeader
from roomlight.wire.frame_message import MAX_HEADER_BYTES, bad_frame, pack, to_wire_error
from roomlight_server.base.byte_budget import Reservation
from roomlight_server.base.metrics import Metrics
from roomlight_server.base.problems import ProblemError
from roomlight_server.base.settings import ServerSettings
from roomlight_server.recordings.files import MAX_PIECE_BYTES, PIECE_PATH

MAX_JSON_BYTES: Final = 65_536
"""Largest JSON body; a request with 64 probes has 6 kB."""
MAX_JSON_NAMES: Final = 2048
"""Most names of a JSON body or message; one of 64 probes or objects has 1,000. Each unknown name is an error with its
own text: 6,000 of them held the event loop for 0.13 s."""
MANY_NAMES: Final = f"the JSON has more than {MAX_JSON_NAMES} names, the limit"
MIN_BYTES_PER_S: Final = 2**14
"""Rate at which a body must arrive; it may lag behind by `body_timeout_s`. An object of 32 MiB may take 35 minutes."""
_MAX_LENGTH_DIGITS: Final = 15
_CHARSETS: Final = ("utf-8", "utf8", "us-ascii", "ascii")
_FILES: Final = ("colour", "depth", "confidence")
_AS_FILE: Final = "must be sent as a file, with a file name (curl: -F NAME=@FILE)"
OBJECTS_PATH: Final = "/v1/objects"
_FRAME_PATH: Final = re.compile(r"/v1/sessions/[^/]+/frames/[^/]+")


class BodyMiddleware:
    """Rejects bodies that exceed their limit (413) or arrive too late (408), and measures the time of requests.

    Rejections are HTTPExceptions, because FastAPI passes no other error on while it reads a body. The server reads and
    discards the rest of the body, so that the client receives the answer.
    """

    def __init__(self, app: ASGIApp, *, settings: ServerSettings, metrics: Metrics) -> None:
        """Wrap an application. Frames, objects and all other bodies (`MAX_JSON_BYTES`) have limits of their own.

        A body may lag behind `MIN_BYTES_PER_S` by `body_timeout_s`; bytes that come sooner give no more time.
        """
        self._app, self._settings, self._metrics = app, settings, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle an ASGI connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        limit = MAX_JSON_BYTES
        if _FRAME_PATH.fullmatch(scope["path"]):  # multipart adds boundaries and a header part
            limit = self._settings.max_body_bytes + (2 * MAX_HEADER_BYTES if _is_multipart(Headers(scope=scope)) else 0)
        elif PIECE_PATH.fullmatch(scope["path"]):
            limit = MAX_PIECE_BYTES
        elif scope["path"] == OBJECTS_PATH:
            limit = self._settings.max_object_file_bytes
        start_s, status = time.perf_counter(), 0

        async def send_observed(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self._app(scope, self._limited(scope, receive, limit), send_observed)
        finally:
            path = getattr(scope.get("route"), "path", "other")
            labels = self._metrics.requests.labels(scope["method"] if path != "other" else "-", path, str(status))
            labels.observe(time.perf_counter() - start_s)

    def _limited(self, scope: Scope, receive: Receive, limit: int) -> Receive:
        headers = Headers(scope=scope)
        declared, encoding = headers.get("content-length", ""), headers.get("content-encoding", "").strip().lower()
        # Python converts at most 4,300 digits to an integer
        too_long = declared.isdecimal() and (len(declared) > _MAX_LENGTH_DIGITS or int(declared) > limit)
        received, names, done = 0, 0, False
        timeout_s = self._settings.body_timeout_s
        deadline = time.monotonic() + timeout_s

        async def limited() -> Message:
            nonlocal received, names, done, deadline
            if done:  # the application now waits for a disconnect
                return await receive()
            if encoding not in ("", "identity"):
                raise HTTPException(415, f"Content-Encoding {encoding[:80]!r} is not supported; send the body as it is")
            if too_long:
                raise HTTPException(413, f"the body has {declared[:_MAX_LENGTH_DIGITS]} bytes; the limit is {limit}")
            try:
                async with asyncio.timeout(max(0.0, deadline - time.monotonic())):
                    message = await receive()
            except TimeoutError:
                rule = f"may lag behind {MIN_BYTES_PER_S} bytes a second by {timeout_s:g} s"
                raise HTTPException(408, f"the body came too slowly ({received} bytes of it): it {rule}") from None
            n_bytes = len(message.get("body", b""))
            received += n_bytes
            deadline = min(deadline + n_bytes / MIN_BYTES_PER_S, time.monotonic() + timeout_s)
            done = message["type"] != "http.request" or not message.get("more_body", False)
            if limit == MAX_JSON_BYTES:
                names += message.get("body", b"").count(b":")
            if names > MAX_JSON_NAMES:
                raise HTTPException(413, MANY_NAMES)
            if received > limit:
                raise HTTPException(413, f"the body has more than {limit} bytes, the limit")
            return message

        return limited


def _is_multipart(headers: Headers) -> bool:
    return headers.get("content-type", "").lower().startswith("multipart/")


async def read_body(request: Request, reserved: Reservation, copies: int = 1) -> bytes:
    """Return a request's body; the memory of so many copies of it is added to `reserved` as it arrives.

    Raises:
        ProblemError: The body is a form (415), or the memory budget is used up (429, 503).
    """
    if _is_multipart(request.headers):
        rule = "send the bytes alone, not a form (curl: --data-binary @FILE)"
        value = request.headers["content-type"]
        raise ProblemError("unsupported-media-type", rule, field="Content-Type", value=value, rule=rule)
    chunks: list[bytes] = []
    async for chunk in request.stream():
        reserved.add(copies * len(chunk))
        chunks.append(chunk)
    return b"".join(chunks)


async def read_frame(request: Request, reserved: Reservation) -> bytes:
    """Return the frame message in a request's body, assembled from its parts if the body is multipart.

    The memory of the body is added to `reserved` as it arrives.

    Raises:
        ProblemError: The multipart body cannot be parsed or is not UTF-8 (400), or the memory budget is used up (503).
    """
    content_type = request.headers.get("content-type", "")
    if not content_type.lower().startswith("multipart/form-data"):
        return await read_body(request, reserved)
    charset = parse_options_header(content_type)[1].get(b"charset", b"utf-8").decode("latin-1")
    if charset.lower() not in _CHARSETS:  # Starlette decodes with any of Python's codecs, some of which raise
        rule = "must be utf-8"
        raise ProblemError("bad-request", f"charset: {rule}", field="Content-Type", value=charset, rule=rule)
    try:
        async with request.form(max_files=4, max_fields=4, max_part_size=MAX_HEADER_BYTES) as form:
            parts: dict[str, bytes] = {}
            for name, value in form.multi_items():
                reserved.add(2 * (value.size or 0) if isinstance(value, UploadFile) else len(value))
                if name in parts:
                    raise ProblemError("bad-request", f"the part {name[:100]!r} is given twice", field=name[:100])
                if isinstance(value, str) and name in _FILES:  # as text its bytes are damaged
                    raise ProblemError("bad-request", f"the part {name} {_AS_FILE}", field=name, rule=_AS_FILE)
                parts[name] = await value.read() if isinstance(value, UploadFile) else value.encode()
    except (MultiPartException, FormParserError) as error:
        reason = error.message if isinstance(error, MultiPartException) else str(error)
        raise ProblemError("bad-request", f"the multipart body cannot be parsed: {reason}") from error
    except HTTPException as error:  # Starlette's conversion of most of the parser's errors
        if error.status_code != 400:
            raise
        detail = f"the multipart body cannot be parsed: {error.detail}; each of {', '.join(_FILES)} {_AS_FILE}"
        raise ProblemError("bad-request", detail) from error
    try:
        return _from_parts(parts)
    except WireError as error:
        raise ProblemError.from_wire(error) from error


def _from_parts(parts: dict[str, bytes]) -> bytes:
    """Build a frame message from the parts `header`, `colour` and, if the header has them, `depth` and `confidence`.

    Lengths that the header leaves out are filled in.
    """
    if not {"header", "colour"} <= parts.keys() <= {"header", *_FILES}:
        rule = "the parts must be header, colour and optionally depth and confidence"
        raise bad_frame("", ", ".join(sorted(parts)), rule)
    if len(parts["header"]) > MAX_HEADER_BYTES:
        rule = f"at most {MAX_HEADER_BYTES} bytes"
        raise bad_frame("header", f"{len(parts['header'])} bytes", rule)
    try:
        header: Any = json.loads(parts["header"])
    except (ValueError, RecursionError) as error:
        raise bad_frame("header", f"{len(parts['header'])} bytes", f"must be JSON ({error})") from error
    for name in _FILES:
        part = header.get(name) if isinstance(header, dict) else None
        if isinstance(part, dict) and name in parts:
            part.setdefault("bytes", len(parts[name]))
        elif isinstance(part, dict):
            raise bad_frame(name, "no such part", "is in the header, must be a part too")
    try:
        checked = FrameHeader.model_validate_json(json.dumps(header))
    except ValidationError as error:
        raise to_wire_error(error, kind="bad-frame") from error
    return pack(checked, parts["colour"], parts.get("depth"), parts.get("confidence"))
