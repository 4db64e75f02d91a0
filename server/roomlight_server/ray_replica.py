"""The application of one replica under Ray Serve: that of a single server, ready before Ray sends it requests."""

import asyncio
import gc
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Final

from fastapi import FastAPI

from roomlight.errors import ServerError
from roomlight_server.app import create_app
from roomlight_server.context import Context
from roomlight_server.logs import configure_logging
from roomlight_server.serving import SWITCH_S, freeze_garbage_collector
from roomlight_server.settings import ServerSettings

START_S: Final = 300.0
"""Limit on loading: compiling the kernels for the first time takes a minute, several on a busy machine."""


def replica_app(settings: ServerSettings) -> FastAPI:
    """Return the application of a replica; its start ends when kernels and networks are loaded.

    Raises:
        ModelError: The weights of the default model cannot be loaded.
        ServerError: The state directory cannot be used.
    """
    configure_logging(settings.log_level)
    sys.setswitchinterval(SWITCH_S)
    gc.enable()  # Ray switches it off in some of its processes
    app = create_app(settings, when_ready=freeze_garbage_collector)
    context: Context = app.state.context
    context.workers.load()
    lifespan = app.router.lifespan_context

    @asynccontextmanager
    async def until_ready(started: FastAPI) -> AsyncGenerator[object]:
        async with lifespan(started) as state:
            try:
                async with asyncio.timeout(START_S):
                    while not context.ready:
                        await asyncio.sleep(0.02)
            except TimeoutError:
                raise ServerError(f"the replica is not ready after {START_S:g} s; its log has the reason") from None
            yield state

    app.router.lifespan_context = until_ready
    return app
