"""The connections of a server: their number in all and by address, their owners, and what is refused or closed."""

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any, Final, Protocol, runtime_checkable

from roomlight_server.base.metrics import Metrics
from roomlight_server.base.problems import ProblemError
from roomlight_server.base.request_context import may_see
from roomlight_server.base.settings import ServerSettings

_log = logging.getLogger("roomlight.server")
TRANSPORT: Final = "transport"
"""Key of a request's connection in the state of its scope."""
LINGER_S: Final = 2.0
"""Time for which the rest of a refused connection is read, so that the client receives the answer, not a reset."""
SLICE_BYTES: Final = 8192
"""Bytes that a parser is given at once; after each slice the limits are checked."""
_LOG_LINES: Final = 20
"""Lines a second, of each kind, about refused connections: a flood of connections must not become a flood of lines."""


@runtime_checkable
class Transport(Protocol):
    """The part of `asyncio.Transport` that is used here; uvloop's transports are no subclasses of it."""

    def get_write_buffer_size(self) -> int:
        """Return the number of bytes that are not sent yet."""
        ...

    def abort(self) -> None:
        """Close at once."""
        ...


class Allowance:
    """A number of events that grows with time up to a maximum (a token bucket)."""

    def __init__(self, per_s: float, most: int, clock: Callable[[], float] = time.monotonic) -> None:
        """Create a full allowance of `most` events, which grows by `per_s` events a second."""
        self._per_s, self._most, self._clock = per_s, most, clock
        self._left, self._at_s = float(most), clock()

    def take(self) -> float:
        """Use one event; return 0, or the seconds until it is allowed, and then it is used all the same."""
        now_s = self._clock()
        self._left = min(self._most, self._left + self._per_s * (now_s - self._at_s)) - 1.0
        self._at_s = now_s
        return max(0.0, -self._left / self._per_s)

    def try_take(self) -> bool:
        """Use one event if it is allowed; return whether it was."""
        allowed = self.take() == 0.0
        if not allowed:
            self._left += 1.0
        return allowed


class ConnectionGuard:
    """Counts the connections of a server, in all and by address.

    When all are taken, an idle connection (without a request) makes room for a new one: the one that is idle for the
    longest time, of the address with the most connections. So idle connections do not keep other clients out.
    """

    def __init__(self, settings: ServerSettings, metrics: Metrics) -> None:
        self.settings, self._metrics = settings, metrics
        self._addresses: dict[Transport, str] = {}
        self._idle: dict[Transport, None] = {}  # in the order in which they became idle
        self._counts: Counter[str] = Counter()
        self._owners: dict[Transport, str] = {}
        self._transports_of: dict[str, set[Transport]] = {}
        self._lines: dict[str, Allowance] = {}
        self._unlogged: Counter[str] = Counter()
        self.parsing: str | None = None
        """Address of the client whose data is being parsed; read by the watchdog's thread."""
        metrics.connections.set_function(lambda: self.connections)

    @property
    def connections(self) -> int:
        """Connections that are open, TLS handshakes included."""
        return len(self._addresses)

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

    def close_owner(self, owner: str) -> None:
        """Close the connections of an owner whose token is not valid any more, and of its phones."""
        for transport, connected in tuple(self._owners.items()):
            if may_see(owner, connected):
                self.record("token-ended", self._addresses[transport])
                transport.abort()

    def admit(self, transport: Transport, address: str) -> ProblemError | None:
        """Count a new connection, which is idle, or return the reason to refuse it."""
        total, per_address = self.settings.max_connections, self.settings.max_connections_per_address
        if self._counts[address] >= per_address:
            rule = f"at most {per_address} connections per address"
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
        oldest = max(self._idle, key=lambda idle: self._counts[self._addresses[idle]], default=None)
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

    def release(self, transport: Transport) -> bool:
        """Remove a closed connection; return whether it was admitted."""
        self._forget_owner(transport)
        self._idle.pop(transport, None)
        address = self._addresses.pop(transport, None)
        if address is None:
            return False
        self._counts[address] -= 1
        if not self._counts[address]:
            del self._counts[address]
        return True

    def record(self, kind: str, address: str) -> None:
        """Count a connection that is refused or closed, and log it, at most `_LOG_LINES` a second of each kind."""
        self._metrics.connections_refused.labels(kind).inc()
        if not self._lines.setdefault(kind, Allowance(float(_LOG_LINES), _LOG_LINES)).try_take():
            self._unlogged[kind] += 1
            return
        more = self._unlogged.pop(kind, 0)
        _log.warning("connection refused", extra={"kind": kind, "address": address, "unlogged": more})

    @contextmanager
    def naming(self, address: str) -> Generator[None]:
        """Name the client whose data is parsed inside the context."""
        before, self.parsing = self.parsing, address
        try:
            yield
        finally:
            self.parsing = before


class WatchedWriting(asyncio.BaseProtocol):
    """A protocol of a counted connection, which it aborts if its client receives nothing of a waiting
    answer for `send_timeout_s`."""

    transport: Any
    _guard: ConnectionGuard
    _address = ""
    _watch: asyncio.TimerHandle | None = None

    def pause_writing(self) -> None:
        """Start to watch."""
        super().pause_writing()
        self._start_watch()

    def resume_writing(self) -> None:
        """Stop to watch."""
        super().resume_writing()
        self._stop_watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """Release the connection."""
        self._stop_watch()
        self._guard.release(self.transport)
        super().connection_lost(exc)

    def _start_watch(self) -> None:
        size, delay_s = self.transport.get_write_buffer_size(), self._guard.settings.send_timeout_s
        self._watch = asyncio.get_running_loop().call_later(delay_s, self._check_progress, size)

    def _stop_watch(self) -> None:
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None

    def _check_progress(self, size: int) -> None:
        if self.transport.get_write_buffer_size() < size:
            self._start_watch()
            return
        self._guard.record("slow-reader", self._address)
        self.transport.abort()
