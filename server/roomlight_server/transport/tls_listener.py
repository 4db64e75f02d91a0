"""A socket that accepts TLS connections: their handshakes count as connections and have a deadline.

A listening socket of asyncio makes the handshake before it asks for a protocol, so that 1,400 silent connections took
all files of the process.
"""

import asyncio
import logging
import socket
import ssl
from collections.abc import Callable
from typing import Final

from roomlight_server.transport.guard import ConnectionGuard
from roomlight_server.transport.http_protocol import HttpProtocol

_log = logging.getLogger("roomlight.server")
HANDSHAKE_S: Final = 5.0
"""Time limit of a TLS handshake."""
_FULL_S: Final = 0.1
"""Time until the next attempt when the process has no files left."""


class _Handshake:
    """A connection before the end of its handshake; a `Transport` for the guard."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.task: asyncio.Task[None] | None = None

    def get_write_buffer_size(self) -> int:
        return 0

    def abort(self) -> None:
        if self.task is not None:
            self.task.cancel()


class TlsListener:
    """Accepts connections of one socket. It has the methods of `asyncio.Server` that uvicorn calls."""

    def __init__(
        self, bound: socket.socket, tls: ssl.SSLContext, guard: ConnectionGuard, make: Callable[[], HttpProtocol]
    ) -> None:
        """Listen on a bound socket, inside a running event loop; `make` makes the protocol of a connection."""
        bound.setblocking(False)
        self.sockets = (bound,)
        self._tls, self._guard, self._make = tls, guard, make
        self._pending: set[asyncio.Task[None]] = set()
        self._accepting = asyncio.create_task(self._accept(bound))

    def close(self) -> None:
        """Stop accepting connections, and end the handshakes."""
        for task in (self._accepting, *self._pending):
            task.cancel()

    async def wait_closed(self) -> None:
        """Wait until the handshakes have ended."""
        await asyncio.wait((self._accepting, *self._pending))

    async def _accept(self, bound: socket.socket) -> None:
        with bound:
            while True:
                try:
                    connection, peer = await asyncio.get_running_loop().sock_accept(bound)
                except OSError as error:
                    _log.error("connections cannot be accepted: %s", error.strerror)
                    await asyncio.sleep(_FULL_S)
                else:
                    self._admit(connection, str(peer[0]))

    def _admit(self, connection: socket.socket, address: str) -> None:
        handshake = _Handshake(connection)
        problem = self._guard.admit(handshake, address)
        if problem is not None:  # without TLS there is no way to send a reason
            self._guard.record(problem.kind, address)
            connection.close()
            return
        handshake.task = asyncio.create_task(self._shake(handshake, address))
        self._pending.add(handshake.task)
        handshake.task.add_done_callback(self._pending.discard)

    async def _shake(self, handshake: _Handshake, address: str) -> None:
        protocol = self._make()
        protocol.handshake = handshake
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                lambda: protocol, handshake.connection, ssl=self._tls, ssl_handshake_timeout=HANDSHAKE_S
            )
        except OSError:  # SSLError, ConnectionError and TimeoutError are OSErrors
            if self._guard.release(handshake):
                self._guard.record("tls-handshake", address)
        finally:
            if self._guard.release(handshake):
                handshake.connection.close()
