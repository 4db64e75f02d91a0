"""What is asked of a server and how its answers are read: everything about a call but the I/O.

A `Call` is a request and the function that makes its result of the answer; `Attempt` takes one through its retries.
`client` and `async_client` do nothing but send, wait and hand back.
"""

import random
import re
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from ipaddress import ip_address
from typing import Any, Final, Generic, TypeVar
from urllib.parse import urlsplit

import httpx
from pydantic import BaseModel, ValidationError

from roomlight.conventions import Position
from roomlight.errors import RoomLightError, WireError
from roomlight.frame import Frame
from roomlight.wire.frame_message import explain
from roomlight.wire.light_message import MEDIA_TYPE
from roomlight.wire.messages import (
    ID_PATTERN,
    FrameResult,
    LightForm,
    LightFormat,
    LightRequest,
    ProbeBody,
    ProbeQuery,
    SessionRequest,
    SessionState,
)
from roomlight_client.errors import RETRIED, BadReplyError, UnreachableError, refusal
from roomlight_client.frames import CameraFrame, Colour, pack_camera_frame, pack_frame
from roomlight_client.light import Light, LightFile, parse_lights
from roomlight_client.retry import Retry, Timeouts, parse_retry_after

T = TypeVar("T")
_Model = TypeVar("_Model", bound=BaseModel)

Where = Position | str
"""A point in world metres, or the name of a tracked probe."""

FORMS: Final[tuple[LightFormat, ...]] = ("npy", "sh", "main_light")
"""What `light_at` asks for when it is not told: the panorama as the engine has it, harmonics, the main light."""

FRAME_MEDIA_TYPE: Final = "application/vnd.roomlight.frame"

SESSION_HEADER: Final = "X-Session-Id"
"""Says in a header what the path says too: proxies in front of several servers route by it."""


@dataclass(frozen=True)
class Reply:
    """An answer, read to its end. Header names are lower case."""

    status: int
    headers: Mapping[str, str]
    body: bytes


@dataclass(frozen=True)
class Call(Generic[T]):
    """A request, and what its answer means. `expected`: statuses that `read` understands, besides 200 to 299."""

    method: str
    path: str
    read: Callable[[Reply], T]
    headers: Mapping[str, str] = field(default_factory=dict[str, str])
    content: bytes | None = None
    params: Mapping[str, str] = field(default_factory=dict[str, str])
    expected: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Result(Generic[T]):
    """What a call came to."""

    value: T


class Attempt(Generic[T]):
    """One call through its attempts."""

    def __init__(self, call: Call[T], retry: Retry, base: str) -> None:
        """None made yet."""
        self._call, self._retry, self._base = call, retry, base
        self._made = 0

    def answered(self, response: httpx.Response) -> Result[T] | float:
        """The result, or how many seconds to wait for the next attempt. Raises RemoteError."""
        self._made += 1
        headers = {name.lower(): value for name, value in response.headers.items()}
        reply = Reply(response.status_code, headers, response.content)
        if reply.status in self._call.expected or 200 <= reply.status < 300:
            return Result(self._call.read(reply))
        after_s = parse_retry_after(headers.get("retry-after"))
        if reply.status in RETRIED:
            wait_s = self._retry.delay_s(self._made, retry_after_s=after_s, luck=random.random())
            if wait_s is not None:
                return wait_s
        raise refusal(reply.status, reply.body, retry_after_s=after_s)

    def failed(self, error: httpx.HTTPError) -> float:
        """How many seconds to wait for the next attempt; UnreachableError when there is none."""
        self._made += 1
        hopeless = isinstance(error, httpx.UnsupportedProtocol | httpx.LocalProtocolError | httpx.DecodingError)
        wait_s = None if hopeless else self._retry.delay_s(self._made, luck=random.random())
        if wait_s is not None:
            return wait_s
        attempts = f"{self._made} attempts" if self._made > 1 else "one attempt"
        reason = str(error) or type(error).__name__
        raise UnreachableError(
            f"{self._base}: no answer to {self._call.method} {self._call.path} after {attempts} ({reason}); "
            "is `roomlight serve` running there?"
        ) from error


def client_arguments(url: str, *, token: str | None, timeouts: Timeouts) -> dict[str, Any]:
    """What httpx's client is made with. Raises RoomLightError for an address that is none."""
    try:
        parts = urlsplit(url)
        host = parts.hostname if parts.port != 0 else None
    except ValueError:
        parts, host = None, None
    if parts is None or parts.scheme not in ("http", "https") or not host:
        raise RoomLightError(f"{url!r} is no server's address; it looks like http://localhost:8090")
    if parts.username is not None or parts.password is not None:
        raise RoomLightError("the address holds a user or a password; servers take a token instead: token=...")
    headers = {"User-Agent": "roomlight-python"}
    if token is not None:
        if not token or not token.isascii() or not token.isprintable():
            raise RoomLightError("the token must be printable ASCII, as the server's administrator gave it")
        headers["Authorization"] = f"Bearer {token}"
    limits = httpx.Timeout(timeouts.answer_s, connect=timeouts.connect_s, write=timeouts.send_s)
    # A proxy of the environment is for the world outside, not for this machine.
    return {"base_url": url.rstrip("/"), "headers": headers, "timeout": limits, "trust_env": not _is_loopback(host)}


def request_arguments(call: Call[Any]) -> dict[str, Any]:
    """What httpx sends for a call."""
    return {
        "method": call.method,
        "url": call.path,
        "params": dict(call.params) or None,
        "headers": dict(call.headers),
        "content": call.content,
    }


def ready() -> Call[bool]:
    """Whether the server takes sessions."""
    return Call("GET", "/readyz", lambda reply: reply.status == 200, expected=frozenset({503}))


def new_session_id() -> str:
    """128 random bits: nobody else's, and nobody guesses it."""
    return secrets.token_hex(16)


class SessionCalls:
    """The calls of one session, and the index that its next frame gets."""

    def __init__(self, session_id: str | None = None) -> None:
        """Of this id, or a new one. RoomLightError for an id that no server takes, before it stands in an address."""
        self.session_id = new_session_id() if session_id is None else session_id
        _check_id(self.session_id, "a session's id")
        self.next_index = 0

    def begin(self, state: SessionState) -> None:
        """The session is there: go on after the frames it has."""
        last = state.frames.last_index
        self.next_index = 0 if last is None else last + 1

    def reserve(self, frame: Frame | CameraFrame, index: int | None) -> int:
        """The index to send a frame under: as stated, a `Frame`'s own, or the next.

        It counts as used however the call ends: a frame whose answer is lost may have arrived.
        """
        if index is None:
            index = frame.index if isinstance(frame, Frame) else self.next_index
        self.next_index = max(self.next_index, index + 1)
        return index

    def open(self, request: SessionRequest) -> Call[SessionState]:
        """Make it; where it is there with the same options, this changes nothing."""
        return self._call("PUT", "", _reader(SessionState), json=request)

    def state(self) -> Call[SessionState]:
        """Its state."""
        return self._call("GET", "", _reader(SessionState))

    def close(self) -> Call[None]:
        """Delete it. One that is gone already is what was wanted: an earlier attempt's answer may be lost."""
        return self._call("DELETE", "", _nothing, expected=frozenset({404, 410}))

    def push(self, frame: Frame | CameraFrame, index: int, *, colour: Colour, wait: bool) -> Call[FrameResult]:
        """Send a frame. Raises WireError for one that no server would take."""
        body = pack_camera_frame(frame) if isinstance(frame, CameraFrame) else pack_frame(frame, colour=colour)
        headers = {"Content-Type": FRAME_MEDIA_TYPE} | ({} if wait else {"Prefer": "respond-async"})
        return self._call("PUT", f"/frames/{index}", _reader(FrameResult), content=body, headers=headers)

    def lights(self, places: Sequence[Where], forms: Sequence[LightFormat | LightForm]) -> Call[list[Light]]:
        """Light at several points at one moment. Raises WireError for positions, names or forms that are none."""
        try:
            request = LightRequest(
                probes=[_query(place) for place in places],
                forms=[as_form(form) for form in forms],
            )
        except ValidationError as error:
            raise explain(error, kind="invalid") from error

        def read(reply: Reply) -> list[Light]:
            lights = parse_lights(reply.body, reply.headers.get("content-type", ""))
            if len(lights) != len(places):
                raise BadReplyError(f"asked for light at {len(places)} points, the answer has {len(lights)}")
            return lights

        return self._call("POST", "/probes", read, json=request, headers={"Accept": MEDIA_TYPE})

    def file(self, place: Where, form: LightForm, *, unless: str | None) -> Call[LightFile | None]:
        """One form as a file; None if the light's etag still is `unless`."""
        query = _query(place)
        asked = form.model_dump(exclude_defaults=True, exclude_none=True) | {"format": form.format}
        params = {name: str(value) for name, value in asked.items()}
        params |= {axis: repr(value) for axis, value in zip("xyz", query.position or (), strict=False)}
        headers = {} if unless is None else {"If-None-Match": _quoted(unless)}

        def read(reply: Reply) -> LightFile | None:
            if reply.status == 304:
                return None
            etag = reply.headers.get("etag", "").removeprefix("W/").strip('"')
            return LightFile(reply.body, reply.headers.get("content-type", ""), etag)

        path = "/probe" if query.name is None else f"/probes/{query.name}"
        return self._call("GET", path, read, params=params, headers=headers, expected=frozenset({304}))

    def track(self, name: str, position: Position) -> Call[None]:
        """Follow a point from now on."""
        _check_id(name, "a probe's name")
        _query(position)
        return self._call("PUT", f"/probes/{name}", _nothing, json=ProbeBody(position=_floats(position)))

    def untrack(self, name: str) -> Call[None]:
        """No longer follow it."""
        _check_id(name, "a probe's name")
        return self._call("DELETE", f"/probes/{name}", _nothing, expected=frozenset({404}))

    def _call(
        self,
        method: str,
        path: str,
        read: Callable[[Reply], T],
        *,
        json: BaseModel | None = None,
        content: bytes | None = None,
        headers: Mapping[str, str] | None = None,
        params: Mapping[str, str] | None = None,
        expected: frozenset[int] = frozenset(),
    ) -> Call[T]:
        sent = {SESSION_HEADER: self.session_id, "Accept": "application/json", **(headers or {})}
        if json is not None:
            content, sent["Content-Type"] = json.model_dump_json().encode(), "application/json"
        address = f"/v1/sessions/{self.session_id}{path}"
        return Call(method, address, read, sent, content, params or {}, expected)


def as_form(form: LightFormat | LightForm) -> LightForm:
    """A form by its name, or as it is. Raises WireError for a name that is none."""
    try:
        return form if isinstance(form, LightForm) else LightForm(format=form)
    except ValidationError as error:
        raise explain(error, kind="invalid") from error


def session_request(**options: Any) -> SessionRequest:
    """The options of a session. Raises WireError for one that is none, with field, value and rule."""
    try:
        return SessionRequest(**options)
    except ValidationError as error:
        raise explain(error, kind="invalid") from error


def _reader(model: type[_Model]) -> Callable[[Reply], _Model]:
    def read(reply: Reply) -> _Model:
        try:
            return model.model_validate_json(reply.body)
        except ValidationError as error:
            raise BadReplyError(f"the answer is no {model.__name__}: {explain(error, kind='bad-reply')}") from error

    return read


def _nothing(_: Reply) -> None:
    return None


def _query(place: Where) -> ProbeQuery:
    try:
        return ProbeQuery(name=place) if isinstance(place, str) else ProbeQuery(position=_floats(place))
    except (ValidationError, ValueError, TypeError) as error:
        if isinstance(error, ValidationError):
            raise explain(error, kind="invalid") from error
        rule = "must be a name, or three numbers in world metres"
        raise WireError("invalid", field="position", value=place, rule=rule) from error


def _floats(position: Position) -> list[float]:
    return [float(value) for value in position]


def _quoted(etag: str) -> str:
    return f'"{etag.strip(chr(34))}"'


def _check_id(text: str, what: str) -> None:
    if re.match(ID_PATTERN, text) is None:
        raise RoomLightError(f"{what} is 1 to 64 of the characters A-Z a-z 0-9 _ -, got {text[:80]!r}")


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
