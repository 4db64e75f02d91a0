"""WebSockets within limits: control frames, fragments, messages, clients that do not read.

The class extends uvicorn's; like `HttpProtocol` it uses parts of it that are not public.
"""

import asyncio
from typing import Any, Final

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame

from roomlight_server.transport.guard import (
    LINGER_S,
    SLICE_BYTES,
    TRANSPORT,
    Allowance,
    ConnectionGuard,
    WatchedWriting,
)

CONTROL_FRAMES_PER_S: Final = 16.0
SPARE_CONTROL_FRAMES: Final = 64
"""Pings and pongs at once; a client sends one of each every 20 s."""
SPARE_FRAGMENTS: Final = 64
MIN_FRAGMENT_BYTES: Final = 1024
"""Mean size of the fragments of a message beyond the first `SPARE_FRAGMENTS`; browsers send 64 KiB or more."""
MESSAGES_PER_S: Final = 250.0
SPARE_MESSAGES: Final = 500
"""Messages at once, before the server waits between them; a phone sends 30 frames a second and a few calls."""


class StreamProtocol(WatchedWriting, WebSocketsSansIOProtocol):
    """uvicorn's WebSocket protocol within limits; it ends the connection after a bad handshake or a bad text."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        app: Any = self.config.app
        self._guard: ConnectionGuard = app.state.context.guard
        self._unparsed = bytearray()  # what arrived behind a message that the application has not taken
        self._fragments = self._fragment_bytes = 0  # of the current message
        self._control_frames = Allowance(CONTROL_FRAMES_PER_S, SPARE_CONTROL_FRAMES)
        self._messages = Allowance(MESSAGES_PER_S, SPARE_MESSAGES)

    def connection_made(self, transport: Any) -> None:
        """Take over an admitted connection."""
        super().connection_made(transport)
        self._address = self.client[0] if self.client else ""

    async def run_asgi(self) -> None:
        """Run the application with the connection in the scope's state."""
        state: dict[str, Any] = self.scope.setdefault("state", {})
        state[TRANSPORT] = self.transport
        await super().run_asgi()

    def data_received(self, data: bytes) -> None:
        """Parse data up to the next message; the rest waits until the application has taken it."""
        self._unparsed += data
        self._parse()
        if self._unparsed and not self.read_paused:
            self.read_paused = True
            self.transport.pause_reading()

    def _parse(self) -> None:
        with self._guard.naming(self._address):
            # After the server's close frame uvicorn drops messages: reading goes on until the client's answer to it.
            while self._unparsed and (self.close_sent or self.queue.empty()) and not self.transport.is_closing():
                part = bytes(self._unparsed[:SLICE_BYTES])
                del self._unparsed[:SLICE_BYTES]
                super().data_received(part)
                if self.conn.handshake_exc is not None and not self.handshake_complete:
                    self._refuse_handshake()

    def _refuse_handshake(self) -> None:
        """Send the answer to a handshake that the library refuses: uvicorn sends none and leaves it open."""
        if not self.transport.is_closing():
            self.transport.write(b"".join(self.conn.data_to_send()))
            self.transport.close()

    async def receive(self) -> Any:
        """Return the next message for the application, at most `MESSAGES_PER_S` a second after the first ones."""
        wait_s = self._messages.take()
        if wait_s:
            await asyncio.sleep(wait_s)
        message = await super().receive()
        self._parse()
        return message

    async def send(self, message: Any) -> None:
        """Send a message of the application; after a close frame, parse what the client sent before."""
        await super().send(message)
        if message["type"] == "websocket.http.response.body" and self.close_sent:
            self.handshake_complete = True  # uvicorn logs an error without it
        if self.close_sent:
            self._parse()

    def handle_text(self, event: Frame) -> None:
        """Begin a text message."""
        self._fragments = self._fragment_bytes = 0
        super().handle_text(event)

    def handle_bytes(self, event: Frame) -> None:
        """Begin a binary message."""
        self._fragments = self._fragment_bytes = 0
        super().handle_bytes(event)

    def handle_cont(self, event: Frame) -> None:
        """Continue a message; too many small fragments close the connection."""
        self._fragments += 1
        self._fragment_bytes += len(event.data)
        if self._fragments > SPARE_FRAGMENTS + self._fragment_bytes // MIN_FRAGMENT_BYTES:
            self._end("fragments", "too many small fragments")
        else:
            super().handle_cont(event)

    def handle_ping(self) -> None:
        """Answer a ping; too many control frames close the connection."""
        if self._control_frames.try_take():
            super().handle_ping()
        else:
            self._end("control-frames", "too many control frames")

    def handle_pong(self, event: Frame) -> None:
        """Note a pong; too many control frames close the connection."""
        if self._control_frames.try_take():
            super().handle_pong(event)
        else:
            self._end("control-frames", "too many control frames")

    def _end(self, kind: str, reason: str) -> None:
        """Close with 1008 (policy violation); what the client does not read then is dropped soon."""
        if self.close_sent or self.transport.is_closing():
            return
        self._guard.record(kind, self._address)
        self._unparsed.clear()
        self.frames = []
        self.conn.send_close(1008, reason)
        self.handle_parser_exception()
        self.loop.call_later(LINGER_S, self.transport.abort)

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
