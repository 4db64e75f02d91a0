"""Limits of connections below HTTP: their number, bytes of headers, slow requests, clients that do not read.

uvicorn has none of these limits for its httptools protocol. Its `limit_concurrency` counts idle connections too, and
when it is reached, refuses the requests of all clients. The protocols here extend uvicorn's.
"""

import asyncio
import json
import logging
from collections import Counter
from http import HTTPStatus
from typing import Any, Final, Protocol, runtime_checkable

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from roomlight_server.base.metrics import Metrics
from roomlight_server.base.problems import MEDIA_TYPE, ProblemError
from roomlight_server.base.settings import ServerSettings

_log = logging.getLogger("roomlight.server")
TRANSPORT: Final = "transport"
"""Key of a request's connection in the state of its scope."""
LINGER_S: Final = 2.0
"""Time for which the rest of a refused request is read, so that the client receives the answer instead of a reset."""

DISCARDED_BYTES: Final = 16 * 2**20
"""Bytes of a refused request that are read and discarded: a client that sends a whole frame first reads its answer."""


@runtime_checkable
class Transport(Protocol):
    """The part of `asyncio.Transport` that is used here; uvloop's transports are no subclasses of it."""

    def get_write_buffer_size(self) -> int:
        """Return the number of bytes that are not sent yet."""
        ...

    def abort(self) -> None:
        """Close at once."""
        ...


class ConnectionGuard:
    """Counts the connections of a server, in all and by address.

    When all are taken, an idle connection (without a request) makes room for a new one: the one that is idle for the
    longest time, of the address with the most connections. So idle connections do not keep other clients out.
    """

    def __init__(self, settings: ServerSettings, metrics: Metrics) -> None:
        """Create a guard without connections."""
        self.settings, self._metrics = settings, metrics
        self._addresses: dict[Transport, str] = {}
        self._idle: dict[Transport, None] = {}  # in the order in which they became idle
        self._counts: Counter[str] = Counter()
        self._owners: dict[Transport, str] = {}
        self._transports_of: dict[str, set[Transport]] = {}
        metrics.connections.set_function(lambda: len(self._addresses))

    def unsent_bytes(self, owner: str | None = None) -> int:
        """Bytes of answers that clients of an owner, or all, have not received yet."""
        transports = tuple(self._addresses) if owner is None else tuple(self._transports_of.get(owner, ()))
        return sum(transport.get_write_buffer_size() for transport in transports)

    def assign(self, transport: Transport, owner: str) -> None:
        """Record the owner of the current request of a connection."""
        before = self._owners.get(transport)
        if before != owner and transport in self._addresses:
            self._forget_owner(transport)
            self._owners[transport] = owner
            self._transports_of.setdefault(owner, set()).add(transport)

    def _forget_owner(self, transport: Transport) -> None:
        owner = self._owners.pop(transport, None)
        if owner is not None:
            self._transports_of[owner].discard(transport)
            if not self._transports_of[owner]:
                del self._transports_of[owner]

    def admit(self, transport: Transport, address: str) -> ProblemError | None:
        """Count a new connection, which is idle, or return the reason to refuse it."""
        total, each = self.settings.max_connections, self.settings.max_connections_per_address
        if self._counts[address] >= each:
            rule = f"at most {each} connections per address"
        elif len(self._addresses) >= total and not self._make_room():
            rule = f"at most {total} connections"
        else:
            self._addresses[transport] = address
            self._counts[address] += 1
            self._idle[transport] = None
            return None
        return ProblemError("too-many-connections", f"connection refused: {rule}", rule=rule, retry_after_s=5)

    def _make_room(self) -> bool:
        """Close an idle connection; return False if there is none."""
        oldest = max(self._idle, key=lambda each: self._counts[self._addresses[each]], default=None)
        if oldest is None:
            return False
        self.record("idle", self._addresses[oldest])
        self.release(oldest)
        oldest.abort()
        return True

    def idle(self, transport: Transport) -> None:
        """Record that a connection has no request in progress any more."""
        if transport in self._addresses:
            self._idle[transport] = None

    def busy(self, transport: Transport) -> None:
        """Record that a request of a connection is in progress."""
        self._idle.pop(transport, None)

    def release(self, transport: Transport) -> None:
        """Remove a closed connection, if it was admitted."""
        self._forget_owner(transport)
        self._idle.pop(transport, None)
        address = self._addresses.pop(transport, None)
        if address is not None:
            self._counts[address] -= 1
            if not self._counts[address]:
                del self._counts[address]

    def record(self, kind: str, address: str) -> None:
        """Count and log a connection that is refused or closed."""
        self._metrics.connections_refused.labels(kind).inc()
        _log.warning("connection refused", extra={"kind": kind, "address": address})


class _WriteWatch:
    """Aborts a connection whose client receives nothing of a waiting answer for `send_timeout_s`."""

    def __init__(self, transport: Transport, guard: ConnectionGuard, address: str) -> None:
        self._transport, self._guard, self._address = transport, guard, address
        self._timer: asyncio.TimerHandle | None = None

    def start(self) -> None:
        size = self._transport.get_write_buffer_size()
        delay_s = self._guard.settings.send_timeout_s
        self._timer = asyncio.get_running_loop().call_later(delay_s, self._check, size)

    def stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _check(self, size: int) -> None:
        if self._transport.get_write_buffer_size() < size:
            self.start()
            return
        self._guard.record("slow-reader", self._address)
        self._transport.abort()


class HttpProtocol(HttpToolsProtocol):
    """uvicorn's HTTP protocol with the limits of `ConnectionGuard` and `ServerSettings`."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        app: Any = self.config.app
        self._guard: ConnectionGuard = app.state.context.guard
        self._address = ""
        self._watch: _WriteWatch | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._header_bytes = 0  # of the current request: URL, headers, trailers
        self._reported_bytes = 0  # by the parser, of the data that it was last given
        self._unparsed_bytes = 0  # that the parser keeps of an incomplete header
        self._discarded_bytes = 0  # of a body whose request is answered already
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
        self._address = self.client[0] if self.client else ""
        self._watch = _WriteWatch(transport, self._guard, self._address)
        problem = self._guard.admit(transport, self._address)
        if problem is not None:
            self._refuse(problem)
            transport.close()
        else:
            self._start_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        """Release the connection and its timers."""
        self._stop_timer()
        if self._watch is not None:
            self._watch.stop()
        self._guard.release(self.transport)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Parse data within the limits of headers and of discarded bodies."""
        if self._refused or self._is_answered_early():
            self._discarded_bytes += len(data)
            if self._discarded_bytes > DISCARDED_BYTES:
                self._close("too-large")
                return
        if self._refused:
            return
        self._reported_bytes = 0
        super().data_received(data)
        if self._upgraded:
            return
        self._count_unparsed(len(data))
        limit = self._guard.settings.max_header_bytes
        if max(self._header_bytes, self._unparsed_bytes) > limit and not self.transport.is_closing():
            detail = f"the request line and headers have more than {limit} bytes"
            self._refuse(ProblemError("headers-too-large", detail, rule=f"at most {limit} bytes"))
        elif self._timer is None and (self._cycle is None or self._cycle.response_complete):
            self._start_timer()

    def on_message_begin(self) -> None:
        """Begin a request."""
        super().on_message_begin()
        state: dict[str, Any] = self.scope.setdefault("state", {})
        state[TRANSPORT] = self.transport
        self._header_bytes = self._unparsed_bytes = self._discarded_bytes = 0
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
        super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Start the request unless its headers are too large."""
        if self._are_headers_too_large():
            return
        self._reading_headers = False
        self._stop_timer()
        self._guard.busy(self.transport)
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Pass on a part of the body."""
        self._reported_bytes += len(body)
        if not self._are_headers_too_large():
            super().on_body(body)

    def on_message_complete(self) -> None:
        """End the request."""
        self._reported_bytes += 1
        if not self._are_headers_too_large():
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
        if not self._are_headers_too_large():
            self._stop_timer()
            self._upgraded = True
            super().handle_websocket_upgrade()

    def pause_writing(self) -> None:
        """Start to watch a client that does not read."""
        super().pause_writing()
        if self._watch is not None:
            self._watch.start()

    def resume_writing(self) -> None:
        """Stop to watch it."""
        super().resume_writing()
        if self._watch is not None:
            self._watch.stop()

    def _count_unparsed(self, size: int) -> None:
        if self._reading_headers and not self._follows_another:
            self._unparsed_bytes = max(0, self._unparsed_bytes + size - self._reported_bytes)
        elif self._reported_bytes:  # the frames of a chunked body are never reported
            self._unparsed_bytes = 0
        else:
            self._unparsed_bytes += size

    def _are_headers_too_large(self) -> bool:
        return self._header_bytes > self._guard.settings.max_header_bytes

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
        self._guard.record(problem.kind, self._address)
        self.transport.write(_response(problem))
        if self.transport.can_write_eof():
            self.transport.write_eof()
        self._timer = self.loop.call_later(LINGER_S, self.transport.abort)


class StreamProtocol(WebSocketsSansIOProtocol):
    """uvicorn's WebSocket protocol: releases the connection, and ends it after a bad handshake or a bad text."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        app: Any = self.config.app
        self._guard: ConnectionGuard = app.state.context.guard
        self._watch: _WriteWatch | None = None

    def connection_made(self, transport: Any) -> None:
        """Take over an admitted connection."""
        super().connection_made(transport)
        self._watch = _WriteWatch(self.transport, self._guard, self.client[0] if self.client else "")

    async def run_asgi(self) -> None:
        """Run the application with the connection in the scope's state."""
        state: dict[str, Any] = self.scope.setdefault("state", {})
        state[TRANSPORT] = self.transport
        await super().run_asgi()

    def connection_lost(self, exc: Exception | None) -> None:
        """Release the connection."""
        if self._watch is not None:
            self._watch.stop()
        self._guard.release(self.transport)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Parse data. uvicorn sends no answer to a handshake that the library refuses, and leaves it open."""
        super().data_received(data)
        if self.conn.handshake_exc is not None and not self.handshake_complete and not self.transport.is_closing():
            self.transport.write(b"".join(self.conn.data_to_send()))
            self.transport.close()

    def send_receive_event_to_app(self) -> None:
        """Pass on a message. uvicorn logs text that is not UTF-8 as an error with a traceback."""
        if self.curr_msg_data_type == "text" and not self.close_sent:
            try:
                b"".join(self.frames).decode()
            except UnicodeDecodeError:
                self.frames = []
                self.conn.send_close(1007, "text must be UTF-8")
                self.handle_parser_exception()
                return
        super().send_receive_event_to_app()

    def pause_writing(self) -> None:
        """Start to watch a client that does not read."""
        super().pause_writing()
        if self._watch is not None:
            self._watch.start()

    def resume_writing(self) -> None:
        """Stop to watch it."""
        super().resume_writing()
        if self._watch is not None:
            self._watch.stop()


def _response(problem: ProblemError) -> bytes:
    """Return a problem as the bytes of an HTTP response."""
    status = HTTPStatus(problem.problem.status)
    body = json.dumps(problem.problem.model_dump(exclude_none=True)).encode()
    lines = [
        f"HTTP/1.1 {status.value} {status.phrase}",
        f"Content-Type: {MEDIA_TYPE}",
        f"Content-Length: {len(body)}",
        "Connection: close",
    ]
    if problem.retry_after_s is not None:
        lines.append(f"Retry-After: {problem.retry_after_s}")
    return "\r\n".join([*lines, "", ""]).encode() + body
