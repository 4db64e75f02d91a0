"""Run a server until it is told to stop: uvicorn, structured logs, a stop that finishes the frame in work."""

import gc
import json
import logging
import os
import socket
import sys
import time
from collections.abc import Callable
from typing import Final

import uvicorn
from fastapi import FastAPI

from roomlight.errors import ServerError
from roomlight_server.app import create_app
from roomlight_server.context import Context
from roomlight_server.settings import ServerSettings

GRACE_S: Final = 20
"""For requests on their way when the server is told to stop; a frame takes a tenth of a second."""
KEEP_ALIVE_S: Final = 75
"""An idle connection is kept so long: a phone that pauses need not shake hands anew."""
SWITCH_S: Final = 0.001
"""How long a computing thread may keep Python's lock when the event loop wants it. Against the default of 0.005 the
median of `/healthz` beside a working engine halves (1.9 to 2.4 ms before, 1.1 to 1.3 after); frames take as long."""
_STANDARD: Final = frozenset(logging.makeLogRecord({}).__dict__) | {"message", "asctime", "color_message", "taskName"}


class JsonLines(logging.Formatter):
    """One record, one line of JSON: time, level, event, and whatever the record was given as `extra`."""

    def format(self, record: logging.LogRecord) -> str:
        """Never more than one line: line breaks are escaped by JSON."""
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        line: dict[str, object] = {
            "time": f"{stamp}.{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "event": record.getMessage(),
        }
        line |= {key: value for key, value in record.__dict__.items() if key not in _STANDARD}
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def configure_logging(level: str) -> None:
    """Everything to standard error, as `JsonLines`."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines())
    logging.basicConfig(handlers=[handler], level=level.upper(), force=True)


def server_of(settings: ServerSettings, app: FastAPI) -> uvicorn.Server:
    """A uvicorn server, not yet started."""
    return uvicorn.Server(
        uvicorn.Config(
            app,
            host=settings.host.strip("[]"),
            port=settings.port,
            access_log=settings.access_log,
            log_config=None,
            ws="websockets-sansio",
            ws_max_size=settings.max_body_bytes + 1,
            ws_max_queue=settings.frames_in_flight,
            server_header=False,
            timeout_keep_alive=KEEP_ALIVE_S,
            timeout_graceful_shutdown=GRACE_S,
        )
    )


def listen(settings: ServerSettings) -> socket.socket:
    """A socket bound to the address of the settings; port 0 becomes one that is free. Raises ServerError."""
    host = settings.host.strip("[]")
    try:
        found = socket.getaddrinfo(host, settings.port, type=socket.SOCK_STREAM)
        # `localhost` may name both families' addresses: clients try 127.0.0.1 in any case
        family, kind, protocol, _, address = min(found, key=lambda each: each[0] != socket.AF_INET)
        bound = socket.socket(family, kind, protocol)
    except OSError as error:
        raise ServerError(f"host: {settings.host!r} is no address of this machine ({error.strerror})") from error
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind(address)
        bound.listen()  # two sockets may be bound to one address, but only one listens: the error comes here, not later
    except OSError as error:
        bound.close()
        raise ServerError(
            f"port: cannot listen on {settings.host}:{settings.port} ({os.strerror(error.errno or 0)}); stop what "
            "listens there, or choose another --port"
        ) from error
    return bound


def settle() -> None:
    """Let the garbage collector pass over what stays for good (kernels, models, routes): 0.18 million objects, for
    which it stopped everything for 0.1 to 0.3 s whenever it looked at them all.
    """
    gc.collect()
    gc.freeze()


def address_of(settings: ServerSettings, bound: socket.socket) -> str:
    """The address to give to clients on this machine."""
    host = settings.host.strip("[]")
    return f"http://{f'[{host}]' if ':' in host else host}:{bound.getsockname()[1]}"


def serve(settings: ServerSettings, *, listening: Callable[[str], object]) -> None:
    """Serve until SIGINT or SIGTERM. `listening` is told the address before anything is answered.

    Raises ModelError where the weights that are asked for cannot be loaded, ServerError where the address is taken.
    """
    configure_logging(settings.log_level)
    sys.setswitchinterval(SWITCH_S)
    app = create_app(settings, when_ready=settle)
    context: Context = app.state.context
    context.workers.load()
    with listen(settings) as bound:
        listening(address_of(settings, bound))
        server_of(settings, app).run(sockets=[bound])
