"""A stream's connection without its logic: its options, its state, how it is opened and how messages are parsed."""

import inspect
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Final, Literal
from urllib.parse import urlsplit

from pydantic import TypeAdapter
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidHandshake, InvalidStatus
from websockets.typing import Subprotocol

from roomlight.errors import OptionError
from roomlight.wire.light_message import parse_light
from roomlight.wire.messages import LightAnswer, LightingUpdate, ServerMessage
from roomlight_client.calls import SESSION_HEADER, SessionCalls, is_loopback
from roomlight_client.errors import RefusedError, RemoteError, UnreachableError, refusal
from roomlight_client.light import Light, lights_of
from roomlight_client.recovery import ClientOptions, Recovery, Resumed

_MESSAGES: Final[TypeAdapter[ServerMessage]] = TypeAdapter(ServerMessage)
_MAX_ANSWER_BYTES: Final = 2**27
_PONG_S: Final = 120.0
"""A ping waits behind the frames on a slow network; calls have their own limit."""


@dataclass(frozen=True)
class StreamStatus:
    """State of a stream's connection.

    Attributes:
        state: `closed` is final; after `reconnecting` comes `open` or `closed`.
        attempt: With `reconnecting`: the number of the next attempt, from 1.
        delay_s: With `reconnecting`: the seconds until that attempt.
        error: With `reconnecting` and `closed`: why the connection ended.
        reopened: With `open`: the server had lost the session; its light starts again from the frames sent again.
        incomplete: With `open`: the server lost frames that are no longer kept; its light differs from before.
    """

    state: Literal["connecting", "open", "reconnecting", "closed"]
    attempt: int = 0
    delay_s: float = 0.0
    error: RemoteError | None = None
    reopened: bool = False
    incomplete: bool = False


@dataclass(frozen=True)
class StreamHandlers:
    """Functions that receive what answers no call; they must not block.

    Raises:
        OptionError: If one is a coroutine function: nobody would wait for it.
    """

    on_lighting: Callable[[list[Light]], object] | None = None
    on_status: Callable[[StreamStatus], object] | None = None
    on_problem: Callable[[RemoteError], object] | None = None

    def __post_init__(self) -> None:
        """Check the functions."""
        for name, handler in vars(self).items():
            if inspect.iscoroutinefunction(handler):
                raise OptionError(f"{name} must be a plain function, got the coroutine function {handler.__name__}")


@dataclass(frozen=True)
class StreamLink:
    """What a stream needs of its session and its client. `resume` runs the steps of `Recovery.resume(reopen=..)`."""

    options: ClientOptions
    calls: SessionCalls
    recovery: Recovery
    resume: Callable[[bool], Awaitable[Resumed]]


async def open_socket(link: StreamLink) -> ClientConnection:
    """Connect to the session's WebSocket. Raises RemoteError if the server refuses or does not respond."""
    options = link.options
    headers = {SESSION_HEADER: link.calls.session_id}
    if options.token is not None:
        headers["Authorization"] = f"Bearer {options.token}"
    base = "ws" + options.url.rstrip("/").removeprefix("http")
    try:
        return await connect(
            f"{base}/v1/sessions/{link.calls.session_id}/stream",
            additional_headers=headers,
            subprotocols=[Subprotocol("roomlight.v1")],
            compression=None,
            max_size=_MAX_ANSWER_BYTES,
            open_timeout=options.timeouts.connect_s,
            close_timeout=1.0,
            ping_timeout=_PONG_S,
            proxy=None if is_loopback(urlsplit(options.url).hostname or "") else True,
            user_agent_header="roomlight-python",
        )
    except InvalidStatus as error:
        raise refusal(error.response.status_code, bytes(error.response.body or b"")) from error
    except (OSError, TimeoutError, InvalidHandshake) as error:
        raise UnreachableError(f"{options.url}: no WebSocket connection ({error})") from error


def decode_message(data: str | bytes) -> tuple[ServerMessage, list[Light]]:
    """Parse a message of the server; return it with its lights."""
    if isinstance(data, bytes):
        is_update = b'"type":"lighting"' in data[: 8 + int.from_bytes(data[4:8], "little")]
        binary, parts = parse_light(data, LightingUpdate) if is_update else parse_light(data, LightAnswer)
        return binary, lights_of(binary, parts)
    message = _MESSAGES.validate_json(data)
    return message, lights_of(message, None) if isinstance(message, LightAnswer | LightingUpdate) else []


def is_temporary(error: RemoteError) -> bool:
    """Return whether the same request may succeed later."""
    if isinstance(error, RefusedError):
        return error.status in (408, 429) or error.status >= 500
    return isinstance(error, UnreachableError)
