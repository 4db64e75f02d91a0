"""The calls of the interface without their I/O: requests, how responses are parsed, and when to retry.

A `Call` is a request and the parser of its response; `Attempt` counts the attempts of one call. `client` and
`async_client` only send, wait and return.
"""

import operator
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from ipaddress import ip_address
from typing import Any, Final, Generic, TypeVar, cast
from urllib.parse import urlsplit

import httpx
import numpy as np
from pydantic import BaseModel, ValidationError

from roomlight.conventions import Position
from roomlight.errors import OptionError, WireError
from roomlight.frame import Frame
from roomlight.wire.compositing import CompositeRequest, ObjectInfo, ObjectList
from roomlight.wire.frame_encoding import CameraFrame, FrameEncoding, pack_camera_frame, pack_frame
from roomlight.wire.frame_header import MAX_INDEX, as_whole_number
from roomlight.wire.frame_message import to_wire_error
from roomlight.wire.light_message import MEDIA_TYPE
from roomlight.wire.messages import (
    FrameResult,
    LightForm,
    LightFormat,
    LightRequest,
    ProbeBody,
    ProbeQuery,
    SessionRequest,
    SessionState,
    is_id,
)
from roomlight_client import _waiting
from roomlight_client.compositing import CompositeFile, parse_composite
from roomlight_client.errors import RETRIED, TIMED_OUT, BadReplyError, RemoteError, UnreachableError, refusal
from roomlight_client.light import Light, LightFile, parse_lights
from roomlight_client.retry import Retry, Timeouts, parse_retry_after

T = TypeVar("T")
_Model = TypeVar("_Model", bound=BaseModel)

PositionOrName = Position | str
"""A point in world metres (y up), or the name of a tracked probe."""

Forms = Sequence[LightFormat | LightForm] | LightFormat | LightForm
"""Forms of light, or a single one."""

_GONE: Final = frozenset({404, 410})
"""Statuses of a deletion that say that it was done before."""

DEFAULT_FORMS: Final[tuple[LightFormat | LightForm, ...]] = (
    "npy",
    LightForm(format="npy", use="reflection"),
    "sh",
    "main_light",
)
"""Forms of `light_at` by default: both panoramas exactly as the engine has them, harmonics, the main light."""

PERMANENT: Final = (httpx.UnsupportedProtocol, httpx.LocalProtocolError, httpx.DecodingError)
"""Failures that another attempt would meet too."""

FRAME_MEDIA_TYPE: Final = "application/vnd.roomlight.frame"

SESSION_HEADER: Final = "X-Session-Id"
"""Repeats the session id of the path in a header, for proxies that route by it."""


@dataclass(frozen=True)
class Call(Generic[T]):
    """A request, and the parser of its response.

    `expected`: statuses that `read` accepts besides 200 to 299. `is_long`: it has the time limit of composites, and
    is not repeated after it: the server would do its work twice, or the file be sent twice.
    """

    method: str
    path: str
    read: Callable[[httpx.Response], T]
    headers: Mapping[str, str] = field(default_factory=dict[str, str])
    content: bytes | None = None
    params: Mapping[str, str] = field(default_factory=dict[str, str])
    expected: frozenset[int] = frozenset()
    is_long: bool = False


@dataclass(frozen=True)
class Result(Generic[T]):
    """The parsed response of a call."""

    value: T


class Attempt(Generic[T]):
    """The attempts of one call."""

    def __init__(self, call: Call[T], retry: Retry, base: str) -> None:
        self._call, self._retry, self._base = call, retry, base
        self._made = 0

    def answered(self, response: httpx.Response) -> Result[T] | float:
        """Return the result, or the seconds until the next attempt.

        Raises:
            RemoteError: If the server refused the call and no attempt is left, or the response is malformed.
        """
        self._made += 1
        status = response.status_code
        if status in self._call.expected or response.is_success:
            return Result(self._call.read(response))
        retry_after_s = parse_retry_after(response.headers.get("retry-after"))
        if status in RETRIED and not (self._call.is_long and status in TIMED_OUT):
            delay_s = self._retry.delay_s(self._made, retry_after_s=retry_after_s, jitter=_waiting.jitter())
            if delay_s is not None:
                return delay_s
        raise refusal(status, response.content, retry_after_s=retry_after_s)

    def failed(self, error: httpx.HTTPError) -> float:
        """Return the seconds until the next attempt, after one without a response.

        Raises:
            UnreachableError: If no attempt is left.
        """
        self._made += 1
        permanent = isinstance(error, PERMANENT) or (isinstance(error, httpx.ReadTimeout) and self._call.is_long)
        delay_s = None if permanent else self._retry.delay_s(self._made, jitter=_waiting.jitter())
        if delay_s is not None:
            return delay_s
        attempts = f"{self._made} attempts" if self._made > 1 else "one attempt"
        reason = str(error) or type(error).__name__
        hint = "is `roomlight serve` running there?"
        if "CERTIFICATE_VERIFY_FAILED" in reason:
            hint = "set SSL_CERT_FILE to the certificate that the server, or its authority, should have"
        raise UnreachableError(
            f"{self._base}: no answer to {self._call.method} {self._call.path} after {attempts} ({reason}); {hint}"
        ) from error


def client_arguments(url: str, *, token: str | None) -> dict[str, Any]:
    """Return the arguments of httpx's client. Raises OptionError if the address or the token is invalid."""
    try:
        parts = urlsplit(url)
        host = parts.hostname if parts.port != 0 else None
    except ValueError:
        parts, host = None, None
    if parts is None or parts.scheme not in ("http", "https") or not host:
        raise OptionError(f"url must be a server's address like http://localhost:8090, got {url!r}")
    if parts.username is not None or parts.password is not None:
        raise OptionError("url must not contain a user or a password; servers take a token instead: token=...")
    headers = {"User-Agent": "roomlight-python"}
    if token is not None:
        if not token or not token.isascii() or not token.isprintable():
            raise OptionError("token must be printable ASCII, exactly as configured on the server")
        headers["Authorization"] = f"Bearer {token}"
    # Proxies set in the environment do not apply to this machine itself; its certificates do.
    mounts = {f"{parts.scheme}://": None} if is_loopback(host) else None
    return {"base_url": url.rstrip("/"), "headers": headers, "mounts": mounts}


def check_open(*, closed: bool) -> None:
    """Raise RemoteError if the client was closed; not UnreachableError, which is waited for."""
    if closed:
        raise RemoteError("the client was closed: make a new one, or close it after its last call")


def request_arguments(call: Call[Any], timeouts: Timeouts) -> dict[str, Any]:
    """Return the arguments of httpx's `request` for a call."""
    read_s = timeouts.composite_s if call.is_long else timeouts.read_s
    return {
        "timeout": httpx.Timeout(read_s, connect=timeouts.connect_s, write=timeouts.write_s),
        "method": call.method,
        "url": call.path,
        "params": dict(call.params) or None,
        "headers": dict(call.headers),
        "content": call.content,
    }


def ready() -> Call[bool]:
    """Ask whether the server accepts sessions."""
    return Call("GET", "/readyz", lambda reply: reply.status_code == 200, expected=frozenset({503}))


def upload(body: bytes, kind: str | None, session_id: str | None = None) -> Call[ObjectInfo]:
    """Store an object on the server of a session. A repetition changes nothing: its id is the digest of the file.

    Raises:
        OptionError: If the session id is invalid.
    """
    headers = {"Content-Type": "application/octet-stream", "Accept": "application/json"} | _server_of(session_id)
    params = {} if kind is None else {"kind": kind}
    return Call("POST", "/v1/objects", _parser(ObjectInfo), headers, body, params, is_long=True)


def list_objects(session_id: str | None = None) -> Call[ObjectList]:
    """Get the objects of this token on the server of a session. Raises OptionError if the session id is invalid."""
    return Call("GET", "/v1/objects", _parser(ObjectList), _server_of(session_id))


def delete_object(object_id: str, session_id: str | None = None) -> Call[None]:
    """Delete an object on the server of a session. A missing one counts as success.

    Raises:
        OptionError: If an id is invalid; the object's becomes part of an address.
    """
    _check_id(object_id, "object_id")
    return Call("DELETE", f"/v1/objects/{object_id}", _ignore_body, _server_of(session_id), expected=_GONE)


def _server_of(session_id: str | None) -> dict[str, str]:
    """Return the header by which a proxy finds a session's server."""
    if session_id is None:
        return {}
    _check_id(session_id, "session_id")
    return {SESSION_HEADER: session_id}


class SessionCalls:
    """The calls of one session, and the index of its next frame.

    Raises:
        OptionError: If the session id is invalid; it becomes part of an address.
    """

    def __init__(self, session_id: str | None = None) -> None:
        self.session_id = secrets.token_hex(16) if session_id is None else session_id  # unique, and not to be guessed
        _check_id(self.session_id, "session_id")
        self.next_index = 0

    def resume(self, state: SessionState) -> None:
        """Continue the frame index after the frames that the session has."""
        last = state.frames.last_index
        self.next_index = 0 if last is None else last + 1

    def reserve(self, frame: Frame | CameraFrame, index: int | None) -> int:
        """Return the index to send a frame under: the argument, a `Frame`'s own, or the next one.

        The index counts as used even if the call fails: a frame whose response is lost may have arrived.

        Raises:
            WireError: If it is no index.
        """
        if index is None:
            index = frame.index if isinstance(frame, Frame) else self.next_index
        index = _as_index(index)
        self.next_index = max(self.next_index, index + 1)
        return index

    def open(self, request: SessionRequest) -> Call[SessionState]:
        """Create the session. If it exists with the same options, this changes nothing."""
        return self._call("PUT", "", _parser(SessionState), json=request)

    def state(self) -> Call[SessionState]:
        """Get the session's state."""
        return self._call("GET", "", _parser(SessionState))

    def close(self) -> Call[None]:
        """Delete the session. A missing one counts as success: the response to an earlier attempt may be lost."""
        return self._call("DELETE", "", _ignore_body, expected=_GONE)

    def push(self, frame: Frame | CameraFrame, index: int, *, colour: FrameEncoding, wait: bool) -> Call[FrameResult]:
        """Send a frame. Raises WireError if the frame is invalid: no server would accept it."""
        if isinstance(frame, CameraFrame):
            return self.frame(index, pack_camera_frame(frame, index), wait=wait)
        return self.frame(index, pack_frame(frame, index, colour=colour), wait=wait)

    def frame(self, index: int, body: bytes, *, wait: bool = True) -> Call[FrameResult]:
        """Send the message of a frame."""
        headers = {"Content-Type": FRAME_MEDIA_TYPE} | ({} if wait else {"Prefer": "respond-async"})
        return self._call("PUT", f"/frames/{index}", _parser(FrameResult), content=body, headers=headers)

    def lights(self, probes: Sequence[PositionOrName], forms: Forms) -> Call[list[Light]]:
        """Get the light at several probes after one and the same frame.

        Raises:
            WireError: If a position, a name or a form is invalid.
        """
        request = light_request(probes, forms)

        def read(reply: httpx.Response) -> list[Light]:
            lights = parse_lights(reply.content, reply.headers.get("content-type", ""))
            if len(lights) != len(request.probes):
                raise BadReplyError(f"requested light at {len(request.probes)} probes, the answer has {len(lights)}")
            return lights

        return self._call("POST", "/probes", read, json=request, headers={"Accept": MEDIA_TYPE})

    def file(self, probe: PositionOrName, form: LightForm, *, if_none_match: str | None) -> Call[LightFile | None]:
        """Get one form of the light as a file; None if the light's ETag still equals `if_none_match`.

        Raises:
            WireError: If the position or the name is invalid.
        """
        query = _probe_query(probe)
        fields = form.model_dump(exclude_defaults=True, exclude_none=True) | {"format": form.format}
        params = {name: str(value) for name, value in fields.items()}
        params |= {axis: repr(value) for axis, value in zip("xyz", query.position or (), strict=False)}
        headers = {} if if_none_match is None else {"If-None-Match": _quoted(if_none_match)}

        def read(reply: httpx.Response) -> LightFile | None:
            if reply.status_code == 304:
                return None
            etag = reply.headers.get("etag", "").removeprefix("W/").strip('"')
            return LightFile(reply.content, reply.headers.get("content-type", ""), etag)

        path = "/probe" if query.name is None else f"/probes/{query.name}"
        return self._call("GET", path, read, params=params, headers=headers, expected=frozenset({304}))

    def composite(self, request: CompositeRequest) -> Call[CompositeFile]:
        """Get the last processed frame with objects in it."""
        call = self._call("POST", "/composite", parse_composite, json=request, headers={"Accept": "*/*"})
        return replace(call, is_long=True)

    def track(self, name: str, position: Position) -> Call[None]:
        """Track a point under a name.

        Raises:
            OptionError: If the name is invalid.
            WireError: If the position is invalid.
        """
        _check_id(name, "name")
        _probe_query(position)
        return self._call("PUT", f"/probes/{name}", _ignore_body, json=ProbeBody(position=_floats(position)))

    def untrack(self, name: str) -> Call[None]:
        """Stop tracking a point. Raises OptionError if the name is invalid."""
        _check_id(name, "name")
        return self._call("DELETE", f"/probes/{name}", _ignore_body, expected=_GONE)

    def _call(
        self,
        method: str,
        path: str,
        read: Callable[[httpx.Response], T],
        *,
        json: BaseModel | None = None,
        content: bytes | None = None,
        headers: Mapping[str, str] | None = None,
        params: Mapping[str, str] | None = None,
        expected: frozenset[int] = frozenset(),
    ) -> Call[T]:
        all_headers = {SESSION_HEADER: self.session_id, "Accept": "application/json", **(headers or {})}
        if json is not None:
            content, all_headers["Content-Type"] = json.model_dump_json().encode(), "application/json"
        address = f"/v1/sessions/{self.session_id}{path}"
        return Call(method, address, read, all_headers, content, params or {}, expected)


def light_request(probes: Sequence[PositionOrName], forms: Forms) -> LightRequest:
    """Return the request for the light at several probes; a name by itself is one of them.

    Raises:
        WireError: If a position, a name or a form is invalid.
    """
    listed = [probes] if isinstance(probes, str) else probes
    try:
        return LightRequest(probes=[_probe_query(probe) for probe in listed], forms=as_forms(forms))
    except ValidationError as error:
        raise to_wire_error(error, kind="invalid") from error


def as_forms(forms: Forms) -> list[LightForm]:
    """Return the forms as a list. Raises WireError if there is no such format."""
    if isinstance(forms, str | LightForm):
        return [as_form(forms)]
    return [as_form(form) for form in forms]


def as_form(form: LightFormat | LightForm) -> LightForm:
    """Return the form of a format's name, or the form itself. Raises WireError if there is no such format."""
    try:
        return form if isinstance(form, LightForm) else LightForm(format=form)
    except ValidationError as error:
        raise to_wire_error(error, kind="invalid") from error


def session_request(**options: Any) -> SessionRequest:
    """Return the request that opens a session. Raises WireError if an option is invalid; with field, value and rule."""
    plain = {name: value.item() if isinstance(value, np.generic) else value for name, value in options.items()}
    try:
        return SessionRequest.model_validate(plain)
    except ValidationError as error:
        raise to_wire_error(error, kind="invalid") from error


def _parser(model: type[_Model]) -> Callable[[httpx.Response], _Model]:
    def read(reply: httpx.Response) -> _Model:
        try:
            return model.model_validate_json(reply.content)
        except ValidationError as error:
            explained = to_wire_error(error, kind="bad-reply")
            raise BadReplyError(f"the answer is not a valid {model.__name__}: {explained}") from error

    return read


def _as_index(value: object) -> int:
    """Return an index of any integer type, or of a float without a fraction, as the wire format allows it."""
    try:
        index = operator.index(cast("int", as_whole_number(value)))
    except TypeError:
        index = -1
    if not 0 <= index <= MAX_INDEX:
        raise WireError("invalid", field="index", value=repr(value), rule=f"must be a whole number, 0 to {MAX_INDEX}")
    return index


def _ignore_body(_: httpx.Response) -> None:
    return None


def _probe_query(probe: PositionOrName) -> ProbeQuery:
    try:
        return ProbeQuery(name=probe) if isinstance(probe, str) else ProbeQuery(position=_floats(probe))
    except (ValidationError, ValueError, TypeError) as error:
        if isinstance(error, ValidationError):
            raise to_wire_error(error, kind="invalid") from error
        rule = "must be a name, or three numbers in world metres"
        raise WireError("invalid", field="position", value=probe, rule=rule) from error


def _floats(position: Position) -> list[float]:
    return [float(value) for value in position]


def _quoted(etag: str) -> str:
    return f'"{etag.strip(chr(34))}"'


def _check_id(text: str, option: str) -> None:
    if not is_id(text):
        raise OptionError(f"{option} must be 1 to 64 of the characters A-Z a-z 0-9 _ -, got {text[:80]!r}")


def is_loopback(host: str) -> bool:
    """Return whether a host is this machine itself."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
