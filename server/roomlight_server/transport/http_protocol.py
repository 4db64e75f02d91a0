"""HTTP within limits: headers, requests that wait, slow requests, bodies in tiny pieces, clients that do not read.

uvicorn has none of these limits for its httptools protocol. Its `limit_concurrency` counts idle connections too, and
when it is reached, refuses the requests of all clients. The class here extends uvicorn's; it uses parts of it that are
not public (`cycle`, `pipeline`, `flow`, `scope`), so `pyproject.toml` has an upper bound on uvicorn's version.
"""

import asyncio
import sys
import uuid
from collections.abc import Callable
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import urlsplit

from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from roomlight_server.base.problems import ProblemError, problem_response
from roomlight_server.base.request_context import REQUEST_ID_HEADER, request_id
from roomlight_server.transport.guard import (
    LINGER_S,
    SLICE_BYTES,
    TRANSPORT,
    ConnectionGuard,
    Transport,
    WatchedWriting,
)
from roomlight_server.transport.security_headers import HEADERS

DISCARDED_BYTES: Final = 16 * 2**20
"""Bytes of a refused request that are read and discarded: a client that sends a whole frame first reads its answer."""
MAX_WAITING: Final = 16
"""Requests that a client may send before it has read the answer to the first (HTTP pipelining; browsers send none)."""
MAX_HEADERS: Final = 128
"""Headers of a request; browsers send about 20."""
SPARE_PIECES: Final = 256
"""Pieces of a body that may be small; see `MIN_PIECE_BYTES`."""
MIN_PIECE_BYTES: Final = 64
"""Mean size of the pieces of a body (chunks, or what arrives at once) beyond the first `SPARE_PIECES`."""


class _Flow(FlowControl):
    """uvicorn's flow control, but reading stays paused while requests wait, whatever resumes it."""

    def __init__(self, transport: Any, waiting: Callable[[], object]) -> None:
        super().__init__(transport)
        self._waiting = waiting

    def resume_reading(self) -> None:
        if not self._waiting():
            super().resume_reading()


class HttpProtocol(WatchedWriting, HttpToolsProtocol):
    """uvicorn's HTTP protocol with the limits of `ConnectionGuard` and `ServerSettings`."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        app: Any = self.config.app
        self._guard: ConnectionGuard = app.state.context.guard
        self._problems = app.state.context.metrics.problems
        self.handshake: Transport | None = None
        """The TLS handshake that counted as this connection."""
        self._timer: asyncio.TimerHandle | None = None
        self._header_bytes = 0  # of the current request: URL, headers, trailers
        self._reported_bytes = 0  # by the parser, of the data that it was last given
        self._unparsed_bytes = 0  # that the parser keeps of an incomplete header
        self._discarded_bytes = 0  # of a body whose request is answered already
        self._headers = 0  # of the current request, trailers included
        self._pieces = self._piece_bytes = 0  # of the current body
        self._too_many_waiting = False
        self._reading_headers = False
        self._follows_another = False
        self._refused = False
        self._upgraded = False  # StreamProtocol has the connection

    @property
    def _cycle(self) -> RequestResponseCycle | None:
        """The current or last request; uvicorn declares no None, but there is none before the first."""
        return self.cycle

    def connection_made(self, transport: Any) -> None:
        """Admit or refuse a connection."""
        super().connection_made(transport)
        self.flow = _Flow(transport, lambda: self.pipeline)
        self._address = self.client[0] if self.client else ""
        if self.handshake is not None:
            self._guard.release(self.handshake)
        problem = self._guard.admit(transport, self._address)
        if problem is not None:
            self._refuse(problem)
            transport.close()
        else:
            self._start_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        """Release the connection and its timers."""
        self._stop_timer()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Parse data, a slice at a time, within the limits of headers, waiting requests and discarded bodies."""
        with self._guard.naming(self._address):
            for start in range(0, len(data), SLICE_BYTES):
                if self._upgraded or self.transport.is_closing():
                    return
                self._parse(data[start : start + SLICE_BYTES])

    def _parse(self, data: bytes) -> None:
        if self._refused or self._is_answered_early():
            self._discarded_bytes += len(data)
            if self._discarded_bytes > DISCARDED_BYTES:
                self._close("too-large")
                return
        if self._refused:
            return
        self._reported_bytes = 0
        super().data_received(data)
        if self._upgraded or self._refused or self.transport.is_closing():
            return
        self._count_unparsed(len(data))
        limit = self._guard.settings.max_header_bytes
        if self._too_many_waiting:
            self._close("pipelining")
        elif self._pieces > SPARE_PIECES and self._piece_bytes < MIN_PIECE_BYTES * (self._pieces - SPARE_PIECES):
            self._close("tiny-pieces")
        elif self._headers > MAX_HEADERS or max(self._header_bytes, self._unparsed_bytes) > limit:
            rule = f"at most {limit} bytes and {MAX_HEADERS} headers"
            detail = f"the request line and headers are too large: {rule}"
            self._refuse(ProblemError("headers-too-large", detail, rule=rule))
        elif self._timer is None and (self._cycle is None or self._cycle.response_complete):
            self._start_timer()

    def on_message_begin(self) -> None:
        """Begin a request."""
        super().on_message_begin()
        state: dict[str, Any] = self.scope.setdefault("state", {})
        state[TRANSPORT] = self.transport
        self._header_bytes = self._unparsed_bytes = self._discarded_bytes = 0
        self._headers = self._pieces = self._piece_bytes = 0
        self._follows_another = self._cycle is not None
        self._reading_headers = True
        if self._timer is None:
            self._start_timer()

    def on_url(self, url: bytes) -> None:
        """Count a part of the URL."""
        self._reported_bytes += len(url)
        self._header_bytes += len(url)
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        """Count a header or trailer."""
        self._reported_bytes += len(name) + len(value) + 4
        self._header_bytes += len(name) + len(value) + 4
        self._headers += 1
        if not self._is_beyond_limits():
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Start the request unless its headers are too large."""
        self._too_many_waiting |= len(self.pipeline) >= MAX_WAITING
        if self._is_beyond_limits():
            return
        if not self.url.startswith(b"/") and (authority := urlsplit(self.url).netloc):
            # a proxy's form of a request: Host is ignored (RFC 9112, section 3.2.2)
            self.headers[:] = [(name, authority if name == b"host" else value) for name, value in self.headers]
        self._reading_headers = False
        self._stop_timer()
        self._guard.busy(self.transport)
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Pass on a part of the body."""
        self._reported_bytes += len(body)
        self._pieces += 1
        self._piece_bytes += len(body)
        if not self._is_beyond_limits():
            super().on_body(body)

    def on_message_complete(self) -> None:
        """End the request."""
        self._reported_bytes += 1
        if not self._is_beyond_limits():
            super().on_message_complete()
            if self._cycle is not None and self._cycle.response_complete:
                self._cycle.more_body = False

    def on_response_complete(self) -> None:
        """End the answer; the connection is idle unless its client has sent the next request already."""
        if not self.pipeline:
            self._guard.idle(self.transport)
        super().on_response_complete()

    def handle_websocket_upgrade(self) -> None:
        """Hand the connection to `StreamProtocol`, which releases it."""
        if not self._is_beyond_limits():
            self._stop_timer()
            self._stop_watch()  # writing is resumed by `StreamProtocol`
            self._upgraded = True
            super().handle_websocket_upgrade()

    def send_400_response(self, msg: str) -> None:
        """Refuse what is not HTTP, with the parser's reason; close alone if an earlier request waits for its answer."""
        reason = str(sys.exception() or "") or msg
        cycle = self._cycle
        if cycle is not None and not cycle.response_complete:
            if self.pipeline or cycle.response_started or not cycle.more_body:
                self._close("bad-request")
                return
            cycle.disconnected = True  # its body is what cannot be read: it sends no other answer
            cycle.message_event.set()
        self._refuse(ProblemError("bad-request", f"the request is not valid HTTP/1.1: {reason}", rule=reason))

    def _count_unparsed(self, size: int) -> None:
        if self._reading_headers and not self._follows_another:
            self._unparsed_bytes = max(0, self._unparsed_bytes + size - self._reported_bytes)
        elif self._reported_bytes:  # the frames of a chunked body are never reported
            self._unparsed_bytes = 0
        else:
            self._unparsed_bytes += size

    def _is_beyond_limits(self) -> bool:
        """Whether what the parser reports is ignored, because `_parse` ends the connection after this slice."""
        too_large = self._header_bytes > self._guard.settings.max_header_bytes or self._headers > MAX_HEADERS
        return too_large or self._too_many_waiting

    def _is_answered_early(self) -> bool:
        """Whether the current request is answered, but its body is still arriving."""
        return self._cycle is not None and self._cycle.response_complete and self._cycle.more_body

    def _start_timer(self) -> None:
        self._timer = self.loop.call_later(self._guard.settings.header_timeout_s, self._time_out)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _time_out(self) -> None:
        self._timer = None
        if self._is_answered_early():
            self._close("body-timeout")
        elif not self._reading_headers:
            self._close("no-request")
        else:
            limit_s = self._guard.settings.header_timeout_s
            self._refuse(ProblemError("header-timeout", f"the headers did not arrive within {limit_s:g} s"))

    def _close(self, kind: str) -> None:
        if not self.transport.is_closing():
            self._guard.record(kind, self._address)
            self._stop_timer()
            self.transport.abort()

    def _refuse(self, problem: ProblemError) -> None:
        """Answer with the problem and close, after a client that still sends had time to read the answer."""
        self._refused = True
        self._stop_timer()
        self._problems.labels(problem.kind).inc()
        name = request_id.set(uuid.uuid4().hex)
        self._guard.record(problem.kind, self._address)
        self.transport.write(_response(problem))
        request_id.reset(name)
        if self.transport.can_write_eof():
            self.transport.write_eof()
        self._timer = self.loop.call_later(LINGER_S, self.transport.abort)


def _response(problem: ProblemError) -> bytes:
    answer, status = problem_response(problem), HTTPStatus(problem.problem.status)
    answer.headers.update(HEADERS | {"Connection": "close", REQUEST_ID_HEADER: request_id.get()})
    lines = [f"{name}: {value}" for name, value in answer.headers.items()]
    return "\r\n".join([f"HTTP/1.1 {status.value} {status.phrase}", *lines, "", ""]).encode() + bytes(answer.body)
