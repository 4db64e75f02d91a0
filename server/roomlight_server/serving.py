"""Running a server: uvicorn, its options, a graceful stop."""

import asyncio
import errno
import gc
import logging
import os
import resource
import signal
import socket
import ssl
import sys
import threading
from collections.abc import Callable, Generator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import Any, Final

import uvicorn
from fastapi import FastAPI

from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.errors import ServerError
from roomlight_server.app import create_app
from roomlight_server.base.logs import configure_logging, native_lines_logged
from roomlight_server.base.problems import ProblemError
from roomlight_server.base.settings import ServerSettings
from roomlight_server.base.tls import warn_if_expired
from roomlight_server.routes.context import Context
from roomlight_server.transport.http_protocol import HttpProtocol
from roomlight_server.transport.lan import phone_url
from roomlight_server.transport.stream_protocol import StreamProtocol
from roomlight_server.transport.tls_listener import TlsListener

_log = logging.getLogger("roomlight.server")
ReadTokens = Callable[[], tuple[str, ...]]
"""Returns the tokens of the settings as they are now; raises ServerError."""
STOP_S: Final = 10.0
"""Time after SIGTERM by which the process has ended: frames in progress have 2.5 of it, open answers 1, saving sessions
5, threads 1. What hangs nevertheless is ended by `_end_late`."""
DRAIN_LIMIT_S: Final = 2.5
GRACE_S: Final = 1
"""Time to finish answers after the listening socket is closed."""
KEEP_ALIVE_S: Final = 75
"""Time that an idle connection is kept open, so that a phone that pauses need not reconnect."""
OTHER_FILES: Final = 384
"""Open files besides connections: libraries, the state of sessions, uploads, pipes of processes."""
SWITCH_S: Final = 0.001
"""Interval after which a computing thread releases Python's global lock to the event loop. Compared with the default of
0.005 it halves the median of `/healthz` beside a running engine (1.9 to 2.4 ms before, 1.1 to 1.3 after); the time of a
frame stays the same."""


class GracefulServer(uvicorn.Server):
    """A uvicorn server that stops in steps.

    First `/readyz` answers 503, so that a load balancer sends no more; new sessions and frames are refused, and those
    in progress are finished. Then it stops listening, and sessions are saved if the server keeps them.
    """

    def __init__(
        self,
        settings: ServerSettings,
        app: FastAPI,
        *,
        when_stopping: Callable[[], object] = lambda: None,
        read_tokens: ReadTokens | None = None,
    ) -> None:
        """Create a server; `when_stopping` is called when the stop begins, `read_tokens` at SIGHUP."""
        config = uvicorn.Config(
            app,
            host=settings.host.strip("[]"),
            port=settings.port,
            access_log=settings.access_log,
            log_config=None,
            http=HttpProtocol,
            ws=StreamProtocol,
            ws_max_size=settings.max_body_bytes + 1,
            ws_max_queue=settings.frames_in_flight,
            ws_ping_timeout=120.0,  # a client's pong waits behind its frames on a slow network
            ws_per_message_deflate=False,  # 6.9 MB on the wire became 3.8 GB; frames are compressed already
            server_header=False,
            timeout_keep_alive=KEEP_ALIVE_S,
            timeout_graceful_shutdown=GRACE_S,
        )
        super().__init__(config)
        self._when_stopping, self._read_tokens = when_stopping, read_tokens
        self._loop: asyncio.AbstractEventLoop | None = None

    @property
    def _context(self) -> Context:
        app: Any = self.config.app
        return app.state.context

    def _on_hangup(self, number: int, frame: FrameType | None) -> None:
        if self._read_tokens is None or self._loop is None:
            self.handle_exit(number, frame)
        else:  # a line of the log must not be written inside another
            self._loop.call_soon_threadsafe(self._reload_tokens, self._read_tokens)

    def _reload_tokens(self, read_tokens: ReadTokens) -> None:
        """Use the tokens of the token file from now on; close the connections of those that are gone."""
        context = self._context
        try:
            tokens = read_tokens()
        except ServerError as error:
            _log.error("the tokens stay as they are: %s", error)
            return
        before = context.tokens.owners
        context.tokens.replace(tokens)
        for owner in set(before) - set(context.tokens.owners):
            context.guard.close_owner(owner)
        _log.info("tokens read again", extra={"tokens": len(tokens)})

    @contextmanager
    def capture_signals(self) -> Generator[None]:
        """At SIGHUP read the tokens again, or stop as at SIGTERM. It stays ignored below `nohup`."""
        captured = threading.current_thread() is threading.main_thread()
        if not captured or signal.getsignal(signal.SIGHUP) == signal.SIG_IGN:
            with super().capture_signals():
                yield
            return
        before = signal.signal(signal.SIGHUP, self._on_hangup)
        try:
            with super().capture_signals():
                yield
        finally:
            signal.signal(signal.SIGHUP, before)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen; with a certificate, by `TlsListener`."""
        self._loop = asyncio.get_running_loop()
        context, settings = self._context, self._context.settings
        if settings.tls_cert is None:
            await super().startup(sockets)
            return
        tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        tls.load_cert_chain(settings.tls_cert, settings.tls_key)
        # A ticket arrives while a client sends its first request. In Python, where one thread reads and another writes,
        # that request was lost in one of 1,000 connections.
        tls.num_tickets = 0
        await super().startup([])

        def make() -> HttpProtocol:
            return HttpProtocol(self.config, self.server_state, self.lifespan.state)

        self.servers: list[Any] = [
            TlsListener(bound, tls, context.guard, make) for bound in sockets or [listen(settings)]
        ]

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop; at most `STOP_S`."""
        self._when_stopping()
        context = self._context
        context.begin_stop()
        _log.info("stopping")
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        drains = {signal.SIGTERM, signal.SIGHUP} & set(self._captured_signals)
        notice_s = context.settings.drain_s if drains else 0.0
        while loop.time() - began_s < notice_s or context.registry.frames_in_flight:
            if loop.time() - began_s >= max(notice_s, DRAIN_LIMIT_S) or self.force_exit:
                break
            await asyncio.sleep(0.02)
        await super().shutdown(sockets)


def _phone_link(context: Context, address: str) -> str | None:
    """Return the address that pairs a phone; None where phones do not reach the server, or too many are paired."""
    if not context.settings.on_lan or not context.settings.tokens:
        return None
    try:
        return phone_url(address, context.phones.link(context.tokens.owners[0]))
    except ProblemError as error:
        _log.warning("no phone can be paired: %s (the page lists them)", error)
        return None


def _limit_stop() -> None:
    """End this process `STOP_S` from now, if it has not ended by itself."""
    timer = threading.Timer(STOP_S, _end_late)
    timer.daemon = True
    timer.start()


def _end_late() -> None:
    _log.error("the stop took longer than %g s; what is left of it is dropped", STOP_S)
    sys.stderr.flush()
    os._exit(1)


def listen(settings: ServerSettings) -> socket.socket:
    """Return a socket that listens on the address of the settings; port 0 takes a free port.

    Raises:
        ServerError: The host is not an address of this machine, or the port is in use or needs more rights.
    """
    host = settings.host.strip("[]")
    try:
        addresses = socket.getaddrinfo(host, settings.port, type=socket.SOCK_STREAM)
        # `localhost` may have addresses of both families; every client tries 127.0.0.1
        family, kind, protocol, _, address = min(addresses, key=lambda entry: entry[0] != socket.AF_INET)
        bound = socket.socket(family, kind, protocol)
    except OSError as error:
        raise ServerError(f"host: {settings.host!r} is not an address of this machine ({error.strerror})") from error
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind(address)
        bound.listen()  # two sockets can bind to one address but only one can listen: report that here
    except OSError as error:
        bound.close()
        reason = os.strerror(error.errno or 0)
        if error.errno == errno.EADDRNOTAVAIL:
            problem = f"host: {settings.host!r} is not an address of this machine ({reason}); choose another --host"
        else:
            advice = "stop the process that listens there, or choose another --port"
            if error.errno in (errno.EACCES, errno.EPERM):
                advice = "use a --port from 1024 on"
            problem = f"port: cannot listen on {settings.host}:{settings.port} ({reason}); {advice}"
        raise ServerError(problem) from error
    return bound


def _listen_locally(settings: ServerSettings, bound: socket.socket) -> list[socket.socket]:
    """Return a socket on loopback, with the port of `bound`, of a server on the local network."""
    if not settings.on_lan or settings.is_loopback:
        return []
    port = bound.getsockname()[1]
    return [listen(settings.model_copy(update={"host": "127.0.0.1", "port": port}))]


def allow_files(connections: int) -> None:
    """Raise this process's limit of open files, as far as it may, so that so many connections fit."""
    needed = connections + OTHER_FILES
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft >= needed or soft == resource.RLIM_INFINITY:
        return
    allowed = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))
    if allowed < needed:
        rule = f"max_connections should be at most {max(1, allowed - OTHER_FILES)}"
        _log.warning("the limit of open files is low", extra={"files": allowed, "rule": rule})


def freeze_garbage_collector() -> None:
    """Exclude permanent objects (kernels, models, routes) from garbage collection.

    There are 180,000; each full collection of them paused the process for 0.1 to 0.3 s.
    """
    gc.collect()
    gc.freeze()


def address_of(settings: ServerSettings, port: int) -> str:
    """Return the URL of the server for clients on this machine."""
    host = settings.host.strip("[]")
    scheme = "http" if settings.tls_cert is None else "https"
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}"


def serve(
    settings: ServerSettings,
    *,
    listening: Callable[[str, str | None], object],
    read_tokens: ReadTokens | None = None,
    graphs: "Future[LightingGraphs | None] | None" = None,
) -> None:
    """Serve until SIGINT or SIGTERM.

    Args:
        listening: Called before the first request is answered, with the URL of the server and, on the local network,
            the URL that pairs a phone.
        read_tokens: Called at SIGHUP; None: SIGHUP stops the server.
        graphs: As in `Workers.load`.

    Raises:
        ModelError: The weights of the default model cannot be loaded.
        ServerError: The server cannot listen on the address.
    """
    with native_lines_logged():
        configure_logging(settings.log_level)
        sys.setswitchinterval(SWITCH_S)
        allow_files(settings.max_connections)
        if settings.tls_cert is not None:
            warn_if_expired(settings.tls_cert)
        app = create_app(settings, when_loaded=freeze_garbage_collector)
        context: Context = app.state.context
        context.workers.load(graphs)
        if "*" in settings.allow_origins and not settings.tokens:
            _log.warning("allow_origins is * and there is no token: any web page on this machine can use the server")
        try:
            with ExitStack() as sockets:
                bound = sockets.enter_context(listen(settings))
                local = [sockets.enter_context(bound_socket) for bound_socket in _listen_locally(settings, bound)]
                address = address_of(settings, bound.getsockname()[1])
                context.public_url = address if settings.on_lan else None
                _log.info("serving", extra={"url": address})
                listening(address, _phone_link(context, address))
                server = GracefulServer(settings, app, when_stopping=_limit_stop, read_tokens=read_tokens)
                server.run(sockets=[bound, *local])
        finally:
            context.workers.decode_processes.stop()  # also if it cannot listen
