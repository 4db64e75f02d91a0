"""The application of one replica under Ray Serve: that of a single server, ready before Ray sends it requests."""

import asyncio
import gc
import importlib
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any, Final

from fastapi import FastAPI

from roomlight.errors import ServerError
from roomlight_server.app import create_app
from roomlight_server.base.logs import configure_logging
from roomlight_server.base.settings import ServerSettings
from roomlight_server.routes.context import Context
from roomlight_server.serving import SWITCH_S, freeze_garbage_collector

START_S: Final = 300.0
"""Limit on loading: compiling the kernels for the first time takes a minute, several on a busy machine."""


def replica_app(settings: ServerSettings, *, local: bool) -> FastAPI:
    """Return the application of a replica; its start ends when kernels and networks are loaded.

    Args:
        local: The cluster is of this machine alone: Ray's own port of the replica listens on loopback.

    Raises:
        ModelError: The weights of the default model cannot be loaded.
        ServerError: The state directory cannot be used.
    """
    if local:
        _listen_on_loopback()
    configure_logging(settings.log_level)
    sys.setswitchinterval(SWITCH_S)
    gc.enable()  # Ray switches it off in some of its processes
    app = create_app(settings, when_loaded=freeze_garbage_collector)
    context: Context = app.state.context
    context.workers.load()
    lifespan = app.router.lifespan_context

    @asynccontextmanager
    async def until_ready(started: FastAPI) -> AsyncGenerator[Any]:
        async with lifespan(started) as state:
            try:
                async with asyncio.timeout(START_S):
                    while not context.ready:
                        if context.failure is not None:
                            raise ServerError(f"the replica cannot load: {context.failure}") from context.failure
                        await asyncio.sleep(0.02)
            except TimeoutError:
                raise ServerError(f"the replica is not ready after {START_S:g} s; its log has the reason") from None
            yield state

    app.router.lifespan_context = until_ready
    return app


def _listen_on_loopback() -> None:
    """Bind the port of Ray Serve's calls between deployments, which needs no token, to loopback; Ray has no option."""
    replica: Any = importlib.import_module("ray.serve._private.replica")
    add_port = replica.add_port_to_grpc_server

    def add_loopback_port(server: object, address: str) -> int:
        return add_port(server, address.replace("[::]", "127.0.0.1"))

    replica.add_port_to_grpc_server = add_loopback_port
